// SPDX-License-Identifier: Apache-2.0
#include "scene_import.h"
#include "texture.h"

#include <assimp/DefaultIOSystem.h>
#include <assimp/Importer.hpp>
#include <assimp/material.h>
#include <assimp/postprocess.h>
#include <assimp/scene.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>

namespace lumivdb {

namespace {

/// Remembers which companion files were not there: Assimp only logs it.
class CompanionFiles : public Assimp::DefaultIOSystem {
public:
    Assimp::IOStream* Open(const char* file, const char* mode) override
    {
        // Opening a pipe would wait for a writer for ever.
        std::error_code unknown;
        const bool regular = std::filesystem::is_regular_file(file, unknown);
        Assimp::IOStream* stream = regular ? Assimp::DefaultIOSystem::Open(file, mode) : nullptr;
        if (!stream) missing.emplace_back(file);
        return stream;
    }
    std::vector<std::string> missing;
};

std::string text(const aiString& s) { return {s.data, s.length}; }

Mat4d toMatrix(const aiMatrix4x4& m)
{
    // Assimp multiplies column vectors: transpose.
    Mat4d result;
    const ai_real* p = &m.a1;
    for (int row = 0; row < 4; ++row) {
        for (int column = 0; column < 4; ++column) {
            result[column][row] = static_cast<double>(p[row * 4 + column]);
        }
    }
    return result;
}

class AssimpReader {
public:
    AssimpReader(SceneImport& import, const aiScene& source, bool materialsMissing)
        : mImport(import)
        , mSource(source)
        , mMaterialsMissing(materialsMissing)
        , mFolder(std::filesystem::u8path(import.path).parent_path())
    {
    }
    void read();

private:
    void walkNodes();
    std::size_t localMesh(unsigned index);
    void readVertices(const aiMesh& source, LocalMesh& mesh);
    void readFaces(const aiMesh& source, LocalMesh& mesh);
    void readMaterial(const aiMaterial& source, bool used, Material& material);
    TextureSlot slot(const aiMaterial& source, aiTextureType type);
    int texture(const std::string& name, WrapMode wrapU, WrapMode wrapV);
    TextureDecode decode(const std::string& name, Texture& texture);
    void warnIgnored(const aiMaterial& source, const std::string& name);
    bool isNoMaterial(const aiMaterial& source) const;

    SceneImport& mImport;
    const aiScene& mSource;
    bool mMaterialsMissing;
    std::filesystem::path mFolder;
    std::map<unsigned, std::size_t> mMeshes; ///< into SceneImport::meshes
    std::map<std::string, int> mTextures;
};

void AssimpReader::read()
{
    auto& materials = mImport.scene.materials;
    materials.resize(mSource.mNumMaterials);
    for (unsigned i = 0; i < mSource.mNumMaterials; ++i) {
        materials[i].name = text(mSource.mMaterials[i]->GetName());
        if (materials[i].name.empty()) materials[i].name = "material " + std::to_string(i);
    }
    walkNodes();
    finishMeshes(mImport);
    // Assimp finds an empty scene in any bytes at all.
    if (mImport.scene.meshes.empty())
        mImport.fail("it holds no triangles; check that it is a scene");
    std::vector<bool> used(materials.size(), false);
    for (const Mesh& mesh : mImport.scene.meshes) {
        used[static_cast<std::size_t>(mesh.material)] = true;
    }
    for (unsigned i = 0; i < mSource.mNumMaterials; ++i) {
        readMaterial(*mSource.mMaterials[i], used[i], materials[i]);
    }
    if (mSource.mNumLights > 0) {
        mImport.warnings.add(std::to_string(mSource.mNumLights)
            + " lights of the file are ignored: only glTF lights have defined units");
    }
    if (mSource.mNumAnimations > 0) mImport.warnings.add("Animations are ignored (static pose)");
}

void AssimpReader::walkNodes()
{
    struct Pending {
        const aiNode* node;
        Mat4d parentToWorld;
    };
    std::vector<Pending> pending;
    if (mSource.mRootNode) pending.push_back({mSource.mRootNode, Mat4d()});
    while (!pending.empty()) {
        const Pending next = pending.back();
        pending.pop_back();
        const aiNode& node = *next.node;
        const Mat4d toWorld = toMatrix(node.mTransformation) * next.parentToWorld;
        for (unsigned i = 0; i < node.mNumMeshes; ++i) {
            if (node.mMeshes[i] >= mSource.mNumMeshes) {
                mImport.fail("node '" + text(node.mName) + "' refers to a mesh that is not there");
            }
            placeMesh(mImport, localMesh(node.mMeshes[i]), toWorld);
        }
        for (unsigned i = node.mNumChildren; i-- > 0;) {
            pending.push_back({node.mChildren[i], toWorld});
        }
    }
}

std::size_t AssimpReader::localMesh(unsigned index)
{
    const auto known = mMeshes.find(index);
    if (known != mMeshes.end()) return known->second;
    const aiMesh& source = *mSource.mMeshes[index];
    LocalMesh mesh;
    mesh.name = text(source.mName);
    if (mesh.name.empty()) mesh.name = "mesh " + std::to_string(index);
    if (source.mMaterialIndex >= mSource.mNumMaterials) {
        mImport.fail("mesh '" + mesh.name + "' refers to a material that is not there");
    }
    mesh.material = isNoMaterial(*mSource.mMaterials[source.mMaterialIndex])
        ? defaultMaterial(mImport, mesh.name)
        : static_cast<int>(source.mMaterialIndex);
    readVertices(source, mesh);
    readFaces(source, mesh);
    if (source.mNumBones > 0) mImport.warnings.add("Skins are ignored (static pose)", mesh.name);
    mImport.meshes.push_back(std::move(mesh));
    return mMeshes[index] = mImport.meshes.size() - 1;
}

void AssimpReader::readVertices(const aiMesh& source, LocalMesh& mesh)
{
    for (unsigned v = 0; v < source.mNumVertices; ++v) {
        const aiVector3D& p = source.mVertices[v];
        mesh.positions.emplace_back(double(p.x), double(p.y), double(p.z));
        mesh.sourceVertex.push_back(v);
        for (unsigned set = 0; set < 2; ++set) {
            if (!source.HasTextureCoords(set)) continue;
            const aiVector3D& uv = source.mTextureCoords[set][v];
            // Assimp's v grows upwards.
            const Vec2f flipped(uv.x, 1.0f - uv.y);
            const bool finite = std::isfinite(flipped.x) && std::isfinite(flipped.y);
            mesh.uv[set].push_back(finite ? flipped : Vec2f(0, 0));
        }
        if (!source.HasVertexColors(0)) continue;
        std::array<float, 4> color;
        for (unsigned c = 0; c < 4; ++c) {
            const float value = source.mColors[0][v][c];
            color[c] = value > 0.0f ? std::min(value, 1.0f) : 0.0f; // NaN becomes 0
        }
        mesh.colors.push_back(color);
    }
}

void AssimpReader::readFaces(const aiMesh& source, LocalMesh& mesh)
{
    for (unsigned f = 0; f < source.mNumFaces; ++f) {
        const aiFace& face = source.mFaces[f];
        if (face.mNumIndices != 3) {
            mImport.warnings.add("Points and lines are skipped", mesh.name);
            continue;
        }
        for (unsigned corner = 0; corner < 3; ++corner) {
            if (face.mIndices[corner] >= source.mNumVertices) {
                mImport.fail("mesh '" + mesh.name + "' face " + std::to_string(f) + " names vertex "
                    + std::to_string(face.mIndices[corner]) + ", which is not there");
            }
        }
        mesh.triangles.push_back({face.mIndices[0], face.mIndices[1], face.mIndices[2]});
    }
}

/// Assimp invents a grey (0.6) where there is no material, or where the library was not found.
bool AssimpReader::isNoMaterial(const aiMaterial& source) const
{
    if (text(source.GetName()) == AI_DEFAULT_MATERIAL_NAME) return true;
    if (!mMaterialsMissing || source.GetTextureCount(aiTextureType_DIFFUSE) > 0) return false;
    aiColor3D diffuse(0.6f, 0.6f, 0.6f);
    source.Get(AI_MATKEY_COLOR_DIFFUSE, diffuse);
    return diffuse == aiColor3D(0.6f, 0.6f, 0.6f);
}

Color colorOf(
    const aiMaterial& source, const char* key, unsigned type, unsigned index, const Color& fallback)
{
    aiColor3D c;
    if (source.Get(key, type, index, c) != aiReturn_SUCCESS) return fallback;
    return {static_cast<float>(c.r), static_cast<float>(c.g), static_cast<float>(c.b)};
}

void AssimpReader::readMaterial(const aiMaterial& source, bool used, Material& material)
{
    const Color kd = colorOf(source, AI_MATKEY_COLOR_DIFFUSE, Color(1, 1, 1));
    material.baseColor = clampReflectance(mImport, kd, material.name);
    material.emission = colorOf(source, AI_MATKEY_COLOR_EMISSIVE, Color(0, 0, 0));
    for (int c = 0; c < 3; ++c) {
        if (!std::isfinite(material.emission[c]) || material.emission[c] < 0) {
            mImport.fail("material '" + material.name
                + "' has an emission that is negative or not finite; repair the material");
        }
    }
    int twoSided = 0;
    source.Get(AI_MATKEY_TWOSIDED, twoSided);
    material.doubleSided = twoSided != 0;
    if (!used) return;
    material.baseColorTexture = slot(source, aiTextureType_DIFFUSE);
    material.emissionTexture = slot(source, aiTextureType_EMISSIVE);
    // "map_Ke" without "Ke" is common and means the texture as it is.
    if (material.emissionTexture.texture >= 0 && material.emission == Color(0, 0, 0)) {
        material.emission = Color(1, 1, 1);
    }
    float opacity = 1.0f;
    source.Get(AI_MATKEY_OPACITY, opacity);
    if (opacity < 1.0f) {
        material.alphaMask = true;
        material.alphaFactor = opacity;
        mImport.warnings.add(
            "Blended materials are cut out where alpha is below 0.5", material.name);
    }
    warnIgnored(source, material.name);
}

void AssimpReader::warnIgnored(const aiMaterial& source, const std::string& name)
{
    const Color specular = colorOf(source, AI_MATKEY_COLOR_SPECULAR, Color(0, 0, 0));
    if (specular != Color(0, 0, 0) || source.GetTextureCount(aiTextureType_SPECULAR) > 0) {
        mImport.warnings.add("Gloss (specular) is ignored: surfaces are Lambertian", name);
    }
    if (source.GetTextureCount(aiTextureType_NORMALS) > 0
        || source.GetTextureCount(aiTextureType_HEIGHT) > 0) {
        mImport.warnings.add("Normal and bump maps are ignored", name);
    }
    if (source.GetTextureCount(aiTextureType_OPACITY) > 0) {
        mImport.warnings.add("Opacity maps (map_d) are ignored: use the alpha of the colour", name);
    }
}

WrapMode wrapMode(int assimp)
{
    if (assimp == aiTextureMapMode_Clamp || assimp == aiTextureMapMode_Decal) {
        return WrapMode::ClampToEdge;
    }
    return assimp == aiTextureMapMode_Mirror ? WrapMode::MirroredRepeat : WrapMode::Repeat;
}

TextureSlot AssimpReader::slot(const aiMaterial& source, aiTextureType type)
{
    TextureSlot result;
    aiString name;
    if (source.GetTexture(type, 0, &name) != aiReturn_SUCCESS) return result;
    int wrapU = aiTextureMapMode_Wrap, wrapV = aiTextureMapMode_Wrap, set = 0;
    source.Get(AI_MATKEY_MAPPINGMODE_U(type, 0), wrapU);
    source.Get(AI_MATKEY_MAPPINGMODE_V(type, 0), wrapV);
    source.Get(AI_MATKEY_UVWSRC(type, 0), set);
    result.uvSet = set == 1 ? 1 : 0;
    result.texture = texture(text(name), wrapMode(wrapU), wrapMode(wrapV));
    return result;
}

int AssimpReader::texture(const std::string& name, WrapMode wrapU, WrapMode wrapV)
{
    const std::string key = name + "\n" + std::to_string(int(wrapU)) + std::to_string(int(wrapV));
    const auto known = mTextures.find(key);
    if (known != mTextures.end()) return known->second;
    Texture result;
    result.wrapU = wrapU;
    result.wrapV = wrapV;
    const TextureDecode decoded = decode(name, result);
    return mTextures[key] = addTexture(mImport, std::move(result), decoded, name);
}

TextureDecode AssimpReader::decode(const std::string& name, Texture& texture)
{
    TextureDecode failed;
    const aiTexture* embedded = mSource.GetEmbeddedTexture(name.c_str());
    if (embedded && embedded->mHeight == 0) {
        return decodeTexture(
            reinterpret_cast<const unsigned char*>(embedded->pcData), embedded->mWidth, texture);
    }
    if (embedded) {
        failed.reason = "it is embedded without compression";
        return failed;
    }
    std::string relative = name;
    std::replace(relative.begin(), relative.end(), '\\', '/');
    const auto file = mFolder / std::filesystem::u8path(relative);
    std::error_code status;
    if (!std::filesystem::is_regular_file(file, status)) {
        failed.reason = "there is no such file";
        return failed;
    }
    return decodeTextureFile(file.u8string(), texture);
}

} // namespace

void importAssimp(SceneImport& import)
{
    std::error_code status;
    const auto file = std::filesystem::u8path(import.path);
    if (!std::filesystem::exists(file, status)) {
        import.fail("there is no such file; check the path");
    }
    if (!std::filesystem::is_regular_file(file, status)) {
        import.fail("it is not a file; name a scene file");
    }
    Assimp::Importer importer;
    auto* files = new CompanionFiles; // the importer owns it
    importer.SetIOHandler(files);
    // Nothing that joins, splits or moves triangles; polygons become triangles.
    const aiScene* scene = importer.ReadFile(import.path, aiProcess_Triangulate);
    if (!scene || (scene->mFlags & AI_SCENE_FLAGS_INCOMPLETE) != 0) {
        const std::string why = importer.GetErrorString();
        import.fail("it cannot be read" + (why.empty() ? std::string() : ": " + why)
            + "; glTF and OBJ are the formats that are tested");
    }
    for (const std::string& name : files->missing) {
        import.warnings.add("Files that the scene refers to are missing",
            std::filesystem::u8path(name).filename().u8string());
    }
    AssimpReader(import, *scene, !files->missing.empty()).read();
}

} // namespace lumivdb
