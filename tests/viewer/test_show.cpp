// SPDX-License-Identifier: Apache-2.0
// Pictures of what a volume is made of: its levels, its samples, its error.
#include <lumivdb/viewer/picture.h>

#include <lumivdb/core/error.h>

#include <catch2/catch.hpp>

#include <cmath>

using namespace lumivdb;

namespace {

constexpr double kPi = 3.14159265358979323846;

/// A lamp all round: a box of half-width 50 whose inside shines with radiance 1.
Tracer lampTracer()
{
    Scene scene;
    Material material;
    material.baseColor = Color(0);
    material.emission = Color(1);
    material.doubleSided = true;
    scene.materials.push_back(material);
    Mesh mesh;
    mesh.material = 0;
    for (int i = 0; i < 8; ++i)
        mesh.positions.push_back(
            {i & 1 ? 50.0 : -50.0, i & 2 ? 50.0 : -50.0, i & 4 ? 50.0 : -50.0});
    const unsigned faces[6][4]
        = {{0, 2, 6, 4}, {1, 5, 7, 3}, {0, 4, 5, 1}, {2, 3, 7, 6}, {0, 1, 3, 2}, {4, 6, 7, 5}};
    for (const auto& f : faces) {
        mesh.triangles.push_back({f[0], f[1], f[2]});
        mesh.triangles.push_back({f[0], f[2], f[3]});
    }
    scene.meshes.push_back(mesh);
    return Tracer(std::make_shared<const Scene>(std::move(scene)));
}

/// One cell of width 2 beside eight of width 1, along x; radiance @a L from everywhere, so that
/// L00 = √(4π) L and E = π L on every normal.
IrradianceVolume twoLevels(float L)
{
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(1));
    builder.addCell({0, 0, 0}, 1);
    builder.addUniform({2, 0, 0}, {4, 2, 2});
    IrradianceVolume volume = builder.build();
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        volume.radiance(s)[0] = Color(L * float(std::sqrt(4 * kPi)));
        volume.validity(s) = 1;
    }
    return volume;
}

SliceOptions ground()
{
    SliceOptions options;
    options.position = 0.5;
    options.width = 400;
    return options;
}

const Color& at(const Image& image, int x, int y)
{
    return image.pixels[std::size_t(y) * image.width + x];
}

bool isRed(const Color& c) { return c.x > 0.1f && c.x > 10 * c.y && c.x > 10 * c.z; }

} // namespace

TEST_CASE("levels: a colour for each level and an outline for each cell", "[show]")
{
    const Tracer tracer = lampTracer();
    const Image image = renderLevels(tracer, twoLevels(1), ground());
    // 4 by 2 cells of the lattice, 100 pixels each.
    REQUIRE(image.width == 400);
    REQUIRE(image.height == 200 + kLegendRows);
    const Color coarse = at(image, 50, 50), fine = at(image, 250, 50);
    CHECK((coarse - fine).length() > 0.3f);
    for (const auto& p : {std::pair{99, 101}, {150, 20}, {20, 150}, {198, 198}})
        CHECK(at(image, p.first, p.second) == coarse);
    for (const auto& p : {std::pair{210, 10}, {298, 150}, {302, 150}, {390, 190}})
        CHECK(at(image, p.first, p.second) == fine);
    // Outlines: none in the middle of the coarse cell, one between the fine ones.
    CHECK(at(image, 100, 50) == coarse);
    CHECK(at(image, 300, 50) == fine * 0.35f);
    CHECK(at(image, 250, 100) == fine * 0.35f);
    CHECK(at(image, 200, 50) == fine * 0.35f);
}

TEST_CASE("levels: surfaces are white lines", "[show]")
{
    Scene scene;
    scene.materials.emplace_back();
    Mesh wall; // the plane x = 1.5
    wall.material = 0;
    wall.positions = {{1.5, -5, -5}, {1.5, 5, -5}, {1.5, 5, 5}, {1.5, -5, 5}};
    wall.triangles = {{0, 1, 2}, {0, 2, 3}};
    scene.meshes.push_back(wall);
    const Tracer tracer(std::make_shared<const Scene>(std::move(scene)));
    const Image image = renderLevels(tracer, twoLevels(1), ground());
    for (int y : {20, 130}) {
        CHECK(at(image, 149, y) == Color(1));
        CHECK(at(image, 150, y) == Color(1));
        CHECK_FALSE(at(image, 146, y) == Color(1));
        CHECK_FALSE(at(image, 153, y) == Color(1));
    }
}

TEST_CASE("error: the share that a volume is off by, everywhere", "[show]")
{
    // The scene gives E = π on every normal, the volume π · 1.25: an error of 25%.
    const Tracer tracer = lampTracer();
    ErrorMapOptions options;
    options.slice = ground();
    options.blocks = 8;
    options.reference.rays = 4096;
    ErrorMapReport report;
    const Image image = renderError(tracer, twoLevels(1.25f), options, &report);
    REQUIRE(image.width == 400);
    REQUIRE(image.height == 200 + kLegendRows);
    CHECK(report.points == 8 * 4);
    CHECK(report.meanReference == Approx(kPi).epsilon(0.01));
    CHECK(report.meanError == Approx(0.25).margin(0.01));
    CHECK(report.meanNoise < 0.01);
    CHECK(report.low <= report.meanError);
    CHECK(report.high >= report.meanError);
}

TEST_CASE("error: where it is wrong, not where it is right", "[show]")
{
    const Tracer tracer = lampTracer();
    IrradianceVolume volume = twoLevels(1);
    for (SampleId s = 0; s < volume.sampleCount(); ++s)
        if (volume.samplePosition(s).x == 4) volume.radiance(s)[0] *= 3.0f;
    ErrorMapOptions options;
    options.slice = ground();
    options.blocks = 40;
    options.reference.rays = 256;
    ErrorMapReport report;
    const Image image = renderError(tracer, volume, options, &report);
    // Dark (low) on the left, the brightest of viridis on the right.
    CHECK(luminance(at(image, 395, 100)) > 0.6f);
    CHECK(luminance(at(image, 250, 100)) < 0.5f);
    CHECK(report.high > 1.5);
    const Image again = renderError(tracer, volume, options, nullptr);
    CHECK(again.pixels == image.pixels);
    options.blocks = 0;
    CHECK_THROWS_AS(renderError(tracer, volume, options, nullptr), Error);
}

TEST_CASE("probes: a sphere where each sample was measured, invalid ones red", "[show]")
{
    // The room is a lamp of radiance 1 behind the spheres; a sphere has 0.8/π · E = 0.8 · 0.5.
    const Tracer tracer = lampTracer();
    IrradianceVolume volume = twoLevels(0.5f);
    PictureOptions options;
    options.width = options.height = 200;
    options.samplesPerPixel = 1;
    options.probes = true;
    options.eye = Vec3d(3, 1, 12);
    options.target = Vec3d(3, 1, 0);
    // Half the field of view is 4 at the depth of z = 2, 10 away.
    options.yfovDegrees = 2 * std::atan(0.4) * 180 / kPi;
    const auto pixel = [](double x, double y) {
        return std::pair{int(100 + (x - 3) / 4 * 100), int(100 - (y - 1) / 4 * 100)};
    };
    Image image = renderPicture(tracer, volume, options);
    const auto look = [&](double x, double y) {
        const auto p = pixel(x, y);
        return at(image, p.first, p.second);
    };
    for (int y = 0; y <= 2; ++y)
        for (int x = 2; x <= 4; ++x) CHECK(look(x, y).x == Approx(0.4f).epsilon(1e-4));
    // The coarse cell has corners at x = 0 and nothing at its middle.
    CHECK(look(0, 0).x == Approx(0.4f).epsilon(1e-4));
    CHECK(look(1, 1).x == Approx(1).epsilon(1e-6));
    CHECK(look(2.5, 0.5).x == Approx(1).epsilon(1e-6));

    for (SampleId s = 0; s < volume.sampleCount(); ++s)
        if (volume.samplePosition(s) == Coord(3, 1, 2)) volume.validity(s) = 0.2f;
    image = renderPicture(tracer, volume, options);
    CHECK(isRed(look(3, 1)));
    CHECK_FALSE(isRed(look(4, 1)));
}

TEST_CASE("probes: surfaces hide them", "[show]")
{
    Scene scene;
    scene.materials.emplace_back();
    Mesh wall; // z = 5, before all samples
    wall.material = 0;
    wall.positions = {{-50, -50, 5}, {50, -50, 5}, {50, 50, 5}, {-50, 50, 5}};
    wall.triangles = {{0, 1, 2}, {0, 2, 3}};
    scene.meshes.push_back(wall);
    const Tracer tracer(std::make_shared<const Scene>(std::move(scene)));
    PictureOptions options;
    options.width = options.height = 64;
    options.probes = true;
    options.eye = Vec3d(3, 1, 12);
    options.target = Vec3d(3, 1, 0);
    // The wall lies outside the volume, where there is no light to show.
    for (const Color& c : renderPicture(tracer, twoLevels(1), options).pixels)
        REQUIRE(c == Color(0));
}
