// SPDX-License-Identifier: Apache-2.0
#include "gltf_accessor.h"
#include "gltf_model.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>

namespace lumivdb {

namespace {

/// Translation × rotation × scale, as glTF gives them.
struct Trs {
    double translation[3] = {0, 0, 0};
    double rotation[4] = {0, 0, 0, 1}; ///< x, y, z, w
    double scale[3] = {1, 1, 1};
};

/// Rows are the images of the axes (row vectors).
Mat4d compose(const SceneImport& import, const Trs& trs, const std::string& what)
{
    const double* q = trs.rotation;
    const double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(length > 0)) import.fail(what + " has a rotation of length 0");
    const double x = q[0] / length, y = q[1] / length, z = q[2] / length, w = q[3] / length;
    const Vec3d rows[3] = {
        {1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)},
        {2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)},
        {2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)},
    };
    Mat4d m;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) m[i][j] = rows[i][j] * trs.scale[i];
        m[3][i] = trs.translation[i];
    }
    return m;
}

template <std::size_t N>
void read(const SceneImport& import, const std::vector<double>& from, double (&to)[N],
    const std::string& what)
{
    if (from.empty()) return;
    if (from.size() != N) import.fail(what + " has a transform with a wrong number of values");
    std::copy_n(from.begin(), N, to);
}

/// One attribute of EXT_mesh_gpu_instancing over all instances.
class InstanceAttribute {
public:
    InstanceAttribute(const SceneImport& import, const tinygltf::Model& model,
        const tinygltf::Value& attributes, const char* name, int type, const std::string& what)
    {
        if (!gltfMember(attributes, name)) return;
        const int accessor = static_cast<int>(gltfNumber(attributes, name, -1));
        mView = std::make_unique<AccessorView>(import, model, accessor, type, what + " " + name);
    }
    const AccessorView* view() const { return mView.get(); }
    template <std::size_t N> void read(std::size_t instance, double (&to)[N]) const
    {
        for (std::size_t c = 0; mView && c < N; ++c) {
            to[c] = mView->value(instance, static_cast<int>(c));
        }
    }

private:
    std::unique_ptr<AccessorView> mView;
};

} // namespace

bool isFinite(const Mat4d& m)
{
    for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) {
            if (!std::isfinite(m[i][j])) return false;
        }
    }
    return true;
}

Mat4d gltfTransform(const SceneImport& import, const tinygltf::Node& node, const std::string& what)
{
    if (node.matrix.empty()) {
        Trs trs;
        read(import, node.translation, trs.translation, what);
        read(import, node.rotation, trs.rotation, what);
        read(import, node.scale, trs.scale, what);
        return compose(import, trs, what);
    }
    if (node.matrix.size() != 16) {
        import.fail(what + " has a matrix of " + std::to_string(node.matrix.size())
            + " values instead of 16");
    }
    Mat4d m;
    // Column-major with column vectors is, in memory, row-major with row vectors.
    std::memcpy(m.getValue(), node.matrix.data(), 16 * sizeof(double));
    if (m[0][3] != 0 || m[1][3] != 0 || m[2][3] != 0 || m[3][3] != 1) {
        import.fail(what + " has a matrix that is not affine");
    }
    return m;
}

std::vector<Mat4d> gltfInstances(const SceneImport& import, const tinygltf::Model& model,
    const tinygltf::Node& node, const Mat4d& toWorld, const std::string& what)
{
    const auto* extension = gltfExtension(node.extensions, "EXT_mesh_gpu_instancing");
    if (!extension) return {toWorld};
    const auto* attributes = gltfMember(*extension, "attributes");
    if (!attributes) import.fail(what + " has instances without attributes");
    const InstanceAttribute translation(
        import, model, *attributes, "TRANSLATION", TINYGLTF_TYPE_VEC3, what);
    const InstanceAttribute rotation(
        import, model, *attributes, "ROTATION", TINYGLTF_TYPE_VEC4, what);
    const InstanceAttribute scale(import, model, *attributes, "SCALE", TINYGLTF_TYPE_VEC3, what);
    const AccessorView* first = nullptr;
    for (const AccessorView* view : {translation.view(), rotation.view(), scale.view()}) {
        if (!first) first = view;
        if (view && view->count() != first->count()) {
            import.fail(what + " has instance attributes of different lengths");
        }
    }
    if (!first) return {toWorld}; // attributes of its own alone, which say nothing about places
    std::vector<Mat4d> places;
    for (std::size_t i = 0; i < first->count(); ++i) {
        Trs trs;
        translation.read(i, trs.translation);
        rotation.read(i, trs.rotation);
        scale.read(i, trs.scale);
        places.push_back(compose(import, trs, what + " instance " + std::to_string(i)) * toWorld);
        if (!isFinite(places.back())) {
            import.fail(what + " has an instance with a transform that is not finite");
        }
    }
    return places;
}

} // namespace lumivdb
