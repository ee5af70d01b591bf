// SPDX-License-Identifier: Apache-2.0
// Rooms, doors and solids: what visibility and relocation are for.
#include <lumivdb/bake/visibility.h>

#include "bake_makers.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <cmath>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

/// A closed box whose fronts look outward: a solid block.
void addSolid(Scene& scene, int material, const Vec3d& lower, const Vec3d& size)
{
    const std::size_t first = scene.meshes.size();
    addInwardBox(scene, material, lower, size);
    for (std::size_t m = first; m < scene.meshes.size(); ++m)
        for (auto& t : scene.meshes[m].triangles) std::swap(t[1], t[2]);
}

Scene emptyScene()
{
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), false);
    addMaterial(scene, Color(0.5f), Color(0.0f), true);
    return scene;
}

IrradianceVolume uniform(const Coord& lower, const Coord& upper, double spacing = 1)
{
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(spacing));
    builder.addUniform(lower, upper);
    return builder.build();
}

/// Mean of the corners by trilinear weights over those that count; −1 where none does.
double interpolate(const IrradianceVolume& v, const Vec3d& world, bool masks)
{
    const Vec3d p = world * v.worldToIndex();
    const Coord c(static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
        static_cast<int>(std::floor(p.z)));
    const CellId id = v.findCell(c);
    if (id == kNoCell) return -1;
    const Cell& cell = v.cell(id);
    const Vec3d t = (p - Vec3d(cell.origin)) / static_cast<double>(1 << cell.level);
    unsigned seen = 0xff;
    if (masks && v.visibility(id)) seen = v.visibility(id)->corners(Vec3f(t));
    double sum = 0, weights = 0;
    for (int i = 0; i < 8; ++i) {
        if (!(seen >> i & 1) || !v.isValid(cell.corners[i])) continue;
        const double w
            = (i & 1 ? t.x : 1 - t.x) * (i & 2 ? t.y : 1 - t.y) * (i & 4 ? t.z : 1 - t.z);
        sum += w * v.radiance(cell.corners[i])[0].x;
        weights += w;
    }
    return weights > 0 ? sum / weights : -1;
}

} // namespace

TEST_CASE("a lit room does not shine through a wall without thickness", "[visibility]")
{
    // Lit for x < 2.3, dark behind: samples know which side they are on. Naive interpolation leaks
    // into the cell of the wall; with masks no point of the dark side gets any light.
    for (const double wall : {2.3, 2.0, 2.97}) {
        Scene scene = emptyScene();
        addInwardBox(scene, 0, Vec3d(0.1), Vec3d(4.8));
        addQuad(scene, 1, {wall, 0.1, 0.1}, {0, 4.8, 0}, {0, 0, 4.8});
        const auto tracer = makeTracer(std::move(scene));
        IrradianceVolume v = uniform({0, 0, 0}, {5, 5, 5});
        std::vector<Vec3f> offsets(v.sampleCount(), Vec3f(0.0f));
        for (SampleId s = 0; s < v.sampleCount(); ++s) {
            const Coord p = v.samplePosition(s);
            if (p.x == wall) offsets[s].x = -1e-3f;
            v.radiance(s)[0] = Color(p.x <= wall ? 1.0f : 0.0f);
            for (int a = 0; a < 3; ++a)
                if (p[a] == 0 || p[a] == 5) v.validity(s) = 0.3f;
        }
        v.setOffsets(offsets);
        CHECK(computeVisibility(v, *tracer).cutCells >= 25);
        CounterRng rng(2);
        double naive = 0, masked = 0, litSide = 1;
        for (int i = 0; i < 20000; ++i) {
            Vec3d p(0.1 + 4.8 * rng.next(), 0.1 + 4.8 * rng.next(), 0.1 + 4.8 * rng.next());
            if (i % 4 == 0) p.x = wall + (i % 8 == 0 ? 1e-4 : -1e-4);
            if (p.x > wall) {
                naive = std::max(naive, interpolate(v, p, false));
                masked = std::max(masked, interpolate(v, p, true));
            } else {
                litSide = std::min(litSide, interpolate(v, p, true));
            }
        }
        INFO("wall at " << wall);
        CHECK(naive > 0.02); // beyond the wall at 2.97 the lit corners still weigh 0.03
        CHECK(masked == 0);
        CHECK(litSide == 1);
    }
}

TEST_CASE("beside a doorway the wall still hides", "[visibility]")
{
    // The wall ends at z = 2.4: behind it (z < 2.4) only what the door lets see counts.
    Scene scene = emptyScene();
    addQuad(scene, 1, {1.4, -50, -50}, {0, 100, 0}, {0, 0, 52.4});
    const auto tracer = makeTracer(std::move(scene));
    IrradianceVolume v = uniform({0, 0, 0}, {3, 3, 4});
    computeVisibility(v, *tracer);
    CounterRng rng(4);
    std::size_t places = 0, wrong = 0, away = 0;
    for (int i = 0; i < 20000; ++i) {
        const Vec3d p(1 + rng.next(), 3 * rng.next(), 4 * rng.next());
        const Coord c(static_cast<int>(p.x), static_cast<int>(p.y), static_cast<int>(p.z));
        const CellId id = v.findCell(c);
        const CellVisibility* cut = v.visibility(id);
        const std::uint8_t mask = cut ? cut->corners(Vec3f(p - Vec3d(c))) : 0xff;
        Vec3d corners[8];
        for (int k = 0; k < 8; ++k) corners[k] = v.measuredWorld(v.cell(id).corners[k]);
        const std::uint8_t exact = cornersSeen(*tracer, p, corners);
        for (int k = 0; k < 8; ++k) wrong += (mask >> k & 1) != (exact >> k & 1);
        places += 8;
        if (p.z < 2 || p.z > 3) away += mask != exact;
    }
    CHECK(away == 0); // outside the door's own cells
    CHECK(static_cast<double>(wrong) < 0.05 * static_cast<double>(places));
}

TEST_CASE("a sample in a block moves before its nearest front", "[relocate]")
{
    Scene scene = emptyScene();
    addSolid(scene, 0, {-1, -1, -1}, {2, 2, 2});
    const auto tracer = makeTracer(std::move(scene));
    const auto p = relocated(*tracer, {0.7, 0.1, -0.2}, 1, 0.01);
    REQUIRE(p);
    CHECK(p->x == Approx(1.01).margin(1e-6));
    // 256 directions: the nearest found is within their spacing of the perpendicular.
    CHECK(std::abs(p->y - 0.1) < 0.1);
    CHECK(std::abs(p->z + 0.2) < 0.1);
    CHECK_FALSE(relocated(*tracer, {0.7, 0.1, -0.2}, 0.3, 0.01)); // 0.31 away
    CHECK_FALSE(relocated(*tracer, {0, 0, 0}, 0.9, 0.01));
    const auto again = relocated(*tracer, {0.7, 0.1, -0.2}, 1, 0.01);
    CHECK(*again == *p);
}

TEST_CASE("no sample moves into another solid", "[relocate]")
{
    // The near side is covered by a second block that overlaps nothing but the way out.
    Scene scene = emptyScene();
    addSolid(scene, 0, {-1, -1, -1}, {2, 2, 2});
    addSolid(scene, 0, {1.005, -1.5, -1.5}, {1, 3, 3});
    const auto tracer = makeTracer(std::move(scene));
    const auto p = relocated(*tracer, {0.7, 0.1, -0.2}, 2, 0.01);
    REQUIRE(p);
    CHECK(std::max(std::abs(p->y), std::abs(p->z)) > 1); // out at another side
}
