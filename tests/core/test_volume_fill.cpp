// SPDX-License-Identifier: Apache-2.0
#include "volume_makers.h"

#include <lumivdb/core/volume_fill.h>

#include <catch2/catch.hpp>

using namespace lumivdb;
using namespace volume_test;

TEST_CASE("invalid samples are filled from valid neighbours, ring by ring", "[fill]")
{
    // A row of cells; the plane x = 0 is lit, everything else invalid.
    IrradianceVolume v = uniformVolume(1, GradientStorage::PerCoefficient, {0, 0, 0}, {5, 1, 1});
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const bool lit = v.samplePosition(s).x == 0;
        v.validity(s) = lit ? 1.0f : 0.25f;
        v.radiance(s)[0] = Color(lit ? 2.0f : -7.0f);
        v.gradient(s)[1] = Color(3.0f);
    }
    fillInvalid(v);
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        CHECK(v.radiance(s)[0].x == Approx(2.0f)); // means of equal values
        const bool lit = v.samplePosition(s).x == 0;
        CHECK(v.validity(s) == (lit ? 1.0f : 0.25f));
        CHECK(v.gradient(s)[1].x == (lit ? 3.0f : 0.0f));
    }
}

TEST_CASE("weights are one over the squared distance", "[fill]")
{
    // One cell, one invalid corner: neighbours at squared distances 1, 1, 1, 2, 2, 2, 3. Only the
    // one across the diagonal shines, with 1: (1/3) / (3 + 3/2 + 1/3) = 2/29.
    IrradianceVolume v = uniformVolume(1, GradientStorage::None, {0, 0, 0}, {1, 1, 1});
    v.validity(static_cast<SampleId>(v.findSample({0, 0, 0}))) = 0;
    v.radiance(static_cast<SampleId>(v.findSample({1, 1, 1})))[0] = Color(1.0f);
    fillInvalid(v);
    CHECK(v.radiance(static_cast<SampleId>(v.findSample({0, 0, 0})))[0].y
        == Approx(2.0 / 29).epsilon(1e-6));
}

TEST_CASE("filling twice is filling once, and without valid samples black", "[fill]")
{
    IrradianceVolume v = volumeOf(multiLevelCells());
    fillRandom(v, 4);
    CounterRng rng(8);
    std::size_t invalid = 0;
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        v.validity(s) = rng.next();
        invalid += !v.isValid(s);
    }
    REQUIRE(invalid > 100);
    fillInvalid(v);
    IrradianceVolume twice = v.clone();
    fillInvalid(twice);
    std::size_t different = 0, black = 0;
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        for (int i = 0; i < v.coefficients(); ++i)
            different += v.radiance(s)[i] != twice.radiance(s)[i];
        black += v.radiance(s)[0] == Color(0.0f);
    }
    CHECK(different == 0);
    CHECK(black == 0);
    for (SampleId s = 0; s < v.sampleCount(); ++s) v.validity(s) = 0;
    fillInvalid(v);
    for (SampleId s = 0; s < v.sampleCount(); ++s) REQUIRE(v.radiance(s)[0] == Color(0.0f));
}
