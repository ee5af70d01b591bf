// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file gltf_model.h
/// tinygltf as the importer uses it (internal to bake), and the pieces of the glTF importer.
///
/// tinygltf is used for the JSON only: images are decoded by OpenImageIO, and nothing that it
/// returns is trusted to be in range.

#include "scene_import.h"

#define TINYGLTF_NO_STB_IMAGE
#define TINYGLTF_NO_STB_IMAGE_WRITE
#include <tiny_gltf.h>

#include <string>
#include <vector>

namespace lumivdb {

/// Parses the file into @a model: container, JSON and buffers; images stay encoded.
/// @throws Error(Input).
void readGltfModel(const SceneImport& import, tinygltf::Model& model);

/// Refuses required extensions that are not known, warns about used ones that are ignored.
void checkGltfExtensions(SceneImport& import, const tinygltf::Model& model);

/// The primitives of a mesh that make triangles, in the space of its node.
std::vector<LocalMesh> readGltfMesh(SceneImport& import, const tinygltf::Model& model, int mesh);

bool isFinite(const Mat4d& m);

/// Node to parent, row vectors. @a what names the node. @throws Error(Input).
Mat4d gltfTransform(const SceneImport& import, const tinygltf::Node& node, const std::string& what);

/// Where the mesh of @a node is in the world: @a toWorld, or that after each of the transforms of
/// EXT_mesh_gpu_instancing. @throws Error(Input).
std::vector<Mat4d> gltfInstances(const SceneImport& import, const tinygltf::Model& model,
    const tinygltf::Node& node, const Mat4d& toWorld, const std::string& what);

/// Fills Scene::materials[0 … n) from the file, and Scene::textures with what those that a mesh
/// uses need.
void readGltfMaterials(SceneImport& import, const tinygltf::Model& model);

/// @a list[index] or Error(Input) that says @a what asked for it.
template <typename T>
const T& checkedAt(const SceneImport& import, const std::vector<T>& list, int index,
    const char* kind, const std::string& what)
{
    if (index < 0 || static_cast<std::size_t>(index) >= list.size()) {
        import.fail(what + " refers to " + kind + " " + std::to_string(index) + ", but there are "
            + std::to_string(list.size()));
    }
    return list[static_cast<std::size_t>(index)];
}

/// "'name'", or "3" where it has none.
std::string gltfLabel(const std::string& name, int index);

/// Member @a key of a JSON object, null where there is none (or it is no object).
const tinygltf::Value* gltfMember(const tinygltf::Value& object, const std::string& key);

/// The extension @a name, null where there is none.
const tinygltf::Value* gltfExtension(
    const tinygltf::ExtensionMap& extensions, const std::string& name);

/// Number @a key of a JSON object or @a fallback where it is missing or not a finite number.
double gltfNumber(const tinygltf::Value& object, const std::string& key, double fallback);

/// Percent-decodes a URI ("my%20file.png").
std::string decodeUri(const std::string& uri);

} // namespace lumivdb
