// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/visibility.h>

#include "bake_makers.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <cmath>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

IrradianceVolume uniform(const Coord& lower, const Coord& upper, const Mat4d& m = Mat4d())
{
    VolumeBuilder builder(1, GradientStorage::None, m);
    builder.addUniform(lower, upper);
    return builder.build();
}

/// A double-sided wall x = @a x that reaches beyond everything.
void addWallX(Scene& scene, int material, double x)
{
    addQuad(scene, material, {x, -50, -50}, {0, 100, 0}, {0, 0, 100});
}

Scene wallScene(const std::vector<double>& xs)
{
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), true);
    for (const double x : xs) addWallX(scene, 0, x);
    return scene;
}

/// Bits of the corners i whose measured place lies on the same side of all x in @a walls as @a t.
std::uint8_t sameSide(const IrradianceVolume& v, CellId id, double x, std::vector<double> walls)
{
    std::uint8_t mask = 0;
    for (int i = 0; i < 8; ++i) {
        const double cx = v.measuredWorld(v.cell(id).corners[i]).x;
        bool same = true;
        for (const double w : walls) same = same && (cx < w) == (x < w);
        if (same) mask = static_cast<std::uint8_t>(mask | 1 << i);
    }
    return mask;
}

std::uint8_t maskAt(const IrradianceVolume& v, CellId id, const Vec3f& t)
{
    const CellVisibility* cut = v.visibility(id);
    return cut ? cut->corners(t) : 0xff;
}

/// Asks every cell at many places, and a hair before and behind every wall. Unit spacing.
std::size_t checkWalls(const IrradianceVolume& v, const std::vector<double>& walls)
{
    std::size_t checked = 0;
    CounterRng rng(3);
    for (CellId id = 0; id < static_cast<CellId>(v.cellCount()); ++id) {
        const Cell& cell = v.cell(id);
        const double width = 1 << cell.level;
        std::vector<double> xs;
        for (int i = 0; i < 50; ++i) xs.push_back(rng.next());
        for (const double w : walls)
            for (const double step : {-1e-5, 1e-5})
                xs.push_back((w - cell.origin.x) / width + step);
        for (const double x : xs) {
            if (x < 0 || x > 1) continue;
            const std::uint8_t expected = sameSide(v, id, cell.origin.x + x * width, walls);
            if (expected == 0) continue; // between walls, no sample: nothing is right
            const Vec3f t(static_cast<float>(x), rng.next(), rng.next());
            INFO("cell " << id << " t " << t << " expected " << int(expected));
            REQUIRE(int(maskAt(v, id, t)) == int(expected));
            ++checked;
        }
    }
    return checked;
}

} // namespace

TEST_CASE("a wall without thickness divides cells exactly where it stands", "[visibility]")
{
    for (const double x : {0.5, 0.3, 0.02, 0.998, 1.7}) {
        INFO("wall at " << x);
        const auto tracer = makeTracer(wallScene({x}));
        IrradianceVolume v = uniform({-1, 0, 0}, {3, 2, 2});
        const VisibilityReport report = computeVisibility(v, *tracer);
        CHECK(report.touchedCells == 4);
        CHECK(report.cutCells == 4);
        CHECK(checkWalls(v, {x}) > 500);
    }
}

TEST_CASE("a wall on a lattice plane leaves samples on the side they were moved to", "[visibility]")
{
    const auto tracer = makeTracer(wallScene({1}));
    for (const float side : {-1e-3f, 1e-3f}) {
        IrradianceVolume v = uniform({-1, 0, 0}, {3, 2, 2});
        std::vector<Vec3f> offsets(v.sampleCount(), Vec3f(0.0f));
        for (SampleId s = 0; s < v.sampleCount(); ++s)
            if (v.samplePosition(s).x == 1) offsets[s].x = side;
        v.setOffsets(offsets);
        const VisibilityReport report = computeVisibility(v, *tracer);
        CHECK(report.touchedCells == 8); // on both sides
        CHECK(report.cutCells == 4); // on the side that sees only its far corners
        CHECK(checkWalls(v, {1}) > 500);
    }
}

TEST_CASE("thin double walls keep both rooms apart", "[visibility]")
{
    // Two single-sided walls back to back, 0.01 apart: the solid between them counts for nobody.
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), false);
    addQuad(scene, 0, {0.4, -50, -50}, {0, 0, 100}, {0, 100, 0}); // front to −x
    addQuad(scene, 0, {0.41, -50, -50}, {0, 100, 0}, {0, 0, 100}); // front to +x
    const auto tracer = makeTracer(std::move(scene));
    IrradianceVolume v = uniform({-1, 0, 0}, {3, 2, 2});
    CHECK(computeVisibility(v, *tracer).cutCells == 4);
    CHECK(checkWalls(v, {0.4, 0.41}) > 500);
}

TEST_CASE("two walls in one cell make three regions", "[visibility]")
{
    const auto tracer = makeTracer(wallScene({0.3, 0.8}));
    IrradianceVolume v = uniform({0, 0, 0}, {1, 1, 1});
    CHECK(computeVisibility(v, *tracer).cutCells == 1);
    CHECK(checkWalls(v, {0.3, 0.8}) > 20);
    CHECK(int(maskAt(v, 0, {0.5f, 0.5f, 0.5f})) == 0); // a closet that no sample is in
}

TEST_CASE("slanted walls divide exactly, rotated lattices too", "[visibility]")
{
    CounterRng rng(11);
    for (int round = 0; round < 20; ++round) {
        const Vec3d n = Vec3d(rng.next() - 0.5, rng.next() - 0.5, rng.next() - 0.5).normalized();
        const Vec3d u = n.cross(std::abs(n.x) < 0.6 ? Vec3d(1, 0, 0) : Vec3d(0, 1, 0)).normalized();
        const Vec3d w = n.cross(u);
        Mat4d m;
        m.setAxisAngle(Vec3d(1, 2, 3).normalized(), round * 0.3);
        m = latticeTransform(0.5) * m;
        const Vec3d middle = Vec3d(0.9 + 0.2 * rng.next()) * m;
        Scene scene;
        addMaterial(scene, Color(0.5f), Color(0.0f), true);
        addQuad(scene, 0, middle - u * 20.0 - w * 20.0, u * 40.0, w * 40.0);
        const auto tracer = makeTracer(std::move(scene));
        IrradianceVolume v = uniform({0, 0, 0}, {2, 2, 2}, m);
        REQUIRE(computeVisibility(v, *tracer).cutCells > 0);
        for (int i = 0; i < 4000; ++i) {
            Vec3d p(2 * rng.next(), 2 * rng.next(), 2 * rng.next());
            Vec3d world = p * m;
            if (i % 2 == 0) { // onto the wall, a hair off
                world -= n * n.dot(world - middle) + n * (i % 4 == 0 ? 1e-5 : -1e-5);
                p = world * m.inverse();
            }
            const Coord c(static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
                static_cast<int>(std::floor(p.z)));
            const CellId id = v.findCell(c);
            if (id == kNoCell) continue;
            std::uint8_t expected = 0;
            for (int k = 0; k < 8; ++k) {
                const Vec3d corner = v.sampleWorld(v.cell(id).corners[k]);
                if ((n.dot(corner - middle) > 0) == (n.dot(world - middle) > 0))
                    expected = static_cast<std::uint8_t>(expected | 1 << k);
            }
            if (expected == 0) continue;
            INFO("round " << round << " p " << p);
            REQUIRE(int(maskAt(v, id, Vec3f(p - Vec3d(c)))) == int(expected));
        }
    }
}

TEST_CASE("nothing between, no cut; inside of solids does not count", "[visibility]")
{
    // A room of single-sided walls at 0.3 from the lattice: outside corners are invalid.
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), false);
    addInwardBox(scene, 0, Vec3d(0.3), Vec3d(3.4));
    const auto tracer = makeTracer(std::move(scene));
    IrradianceVolume v = uniform({0, 0, 0}, {4, 4, 4});
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const Coord p = v.samplePosition(s);
        for (int a = 0; a < 3; ++a)
            if (p[a] == 0 || p[a] == 4) v.validity(s) = 0;
    }
    const VisibilityReport report = computeVisibility(v, *tracer);
    CHECK(report.touchedCells == 64 - 8);
    CHECK(report.cutCells == 0);
}

TEST_CASE("the same bits for any number of threads", "[visibility]")
{
    Scene scene = litRoom(Vec3d(0.02), 1.55, true);
    addQuad(scene, 0, {0.8, 0, 0}, {0.05, 1.1, 0}, {0, 0, 1.1});
    const auto tracer = makeTracer(std::move(scene));
    IrradianceVolume one = uniform({-1, -1, -1}, {9, 9, 9}, latticeTransform(0.2));
    IrradianceVolume two = one.clone();
    CHECK(computeVisibility(one, *tracer, 1).cutCells > 50);
    computeVisibility(two, *tracer, 7);
    for (CellId id = 0; id < static_cast<CellId>(one.cellCount()); ++id) {
        const CellVisibility *a = one.visibility(id), *b = two.visibility(id);
        REQUIRE((a != nullptr) == (b != nullptr));
        if (a) REQUIRE(*a == *b);
    }
}

TEST_CASE("small, large and far scenes are cut alike", "[visibility]")
{
    struct Place {
        double scale;
        Vec3d origin;
    };
    for (const Place& place : {Place{1e-4, Vec3d(0.0)}, Place{1e5, Vec3d(0.0)},
             Place{1, Vec3d(1e6, -1e6, 1e6)}, Place{0.01, Vec3d(-1e3, 0, 1e3)}}) {
        INFO("scale " << place.scale << " at " << place.origin);
        Scene scene;
        addMaterial(scene, Color(0.5f), Color(0.0f), true);
        const auto at = [&](double x, double y, double z) {
            return Vec3d(x, y, z) * place.scale + place.origin;
        };
        addQuad(scene, 0, at(0.3, -1, -1), {0, 5 * place.scale, 0}, {0, 0, 5 * place.scale});
        const auto tracer = makeTracer(std::move(scene));
        Mat4d m = latticeTransform(place.scale);
        for (int a = 0; a < 3; ++a) m[3][a] = place.origin[a];
        IrradianceVolume v = uniform({-1, 0, 0}, {3, 2, 2}, m);
        CHECK(computeVisibility(v, *tracer).cutCells == 4);
        for (CellId id = 0; id < static_cast<CellId>(v.cellCount()); ++id) {
            const bool cut = v.cell(id).origin.x == 0;
            CHECK(int(maskAt(v, id, {0.29f, 0.4f, 0.6f})) == (cut ? 0x55 : 0xff));
            CHECK(int(maskAt(v, id, {0.31f, 0.4f, 0.6f})) == (cut ? 0xaa : 0xff));
        }
    }
}

TEST_CASE("degenerate triangles, cut-outs and empty scenes cut nothing", "[visibility]")
{
    IrradianceVolume v = uniform({0, 0, 0}, {2, 2, 2});
    CHECK(computeVisibility(v, *makeTracer(Scene{})).touchedCells == 0);
    Scene scene;
    const int solid = addMaterial(scene, Color(0.5f), Color(0.0f), true);
    const int hole = addMaterial(scene, Color(0.5f), Color(0.0f), true);
    scene.materials[static_cast<std::size_t>(hole)].alphaMask = true;
    scene.materials[static_cast<std::size_t>(hole)].alphaFactor = 0;
    addQuad(scene, hole, {0.3, -1, -1}, {0, 5, 0}, {0, 0, 5});
    addQuad(scene, solid, {0.5, 0.5, -1}, {0, 0, 0}, {0, 0, 5}); // a line
    addQuad(scene, solid, {1.5, 1.5, 1.5}, {0, 0, 0}, {0, 0, 0}); // a point
    const auto tracer = makeTracer(std::move(scene));
    const VisibilityReport report = computeVisibility(v, *tracer);
    CHECK(report.touchedCells == 5);
    CHECK(report.cutCells == 0);
    CHECK_FALSE(v.hasVisibility());
}

TEST_CASE("cornersSeen looks from one place", "[visibility]")
{
    const auto tracer = makeTracer(wallScene({0.5}));
    Vec3d corners[8];
    for (int i = 0; i < 8; ++i) corners[i] = Vec3d(i & 1, i >> 1 & 1, i >> 2 & 1);
    CHECK(int(cornersSeen(*tracer, {0.25, 0.5, 0.5}, corners)) == 0x55);
    CHECK(int(cornersSeen(*tracer, {0.75, 0.5, 0.5}, corners)) == 0xaa);
    CHECK(int(cornersSeen(*tracer, corners[3], corners)) == 0xaa); // itself included
}

TEST_CASE("a progress that cancels leaves the volume as it was", "[visibility]")
{
    class Cancelling : public Progress {
    public:
        bool cancelled() override { return true; }
    };
    const auto tracer = makeTracer(wallScene({0.5}));
    IrradianceVolume v = uniform({0, 0, 0}, {2, 2, 2});
    Cancelling cancelling;
    CHECK(errorOf(ErrorCode::Interrupted, [&] { computeVisibility(v, *tracer, 0, &cancelling); })
        != "");
    CHECK_FALSE(v.hasVisibility());
}

TEST_CASE("coarse cells are cut too", "[visibility]")
{
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(1));
    builder.addCell({0, 0, 0}, 3);
    builder.addCell({8, 0, 0}, 2);
    builder.addCell({8, 4, 0}, 2);
    builder.addCell({8, 0, 4}, 2);
    builder.addCell({8, 4, 4}, 2);
    IrradianceVolume v = builder.build();
    const auto tracer = makeTracer(wallScene({2.7, 9.1}));
    CHECK(computeVisibility(v, *tracer).cutCells == 5);
    CHECK(checkWalls(v, {2.7, 9.1}) > 200);
}
