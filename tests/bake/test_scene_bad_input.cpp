// SPDX-License-Identifier: Apache-2.0
#include "scene_fixture.h"

#include <lumivdb/core/error.h>

#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <sstream>

using namespace lumivdb;
using namespace scene_test;

namespace {

struct BadFile {
    const char* what;
    std::string name;
    std::string bytes;
    const char* says; ///< part of the message
};

const std::string kAsset = R"("asset":{"version":"2.0"})";

/// The triangle with its accessor 0 replaced by @a accessor and top-level @a more.
std::string withAccessor(
    const std::string& accessor, const std::string& more = "", const std::string& primitive = "")
{
    return "{" + kAsset + R"(,"buffers":[{"byteLength":36,"uri":"data:application/octet-stream;)"
        + "base64," + base64(bytesOf(kTriangle))
        + R"("}],"bufferViews":[{"buffer":0,"byteLength":36},
        {"buffer":0,"byteOffset":32,"byteLength":36},{"buffer":7,"byteLength":36}],
        "accessors":[)"
        + accessor + R"(],"meshes":[{"name":"tri","primitives":[{"attributes":
        {"POSITION":0})"
        + primitive + R"(}]}],"nodes":[{"mesh":0}])" + more + "}";
}

std::string accessor(int view, const std::string& count, const std::string& more = "")
{
    return R"({"bufferView":)" + std::to_string(view) + R"(,"componentType":5126,"type":"VEC3",)"
        + R"("count":)" + count + more + "}";
}

/// A triangle whose primitive, node, or file is given.
std::string triangle(const std::string& primitive, const std::string& rest = "",
    const std::string& node = "\"mesh\":0")
{
    GltfBuilder b;
    return triangleGltf(b, primitive, rest, node);
}

std::string indexed(const std::vector<std::uint16_t>& indices)
{
    GltfBuilder b;
    b.indices(indices);
    return triangleGltf(b, R"("indices":0)");
}

std::string nanVertex()
{
    GltfBuilder b;
    b.vec3({0, 0, 0, 1, std::nanf(""), 0, 0, 1, 0});
    return b.gltf(R"("meshes":[{"name":"wall","primitives":[{"attributes":{"POSITION":0}}]}],
        "nodes":[{"mesh":0}])");
}

std::string sparse(const std::string& count, std::uint8_t index, int valueView)
{
    GltfBuilder b;
    const int base = b.view(bytesOf(kTriangle));
    const int at = b.view(std::string(1, static_cast<char>(index)));
    const int views[2] = {base, at};
    b.accessor(base, 5126, 3, "VEC3",
        R"("sparse":{"count":)" + count + R"(,"indices":{"bufferView":)" + std::to_string(at)
            + R"(,"componentType":5121},"values":{"bufferView":)" + std::to_string(views[valueView])
            + "}}");
    return b.gltf(R"("meshes":[{"name":"tri","primitives":[{"attributes":{"POSITION":0}}]}],
        "nodes":[{"mesh":0}])");
}

std::string light(const std::string& members)
{
    GltfBuilder b;
    return b.gltf(R"("extensions":{"KHR_lights_punctual":{"lights":[{)" + members + R"(}]}},
        "nodes":[{"extensions":{"KHR_lights_punctual":{"light":0}}}])");
}

std::string deepJson()
{
    const std::size_t depth = 100000;
    return "{" + kAsset + R"(,"extras":)" + std::string(depth, '[') + std::string(depth, ']') + "}";
}

std::vector<BadFile> badContainers()
{
    const std::string json = "{" + kAsset + "}";
    const std::string glb = glbFile(json, "0123");
    std::string version1 = glb, wrongLength = glb, wrongChunk = glb, longChunk = glb;
    version1[4] = 1;
    wrongLength[8] = 127;
    wrongChunk[16] = 'X';
    longChunk[13] = 1;
    return {
        {"empty file", "a.gltf", "", "empty"},
        {"empty GLB", "a.glb", "", "empty"},
        {"not JSON", "a.gltf", "hello", "not valid glTF"},
        {"JSON cut off", "a.gltf", json.substr(0, 20), "not valid glTF"},
        {"no object", "a.gltf", "[1,2,3]", "not valid glTF"},
        {"no asset", "a.gltf", "{\"nodes\":[]}", "not valid glTF"},
        {"glTF 1.0", "a.gltf", R"({"asset":{"version":"1.0"}})", "glTF 1.0"},
        {"minVersion", "a.gltf", R"({"asset":{"version":"2.0","minVersion":"2.1"}})", "2.1"},
        {"number too large", "a.gltf", "{" + kAsset + ",\"nodes\":[{\"scale\":[1e999,1,1]}]}",
            "not valid glTF"},
        {"nested too deeply", "a.gltf", deepJson(), "nested too deeply"},
        {"GLB header only", "a.glb", glb.substr(0, 12), "cut off"},
        {"GLB version", "a.glb", version1, "version 1"},
        {"GLB length", "a.glb", wrongLength, "should have 127 bytes"},
        {"GLB chunk type", "a.glb", wrongChunk, "not JSON"},
        {"GLB chunk length", "a.glb", longChunk, "not JSON inside the file"},
        {"GLB without its last byte", "a.glb", glb.substr(0, glb.size() - 1), "cut off"},
        {"OBJ without content", "a.obj", "", "cannot be read"},
        {"unknown format", "a.xyzzy", "what is this", "cannot be read"},
        {"no extension", "scene", "what is this", "cannot be read"},
    };
}

std::vector<BadFile> badBuffers()
{
    const std::string start = "{" + kAsset + ",";
    return {
        {"buffer file missing", "a.gltf", start + R"("buffers":[{"byteLength":4,"uri":"no.bin"}]})",
            "no.bin"},
        {"buffer shorter than it says", "a.gltf",
            start + R"("buffers":[{"byteLength":400,"uri":"data:application/octet-stream;base64,)"
                + base64("abcd") + "\"}]}",
            "not valid glTF"},
        {"empty buffer in GLB", "a.glb",
            glbFile(start + R"("buffers":[{"byteLength":0}]})", "abcd"), "not valid glTF"},
        {"buffer longer than the chunk", "a.glb",
            glbFile(start + R"("buffers":[{"byteLength":99}]})", "abcd"), "not valid glTF"},
        {"view beyond buffer", "a.gltf", withAccessor(accessor(1, "3")), "beyond buffer"},
        {"view of no buffer", "a.gltf", withAccessor(accessor(2, "3")), "buffer 7"},
        {"accessor of no view", "a.gltf", withAccessor(accessor(5, "3")), "bufferView 5"},
        {"accessor beyond view", "a.gltf", withAccessor(accessor(0, "4")), "beyond bufferView"},
        {"count that overflows", "a.gltf", withAccessor(accessor(0, "1537228672809129302")),
            "beyond bufferView"},
        {"offset beyond view", "a.gltf",
            withAccessor(accessor(0, "3", ",\"byteOffset\":18446744073709551615")),
            "beyond bufferView"},
        {"zeros without end", "a.gltf",
            withAccessor(R"({"componentType":5126,"type":"VEC3","count":99999999999})"),
            "without data"},
        {"wrong accessor type", "a.gltf",
            withAccessor(R"({"bufferView":0,"componentType":5126,"type":"VEC2","count":3})"),
            "not VEC3"},
        {"double components", "a.gltf",
            withAccessor(R"({"bufferView":0,"componentType":5130,"type":"VEC3","count":1})"),
            "5130"},
        {"unknown components", "a.gltf",
            withAccessor(R"({"bufferView":0,"componentType":77,"type":"VEC3","count":1})"), "77"},
        {"sparse index out of range", "a.gltf", sparse("1", 3, 0), "sparse index 3"},
        {"sparse count", "a.gltf", sparse("4", 0, 0), "replaces 4 of 3"},
        {"sparse values too short", "a.gltf", sparse("1", 0, 1), "sparse data beyond"},
    };
}

std::vector<BadFile> badScenes()
{
    return {
        {"NaN vertex", "a.gltf", nanVertex(), "mesh 'wall' primitive 0 vertex 1"},
        {"index out of range", "a.gltf", indexed({0, 1, 3}),
            "mesh 'tri' primitive 0: index 2 names vertex 3"},
        {"indices of no accessor", "a.gltf", triangle(R"("indices":9)"), "not valid glTF"},
        {"indices as floats", "a.gltf", triangle(R"("indices":0)"), "indices"},
        {"attribute of no accessor", "a.gltf", triangle(R"(attributes:"TEXCOORD_0":-5)"),
            "TEXCOORD_0"},
        {"attribute of wrong type", "a.gltf", triangle(R"(attributes:"TEXCOORD_0":0)"), "not VEC2"},
        {"unknown mode", "a.gltf", triangle(R"("mode":7)"), "mode 7"},
        {"no such material", "a.gltf", triangle(R"("material":2)"), "material 2"},
        {"primitive without attributes", "a.gltf",
            "{" + kAsset + R"(,"meshes":[{"primitives":[{}]}],"nodes":[{"mesh":0}]})",
            "not valid glTF"},
        {"no such mesh", "a.gltf", triangle("", "", R"("mesh":4)"), "mesh 4"},
        {"no such child", "a.gltf", triangle("", "", R"("mesh":0,"children":[3])"), "node 3"},
        {"negative child", "a.gltf", triangle("", "", R"("mesh":0,"children":[-1])"), "node -1"},
        {"node is its own child", "a.gltf", triangle("", "", R"("mesh":0,"children":[0])"),
            "no tree"},
        {"node twice in the scene", "a.gltf",
            "{" + kAsset + R"(,"nodes":[{"name":"n"}],"scenes":[{"nodes":[0,0]}]})", "'n'"},
        {"no such scene", "a.gltf", "{" + kAsset + R"(,"scenes":[{}],"scene":3})", "scene 3"},
        {"matrix of 15", "a.gltf",
            triangle("", "", R"("mesh":0,"matrix":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0])"), "15"},
        {"projective matrix", "a.gltf",
            triangle("", "", R"("mesh":0,"matrix":[1,0,0,1,0,1,0,0,0,0,1,0,0,0,0,1])"),
            "not affine"},
        {"scale of 2", "a.gltf", triangle("", "", R"("mesh":0,"scale":[1,2])"), "wrong number"},
        {"rotation of length 0", "a.gltf", triangle("", "", R"("mesh":0,"rotation":[0,0,0,0])"),
            "length 0"},
        {"transform beyond float", "a.gltf", triangle("", "", R"("mesh":0,"scale":[1e300,1,1])"),
            "mesh 'tri' vertex 1"},
        {"unknown required extension", "a.gltf",
            triangle("", R"("extensionsRequired":["EXT_odd"])"), "EXT_odd"},
        {"compressed meshes", "a.gltf",
            triangle("", R"("extensionsRequired":["KHR_draco_mesh_compression"])"),
            "without mesh compression"},
        {"alphaMode", "a.gltf",
            triangle(R"("material":0)", R"("materials":[{"name":"m","alphaMode":"MAYBE"}])"),
            "'MAYBE'"},
        {"negative emission", "a.gltf",
            triangle(R"("material":0)", R"("materials":[{"name":"m","emissiveFactor":[-1,0,0]}])"),
            "'m'"},
        {"three factors", "a.gltf",
            triangle(R"("material":0)",
                R"("materials":[{"pbrMetallicRoughness":{"baseColorFactor":[1,1,1]}}])"),
            "baseColorFactor"},
        {"no such texture", "a.gltf",
            triangle(R"("material":0)",
                R"("materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":3}}}])"),
            "texture 3"},
        {"no such image", "a.gltf",
            triangle(R"("material":0)",
                R"("materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],
                    "textures":[{"source":5}])"),
            "image 5"},
        {"no such sampler", "a.gltf",
            triangle(R"("material":0)",
                R"("materials":[{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],
                    "textures":[{"sampler":5}])"),
            "sampler 5"},
        {"image in a view beyond its buffer", "a.gltf",
            withAccessor(accessor(0, "3"), R"(,"images":[{"bufferView":1,"mimeType":"image/png"}],
                "textures":[{"source":0}],"materials":[{"pbrMetallicRoughness":
                {"baseColorTexture":{"index":0}}}])",
                R"(,"material":0)"),
            "texture 0: bufferView 1 reaches beyond buffer 0"},
        {"light of no kind", "a.gltf", light(R"("type":"laser")"), "'laser'"},
        {"negative light", "a.gltf", light(R"("type":"point","intensity":-1)"), "negative"},
        {"light colour of 2", "a.gltf", light(R"("type":"point","color":[1,1])"), "2 values"},
        {"cone beyond π/2", "a.gltf", light(R"("type":"spot","spot":{"outerConeAngle":2})"),
            "cone angles"},
        {"no such light", "a.gltf",
            "{" + kAsset + R"(,"nodes":[{"extensions":{"KHR_lights_punctual":{"light":2}}}]})",
            "light 2"},
        {"no such camera", "a.gltf", triangle("", "", R"("camera":2)"), "camera 2"},
    };
}

void checkRefused(const TempFolder& folder, const BadFile& bad)
{
    INFO(bad.what);
    const std::string path = folder.write(bad.name, bad.bytes);
    std::string message;
    try {
        loadScene(path);
    } catch (const Error& e) {
        CHECK(e.code() == ErrorCode::Input);
        message = e.what();
    }
    INFO(message);
    CHECK_FALSE(message.empty());
    CHECK(message.find(path) == 0);
    CHECK(message.find(bad.says) != std::string::npos);
    CHECK(message.find('\n') == std::string::npos);
    if (!message.empty()) CHECK(message.back() == '.');
}

std::string readAll(const std::string& path)
{
    std::ifstream file(std::filesystem::u8path(path), std::ios::binary);
    std::ostringstream bytes;
    bytes << file.rdbuf();
    return bytes.str();
}

/// True where the file was read; any other exception than Error(Input) fails the test.
bool survives(const std::string& path)
{
    try {
        const Scene scene = loadScene(path);
        for (const Mesh& mesh : scene.meshes) {
            for (const auto& t : mesh.triangles) {
                for (const auto v : t) REQUIRE(v < mesh.positions.size());
            }
        }
        return true;
    } catch (const Error& e) {
        REQUIRE(e.code() == ErrorCode::Input);
        REQUIRE(std::string(e.what()).find(path) == 0);
        return false;
    }
}

/// A file with everything that the importer reads: the seed of the mutations.
std::string richGlb()
{
    GltfBuilder b;
    const int base = b.view(bytesOf(kTriangle));
    const int at = b.view(bytesOf(std::vector<std::uint8_t>{1}));
    const int value = b.view(bytesOf(std::vector<float>{5, 0, 0}));
    b.accessor(base, 5126, 3, "VEC3",
        R"("sparse":{"count":1,"indices":{"bufferView":)" + std::to_string(at)
            + R"(,"componentType":5121},"values":{"bufferView":)" + std::to_string(value) + "}}");
    b.vec2({0, 0, 1, 0, 0, 1});
    b.indices({0, 1, 2});
    const int image = b.view(png(2, 2, 3, {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}));
    return b.glb(R"("meshes":[{"name":"m","primitives":[{"attributes":{"POSITION":0,
        "TEXCOORD_0":1},"indices":2,"material":0,"mode":5}]}],"materials":[{"name":"x",
        "emissiveFactor":[1,1,1],"alphaMode":"MASK","emissiveTexture":{"index":0},
        "pbrMetallicRoughness":{"baseColorTexture":{"index":0,"texCoord":0,"extensions":{
        "KHR_texture_transform":{"offset":[0.1,0.2],"rotation":1,"scale":[1,2]}}}}}],
        "images":[{"mimeType":"image/png","bufferView":)"
        + std::to_string(image)
        + R"(}],"samplers":[{"wrapS":33071}],"textures":[{"source":0,"sampler":0}],
        "cameras":[{"type":"perspective","perspective":{"yfov":1,"znear":0.1}}],
        "nodes":[{"mesh":0,"children":[1],"scale":[1,2,-3],"camera":0},{"matrix":[1,0,0,0,0,1,0,0,
        0,0,1,0,1,2,3,1],"extensions":{"KHR_lights_punctual":{"light":0}}}],
        "extensions":{"KHR_lights_punctual":{"lights":[{"type":"spot","spot":{}}]}},
        "scenes":[{"nodes":[0]}],"scene":0)");
}

/// Overwrites bytes by a fixed pseudo-random sequence, or digits by other digits.
std::string mutate(const std::string& bytes, std::uint32_t seed)
{
    std::string result = bytes;
    std::uint32_t state = seed * 2654435761u + 12345u;
    const auto next = [&] { return state = state * 1664525u + 1013904223u, state >> 8; };
    const std::uint32_t changes = 1 + next() % 4;
    for (std::uint32_t i = 0; i < changes; ++i) {
        std::size_t at = next() % result.size();
        if (seed % 2 == 0) { // another digit: keeps the JSON valid, moves an index or a size
            while (at < result.size() && (result[at] < '0' || result[at] > '9')) ++at;
            if (at < result.size()) result[at] = static_cast<char>('0' + next() % 10);
        } else {
            result[at] = static_cast<char>(next() % 256);
        }
    }
    return result;
}

} // namespace

TEST_CASE("scene: bad input is refused with a sentence that names the file", "[scene]")
{
    const TempFolder folder;
    int count = 0;
    for (const auto& list : {badContainers(), badBuffers(), badScenes()}) {
        for (const BadFile& bad : list) {
            checkRefused(folder, bad);
            ++count;
        }
    }
    CHECK(count >= 60);
}

TEST_CASE("scene: missing files and folders", "[scene]")
{
    const TempFolder folder;
    for (const char* name : {"missing.gltf", "missing.glb", "missing.obj", "", "."}) {
        const std::string path = folder.path(name);
        INFO(path);
        CHECK_FALSE(survives(path));
    }
    CHECK_FALSE(survives(""));
}

TEST_CASE("scene: every prefix of a file", "[scene]")
{
    const TempFolder folder;
    const std::string bytes = richGlb();
    REQUIRE(survives(folder.write("whole.glb", bytes)));
    for (std::size_t size = 0; size < bytes.size(); ++size) {
        INFO(size);
        // A GLB carries its length, so that no proper prefix of it is accepted.
        REQUIRE_FALSE(survives(folder.write("cut.glb", bytes.substr(0, size))));
    }
}

TEST_CASE("scene: mutated files never crash", "[scene]")
{
    const TempFolder folder;
    const std::string bytes = richGlb();
    int read = 0;
    const int count = 2000;
    for (int seed = 1; seed <= count; ++seed) {
        INFO(seed);
        read += survives(folder.write("flip.glb", mutate(bytes, std::uint32_t(seed))));
    }
    CHECK(read > 0); // some mutations are harmless,
    CHECK(read < count); // others are noticed
}

TEST_CASE("scene: prefixes and mutations of a real scene", "[scene]")
{
    const std::string path = std::string(LUMIVDB_ASSETS) + "/cornell-bitterli/cornell-bitterli.glb";
    if (!std::filesystem::exists(path)) {
        WARN("skipped: " << path << " is not there");
        return;
    }
    const TempFolder folder;
    const std::string bytes = readAll(path);
    for (std::size_t size = 0; size < bytes.size(); size += 7) {
        INFO(size);
        REQUIRE_FALSE(survives(folder.write("cut.glb", bytes.substr(0, size))));
    }
    for (int seed = 1; seed <= 500; ++seed) {
        INFO(seed);
        survives(folder.write("flip.glb", mutate(bytes, std::uint32_t(seed))));
    }
}
