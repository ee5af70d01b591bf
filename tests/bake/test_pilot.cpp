// SPDX-License-Identifier: Apache-2.0
// The look ahead that a bake's choices rest on.

#include "../../bake/src/pilot.h"
#include "bake_makers.h"

#include <catch2/catch.hpp>

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
