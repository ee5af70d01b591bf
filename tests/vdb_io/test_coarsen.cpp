// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/sampler.h>
#include <lumivdb/vdb_io/resample.h>

#include <catch2/catch.hpp>

#include <cmath>

using namespace vdb_test;

namespace {

/// Linear in space, valid everywhere: any coarser cell reproduces it.
IrradianceVolume linearVolume(const Coord& lower, const Coord& upper, int bands = 2)
{
    IrradianceVolume v = uniformVolume(lower, upper, bands, false);
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const Coord p = v.samplePosition(s);
        for (int c = 0; c < v.coefficients(); ++c)
            v.radiance(s)[c]
                = Color(100.0f + p.x + c, 50.0f - 0.5f * p.y, 80.0f + p.z * 0.25f - p.x);
        v.validity(s) = 1;
    }
    return v;
}

std::size_t count(const IrradianceVolume& v, std::size_t level)
{
    const auto levels = v.cellsByLevel();
    return level < levels.size() ? levels[level] : 0;
}

} // namespace

TEST_CASE("what is linear becomes coarse, level by level")
{
    const IrradianceVolume v = linearVolume({-16, 0, 0}, {16, 16, 16});
    CHECK(count(coarsenVolume(v, 0, 0), 0) == 8192);
    CHECK(count(coarsenVolume(v, 1, 0), 1) == 1024);
    const IrradianceVolume coarse = coarsenVolume(v, 12, 0);
    CHECK(coarse.cellsByLevel() == std::vector<std::size_t>{0, 0, 0, 0, 2});
    CHECK(coarse.sampleCount() == 12);
    CHECK(coarse.spacing() == v.spacing());
    CHECK(compareVolumes(v, coarse, 2000, 1) < 1e-6);
    CHECK(coarse.metadata().errorReached == -1);
}

TEST_CASE("a bump stays fine, balanced, and within the tolerance")
{
    IrradianceVolume v = linearVolume({0, 0, 0}, {32, 32, 32}, 1);
    const auto s = static_cast<SampleId>(v.findSample({5, 6, 7}));
    v.radiance(s)[0].y += 1.0f;
    const IrradianceVolume coarse = coarsenVolume(v, 12, 0); // balanced: build() says so
    const std::int64_t kept = coarse.findSample({5, 6, 7});
    REQUIRE(kept >= 0);
    CHECK(coarse.radiance(static_cast<SampleId>(kept))[0].y == v.radiance(s)[0].y);
    CHECK(count(coarse, 0) >= 8);
    CHECK(coarse.cellCount() < 600);
    CHECK(compareVolumes(v, coarse, 2000, 1) < 1e-6);
    // Mean irradiance of the brightest channel is π Y00 times about 116; the bump is π Y00 times 1,
    // which weighs A_0/sqrt(4π) = π Y00 too: 1/116 of the mean.
    CHECK(coarsenVolume(v, 12, 0.5 / 116).cellCount() == coarse.cellCount());
    CHECK(coarsenVolume(v, 12, 1.5 / 116).cellCount() == 1);
}

TEST_CASE("cut cells, moved samples and mixed validity are left as they are")
{
    const IrradianceVolume plain = linearVolume({0, 0, 0}, {8, 8, 8});
    REQUIRE(coarsenVolume(plain, 1, 0).cellCount() == 64);
    IrradianceVolume cut = plain.clone();
    CellVisibility lower;
    lower.masks = 0x0f;
    const CellId id = cut.findCell({3, 3, 3});
    cut.setVisibility({{id, lower}});
    const IrradianceVolume coarseCut = coarsenVolume(cut, 1, 0);
    CHECK(coarseCut.cellCount() == 63 + 8);
    REQUIRE(coarseCut.visibility(coarseCut.findCell({3, 3, 3})));
    CHECK(*coarseCut.visibility(coarseCut.findCell({3, 3, 3})) == lower);

    IrradianceVolume moved = plain.clone();
    std::vector<Vec3f> offsets(moved.sampleCount(), Vec3f(0.0f));
    offsets[static_cast<std::size_t>(moved.findSample({3, 3, 3}))].x = 0.01f; // inside one parent
    moved.setOffsets(offsets);
    CHECK(coarsenVolume(moved, 1, 0).cellCount() == 63 + 8);

    IrradianceVolume dark = plain.clone();
    dark.validity(static_cast<SampleId>(dark.findSample({3, 3, 3}))) = 0.2f;
    CHECK(coarsenVolume(dark, 1, 0).cellCount() == 63 + 8);
    for (SampleId s = 0; s < dark.sampleCount(); ++s) dark.validity(s) = 0.2f;
    CHECK(coarsenVolume(dark, 1, 0).cellCount() == 64);
}

TEST_CASE("impossible levels and tolerances are refused")
{
    const IrradianceVolume v = linearVolume({0, 0, 0}, {2, 2, 2});
    CHECK_THROWS_AS(coarsenVolume(v, 13, 0), Error);
    CHECK_THROWS_AS(coarsenVolume(v, -1, 0), Error);
    CHECK_THROWS_AS(coarsenVolume(v, 1, -1), Error);
    CHECK_THROWS_AS(coarsenVolume(v, 1, std::nan("")), Error);
}
