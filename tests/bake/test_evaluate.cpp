// SPDX-License-Identifier: Apache-2.0
// The judge: volumes whose error is known must be told so.

#include "../../bake/src/evaluator.h"
#include "bake_makers.h"

#include <lumivdb/core/random.h>
#include <lumivdb/core/sampler.h>

#include <catch2/catch.hpp>

#include <cmath>
#include <limits>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

/// A sky of L = (1, 2, 3) and nothing else: the answer is E = πL everywhere.
Scene constantSky()
{
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), false);
    scene.environment = Environment::constant(Color(1, 2, 3));
    return scene;
}

IrradianceVolume constantVolume(double scale, int bands = 3)
{
    VolumeBuilder builder(bands, GradientStorage::None, latticeTransform(0.5));
    builder.addUniform(Coord(-2), Coord(2));
    IrradianceVolume v = builder.build();
    const auto l00 = static_cast<float>(scale * std::sqrt(4 * kPi));
    for (SampleId s = 0; s < v.sampleCount(); ++s) v.radiance(s)[0] = Color(1, 2, 3) * l00;
    return v;
}

EvaluateOptions options(std::size_t points, int rays)
{
    EvaluateOptions o;
    o.points = points;
    o.rays = rays;
    o.normals = 16;
    return o;
}

/// A smooth scene: a coloured gradient sky over a large grey floor.
Scene smoothScene()
{
    std::vector<Color> pixels;
    for (int y = 0; y < 16; ++y)
        for (int x = 0; x < 32; ++x)
            pixels.emplace_back(1.0f, 1.5f + 0.5f * std::cos(0.196f * static_cast<float>(x)),
                2.0f - 0.1f * static_cast<float>(y));
    Scene scene;
    addMaterial(scene, Color(0.4f, 0.3f, 0.2f), Color(0.0f), false);
    addQuad(scene, 0, {-50, 0, -50}, {0, 0, 100}, {100, 0, 0});
    scene.environment = Environment::fromPixels(32, 16, pixels, {});
    return scene;
}

} // namespace

TEST_CASE("an exact volume: no error but the reference's noise", "[evaluate]")
{
    const auto tracer = makeTracer(constantSky());
    const EvaluateReport r = evaluateVolume(constantVolume(1), *tracer, options(50, 256));
    CHECK(r.points == 50);
    CHECK(r.normals == 16);
    CHECK(r.rejected == 0);
    CHECK(r.outside == 0);
    CHECK(r.referenceStderr < 0.02);
    CHECK(r.relRmse < 2 * r.referenceStderr);
    CHECK(r.queryNs > 0);
    // More rays, less noise: nothing of the volume's own is left.
    const EvaluateReport finer = evaluateVolume(constantVolume(1), *tracer, options(20, 16384));
    CHECK(finer.relRmse < 0.002);
    CHECK(std::abs(finer.bias) < 0.002);
}

TEST_CASE("two references: their noise enters neither the error nor its bound", "[evaluate]")
{
    const auto tracer = makeTracer(constantSky());
    EvaluateOptions o = options(400, 8);
    o.twice = true;
    SECTION("an exact volume: what is left is the spread of a mean over pairs")
    {
        const EvaluateReport r = evaluateVolume(constantVolume(1), *tracer, o);
        CAPTURE(r.relRmse, r.relRmseDebiased, r.upper);
        REQUIRE(r.relRmse > 0.03);
        CHECK(r.relRmseDebiased < 0.5 * r.relRmse);
        CHECK(r.upper < 0.7 * r.relRmse);
    }
    SECTION("a volume 10% too bright")
    {
        const EvaluateReport r = evaluateVolume(constantVolume(1.1), *tracer, o);
        CAPTURE(r.relRmse, r.relRmseDebiased, r.upper);
        // The mean over pairs of 2 · 0.1 · noise, as an error of the root: noise/√32.
        CHECK(r.relRmseDebiased == Approx(0.1).margin(4 * r.referenceStderr / std::sqrt(32.0)));
        CHECK(r.upper > r.relRmseDebiased);
    }
}

TEST_CASE("a volume 10% too bright, or dark: that bias, that error", "[evaluate]")
{
    const auto tracer = makeTracer(constantSky());
    for (const double scale : {1.1, 0.5}) {
        const EvaluateReport r = evaluateVolume(constantVolume(scale), *tracer, options(20, 8192));
        CAPTURE(scale);
        CHECK(r.bias == Approx(scale - 1).margin(0.003));
        CHECK(r.relRmse == Approx(std::abs(scale - 1)).margin(0.003));
        CHECK(r.p50 == Approx(std::abs(scale - 1)).margin(0.005));
        CHECK(r.max == Approx(std::abs(scale - 1)).margin(0.02));
        CHECK(r.worst.size() == 10);
    }
    // One channel alone is the worst channel: green 20% off, the others exact.
    IrradianceVolume v = constantVolume(1);
    for (SampleId s = 0; s < v.sampleCount(); ++s) v.radiance(s)[0].y *= 0.8f;
    const EvaluateReport r = evaluateVolume(v, *tracer, options(20, 8192));
    CHECK(r.relRmse == Approx(0.2).margin(0.003));
    CHECK(r.bias == Approx(-0.2).margin(0.003));
}

TEST_CASE("percentiles of errors that are known", "[evaluate]")
{
    // 10% of the given points lie in a cell whose samples are double: their errors are 1, the
    // others' 0. So p50 is 0, p95, p99 and the maximum 1, and the RMS √0.1.
    IrradianceVolume v = constantVolume(1);
    for (int i = 0; i < 8; ++i) v.radiance(v.cell(v.findCell({1, 1, 1})).corners[i])[0] *= 2;
    EvaluateOptions o = options(1, 4096);
    for (int k = 0; k < 50; ++k)
        o.givenPoints.push_back(k % 10 ? Vec3d(-0.3 - 0.01 * k) : Vec3d(0.6 + 0.005 * k));
    const EvaluateReport r = evaluateVolume(v, *makeTracer(constantSky()), o);
    CHECK(r.points == 50);
    CHECK(r.p50 < 0.01);
    CHECK(r.p95 == Approx(1).margin(0.02));
    CHECK(r.p99 == Approx(1).margin(0.02));
    CHECK(r.max == Approx(1).margin(0.02));
    CHECK(r.relRmse == Approx(std::sqrt(0.1)).epsilon(0.02));
    CHECK(r.bias == Approx(0.1).epsilon(0.02));
    REQUIRE(r.worst.size() == 10);
    for (int i = 0; i < 5; ++i) {
        CHECK(r.worst[static_cast<std::size_t>(i)].position.x > 0.5);
        // Over the mean of the channels: RMS of (1, 2, 3) / 2.
        CHECK(r.worst[static_cast<std::size_t>(i)].error
            == Approx(std::sqrt(14 / 3.0) / 2).epsilon(0.02));
    }
    for (std::size_t i = 1; i < 10; ++i) CHECK(r.worst[i].error <= r.worst[i - 1].error);
    CHECK(r.worst[5].position.x < 0);
    CHECK(r.worst[5].error < 0.02);
}

TEST_CASE("a bake of a smooth scene is good, its percentiles in sequence", "[evaluate]")
{
    const auto tracer = makeTracer(smoothScene());
    BakeOptions bake = bakeOptions(1, {-2, 0, -2}, {2, 2, 2}, 1024);
    bake.bands = 4;
    const IrradianceVolume v = bakeVolume(*tracer, bake).volume;
    for (const Interpolation mode :
        {Interpolation::Trilinear, Interpolation::InverseDistance, Interpolation::Nearest}) {
        EvaluateOptions o = options(60, 1024);
        o.mode = mode;
        const EvaluateReport r = evaluateVolume(v, *tracer, o);
        CAPTURE(name(mode));
        CHECK(r.relRmse < 0.02);
        CHECK(r.relRmse > 1e-5);
        CHECK(r.p50 <= r.p95);
        CHECK(r.p95 <= r.p99);
        CHECK(r.p99 <= r.max);
        CHECK(r.p50 > 0);
        CHECK(std::abs(r.bias) < 0.01);
    }
}

TEST_CASE("points inside geometry are rejected and replaced", "[evaluate]")
{
    // A solid block fills a quarter of the volume's box [-1,1]³.
    Scene scene = constantSky();
    addInwardBox(scene, 0, {-1.01, -1.01, -1.01}, {1.01, 1.01, 3});
    for (Mesh& m : scene.meshes)
        for (auto& t : m.triangles) std::swap(t[1], t[2]);
    const auto tracer = makeTracer(scene);
    const EvaluateReport r = evaluateVolume(constantVolume(1), *tracer, options(200, 64));
    CHECK(r.points == 200);
    // Share 1/4 with an error of √(0.25·0.75/267) = 0.027.
    const double share
        = static_cast<double>(r.rejected) / static_cast<double>(r.rejected + r.points);
    CHECK(share == Approx(0.25).margin(0.11));
    for (const auto& w : r.worst) CHECK((w.position.x > 0 || w.position.y > 0));

    EvaluateOptions given = options(1, 64);
    given.givenPoints = {{-0.5, -0.5, 0}, {0.5, 0.5, 0}, {9, 9, 9},
        {std::numeric_limits<double>::quiet_NaN(), 0, 0}, {0.5, 0.25, 1}};
    const EvaluateReport g = evaluateVolume(constantVolume(1), *tracer, given);
    CHECK(g.points == 2);
    CHECK(g.rejected == 1);
    CHECK(g.outside == 2);

    given.givenPoints = {{-0.5, -0.5, 0}};
    CHECK(errorOf(ErrorCode::Input, [&] { evaluateVolume(constantVolume(1), *tracer, given); })
              .find("nothing to compare")
        != std::string::npos);
    given.givenPoints = {{5, 0, 0}};
    CHECK(errorOf(ErrorCode::Input, [&] { evaluateVolume(constantVolume(1), *tracer, given); })
        != "");
}

TEST_CASE("points just behind a single-sided surface lie on it and do not count", "[evaluate]")
{
    // Cells of 0.5 count 2^-12 of that to the front; a double-sided surface has light behind it.
    constexpr double kStep = 0.5 * 0x1p-12;
    const auto counted = [](bool doubleSided, double y) {
        Scene scene = constantSky();
        const int material = addMaterial(scene, Color(0.5f), Color(0.0f), doubleSided);
        addQuad(scene, material, {-50, 0, -50}, {0, 0, 100}, {100, 0, 0}); // its front is upward
        const auto tracer = makeTracer(std::move(scene));
        const IrradianceVolume v = constantVolume(1);
        Evaluator evaluator(v, *tracer, options(1, 64));
        Progress quiet;
        std::vector<Vec3d> points;
        for (int i = 0; i < 32; ++i) points.emplace_back(0.01 * i, y, 0.3);
        points.emplace_back(0.1, 0.4, 0.3); // free: there must be one
        evaluator.add(points, {}, quiet);
        const EvaluateReport r = evaluator.report(0.95);
        CHECK(r.points + r.rejected == points.size());
        return r.points - 1;
    };
    CHECK(counted(false, kStep / 2) == 32);
    CHECK(counted(false, -kStep / 2) == 0);
    CHECK(counted(true, kStep / 2) == 32);
    CHECK(counted(true, -kStep / 2) == 32);
}

TEST_CASE("points that come in portions count as if they came at once", "[evaluate]")
{
    const auto tracer = makeTracer(smoothScene());
    const IrradianceVolume volume = constantVolume(0.4);
    EvaluateOptions o = options(1, 64);
    o.twice = true;
    std::vector<Vec3d> points;
    std::vector<double> weights;
    for (int i = 0; i < 20; ++i) {
        points.emplace_back(0.09 * i - 0.9, 0.5 - 0.04 * i, 0.02 * i);
        weights.push_back(1 + i % 3);
    }
    Progress silent;
    Evaluator atOnce(volume, *tracer, o), inPortions(volume, *tracer, o);
    atOnce.add(points, weights, silent);
    const auto middle = points.begin() + 7;
    inPortions.add({points.begin(), middle}, {weights.begin(), weights.begin() + 7}, silent);
    const EvaluateReport first = inPortions.report(0.95);
    inPortions.add({middle, points.end()}, {weights.begin() + 7, weights.end()}, silent);
    const EvaluateReport a = atOnce.report(0.9), b = inPortions.report(0.9);
    CHECK(first.points == 7);
    CHECK(b.points == 20);
    CHECK(b.relRmse == a.relRmse);
    CHECK(b.relRmseDebiased == a.relRmseDebiased);
    CHECK(b.upper == a.upper);
    CHECK(b.upper < inPortions.report(0.99).upper);
    CHECK(b.bias == a.bias);
    CHECK(first.relRmse != a.relRmse);
}

TEST_CASE("what a lamp's few bright points add is found by rays that go there", "[evaluate]")
{
    Scene scene;
    const int grey = addMaterial(scene, Color(0.6f), Color(0.0f), false);
    const int lamp = addMaterial(scene, Color(0.0f), Color(40.0f), true);
    addInwardBox(scene, grey, Vec3d(0.0), Vec3d(1.6));
    addQuad(scene, lamp, {0.7, 1.5, 0.7}, {0.2, 0, 0}, {0, 0, 0.2});
    const auto tracer = makeTracer(scene);
    const IrradianceVolume volume
        = bakeVolume(*tracer, bakeOptions(0.1, Vec3d(0.0), Vec3d(1.6), 1024)).volume;
    Vec3d mean(0.0);
    std::vector<Vec3d> points;
    const VolumeSampler sampler(volume);
    for (int i = 0; i < 400; ++i) {
        CounterRng rng(mixBits(static_cast<std::uint64_t>(i)));
        Vec3d p;
        for (int a = 0; a < 3; ++a) p[a] = 0.01 + 1.58 * rng.nextDouble();
        points.push_back(p);
        mean += Vec3d(sampler.irradiance(p, Vec3f(0, 1, 0))) / 400;
    }
    const std::vector<double> weights(points.size(), 1.0);
    constexpr int kSeeds = 24;
    double sum[2] = {}, square[2] = {};
    for (int spread = 0; spread < 2; ++spread) {
        for (int seed = 0; seed < kSeeds; ++seed) {
            EvaluateOptions o = options(1, 32);
            o.twice = true;
            o.seed = static_cast<std::uint64_t>(seed);
            Progress silent;
            Evaluator evaluator(volume, *tracer, o, spread ? mean : Vec3d(0.0));
            evaluator.add(points, weights, silent);
            const EvaluateReport r = evaluator.report(0.95);
            // Squared, and with its sign: what is found has no bias then.
            const double found = r.relRmse * r.relRmse - r.referenceStderr * r.referenceStderr;
            sum[spread] += found / kSeeds;
            square[spread] += found * found / kSeeds;
        }
    }
    const double plain = std::sqrt(square[0] - sum[0] * sum[0]);
    const double own = std::sqrt(square[1] - sum[1] * sum[1]);
    CAPTURE(sum[0], sum[1], plain, own);
    // The same error, within three standard errors of the less certain one.
    CHECK(std::abs(sum[0] - sum[1]) < 3 * plain / std::sqrt(kSeeds - 1.0));
    // Standard deviations of 24 have an error of 0.15: a half by luck is beyond three of them.
    CHECK(own < 0.5 * plain);
}

TEST_CASE("a volume that holds a NaN or an infinity is refused, not praised", "[evaluate][hard]")
{
    const auto tracer = makeTracer(constantSky());
    for (const float bad : {std::numeric_limits<float>::quiet_NaN(),
             std::numeric_limits<float>::infinity(), -std::numeric_limits<float>::infinity()}) {
        IrradianceVolume v = constantVolume(1);
        v.radiance(static_cast<SampleId>(v.findSample({0, 0, 0})))[4].y = bad;
        EvaluateOptions o = options(1, 16);
        o.givenPoints = {Vec3d(-0.7), Vec3d(0.1)};
        const std::string message
            = errorOf(ErrorCode::Input, [&] { evaluateVolume(v, *tracer, o); });
        CHECK(message.find("0.1") != std::string::npos);
        CHECK(message.find("finite") != std::string::npos);
    }
}

TEST_CASE("a black scene: errors are 0, not NaN; light where none is is infinitely wrong",
    "[evaluate][hard]")
{
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), false);
    const auto tracer = makeTracer(scene);
    const EvaluateReport r = evaluateVolume(constantVolume(0), *tracer, options(20, 16));
    for (const double v : {r.relRmse, r.p50, r.p95, r.p99, r.max, r.bias, r.referenceStderr})
        CHECK(v == 0);
    CHECK(r.worst.at(0).error == 0);
    const EvaluateReport lit = evaluateVolume(constantVolume(1), *tracer, options(20, 16));
    CHECK(std::isinf(lit.relRmse));
    CHECK(std::isinf(lit.max));
    // A red light alone leaves two black channels out of the verdict.
    scene.environment = Environment::constant(Color(1, 0, 0));
    IrradianceVolume v = constantVolume(1);
    for (SampleId s = 0; s < v.sampleCount(); ++s) v.radiance(s)[0].y = v.radiance(s)[0].z = 0;
    const EvaluateReport red = evaluateVolume(v, *makeTracer(scene), options(20, 4096));
    CHECK(red.relRmse < 0.01);
}

TEST_CASE("the same report for any number of threads; another for another seed",
    "[evaluate][determinism]")
{
    const auto tracer = makeTracer(litRoom());
    const IrradianceVolume v
        = bakeVolume(*tracer, bakeOptions(0.4, Vec3d(0.0), Vec3d(1.6), 64)).volume;
    EvaluateOptions o = options(40, 64);
    o.threads = 1;
    const EvaluateReport one = evaluateVolume(v, *tracer, o);
    for (const int threads : {2, 4, 0}) {
        o.threads = threads;
        const EvaluateReport r = evaluateVolume(v, *tracer, o);
        CHECK(r.relRmse == one.relRmse);
        CHECK(r.p50 == one.p50);
        CHECK(r.max == one.max);
        CHECK(r.bias == one.bias);
        CHECK(r.referenceStderr == one.referenceStderr);
        REQUIRE(r.worst.size() == one.worst.size());
        for (std::size_t i = 0; i < r.worst.size(); ++i) {
            CHECK(r.worst[i].position == one.worst[i].position);
            CHECK(r.worst[i].error == one.worst[i].error);
        }
    }
    o.seed = 1;
    CHECK(evaluateVolume(v, *tracer, o).relRmse != one.relRmse);
}

TEST_CASE("evaluate: options, cancelling, modes that need gradients", "[evaluate][error]")
{
    const auto tracer = makeTracer(constantSky());
    const IrradianceVolume v = constantVolume(1);
    const auto refusal = [&](auto change) {
        EvaluateOptions o = options(10, 16);
        change(o);
        return errorOf(ErrorCode::Usage, [&] { evaluateVolume(v, *tracer, o); });
    };
    CHECK(refusal([](EvaluateOptions&) {}) == "");
    CHECK(refusal([](EvaluateOptions& o) { o.points = 0; }).find("points") != std::string::npos);
    CHECK(refusal([](EvaluateOptions& o) { o.normals = 0; }).find("normals") != std::string::npos);
    CHECK(refusal([](EvaluateOptions& o) { o.rays = 1; }).find("rays") != std::string::npos);
    CHECK(refusal([](EvaluateOptions& o) { o.mode = Interpolation::Taylor; }).find("gradients")
        != std::string::npos);
    class Stop : public Progress {
    public:
        bool cancelled() override { return true; }
    } stop;
    CHECK(errorOf(ErrorCode::Interrupted, [&] {
        evaluateVolume(v, *tracer, options(10, 16), &stop);
    }) != "");
}
