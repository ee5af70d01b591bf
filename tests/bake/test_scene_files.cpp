// SPDX-License-Identifier: Apache-2.0
#include "scene_fixture.h"

#include <catch2/catch.hpp>

#include <algorithm>

using namespace lumivdb;
using namespace scene_test;

namespace {

const std::string kAssets = LUMIVDB_ASSETS;

bool present(const std::string& path)
{
    if (std::filesystem::exists(path)) return true;
    WARN("skipped: " << path << " is not there");
    return false;
}

void checkBox(const Box3d& box, const Vec3d& min, const Vec3d& max, double tolerance)
{
    CHECK((box.min - min).length() < tolerance);
    CHECK((box.max - max).length() < tolerance);
}

} // namespace

TEST_CASE("scene: OBJ with materials", "[scene]")
{
    const TempFolder folder;
    folder.write("maps/red.png", png(1, 2, 3, {255, 0, 0, 0, 0, 255}));
    folder.write("room.mtl",
        "newmtl brick\nKd 0.5 0.25 0.125\nmap_Kd maps\\red.png\n"
        "newmtl lamp\nKd 0 0 0\nKe 3 2 1\n"
        "newmtl glass\nKd 1 1 1\nd 0.25\n"
        "newmtl missing\nKd 1.5 1 1\nmap_Kd nowhere.png\n");
    const Scene scene = loadScene(folder.write("zimmer ü.obj",
        "mtllib room.mtl\n"
        "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 5\n"
        "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
        "usemtl brick\nf 1/1 2/2 3/3 4/4\n" // a quad: two triangles
        "usemtl lamp\nf 1 2 5\n"
        "usemtl glass\nf 2 3 5\n"
        "usemtl missing\nf 3/3 4/4 5/1\nf 3/3 3/3 5/1\n")); // the last one is degenerate
    CHECK(scene.triangleCount() == 5);
    const auto materialOf = [&](const char* name) -> const Material& {
        for (const Material& m : scene.materials) {
            if (m.name == name) return m;
        }
        FAIL("no material " << name);
        return scene.materials[0];
    };
    CHECK(materialOf("brick").baseColor == Color(0.5f, 0.25f, 0.125f));
    CHECK(materialOf("lamp").emission == Color(3, 2, 1));
    CHECK(materialOf("glass").alphaMask);
    CHECK(materialOf("glass").alphaFactor == 0.25f);
    CHECK(materialOf("missing").baseColor == Color(1, 1, 1));
    CHECK(materialOf("missing").baseColorTexture.texture == -1);
    CHECK(countWarnings(scene, "taken as white: nowhere.png (there is no such file).") == 1);
    CHECK(countWarnings(scene, "clamped: missing") == 1);
    CHECK(countWarnings(scene, "1 degenerate triangles") == 1);
    CHECK(countWarnings(scene, "alpha is below 0.5: glass") == 1);

    // OBJ's v grows upwards: vertex (1,1) has vt (1,1) and must see the top row, which is red.
    const int slot = materialOf("brick").baseColorTexture.texture;
    REQUIRE(slot >= 0);
    bool found = false;
    for (const Mesh& mesh : scene.meshes) {
        if (&scene.materials[static_cast<std::size_t>(mesh.material)] != &materialOf("brick")) {
            continue;
        }
        for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
            CHECK(normalOf(mesh, 0).z > 0); // winding is kept
            if (mesh.positions[v] != Vec3d(1, 1, 0)) continue;
            Texture nearest = scene.textures[static_cast<std::size_t>(slot)];
            nearest.wrapV = WrapMode::ClampToEdge;
            CHECK(nearest.sample(mesh.uv[0][v].x, mesh.uv[0][v].y)[0] == 1.0f);
            found = true;
        }
    }
    CHECK(found);
}

TEST_CASE("scene: OBJ without materials has albedo 1", "[scene]")
{
    const TempFolder folder;
    const std::string faces = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    const Scene none = loadScene(folder.write("plain.obj", faces));
    REQUIRE(none.triangleCount() == 1);
    const auto albedo = [](const Scene& s) {
        return s.materials[static_cast<std::size_t>(s.meshes.at(0).material)].baseColor;
    };
    CHECK(albedo(none) == Color(1, 1, 1));
    CHECK(countWarnings(none, "albedo 1") == 1);
    const Scene lost
        = loadScene(folder.write("lost.obj", "mtllib gone.mtl\nusemtl brick\n" + faces));
    REQUIRE(lost.triangleCount() == 1);
    CHECK(albedo(lost) == Color(1, 1, 1));
    CHECK(countWarnings(lost, "missing: gone.mtl") == 1);
}

TEST_CASE("scene: other formats that Assimp reads", "[scene]")
{
    const TempFolder folder;
    const Scene ply = loadScene(folder.write("t.ply",
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"));
    REQUIRE(ply.triangleCount() == 1);
    CHECK(normalOf(ply.meshes[0], 0) == Vec3d(0, 0, 1));
}

TEST_CASE("scene: Cornell box", "[scene]")
{
    const std::string path = kAssets + "/cornell-bitterli/cornell-bitterli.glb";
    if (!present(path)) return;
    const Scene scene = loadScene(path);
    CHECK(scene.triangleCount() == 36);
    checkBox(scene.bounds(), Vec3d(-1, 0, -1), Vec3d(1, 2, 1), 1e-6);
    int lamps = 0;
    for (const Mesh& mesh : scene.meshes) {
        const Material& m = scene.materials[static_cast<std::size_t>(mesh.material)];
        if (m.emission == Color(0, 0, 0)) continue;
        CHECK(m.emission == Color(17, 12, 4));
        for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
            CHECK(normalOf(mesh, t).y < 0); // the light faces down
            ++lamps;
        }
    }
    CHECK(lamps == 2);
    CHECK(scene.warnings.empty());
    REQUIRE(scene.cameras.size() == 1);
    CHECK(scene.contentHash == loadScene(path).contentHash);
}

TEST_CASE("scene: lamp with punctual lights", "[scene]")
{
    const std::string path = kAssets + "/lights-punctual-lamp/LightsPunctualLamp.gltf";
    if (!present(path)) return;
    const Scene scene = loadScene(path);
    CHECK(scene.triangleCount() == 6000);
    REQUIRE(scene.lights.size() == 5);
    double brightest = 0, sum = 0;
    for (const Light& light : scene.lights) {
        CHECK(light.type == LightType::Point);
        const double candela = std::max({light.intensity.x, light.intensity.y, light.intensity.z});
        brightest = std::max(brightest, candela);
        sum += candela <= 15 ? candela : 0; // 15 and 1.5 cd have a colour whose largest part is 1
    }
    CHECK(brightest == Approx(180));
    CHECK(sum == Approx(16.5));
    CHECK(countWarnings(scene, "KHR_materials_transmission is ignored") == 1);
    CHECK(scene.materials[0].emissionTexture.texture >= 0);
}

TEST_CASE("scene: Crytek Sponza", "[scene]")
{
    const std::string path = kAssets + "/sponza-crytek/sponza.glb";
    if (!present(path)) return;
    const Scene scene = loadScene(path);
    CHECK(scene.triangleCount() == 262267 - 1); // one is degenerate
    CHECK(countWarnings(scene, "1 degenerate triangles") == 1);
    checkBox(scene.bounds(), Vec3d(-15.37, -1.01, -9.46), Vec3d(14.40, 11.44, 8.84), 0.01);
    int masks = 0;
    for (const Material& m : scene.materials) {
        masks += m.alphaMask;
        CHECK(m.baseColor.x == Approx(0.588));
        CHECK(m.baseColorTexture.texture >= 0);
    }
    CHECK(masks == 3);
    CHECK(countWarnings(scene, "Nothing emits light") == 1);
    CHECK(countWarnings(scene, "cannot be read") == 0);
}

TEST_CASE("scene: Dabrovic Sponza", "[scene]")
{
    const std::string path = kAssets + "/sponza-dabrovic/sponza.obj";
    if (!present(path)) return;
    const Scene scene = loadScene(path);
    CHECK(scene.triangleCount() == 66450 - 7);
    CHECK(countWarnings(scene, "7 degenerate triangles") == 1);
    CHECK(countWarnings(scene, "cannot be read") == 0);
    CHECK(scene.textures.size() == 13);
    for (const Mesh& mesh : scene.meshes) {
        CHECK(
            scene.materials[static_cast<std::size_t>(mesh.material)].baseColorTexture.texture >= 0);
    }
}
