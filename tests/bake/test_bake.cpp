// SPDX-License-Identifier: Apache-2.0
// The bake: where samples lie, that their bits depend on nothing but the inputs, and what they
// hold.

#include "bake_makers.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <atomic>
#include <cmath>
#include <limits>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

Scene emptyScene()
{
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), false);
    return scene;
}

bool contains(const std::vector<std::string>& lines, const std::string& what)
{
    for (const std::string& line : lines)
        if (line.find(what) != std::string::npos) return true;
    return false;
}

/// Counts, and asks to stop after some samples.
class Watch : public Progress {
public:
    explicit Watch(std::uint64_t stopAfter)
        : mStopAfter(stopAfter)
    {
    }
    void begin(const char* /*stage*/, std::uint64_t total) override { steps = total; }
    void advance(std::uint64_t n) override { done += n; }
    bool cancelled() override { return done >= mStopAfter; }
    std::uint64_t steps = 0;
    std::atomic<std::uint64_t> done{0};

private:
    std::uint64_t mStopAfter;
};

} // namespace

TEST_CASE("bounds that are multiples of the spacing give exactly n + 1 samples", "[bake][bounds]")
{
    const auto tracer = makeTracer(emptyScene());
    const auto bake = [&](double h, const Vec3d& lower, const Vec3d& upper) {
        return bakeVolume(*tracer, bakeOptions(h, lower, upper, 2)).volume;
    };
    const IrradianceVolume seed = bake(0.1, Vec3d(0.0), Vec3d(1.6));
    CHECK(seed.sampleCount() == 4913);
    CHECK(seed.minLattice() == Coord(0));
    CHECK(seed.maxLattice() == Coord(16));
    for (const double h : {0.1, 0.3, 0.05, 1 / 3.0, 0.7, 1e-4, 123.4}) {
        for (const int first : {-7, 0, 3, 1000003}) {
            const Vec3d lower(first * h, -first * h, first * h);
            const IrradianceVolume v = bake(h, lower, lower + Vec3d(3 * h, 2 * h, h));
            CAPTURE(h, first);
            CHECK(v.sampleCount() == 4 * 3 * 2);
            CHECK(v.minLattice() == Coord(first, -first, first));
        }
    }
    // Anything else grows to whole cells of the lattice through the origin.
    const IrradianceVolume grown = bake(0.5, {-0.6, 0.1, 0.2}, {0.4, 0.2, 1.3});
    CHECK(grown.minLattice() == Coord(-2, 0, 0));
    CHECK(grown.maxLattice() == Coord(1, 1, 3));
    CHECK(grown.indexToWorld() == latticeTransform(0.5));
    // One voxel, also where the box is much smaller than it.
    CHECK(bake(1, Vec3d(0.2), Vec3d(0.3)).sampleCount() == 8);
    CHECK(bake(1, Vec3d(2.0), Vec3d(2.0 + 1e-9)).sampleCount() == 8);
}

TEST_CASE(
    "defaults: bounds of the scene and a cell more, a round spacing, both said", "[bake][bounds]")
{
    const struct {
        double size, spacing;
    } cases[] = {{2, 0.1}, {20, 1}, {39.9, 1}, {40, 2}, {99.9, 2}, {100, 5}, {199, 5}, {200, 10},
        {1e-4, kMinSpacing}, {3.9e-4, kMinSpacing}, {1e5, 5000}};
    for (const auto& k : cases) {
        const Box3d box(Vec3d(7.0), Vec3d(7 + k.size, 7 + 0.5 * k.size, 7 + k.size * 0.9));
        CAPTURE(k.size);
        CHECK(defaultSpacing(box) == Approx(k.spacing).epsilon(1e-12));
    }
    CHECK(defaultSpacing(Box3d()) == 0.1);
    CHECK(defaultSpacing(Box3d(Vec3d(1.0), Vec3d(1.0))) == 0.1);

    Scene scene = emptyScene();
    addInwardBox(scene, 0, {0.03, 0, 0}, {2, 0.4, 0.2});
    BakeOptions o;
    o.probe.rays = 2;
    const BakeResult r = bakeVolume(*makeTracer(scene), o);
    CHECK(r.report.spacing == 0.1);
    CHECK(contains(r.report.decisions, "spacing 0.1"));
    // 0.03 − 0.1 → −1 and 2.03 + 0.1 → 22 steps; −0.1 … 0.5 and −0.1 … 0.3 fall on the lattice.
    CHECK(r.volume.minLattice() == Coord(-1, -1, -1));
    CHECK(r.volume.maxLattice() == Coord(22, 5, 3));

    const BakeResult nothing = bakeVolume(*makeTracer(emptyScene()), o);
    CHECK(nothing.volume.sampleCount() == 21 * 21 * 21);
    CHECK(contains(nothing.report.decisions, "no geometry"));
}

TEST_CASE("the report and the metadata say what was done", "[bake]")
{
    const auto tracer = makeTracer(litRoom());
    BakeOptions o = bakeOptions(0.8, Vec3d(0.0), Vec3d(1.6), 32);
    o.probe.seed = 99;
    o.probe.contribution = Contribution::Indirect;
    o.lightGroup = "lamp";
    o.commandLine = "bake it";
    o.bands = 2;
    const BakeResult r = bakeVolume(*tracer, o);
    CHECK(r.report.samples == 27);
    CHECK(r.report.cellsByLevel == std::vector<std::uint64_t>{8});
    CHECK(r.report.rays > 27 * 32);
    CHECK(r.report.raysPerSecond > 0);
    CHECK(r.report.meanRelativeStderr > 0);
    CHECK(r.report.meanRelativeStderr < 1);
    const VolumeMetadata& m = r.volume.metadata();
    CHECK(m.contribution == "indirect");
    CHECK(m.lightGroup == "lamp");
    CHECK(m.seed == 99);
    CHECK(m.raysPerSample == 32);
    CHECK(m.options == "bake it");
    CHECK(r.volume.bands() == 2);
    CHECK_FALSE(r.volume.hasGradients());
}

TEST_CASE("options that make no sense are refused with their name and value", "[bake][error]")
{
    const auto tracer = makeTracer(emptyScene());
    const BakeOptions good = bakeOptions(1, Vec3d(0.0), Vec3d(1.0), 2);
    const auto refusal = [&](const BakeOptions& o) {
        return errorOf(ErrorCode::Usage, [&] { bakeVolume(*tracer, o); });
    };
    const double nan = std::numeric_limits<double>::quiet_NaN();
    CHECK(refusal(good) == "");
    const auto with = [&](auto change) {
        BakeOptions o = good;
        change(o);
        return refusal(o);
    };
    CHECK(with([](BakeOptions& o) { o.bands = -1; }).find("bands is -1") != std::string::npos);
    CHECK(with([](BakeOptions& o) { o.bands = 7; }).find("bands is 7") != std::string::npos);
    CHECK(with([](BakeOptions& o) { o.probe.rays = 1; }).find("rays is 1") != std::string::npos);
    CHECK(with([](BakeOptions& o) { o.probe.rays = -5; }).find("-5") != std::string::npos);
    CHECK(with([](BakeOptions& o) { o.probe.maxBounces = -2; }).find("-2") != std::string::npos);
    CHECK(with([](BakeOptions& o) { o.spacing = -1; }).find("spacing is -1") != std::string::npos);
    CHECK(with([&](BakeOptions& o) { o.spacing = nan; }).find("spacing") != std::string::npos);
    CHECK(with([](BakeOptions& o) { o.spacing = 1e-6; }) != "");
    CHECK(with([](BakeOptions& o) { o.spacing = 1e-12; }) != "");
    CHECK(with([](BakeOptions& o) { o.bounds->max.y = 0; }).find("along y") != std::string::npos);
    CHECK(
        with([&](BakeOptions& o) { o.bounds->min.z = nan; }).find("along z") != std::string::npos);
    CHECK(with([](BakeOptions& o) { o.bounds->max.x = 1.0 / 0.0 * 1; }) != "");
    // 1500³ samples is beyond 2³¹; 3·10⁶ in a row is beyond the lattice's keys.
    CHECK(with([](BakeOptions& o) { o.bounds->max = Vec3d(1500.0); }).find("2^31")
        != std::string::npos);
    CHECK(with([](BakeOptions& o) { o.bounds->max.x = 3e6; }).find("2^21") != std::string::npos);
    CHECK(with([](BakeOptions& o) { o.bounds = Box3d(Vec3d(2e9), Vec3d(2e9 + 1)); }).find("lattice")
        != std::string::npos);
}

TEST_CASE("the same bits for 1, 2 and 4 threads", "[bake][determinism][heavy]")
{
    const auto tracer = makeTracer(litRoom());
    for (const int rays : {96, 5000}) { // above 4096 a probe is split between threads itself
        BakeOptions o = bakeOptions(0.4, Vec3d(0.0), rays > 4096 ? Vec3d(0.4) : Vec3d(1.6), rays);
        o.gradients = GradientMethod::Central;
        o.threads = 1;
        const BakeResult one = bakeVolume(*tracer, o);
        std::size_t bright = 0;
        for (SampleId s = 0; s < one.volume.sampleCount(); ++s)
            bright += one.volume.radiance(s)[0].x > 0;
        CHECK(bright == one.volume.sampleCount());
        for (const int threads : {2, 4, 0}) {
            o.threads = threads;
            const BakeResult r = bakeVolume(*tracer, o);
            CAPTURE(rays, threads);
            CHECK(differentRecords(one.volume, r.volume) == 0);
            CHECK(r.report.rays == one.report.rays);
            CHECK(r.report.meanRelativeStderr == one.report.meanRelativeStderr);
        }
        // And for another tracer of the same scene.
        CHECK(differentRecords(one.volume, bakeVolume(*makeTracer(litRoom()), o).volume) == 0);
    }
}

TEST_CASE("split in two boxes: the same bits in every sample", "[bake][determinism]")
{
    const auto tracer = makeTracer(litRoom());
    BakeOptions o = bakeOptions(0.2, Vec3d(0.0), Vec3d(1.6), 32);
    const IrradianceVolume whole = bakeVolume(*tracer, o).volume;
    std::size_t compared = 0, different = 0, shared = 0;
    for (const int half : {0, 1}) {
        o.bounds = Box3d({half * 0.6, 0, 0}, {half ? 1.6 : 0.6, 1.6, 1.6});
        const IrradianceVolume part = bakeVolume(*tracer, o).volume;
        for (SampleId s = 0; s < part.sampleCount(); ++s) {
            const std::int64_t other = whole.findSample(part.samplePosition(s));
            REQUIRE(other >= 0);
            different += !sameRecord(part, s, whole, static_cast<SampleId>(other));
            shared += part.samplePosition(s).x == 3;
            ++compared;
        }
    }
    CHECK(different == 0);
    CHECK(shared == 2 * 81);
    CHECK(compared == whole.sampleCount() + 81);
}

TEST_CASE(
    "another seed is another estimate; no seed repeats from point to point", "[bake][determinism]")
{
    const auto tracer = makeTracer(litRoom());
    BakeOptions o = bakeOptions(0.8, Vec3d(0.0), Vec3d(1.6), 64);
    const IrradianceVolume a = bakeVolume(*tracer, o).volume;
    o.probe.seed = 2;
    const IrradianceVolume b = bakeVolume(*tracer, o).volume;
    CHECK(differentRecords(a, b) == a.sampleCount());
    // In a furnace all points look the same but for the lengths of their paths: neighbours that
    // shared their random numbers would err alike. 4·5² pairs know a correlation to ±0.1.
    Scene furnace;
    addInwardBox(
        furnace, addMaterial(furnace, Color(0.9f), Color(1.0f), false), Vec3d(-1.0), Vec3d(2.0));
    const IrradianceVolume v
        = bakeVolume(*makeTracer(furnace), bakeOptions(0.25, Vec3d(-0.5), Vec3d(0.5), 32)).volume;
    const auto error = [&](std::int64_t s) {
        return v.radiance(static_cast<SampleId>(s))[0].x / std::sqrt(4 * kPi) - 10;
    };
    double together = 0, alone = 0;
    int pairs = 0;
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const std::int64_t next = v.findSample(v.samplePosition(s) + Coord(1, 0, 0));
        if (next < 0) continue;
        together += error(s) * error(next);
        alone += error(s) * error(s);
        ++pairs;
    }
    CHECK(pairs == 100);
    CHECK(alone > 0);
    CHECK(std::abs(together / alone) < 0.5);
}

TEST_CASE("a bake that is cancelled throws Interrupted, at once or soon", "[bake][progress]")
{
    const auto tracer = makeTracer(litRoom());
    const BakeOptions o = bakeOptions(0.1, Vec3d(0.0), Vec3d(1.6), 16);
    for (const std::uint64_t stopAfter : {0, 1, 50}) {
        Watch watch(stopAfter);
        const std::string message
            = errorOf(ErrorCode::Interrupted, [&] { bakeVolume(*tracer, o, &watch); });
        CHECK(message != "");
        CHECK(watch.steps == 4913);
        CHECK(watch.done <= stopAfter + 64); // what was under way
    }
    Watch watch(1 << 30);
    BakeOptions whole = bakeOptions(0.8, Vec3d(0.0), Vec3d(1.6), 16);
    bakeVolume(*tracer, whole, &watch);
    CHECK(watch.done == 27 + 8); // samples, then cells
    CHECK(watch.steps == 8);
    Watch plain(1 << 30);
    whole.visibility = false;
    bakeVolume(*tracer, whole, &plain);
    CHECK(plain.done == 27);
    CHECK(plain.steps == 27);
}

TEST_CASE("validity: none inside a solid, half on its rim's level, all outside", "[bake][validity]")
{
    // A solid cube [-1,1]³: fronts look outward, so from inside every ray meets a back face.
    Scene scene = emptyScene();
    addInwardBox(scene, 0, Vec3d(-1.0), Vec3d(2.0));
    for (Mesh& m : scene.meshes)
        for (auto& t : m.triangles) std::swap(t[1], t[2]);
    scene.environment = Environment::constant(Color(1.0f));
    const auto bake = [&] {
        return bakeVolume(*makeTracer(scene), bakeOptions(0.5, Vec3d(-2.0), Vec3d(2.0), 256))
            .volume;
    };
    const IrradianceVolume v = bake();
    int inside = 0, outside = 0, wrong = 0;
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const Coord& p = v.samplePosition(s);
        const int reach = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
        if (reach < 2) {
            ++inside;
            wrong += v.validity(s) != 0 || v.radiance(s)[0] != Color(0.0f) || v.isValid(s);
        } else {
            // Beside it, and exactly on it, where samples move to the outside.
            ++outside;
            wrong += v.validity(s) != 1 || !(v.radiance(s)[0].x > 0);
        }
    }
    CHECK(inside == 27);
    CHECK(outside == 9 * 9 * 9 - 27);
    CHECK(wrong == 0);
    // Double-sided walls have no inside.
    scene.materials[0].doubleSided = true;
    const IrradianceVolume both = bake();
    for (SampleId s = 0; s < both.sampleCount(); ++s) REQUIRE(both.validity(s) == 1);
}

TEST_CASE("harmonic mean distance: closed forms", "[bake][distance]")
{
    SECTION("centre of a cube of half side a")
    {
        // 1/r = cosθ/a towards a face, so the mean of 1/r is 6/(4π a) ∫_face cosθ dω, and that
        // integral is π times the form factor of a square seen from its axis at a distance of half
        // its side: F = 4 · (1/π) · (1/√2) · atan(1/√2) (Howell, configuration B-3, A = B = 1).
        const double a = 0.8, F = 4 / kPi * std::sqrt(0.5) * std::atan(std::sqrt(0.5));
        const double expected = a * 4 / (6 * F);
        CHECK(expected / a == Approx(1.2031).epsilon(1e-4));
        Scene scene = emptyScene();
        addInwardBox(scene, 0, Vec3d(0.0), Vec3d(1.6));
        const auto tracer = makeTracer(scene);
        const IrradianceVolume v
            = bakeVolume(*tracer, bakeOptions(0.8, Vec3d(0.0), Vec3d(1.6), 4096)).volume;
        const auto s = static_cast<SampleId>(v.findSample({1, 1, 1}));
        CHECK(v.distance(s) == Approx(expected).epsilon(2e-3));
        Bench bench(scene, bakeOptions(1, Vec3d(0.0), Vec3d(1.0), 4096).probe);
        const ProbeResult r = bench.sh(Vec3d(0.8), 1);
        CHECK(r.minDistance == Approx(a).epsilon(5e-3));
        CHECK(r.minDistance >= a * 0.999999);
    }
    SECTION("above an endless floor, half of the rays escape")
    {
        // 1/r = cosθ/h below, 0 above: mean (1/4π) ∫ cosθ/h dω = 1/(4h).
        Scene scene = emptyScene();
        addQuad(scene, 0, {-1e4, 0, -1e4}, {0, 0, 2e4}, {2e4, 0, 0});
        const auto tracer = makeTracer(scene);
        const IrradianceVolume v
            = bakeVolume(*tracer, bakeOptions(1, {0, 1, 0}, {1, 3, 1}, 4096)).volume;
        for (SampleId s = 0; s < v.sampleCount(); ++s) {
            CHECK(v.distance(s) == Approx(4.0 * v.samplePosition(s).y).epsilon(5e-3));
        }
    }
    SECTION("nothing around")
    {
        const IrradianceVolume v
            = bakeVolume(*makeTracer(emptyScene()), bakeOptions(1, Vec3d(0.0), Vec3d(1.0), 64))
                  .volume;
        for (SampleId s = 0; s < 8; ++s) CHECK(std::isinf(v.distance(s)));
    }
}

TEST_CASE("gradients of a point light are those of its formula", "[bake][gradients]")
{
    // L_i(p) = I/d² Y_i(direction): differentiated by a step small in double precision. The bake's
    // δ = h/8 = d/80 leaves a relative error of about 2 (δ/d)² = 3e-4 in band 0, more above.
    Scene scene = emptyScene();
    Light light;
    light.position = Vec3d(0.3, 2.1, -0.4);
    light.intensity = Color(7.0f);
    scene.lights = {light};
    const auto tracer = makeTracer(scene);
    BakeOptions o = bakeOptions(0.2, {-0.2, 0, -0.2}, {0.2, 0.2, 0.2}, 2);
    o.gradients = GradientMethod::Central;
    const IrradianceVolume v = bakeVolume(*tracer, o).volume;
    const auto coefficient = [&](const Vec3d& p, int i) {
        const Vec3d d = light.position - p;
        double y[9];
        evalShBasis(3, d.normalized(), y);
        return 7 / d.length2() * y[i];
    };
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const Vec3d p = v.sampleWorld(s);
        const double scale = 2 * 7 / std::pow((light.position - p).length(), 3);
        for (int i = 0; i < 9; ++i)
            for (int a = 0; a < 3; ++a) {
                Vec3d step(0.0);
                step[a] = 1e-5;
                const double expected
                    = (coefficient(p + step, i) - coefficient(p - step, i)) / 2e-5;
                CAPTURE(p, i, a, expected);
                REQUIRE(std::abs(v.gradient(s)[a * 9 + i].x - expected) < 3e-3 * scale);
            }
    }
}

TEST_CASE("gradients under an area light: solid angle's derivative", "[bake][gradients]")
{
    // L_0 = Y_0 Ω for a panel of radiance 1; Ω by Van Oosterom & Strackee (1983).
    Scene scene = emptyScene();
    scene.materials[0].emission = Color(1.0f);
    scene.materials[0].baseColor = Color(0.0f);
    addQuad(scene, 0, {-1, 2, -1}, {2, 0, 0}, {0, 0, 2});
    const auto solidAngle = [](const Vec3d& p) {
        const Vec3d q[4] = {{-1, 2, -1}, {1, 2, -1}, {1, 2, 1}, {-1, 2, 1}};
        double sum = 0;
        for (int t = 0; t < 2; ++t) {
            const Vec3d a = (q[0] - p).normalized(), b = (q[t + 1] - p).normalized(),
                        c = (q[t + 2] - p).normalized();
            sum += 2 * std::atan2(std::abs(a.dot(b.cross(c))), 1 + a.dot(b) + b.dot(c) + c.dot(a));
        }
        return sum;
    };
    BakeOptions o = bakeOptions(0.5, {0, 0, 0}, {1, 0.5, 0.5}, 8192);
    o.gradients = GradientMethod::Central;
    const IrradianceVolume v = bakeVolume(*makeTracer(scene), o).volume;
    double error2 = 0, size2 = 0;
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const Vec3d p = v.sampleWorld(s);
        for (int a = 0; a < 3; ++a) {
            Vec3d step(0.0);
            step[a] = 1e-4;
            const double expected
                = 0.28209479 * (solidAngle(p + step) - solidAngle(p - step)) / 2e-4;
            error2 += std::pow(v.gradient(s)[a * 9].x - expected, 2);
            size2 += expected * expected;
        }
    }
    CAPTURE(std::sqrt(error2 / size2));
    CHECK(std::sqrt(error2 / size2) < 0.05);
}
