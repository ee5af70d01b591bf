// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file scene_import.h
/// What all importers share (internal to bake): collected warnings, meshes before they are placed,
/// and the checks at the end.

#include <lumivdb/bake/scene.h>

#include <cstdint>
#include <set>
#include <string>
#include <vector>

namespace lumivdb {

/// Warnings, each said once: repeated ones gather the names of the things they are about.
class WarningList {
public:
    void add(const std::string& sentence);
    /// @a item: what it is about, e.g. a material's name.
    void add(const std::string& sentence, const std::string& item);
    /// In the sequence of their first occurrence.
    std::vector<std::string> sentences() const;

private:
    struct Entry {
        std::string sentence;
        std::vector<std::string> items; ///< the first few
        std::set<std::string> seen; ///< all of them
    };
    std::vector<Entry> mEntries;
};

/// Triangles in the space of their node: one primitive of one material.
struct LocalMesh {
    std::string name;
    int material = 0;
    std::vector<Vec3d> positions;
    std::vector<std::uint32_t> sourceVertex; ///< number in the file, for messages
    std::vector<Vec2f> uv[2];
    std::vector<std::array<float, 4>> colors;
    std::vector<std::array<std::uint32_t, 3>> triangles;
    std::vector<Mat4d> places[3]; ///< to world: those that keep fronts, mirror, or flatten it
};

/// A scene while it is read.
struct SceneImport {
    std::string path; ///< as the user gave it
    Scene scene;
    WarningList warnings;
    std::vector<LocalMesh> meshes; ///< in the sequence of their first use
    std::uint64_t triangles = 0; ///< in the world so far, those of instances each time
    std::uint64_t stored = 0; ///< in the scene's meshes so far
    std::size_t degenerate = 0; ///< dropped so far
    int noMaterial = -1; ///< number of the material for geometry that has none

    /// @throws Error(Input) "PATH: what."
    [[noreturn]] void fail(const std::string& what) const;
};

/// Adds an instance of SceneImport::meshes[@a mesh].
void placeMesh(SceneImport& import, std::size_t mesh, const Mat4d& toWorld);

/// Moves all that is placed into the scene, once nothing more comes. What has one place is
/// transformed, in double precision; what has several becomes a mesh with instances, and one more
/// for the instances that mirror: their winding is turned round, so that front sides stay front
/// sides. Drops degenerate triangles.
void finishMeshes(SceneImport& import);

/// Clamps @a factor to [0, 1] with a warning: a surface that reflects more than it gets would
/// never settle.
Color clampReflectance(SceneImport& import, const Color& factor, const std::string& material);

/// Number of the material for geometry that has none (albedo 1); says so once.
int defaultMaterial(SceneImport& import, const std::string& mesh);

/// Loads the texture into the scene; −1 with a warning where @a decoded failed.
int addTexture(SceneImport& import, Texture&& texture, const struct TextureDecode& decoded,
    const std::string& name);

/// Final checks, warnings and the content hash.
void finishImport(SceneImport& import);

/// Whole file as bytes. @throws Error(Input).
std::vector<unsigned char> readFileBytes(const std::string& path);

void importGltf(SceneImport& import);
void importAssimp(SceneImport& import);

} // namespace lumivdb
