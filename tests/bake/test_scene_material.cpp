// SPDX-License-Identifier: Apache-2.0
#include "scene_fixture.h"

#include "../../bake/src/texture.h"

#include <lumivdb/bake/environment.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <functional>

using namespace lumivdb;
using namespace scene_test;

namespace {

/// The triangle with material 0 = { @a material } and further top-level members.
Scene withMaterial(const std::string& material, const std::string& rest = "")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec2({0, 0, 1, 0, 0, 1});
    const std::string attributes = R"(attributes:"TEXCOORD_0":0,"TEXCOORD_1":0|)";
    return load(folder,
        triangleGltf(b, attributes + R"("material":0)",
            R"("materials":[{)" + material + "}]" + (rest.empty() ? "" : ",") + rest));
}

std::string dataUri(const std::string& bytes) { return "data:image/png;base64," + base64(bytes); }

/// Textures 0 … from images given as glTF objects.
std::string textures(const std::string& image, const std::string& texture = R"("source":0)",
    const std::string& sampler = "")
{
    return R"("images":[{)" + image + R"(}],"textures":[{)" + texture + "}]"
        + (sampler.empty() ? "" : R"(,"samplers":[{)" + sampler + "}]");
}

const char* kTextured = R"("pbrMetallicRoughness":{"metallicFactor":0,
    "baseColorTexture":{"index":0}})";

/// Black, white, sRGB 188 with alpha 0.5.
const std::vector<std::uint8_t> kPixels
    = {0, 0, 0, 255, 255, 255, 255, 255, 188, 188, 188, 128, 255, 0, 0, 255};

} // namespace

TEST_CASE("scene: material factors", "[scene]")
{
    const Scene scene = withMaterial(
        R"("name":"lamp","doubleSided":true,"emissiveFactor":[0.5,0.25,1],
        "extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":8}},
        "pbrMetallicRoughness":{"baseColorFactor":[0.1,0.2,0.3,0.4],"metallicFactor":0})");
    REQUIRE(scene.materials.size() == 1);
    const Material& m = scene.materials[0];
    CHECK(m.name == "lamp");
    CHECK(m.baseColor == Color(0.1f, 0.2f, 0.3f)); // factors are linear
    CHECK(m.emission == Color(4, 2, 8));
    CHECK(m.alphaFactor == 0.4f);
    CHECK_FALSE(m.alphaMask); // OPAQUE ignores alpha
    CHECK(m.doubleSided);
    CHECK(scene.warnings.empty());
}

TEST_CASE("scene: alpha modes", "[scene]")
{
    const Scene mask = withMaterial(
        R"("alphaMode":"MASK","alphaCutoff":0.25,"pbrMetallicRoughness":{"metallicFactor":0})");
    CHECK(mask.materials[0].alphaMask);
    CHECK(mask.materials[0].alphaCutoff == 0.25f);
    CHECK(countWarnings(mask, "Blended") == 0);
    const Scene blend = withMaterial(R"("name":"veil","alphaMode":"BLEND","alphaCutoff":0.9)");
    CHECK(blend.materials[0].alphaMask);
    CHECK(blend.materials[0].alphaCutoff == 0.5f);
    CHECK(
        countWarnings(blend, "Blended materials are cut out where alpha is below 0.5: veil.") == 1);
}

TEST_CASE("scene: no material means albedo 1, said once", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3(kTriangle);
    const Scene scene = load(
        folder, b.gltf(R"("materials":[{"name":"unused"}],"meshes":[{"name":"m","primitives":[
            {"attributes":{"POSITION":0}},{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}])"));
    REQUIRE(scene.meshes.size() == 2);
    for (const Mesh& mesh : scene.meshes) {
        REQUIRE(mesh.material == 1);
        CHECK(scene.materials[1].baseColor == Color(1, 1, 1));
    }
    CHECK(countWarnings(scene, "albedo 1: m/0, m/1.") == 1);
    CHECK(countWarnings(scene, "Metals") == 0); // the unused material is not talked about
}

TEST_CASE("scene: base colour above 1 is clamped", "[scene]")
{
    const Scene scene
        = withMaterial(R"("name":"hot","pbrMetallicRoughness":{"baseColorFactor":[1.5,0.5,1,1]})");
    CHECK(scene.materials[0].baseColor == Color(1, 0.5f, 1));
    CHECK(countWarnings(scene, "clamped: hot") == 1);
}

TEST_CASE("scene: what is ignored is said once, with names", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3(kTriangle);
    const int joints = b.accessor(b.view(std::string(64, '\0')), 5126, 1, "MAT4");
    std::string materials, primitives;
    for (int i = 0; i < 6; ++i) {
        const std::string n = std::to_string(i);
        materials += std::string(i ? "," : "") + R"({"name":"m)" + n
            + R"(","normalTexture":{"index":0},"occlusionTexture":{"index":0},
                "pbrMetallicRoughness":{"metallicFactor":1,"roughnessFactor":0.2},
                "extensions":{"KHR_materials_unlit":{},
                    "KHR_materials_transmission":{"transmissionFactor":1}}})";
        primitives += std::string(i ? "," : "")
            + R"({"attributes":{"POSITION":0},"targets":[{"POSITION":0}],"material":)" + n + "}";
    }
    const Scene scene = load(folder,
        b.gltf(R"("materials":[)" + materials + R"(],"meshes":[{"name":"x","primitives":[)"
            + primitives + R"(]}],"nodes":[{"mesh":0,"skin":0,"name":"n"}],
            "skins":[{"joints":[0],"inverseBindMatrices":)"
            + std::to_string(joints) + R"(}],
            "textures":[{}],"animations":[{"channels":[],"samplers":[]}],
            "extensionsUsed":["KHR_materials_unlit","EXT_strange"])"));
    CHECK(scene.triangleCount() == 6);
    for (const char* text : {"Normal maps are ignored: m0, m1, m2, m3 and 2 more.",
             "Occlusion maps are ignored: m0", "Metals reflect their base colour diffusely: m0",
             "Gloss (metallic-roughness) is ignored", "Unlit materials",
             "material extension KHR_materials_transmission is ignored: m0",
             "Skins are ignored (static pose)", "Morph targets are ignored",
             "1 animations are ignored", "Extensions of the file are ignored: EXT_strange.",
             "Nothing emits light"}) {
        INFO(text);
        CHECK(countWarnings(scene, text) == 1);
    }
    CHECK(scene.warnings.size() == 11);
}

TEST_CASE("scene: textures from data URI, buffer view and file", "[scene]")
{
    const std::string image = png(4, 1, 4, kPixels);
    const TempFolder folder;
    folder.write("bilder ü/tex 1.png", image);
    const auto check = [](const Scene& scene) {
        REQUIRE(scene.textures.size() == 1);
        REQUIRE(scene.materials[0].baseColorTexture.texture == 0);
        const Texture& t = scene.textures[0];
        REQUIRE(t.width == 4);
        REQUIRE(t.height == 1);
        REQUIRE(t.pixels.size() == 16);
        CHECK(t.pixels[0] == 0.0f);
        CHECK(t.pixels[4] == Approx(1.0f).margin(1e-6));
        // 188/255 = 0.737255; ((0.737255 + 0.055) / 1.055)^2.4 = 0.502886.
        CHECK(t.pixels[8] == Approx(0.502886).margin(1e-5));
        CHECK(t.pixels[11] == Approx(128 / 255.0)); // alpha is no colour
        CHECK(countWarnings(scene, "Textures") == 0);
    };
    check(withMaterial(kTextured, textures(R"("uri":")" + dataUri(image) + "\"")));

    GltfBuilder b;
    b.vec2({0, 0, 1, 0, 0, 1});
    const int view = b.view(image);
    const std::string common = R"("materials":[{)" + std::string(kTextured) + "}],";
    check(load(folder,
        triangleGltf(b, R"(attributes:"TEXCOORD_0":0|"material":0)",
            common + textures(R"("mimeType":"image/png","bufferView":)" + std::to_string(view)))));

    GltfBuilder c;
    c.vec2({0, 0, 1, 0, 0, 1});
    check(load(folder,
        triangleGltf(c, R"(attributes:"TEXCOORD_0":0|"material":0)",
            common + textures(R"("uri":"bilder%20%C3%BC/tex%201.png")"))));
}

TEST_CASE("scene: grey and grey-alpha images", "[scene]")
{
    const Scene grey
        = withMaterial(kTextured, textures(R"("uri":")" + dataUri(png(1, 1, 1, {188})) + "\""));
    REQUIRE(grey.textures.size() == 1);
    for (int c = 0; c < 3; ++c) {
        CHECK(
            grey.textures[0].pixels[static_cast<std::size_t>(c)] == Approx(0.502886).margin(1e-5));
    }
    CHECK(grey.textures[0].pixels[3] == 1.0f);
    const Scene alpha
        = withMaterial(kTextured, textures(R"("uri":")" + dataUri(png(1, 1, 2, {188, 51})) + "\""));
    REQUIRE(alpha.textures.size() == 1);
    CHECK(alpha.textures[0].pixels[2] == Approx(0.502886).margin(1e-5));
    CHECK(alpha.textures[0].pixels[3] == Approx(0.2));
}

TEST_CASE("scene: 16-bit images are sRGB, floating-point images are linear", "[scene]")
{
    const TempFolder folder;
    folder.write("deep.png", encodeImage("png", 1, 1, {0.5f, 0.25f, 1.0f}));
    folder.write(
        "hot.exr", encodeImage("exr", 2, 1, {0.5f, 3.0f, 1.0f, std::nanf(""), -1.0f, 0.0f}));
    const auto make = [&](const std::string& image) {
        GltfBuilder b;
        b.vec2({0, 0, 1, 0, 0, 1});
        return load(folder,
            triangleGltf(b, R"(attributes:"TEXCOORD_0":0|"material":0)",
                R"("materials":[{"name":"m","emissiveFactor":[1,1,1],"emissiveTexture":{"index":0},
                "pbrMetallicRoughness":{"metallicFactor":0,"baseColorTexture":{"index":0}}}],)"
                    + textures(R"("uri":")" + image + "\"")));
    };
    // ((0.5 + 0.055) / 1.055)^2.4 = 0.214041, ((0.25 + 0.055) / 1.055)^2.4 = 0.050876.
    const Scene deep = make("deep.png");
    REQUIRE(deep.textures.size() == 1);
    CHECK(deep.textures[0].pixels[0] == Approx(0.214041).margin(2e-5));
    CHECK(deep.textures[0].pixels[1] == Approx(0.050876).margin(2e-5));
    CHECK(deep.textures[0].pixels[2] == Approx(1.0));

    // Emission may be above 1; for the base colour a clamped copy is made.
    const Scene hot = make("hot.exr");
    REQUIRE(hot.textures.size() == 2);
    const Material& m = hot.materials[0];
    REQUIRE(m.emissionTexture.texture != m.baseColorTexture.texture);
    const auto& emission = hot.textures[static_cast<std::size_t>(m.emissionTexture.texture)].pixels;
    const auto& base = hot.textures[static_cast<std::size_t>(m.baseColorTexture.texture)].pixels;
    CHECK(emission == std::vector<float>{0.5f, 3.0f, 1.0f, 1, 0, 0, 0, 1});
    CHECK(base == std::vector<float>{0.5f, 1.0f, 1.0f, 1, 0, 0, 0, 1});
    CHECK(countWarnings(hot, "textures above 1 are clamped to 1: m.") == 1);
    CHECK(countWarnings(hot, "NaN, infinite or negative texels are taken as 0: hot.exr.") == 1);
}

TEST_CASE("scene: samplers, UV sets and texture transforms", "[scene]")
{
    const std::string image = R"("uri":")" + dataUri(png(1, 1, 3, {255, 255, 255})) + "\"";
    const double angle = 0.3;
    const Scene scene = withMaterial(R"("emissiveFactor":[1,1,1],"emissiveTexture":
            {"index":0,"texCoord":1},"pbrMetallicRoughness":{"metallicFactor":0,
            "baseColorTexture":{"index":0,"extensions":{"KHR_texture_transform":
            {"offset":[0.25,0.5],"rotation":0.3,"scale":[2,3],"texCoord":1}}}})",
        textures(
            image, R"("source":0,"sampler":0)", R"("magFilter":9728,"wrapS":33071,"wrapT":33648)"));
    REQUIRE(scene.textures.size() == 1);
    CHECK(scene.textures[0].nearest);
    CHECK(scene.textures[0].wrapU == WrapMode::ClampToEdge);
    CHECK(scene.textures[0].wrapV == WrapMode::MirroredRepeat);
    const Material& m = scene.materials[0];
    CHECK(m.emissionTexture.uvSet == 1);
    CHECK(m.emissionTexture.transform == std::array<float, 6>{1, 0, 0, 0, 1, 0});
    CHECK(m.baseColorTexture.uvSet == 1); // the transform's own texCoord wins
    // Scale first, then rotate counter-clockwise as seen with v pointing down: the u axis turns
    // towards −v, i.e. (1, 0) → 2·(cos, −sin) and (0, 1) → 3·(sin, cos).
    const double expected[6] = {2 * std::cos(angle), 3 * std::sin(angle), 0.25,
        -2 * std::sin(angle), 3 * std::cos(angle), 0.5};
    for (std::size_t i = 0; i < 6; ++i) {
        CHECK(m.baseColorTexture.transform[i] == Approx(expected[i]));
    }
}

TEST_CASE("scene: a missing or broken texture is white, with a warning", "[scene]")
{
    for (const std::string& image :
        {std::string(R"("uri":"nowhere.png")"), R"("uri":")" + dataUri("not an image") + "\"",
            R"("uri":")" + dataUri(png(4, 1, 4, kPixels).substr(0, 50)) + "\""}) {
        const Scene scene = withMaterial(kTextured, textures(image));
        INFO(image);
        CHECK(scene.textures.empty());
        CHECK(scene.materials[0].baseColorTexture.texture == -1);
        CHECK(countWarnings(scene, "cannot be read are taken as white: ") == 1);
    }
    const Scene none = withMaterial(kTextured, R"("textures":[{}])");
    CHECK(countWarnings(none, "it has no image") == 1);
}

TEST_CASE("scene: textured meshes without coordinates get some", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    const Scene scene = load(folder,
        triangleGltf(b, R"("material":0)",
            R"("materials":[{)" + std::string(kTextured) + "}],"
                + textures(R"("uri":")" + dataUri(png(1, 1, 3, {9, 9, 9})) + "\"")));
    REQUIRE(scene.meshes.size() == 1);
    CHECK(scene.meshes[0].uv[0].size() == 3);
    CHECK(countWarnings(scene, "lack the texture coordinates") == 1);
}

TEST_CASE("scene: NaN in texture coordinates becomes 0 with a warning", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec2({0, std::nanf(""), 1, 0, INFINITY, 1});
    const Scene scene = load(folder, triangleGltf(b, R"(attributes:"TEXCOORD_0":0)"));
    REQUIRE(scene.meshes.size() == 1);
    CHECK(scene.meshes[0].uv[0][0] == Vec2f(0, 0));
    CHECK(scene.meshes[0].uv[0][2] == Vec2f(0, 1));
    CHECK(countWarnings(scene, "not finite become 0: mesh 'tri' primitive 0.") == 1);
}

TEST_CASE("texture: look-ups filter linear values", "[scene]")
{
    Texture t;
    t.width = 2;
    t.height = 2;
    // Row 0: 0, 1. Row 1: 10, 20. Texel centres at u, v = 0.25 and 0.75.
    t.pixels = {0, 0, 0, 1, 1, 0, 0, 1, 10, 0, 0, 0, 20, 0, 0, 0};
    CHECK(t.sample(0.25f, 0.25f)[0] == 0.0f);
    CHECK(t.sample(0.75f, 0.25f)[0] == 1.0f);
    CHECK(t.sample(0.25f, 0.75f)[0] == 10.0f); // v grows downwards
    CHECK(t.sample(0.5f, 0.5f)[0] == Approx(31 / 4.0));
    CHECK(t.sample(0.5f, 0.5f)[3] == Approx(0.5));
    // At u = 0 the neighbour is the other border (repeat) or the border itself.
    CHECK(t.sample(0.0f, 0.25f)[0] == Approx(0.5));
    CHECK(t.sample(-1.0f, 3.25f)[0] == Approx(0.5));
    t.wrapU = WrapMode::ClampToEdge;
    CHECK(t.sample(0.0f, 0.25f)[0] == 0.0f);
    CHECK(t.sample(-7.0f, 0.25f)[0] == 0.0f);
    CHECK(t.sample(7.0f, 0.25f)[0] == 1.0f);
    t.wrapU = WrapMode::MirroredRepeat;
    CHECK(t.sample(0.0f, 0.25f)[0] == 0.0f);
    CHECK(t.sample(1.25f, 0.25f)[0] == 1.0f); // mirrored at 1
    CHECK(t.sample(-0.25f, 0.25f)[0] == 0.0f); // mirrored at 0
    CHECK(t.sample(2.25f, 0.25f)[0] == 0.0f); // period 2
    t.nearest = true;
    CHECK(t.sample(0.49f, 0.49f)[0] == 0.0f);
    CHECK(t.sample(0.51f, 0.49f)[0] == 1.0f);
    CHECK(t.sample(0.51f, 0.51f)[0] == 20.0f);
}

TEST_CASE("texels give what their texture gives", "[scene][texture]")
{
    CounterRng random(5);
    std::vector<unsigned char> bytes(7 * 5 * 4);
    for (unsigned char& b : bytes) b = static_cast<unsigned char>(random.bits() >> 56);
    const Scene scene
        = withMaterial(kTextured, textures(R"("uri":")" + dataUri(png(7, 5, 4, bytes)) + "\""));
    REQUIRE(scene.textures.size() == 1);
    Texture t = scene.textures[0];
    const auto compare = [&](bool packed) {
        const Texels texels(t);
        CHECK(texels.packed() == packed);
        int different = 0;
        for (int i = 0; i < 1000; ++i) {
            const float u = 6 * random.next() - 3, v = 6 * random.next() - 3;
            different += texels.sample(u, v) != t.sample(u, v);
        }
        CHECK(different == 0);
    };
    for (const bool nearest : {false, true}) {
        t.nearest = nearest;
        for (const WrapMode mode :
            {WrapMode::Repeat, WrapMode::MirroredRepeat, WrapMode::ClampToEdge}) {
            t.wrapU = t.wrapV = mode;
            compare(true);
        }
    }
    for (const float other : {0.5f, 2.0f, -0.0f, std::nextafter(t.pixels[5], 1.0f)}) {
        t.pixels[5] = other;
        compare(other == 0);
    }
}

TEST_CASE("texture: no coordinate leaves the image", "[scene]")
{
    for (const bool nearest : {false, true}) {
        for (const WrapMode mode :
            {WrapMode::Repeat, WrapMode::MirroredRepeat, WrapMode::ClampToEdge}) {
            Texture t;
            t.width = 3;
            t.height = 1;
            t.pixels.assign(12, 0.5f);
            t.wrapU = t.wrapV = mode;
            t.nearest = nearest;
            for (const float u : {-1e-9f, -0.0f, 1.0f, 0.99999994f, 2.0f, -1e30f, 1e30f, 3e7f,
                     std::nanf(""), INFINITY, -INFINITY, 1e-40f}) {
                for (const float v : {0.5f, u}) CHECK(t.sample(u, v)[0] == 0.5f);
            }
        }
    }
}

TEST_CASE("scene: punctual lights", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    // −Z turned by +90° about Y is −X. Scale does not touch a light.
    const Scene scene = load(folder, b.gltf(R"("extensions":{"KHR_lights_punctual":{"lights":[
            {"type":"point","name":"bulb","color":[1,0.5,0.25],"intensity":20,"range":7},
            {"type":"spot","intensity":3,"spot":{"innerConeAngle":0.1,"outerConeAngle":0.2}},
            {"type":"directional","name":"sun"}]}},
            "nodes":[{"name":"p","translation":[1,2,3],"scale":[5,5,5],"children":[1],
                      "extensions":{"KHR_lights_punctual":{"light":0}}},
                     {"name":"spotnode","translation":[1,0,0],
                      "extensions":{"KHR_lights_punctual":{"light":1}}},
                     {"rotation":[0,0.70710678118654752,0,0.70710678118654752],
                      "extensions":{"KHR_lights_punctual":{"light":2}}}],
            "scenes":[{"nodes":[0,2]}])"));
    REQUIRE(scene.lights.size() == 3);
    const Light& point = scene.lights[0];
    CHECK(point.type == LightType::Point);
    CHECK(point.name == "bulb");
    CHECK(point.nodeName == "p");
    CHECK(point.intensity == Color(20, 10, 5));
    CHECK(point.position == Vec3d(1, 2, 3));
    CHECK(point.range == 7);
    const Light& spot = scene.lights[1];
    CHECK(spot.type == LightType::Spot);
    CHECK(spot.name == "spotnode");
    CHECK(spot.position == Vec3d(6, 2, 3));
    CHECK(spot.direction == Vec3d(0, 0, -1));
    CHECK(spot.innerConeAngle == 0.1);
    CHECK(spot.outerConeAngle == 0.2);
    CHECK(spot.range == 0);
    const Light& sun = scene.lights[2];
    CHECK(sun.type == LightType::Directional);
    CHECK((sun.direction - Vec3d(-1, 0, 0)).length() < 1e-12);
    CHECK(sun.intensity == Color(1, 1, 1));
    CHECK(countWarnings(scene, "Nothing emits light") == 0);
}

TEST_CASE("scene: cameras", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    const Scene scene = load(
        folder, b.gltf(R"("cameras":[{"type":"perspective","perspective":{"yfov":0.7,"znear":0.1}},
            {"type":"orthographic","orthographic":{"xmag":1,"ymag":1,"znear":0,"zfar":1}}],
            "nodes":[{"camera":0,"translation":[0,1,2],"scale":[3,3,3],
                "rotation":[0,0.70710678118654752,0,0.70710678118654752]},
                {"camera":1,"name":"top"}])"));
    REQUIRE(scene.cameras.size() == 1);
    CHECK(scene.cameras[0].yfov == 0.7);
    const Mat4d& m = scene.cameras[0].cameraToWorld;
    Vec3d forward, up, origin;
    m.multDirMatrix(Vec3d(0, 0, -1), forward);
    m.multDirMatrix(Vec3d(0, 1, 0), up);
    m.multVecMatrix(Vec3d(0, 0, 0), origin);
    CHECK((forward - Vec3d(-1, 0, 0)).length() < 1e-12);
    CHECK((up - Vec3d(0, 1, 0)).length() < 1e-12);
    CHECK(origin == Vec3d(0, 1, 2));
    CHECK(countWarnings(scene, "Orthographic cameras are ignored: node 'top'.") == 1);
}

TEST_CASE("scene: the content hash sees everything that affects light", "[scene]")
{
    const auto make = [] {
        Scene scene = withMaterial(
            R"("name":"lamp","emissiveFactor":[1,1,1],"pbrMetallicRoughness":{"metallicFactor":0,
                "baseColorTexture":{"index":0}})",
            textures(R"("uri":")" + dataUri(png(4, 1, 4, kPixels)) + "\""));
        scene.lights.emplace_back();
        scene.environment = Environment::constant(Color(1, 2, 3));
        updateContentHash(scene);
        return scene;
    };
    const Scene original = make();
    CHECK(original.contentHash == make().contentHash);
    CHECK(original.contentHash.find_first_not_of("0123456789abcdef") == std::string::npos);
    CHECK(original.contentHash.size() == 16);
    const std::function<void(Scene&)> changes[] = {
        [](Scene& s) { s.meshes[0].positions[2].y += 1e-15; },
        [](Scene& s) { s.meshes[0].uv[0][1].x += 1e-7f; },
        [](Scene& s) { s.meshes[0].uv[1].clear(); },
        [](Scene& s) { s.meshes[0].colors.resize(3); },
        [](Scene& s) { std::swap(s.meshes[0].triangles[0][1], s.meshes[0].triangles[0][2]); },
        [](Scene& s) { s.meshes.push_back(s.meshes[0]); },
        [](Scene& s) { s.materials[0].baseColor.y = 0.5f; },
        [](Scene& s) { s.materials[0].emission.z = 0.5f; },
        [](Scene& s) { s.materials[0].doubleSided = true; },
        [](Scene& s) { s.materials[0].emitsFrontOnly = true; },
        [](Scene& s) { s.materials[0].alphaMask = true; },
        [](Scene& s) { s.materials[0].alphaCutoff = 0.1f; },
        [](Scene& s) { s.materials[0].alphaFactor = 0.1f; },
        [](Scene& s) { s.materials[0].baseColorTexture.uvSet = 1; },
        [](Scene& s) { s.materials[0].baseColorTexture.transform[3] = 0.1f; },
        [](Scene& s) { s.materials[0].emissionTexture.texture = 0; },
        [](Scene& s) { s.textures[0].pixels[3] = 0.9f; },
        [](Scene& s) { s.textures[0].nearest = true; },
        [](Scene& s) { s.textures[0].wrapV = WrapMode::ClampToEdge; },
        [](Scene& s) { s.lights[0].position.x = 1; },
        [](Scene& s) { s.lights[0].range = 1; },
        [](Scene& s) { s.lights[0].type = LightType::Spot; },
        [](Scene& s) { s.lights[0].outerConeAngle = 0.3; },
        [](Scene& s) { s.environment = Environment::constant(Color(1, 2, 4)); },
        [](Scene& s) { s.environment = nullptr; },
    };
    std::vector<std::string> seen = {original.contentHash};
    for (const auto& change : changes) {
        Scene scene = make();
        change(scene);
        updateContentHash(scene);
        INFO("change " << seen.size());
        CHECK(std::find(seen.begin(), seen.end(), scene.contentHash) == seen.end());
        seen.push_back(scene.contentHash);
    }
    Scene renamed = make();
    renamed.materials[0].name = "other";
    renamed.cameras.emplace_back();
    updateContentHash(renamed);
    CHECK(renamed.contentHash == original.contentHash);
}

TEST_CASE("scene: light groups", "[scene]")
{
    Scene scene;
    scene.materials.resize(3);
    scene.materials[0].name = "panel";
    scene.materials[0].emission = Color(1, 2, 3);
    scene.materials[1].name = "sign";
    scene.materials[1].emission = Color(4, 5, 6);
    scene.materials[2].name = "wall";
    scene.lights.resize(2);
    scene.lights[0].name = "bulb";
    scene.lights[0].nodeName = "kitchen";
    scene.lights[1].name = "torch";
    scene.environment = Environment::constant(Color(1, 1, 1));
    updateContentHash(scene);

    Scene sign = scene;
    selectLightGroup(sign, "sign");
    CHECK(sign.materials[1].emission == Color(4, 5, 6));
    CHECK(sign.materials[0].emission == Color(0, 0, 0));
    CHECK(sign.lights[0].intensity == Color(0, 0, 0));
    CHECK(sign.environment == nullptr);
    CHECK(sign.contentHash != scene.contentHash);
    CHECK(sign.materials[0].baseColor == Color(1, 1, 1)); // it still reflects

    for (const char* name : {"bulb", "kitchen"}) {
        Scene bulb = scene;
        selectLightGroup(bulb, name);
        CHECK(bulb.lights[0].intensity == Color(1, 1, 1));
        CHECK(bulb.lights[1].intensity == Color(0, 0, 0));
        CHECK(bulb.materials[1].emission == Color(0, 0, 0));
    }
    Scene sky = scene;
    selectLightGroup(sky, "environment");
    CHECK(sky.environment != nullptr);
    CHECK(sky.lights[1].intensity == Color(0, 0, 0));

    for (const char* name : {"wall", "nothing", ""}) {
        try {
            Scene copy = scene;
            selectLightGroup(copy, name);
            FAIL("accepted " << name);
        } catch (const Error& e) {
            CHECK(e.code() == ErrorCode::Usage);
            for (const char* group : {"panel", "sign", "bulb", "kitchen", "torch", "environment"}) {
                CHECK(std::string(e.what()).find(group) != std::string::npos);
            }
        }
    }
}
