// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file scene.h
/// A static scene as the bake sees it: Lambertian triangles, textures, emitters and lights.
///
/// Right-handed, +Y up (glTF). All radiometric values are scene-linear RGB in the units of the
/// file, without conversion: emission is radiance; a point or spot light of I candela gives
/// E = I/d²; a directional light of E lux gives E on a surface facing it.

#include <lumivdb/core/types.h>

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace lumivdb {

class Environment; // environment.h

enum class WrapMode { Repeat, MirroredRepeat, ClampToEdge };

/// A decoded image. Colour data is decoded from sRGB *before* it is filtered.
struct Texture {
    int width = 0;
    int height = 0;
    /// Linear RGBA, row 0 on top, 4 floats a pixel; alpha is never gamma-decoded.
    std::vector<float> pixels;
    WrapMode wrapU = WrapMode::Repeat;
    WrapMode wrapV = WrapMode::Repeat;
    bool nearest = false; ///< magnification filter NEAREST

    /// Bilinear (or nearest) look-up at texture coordinates (glTF: v grows downwards).
    std::array<float, 4> sample(float u, float v) const;
};

/// A texture slot of a material: which texture, which UV set, KHR_texture_transform.
struct TextureSlot {
    int texture = -1; ///< index into Scene::textures, −1: none
    int uvSet = 0; ///< 0 or 1
    /// u' = m[0] u + m[1] v + m[2]; v' = m[3] u + m[4] v + m[5]
    std::array<float, 6> transform = {1, 0, 0, 0, 1, 0};
};

struct Material {
    std::string name;
    Color baseColor{1, 1, 1}; ///< linear reflectance factor; 1 where there is no material
    TextureSlot baseColorTexture;
    Color emission{0, 0, 0}; ///< radiance: emissiveFactor × emissive strength
    TextureSlot emissionTexture; ///< multiplies emission
    bool alphaMask = false; ///< alphaMode MASK (BLEND is treated so too, with a warning)
    float alphaFactor = 1.0f; ///< baseColorFactor.a
    float alphaCutoff = 0.5f;
    bool doubleSided = false; ///< reflects and emits on both sides
    /// Emits on its front alone even where it is double-sided, as the area lights of many renderers
    /// do. No file says so: the caller sets it.
    bool emitsFrontOnly = false;
};

/// @a p (row vector) times an affine matrix.
inline Vec3d transformAffine(const Mat4d& m, const Vec3d& p)
{
    return {p.x * m[0][0] + p.y * m[1][0] + p.z * m[2][0] + m[3][0],
        p.x * m[0][1] + p.y * m[1][1] + p.z * m[2][1] + m[3][1],
        p.x * m[0][2] + p.y * m[1][2] + p.z * m[2][2] + m[3][2]};
}

/// Indexed triangles of one material, in world space or, where the mesh has instances, in a space
/// of its own that they place in the world.
struct Mesh {
    std::string name;
    int material = 0;
    std::vector<Vec3d> positions; ///< world units; in the mesh's own space where it has instances
    std::vector<Vec2f> uv[2]; ///< empty or one per position
    std::vector<std::array<float, 4>> colors; ///< linear RGBA, empty or one per position
    /// Counter-clockwise seen from the front, in the world: an instance that mirrors turns the
    /// fronts round, so importers keep a mesh with turned triangles for those.
    std::vector<std::array<std::uint32_t, 3>> triangles;
    /// Own space to world, affine, row vectors; empty: the mesh is there once, in world space.
    std::vector<Mat4d> instances;

    /// How many times the mesh is in the world.
    std::size_t uses() const { return instances.empty() ? 1 : instances.size(); }
    /// Where instance @a use < uses() has its vertex.
    Vec3d worldPosition(std::size_t use, std::size_t vertex) const
    {
        return instances.empty() ? positions[vertex]
                                 : transformAffine(instances[use], positions[vertex]);
    }
};

enum class LightType { Point, Spot, Directional };

/// KHR_lights_punctual.
struct Light {
    std::string name;
    LightType type = LightType::Point;
    Color intensity{1, 1, 1}; ///< colour × intensity: candela (point, spot) or lux (directional)
    Vec3d position{0, 0, 0}; ///< world
    Vec3d direction{0, 0, -1}; ///< unit, the way the light travels (node's −Z)
    double range = 0; ///< 0: infinite; else glTF's recommended window
    double innerConeAngle = 0; ///< radians
    double outerConeAngle = 0.78539816339744830962;
    std::string nodeName; ///< of the node it hangs on, "" where that has none
};

struct Camera {
    Mat4d cameraToWorld; ///< looks along −Z, +Y up; row vectors
    double yfov = 0.8; ///< radians
};

struct Scene {
    std::vector<Mesh> meshes;
    std::vector<Material> materials; ///< never empty once loaded
    std::vector<Texture> textures;
    std::vector<Light> lights;
    std::vector<Camera> cameras;
    std::shared_ptr<const Environment> environment; ///< null: black surroundings
    /// What was ignored or repaired, one sentence each, each said once.
    std::vector<std::string> warnings;
    /// 64-bit content hash of everything above that affects light, 16 hex digits.
    std::string contentHash;

    Box3d bounds() const; ///< of all triangles; empty where there is none
    std::uint64_t triangleCount() const; ///< in the world: those of an instance count each time
};

/// Reads glTF 2.0 (.gltf, .glb) and what Assimp reads (.obj first).
///
/// glTF: textures (embedded, data URI or file), alpha mask, KHR_materials_emissive_strength,
/// KHR_materials_unlit (said as a warning), KHR_lights_punctual, KHR_texture_transform, node
/// hierarchies, vertex colours, both UV sets, sparse accessors, all primitive modes
/// that make triangles. A mesh that several nodes share (or EXT_mesh_gpu_instancing repeats) is
/// kept once, with instances. Mirrored instances keep their front sides. What is ignored is listed
/// in Scene::warnings. Degenerate triangles are dropped with a warning that counts them.
/// @throws Error(Input) for: file missing or unreadable, not parseable, an index or buffer out of
/// range, non-finite positions or transforms (naming mesh and vertex), a required extension that is
/// not known. A missing texture is a warning; its slot is white.
Scene loadScene(const std::string& path);

/// Recomputes Scene::contentHash (the environment's hash included).
void updateContentHash(Scene& scene);

/// Keeps only the light of group @a name: punctual lights (by light or node name), emissive
/// materials (by material name), or the environment ("environment"). Everything else stays in the
/// scene as a black emitter. @throws Error(Usage) naming the groups there are.
void selectLightGroup(Scene& scene, const std::string& name);

} // namespace lumivdb
