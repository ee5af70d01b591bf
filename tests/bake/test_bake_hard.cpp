// SPDX-License-Identifier: Apache-2.0
// Places and scenes that break bakes: samples on surfaces, edges and corners; far, tiny and huge
// scenes; nothing to see; a sun through a pinhole.

#include "bake_makers.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

bool isFinite(const IrradianceVolume& v)
{
    const int n = v.coefficients() * (v.hasGradients() ? 4 : 1);
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        if (!std::isfinite(v.validity(s)) || std::isnan(v.distance(s))) return false;
        for (int i = 0; i < n; ++i)
            for (int c = 0; c < 3; ++c)
                if (!std::isfinite(v.radiance(s)[i][c])) return false;
    }
    return true;
}

/// Largest difference of any coefficient over the largest coefficient, and their RMS ratio.
struct Difference {
    double max = 0, rms = 0;
};

Difference difference(const IrradianceVolume& a, const IrradianceVolume& b)
{
    REQUIRE(a.sampleCount() == b.sampleCount());
    double largest = 0, worst = 0, square = 0, error = 0;
    for (SampleId s = 0; s < a.sampleCount(); ++s)
        for (int i = 0; i < a.coefficients(); ++i)
            for (int c = 0; c < 3; ++c) {
                const double x = a.radiance(s)[i][c], y = b.radiance(s)[i][c];
                largest = std::max(largest, std::abs(x));
                worst = std::max(worst, std::abs(x - y));
                square += x * x;
                error += (x - y) * (x - y);
            }
    return {worst / largest, std::sqrt(error / square)};
}

/// How far a sample on the walls of [0,size]³ has to go inwards, in lattice steps, per axis.
Vec3d inward(const Coord& p, int last)
{
    Vec3d d(0.0);
    for (int a = 0; a < 3; ++a) d[a] = p[a] == 0 ? 1 : p[a] == last ? -1 : 0;
    return d;
}

} // namespace

TEST_CASE(
    "on a wall, an edge, a corner of a room: the light inside", "[bake][hard][surface][heavy]")
{
    for (const bool doubleSided : {false, true}) {
        // The room stands in bright surroundings: outside is another light altogether.
        Scene scene = litRoom(Vec3d(0.0), 1.6, doubleSided);
        scene.environment = Environment::constant(Color(0, 0, 100));
        const auto tracer = makeTracer(scene);
        const BakeOptions o = bakeOptions(0.4, Vec3d(0.0), Vec3d(1.6), 2048);
        const IrradianceVolume v = bakeVolume(*tracer, o).volume;
        REQUIRE(v.sampleCount() == 125);
        REQUIRE(isFinite(v));
        const ProbeEstimator estimator(*tracer, o.probe);
        ProbeEstimator::Workspace workspace;
        int walls = 0, edges = 0, corners = 0;
        for (SampleId s = 0; s < v.sampleCount(); ++s) {
            const Coord& p = v.samplePosition(s);
            const Vec3d step = inward(p, 4);
            const int surfaces = static_cast<int>(step.length2());
            ++(surfaces == 1 ? walls : surfaces == 2 ? edges : corners);
            CAPTURE(doubleSided, p);
            REQUIRE(v.validity(s) == 1);
            // A probe a little inside, with other random numbers, sees the same light.
            const ProbeResult inside = estimator.radianceSh(
                v.sampleWorld(s) + step * (1e-3 * 0.4), 3, 77 + s, workspace);
            for (std::size_t i = 0; i < 9; ++i)
                for (int c = 0; c < 3; ++c) {
                    // Both have the error; 3000 comparisons: five of them.
                    const double error = std::sqrt(2.0) * inside.stderr_[i][c];
                    REQUIRE(std::abs(v.radiance(s)[i][c] - inside.value[i][c])
                        < 5 * error + 1e-3 * inside.value[0][c]);
                }
        }
        CHECK(walls == 6 * 9);
        CHECK(edges == 12 * 3);
        CHECK(corners == 8 + 27); // and the 27 in the middle
    }
}

TEST_CASE(
    "a wall without thickness between two rooms: the light of one of them", "[bake][hard][surface]")
{
    // Five sides of each room emit 1 and 10; the wall between reflects on both sides. With albedo ½
    // and at most all of the surroundings as bright as can be, 1 ≤ L ≤ 2 and 10 ≤ L ≤ 20 where no
    // wall hides the emitters, and half of that is left beside the wall.
    Scene scene;
    const int left = addMaterial(scene, Color(0.5f), Color(1.0f), false);
    const int right = addMaterial(scene, Color(0.5f), Color(10.0f), false);
    const int wall = addMaterial(scene, Color(0.5f), Color(0.0f), true);
    addInwardBox(scene, left, {0, 0, 0}, {1, 1, 1});
    addInwardBox(scene, right, {1, 0, 0}, {1, 1, 1});
    // The quads in the plane x = 1 go, one takes their place.
    scene.meshes.erase(std::remove_if(scene.meshes.begin(), scene.meshes.end(),
                           [](const Mesh& m) {
                               return std::all_of(m.positions.begin(), m.positions.end(),
                                   [](const Vec3d& p) { return p.x == 1; });
                           }),
        scene.meshes.end());
    REQUIRE(scene.meshes.size() == 10);
    addQuad(scene, wall, {1, 0, 0}, {0, 1, 0}, {0, 0, 1});
    const IrradianceVolume v
        = bakeVolume(*makeTracer(scene), bakeOptions(0.25, Vec3d(0.0), {2, 1, 1}, 1024)).volume;
    int onWall = 0;
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const double L = v.radiance(s)[0].x / std::sqrt(4 * kPi);
        const int x = v.samplePosition(s).x;
        CAPTURE(v.samplePosition(s), L);
        REQUIRE(v.validity(s) == 1);
        const bool dark = L > 0.5 && L<2, bright = L> 5 && L < 20;
        REQUIRE((x < 4 ? dark : x > 4 ? bright : dark != bright));
        onWall += x == 4;
    }
    CHECK(onWall == 25);
}

TEST_CASE("a sample on a slanted roof and in its acute corner", "[bake][hard][surface]")
{
    // A closed prism: floor, a roof of 26.6° that rises from z = 0 to z = 2, back and side walls.
    Scene scene;
    const int m = addMaterial(scene, Color(0.5f), Color(1.0f), false);
    addQuad(scene, m, {0, 0, 0}, {0, 0, 2}, {2, 0, 0}); // floor, up
    addQuad(scene, m, {0, 0, 0}, {2, 0, 0}, {0, 1, 2}); // roof: u × v = (0, −4, 2), down and in
    addQuad(scene, m, {0, 0, 2}, {0, 1, 0}, {2, 0, 0}); // back wall: u × v = −z
    for (const int side : {0, 2}) {
        Mesh wall;
        wall.material = m;
        const double x = side;
        wall.positions = {{x, 0, 0}, {x, 1, 2}, {x, 0, 2}};
        wall.triangles = {{{0, 1, 2}}};
        if (side == 2) std::swap(wall.triangles[0][1], wall.triangles[0][2]);
        scene.meshes.push_back(wall);
    }
    const auto tracer = makeTracer(scene);
    REQUIRE_FALSE(tracer->intersect({1, 0.2, 1}, {1, 0, 0}).backFace);
    REQUIRE_FALSE(tracer->intersect({1, 0.2, 1}, {-1, 0, 0}).backFace);
    REQUIRE_FALSE(tracer->intersect({1, 0.2, 1}, {0, 0, 1}).backFace);
    const IrradianceVolume v
        = bakeVolume(*tracer, bakeOptions(0.5, Vec3d(0.0), {2, 1, 2}, 512)).volume;
    int inside = 0;
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const Coord& p = v.samplePosition(s);
        if (2 * p.y > p.z) continue; // above the roof
        CAPTURE(p);
        CHECK(v.validity(s) == 1);
        CHECK(v.radiance(s)[0].x / std::sqrt(4 * kPi) == Approx(2).margin(0.4));
        ++inside;
    }
    CHECK(inside == 5 * (5 + 3 + 1));
}

TEST_CASE("moved by 1e6: the same light", "[bake][hard][far][heavy]")
{
    const BakeOptions near = bakeOptions(0.4, Vec3d(0.0), Vec3d(1.6), 1024);
    const auto nearTracer = makeTracer(litRoom());
    const IrradianceVolume a = bakeVolume(*nearTracer, near).volume;
    const ProbeEstimator estimator(*nearTracer, near.probe);
    ProbeEstimator::Workspace workspace;
    for (const Vec3d& offset : {Vec3d(1e6, 0, 0), Vec3d(-1e6, 1e6, -1e6)}) {
        BakeOptions far = near;
        far.bounds = Box3d(offset, offset + Vec3d(1.6));
        const IrradianceVolume b = bakeVolume(*makeTracer(litRoom(offset)), far).volume;
        REQUIRE(b.sampleCount() == a.sampleCount());
        double z2 = 0;
        int count = 0;
        for (SampleId s = 0; s < a.sampleCount(); ++s) {
            CAPTURE(offset, a.samplePosition(s));
            REQUIRE(b.validity(s) == 1);
            const Vec3d inside = inward(a.samplePosition(s), 4) * 4e-4;
            const ProbeResult r
                = estimator.radianceSh(a.sampleWorld(s) + inside, 3, 5 + s, workspace);
            for (std::size_t i = 0; i < 9; ++i) {
                const double error = std::sqrt(2.0) * r.stderr_[i].x + 1e-4 * r.value[0].x;
                const double z = (a.radiance(s)[i].x - b.radiance(s)[i].x) / error;
                REQUIRE(std::abs(z) < 5);
                z2 += z * z;
                ++count;
            }
        }
        CHECK(count == 125 * 9);
        CHECK(std::sqrt(z2 / count) < 1.1);
    }
}

TEST_CASE("scaled by 1e-4 and 1e5: the same light, path by path", "[bake][hard][scale]")
{
    // Radiance does not know scale (the lamp's candela grow with its square), and lattice points
    // keep their random numbers: only rounding differs.
    const IrradianceVolume a
        = bakeVolume(*makeTracer(litRoom()), bakeOptions(0.4, Vec3d(0.0), Vec3d(1.6), 512)).volume;
    for (const double scale : {1e-4, 1e5}) {
        const BakeOptions o = bakeOptions(0.4 * scale, Vec3d(0.0), Vec3d(1.6 * scale), 512);
        const IrradianceVolume b
            = bakeVolume(*makeTracer(litRoom(Vec3d(0.0), 1.6 * scale)), o).volume;
        const Difference d = difference(a, b);
        CAPTURE(scale, d.max, d.rms);
        CHECK(d.rms < 5e-3);
        for (SampleId s = 0; s < a.sampleCount(); ++s) {
            REQUIRE(b.validity(s) == 1);
            REQUIRE(b.distance(s) / scale == Approx(a.distance(s)).epsilon(0.01));
        }
    }
}

TEST_CASE("nothing to see: black scene, no lights, no geometry, one voxel", "[bake][hard]")
{
    Scene black;
    addInwardBox(
        black, addMaterial(black, Color(0.5f), Color(0.0f), false), Vec3d(0.0), Vec3d(1.0));
    Scene empty;
    addMaterial(empty, Color(1.0f), Color(0.0f), false);
    Scene sky = empty;
    sky.environment = Environment::constant(Color(1.0f));
    Scene darkSky = black;
    darkSky.environment = Environment::constant(Color(0.0f));
    for (const GradientMethod gradients : {GradientMethod::None, GradientMethod::Central}) {
        for (const Scene* scene : {&black, &empty, &sky, &darkSky}) {
            for (const double h : {0.5, 1.0}) {
                BakeOptions o = bakeOptions(h, Vec3d(0.0), Vec3d(1.0), 64);
                o.gradients = gradients;
                const BakeResult r = bakeVolume(*makeTracer(*scene), o);
                REQUIRE(isFinite(r.volume));
                CHECK(r.report.samples == (h == 1 ? 8 : 27));
                CHECK(std::isfinite(r.report.meanRelativeStderr));
                for (SampleId s = 0; s < r.volume.sampleCount(); ++s) {
                    const Color L = r.volume.radiance(s)[0];
                    if (scene == &sky) {
                        CHECK(L.x == Approx(std::sqrt(4 * kPi)).epsilon(1e-5));
                    } else {
                        CHECK(L == Color(0.0f));
                    }
                }
            }
        }
    }
}

TEST_CASE("a lamp exactly on a sample, and one very near", "[bake][hard]")
{
    Scene scene = litRoom();
    scene.lights[0].position = Vec3d(0.8);
    Light near = scene.lights[0];
    near.position = Vec3d(0.4, 0.4, 0.4 + 1e-7);
    scene.lights.push_back(near);
    BakeOptions o = bakeOptions(0.4, Vec3d(0.0), Vec3d(1.6), 64);
    o.gradients = GradientMethod::Central;
    CHECK(isFinite(bakeVolume(*makeTracer(scene), o).volume));
}

TEST_CASE("sun through a pinhole: a dynamic range of 1e8", "[bake][hard][pinhole]")
{
    // A dark room [-1,1]³ under a hole of side a. A sun of 1e8 lux from straight above lights a
    // spot a × a of the floor, of albedo ½: a Lambertian panel of radiance E/2π. All else is black,
    // so the light at a point is that panel's, by Lambert's formula.
    const double a = 0.1, E = 1e8;
    Scene scene;
    const int white = addMaterial(scene, Color(0.5f), Color(0.0f), false);
    const int dark = addMaterial(scene, Color(0.0f), Color(0.0f), true);
    addInwardBox(scene, dark, Vec3d(-1.0), Vec3d(2.0));
    scene.meshes[0].material = white; // floor
    REQUIRE(scene.meshes[3].positions[2].y == 1);
    scene.meshes.erase(scene.meshes.begin() + 3); // the ceiling: four quads take its place
    const double h = a / 2;
    addQuad(scene, dark, {-1, 1, -1}, {2, 0, 0}, {0, 0, 1 - h});
    addQuad(scene, dark, {-1, 1, h}, {2, 0, 0}, {0, 0, 1 - h});
    addQuad(scene, dark, {-1, 1, -h}, {1 - h, 0, 0}, {0, 0, a});
    addQuad(scene, dark, {h, 1, -h}, {1 - h, 0, 0}, {0, 0, a});
    Light sun;
    sun.type = LightType::Directional;
    sun.direction = Vec3d(0, -1, 0);
    sun.intensity = Color(static_cast<float>(E), 1.0f, 0.0f);
    scene.lights.push_back(sun);

    ProbeOptions o;
    o.rays = 1 << 17;
    Bench bench(scene, o);
    const std::vector<Vec3d> spot = {{-h, -1, -h}, {h, -1, -h}, {h, -1, h}, {-h, -1, h}};
    const Vec3d p(0.3, -0.6, -0.2);
    const Vec3d down(0, -1, 0);
    const double expected = E * 0.5 / kPi * polygonIrradiance(p, down, spot);
    const ProbeResult r = bench.irradiance(p, {Vec3f(down), {0, 1, 0}});
    CAPTURE(r.value[0].x, r.stderr_[0].x, expected);
    CHECK(std::abs(r.value[0].x - expected) < 4 * r.stderr_[0].x);
    CHECK(r.stderr_[0].x < 0.03 * expected);
    // Red and green are the same paths: 1e8 times apart to rounding, and blue is black.
    CHECK(r.value[0].y * E == Approx(r.value[0].x).epsilon(1e-4));
    CHECK(r.value[0].z == 0);
    // In the beam the sun itself arrives, without noise.
    CHECK(bench.irradiance({0, 0.3, 0}, {{0, 1, 0}}).value[0].x == Approx(E).epsilon(1e-6));
    CHECK(bench.irradiance({2 * h, 0.3, 0}, {{0, 1, 0}}).value[0].x == 0);

    // A bake of it, with gradients, has no infinity and no NaN.
    BakeOptions b = bakeOptions(0.25, Vec3d(-1.0), Vec3d(1.0), 64);
    b.gradients = GradientMethod::Central;
    CHECK(isFinite(bakeVolume(bench.tracer(), b).volume));
}

TEST_CASE("a lit environment of 1e8 seen through the same hole", "[bake][hard][pinhole]")
{
    // One texel of the sky is 1e8, the others 1. Under the hole E = L Ω cos for the texel.
    const int w = 64, h = 32, row = 1, column = 20;
    std::vector<Color> pixels(static_cast<std::size_t>(w * h), Color(1.0f));
    pixels[static_cast<std::size_t>(row * w + column)] = Color(1e8f);
    Scene scene;
    const int dark = addMaterial(scene, Color(0.0f), Color(0.0f), true);
    scene.environment = Environment::fromPixels(w, h, pixels, {});
    // A screen with a hole towards the texel's middle.
    const double u = (column + 0.5) / w, v = (row + 0.5) / h;
    const Vec3d d(std::sin(kPi * v) * std::cos(2 * kPi * (u - 0.5)), std::cos(kPi * v),
        std::sin(kPi * v) * std::sin(2 * kPi * (u - 0.5)));
    const Vec3d hole = d / d.y; // where it meets y = 1
    const double a = 0.2; // hole's half side; the texel is 0.1 rad wide
    addQuad(scene, dark, {-99, 1, -99}, {198, 0, 0}, {0, 0, 99 + hole.z - a});
    addQuad(scene, dark, {-99, 1, hole.z + a}, {198, 0, 0}, {0, 0, 99 - hole.z - a});
    addQuad(scene, dark, {-99, 1, hole.z - a}, {99 + hole.x - a, 0, 0}, {0, 0, 2 * a});
    addQuad(scene, dark, {hole.x + a, 1, hole.z - a}, {99 - hole.x - a, 0, 0}, {0, 0, 2 * a});
    ProbeOptions o;
    o.rays = 8192;
    Bench bench(scene, o);
    const double omega = 2 * kPi / w * (std::cos(kPi * row / h) - std::cos(kPi * (row + 1) / h));
    const ProbeResult r = bench.irradiance({0, 0, 0}, {Vec3f(d), Vec3f(-d)});
    CAPTURE(r.value[0].x, r.stderr_[0].x, omega * 1e8);
    // cos over the texel: 1 − θ²/2 with θ below 0.07.
    CHECK(std::abs(r.value[0].x - omega * 1e8) < 4 * r.stderr_[0].x + 0.0025 * omega * 1e8);
    CHECK(r.stderr_[0].x < 0.01 * omega * 1e8);
    // Out of the beam only the sky of 1 is left: under a millionth, not a firefly in sight.
    const ProbeResult beside = bench.irradiance({1.5, 0, 1.5}, {Vec3f(0, 1, 0)});
    CHECK(beside.value[0].x < 10);
    CHECK(std::isfinite(beside.stderr_[0].x));
}
