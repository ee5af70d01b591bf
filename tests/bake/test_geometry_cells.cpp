// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/geometry_cells.h>

#include "bake_makers.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <cmath>
#include <thread>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

using Triangle = std::array<Vec3d, 3>;

std::unique_ptr<Tracer> tracerOf(const std::vector<Triangle>& triangles, bool alphaMask = false)
{
    Scene scene;
    const int m = addMaterial(scene, Color(0.5f), Color(0.0f), false);
    scene.materials[0].alphaMask = alphaMask;
    scene.materials[0].alphaFactor = alphaMask ? 0.0f : 1.0f;
    Mesh mesh;
    mesh.material = m;
    for (const Triangle& t : triangles) {
        const auto base = static_cast<std::uint32_t>(mesh.positions.size());
        mesh.positions.insert(mesh.positions.end(), t.begin(), t.end());
        mesh.triangles.push_back({base, base + 1, base + 2});
    }
    scene.meshes.push_back(mesh);
    return makeTracer(std::move(scene));
}

/// Clips the triangle by the box's six half-spaces (Sutherland and Hodgman): another way than
/// separating axes. Positive: they overlap although the box shrinks by it; negative: they do not
/// although it grows.
bool clipOverlaps(const Triangle& t, const Box3d& box, double grow)
{
    std::vector<Vec3d> p(t.begin(), t.end());
    for (int a = 0; a < 3; ++a) {
        for (const double sign : {1.0, -1.0}) {
            const double limit = (sign > 0 ? box.max[a] : -box.min[a]) + grow;
            std::vector<Vec3d> out;
            for (std::size_t i = 0; i < p.size(); ++i) {
                const Vec3d &u = p[i], &v = p[(i + 1) % p.size()];
                const double du = sign * u[a] - limit, dv = sign * v[a] - limit;
                if (du <= 0) out.push_back(u);
                if ((du < 0 && dv > 0) || (du > 0 && dv < 0))
                    out.push_back(u + (v - u) * (du / (du - dv)));
            }
            p.swap(out);
        }
    }
    return !p.empty();
}

struct Draw {
    CounterRng rng;
    explicit Draw(std::uint64_t key)
        : rng(key)
    {
    }
    double in(double low, double high) { return low + (high - low) * rng.next(); }
    Vec3d point(double size) { return {in(-size, size), in(-size, size), in(-size, size)}; }
    double scale(double low, double high) { return std::exp(in(std::log(low), std::log(high))); }
};

} // namespace

TEST_CASE("boxes touch what clipping says", "[geometry_cells]")
{
    std::size_t touching = 0, apart = 0, close = 0;
    for (std::uint64_t round = 0; round < 40; ++round) {
        Draw draw(round);
        std::vector<Triangle> triangles;
        for (int i = 0; i < 30; ++i) {
            const double size = draw.scale(1e-3, 10);
            const Vec3d c = draw.point(1);
            Triangle t{c, c + draw.point(size), c + draw.point(size)};
            if (i % 7 == 0) t[2] = t[1]; // a line
            if (i % 11 == 0) t[2] = t[1] = t[0]; // a point
            triangles.push_back(t);
        }
        const auto tracer = tracerOf(triangles);
        const GeometryCells cells(*tracer);
        for (int i = 0; i < 300; ++i) {
            const double size = draw.scale(1e-3, 4);
            const Vec3d c = draw.point(1.5);
            const Box3d box(c, c + Vec3d(size * draw.in(0, 1), size, size * draw.in(0.1, 1)));
            // Vertices up to 12 are kept with an error of up to 12 · 2^-24 = 7e-7.
            bool surely = false, possibly = false;
            for (const Triangle& t : triangles) {
                surely = surely || clipOverlaps(t, box, 0);
                possibly = possibly || clipOverlaps(t, box, 2e-6);
            }
            const bool touches = cells.touches(box);
            if (surely) REQUIRE(touches);
            if (!possibly) REQUIRE(!touches);
            ++(surely ? touching : possibly ? close : apart);
        }
    }
    CHECK(touching > 2000);
    CHECK(apart > 1000);
    CHECK(close < 50);
}

TEST_CASE("closed boxes and triangles touch in a face, an edge and a vertex", "[geometry_cells]")
{
    // All coordinates are exact in single precision, whatever the scene's middle is.
    const auto tracer = tracerOf({{Vec3d(0, 0, 0), Vec3d(4, 0, 0), Vec3d(0, 0, 4)}});
    const GeometryCells cells(*tracer);
    const auto touches
        = [&](const Vec3d& low, const Vec3d& high) { return cells.touches(Box3d(low, high)); };
    CHECK(touches({0.5, -1, 0.5}, {1, 0, 1})); // plane in the box's top
    CHECK(touches({0.5, 0, 0.5}, {1, 1, 1})); // in its bottom
    CHECK(touches({2, -1, 2}, {3, 1, 3})); // the slanted edge through a box's edge: x + z = 4
    CHECK(touches({-1, -1, -1}, {0, 0, 0})); // vertex on vertex
    CHECK(touches({4, 0, 0}, {5, 1, 1}));
    CHECK(touches({1, 0, 1}, {1, 0, 1})); // a box that is a point
    CHECK(touches({-1e30, -1e30, -1e30}, {1e30, 1e30, 1e30}));
    // Rounding here is 2 · 2^-24 = 1.2e-7 along x and z, 0 along y.
    CHECK_FALSE(touches({0.5, -1, 0.5}, {1, -1e-9, 1}));
    CHECK_FALSE(touches({2.00001, -1, 2.00001}, {3, 1, 3}));
    CHECK_FALSE(touches({-1, -1, -1}, {-1e-6, 0, 0}));
    CHECK_FALSE(touches({5, 5, 5}, {1e30, 1e30, 1e30}));
    CHECK_FALSE(cells.touches(Box3d()));
}

TEST_CASE("a wall far from the origin is found where it is", "[geometry_cells]")
{
    const Vec3d far(1e6, -1e6, 1e6);
    const auto tracer = tracerOf({{far, far + Vec3d(0, 1, 0), far + Vec3d(0, 0, 1)},
        {far + Vec3d(1, 0, 0), far + Vec3d(1, 1, 0), far + Vec3d(1, 0, 1)}});
    const GeometryCells cells(*tracer);
    CHECK(cells.touches(Box3d(far + Vec3d(-0.1, 0.1, 0.1), far + Vec3d(0, 0.2, 0.2))));
    CHECK_FALSE(cells.touches(Box3d(far + Vec3d(0.001, 0, 0), far + Vec3d(0.999, 1, 1))));
}

TEST_CASE("a plane 1e5 wide does not thicken", "[geometry_cells]")
{
    const auto tracer = tracerOf({{Vec3d(-1e5, 0, -1e5), Vec3d(1e5, 0, -1e5), Vec3d(0, 0, 1e5)}});
    const GeometryCells cells(*tracer);
    CHECK(cells.touches(Box3d({0, -1, 0}, {1, 0, 1})));
    CHECK_FALSE(cells.touches(Box3d({0, 1e-6, 0}, {1, 1, 1})));
}

TEST_CASE("masked triangles count and no triangles touch nothing", "[geometry_cells]")
{
    const auto masked = tracerOf({{Vec3d(0, 0, 0), Vec3d(4, 0, 0), Vec3d(0, 0, 4)}}, true);
    CHECK(GeometryCells(*masked).touches(Box3d({0.5, -1, 0.5}, {1, 1, 1})));
    const auto nothing = tracerOf({});
    CHECK_FALSE(GeometryCells(*nothing).touches(Box3d({-1, -1, -1}, {1, 1, 1})));
}

TEST_CASE("collect lists each triangle once, in order, from any thread", "[geometry_cells]")
{
    Draw draw(5);
    std::vector<Triangle> triangles;
    for (int i = 0; i < 500; ++i) {
        const Vec3d c = draw.point(1);
        triangles.push_back({c, c + draw.point(0.1), c + draw.point(0.1)});
    }
    const auto tracer = tracerOf(triangles);
    const GeometryCells cells(*tracer);
    const Box3d box({-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5});
    std::vector<std::uint32_t> expected;
    for (std::uint32_t i = 0; i < triangles.size(); ++i)
        if (clipOverlaps(triangles[i], box, 0)) expected.push_back(i);
    REQUIRE(expected.size() > 30);
    std::vector<std::uint32_t> found[4];
    std::vector<std::thread> threads;
    for (auto& f : found) threads.emplace_back([&] { cells.collect(box, f); });
    for (std::thread& t : threads) t.join();
    for (const auto& f : found) CHECK(f == expected);
}
