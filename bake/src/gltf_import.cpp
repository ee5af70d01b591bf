// SPDX-License-Identifier: Apache-2.0
#include "gltf_model.h"

#include <algorithm>
#include <cmath>
#include <map>

namespace lumivdb {

namespace {

constexpr double kHalfPi = 1.57079632679489661923;

Vec3d axis(const Mat4d& m, int row) { return {m[row][0], m[row][1], m[row][2]}; }

class NodeWalker {
public:
    NodeWalker(SceneImport& import, const tinygltf::Model& model)
        : mImport(import)
        , mModel(model)
        , mVisited(model.nodes.size(), false)
    {
    }

    /// Places all that hangs on @a roots.
    void walk(const std::vector<int>& roots);

private:
    struct Pending {
        int node;
        Mat4d parentToWorld;
    };
    void visit(int index, const Mat4d& parentToWorld, std::vector<Pending>& pending);
    /// The primitives of a mesh of the file in SceneImport::meshes.
    struct MeshRange {
        std::size_t first, last;
    };
    MeshRange meshRange(int mesh);
    void place(int index, const Mat4d& toWorld, const std::string& what);
    void placeLight(const tinygltf::Node& node, const Mat4d& toWorld, const std::string& what);
    void placeCamera(int camera, const Mat4d& toWorld, const std::string& what);

    SceneImport& mImport;
    const tinygltf::Model& mModel;
    std::vector<bool> mVisited;
    std::map<int, MeshRange> mMeshes; ///< read once, placed per instance
};

void NodeWalker::walk(const std::vector<int>& roots)
{
    // A stack of its own, because a hostile chain of nodes may be a million deep.
    std::vector<Pending> pending;
    for (auto root = roots.rbegin(); root != roots.rend(); ++root) {
        pending.push_back({*root, Mat4d()});
    }
    while (!pending.empty()) {
        const Pending next = pending.back();
        pending.pop_back();
        visit(next.node, next.parentToWorld, pending);
    }
}

void NodeWalker::visit(int index, const Mat4d& parentToWorld, std::vector<Pending>& pending)
{
    const auto& node = checkedAt(mImport, mModel.nodes, index, "node", "the scene");
    const std::string what = "node " + gltfLabel(node.name, index);
    if (mVisited[static_cast<std::size_t>(index)]) {
        mImport.fail(what + " has two parents or is its own ancestor, so the hierarchy is no tree");
    }
    mVisited[static_cast<std::size_t>(index)] = true;
    const Mat4d toWorld = gltfTransform(mImport, node, what) * parentToWorld;
    if (!isFinite(toWorld)) mImport.fail(what + " has a transform that is not finite");
    place(index, toWorld, what);
    for (auto child = node.children.rbegin(); child != node.children.rend(); ++child) {
        pending.push_back({*child, toWorld});
    }
}

void NodeWalker::place(int index, const Mat4d& toWorld, const std::string& what)
{
    const auto& node = mModel.nodes[static_cast<std::size_t>(index)];
    if (node.mesh >= 0) {
        checkedAt(mImport, mModel.meshes, node.mesh, "mesh", what);
        const MeshRange range = meshRange(node.mesh);
        for (const Mat4d& place : gltfInstances(mImport, mModel, node, toWorld, what)) {
            for (std::size_t m = range.first; m < range.last; ++m) placeMesh(mImport, m, place);
        }
        if (node.skin >= 0) {
            mImport.warnings.add("Skins are ignored (static pose)", what.substr(5));
        }
    }
    placeLight(node, toWorld, what);
    if (node.camera >= 0) placeCamera(node.camera, toWorld, what);
}

NodeWalker::MeshRange NodeWalker::meshRange(int mesh)
{
    const auto known = mMeshes.find(mesh);
    if (known != mMeshes.end()) return known->second;
    MeshRange range{mImport.meshes.size(), 0};
    for (LocalMesh& local : readGltfMesh(mImport, mModel, mesh)) {
        mImport.meshes.push_back(std::move(local));
    }
    range.last = mImport.meshes.size();
    return mMeshes[mesh] = range;
}

LightType lightType(const SceneImport& import, const std::string& type, const std::string& what)
{
    if (type == "point") return LightType::Point;
    if (type == "spot") return LightType::Spot;
    if (type != "directional") import.fail(what + " has the unknown type '" + type + "'");
    return LightType::Directional;
}

Color lightIntensity(
    const SceneImport& import, const tinygltf::Light& source, const std::string& what)
{
    Color result(1, 1, 1);
    if (!source.color.empty() && source.color.size() != 3) {
        import.fail(what + " has a colour of " + std::to_string(source.color.size()) + " values");
    }
    for (std::size_t c = 0; c < 3; ++c) {
        const double color = source.color.empty() ? 1.0 : source.color[c];
        const float value = static_cast<float>(color * source.intensity);
        if (!std::isfinite(value) || value < 0) {
            import.fail(what + " has an intensity that is negative or not finite");
        }
        result[static_cast<int>(c)] = value;
    }
    return result;
}

void NodeWalker::placeLight(
    const tinygltf::Node& node, const Mat4d& toWorld, const std::string& what)
{
    const auto* extension = gltfExtension(node.extensions, "KHR_lights_punctual");
    if (!extension) return;
    const int index = static_cast<int>(gltfNumber(*extension, "light", -1));
    const auto& source = checkedAt(mImport, mModel.lights, index, "light", what);
    const std::string label = "light " + gltfLabel(source.name, index);
    Light light;
    light.name = !source.name.empty() ? source.name : node.name;
    if (light.name.empty()) light.name = "light " + std::to_string(index);
    light.nodeName = node.name;
    light.type = lightType(mImport, source.type, label);
    light.intensity = lightIntensity(mImport, source, label);
    light.position = axis(toWorld, 3);
    const Vec3d direction = -axis(toWorld, 2);
    if (!(direction.length() > 0)) mImport.fail(what + " has a light but scales to zero");
    light.direction = direction / direction.length();
    if (!(source.range >= 0)) mImport.fail(label + " has a negative range");
    light.range = light.type == LightType::Directional ? 0 : source.range;
    if (light.type == LightType::Spot) {
        light.innerConeAngle = source.spot.innerConeAngle;
        light.outerConeAngle = source.spot.outerConeAngle;
        // π/2 written with few digits is still π/2.
        if (!(light.innerConeAngle >= 0 && light.innerConeAngle <= light.outerConeAngle
                && light.outerConeAngle <= kHalfPi + 1e-5)) {
            mImport.fail(label + " needs cone angles 0 ≤ inner ≤ outer ≤ π/2");
        }
    }
    mImport.scene.lights.push_back(std::move(light));
}

void NodeWalker::placeCamera(int index, const Mat4d& toWorld, const std::string& what)
{
    const auto& source = checkedAt(mImport, mModel.cameras, index, "camera", what);
    if (source.type != "perspective") {
        mImport.warnings.add("Orthographic cameras are ignored", what);
        return;
    }
    Camera camera;
    camera.yfov = source.perspective.yfov;
    // Axes without the scale of the hierarchy; +Y stays up where a node mirrors.
    const Vec3d z = axis(toWorld, 2).normalized();
    const Vec3d x = axis(toWorld, 1).cross(z).normalized();
    const Vec3d y = z.cross(x);
    if (!(x.length() > 0.5) || !(camera.yfov > 0 && camera.yfov < 2 * kHalfPi)) {
        mImport.warnings.add("Cameras without a usable frame or field of view are ignored", what);
        return;
    }
    for (int j = 0; j < 3; ++j) {
        camera.cameraToWorld[0][j] = x[j];
        camera.cameraToWorld[1][j] = y[j];
        camera.cameraToWorld[2][j] = z[j];
        camera.cameraToWorld[3][j] = toWorld[3][j];
    }
    mImport.scene.cameras.push_back(camera);
}

/// Root nodes of the scene to load; all root nodes where the file has no scene.
std::vector<int> rootNodes(SceneImport& import, const tinygltf::Model& model)
{
    if (!model.scenes.empty()) {
        const int index = model.defaultScene < 0 ? 0 : model.defaultScene;
        const auto& scene = checkedAt(import, model.scenes, index, "scene", "the file");
        if (model.scenes.size() > 1) {
            import.warnings.add("Of " + std::to_string(model.scenes.size())
                + " scenes in the file only one is loaded: " + gltfLabel(scene.name, index));
        }
        return scene.nodes;
    }
    std::vector<bool> isChild(model.nodes.size(), false);
    for (const auto& node : model.nodes) {
        for (const int child : node.children) {
            checkedAt(import, model.nodes, child, "node", "a node");
            isChild[static_cast<std::size_t>(child)] = true;
        }
    }
    std::vector<int> roots;
    for (std::size_t i = 0; i < model.nodes.size(); ++i) {
        if (!isChild[i]) roots.push_back(static_cast<int>(i));
    }
    return roots;
}

} // namespace

void importGltf(SceneImport& import)
{
    tinygltf::Model model;
    readGltfModel(import, model);
    checkGltfExtensions(import, model);
    if (!model.animations.empty()) {
        import.warnings.add(
            std::to_string(model.animations.size()) + " animations are ignored (static pose)");
    }
    // Materials come first in number, so that meshes can refer to them, and last in reading, when
    // it is known which are used.
    import.scene.materials.resize(model.materials.size());
    NodeWalker(import, model).walk(rootNodes(import, model));
    finishMeshes(import);
    readGltfMaterials(import, model);
}

} // namespace lumivdb
