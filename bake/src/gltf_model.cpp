// SPDX-License-Identifier: Apache-2.0
#include "gltf_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <sstream>

namespace lumivdb {

namespace {

/// tinygltf walks "extras" and "extensions" recursively: deeper JSON could exhaust its stack.
constexpr int kMaxJsonDepth = 200;

// Extensions that change what the importer reads.
constexpr std::array<const char*, 7> kSupportedExtensions = {"KHR_lights_punctual",
    "KHR_texture_transform", "KHR_materials_emissive_strength", "KHR_materials_unlit",
    "KHR_mesh_quantization", "EXT_mesh_gpu_instancing", "EXT_texture_webp"};

// Extensions that a Lambertian scene can do without; each material that has one is warned about.
constexpr std::array<const char*, 13> kIgnorableExtensions = {"KHR_materials_anisotropy",
    "KHR_materials_clearcoat", "KHR_materials_dispersion", "KHR_materials_ior",
    "KHR_materials_iridescence", "KHR_materials_sheen", "KHR_materials_specular",
    "KHR_materials_transmission", "KHR_materials_diffuse_transmission", "KHR_materials_variants",
    "KHR_materials_volume", "KHR_animation_pointer", "KHR_xmp_json_ld"};

template <typename List> bool contains(const List& list, const std::string& name)
{
    return std::find(list.begin(), list.end(), name) != list.end();
}

bool fileExists(const std::string& path, void*)
{
    std::error_code status;
    const std::filesystem::path file = std::filesystem::u8path(path);
    return std::filesystem::is_regular_file(file, status)
        && std::filesystem::file_size(file, status) > 0 && !status;
}

/// File names are names, not shell words.
std::string keepPath(const std::string& path, void*) { return path; }

bool readWholeFile(
    std::vector<unsigned char>* out, std::string* error, const std::string& path, void*)
{
    try {
        *out = readFileBytes(path);
        return !out->empty();
    } catch (const std::exception& e) {
        if (error) *error += e.what();
        return false;
    }
}

bool writeNothing(std::string*, const std::string&, const std::vector<unsigned char>&, void*)
{
    return false;
}

/// Keeps the encoded bytes of data URIs. Files and buffer views are read later: the pointer that
/// comes for a buffer view is not checked against the buffer's size.
bool keepImageBytes(tinygltf::Image* image, const int, std::string*, std::string*, int, int,
    const unsigned char* bytes, int size, void*)
{
    if (image->bufferView < 0 && image->uri.empty() && size > 0) {
        image->image.assign(bytes, bytes + size);
    }
    return true;
}

void checkJsonDepth(const SceneImport& import, const unsigned char* json, std::size_t size)
{
    int depth = 0;
    bool inString = false;
    for (std::size_t i = 0; i < size; ++i) {
        const unsigned char c = json[i];
        if (inString) {
            if (c == '\\') ++i;
            if (c == '"') inString = false;
        } else if (c == '"') {
            inString = true;
        } else if (c == '[' || c == '{') {
            if (++depth > kMaxJsonDepth) import.fail("its JSON is nested too deeply");
        } else if (c == ']' || c == '}') {
            --depth;
        }
    }
}

std::uint32_t word(const std::vector<unsigned char>& bytes, std::size_t at)
{
    return std::uint32_t(bytes[at]) | std::uint32_t(bytes[at + 1]) << 8
        | std::uint32_t(bytes[at + 2]) << 16 | std::uint32_t(bytes[at + 3]) << 24;
}

/// Checks the GLB header and chunk sizes (glTF 2.0 specification, section 4).
void checkGlb(const SceneImport& import, const std::vector<unsigned char>& bytes)
{
    if (bytes.size() < 20) import.fail("it is cut off inside the GLB header");
    if (word(bytes, 4) != 2) {
        import.fail("it is GLB version " + std::to_string(word(bytes, 4)) + "; convert it to 2");
    }
    const std::uint64_t length = word(bytes, 8);
    if (length > bytes.size() || length < 20) {
        import.fail("it should have " + std::to_string(length) + " bytes but has "
            + std::to_string(bytes.size()) + "; it may be cut off");
    }
    const std::uint64_t jsonEnd = 20 + std::uint64_t(word(bytes, 12));
    if (word(bytes, 16) != 0x4E4F534A || jsonEnd > length) { // "JSON"
        import.fail("its first GLB chunk is not JSON inside the file");
    }
    if (jsonEnd < length) {
        if (jsonEnd + 8 > length || jsonEnd + 8 + word(bytes, std::size_t(jsonEnd)) > length) {
            import.fail("its second GLB chunk reaches beyond the file");
        }
    }
    checkJsonDepth(import, bytes.data() + 20, std::size_t(jsonEnd - 20));
}

/// What remains of tinygltf's complaints about a file that it did read. Skins and animations are
/// ignored anyway, and a missing padding harms nobody.
std::string relevantComplaints(const std::string& text)
{
    std::istringstream lines(text);
    std::string result;
    for (std::string line; std::getline(lines, line);) {
        const bool irrelevant = line.empty() || line.find("Skin") != std::string::npos
            || line.find("nimation") != std::string::npos
            || line.find("'node' property") != std::string::npos
            || line.find("'path' property") != std::string::npos
            || line.find("4-byte boundary") != std::string::npos;
        if (irrelevant) continue;
        result += (result.empty() ? "" : "; ") + line;
    }
    while (!result.empty() && (result.back() == '.' || result.back() == ' ')) result.pop_back();
    return result;
}

void checkVersion(const SceneImport& import, const tinygltf::Asset& asset)
{
    const std::string& needed = asset.minVersion.empty() ? asset.version : asset.minVersion;
    if (asset.version.compare(0, 2, "2.") != 0 || (!asset.minVersion.empty() && needed != "2.0")) {
        import.fail("it is glTF " + needed + "; convert it to glTF 2.0");
    }
}

bool parse(const std::vector<unsigned char>& bytes, bool binary, const std::string& folder,
    tinygltf::Model& model, std::string& error)
{
    tinygltf::TinyGLTF loader;
    std::string warning; // repeats what later checks say more precisely
    loader.SetImageLoader(keepImageBytes, nullptr);
    loader.SetFsCallbacks({fileExists, keepPath, readWholeFile, writeNothing, nullptr});
    const auto size = static_cast<unsigned>(bytes.size());
    if (binary) {
        return loader.LoadBinaryFromMemory(&model, &error, &warning, bytes.data(), size, folder);
    }
    return loader.LoadASCIIFromString(
        &model, &error, &warning, reinterpret_cast<const char*>(bytes.data()), size, folder);
}

} // namespace

void readGltfModel(const SceneImport& import, tinygltf::Model& model)
{
    const std::vector<unsigned char> bytes = readFileBytes(import.path);
    if (bytes.empty()) import.fail("it is empty");
    if (bytes.size() > 0xffffffffull) import.fail("it is larger than 4 GiB; split it");
    const bool binary = bytes.size() >= 4 && std::memcmp(bytes.data(), "glTF", 4) == 0;
    if (binary) {
        checkGlb(import, bytes);
    } else {
        checkJsonDepth(import, bytes.data(), bytes.size());
    }
    std::string error;
    bool ok = false;
    try {
        const auto folder = std::filesystem::u8path(import.path).parent_path().u8string();
        ok = parse(bytes, binary, folder, model, error);
    } catch (const std::bad_alloc&) {
        throw;
    } catch (const std::exception& e) {
        error += e.what();
    }
    const std::string complaints = relevantComplaints(error);
    if (!ok || !complaints.empty()) {
        import.fail("it is not valid glTF"
            + (complaints.empty() ? std::string() : ": " + complaints)
            + "; check it with a glTF validator");
    }
    checkVersion(import, model.asset);
}

void checkGltfExtensions(SceneImport& import, const tinygltf::Model& model)
{
    for (const std::string& name : model.extensionsRequired) {
        if (contains(kSupportedExtensions, name) || contains(kIgnorableExtensions, name)) continue;
        const bool compressed
            = name == "KHR_draco_mesh_compression" || name == "EXT_meshopt_compression";
        import.fail("it requires the extension " + name + ", which is not supported; "
            + (compressed ? "export it without mesh compression" : "export it without that"));
    }
    for (const std::string& name : model.extensionsUsed) {
        // Material extensions are reported with the materials that have them.
        if (contains(kSupportedExtensions, name) || name.rfind("KHR_materials_", 0) == 0) continue;
        import.warnings.add("Extensions of the file are ignored", name);
    }
}

std::string gltfLabel(const std::string& name, int index)
{
    return name.empty() ? std::to_string(index) : "'" + name + "'";
}

const tinygltf::Value* gltfMember(const tinygltf::Value& object, const std::string& key)
{
    if (!object.IsObject() || !object.Has(key)) return nullptr;
    return &object.Get(key);
}

const tinygltf::Value* gltfExtension(
    const tinygltf::ExtensionMap& extensions, const std::string& name)
{
    const auto it = extensions.find(name);
    return it == extensions.end() ? nullptr : &it->second;
}

double gltfNumber(const tinygltf::Value& object, const std::string& key, double fallback)
{
    const tinygltf::Value* value = gltfMember(object, key);
    if (!value || !value->IsNumber()) return fallback;
    const double number = value->GetNumberAsDouble();
    return std::isfinite(number) ? number : fallback;
}

std::string decodeUri(const std::string& uri)
{
    const auto digit = [](char c) {
        if (c >= '0' && c <= '9') return c - '0';
        if (c >= 'a' && c <= 'f') return c - 'a' + 10;
        return c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
    };
    std::string result;
    for (std::size_t i = 0; i < uri.size(); ++i) {
        const bool escape = uri[i] == '%' && i + 2 < uri.size() && digit(uri[i + 1]) >= 0
            && digit(uri[i + 2]) >= 0;
        result += escape ? static_cast<char>(digit(uri[i + 1]) * 16 + digit(uri[i + 2])) : uri[i];
        if (escape) i += 2;
    }
    return result;
}

} // namespace lumivdb
