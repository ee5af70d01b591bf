// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file scene_fixture.h
/// Small glTF files made in the tests.

#include <lumivdb/bake/scene.h>

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace scene_test {

/// A folder of its own that goes away with the object.
class TempFolder {
public:
    TempFolder();
    ~TempFolder();
    std::string path(const std::string& name) const;
    /// Writes the file and returns its path.
    std::string write(const std::string& name, const std::string& bytes) const;

private:
    std::filesystem::path mFolder;
};

std::string base64(const std::string& bytes);

/// PNG bytes of 8-bit pixels.
std::string png(int width, int height, int channels, const std::vector<std::uint8_t>& pixels);

/// Bytes of an image of 16-bit (png) or float (exr) RGB pixels given as floats.
std::string encodeImage(
    const std::string& extension, int width, int height, const std::vector<float>& pixels);

template <typename T> std::string bytesOf(const std::vector<T>& values)
{
    return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}

/// Collects buffer views and accessors of one buffer.
class GltfBuilder {
public:
    int view(const std::string& bytes, int stride = 0);
    int accessor(int bufferView, int componentType, int count, const std::string& type,
        const std::string& more = "");
    int vec3(const std::vector<float>& values); ///< float VEC3 accessor
    int vec2(const std::vector<float>& values);
    int indices(const std::vector<std::uint16_t>& values);

    /// The file; @a rest are further top-level members, e.g. "\"nodes\":[{\"mesh\":0}]".
    std::string gltf(const std::string& rest) const;
    std::string glb(const std::string& rest) const;

private:
    std::string arrays() const;
    std::string mBytes;
    std::vector<std::string> mViews;
    std::vector<std::string> mAccessors;
};

std::string glbFile(const std::string& json, const std::string& bin);

/// (0,0,0) (1,0,0) (0,1,0): normal +Z.
extern const std::vector<float> kTriangle;

/// A file with that triangle as mesh 0 (positions are accessor 0; @a attributes adds more) in
/// node 0 of scene 0; @a rest as in GltfBuilder.
std::string triangleGltf(GltfBuilder& builder, const std::string& primitive = "",
    const std::string& rest = "", const std::string& node = "\"mesh\":0");

/// Loads glTF text.
lumivdb::Scene load(const TempFolder& folder, const std::string& text);

/// How many warnings contain @a text.
int countWarnings(const lumivdb::Scene& scene, const std::string& text);

/// Geometric normal of a triangle, not normalised.
lumivdb::Vec3d normalOf(const lumivdb::Mesh& mesh, std::size_t triangle);

} // namespace scene_test
