// SPDX-License-Identifier: Apache-2.0
// The look ahead that a bake's choices rest on.

#include "../../bake/src/pilot.h"
#include "bake_makers.h"

#include <catch2/catch.hpp>

#include <algorithm>
#include <array>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

/// Leaves numbers near 1e306 where the next calls have their variables.
__attribute__((noinline)) double dirtyStack()
{
    volatile double numbers[1 << 14];
    for (volatile double& number : numbers) number = 0x1p1017;
    return numbers[123];
}

} // namespace

TEST_CASE("pilot: what it finds depends on nothing that was in memory before", "[pilot]")
{
    const auto tracer = makeTracer(litRoom());
    ProbeOptions probe;
    probe.rays = 64;
    Progress silent;
    std::array<Pilot, 3> pilots;
    for (Pilot& pilot : pilots) {
        REQUIRE(dirtyStack() > 0);
        pilot = lookAhead(*tracer, probe, Box3d(Vec3d(0.1), Vec3d(1.5)), 8, silent);
        CHECK(pilot.points > 0);
        CHECK(pilot.truncation == pilots[0].truncation);
        // One band leaves the light's direction out.
        CHECK(pilot.truncation[1] > pilot.truncation[3]);
        for (const double share : pilot.truncation) CHECK(share < 100);
    }
}

TEST_CASE("coefficients and irradiances of the same rays are those of either alone", "[pilot]")
{
    const auto tracer = makeTracer(litRoom());
    ProbeOptions probe;
    probe.rays = 300;
    const ProbeEstimator estimator(*tracer, probe);
    ProbeEstimator::Workspace workspace;
    const Vec3d p(0.4, 0.7, 0.6);
    const std::vector<Vec3f> normals = uniformNormals(7);
    const ProbeResult both = estimator.radianceShAndIrradiance(p, 4, normals, 5, workspace),
                      sh = estimator.radianceSh(p, 4, 5, workspace),
                      direct = estimator.irradiance(p, normals, 5, workspace);
    REQUIRE(both.value.size() == 16 + 7);
    REQUIRE(both.stderr_.size() == 16 + 7);
    CHECK(std::equal(sh.value.begin(), sh.value.end(), both.value.begin()));
    CHECK(std::equal(sh.stderr_.begin(), sh.stderr_.end(), both.stderr_.begin()));
    CHECK(std::equal(direct.value.begin(), direct.value.end(), both.value.begin() + 16));
    CHECK(std::equal(direct.stderr_.begin(), direct.stderr_.end(), both.stderr_.begin() + 16));
    CHECK(both.rays == sh.rays);
}
