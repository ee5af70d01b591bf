// SPDX-License-Identifier: Apache-2.0
// From a scene to a volume by light propagation: what is added to what, and what is decided.

#include "bake_makers.h"

#include <lumivdb/bake/lpv_bake.h>

#include <catch2/catch.hpp>

#include <cmath>
#include <functional>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

LpvBakeOptions lpvOptions(double spacing)
{
    LpvBakeOptions o;
    o.lpv.spacing = spacing;
    o.rsmResolution = 64;
    o.rays = 64;
    return o;
}

double meanL0(const IrradianceVolume& volume)
{
    double sum = 0;
    for (SampleId s = 0; s < volume.sampleCount(); ++s) sum += volume.radiance(s)[0].y;
    return sum / static_cast<double>(volume.sampleCount());
}

/// Largest difference of coefficients between @a a and @a b + @a c, over the largest of @a a.
double worstOfSum(const IrradianceVolume& a, const IrradianceVolume& b, const IrradianceVolume& c)
{
    double worst = 0, most = 0;
    for (SampleId s = 0; s < a.sampleCount(); ++s) {
        for (int i = 0; i < a.coefficients(); ++i) {
            const Color sum = b.radiance(s)[i] + c.radiance(s)[i];
            worst = std::max(worst, static_cast<double>((a.radiance(s)[i] - sum).length()));
            most = std::max(most, static_cast<double>(a.radiance(s)[i].length()));
        }
    }
    return worst / most;
}

} // namespace

TEST_CASE("a propagated volume has the lattice, channels and metadata of a bake", "[lpvbake]")
{
    const auto tracer = makeTracer(litRoom());
    LpvBakeOptions options = lpvOptions(0.2);
    options.seed = 9;
    options.commandLine = "the command";
    const LpvBakeResult lpv = bakeLpv(*tracer, options);
    BakeOptions same;
    same.spacing = 0.2;
    same.bands = 2;
    same.probe.rays = 64;
    same.probe.seed = 9;
    same.probe.contribution = Contribution::Direct;
    same.probe.maxBounces = 0;
    const BakeResult baked = bakeVolume(*tracer, same);

    const IrradianceVolume &a = lpv.volume, &b = baked.volume;
    REQUIRE(a.sampleCount() == b.sampleCount());
    CHECK(a.cellCount() == b.cellCount());
    CHECK(a.indexToWorld() == b.indexToWorld());
    CHECK(a.bands() == 2);
    CHECK(a.hasBlocking());
    CHECK(a.hasVisibility());
    for (SampleId s = 0; s < a.sampleCount(); ++s) {
        REQUIRE(a.samplePosition(s) == b.samplePosition(s));
        REQUIRE(a.validity(s) == b.validity(s));
        REQUIRE(a.distance(s) == b.distance(s));
        REQUIRE(a.offset(s) == b.offset(s));
    }
    CHECK(a.metadata().contribution == "indirect");
    CHECK(a.metadata().options == "the command");
    CHECK(a.metadata().seed == 9);
    CHECK(a.metadata().sceneHash == tracer->scene().contentHash);
    CHECK(meanL0(a) > 0);
    CHECK(lpv.report.samples == a.sampleCount());
    CHECK(lpv.report.propagation.residual < 1e-3);

    // All light is the propagated and the traced, the latter a bake's to the bit.
    options.contribution = Contribution::All;
    const LpvBakeResult all = bakeLpv(*tracer, options);
    CHECK(all.volume.metadata().contribution == "all");
    CHECK(worstOfSum(all.volume, a, b) < 1e-6);
}

TEST_CASE("propagated volumes are the same bits for any number of threads", "[lpvbake][heavy]")
{
    const auto tracer = makeTracer(litRoom());
    LpvBakeOptions options = lpvOptions(0.2);
    options.lpv.bounces = LpvBounces::Many;
    options.contribution = Contribution::All;
    options.maxSurfels = 3000;
    options.lpv.threads = 1;
    const LpvBakeResult one = bakeLpv(*tracer, options);
    CHECK(one.report.surfels <= 3000);
    for (const int threads : {2, 4}) {
        options.lpv.threads = threads;
        const IrradianceVolume other = bakeLpv(*tracer, options).volume;
        CHECK(differentRecords(one.volume, other) == 0);
        for (CellId c = 0; c < static_cast<CellId>(one.volume.cellCount()); ++c) {
            REQUIRE(one.volume.blocking(c) == other.blocking(c));
        }
    }
}

TEST_CASE("far from surfaces nothing blocks", "[lpvbake][heavy]")
{
    const auto tracer = makeTracer(litRoom());
    LpvBakeOptions options = lpvOptions(0.4);
    options.bounds = Box3d(Vec3d(-8.0), Vec3d(8.0));
    options.rays = 0;
    const IrradianceVolume volume = bakeLpv(*tracer, options).volume;
    int near = 0, far = 0;
    for (CellId c = 0; c < static_cast<CellId>(volume.cellCount()); ++c) {
        const Coord& o = volume.cell(c).origin;
        const bool touches = std::min({o.x, o.y, o.z}) >= -1 && std::max({o.x, o.y, o.z}) <= 4;
        const Vec3f blocked = volume.blocking(c);
        if (touches) {
            near += blocked != Vec3f(0.0f);
        } else {
            ++far;
            REQUIRE(blocked == Vec3f(0.0f));
        }
    }
    CHECK(near > 20);
    CHECK(far > 50000);
}

TEST_CASE("light groups add up where nothing is clamped", "[lpvbake]")
{
    const auto groupVolume = [](const char* group) {
        Scene scene = litRoom();
        scene.lights[0].name = "lamp";
        scene.materials[2].name = "panel";
        if (group[0]) selectLightGroup(scene, group);
        const auto tracer = makeTracer(std::move(scene));
        LpvBakeOptions options = lpvOptions(0.2);
        options.lpv.scheme = LpvScheme::Conservative;
        options.lpv.cutoff = 0;
        options.stop = {24, 0};
        return bakeLpv(*tracer, options).volume;
    };
    const IrradianceVolume both = groupVolume(""), lamp = groupVolume("lamp"),
                           panel = groupVolume("panel");
    CHECK(meanL0(lamp) > 0);
    CHECK(meanL0(panel) > 0);
    CHECK(worstOfSum(both, lamp, panel) < 1e-4);
}

TEST_CASE("cascades of a scene reach over it", "[lpvbake][heavy]")
{
    const auto tracer = makeTracer(litRoom());
    LpvBakeOptions options = lpvOptions(0);
    options.cascades.cascades = 2;
    options.cascades.cells = 24;
    const LpvBakeResult lpv = bakeLpv(*tracer, options);
    REQUIRE(lpv.report.decisions.size() == 1);
    CHECK(lpv.report.cellsByLevel.size() == 2);
    CHECK(lpv.report.surfelsOutside == 0);
    const Box3d world = lpv.volume.worldBounds(), scene = tracer->scene().bounds();
    for (int a = 0; a < 3; ++a) {
        CHECK(world.min[a] <= scene.min[a]);
        CHECK(world.max[a] >= scene.max[a]);
    }
    CHECK(meanL0(lpv.volume) > 0);
}

TEST_CASE("hard cases of propagated volumes", "[lpvbake]")
{
    SECTION("no light, no geometry")
    {
        Scene dark = litRoom();
        dark.lights.clear();
        dark.materials[2].emission = Color(0.0f);
        const LpvBakeResult lpv = bakeLpv(*makeTracer(std::move(dark)), lpvOptions(0.2));
        CHECK(meanL0(lpv.volume) == 0);
        REQUIRE(lpv.report.warnings.size() == 1);
        const auto empty = makeTracer(Scene{{}, {Material{}}, {}, {}, {}, nullptr, {}, {}});
        const LpvBakeResult nothing = bakeLpv(*empty, lpvOptions(0.5));
        CHECK(nothing.volume.sampleCount() == 5 * 5 * 5);
        CHECK(meanL0(nothing.volume) == 0);
    }
    SECTION("light outside the volume, and one cell")
    {
        const auto tracer = makeTracer(litRoom());
        LpvBakeOptions options = lpvOptions(0.1);
        options.bounds = Box3d(Vec3d(0.75), Vec3d(0.76));
        const LpvBakeResult lpv = bakeLpv(*tracer, options);
        CHECK(lpv.volume.cellCount() == 1);
        CHECK(lpv.report.surfelsOutside == lpv.report.surfels);
        CHECK(meanL0(lpv.volume) == 0);
    }
    SECTION("albedo 1 and a very bright lamp, many bounces")
    {
        Scene scene = litRoom();
        for (Material& m : scene.materials) m.baseColor = Color(1.0f);
        scene.lights[0].intensity = Color(1e8f);
        LpvBakeOptions options = lpvOptions(0.2);
        options.lpv.bounces = LpvBounces::Many;
        options.stop = {500, 1e-3};
        const LpvBakeResult lpv = bakeLpv(*makeTracer(std::move(scene)), options);
        CHECK(std::isfinite(meanL0(lpv.volume)));
        CHECK(meanL0(lpv.volume) > 0);
    }
    SECTION("samples that nobody looks at are valid")
    {
        LpvBakeOptions options = lpvOptions(0.2);
        options.rays = 0;
        const LpvBakeResult lpv = bakeLpv(*makeTracer(litRoom()), options);
        CHECK(lpv.report.cutCells == 0);
        for (SampleId s = 0; s < lpv.volume.sampleCount(); ++s) {
            REQUIRE(lpv.volume.validity(s) == 1);
        }
    }
    SECTION("options that do not fit")
    {
        const auto tracer = makeTracer(litRoom());
        const auto refused = [&](const std::function<void(LpvBakeOptions&)>& change) {
            LpvBakeOptions options = lpvOptions(0.2);
            change(options);
            return errorOf(ErrorCode::Usage, [&] { bakeLpv(*tracer, options); });
        };
        CHECK(refused([](auto& o) { o.contribution = Contribution::Direct; }) != "");
        CHECK(refused([](auto& o) { o.rays = 1; }) != "");
        CHECK(refused([](auto& o) { o.stop.tolerance = 1; }) != "");
        CHECK(refused([](auto& o) { o.stop.iterations = -1; }) != "");
        CHECK(refused([](auto& o) { o.center = Vec3d(0.0); }) != "");
        CHECK(refused([](auto& o) { o.rsmResolution = 0; }) != "");
        CHECK(refused([](auto& o) { o.lpv.spacing = 1e-4; }) != "");
    }
    SECTION("cancelled")
    {
        struct Stopped : Progress {
            bool cancelled() override { return true; }
        } stopped;
        const auto tracer = makeTracer(litRoom());
        CHECK(errorOf(ErrorCode::Interrupted, [&] { bakeLpv(*tracer, lpvOptions(0.2), &stopped); })
            != "");
    }
}
