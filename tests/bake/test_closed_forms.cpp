// SPDX-License-Identifier: Apache-2.0
// Light whose amount is known exactly. Every random result must lie within four of its own
// standard errors of the answer, and that error must be small enough to mean something (0.5%).

#include "scene_makers.h"

#include <catch2/catch.hpp>

#include <cmath>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

constexpr double kPi = 3.14159265358979323846;

ProbeOptions withRays(int rays)
{
    ProbeOptions o;
    o.rays = rays;
    return o;
}

/// |value − expected| ≤ 4 stderr (+ float rounding), and stderr ≤ @a asked of @a scale.
void checkEstimate(double value, double error, double expected, double scale, double asked = 0.005)
{
    CAPTURE(value, error, expected);
    CHECK(std::abs(value - expected) <= 4 * error + 4e-6 * scale);
    CHECK(error <= asked * scale);
}

Scene emptyScene()
{
    Scene scene;
    addMaterial(scene, Color(1.0f), Color(0.0f), false);
    return scene;
}

} // namespace

TEST_CASE("constant environment: E = pi L and nothing above band 0", "[closed]")
{
    Scene scene = emptyScene();
    const Color L(0.5f, 1.0f, 2.0f);
    scene.environment = Environment::constant(L);
    Bench bench(scene, withRays(4096));
    const ProbeResult r = bench.sh({0.3, -0.2, 5}, 6);
    // ∫ L Y0 dω = 4π L Y0 = L √(4π)
    for (int c = 0; c < 3; ++c) {
        checkEstimate(r.value[0][c], r.stderr_[0][c], L[c] * std::sqrt(4 * kPi), L[c]);
        for (std::size_t i = 1; i < 36; ++i) {
            CAPTURE(i);
            checkEstimate(r.value[i][c], r.stderr_[i][c], 0, 3.5 * L[c]);
        }
        const Color E = irradiance(6, r.value.data(), {0.6f, 0.0f, 0.8f});
        CHECK(E[c] == Approx(kPi * L[c]).epsilon(0.005));
    }
    CHECK(r.validity == 1.0f);
    CHECK(std::isinf(r.distance));
}

TEST_CASE("closed furnace: L = Le / (1 - rho)", "[closed][heavy]")
{
    // Inside a closed room whose every surface emits Le and reflects rho, the radiance L solves
    // L = Le + rho L, the same everywhere and in every direction.
    const struct {
        float rho;
        int rays;
        double asked; // standard error, as a share of L
    } cases[] = {{0.0f, 4096, 0.005}, {0.5f, 8192, 0.005}, {0.9f, 16384, 0.005},
        {0.99f, 32768, 0.005}, {0.999f, 2048, 0.03}};
    for (const auto& k : cases) {
        Scene scene;
        addInwardBox(scene, addMaterial(scene, Color(k.rho), Color(1, 2, 3), false), {-1, -2, -1.5},
            {2, 3, 4});
        Bench bench(scene, withRays(k.rays));
        const ProbeResult r = bench.sh({0.2, 0.1, 0.4}, 3);
        for (int c = 0; c < 3; ++c) {
            const double L = (c + 1) / (1.0 - static_cast<double>(k.rho));
            CAPTURE(k.rho, c);
            const double l00 = L * std::sqrt(4 * kPi);
            checkEstimate(r.value[0][c], r.stderr_[0][c], l00, l00, k.asked);
            for (std::size_t i = 1; i < 9; ++i) {
                checkEstimate(r.value[i][c], r.stderr_[i][c], 0, l00, k.asked);
            }
        }
        WARN("rho " << k.rho << ": L/Le = " << r.value[0].x / std::sqrt(4 * kPi) << " +- "
                    << r.stderr_[0].x / std::sqrt(4 * kPi) << ", expected " << 1 / (1 - k.rho)
                    << ", " << r.rays / static_cast<std::uint64_t>(k.rays) << " rays a path");
        CHECK(r.validity == 1.0f);
    }
}

TEST_CASE("a room of albedo 1 ends and stays finite", "[closed][hard]")
{
    Scene scene;
    addInwardBox(
        scene, addMaterial(scene, Color(1.0f), Color(1.0f), false), Vec3d(-1.0), Vec3d(2.0));
    Bench bench(scene, withRays(64));
    const ProbeResult r = bench.sh({0, 0, 0}, 3);
    CHECK(std::isfinite(r.value[0].x));
    CHECK(r.value[0].x > 100); // the answer is infinite; the estimate is large
}

TEST_CASE("maximum number of bounces: the furnace's partial sums", "[closed]")
{
    // With at most b reflections: L = Le Σ_{k=0}^{b} rho^k.
    const float rho = 0.5f;
    for (int bounces : {0, 1, 2, 3}) {
        Scene scene;
        addInwardBox(
            scene, addMaterial(scene, Color(rho), Color(1.0f), false), Vec3d(-1.0), Vec3d(2.0));
        ProbeOptions o = withRays(8192);
        o.maxBounces = bounces;
        Bench bench(scene, o);
        const ProbeResult r = bench.sh({0.1, 0.2, 0.3}, 1);
        const double L = (1 - std::pow(0.5, bounces + 1)) / 0.5;
        CAPTURE(bounces);
        checkEstimate(r.value[0].x, r.stderr_[0].x, L * std::sqrt(4 * kPi), 3.5);
    }
}

TEST_CASE("direct and indirect add up to all, each right alone", "[closed]")
{
    for (const Contribution c : {Contribution::Direct, Contribution::Indirect}) {
        Scene scene;
        addInwardBox(
            scene, addMaterial(scene, Color(0.75f), Color(1.0f), false), Vec3d(-1.0), Vec3d(2.0));
        ProbeOptions o = withRays(32768);
        o.contribution = c;
        Bench bench(scene, o);
        const ProbeResult r = bench.sh({0.1, 0.2, 0.3}, 1);
        // direct: Le = 1; indirect: 1/(1 − 0.75) − 1 = 3
        const double L = c == Contribution::Direct ? 1 : 3;
        checkEstimate(r.value[0].x, r.stderr_[0].x, L * std::sqrt(4 * kPi), L * 3.5);
    }
}

TEST_CASE("point, spot and directional lights: exact, no noise", "[closed]")
{
    Scene scene = emptyScene();
    Light light;
    light.intensity = Color(80, 40, 20);
    light.position = Vec3d(0, 3, 0);
    light.direction = Vec3d(0, -1, 0);
    const Vec3d p(0, 1, 0);
    const Vec3f up(0, 1, 0), side(1, 0, 0);
    const Vec3f tilted = Vec3f(1, 1, 0).normalized();

    SECTION("point: E = I cos / d^2")
    {
        light.type = LightType::Point;
        scene.lights = {light};
        Bench bench(scene, withRays(16));
        const ProbeResult r = bench.irradiance(p, {up, side, tilted, -up});
        CHECK(r.value[0].x == Approx(80 / 4.0));
        CHECK(r.value[0].z == Approx(20 / 4.0));
        CHECK(std::abs(r.value[1].x) < 1e-5);
        CHECK(r.value[2].x == Approx(80 / 4.0 * std::sqrt(0.5)));
        CHECK(r.value[3].x == 0);
        CHECK(r.stderr_[0].x == 0);
        // SH of a single direction: L_i = E Y_i(up)
        const ProbeResult sh = bench.sh(p, 3);
        double y[9];
        evalShBasis(3, Vec3d(up), y);
        for (std::size_t i = 0; i < 9; ++i) CHECK(sh.value[i].x == Approx(20 * y[i]).margin(1e-5));
    }
    SECTION("point with range: window 1 - (d/r)^4")
    {
        light.range = 4;
        scene.lights = {light};
        Bench bench(scene, withRays(16));
        CHECK(bench.irradiance(p, {up}).value[0].x == Approx(20 * (1 - std::pow(0.5, 4))));
        CHECK(bench.irradiance({0, -1.5, 0}, {up}).value[0].x == 0);
    }
    SECTION("spot: glTF's cone")
    {
        light.type = LightType::Spot;
        light.innerConeAngle = 0.2;
        light.outerConeAngle = 0.5;
        scene.lights = {light};
        Bench bench(scene, withRays(16));
        CHECK(bench.irradiance(p, {up}).value[0].x == Approx(20));
        // at angle a off the axis: ((cos a − cos outer)/(cos inner − cos outer))²
        const double a = 0.35;
        const Vec3d q(2 * std::tan(a), 1, 0);
        const double falloff
            = std::pow((std::cos(a) - std::cos(0.5)) / (std::cos(0.2) - std::cos(0.5)), 2);
        const double d = 2 / std::cos(a);
        CHECK(bench.irradiance(q, {up}).value[0].x
            == Approx(80 / (d * d) * std::cos(a) * falloff).epsilon(1e-5));
        CHECK(bench.irradiance({2 * std::tan(0.51), 1, 0}, {up}).value[0].x == 0);
    }
    SECTION("directional: E lux on a surface facing it")
    {
        light.type = LightType::Directional;
        scene.lights = {light};
        Bench bench(scene, withRays(16));
        CHECK(bench.irradiance(p, {up}).value[0].x == Approx(80));
        CHECK(bench.irradiance(p, {tilted}).value[0].x == Approx(80 * std::sqrt(0.5)));
    }
    SECTION("a surface in between casts a shadow; light reflected from a floor")
    {
        light.type = LightType::Directional;
        scene.lights = {light};
        addQuad(scene, 0, {-1, 2, -1}, {0, 0, 2}, {2, 0, 0});
        Bench bench(scene, withRays(16));
        CHECK(bench.irradiance(p, {up}).value[0].x == 0);
    }
}

TEST_CASE("a lit floor reflects rho E / pi", "[closed]")
{
    // An infinite floor (1e5 units) of albedo 0.5 under a directional light of E lux looks equally
    // bright from everywhere: L = rho E / pi; a surface looking down receives pi L = rho E.
    Scene scene;
    addQuad(scene, addMaterial(scene, Color(0.5f), Color(0.0f), false), {-5e4, 0, -5e4},
        {0, 0, 1e5}, {1e5, 0, 0});
    Light sun;
    sun.type = LightType::Directional;
    sun.direction = Vec3d(0.6, -0.8, 0);
    sun.intensity = Color(10.0f);
    scene.lights = {sun};
    Bench bench(scene, withRays(4096));
    const ProbeResult r = bench.irradiance({3, 1, 2}, {{0, -1, 0}});
    checkEstimate(r.value[0].x, r.stderr_[0].x, 0.5 * 10 * 0.8, 4);
}

TEST_CASE("area lights, small and large, against Lambert's formula", "[closed]")
{
    for (const double size : {0.01, 1.0, 40.0}) {
        Scene scene;
        const int m = addMaterial(scene, Color(0.0f), Color(5.0f), false);
        // faces −y, at height 2
        addQuad(scene, m, {-size / 2, 2, -size / 2}, {size, 0, 0}, {0, 0, size});
        Bench bench(scene, withRays(16384));
        const Vec3d p(0.3, 0.5, -0.2);
        const std::vector<Vec3d> polygon = {{-size / 2, 2, -size / 2}, {size / 2, 2, -size / 2},
            {size / 2, 2, size / 2}, {-size / 2, 2, size / 2}};
        const Vec3d up(0, 1, 0);
        const double E = 5 * polygonIrradiance(p, up, polygon);
        const ProbeResult r = bench.irradiance(p, {Vec3f(up)});
        CAPTURE(size);
        checkEstimate(r.value[0].x, r.stderr_[0].x, E, E);
    }
}

TEST_CASE("one- and two-sided emitters, seen from both sides", "[closed]")
{
    for (const bool doubleSided : {false, true}) {
        Scene scene;
        addQuad(scene, addMaterial(scene, Color(0.5f), Color(3.0f), doubleSided), {-1, 0, -1},
            {2, 0, 0}, {0, 0, 2}); // u × v = −y: front looks down
        Bench bench(scene, withRays(16384));
        const std::vector<Vec3d> polygon = {{-1, 0, -1}, {1, 0, -1}, {1, 0, 1}, {-1, 0, 1}};
        const Vec3d below(0.1, -1, 0.2), above(0.1, 1, 0.2);
        const double E = 3 * polygonIrradiance(below, {0, 1, 0}, polygon);
        const ProbeResult front = bench.irradiance(below, {{0, 1, 0}});
        const ProbeResult behind = bench.irradiance(above, {{0, -1, 0}});
        CAPTURE(doubleSided);
        checkEstimate(front.value[0].x, front.stderr_[0].x, E, E);
        CHECK(front.validity == 1.0f);
        if (doubleSided) {
            checkEstimate(behind.value[0].x, behind.stderr_[0].x, E, E);
            CHECK(behind.validity == 1.0f);
        } else {
            // An opaque, black back face that counts against validity.
            CHECK(behind.value[0].x == 0);
            CHECK(behind.validity < 1.0f);
        }
    }
}

TEST_CASE("sun disc in an environment: E = L Omega cos", "[closed]")
{
    // One texel of a 512x256 lat-long map: 65,000 times the sky.
    const int w = 512, h = 256, column = 300, row = 60;
    std::vector<Color> pixels(static_cast<std::size_t>(w * h), Color(0.0f));
    pixels[static_cast<std::size_t>(row * w + column)] = Color(65000.0f);
    const double omega = 2 * kPi / w * (std::cos(kPi * row / h) - std::cos(kPi * (row + 1) / h));
    const double u = (column + 0.5) / w, v = (row + 0.5) / h;
    const Vec3d d(std::sin(kPi * v) * std::cos(2 * kPi * (u - 0.5)), std::cos(kPi * v),
        std::sin(kPi * v) * std::sin(2 * kPi * (u - 0.5)));
    Scene scene = emptyScene();
    scene.environment = Environment::fromPixels(w, h, pixels, {});
    Bench bench(scene, withRays(1024));
    const ProbeResult r = bench.irradiance({0, 0, 0}, {Vec3f(d)});
    // The cosine averages to 1 − θ²/2 over the texel: half its diagonal, 0.0087, makes that 1.9e-5.
    CHECK(r.value[0].x == Approx(65000 * omega).epsilon(4e-5));
    CHECK(r.stderr_[0].x < 1e-4 * r.value[0].x);
}

TEST_CASE("alpha-masked surfaces let light through their holes", "[closed]")
{
    Scene scene;
    Texture t;
    t.width = t.height = 2;
    t.nearest = true;
    t.pixels = {1, 1, 1, 1, 1, 1, 1, 0, 1, 1, 1, 0, 1, 1, 1, 1}; // checkerboard alpha
    scene.textures.push_back(t);
    const int m = addMaterial(scene, Color(0.0f), Color(0.0f), true);
    scene.materials[0].alphaMask = true;
    scene.materials[0].baseColorTexture.texture = 0;
    // A very large screen with the pattern repeated 1e3 times hides half of a constant sky.
    addQuad(scene, m, {-500, 1, -500}, {1000, 0, 0}, {0, 0, 1000});
    scene.meshes[0].uv[0] = {{0, 0}, {1e3f, 0}, {1e3f, 1e3f}, {0, 1e3f}};
    scene.environment = Environment::constant(Color(1.0f));
    Bench bench(scene, withRays(65536));
    const ProbeResult r = bench.irradiance({0.13, 0, 0.21}, {{0, 1, 0}});
    CHECK(std::abs(r.value[0].x - kPi / 2) < 4 * r.stderr_[0].x + 0.02);
}

TEST_CASE("the standard error is honest", "[closed][statistics]")
{
    // z = (estimate − truth)/stderr over 400 independent seeds, in a furnace (path noise) and under
    // a rectangular light (visibility edges): its RMS is 1 if the error is exact, below 1 where
    // consecutive strata differ in mean. With 400 seeds the RMS itself is known to ±3.5%.
    Scene furnace;
    addInwardBox(
        furnace, addMaterial(furnace, Color(0.8f), Color(1.0f), false), Vec3d(-1.0), Vec3d(2.0));
    Scene lit;
    addQuad(
        lit, addMaterial(lit, Color(0.0f), Color(5.0f), false), {-1, 2, -1}, {2, 0, 0}, {0, 0, 2});
    const double E = 5
        * polygonIrradiance(
            {0.3, 0.5, -0.2}, {0, 1, 0}, {{-1, 2, -1}, {1, 2, -1}, {1, 2, 1}, {-1, 2, 1}});
    const struct {
        const Scene& scene;
        Vec3d p;
        double truth;
    } cases[] = {{furnace, {0.2, 0.1, 0.4}, 5 * kPi}, {lit, {0.3, 0.5, -0.2}, E}};
    for (const auto& k : cases) {
        double z2 = 0;
        constexpr int kSeeds = 400;
        for (int seed = 0; seed < kSeeds; ++seed) {
            ProbeOptions o = withRays(256);
            o.seed = static_cast<std::uint64_t>(seed);
            Bench bench(k.scene, o);
            const ProbeResult r
                = bench.irradiance(k.p, {{0, 1, 0}}, static_cast<std::uint64_t>(seed) * 77);
            const double z = (r.value[0].x - k.truth) / r.stderr_[0].x;
            z2 += z * z / kSeeds;
        }
        WARN("RMS z over seeds: " << std::sqrt(z2));
        CHECK(std::sqrt(z2) < 1.15);
        CHECK(std::sqrt(z2) > 0.1);
    }
}

TEST_CASE("rooms modelled back to back share a plane: each sees its own wall", "[closed][hard]")
{
    // Two closed furnaces of single-sided quads, the wall x = 0 of each in the same plane. Inside
    // either, L = Le / (1 − rho) = 2 everywhere, and no ray may meet a back face.
    Scene scene;
    const int m = addMaterial(scene, Color(0.5f), Color(1.0f), false);
    addInwardBox(scene, m, {-1.7, -1, -1}, {1.7, 2, 2});
    addInwardBox(scene, m, {0, -1, -1}, {1.3, 2, 2});
    Bench bench(scene, withRays(8192));
    for (const double x : {-0.8, -0.05, 0.05, 0.6}) {
        const ProbeResult r = bench.sh({x, 0.1, 0.2}, 1);
        CAPTURE(x);
        checkEstimate(r.value[0].x, r.stderr_[0].x, 2 * std::sqrt(4 * kPi), 2 * 3.5449);
        CHECK(r.validity == 1.0f);
    }
}

TEST_CASE("a sky that a room cannot see does not spoil its light", "[closed][hard]")
{
    // A closed room of 2 m in a scene of 200 m, lit by one quad: adding a bright environment
    // changes nothing but the choice of emitters, so the noise may grow by about √2, not more.
    Scene scene;
    addInwardBox(
        scene, addMaterial(scene, Color(0.0f), Color(0.0f), false), Vec3d(-1.0), Vec3d(2.0));
    addQuad(scene, addMaterial(scene, Color(0.0f), Color(5.0f), false), {-0.2, 0.9, -0.2},
        {0.4, 0, 0}, {0, 0, 0.4});
    addQuad(scene, 0, {-100, -5, -100}, {0, 0, 200}, {200, 0, 0});
    const Vec3d p(0.3, -0.2, 0.1);
    Bench alone(scene, withRays(16384));
    const ProbeResult dark = alone.irradiance(p, {{0, 1, 0}});
    scene.environment = Environment::constant(Color(1000.0f));
    Bench under(scene, withRays(16384));
    const ProbeResult lit = under.irradiance(p, {{0, 1, 0}});
    CHECK(std::abs(lit.value[0].x - dark.value[0].x)
        < 4 * std::hypot(lit.stderr_[0].x, dark.stderr_[0].x));
    CHECK(lit.stderr_[0].x < 3 * dark.stderr_[0].x);
}

TEST_CASE("coinciding emitters are one emitter", "[closed][hard]")
{
    // A furnace with every triangle twice: rays meet one of each pair, so the light is that of one.
    for (const bool doubleSided : {false, true}) {
        Scene scene;
        const int m = addMaterial(scene, Color(0.5f), Color(1.0f), doubleSided);
        addInwardBox(scene, m, Vec3d(-1.0), Vec3d(2.0));
        addInwardBox(scene, m, Vec3d(-1.0), Vec3d(2.0));
        Bench bench(scene, withRays(8192));
        const ProbeResult r = bench.sh({0.3, 0.1, 0.2}, 1);
        CAPTURE(doubleSided);
        checkEstimate(r.value[0].x, r.stderr_[0].x, 2 * std::sqrt(4 * kPi), 2 * 3.5449);
    }
}
