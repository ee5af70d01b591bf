// SPDX-License-Identifier: Apache-2.0
// Reflective shadow maps against closed forms. The total flux of the surfels of one light is
// ∫ albedo · E dA. Where every beam carries the same flux and none is lost that holds to rounding;
// elsewhere over many seeds, to four of the standard errors that their spread gives.

#include "bake_makers.h"

#include <lumivdb/bake/rsm.h>
#include <lumivdb/core/random.h>

#include <tbb/global_control.h>

#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <functional>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

struct Totals {
    Vec3d flux{0, 0, 0};
    double area = 0;
};

Totals totals(const std::vector<Surfel>& surfels)
{
    Totals t;
    for (const Surfel& s : surfels) {
        t.flux += Vec3d(s.flux);
        t.area += s.area;
    }
    return t;
}

/// Mean and standard error of @a value over @a seeds seeds.
struct Estimate {
    double mean = 0, error = 0;
};

Estimate overSeeds(int seeds, const std::function<double(std::uint64_t)>& value)
{
    double sum = 0, squares = 0;
    for (int i = 0; i < seeds; ++i) {
        const double v = value(static_cast<std::uint64_t>(i) + 1);
        sum += v;
        squares += v * v;
    }
    const double mean = sum / seeds;
    return {mean, std::sqrt(std::max(0.0, squares / seeds - mean * mean) / (seeds - 1))};
}

void checkEstimate(const Estimate& e, double expected, double asked)
{
    CAPTURE(e.mean, e.error, expected);
    CHECK(std::abs(e.mean - expected) <= 4 * e.error + 1e-5 * std::abs(expected));
    CHECK(e.error <= asked * std::abs(expected));
}

RsmOptions withResolution(int resolution, std::uint64_t seed = 1)
{
    RsmOptions o;
    o.resolution = resolution;
    o.seed = seed;
    return o;
}

Light light(LightType type, const Color& intensity, const Vec3d& position, const Vec3d& direction)
{
    Light l;
    l.type = type;
    l.intensity = intensity;
    l.position = position;
    l.direction = direction.normalized();
    return l;
}

/// Floor [0,size]² at y = 0 that looks up.
Scene floorScene(const Color& albedo, double size = 2, bool doubleSided = false)
{
    Scene scene;
    addMaterial(scene, albedo, Color(0.0f), doubleSided);
    addQuad(scene, 0, {0, 0, 0}, {0, 0, size}, {size, 0, 0});
    scene.meshes[0].uv[0] = {{0, 0}, {0, 1}, {1, 1}, {1, 0}};
    return scene;
}

Scene boxScene(const Color& albedo)
{
    Scene scene;
    addMaterial(scene, albedo, Color(0.0f), false);
    addInwardBox(scene, 0, {0, 0, 0}, {2, 3, 4});
    return scene;
}
constexpr double kBoxArea = 2 * (2 * 3 + 3 * 4 + 2 * 4);

/// Two texels side by side along u, not filtered.
Texture twoTexels(std::array<float, 4> left, std::array<float, 4> right)
{
    Texture t;
    t.width = 2;
    t.height = 1;
    t.nearest = true;
    t.pixels.insert(t.pixels.end(), left.begin(), left.end());
    t.pixels.insert(t.pixels.end(), right.begin(), right.end());
    return t;
}

bool sameBits(const std::vector<Surfel>& a, const std::vector<Surfel>& b)
{
    if (a.size() != b.size()) return false;
    for (std::size_t i = 0; i < a.size(); ++i) {
        if (a[i].position != b[i].position || a[i].normal != b[i].normal || a[i].flux != b[i].flux
            || a[i].area != b[i].area)
            return false;
    }
    return true;
}

} // namespace

TEST_CASE("a directional light on a floor: rho E A cos, and the floor's area", "[rsm]")
{
    const Color rho(0.25f, 0.5f, 0.75f);
    const auto tracer = makeTracer(floorScene(rho));
    // From above the map is the floor: each beam E A / N².
    const Light above = light(LightType::Directional, Color(3.0f), {0, 0, 0}, {0, -1, 0});
    const std::vector<Surfel> surfels = reflectedLight(*tracer, above, withResolution(64));
    REQUIRE(surfels.size() == 64 * 64);
    const Totals t = totals(surfels);
    CHECK(t.area == Approx(4).epsilon(1e-5));
    for (int c = 0; c < 3; ++c) CHECK(t.flux[c] == Approx(rho[c] * 3 * 4).epsilon(1e-5));
    for (const Surfel& s : surfels) {
        REQUIRE(s.normal == Vec3f(0, 1, 0));
        REQUIRE(std::abs(s.position.y) < 1e-6);
    }

    const Vec3d slanting(1, -2, 0.5);
    const Light sun = light(LightType::Directional, Color(3.0f), {0, 0, 0}, slanting);
    const auto total = [&](std::uint64_t seed) {
        return totals(reflectedLight(*tracer, sun, withResolution(32, seed)));
    };
    const double cosine = 2 / slanting.length();
    checkEstimate(
        overSeeds(32, [&](auto s) { return total(s).flux.y; }), 0.5 * 3 * 4 * cosine, 2e-3);
    checkEstimate(overSeeds(32, [&](auto s) { return total(s).area; }), 4, 2e-3);
}

TEST_CASE("a point light in a closed box: rho 4 pi I, and the walls' area", "[rsm]")
{
    const auto tracer = makeTracer(boxScene(Color(0.5f)));
    const Light lamp = light(LightType::Point, Color(1, 2, 4), {0.7, 1.1, 2.5}, {0, 0, -1});
    const std::vector<Surfel> surfels = reflectedLight(*tracer, lamp, withResolution(32));
    REQUIRE(surfels.size() == 6 * 32 * 32);
    for (int c = 0; c < 3; ++c) {
        CHECK(totals(surfels).flux[c] == Approx(0.5 * 4 * kPi * (1 << c)).epsilon(1e-5));
    }
    const auto area = [&](std::uint64_t seed) {
        return totals(reflectedLight(*tracer, lamp, withResolution(32, seed))).area;
    };
    checkEstimate(overSeeds(32, area), kBoxArea, 2e-3);
}

TEST_CASE("a point light's beams show every wall its share", "[rsm]")
{
    // From the middle of a cube each wall gets a sixth; the quarter of a wall with x, y > 0 a
    // twenty-fourth: the map of a face keeps solid angles.
    Scene scene;
    addMaterial(scene, Color(1.0f), Color(0.0f), false);
    addInwardBox(scene, 0, Vec3d(-1.0), Vec3d(2.0));
    const auto tracer = makeTracer(std::move(scene));
    const Light lamp = light(LightType::Point, Color(1.0f), {0, 0, 0}, {0, 0, -1});
    std::vector<double> flux(8, 0.0);
    // The corner beyond (½, ½) of a wall: a rectangle one away subtends atan(ab/√(1+a²+b²)), so
    // Ω = f(1,1) − 2 f(1,½) + f(½,½).
    double corners = 0;
    for (const Surfel& s : reflectedLight(*tracer, lamp, withResolution(64))) {
        const Vec3d& p = s.position;
        flux[(p.x > 0 ? 1u : 0u) + (p.y > 0 ? 2u : 0u) + (p.z > 0 ? 4u : 0u)] += s.flux.x;
        int far = 0;
        for (int a = 0; a < 3; ++a) far += std::abs(p[a]) > 0.5;
        if (far == 3) corners += s.flux.x;
    }
    // A beam between two octants may fall into either; 64 is even, so none is.
    for (const double f : flux) CHECK(f == Approx(kPi / 2).epsilon(1e-3));
    const auto f
        = [](double a, double b) { return std::atan(a * b / std::sqrt(1 + a * a + b * b)); };
    const double corner = f(1, 1) - 2 * f(1, 0.5) + f(0.5, 0.5);
    CHECK(corners == Approx(24 * corner).epsilon(0.01));
}

TEST_CASE("a spot light: the integral of glTF's cone", "[rsm]")
{
    // ∫ a² dω with a rising linearly in the cosine from 0 at the outer to 1 at the inner angle:
    // 2π ((1 − cos inner) + (cos inner − cos outer)/3).
    const auto tracer = makeTracer(boxScene(Color(0.5f)));
    const double angles[][2] = {{0.3, 0.8}, {0, kPi / 2}, {0.1, 0.2}};
    for (const auto& [inner, outer] : angles) {
        Light spot = light(LightType::Spot, Color(2.0f), {0.7, 1.1, 2.5}, {1, -1, 2});
        spot.innerConeAngle = inner;
        spot.outerConeAngle = outer;
        const double cosIn = std::cos(inner), cosOut = std::cos(outer);
        CAPTURE(inner, outer);
        checkEstimate(
            overSeeds(16,
                [&](std::uint64_t seed) {
                    return totals(reflectedLight(*tracer, spot, withResolution(24, seed))).flux.x;
                }),
            0.5 * 2 * 2 * kPi * ((1 - cosIn) + (cosIn - cosOut) / 3), 2e-3);
    }
}

TEST_CASE("a light's range dims what is far", "[rsm]")
{
    // A floor 1 below the lamp: ∫ I (1 − (d/r)⁴) cosine/d² dA over the disc d < r is, with d² = 1 +
    // ρ², 2π ∫₁^r (1 − (d/r)⁴) d⁻² dd = 2π ((1 − 1/r) − (r³ − 1)/(3 r⁴)).
    const auto tracer = makeTracer(floorScene(Color(1.0f), 10));
    Light lamp = light(LightType::Point, Color(1.0f), {5, 1, 5}, {0, 0, -1});
    const double r = lamp.range = 3;
    checkEstimate(
        overSeeds(16,
            [&](std::uint64_t seed) {
                return totals(reflectedLight(*tracer, lamp, withResolution(32, seed))).flux.x;
            }),
        2 * kPi * ((1 - 1 / r) - (r * r * r - 1) / (3 * r * r * r * r)), 2e-3);
}

TEST_CASE("a lamp outside what it lights spends its beams there", "[rsm]")
{
    // A square of half side 1, 5 below the lamp, subtends 4 atan(1/(5 √(1 + 1 + 25))).
    const auto tracer = makeTracer(floorScene(Color(1.0f)));
    const double omega = 4 * std::atan(1 / (5 * std::sqrt(27.0)));
    for (const LightType type : {LightType::Point, LightType::Spot}) {
        Light lamp = light(type, Color(1.0f), {1, 5, 1}, {0, -1, 0});
        lamp.innerConeAngle = lamp.outerConeAngle = 1.2;
        const std::vector<Surfel> surfels = reflectedLight(*tracer, lamp, withResolution(64));
        CHECK(surfels.size() > 64 * 64 / 2);
        for (const Vec3d& corner :
            {Vec3d(0, 0, 0), Vec3d(0, 0, 2), Vec3d(2, 0, 0), Vec3d(2, 0, 2)}) {
            // Beams are 0.04 apart there; a cone a tenth too narrow ends 0.09 before the corners.
            CHECK(std::any_of(surfels.begin(), surfels.end(),
                [&](const Surfel& s) { return (Vec3d(s.position) - corner).length() < 0.07; }));
        }
        checkEstimate(
            overSeeds(16,
                [&](std::uint64_t seed) {
                    return totals(reflectedLight(*tracer, lamp, withResolution(32, seed))).flux.x;
                }),
            omega, 5e-3);
    }
}

TEST_CASE("area lights in a closed box: rho pi L A, by the sides that shine", "[rsm]")
{
    for (const bool doubleSided : {false, true}) {
        for (const bool frontOnly : {false, true}) {
            Scene scene = boxScene(Color(0.5f));
            const int panel = addMaterial(scene, Color(0.0f), Color(4.0f), doubleSided);
            scene.materials[1].emitsFrontOnly = frontOnly;
            addQuad(scene, panel, {0.5, 2, 1}, {0.5, 0, 0}, {0, 0, 2});
            const auto tracer = makeTracer(std::move(scene));
            const double sides = doubleSided && !frontOnly ? 2 : 1;
            const Totals t = totals(reflectedEmission(*tracer, withResolution(64)));
            CAPTURE(doubleSided, frontOnly);
            CHECK(t.flux.x == Approx(0.5 * kPi * 4 * 1.0 * sides).epsilon(1e-5));
            if (sides == 2) continue;
            // Every point of the panel sees the whole floor (2 × 4), and each has a share of it.
            checkEstimate(overSeeds(16,
                              [&](std::uint64_t seed) {
                                  double area = 0;
                                  for (const Surfel& s :
                                      reflectedEmission(*tracer, withResolution(256, seed))) {
                                      area += s.normal.y > 0.5f ? s.area : 0;
                                  }
                                  return area;
                              }),
                8, 0.01);
        }
    }
}

TEST_CASE("area lights of several colours, sizes and textures", "[rsm]")
{
    Scene scene = boxScene(Color(0.5f));
    const int red = addMaterial(scene, Color(0.0f), Color(9, 1, 0), false);
    const int blue = addMaterial(scene, Color(0.0f), Color(0, 1, 2), true);
    addQuad(scene, red, {0.5, 2, 1}, {0.5, 0, 0}, {0, 0, 2});
    addQuad(scene, blue, {1.5, 1, 1}, {0.25, 0, 0}, {0, 0.25, 0});
    scene.textures.push_back(twoTexels({1, 1, 1, 1}, {0, 0, 0, 1}));
    scene.materials[1].emissionTexture.texture = 0; // half of the red panel is dark
    scene.meshes[6].uv[0] = {{0, 0}, {0, 1}, {1, 1}, {1, 0}};
    const auto tracer = makeTracer(std::move(scene));
    const double expected[3] = {9 * 0.5, 0.5 + 2 * 0.0625, 2 * 2 * 0.0625};
    for (int c = 0; c < 3; ++c) {
        checkEstimate(
            overSeeds(24,
                [&](std::uint64_t seed) {
                    return totals(reflectedEmission(*tracer, withResolution(256, seed))).flux[c];
                }),
            0.5 * kPi * expected[c], 0.02);
    }
}

TEST_CASE("a constant sky on a floor: rho pi L A", "[rsm]")
{
    Scene scene = floorScene(Color(0.5f));
    scene.environment = Environment::constant(Color(1, 2, 3));
    const auto tracer = makeTracer(std::move(scene));
    const auto total = [&](std::uint64_t seed) {
        return totals(reflectedEnvironment(*tracer, withResolution(256, seed)));
    };
    checkEstimate(overSeeds(24, [&](auto s) { return total(s).flux.z; }), 0.5 * kPi * 3 * 4, 0.01);
    // Half of the directions lie below the floor: its front is seen by the other half.
    checkEstimate(overSeeds(24, [&](auto s) { return total(s).area; }), 4.0 / 2, 0.01);
}

TEST_CASE("the sun of an environment gets its share of the directions", "[rsm]")
{
    // One texel of a 64 × 32 map, 10⁴ times as bright as the sky. On a floor that looks up E = L ∫
    // cos θ dω: over the sky's half π, over the texel ∫ cos θ sin θ dθ Δφ in closed form.
    constexpr int kWidth = 64, kHeight = 32, kColumn = 10, kRow = 6;
    std::vector<Color> pixels(kWidth * kHeight, Color(1.0f));
    pixels[kRow * kWidth + kColumn] = Color(1e4f);
    const auto sine2 = [](int row) { return std::pow(std::sin(kPi * row / kHeight), 2); };
    const double texel = 0.5 * (sine2(kRow + 1) - sine2(kRow)) * 2 * kPi / kWidth;
    Scene scene = floorScene(Color(0.5f));
    scene.environment = Environment::fromPixels(kWidth, kHeight, pixels, {});
    const auto tracer = makeTracer(std::move(scene));
    const std::vector<Surfel> surfels = reflectedEnvironment(*tracer, withResolution(256));
    CHECK(surfels.size() > 256 * 256 / 4);
    checkEstimate(
        overSeeds(24,
            [&](std::uint64_t seed) {
                return totals(reflectedEnvironment(*tracer, withResolution(256, seed))).flux.x;
            }),
        0.5 * 4 * (kPi + (1e4 - 1) * texel), 0.01);
}

TEST_CASE("surfels have the albedo of their texel, and masks let light through", "[rsm]")
{
    const Light sun = light(LightType::Directional, Color(1.0f), {0, 0, 0}, {0, -1, 0});
    Scene textured = floorScene(Color(0.5f));
    textured.textures.push_back(twoTexels({1, 0, 0, 1}, {0, 1, 0, 1}));
    textured.materials[0].baseColorTexture.texture = 0;
    double left = 0;
    const auto tracer = makeTracer(std::move(textured));
    for (const Surfel& s : reflectedLight(*tracer, sun, withResolution(64))) {
        // u runs along x: the left half is red.
        REQUIRE(s.flux[s.position.x < 1 ? 1 : 0] == 0);
        left += s.position.x < 1 ? s.flux.x : 0;
    }
    CHECK(left == Approx(0.5 * 2).epsilon(1e-5));

    // A black roof 1 above the floor whose right half is cut away.
    Scene masked = floorScene(Color(0.5f));
    addMaterial(masked, Color(0.0f), Color(0.0f), true);
    masked.materials[1].alphaMask = true;
    masked.textures.push_back(twoTexels({1, 1, 1, 1}, {1, 1, 1, 0}));
    masked.materials[1].baseColorTexture.texture = 0;
    addQuad(masked, 1, {0, 1, 0}, {0, 0, 2}, {2, 0, 0});
    masked.meshes[1].uv[0] = masked.meshes[0].uv[0];
    const auto roofed = makeTracer(std::move(masked));
    const std::vector<Surfel> lit = reflectedLight(*roofed, sun, withResolution(64));
    CHECK(totals(lit).flux.x == Approx(0.5 * 2).epsilon(1e-5));
    for (const Surfel& s : lit) REQUIRE((s.position.y > 0.5) == (s.position.x < 1));
}

TEST_CASE("the back of a single-sided surface sends nothing, that of a double-sided does", "[rsm]")
{
    const Light sun = light(LightType::Directional, Color(1.0f), {0, 0, 0}, {0, 1, 0});
    const auto single = makeTracer(floorScene(Color(0.5f), 2, false));
    CHECK(reflectedLight(*single, sun, withResolution(16)).empty());
    const auto both = makeTracer(floorScene(Color(0.5f), 2, true));
    const std::vector<Surfel> surfels = reflectedLight(*both, sun, withResolution(16));
    CHECK(totals(surfels).flux.x == Approx(0.5 * 4).epsilon(1e-5));
    for (const Surfel& s : surfels) REQUIRE(s.normal == Vec3f(0, -1, 0));
}

TEST_CASE("a region takes all of a map's beams, and what is before it still shadows", "[rsm]")
{
    // A roof over the left half of a floor; a region around the floor's front half, roof left out.
    Scene scene = floorScene(Color(1.0f));
    addQuad(scene, 0, {0, 1, 0}, {0, 0, 2}, {1, 0, 0});
    const auto tracer = makeTracer(std::move(scene));
    const Light sun = light(LightType::Directional, Color(1.0f), {0, 0, 0}, {0, -1, 0});
    RsmOptions options = withResolution(64);
    options.region = Box3d({-5, -0.5, 1}, {5, 0.5, 5});
    double lit = 0;
    for (const Surfel& s : reflectedLight(*tracer, sun, options)) {
        REQUIRE(s.position.z >= 1 - 1e-6);
        if (s.position.y < 0.5) lit += s.flux.x;
    }
    CHECK(lit == Approx(1).epsilon(1e-5));
    options.region = Box3d({10, 10, 10}, {11, 11, 11});
    CHECK(reflectedLight(*tracer, sun, options).empty());
}

TEST_CASE("several lights add up, and any number of threads finds the same bits", "[rsm]")
{
    Scene scene = litRoom();
    scene.lights.push_back(light(LightType::Spot, Color(1.0f), {0.5, 0.5, 0.5}, {0, -1, 0}));
    scene.environment = Environment::constant(Color(1.0f)); // does not get in
    const auto tracer = makeTracer(std::move(scene));
    const RsmOptions options = withResolution(32, 5);
    std::vector<Surfel> parts;
    const auto add
        = [&](const std::vector<Surfel>& s) { parts.insert(parts.end(), s.begin(), s.end()); };
    RsmOptions own = options;
    for (std::size_t i = 0; i < 2; ++i) {
        own.seed = hashCombine(mixBits(options.seed), i);
        add(reflectedLight(*tracer, tracer->scene().lights[i], own));
    }
    own.seed = hashCombine(mixBits(options.seed), 2);
    add(reflectedEmission(*tracer, own));
    REQUIRE(parts.size() > 7000);
    for (const std::size_t threads : {1u, 2u, 4u}) {
        tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
        CHECK(sameBits(reflectedLight(*tracer, options), parts));
    }
}

TEST_CASE("fewer surfels by importance keep every sum on average", "[rsm]")
{
    const auto tracer = makeTracer(litRoom());
    const std::vector<Surfel> all = reflectedLight(*tracer, withResolution(64));
    REQUIRE(all.size() > 20000);
    double luminous = 0, moment = 0, lit = 0;
    for (const Surfel& s : all) {
        luminous += luminance(s.flux);
        moment += s.flux.z * s.position.x;
        lit += luminance(s.flux) > 0 ? s.area : 0;
    }
    constexpr std::size_t kCount = 500;
    const auto draw = [&](std::uint64_t seed) { return importantSurfels(all, kCount, seed); };
    for (std::uint64_t seed = 1; seed <= 20; ++seed) {
        const std::vector<Surfel> few = draw(seed);
        REQUIRE(few.size() <= kCount);
        double sum = 0;
        for (const Surfel& s : few) sum += luminance(s.flux);
        CHECK(sum == Approx(luminous).epsilon(1e-5));
    }
    const auto momentOf = [&](std::uint64_t seed) {
        double sum = 0;
        for (const Surfel& s : draw(seed)) sum += s.flux.z * s.position.x;
        return sum;
    };
    checkEstimate(overSeeds(400, momentOf), moment, 0.01);
    checkEstimate(overSeeds(400, [&](auto s) { return totals(draw(s)).area; }), lit, 0.01);
    CHECK(sameBits(importantSurfels(all, all.size(), 1), all));
    CHECK(importantSurfels(all, 0, 1).empty());
    CHECK(importantSurfels({}, 10, 1).empty());
}

TEST_CASE("hard cases of reflective shadow maps", "[rsm]")
{
    const Light sun = light(LightType::Directional, Color(1e8f), {0, 0, 0}, {0, -1, 0});
    SECTION("no geometry, no light")
    {
        const auto empty = makeTracer(Scene{{}, {Material{}}, {}, {}, {}, nullptr, {}, {}});
        CHECK(reflectedLight(*empty, sun, withResolution(8)).empty());
        CHECK(reflectedLight(*empty, withResolution(8)).empty());
        const auto dark = makeTracer(floorScene(Color(1.0f)));
        CHECK(reflectedLight(*dark, withResolution(8)).empty());
    }
    SECTION("a million units from the origin, 1e8 lux")
    {
        Scene scene = floorScene(Color(0.5f));
        for (Vec3d& p : scene.meshes[0].positions) p += Vec3d(1e6, -1e6, 1e6);
        const auto tracer = makeTracer(std::move(scene));
        const std::vector<Surfel> surfels = reflectedLight(*tracer, sun, withResolution(16));
        CHECK(totals(surfels).flux.x == Approx(0.5e8 * 4).epsilon(1e-5));
        for (const Surfel& s : surfels) {
            REQUIRE(s.position.x >= 1e6 - 1e-6);
            REQUIRE(s.position.x <= 1e6 + 2 + 1e-6);
        }
    }
    SECTION("light along the floor, and a lamp on it, give numbers")
    {
        const auto tracer = makeTracer(floorScene(Color(0.5f)));
        for (const Light& l : {light(LightType::Directional, Color(1.0f), {0, 0, 0}, {1, 0, 0}),
                 light(LightType::Point, Color(1.0f), {1, 0, 1}, {0, 0, -1})}) {
            for (const Surfel& s : reflectedLight(*tracer, l, withResolution(16))) {
                REQUIRE(std::isfinite(s.flux.x));
                REQUIRE(std::isfinite(s.area));
            }
        }
    }
    SECTION("options out of range")
    {
        const auto tracer = makeTracer(floorScene(Color(0.5f)));
        for (const int n : {0, -3, 16385}) {
            CHECK_THAT(
                errorOf(ErrorCode::Usage, [&] { reflectedLight(*tracer, sun, withResolution(n)); }),
                Catch::Contains("resolution") && Catch::Contains(std::to_string(n)));
        }
    }
    SECTION("cancelled")
    {
        struct Stopped : Progress {
            bool cancelled() override { return true; }
        } stopped;
        const auto tracer = makeTracer(floorScene(Color(0.5f)));
        CHECK(errorOf(ErrorCode::Interrupted, [&] {
            reflectedLight(*tracer, sun, withResolution(64), &stopped);
        }) != "");
    }
}
