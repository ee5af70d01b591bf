// SPDX-License-Identifier: Apache-2.0
#include "scene_fixture.h"

#include <catch2/catch.hpp>

using namespace lumivdb;
using namespace scene_test;

namespace {

/// A mesh of one primitive drawn with @a mode over the five points of a zigzag.
Scene zigzag(int mode, const std::string& indices = "")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3({0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1, 0, 2, 0, 0});
    return load(folder,
        b.gltf(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},"mode":)"
            + std::to_string(mode) + indices + R"(}]}],"nodes":[{"mesh":0}])"));
}

} // namespace

TEST_CASE("scene: a node chain multiplies in double precision", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3(kTriangle);
    // Outer: +90° about Y (x → −z), then 1e6 along x. Inner: scale (2,3,4), then (0.5, 0, 0).
    // (1,0,0) → (2,0,0) → (2.5,0,0) → (0,0,−2.5) → (1e6,0,−2.5); (0,1,0) → (1e6, 3, −0.5).
    const Scene scene
        = load(folder, b.gltf(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "nodes":[{"children":[1],"rotation":[0,0.70710678118654752,0,0.70710678118654752],
                  "translation":[1000000.0,0,0]},
                 {"mesh":0,"scale":[2,3,4],"translation":[0.5,0,0]}],
        "scenes":[{"nodes":[0]}])"));
    REQUIRE(scene.meshes.size() == 1);
    const auto& p = scene.meshes[0].positions;
    REQUIRE(p.size() == 3);
    const Vec3d expected[3] = {{1e6, 0, -0.5}, {1e6, 0, -2.5}, {1e6, 3, -0.5}};
    for (int i = 0; i < 3; ++i) CHECK((p[i] - expected[i]).length() < 1e-9);
}

TEST_CASE("scene: rotations about every axis", "[scene]")
{
    // Quarter turns, right-handed: about Z x → y; about X y → z; about Y z → x (so x → −z). The
    // last one turns by 120° about (1,1,1): x → y → z → x. It is also given with length 2.
    const struct {
        const char* rotation;
        Vec3d x, y;
    } cases[] = {
        {"0,0,0.7071067811865476,0.7071067811865476", {0, 1, 0}, {-1, 0, 0}},
        {"0.7071067811865476,0,0,0.7071067811865476", {1, 0, 0}, {0, 0, 1}},
        {"0,0.7071067811865476,0,0.7071067811865476", {0, 0, -1}, {0, 1, 0}},
        {"0.5,0.5,0.5,0.5", {0, 1, 0}, {0, 0, 1}},
        {"1,1,1,1", {0, 1, 0}, {0, 0, 1}},
    };
    for (const auto& c : cases) {
        const TempFolder folder;
        GltfBuilder b;
        const Scene scene = load(folder,
            triangleGltf(b, "", "", std::string(R"("mesh":0,"rotation":[)") + c.rotation + "]"));
        INFO(c.rotation);
        REQUIRE(scene.triangleCount() == 1);
        CHECK((scene.meshes[0].positions[1] - c.x).length() < 1e-15);
        CHECK((scene.meshes[0].positions[2] - c.y).length() < 1e-15);
    }
}

TEST_CASE("scene: a matrix is column-major", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    // Columns: x → +Y, y → −X, z → +Z, translation (7, 8, 9).
    const Scene scene = load(folder,
        triangleGltf(b, "", "", R"("mesh":0,"matrix":[0,1,0,0, -1,0,0,0, 0,0,1,0, 7,8,9,1])"));
    REQUIRE(scene.triangleCount() == 1);
    CHECK(scene.meshes[0].positions[0] == Vec3d(7, 8, 9));
    CHECK(scene.meshes[0].positions[1] == Vec3d(7, 9, 9));
    CHECK(scene.meshes[0].positions[2] == Vec3d(6, 8, 9));
}

TEST_CASE("scene: mirrored instances keep their front sides", "[scene]")
{
    // The triangle faces +Z. Mirroring x leaves z alone, so its front still faces +Z; mirroring
    // all three axes turns the front to −Z. Two reflections make a rotation about Y: −Z again.
    const struct {
        const char* scale;
        double z;
    } cases[] = {{"1,1,1", 1}, {"-1,1,1", 1}, {"1,-1,1", 1}, {"-1,-1,-1", -1}, {"-1,1,-1", -1}};
    for (const auto& c : cases) {
        const TempFolder folder;
        GltfBuilder b;
        const Scene scene = load(
            folder, triangleGltf(b, "", "", std::string(R"("mesh":0,"scale":[)") + c.scale + "]"));
        INFO(c.scale);
        REQUIRE(scene.triangleCount() == 1);
        CHECK(normalOf(scene.meshes[0], 0) == Vec3d(0, 0, c.z));
    }
}

TEST_CASE("scene: nodes that share a mesh are its instances, and bounds cover them", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3(kTriangle);
    // Two as they are, two mirrored, one that is flattened to a line and one of half a triangle.
    const Scene scene
        = load(folder, b.gltf(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "nodes":[{"mesh":0},{"mesh":0,"scale":[-1,1,1]},{"mesh":0,"translation":[10,0,-2]},
                 {"mesh":0,"scale":[0,1,1]},{"mesh":0,"scale":[1,1,-2],"translation":[0,0,5]},
                 {"mesh":0,"scale":[1,0.5,0]}],
        "scenes":[{"nodes":[0,1,2,3,4,5]}])"));
    REQUIRE(scene.meshes.size() == 3);
    CHECK(scene.triangleCount() == 5);
    CHECK(countWarnings(scene, "1 degenerate") == 1);
    for (int m = 0; m < 2; ++m) {
        const Mesh& mesh = scene.meshes[static_cast<std::size_t>(m)];
        REQUIRE(mesh.instances.size() == 2);
        CHECK(mesh.positions[1] == Vec3d(1, 0, 0));
    }
    CHECK(scene.meshes[0].worldPosition(1, 1) == Vec3d(11, 0, -2));
    CHECK(scene.meshes[1].worldPosition(0, 1) == Vec3d(-1, 0, 0));
    CHECK(normalOf(scene.meshes[0], 0) == Vec3d(0, 0, 1));
    CHECK(normalOf(scene.meshes[1], 0) == Vec3d(0, 0, -1)); // which the mirrors turn round
    CHECK(scene.meshes[2].instances.empty());
    CHECK(scene.meshes[2].positions[2] == Vec3d(0, 0.5, 0));
    CHECK(scene.bounds().min == Vec3d(-1, 0, -2));
    CHECK(scene.bounds().max == Vec3d(11, 1, 5));
}

TEST_CASE("scene: instances of EXT_mesh_gpu_instancing", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3(kTriangle);
    b.vec3({0, 0, 0, 1, 0, 0}); // translations
    // Rotations as normalised shorts: none, and 180° about Y.
    const std::vector<std::int16_t> turns = {0, 0, 0, 32767, 0, 32767, 0, 0};
    b.accessor(b.view(bytesOf(turns)), 5122, 2, "VEC4", R"("normalized":true)");
    b.vec3({2, 2, 2, 1, 3, 1}); // scales
    const std::string mesh = R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],)";
    const auto text = [&](const std::string& attributes) {
        return b.gltf(mesh + R"("nodes":[{"mesh":0,"translation":[0,0,10],"extensions":{
            "EXT_mesh_gpu_instancing":{"attributes":{)"
            + attributes + R"(}}}}],"extensionsUsed":["EXT_mesh_gpu_instancing"],
            "extensionsRequired":["EXT_mesh_gpu_instancing"])");
    };
    const Scene scene = load(folder, text(R"("TRANSLATION":1,"ROTATION":2,"SCALE":3)"));
    REQUIRE(scene.meshes.size() == 1);
    REQUIRE(scene.meshes[0].instances.size() == 2);
    CHECK(countWarnings(scene, "EXT_mesh_gpu_instancing") == 0);
    CHECK(scene.meshes[0].worldPosition(0, 1) == Vec3d(2, 0, 10));
    CHECK((scene.meshes[0].worldPosition(1, 1) - Vec3d(0, 0, 10)).length() < 1e-12);
    CHECK((scene.meshes[0].worldPosition(1, 2) - Vec3d(1, 3, 10)).length() < 1e-12);
    CHECK(load(folder, text(R"("_ID":1)")).triangleCount() == 1);
    CHECK_THROWS_WITH(
        load(folder, text(R"("TRANSLATION":1,"SCALE":0)")), Catch::Contains("different lengths"));
    CHECK_THROWS_WITH(load(folder, text(R"("TRANSLATION":9)")), Catch::Contains("accessor"));
}

TEST_CASE("scene: index types", "[scene]")
{
    const std::vector<std::uint8_t> bytes = {2, 0, 1};
    const std::vector<std::uint16_t> shorts = {2, 0, 1};
    const std::vector<std::uint32_t> words = {2, 0, 1};
    const struct {
        int type;
        std::string data;
    } cases[] = {{5121, bytesOf(bytes)}, {5123, bytesOf(shorts)}, {5125, bytesOf(words)}};
    for (const auto& c : cases) {
        const TempFolder folder;
        GltfBuilder b;
        b.accessor(b.view(c.data), c.type, 3, "SCALAR");
        const Scene scene = load(folder, triangleGltf(b, R"("indices":0)"));
        INFO(c.type);
        REQUIRE(scene.triangleCount() == 1);
        const auto& mesh = scene.meshes[0];
        CHECK(mesh.positions[mesh.triangles[0][0]] == Vec3d(0, 1, 0));
        CHECK(normalOf(mesh, 0) == Vec3d(0, 0, 1));
    }
}

TEST_CASE("scene: triangles, strips, fans; points and lines are skipped", "[scene]")
{
    // Zigzag 0(0,0) 1(0,1) 2(1,0) 3(1,1) 4(2,0): every strip triangle must face −Z like the first.
    const Scene strip = zigzag(5);
    REQUIRE(strip.triangleCount() == 3);
    for (std::size_t t = 0; t < 3; ++t) CHECK(normalOf(strip.meshes[0], t) == Vec3d(0, 0, -1));
    const Scene fan = zigzag(6); // (0,1,2) (0,2,3) (0,3,4)
    REQUIRE(fan.triangleCount() == 3);
    CHECK(normalOf(fan.meshes[0], 0) == Vec3d(0, 0, -1));
    CHECK(normalOf(fan.meshes[0], 1) == Vec3d(0, 0, 1));
    CHECK(normalOf(fan.meshes[0], 2) == Vec3d(0, 0, -2));
    const Scene list = zigzag(4);
    CHECK(list.triangleCount() == 1);
    CHECK(countWarnings(list, "Incomplete last triangles") == 1);
    for (int mode = 0; mode < 4; ++mode) {
        const Scene skipped = zigzag(mode);
        CHECK(skipped.triangleCount() == 0);
        CHECK(countWarnings(skipped, "Points and lines") == 1);
    }
}

TEST_CASE("scene: strides and normalised integers", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    // 20 bytes a vertex: position (12), uv as 2 × u16 (4), colour as 4 × u8 (4).
    std::string interleaved;
    const std::uint16_t uv[3][2] = {{0, 65535}, {13107, 0}, {65535, 32768}};
    const std::uint8_t color[3][4] = {{255, 0, 51, 255}, {0, 255, 0, 128}, {1, 2, 3, 0}};
    for (std::size_t v = 0; v < 3; ++v) {
        interleaved.append(reinterpret_cast<const char*>(&kTriangle[v * 3]), 12);
        interleaved.append(reinterpret_cast<const char*>(uv[v]), 4);
        interleaved.append(reinterpret_cast<const char*>(color[v]), 4);
    }
    const int view = b.view(interleaved, 20);
    b.accessor(view, 5126, 3, "VEC3");
    b.accessor(view, 5123, 3, "VEC2", R"("byteOffset":12,"normalized":true)");
    b.accessor(view, 5121, 3, "VEC4", R"("byteOffset":16,"normalized":true)");
    const Scene scene = load(folder, b.gltf(R"("meshes":[{"primitives":[{"attributes":
            {"POSITION":0,"TEXCOORD_1":1,"COLOR_0":2}}]}],"nodes":[{"mesh":0}])"));
    REQUIRE(scene.triangleCount() == 1);
    const Mesh& mesh = scene.meshes[0];
    CHECK(mesh.positions[1] == Vec3d(1, 0, 0));
    CHECK(mesh.uv[0].empty());
    REQUIRE(mesh.uv[1].size() == 3);
    CHECK(mesh.uv[1][0] == Vec2f(0, 1));
    CHECK(mesh.uv[1][1].x == Approx(13107 / 65535.0));
    CHECK(mesh.uv[1][2].y == Approx(32768 / 65535.0));
    REQUIRE(mesh.colors.size() == 3);
    // Vertex colours are linear already: 51/255 stays 0.2.
    CHECK(mesh.colors[0] == std::array<float, 4>{1, 0, 0.2f, 1});
    CHECK(mesh.colors[1][3] == Approx(128 / 255.0));
}

TEST_CASE("scene: sparse accessors", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    const int base = b.view(bytesOf(kTriangle));
    const int at = b.view(bytesOf(std::vector<std::uint8_t>{1}));
    const int value = b.view(bytesOf(std::vector<float>{5, 0, 0}));
    const std::string sparse = R"("sparse":{"count":1,"indices":{"bufferView":)"
        + std::to_string(at) + R"(,"componentType":5121},"values":{"bufferView":)"
        + std::to_string(value) + "}}";
    b.accessor(base, 5126, 3, "VEC3", sparse);
    // Without a base view the rest is zeros: the texture coordinates below are (0,0) (5,0) (0,0).
    b.accessor(-1, 5126, 3, "VEC2", sparse);
    const Scene scene = load(
        folder, b.gltf(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0,"TEXCOORD_0":1}}]}],
            "nodes":[{"mesh":0}])"));
    REQUIRE(scene.triangleCount() == 1);
    CHECK(scene.meshes[0].positions[1] == Vec3d(5, 0, 0));
    CHECK(scene.meshes[0].positions[2] == Vec3d(0, 1, 0));
    REQUIRE(scene.meshes[0].uv[0].size() == 3);
    CHECK(scene.meshes[0].uv[0][0] == Vec2f(0, 0));
    CHECK(scene.meshes[0].uv[0][1] == Vec2f(5, 0));
}

TEST_CASE("scene: degenerate triangles are dropped and counted", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    // One good, one with a repeated corner, one collinear (thirds: not exact in binary).
    b.vec3({0, 0, 0, 1, 0, 0, 0, 1, 0, 0.25f, 0.5f, 0, 0.5f, 1, 0});
    b.indices({0, 1, 2, 1, 1, 2, 0, 3, 4});
    const std::string text
        = b.gltf(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
            "nodes":[{"mesh":0}])");
    const Scene scene = load(folder, text);
    CHECK(scene.triangleCount() == 1);
    CHECK(countWarnings(scene, "2 degenerate triangles") == 1);
    // Scaling to a plane through the edge makes the remaining one degenerate too.
    GltfBuilder flat;
    const Scene none = load(folder, triangleGltf(flat, "", "", R"("mesh":0,"scale":[1,0,1])"));
    CHECK(none.triangleCount() == 0);
    CHECK(countWarnings(none, "no triangles") == 1);
}

TEST_CASE("scene: only the vertices that triangles use are kept", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3({9, 9, 9, 0, 0, 0, 9, 9, 9, 1, 0, 0, 0, 1, 0});
    b.indices({1, 3, 4});
    const Scene scene = load(
        folder, b.gltf(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
            "nodes":[{"mesh":0}])"));
    REQUIRE(scene.triangleCount() == 1);
    CHECK(scene.meshes[0].positions.size() == 3);
    CHECK(scene.bounds().max == Vec3d(1, 1, 0));
}

TEST_CASE("scene: the default scene, else the first, else all roots", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3(kTriangle);
    const std::string common = R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "nodes":[{"mesh":0},{"mesh":0,"translation":[5,0,0]}])";
    const std::string scenes = R"(,"scenes":[{"nodes":[0]},{"nodes":[1],"name":"other"}])";
    const Scene first = load(folder, b.gltf(common + scenes));
    CHECK(first.bounds().min.x == 0);
    CHECK(countWarnings(first, "2 scenes") == 1);
    const Scene second = load(folder, b.gltf(common + scenes + R"(,"scene":1)"));
    CHECK(second.bounds().min.x == 5);
    CHECK(countWarnings(second, "'other'") == 1);
    CHECK(load(folder, b.gltf(common)).triangleCount() == 2);
}

TEST_CASE("scene: GLB and non-ASCII paths", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3(kTriangle);
    const std::string rest = R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "nodes":[{"mesh":0}])";
    const std::string path = folder.write("Zimmer-ü-室/szene ö.glb", b.glb(rest));
    CHECK(loadScene(path).triangleCount() == 1);
    // The container is told by its first bytes, not by the name.
    CHECK(loadScene(folder.write("binary.gltf", b.glb(rest))).triangleCount() == 1);
    CHECK(loadScene(folder.write("text.GLB", b.gltf(rest))).triangleCount() == 1);
}

TEST_CASE("scene: a scene without triangles is allowed", "[scene]")
{
    const TempFolder folder;
    const Scene scene = load(folder, R"({"asset":{"version":"2.0"}})");
    CHECK(scene.triangleCount() == 0);
    CHECK(scene.bounds().isEmpty());
    CHECK(scene.materials.size() == 1);
    CHECK(countWarnings(scene, "no triangles") == 1);
    CHECK(countWarnings(scene, "Nothing emits light") == 1);
    CHECK(scene.contentHash.size() == 16);
}

TEST_CASE("scene: a chain of 20,000 nodes needs no stack", "[scene]")
{
    const TempFolder folder;
    GltfBuilder b;
    b.vec3(kTriangle);
    std::string nodes;
    const int count = 20000;
    for (int i = 0; i < count; ++i) {
        nodes += R"({"translation":[1,0,0],"children":[)" + std::to_string(i + 1) + "]},";
    }
    const Scene scene = load(folder,
        b.gltf(R"("meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[)" + nodes
            + R"({"mesh":0}],"scenes":[{"nodes":[0]}])"));
    REQUIRE(scene.triangleCount() == 1);
    CHECK(scene.bounds().min.x == count);
}
