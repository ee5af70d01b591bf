// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/scene.h>

#include "scene_import.h"

#include <lumivdb/bake/environment.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <new>
#include <set>

namespace lumivdb {

namespace {

/// Streams numbers into one 64-bit hash. Every list is preceded by its length, so that moving a
/// value from one list to the next changes the result.
class ContentHasher {
public:
    template <typename T> void value(const T& v) { bytes(&v, sizeof(T)); }

    template <typename T> void list(const std::vector<T>& v)
    {
        mHash = hashCombine(mHash, v.size());
        if (!v.empty()) bytes(v.data(), v.size() * sizeof(T));
    }

    void bytes(const void* data, std::size_t size)
    {
        const auto* p = static_cast<const unsigned char*>(data);
        for (; size >= 8; p += 8, size -= 8) {
            std::uint64_t word;
            std::memcpy(&word, p, 8);
            mHash = hashCombine(mHash, word);
        }
        if (size == 0) return;
        std::uint64_t tail = 0;
        std::memcpy(&tail, p, size);
        mHash = hashCombine(mHash, tail);
    }

    std::string hex() const
    {
        std::string result(16, '0');
        for (std::size_t i = 0; i < 16; ++i) {
            result[15 - i] = "0123456789abcdef"[(mHash >> (4 * i)) & 15];
        }
        return result;
    }

private:
    std::uint64_t mHash = mixBits(1);
};

void hashSlot(ContentHasher& hasher, const TextureSlot& slot)
{
    hasher.value(slot.texture);
    if (slot.texture < 0) return; // nothing else of it is looked at
    hasher.value(slot.uvSet);
    hasher.value(slot.transform);
}

void hashMaterial(ContentHasher& hasher, const Material& material)
{
    hasher.value(material.baseColor);
    hashSlot(hasher, material.baseColorTexture);
    hasher.value(material.emission);
    hashSlot(hasher, material.emissionTexture);
    hasher.value(int(material.alphaMask));
    hasher.value(material.alphaFactor);
    hasher.value(material.alphaCutoff);
    hasher.value(int(material.doubleSided));
    hasher.value(int(material.emitsFrontOnly));
}

void hashMesh(ContentHasher& hasher, const Mesh& mesh)
{
    hasher.value(mesh.material);
    hasher.list(mesh.positions);
    hasher.list(mesh.uv[0]);
    hasher.list(mesh.uv[1]);
    hasher.list(mesh.colors);
    hasher.list(mesh.triangles);
    if (!mesh.instances.empty()) hasher.list(mesh.instances);
}

void hashTexture(ContentHasher& hasher, const Texture& texture)
{
    hasher.value(texture.width);
    hasher.value(texture.height);
    hasher.value(int(texture.wrapU));
    hasher.value(int(texture.wrapV));
    hasher.value(int(texture.nearest));
    hasher.list(texture.pixels);
}

void hashLight(ContentHasher& hasher, const Light& light)
{
    hasher.value(int(light.type));
    hasher.value(light.intensity);
    hasher.value(light.position);
    hasher.value(light.direction);
    hasher.value(light.range);
    hasher.value(light.innerConeAngle);
    hasher.value(light.outerConeAngle);
}

bool emits(const Material& m) { return m.emission.x > 0 || m.emission.y > 0 || m.emission.z > 0; }

std::set<std::string> lightGroups(const Scene& scene)
{
    std::set<std::string> groups;
    for (const Light& light : scene.lights) {
        groups.insert(light.name);
        groups.insert(light.nodeName);
    }
    for (const Material& material : scene.materials) {
        if (emits(material)) groups.insert(material.name);
    }
    if (scene.environment) groups.insert("environment");
    groups.erase("");
    return groups;
}

/// Whether all corners of @a inner, placed by @a m, lie in @a outer.
bool contains(const Box3d& outer, const Box3d& inner, const Mat4d& m)
{
    for (int corner = 0; corner < 8; ++corner) {
        const Vec3d p(corner & 1 ? inner.max.x : inner.min.x,
            corner & 2 ? inner.max.y : inner.min.y, corner & 4 ? inner.max.z : inner.min.z);
        if (!outer.intersects(transformAffine(m, p))) return false;
    }
    return true;
}

void extendByMesh(const Mesh& mesh, Box3d& box)
{
    Box3d own; // in the mesh's space
    for (const auto& triangle : mesh.triangles) {
        for (const std::uint32_t v : triangle) own.extendBy(mesh.positions[v]);
    }
    if (mesh.instances.empty()) box.extendBy(own);
    for (std::size_t use = 0; use < mesh.instances.size(); ++use) {
        if (own.isEmpty() || contains(box, own, mesh.instances[use])) continue;
        for (const auto& triangle : mesh.triangles) {
            for (const std::uint32_t v : triangle) box.extendBy(mesh.worldPosition(use, v));
        }
    }
}

std::string lowerExtension(const std::string& path)
{
    std::string extension = std::filesystem::u8path(path).extension().u8string();
    for (char& c : extension) {
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    }
    return extension;
}

} // namespace

Box3d Scene::bounds() const
{
    // One vertex of each instance first: then most of them lie within the box as they are, and
    // only those at its border are walked through.
    Box3d box;
    for (const Mesh& mesh : meshes) {
        if (mesh.triangles.empty()) continue;
        for (std::size_t use = 0; use < mesh.instances.size(); ++use) {
            box.extendBy(mesh.worldPosition(use, mesh.triangles[0][0]));
        }
    }
    for (const Mesh& mesh : meshes) extendByMesh(mesh, box);
    return box;
}

std::uint64_t Scene::triangleCount() const
{
    std::uint64_t count = 0;
    for (const Mesh& mesh : meshes) count += mesh.triangles.size() * std::uint64_t(mesh.uses());
    return count;
}

Scene loadScene(const std::string& path)
{
    SceneImport import;
    import.path = path;
    try {
        const std::string extension = lowerExtension(path);
        if (extension == ".gltf" || extension == ".glb") {
            importGltf(import);
        } else {
            importAssimp(import);
        }
        finishImport(import);
    } catch (const std::bad_alloc&) {
        import.fail("it needs more memory than there is");
    } catch (const std::length_error&) {
        import.fail("it needs more memory than there is");
    }
    return std::move(import.scene);
}

void updateContentHash(Scene& scene)
{
    ContentHasher hasher;
    hasher.value(std::uint64_t(scene.meshes.size()));
    for (const Mesh& mesh : scene.meshes) hashMesh(hasher, mesh);
    hasher.value(std::uint64_t(scene.materials.size()));
    for (const Material& material : scene.materials) hashMaterial(hasher, material);
    hasher.value(std::uint64_t(scene.textures.size()));
    for (const Texture& texture : scene.textures) hashTexture(hasher, texture);
    hasher.value(std::uint64_t(scene.lights.size()));
    for (const Light& light : scene.lights) hashLight(hasher, light);
    hasher.value(scene.environment ? scene.environment->contentHash() : std::uint64_t(0));
    scene.contentHash = hasher.hex();
}

void selectLightGroup(Scene& scene, const std::string& name)
{
    const std::set<std::string> groups = lightGroups(scene);
    if (groups.count(name) == 0) {
        std::string known;
        for (const std::string& group : groups)
            known += (known.empty() ? "'" : ", '") + group + "'";
        throw Error(ErrorCode::Usage,
            "There is no light group '" + name + "'; "
                + (known.empty() ? "nothing in the scene emits light." : "choose " + known + "."));
    }
    for (Light& light : scene.lights) {
        if (light.name != name && light.nodeName != name) light.intensity = Color(0, 0, 0);
    }
    for (Material& material : scene.materials) {
        if (material.name == name) continue;
        material.emission = Color(0, 0, 0);
        material.emissionTexture = TextureSlot();
    }
    if (name != "environment") scene.environment = nullptr;
    updateContentHash(scene);
}

} // namespace lumivdb
