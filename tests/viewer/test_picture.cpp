// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/viewer/picture.h>

#include <lumivdb/bake/environment.h>
#include <lumivdb/core/error.h>

#include <catch2/catch.hpp>
#include <tbb/global_control.h>

#include <cmath>
#include <functional>

using namespace lumivdb;

namespace {

constexpr double kPi = 3.14159265358979323846;

/// A quad a, b, c, d, counter-clockwise seen from its front.
void addQuad(
    Scene& scene, int material, const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec3d& d)
{
    Mesh mesh;
    mesh.material = material;
    mesh.positions = {a, b, c, d};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    scene.meshes.push_back(mesh);
}

int addMaterial(Scene& scene, const Color& albedo, const Color& emission, bool doubleSided)
{
    Material material;
    material.baseColor = albedo;
    material.emission = emission;
    material.doubleSided = doubleSided;
    scene.materials.push_back(material);
    return int(scene.materials.size()) - 1;
}

/// The floor y = 0 with its front up.
void addFloor(Scene& scene, int material, double half)
{
    addQuad(
        scene, material, {-half, 0, half}, {half, 0, half}, {half, 0, -half}, {-half, 0, -half});
}

/// Inside faces of a box, without the sides of @a open (bits: −x, +x, −y, +y, −z, +z).
void addRoom(Scene& scene, int material, const Vec3d& lo, const Vec3d& hi, int open)
{
    const auto corner = [&](int i) {
        return Vec3d(i & 1 ? hi.x : lo.x, i & 2 ? hi.y : lo.y, i & 4 ? hi.z : lo.z);
    };
    const int faces[6][4]
        = {{0, 2, 6, 4}, {1, 5, 7, 3}, {0, 4, 5, 1}, {2, 3, 7, 6}, {0, 1, 3, 2}, {4, 6, 7, 5}};
    for (int f = 0; f < 6; ++f)
        if (!(open >> f & 1))
            addQuad(scene, material, corner(faces[f][0]), corner(faces[f][1]), corner(faces[f][2]),
                corner(faces[f][3]));
}

/// A volume over [−half, half]³ of 2 bands whose radiance is L(d) = a + b·d_y (same everywhere).
/// With Y00 = 1/√(4π), Y1 = −√(3/4π) y: L00 = a √(4π), L1 = −b √(4π/3).
IrradianceVolume ambient(double half, const Color& a, const Color& b)
{
    VolumeBuilder builder(2, GradientStorage::None, latticeTransform(half));
    builder.addUniform({-1, -1, -1}, {1, 1, 1});
    IrradianceVolume volume = builder.build();
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        volume.radiance(s)[0] = a * float(std::sqrt(4 * kPi));
        volume.radiance(s)[1] = b * float(-std::sqrt(4 * kPi / 3));
        volume.validity(s) = 1;
    }
    return volume;
}

Tracer trace(Scene scene) { return Tracer(std::make_shared<const Scene>(std::move(scene))); }

PictureOptions lookDown(double height)
{
    PictureOptions options;
    options.width = options.height = 16;
    options.samplesPerPixel = 4;
    options.eye = Vec3d(0.01, height, 0.02);
    options.target = Vec3d(0, 0, 0);
    options.spheres = 0;
    return options;
}

void requireEverywhere(const Image& image, const Color& expected)
{
    REQUIRE(image.pixels.size() == std::size_t(image.width) * image.height);
    REQUIRE(!image.pixels.empty());
    for (const Color& p : image.pixels)
        for (int c = 0; c < 3; ++c)
            REQUIRE(p[c] == Approx(expected[c]).epsilon(2e-6).margin(1e-12));
}

std::size_t countPixels(const Image& image, const std::function<bool(const Color&)>& is)
{
    std::size_t n = 0;
    for (const Color& p : image.pixels) n += is(p);
    return n;
}

bool near(const Color& p, float value) { return std::abs(p.x - value) < 1e-5f * value; }

struct CancelAfter : Progress {
    bool cancelled() override { return true; }
};

} // namespace

TEST_CASE("a plane under constant radiance reflects albedo times radiance", "[picture]")
{
    // E = π L on every normal; the pixel is albedo/π · E = albedo · L.
    Scene scene;
    addFloor(scene, addMaterial(scene, {0.25f, 0.5f, 0.75f}, {0, 0, 0}, false), 2);
    const Tracer tracer = trace(std::move(scene));
    const IrradianceVolume volume = ambient(4, {2, 3, 4}, {0, 0, 0});
    requireEverywhere(renderPicture(tracer, volume, lookDown(1)), {0.5f, 1.5f, 3.0f});
}

TEST_CASE("the side that is seen decides the normal", "[picture]")
{
    // L(d) = 1 + d_y/2 gives E(n) = π + (2π/3) n_y/2, so albedo · 4/3 from above, 2/3 from below.
    const IrradianceVolume volume = ambient(4, {1, 1, 1}, {0.5f, 0.5f, 0.5f});
    for (bool doubleSided : {false, true}) {
        Scene scene;
        addFloor(scene, addMaterial(scene, {0.6f, 0.6f, 0.6f}, {0, 0, 0}, doubleSided), 2);
        const Tracer tracer = trace(std::move(scene));
        requireEverywhere(renderPicture(tracer, volume, lookDown(1)), Color(0.8f));
        requireEverywhere(
            renderPicture(tracer, volume, lookDown(-1)), Color(doubleSided ? 0.4f : 0.0f));
    }
}

TEST_CASE("negative irradiance reflects nothing, emission is added", "[picture]")
{
    Scene scene;
    addFloor(scene, addMaterial(scene, {0.5f, 0.5f, 0.5f}, {7, 8, 9}, false), 2);
    const Tracer tracer = trace(std::move(scene));
    const IrradianceVolume negative = ambient(4, {-1, 1, -1}, {0, 0, 0});
    requireEverywhere(renderPicture(tracer, negative, lookDown(1)), {7, 8.5f, 9});
}

TEST_CASE("outside the volume only emission is seen", "[picture]")
{
    Scene scene;
    addFloor(scene, addMaterial(scene, {0.5f, 0.5f, 0.5f}, {1, 2, 3}, false), 50);
    const Tracer tracer = trace(std::move(scene));
    PictureOptions options = lookDown(1);
    options.eye = Vec3d(30.01, 1, 30.02);
    options.target = Vec3d(30, 0, 30);
    requireEverywhere(renderPicture(tracer, ambient(4, {1, 1, 1}, {0, 0, 0}), options), {1, 2, 3});
}

TEST_CASE("a wall in a lattice plane takes the light of its own side", "[picture]")
{
    // The wall lies in the lattice plane y = 0. On the side that is seen L = 1; the samples on the
    // wall and behind it are invalid, as they are when they see its back, and hold L = 100. Asked
    // exactly on the plane, one side of the two would be answered by the other's cell.
    for (double side : {1.0, -1.0}) {
        IrradianceVolume volume = ambient(4, {1, 1, 1}, {0, 0, 0});
        for (SampleId s = 0; s < volume.sampleCount(); ++s) {
            if (volume.sampleWorld(s).y * side > 0.1) continue;
            volume.validity(s) = 0;
            volume.radiance(s)[0] *= 100;
        }
        Scene scene;
        addFloor(scene, addMaterial(scene, {0.5f, 0.5f, 0.5f}, {0, 0, 0}, true), 2);
        const Tracer tracer = trace(std::move(scene));
        requireEverywhere(renderPicture(tracer, volume, lookDown(side)), Color(0.5f));
    }
}

TEST_CASE("the background is the environment, black without one", "[picture]")
{
    const IrradianceVolume volume = ambient(4, {1, 1, 1}, {0, 0, 0});
    Scene scene;
    addMaterial(scene, {1, 1, 1}, {0, 0, 0}, false);
    requireEverywhere(renderPicture(trace(scene), volume, lookDown(1)), Color(0));
    scene.environment = Environment::constant({5, 6, 7});
    requireEverywhere(renderPicture(trace(scene), volume, lookDown(1)), {5, 6, 7});
}

TEST_CASE("test spheres: size and shading", "[picture][spheres]")
{
    const IrradianceVolume volume = ambient(4, {1, 1, 1}, {0, 0, 0});
    Scene scene;
    addMaterial(scene, {1, 1, 1}, {0, 0, 0}, false);
    const Tracer tracer = trace(scene);
    PictureOptions options;
    options.width = options.height = 400;
    options.samplesPerPixel = 1;
    options.eye = Vec3d(0, 0, 3);
    options.target = Vec3d(0, 0, 0);
    for (int count : {1, 5}) {
        options.spheres = count;
        const Image image = renderPicture(tracer, volume, options);
        const std::size_t n = countPixels(image, [](const Color& p) { return near(p, 0.8f); });
        // A disc of 4% of the width each; perspective stretches those off the axis: +20% at most.
        const double disc = kPi * 16 * 16;
        CHECK(double(n) > 0.99 * disc * count);
        CHECK(double(n) < 1.2 * disc * count);
        CHECK(n + countPixels(image, [](const Color& p) { return p == Color(0); })
            == image.pixels.size());
    }
}

TEST_CASE("a sphere shows the irradiance of its normals", "[picture][spheres]")
{
    // L(d) = 1 + d_y: pixel = 0.8 (1 + (2/3) n_y). Over the visible disc n_y runs from −1 to 1.
    const IrradianceVolume volume = ambient(4, {1, 1, 1}, {1, 1, 1});
    Scene scene;
    addMaterial(scene, {1, 1, 1}, {0, 0, 0}, false);
    PictureOptions options;
    options.width = options.height = 800;
    options.samplesPerPixel = 1;
    options.spheres = 1;
    options.eye = Vec3d(0, 0, 3);
    options.target = Vec3d(0, 0, 0);
    const Image image = renderPicture(trace(scene), volume, options);
    float low = 1e9f, high = 0;
    for (const Color& p : image.pixels) {
        if (p == Color(0)) continue;
        low = std::min(low, p.x);
        high = std::max(high, p.x);
    }
    CHECK(low == Approx(0.8 / 3).margin(0.03));
    CHECK(high == Approx(0.8 * 5 / 3).margin(0.03));
    CHECK(low >= 0.8f / 3 - 1e-4f);
    CHECK(high <= 0.8f * 5 / 3 + 1e-4f);

    // From above only the upper half is seen: n_y from about 0 to 1.
    options.eye = Vec3d(0, 3, 0);
    const Image above = renderPicture(trace(scene), volume, options);
    low = 1e9f;
    for (const Color& p : above.pixels)
        if (p != Color(0)) low = std::min(low, p.x);
    CHECK(low > 0.75f * 0.8f);
    CHECK(low < 0.85f); // the rim: n_y = radius / distance = 0.04
}

TEST_CASE("spheres come forward of walls and stay out of geometry", "[picture][spheres]")
{
    const IrradianceVolume volume = ambient(8, {1, 1, 1}, {0, 0, 0});
    Scene scene;
    const int grey = addMaterial(scene, {0.3f, 0.3f, 0.3f}, {0, 0, 0}, true);
    addQuad(scene, grey, {-9, -9, 1}, {9, -9, 1}, {9, 9, 1}, {-9, 9, 1});
    const Tracer tracer = trace(scene);
    PictureOptions options;
    options.width = options.height = 200;
    options.samplesPerPixel = 1;
    options.eye = Vec3d(0, 0, 3);
    options.target = Vec3d(0, 0, -3); // behind the wall
    const Image image = renderPicture(tracer, volume, options);
    const std::size_t n = countPixels(image, [](const Color& p) { return near(p, 0.8f); });
    CHECK(double(n) > 5 * 0.99 * kPi * 8 * 8);
    CHECK(n + countPixels(image, [](const Color& p) { return near(p, 0.3f); })
        == image.pixels.size());

    // Two plates 0.04 apart along the line of sight: the smallest sphere tried has radius 0.034.
    Scene plates;
    const int plate = addMaterial(plates, {0.3f, 0.3f, 0.3f}, {0, 0, 0}, true);
    for (double x : {-0.02, 0.02})
        addQuad(plates, plate, {x, -3, -5}, {x, -3, 2.5}, {x, 3, 2.5}, {x, 3, -5});
    options.spheres = 1;
    const Image slit = renderPicture(trace(plates), volume, options);
    CHECK(countPixels(slit, [](const Color& p) { return near(p, 0.8f); }) == 0);
    CHECK(countPixels(slit, [](const Color& p) { return near(p, 0.3f); }) > 0);
}

TEST_CASE("geometry in front hides a part of a sphere", "[picture][spheres]")
{
    // The sphere's middle is at t = 0.58, on the line y = −0.16 tan 25° = −0.0746 one metre away;
    // its radius there is 0.0373. A board from −0.07 upwards hides nearly half of it.
    Scene scene;
    const int board = addMaterial(scene, {0.3f, 0.3f, 0.3f}, {0, 0, 0}, true);
    addQuad(scene, board, {-9, -0.07, 2}, {9, -0.07, 2}, {9, 9, 2}, {-9, 9, 2});
    PictureOptions options;
    options.width = options.height = 400;
    options.samplesPerPixel = 1;
    options.spheres = 1;
    options.eye = Vec3d(0, 0, 3);
    options.target = Vec3d(0, 0, 0);
    const Image image = renderPicture(trace(scene), ambient(8, {1, 1, 1}, {0, 0, 0}), options);
    const auto n = double(countPixels(image, [](const Color& p) { return near(p, 0.8f); }));
    CHECK(n > 0.5 * kPi * 16 * 16);
    CHECK(n < 0.65 * kPi * 16 * 16);
}

TEST_CASE("spheres stay inside a small volume", "[picture][spheres]")
{
    Scene scene;
    addMaterial(scene, {1, 1, 1}, {0, 0, 0}, false);
    scene.environment = Environment::constant({5, 5, 5});
    PictureOptions options;
    options.width = options.height = 200;
    options.samplesPerPixel = 1;
    options.eye = Vec3d(0, 0, 3);
    options.target = Vec3d(0, 0, 0);
    const Image image = renderPicture(trace(scene), ambient(0.7, {1, 1, 1}, {0, 0, 0}), options);
    const auto n = double(countPixels(image, [](const Color& p) { return near(p, 0.8f); }));
    CHECK(n > 5 * 0.5 * kPi * 8 * 8);
    // Outside they would have been black.
    CHECK(countPixels(image, [](const Color& p) { return p.x < 0.7f; }) == 0);
}

TEST_CASE("default cameras show the inside of rooms", "[picture][camera]")
{
    const IrradianceVolume volume = ambient(8, {1, 1, 1}, {0, 0, 0});
    PictureOptions options;
    options.width = 64;
    options.height = 36;
    options.spheres = 0;
    const auto lit = [](const Color& p) { return p.x > 0.2f; };
    // Single-sided walls: from outside they are black.
    for (int open : {0, 1 << 0, 1 << 1, 1 << 4, 1 << 5, 1 << 3}) {
        Scene scene;
        const int wall = addMaterial(scene, {0.5f, 0.5f, 0.5f}, {0, 0, 0}, false);
        addRoom(scene, wall, {-2, -1, -4}, {2, 1, 4}, open);
        const Image image = renderPicture(trace(scene), volume, options);
        const double share = double(countPixels(image, lit)) / double(image.pixels.size());
        CAPTURE(open);
        CHECK(share > (open ? 0.2 : 0.999));
        // An open side is a frame to look through: its rim is in the picture, black around.
        const bool throughSide = open && open != 1 << 3;
        if (!throughSide) continue;
        CHECK(image.pixels.front() == Color(0));
        CHECK(image.pixels.back() == Color(0));
        CHECK(lit(image.pixels[18 * 64 + 32]));
    }
}

TEST_CASE("the scene's first camera is used, with its field of view", "[picture][camera]")
{
    // Ten metres above a 2 × 2 floor: with yfov = 2 atan(0.2) the floor fills half the height.
    Scene scene;
    addFloor(scene, addMaterial(scene, {0.5f, 0.5f, 0.5f}, {0, 0, 0}, false), 1);
    Camera camera;
    // Looks along −Z of its node, which is −Y of the world: rows are the node's axes.
    camera.cameraToWorld = Mat4d(1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 10, 0, 1);
    camera.yfov = 2 * std::atan(0.2);
    scene.cameras.push_back(camera);
    const Tracer tracer = trace(scene);
    PictureOptions options;
    options.width = options.height = 40;
    options.samplesPerPixel = 1;
    options.spheres = 0;
    const IrradianceVolume volume = ambient(16, {1, 1, 1}, {0, 0, 0});
    const Image image = renderPicture(tracer, volume, options);
    CHECK(countPixels(image, [](const Color& p) { return near(p, 0.5f); }) == 20 * 20);
    for (int x : {10, 29}) {
        CHECK(near(image.pixels[x * 40 + x], 0.5f));
        CHECK(near(image.pixels[(39 - x) * 40 + x], 0.5f));
    }
    // A field of view that is asked for replaces the camera's: 45 degrees see 8.28 m.
    options.yfovDegrees = 45;
    const Image wide = renderPicture(tracer, volume, options);
    const double side = 40 * 2 / (2 * 10 * std::tan(kPi / 8));
    CHECK(std::sqrt(double(countPixels(wide, [](const Color& p) { return near(p, 0.5f); })))
        == Approx(side).margin(1.0));
}

TEST_CASE("the same picture for any number of threads", "[picture]")
{
    Scene scene;
    const int wall = addMaterial(scene, {0.5f, 0.4f, 0.3f}, {0, 0, 0}, true);
    addRoom(scene, wall, {-2, -1, -4}, {2, 1, 4}, 1 << 3);
    scene.environment = Environment::constant({1, 2, 3});
    const Tracer tracer = trace(scene);
    const IrradianceVolume volume = ambient(8, {1, 1, 1}, {0.3f, 0.5f, 0.7f});
    PictureOptions options;
    options.width = 80;
    options.height = 45;
    const Image many = renderPicture(tracer, volume, options);
    tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
    CHECK(renderPicture(tracer, volume, options).pixels == many.pixels);
}

TEST_CASE("pictures refuse bad options and stop when asked", "[picture]")
{
    Scene scene;
    addFloor(scene, addMaterial(scene, {0.5f, 0.5f, 0.5f}, {0, 0, 0}, false), 1);
    const Tracer tracer = trace(scene);
    const IrradianceVolume volume = ambient(4, {1, 1, 1}, {0, 0, 0});
    const auto codeOf = [&](const std::function<void(PictureOptions&)>& spoil) {
        PictureOptions options = lookDown(1);
        spoil(options);
        try {
            renderPicture(tracer, volume, options);
        } catch (const Error& e) {
            return e.code();
        }
        return ErrorCode::BoundNotMet;
    };
    CHECK(codeOf([](PictureOptions& o) { o.width = 0; }) == ErrorCode::Usage);
    CHECK(codeOf([](PictureOptions& o) { o.height = 16385; }) == ErrorCode::Usage);
    CHECK(codeOf([](PictureOptions& o) { o.samplesPerPixel = 0; }) == ErrorCode::Usage);
    CHECK(codeOf([](PictureOptions& o) { o.yfovDegrees = 180; }) == ErrorCode::Usage);
    CHECK(codeOf([](PictureOptions& o) { o.yfovDegrees = std::nan(""); }) == ErrorCode::Usage);
    CHECK(codeOf([](PictureOptions& o) { o.spheres = -1; }) == ErrorCode::Usage);
    CHECK(codeOf([](PictureOptions& o) { o.eye = o.target; }) == ErrorCode::Usage);
    CHECK(codeOf([](PictureOptions& o) { o.eye = Vec3d(std::nan(""), 0, 0); }) == ErrorCode::Usage);
    CHECK(codeOf([](PictureOptions& o) { o.mode = Interpolation::Taylor; }) == ErrorCode::Usage);
    CHECK(codeOf([](PictureOptions&) {}) == ErrorCode::BoundNotMet); // nothing thrown

    CancelAfter cancel;
    try {
        renderPicture(tracer, volume, lookDown(1), &cancel);
        FAIL("not interrupted");
    } catch (const Error& e) {
        CHECK(e.code() == ErrorCode::Interrupted);
    }
}
