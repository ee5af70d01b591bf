// SPDX-License-Identifier: Apache-2.0
#include "gltf_accessor.h"
#include "gltf_model.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lumivdb {

namespace {

constexpr std::uint32_t kUnused = std::numeric_limits<std::uint32_t>::max();

using Triangle = std::array<std::uint32_t, 3>;

/// The vertex numbers that the primitive draws, in sequence.
std::vector<std::uint32_t> drawnVertices(const SceneImport& import, const tinygltf::Model& model,
    const tinygltf::Primitive& primitive, std::size_t vertexCount, const std::string& what)
{
    std::vector<std::uint32_t> result;
    if (primitive.indices < 0) {
        if (vertexCount >= kUnused) import.fail(what + " has too many vertices");
        result.resize(vertexCount);
        for (std::size_t i = 0; i < vertexCount; ++i) result[i] = static_cast<std::uint32_t>(i);
        return result;
    }
    const AccessorView view(
        import, model, primitive.indices, TINYGLTF_TYPE_SCALAR, what + " indices");
    if (view.componentType() != TINYGLTF_COMPONENT_TYPE_UNSIGNED_BYTE
        && view.componentType() != TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT
        && view.componentType() != TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT) {
        import.fail(what + " has indices that are not unsigned integers");
    }
    result.reserve(view.count());
    for (std::size_t i = 0; i < view.count(); ++i) {
        const std::uint32_t v = view.index(i);
        if (v >= vertexCount) {
            import.fail(what + ": index " + std::to_string(i) + " names vertex " + std::to_string(v)
                + ", but there are " + std::to_string(vertexCount));
        }
        result.push_back(v);
    }
    return result;
}

/// Corners of each triangle as positions in the drawn sequence (glTF 2.0, section 3.7.2.1).
std::vector<Triangle> assemble(int mode, std::uint32_t n)
{
    std::vector<Triangle> result;
    if (n < 3) return result;
    if (mode == TINYGLTF_MODE_TRIANGLES) {
        for (std::uint32_t i = 0; i + 2 < n; i += 3) result.push_back({i, i + 1, i + 2});
    } else if (mode == TINYGLTF_MODE_TRIANGLE_STRIP) {
        for (std::uint32_t i = 0; i + 2 < n; ++i) {
            result.push_back({i, i + 1 + i % 2, i + 2 - i % 2});
        }
    } else {
        for (std::uint32_t i = 1; i + 1 < n; ++i) result.push_back({i, i + 1, 0});
    }
    return result;
}

/// An optional attribute with as many elements as POSITION; null where there is none.
std::unique_ptr<AccessorView> attribute(const SceneImport& import, const tinygltf::Model& model,
    const tinygltf::Primitive& primitive, const char* name, int type, std::size_t vertexCount,
    const std::string& what)
{
    const auto it = primitive.attributes.find(name);
    if (it == primitive.attributes.end()) return nullptr;
    const std::string label = what + " " + name;
    auto view = std::make_unique<AccessorView>(import, model, it->second, type, label);
    if (view->count() != vertexCount) {
        import.fail(label + " has " + std::to_string(view->count()) + " elements for "
            + std::to_string(vertexCount) + " vertices");
    }
    return view;
}

void readPositions(
    const SceneImport& import, const AccessorView& view, LocalMesh& mesh, const std::string& what)
{
    mesh.positions.reserve(mesh.sourceVertex.size());
    for (const std::uint32_t v : mesh.sourceVertex) {
        const Vec3d p(view.value(v, 0), view.value(v, 1), view.value(v, 2));
        if (!std::isfinite(p.x) || !std::isfinite(p.y) || !std::isfinite(p.z)) {
            import.fail(what + " vertex " + std::to_string(v)
                + " has a position that is not finite; repair the mesh");
        }
        mesh.positions.push_back(p);
    }
}

/// Finite, or 0 with a warning: a wrong colour is no reason to refuse a scene.
float tolerated(SceneImport& import, double value, const std::string& what)
{
    const float v = static_cast<float>(value);
    if (std::isfinite(v)) return v;
    import.warnings.add("Texture coordinates or vertex colours that are not finite become 0", what);
    return 0.0f;
}

void readColors(
    SceneImport& import, const AccessorView& view, LocalMesh& mesh, const std::string& what)
{
    mesh.colors.reserve(mesh.sourceVertex.size());
    for (const std::uint32_t v : mesh.sourceVertex) {
        std::array<float, 4> color = {1, 1, 1, 1};
        for (int c = 0; c < view.components(); ++c) {
            const float value = tolerated(import, view.value(v, c), what);
            color[static_cast<std::size_t>(c)] = std::clamp(value, 0.0f, 1.0f);
            if (value < 0.0f || value > 1.0f) {
                import.warnings.add("Vertex colours outside 0…1 are clamped", what);
            }
        }
        mesh.colors.push_back(color);
    }
}

/// Keeps the vertices that triangles use, in the sequence of the file: many primitives may share
/// one large set of vertices.
void compact(LocalMesh& mesh, const std::vector<std::uint32_t>& drawn, std::size_t vertexCount)
{
    std::vector<std::uint32_t> number(vertexCount, kUnused);
    for (const Triangle& t : mesh.triangles) {
        for (const std::uint32_t corner : t) number[drawn[corner]] = 0;
    }
    for (std::size_t v = 0; v < vertexCount; ++v) {
        if (number[v] == kUnused) continue;
        number[v] = static_cast<std::uint32_t>(mesh.sourceVertex.size());
        mesh.sourceVertex.push_back(static_cast<std::uint32_t>(v));
    }
    for (Triangle& t : mesh.triangles) {
        for (std::uint32_t& corner : t) corner = number[drawn[corner]];
    }
}

void readAttributes(SceneImport& import, const tinygltf::Model& model,
    const tinygltf::Primitive& primitive, std::size_t vertexCount, const std::string& what,
    LocalMesh& mesh)
{
    const char* uvNames[2] = {"TEXCOORD_0", "TEXCOORD_1"};
    for (int set = 0; set < 2; ++set) {
        const auto uv = attribute(
            import, model, primitive, uvNames[set], TINYGLTF_TYPE_VEC2, vertexCount, what);
        if (!uv) continue;
        mesh.uv[set].reserve(mesh.sourceVertex.size());
        for (const std::uint32_t v : mesh.sourceVertex) {
            const float s = tolerated(import, uv->value(v, 0), what);
            const float t = tolerated(import, uv->value(v, 1), what);
            mesh.uv[set].emplace_back(s, t);
        }
    }
    const auto colors = attribute(import, model, primitive, "COLOR_0", -1, vertexCount, what);
    if (colors) readColors(import, *colors, mesh, what);
}

/// False where the primitive draws no triangles.
bool readPrimitive(SceneImport& import, const tinygltf::Model& model,
    const tinygltf::Primitive& primitive, const std::string& what, LocalMesh& mesh)
{
    if (primitive.mode < TINYGLTF_MODE_POINTS || primitive.mode > TINYGLTF_MODE_TRIANGLE_FAN) {
        import.fail(
            what + " has mode " + std::to_string(primitive.mode) + ", which glTF does not have");
    }
    if (primitive.mode < TINYGLTF_MODE_TRIANGLES) {
        import.warnings.add("Points and lines are skipped", what);
        return false;
    }
    const auto position = primitive.attributes.find("POSITION");
    if (position == primitive.attributes.end()) {
        import.warnings.add("Primitives without positions are skipped", what);
        return false;
    }
    if (!primitive.targets.empty()) {
        import.warnings.add("Morph targets are ignored (static pose)", what);
    }
    const AccessorView view(
        import, model, position->second, TINYGLTF_TYPE_VEC3, what + " POSITION");
    const auto drawn = drawnVertices(import, model, primitive, view.count(), what);
    if (drawn.size() >= kUnused) import.fail(what + " draws too many vertices");
    if (primitive.mode == TINYGLTF_MODE_TRIANGLES && drawn.size() % 3 != 0) {
        import.warnings.add("Incomplete last triangles are ignored", what);
    }
    mesh.triangles = assemble(primitive.mode, static_cast<std::uint32_t>(drawn.size()));
    compact(mesh, drawn, view.count());
    readPositions(import, view, mesh, what);
    readAttributes(import, model, primitive, view.count(), what, mesh);
    return true;
}

} // namespace

std::vector<LocalMesh> readGltfMesh(SceneImport& import, const tinygltf::Model& model, int mesh)
{
    const auto& source = model.meshes[static_cast<std::size_t>(mesh)];
    std::vector<LocalMesh> result;
    for (std::size_t i = 0; i < source.primitives.size(); ++i) {
        const auto& primitive = source.primitives[i];
        const std::string what
            = "mesh " + gltfLabel(source.name, mesh) + " primitive " + std::to_string(i);
        LocalMesh local;
        local.name = source.name.empty() ? "mesh " + std::to_string(mesh) : source.name;
        if (source.primitives.size() > 1) local.name += "/" + std::to_string(i);
        if (primitive.material >= 0) {
            checkedAt(import, model.materials, primitive.material, "material", what);
            local.material = primitive.material;
        }
        if (!readPrimitive(import, model, primitive, what, local)) continue;
        if (primitive.material < 0) local.material = defaultMaterial(import, local.name);
        result.push_back(std::move(local));
    }
    return result;
}

} // namespace lumivdb
