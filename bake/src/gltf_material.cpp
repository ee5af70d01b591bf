// SPDX-License-Identifier: Apache-2.0
#include "gltf_accessor.h"
#include "gltf_model.h"
#include "texture.h"

#include <cmath>
#include <filesystem>
#include <map>

namespace lumivdb {

namespace {

/// The pair of numbers @a key of a KHR_texture_transform.
std::array<double, 2> numberPair(
    const tinygltf::Value& object, const std::string& key, double fallback)
{
    std::array<double, 2> result = {fallback, fallback};
    const tinygltf::Value* list = gltfMember(object, key);
    if (!list || !list->IsArray() || list->ArrayLen() != 2) return result;
    for (int i = 0; i < 2; ++i) {
        const tinygltf::Value& v = list->Get(i);
        if (v.IsNumber()) result[static_cast<std::size_t>(i)] = v.GetNumberAsDouble();
    }
    return result;
}

/// u' = T·R·S·u. The extension's GLSL listing turns the wrong way for a v axis that points down;
/// its text, its test model and all renderers agree on this one (KhronosGroup/glTF issue 1563).
void applyTransform(const SceneImport& import, const tinygltf::Value& transform, TextureSlot& slot)
{
    const auto offset = numberPair(transform, "offset", 0.0);
    const auto scale = numberPair(transform, "scale", 1.0);
    const double angle = gltfNumber(transform, "rotation", 0.0);
    const double c = std::cos(angle), s = std::sin(angle);
    const double m[6]
        = {c * scale[0], s * scale[1], offset[0], -s * scale[0], c * scale[1], offset[1]};
    for (std::size_t i = 0; i < 6; ++i) {
        slot.transform[i] = static_cast<float>(m[i]);
        if (!std::isfinite(slot.transform[i])) import.fail("a texture transform is not finite");
    }
    slot.uvSet = static_cast<int>(gltfNumber(transform, "texCoord", slot.uvSet));
}

class MaterialReader {
public:
    MaterialReader(SceneImport& import, const tinygltf::Model& model)
        : mImport(import)
        , mModel(model)
        , mFolder(std::filesystem::u8path(import.path).parent_path())
    {
    }

    void read(const tinygltf::Material& source, bool used, Material& material);

private:
    void readBaseColor(const tinygltf::Material& source, Material& material);
    void readEmission(const tinygltf::Material& source, Material& material);
    void readAlpha(const tinygltf::Material& source, Material& material);
    void warnIgnored(const tinygltf::Material& source, const std::string& name);
    TextureSlot slot(const tinygltf::TextureInfo& info, const std::string& material);
    int texture(int index, const std::string& material);
    TextureDecode decodeImage(int index, const std::string& what, Texture& texture);

    SceneImport& mImport;
    const tinygltf::Model& mModel;
    std::filesystem::path mFolder;
    bool mUsed = true;
    std::map<int, int> mTextures; ///< glTF texture → Scene::textures
};

void MaterialReader::read(const tinygltf::Material& source, bool used, Material& material)
{
    // Textures of unused materials are not decoded: a library file may hold hundreds.
    mUsed = used;
    material.doubleSided = source.doubleSided;
    readBaseColor(source, material);
    readEmission(source, material);
    readAlpha(source, material);
    if (used) warnIgnored(source, material.name);
}

void MaterialReader::readBaseColor(const tinygltf::Material& source, Material& material)
{
    const auto& pbr = source.pbrMetallicRoughness;
    const auto& factor = pbr.baseColorFactor;
    if (factor.size() == 4) {
        const Color color(static_cast<float>(factor[0]), static_cast<float>(factor[1]),
            static_cast<float>(factor[2]));
        material.baseColor = clampReflectance(mImport, color, material.name);
        material.alphaFactor = static_cast<float>(factor[3]);
    }
    material.baseColorTexture = slot(pbr.baseColorTexture, material.name);
}

void MaterialReader::readEmission(const tinygltf::Material& source, Material& material)
{
    double strength = 1.0;
    const auto* extension = gltfExtension(source.extensions, "KHR_materials_emissive_strength");
    if (extension) strength = gltfNumber(*extension, "emissiveStrength", 1.0);
    for (std::size_t c = 0; c < 3 && c < source.emissiveFactor.size(); ++c) {
        const float value = static_cast<float>(source.emissiveFactor[c] * strength);
        if (!std::isfinite(value) || value < 0) {
            mImport.fail("material '" + material.name
                + "' has an emission that is negative or not finite; repair the material");
        }
        material.emission[static_cast<int>(c)] = value;
    }
    const bool black = material.emission == Color(0, 0, 0);
    if (!black) material.emissionTexture = slot(source.emissiveTexture, material.name);
}

void MaterialReader::readAlpha(const tinygltf::Material& source, Material& material)
{
    if (source.alphaMode == "MASK") {
        material.alphaMask = true;
        material.alphaCutoff = static_cast<float>(source.alphaCutoff);
    } else if (source.alphaMode == "BLEND") {
        material.alphaMask = true;
        material.alphaCutoff = 0.5f;
        if (mUsed) {
            mImport.warnings.add(
                "Blended materials are cut out where alpha is below 0.5", material.name);
        }
    } else if (source.alphaMode != "OPAQUE" && !source.alphaMode.empty()) {
        mImport.fail("material '" + material.name + "' has alphaMode '" + source.alphaMode
            + "', which glTF does not have");
    }
}

void MaterialReader::warnIgnored(const tinygltf::Material& source, const std::string& name)
{
    const auto& pbr = source.pbrMetallicRoughness;
    WarningList& warnings = mImport.warnings;
    if (pbr.metallicFactor > 0) {
        warnings.add("Metals reflect their base colour diffusely", name);
    }
    if (pbr.roughnessFactor < 1 || pbr.metallicRoughnessTexture.index >= 0) {
        warnings.add("Gloss (metallic-roughness) is ignored: surfaces are Lambertian", name);
    }
    if (source.normalTexture.index >= 0) warnings.add("Normal maps are ignored", name);
    if (source.occlusionTexture.index >= 0) warnings.add("Occlusion maps are ignored", name);
    for (const auto& extension : source.extensions) {
        if (extension.first == "KHR_materials_emissive_strength") continue;
        if (extension.first == "KHR_materials_unlit") {
            warnings.add("Unlit materials reflect like any other (KHR_materials_unlit)", name);
        } else {
            warnings.add("The material extension " + extension.first + " is ignored", name);
        }
    }
}

TextureSlot MaterialReader::slot(const tinygltf::TextureInfo& info, const std::string& material)
{
    TextureSlot result;
    if (info.index == -1) return result;
    checkedAt(mImport, mModel.textures, info.index, "texture", "material '" + material + "'");
    result.uvSet = info.texCoord;
    const auto* transform = gltfExtension(info.extensions, "KHR_texture_transform");
    if (transform) applyTransform(mImport, *transform, result);
    if (result.uvSet != 0 && result.uvSet != 1) {
        mImport.warnings.add(
            "Textures with a third or later set of coordinates are taken as white", material);
        return {};
    }
    if (mUsed) result.texture = texture(info.index, material);
    return result;
}

WrapMode wrapMode(int gltf)
{
    if (gltf == TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE) return WrapMode::ClampToEdge;
    if (gltf == TINYGLTF_TEXTURE_WRAP_MIRRORED_REPEAT) return WrapMode::MirroredRepeat;
    return WrapMode::Repeat;
}

int MaterialReader::texture(int index, const std::string& material)
{
    const auto known = mTextures.find(index);
    if (known != mTextures.end()) return known->second;
    const auto& source = mModel.textures[static_cast<std::size_t>(index)];
    const std::string what = "texture " + gltfLabel(source.name, index);
    Texture result;
    if (source.sampler >= 0) {
        const auto& sampler = checkedAt(mImport, mModel.samplers, source.sampler, "sampler", what);
        result.wrapU = wrapMode(sampler.wrapS);
        result.wrapV = wrapMode(sampler.wrapT);
        result.nearest = sampler.magFilter == TINYGLTF_TEXTURE_FILTER_NEAREST;
    }
    int image = source.source;
    const auto* webp = gltfExtension(source.extensions, "EXT_texture_webp");
    if (webp) image = static_cast<int>(gltfNumber(*webp, "source", image));
    TextureDecode decoded;
    decoded.reason = "it has no image";
    std::string label = what + " of " + material;
    if (image != -1) {
        const auto& used = checkedAt(mImport, mModel.images, image, "image", what);
        if (!used.uri.empty()) label = decodeUri(used.uri);
        decoded = decodeImage(image, what, result);
    }
    return mTextures[index] = addTexture(mImport, std::move(result), decoded, label);
}

TextureDecode MaterialReader::decodeImage(int index, const std::string& what, Texture& texture)
{
    const auto& image = mModel.images[static_cast<std::size_t>(index)];
    if (image.bufferView >= 0) {
        const ByteRange bytes = bufferViewBytes(mImport, mModel, image.bufferView, what);
        return decodeTexture(bytes.begin, bytes.size, texture);
    }
    if (!image.uri.empty()) {
        const auto file = mFolder / std::filesystem::u8path(decodeUri(image.uri));
        std::error_code status;
        if (!std::filesystem::is_regular_file(file, status)) {
            TextureDecode missing;
            missing.reason = "there is no such file";
            return missing;
        }
        return decodeTextureFile(file.u8string(), texture);
    }
    return decodeTexture(image.image.data(), image.image.size(), texture);
}

} // namespace

void readGltfMaterials(SceneImport& import, const tinygltf::Model& model)
{
    std::vector<bool> used(import.scene.materials.size(), false);
    for (const Mesh& mesh : import.scene.meshes) {
        used[static_cast<std::size_t>(mesh.material)] = true;
    }
    MaterialReader reader(import, model);
    for (std::size_t i = 0; i < model.materials.size(); ++i) {
        Material& material = import.scene.materials[i];
        const std::string& name = model.materials[i].name;
        material.name = name.empty() ? "material " + std::to_string(i) : name;
        reader.read(model.materials[i], used[i], material);
    }
}

} // namespace lumivdb
