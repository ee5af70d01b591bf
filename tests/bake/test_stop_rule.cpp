// SPDX-License-Identifier: Apache-2.0
// Rays where the noise is: sets of directions that are added until a sample has enough. A black
// square hides a sixth of a constant sky, so the light that is left is known exactly.

#include "scene_makers.h"

#include "../../bake/src/sample_baker.h"

#include <lumivdb/bake/tracer.h>

#include <catch2/catch.hpp>

#include <cmath>
#include <map>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr int kSeeds = 256, kBase = 32;
/// L_00 of a sky of 1, less the face of a cube around the point.
const double kExpected = std::sqrt(4 * kPi) * 5 / 6;

Scene hiddenSixth()
{
    Scene scene;
    const int black = addMaterial(scene, Color(0.0f), Color(0.0f), true);
    addQuad(scene, black, {-1, -1, 1}, {2, 0, 0}, {0, 2, 0});
    scene.environment = Environment::constant(Color(1.0f));
    return scene;
}

struct Trials {
    double mean = 0, rms = 0, claimed2 = 0; ///< error's; mean of stderr²
    double directions = 0;
};

/// Estimates at the origin under many seeds.
Trials tryOut(const Tracer& tracer, int rays, const StopRule& stop)
{
    Trials t;
    for (int seed = 1; seed <= kSeeds; ++seed) {
        ProbeOptions options;
        options.rays = rays;
        options.seed = static_cast<std::uint64_t>(seed);
        const ProbeEstimator estimator(tracer, options);
        ProbeEstimator::Workspace workspace;
        const ProbeResult r = estimator.radianceSh(Vec3d(0.0), 3, 5, workspace, false, stop);
        const double error = static_cast<double>(r.value[0].y) - kExpected;
        t.mean += error / kSeeds;
        t.rms += error * error / kSeeds;
        t.claimed2 += std::pow(static_cast<double>(r.stderr_[0].y), 2) / kSeeds;
        t.directions += static_cast<double>(r.directions) / kSeeds;
    }
    t.rms = std::sqrt(t.rms);
    return t;
}

/// Adds sets until there are @a most directions.
StopRule upTo(int most)
{
    StopRule stop;
    stop.meanE = Vec3d(kPi);
    stop.tolerance = 0;
    stop.most = most;
    return stop;
}

} // namespace

TEST_CASE("directions added set by set are as good as drawn at once", "[stop]")
{
    const auto scene = std::make_shared<const Scene>(hiddenSixth());
    const Tracer tracer(scene);
    const Trials atOnce = tryOut(tracer, 512, StopRule()), added = tryOut(tracer, kBase, upTo(512));
    CHECK(atOnce.directions == 512);
    CHECK(added.directions == 512);
    for (const Trials& t : {atOnce, added}) {
        CAPTURE(t.mean, t.rms, t.claimed2);
        CHECK(std::abs(t.mean) < 4 * t.rms / std::sqrt(kSeeds));
        CHECK(t.rms < 0.01 * kExpected);
        CHECK(t.claimed2 > t.rms * t.rms); // the standard error is not too small
    }
    // RMS of so many trials is known to 1/√(2 · 256) = 4.4%, the ratio of two to 6.3%.
    CHECK(added.rms < (1 + 3 * 0.063) * atOnce.rms);
}

TEST_CASE("points take turns with patterns of directions", "[stop][directions]")
{
    // At one place all points with the same pattern are equally wrong, and nothing else is random.
    const auto scene = std::make_shared<const Scene>(hiddenSixth());
    const Tracer tracer(scene);
    constexpr int kPoints = 512, kTries = 64, kPatterns = 16;
    double square = 0, squareOfMean = 0;
    for (int seed = 1; seed <= kTries; ++seed) {
        ProbeOptions options;
        options.rays = kBase;
        options.seed = static_cast<std::uint64_t>(seed);
        const ProbeEstimator estimator(tracer, options);
        ProbeEstimator::Workspace workspace;
        std::map<float, int> patterns; // told by another coefficient, which no two have the same
        double mean = 0;
        for (std::uint64_t key = 0; key < kPoints; ++key) {
            const ProbeResult r = estimator.radianceSh(Vec3d(0.0), 3, key, workspace);
            const double error = static_cast<double>(r.value[0].y) - kExpected;
            ++patterns[r.value[2].y];
            mean += error / kPoints;
            square += error * error / kPoints / kTries;
        }
        squareOfMean += mean * mean / kTries;
        CHECK(patterns.size() == kPatterns);
        for (const auto& [value, count] : patterns) { // 32 each, by chance: 4 standard deviations
            CHECK(count > 10);
            CHECK(count < 54);
        }
    }
    // What neighbours have in common is a sixteenth of the square; so many tries tell their mean
    // square to √(2 / 64) = 18%.
    CHECK(squareOfMean < (1 + 3 * 0.18) * square / kPatterns);
}

TEST_CASE("a sample has directions until its noise is what was asked for", "[stop]")
{
    const auto scene = std::make_shared<const Scene>(hiddenSixth());
    const Tracer tracer(scene);
    ProbeOptions options;
    options.rays = kBase;
    const ProbeEstimator estimator(tracer, options);
    ProbeEstimator::Workspace workspace;
    const auto directions = [&](const StopRule& stop) {
        return estimator.radianceSh(Vec3d(0.0), 3, 5, workspace, false, stop).directions;
    };
    CHECK(directions(StopRule()) == kBase);
    CHECK(directions(upTo(kBase)) == kBase);
    CHECK(directions(upTo(2 * kBase - 1)) == kBase);
    CHECK(directions(upTo(2 * kBase)) == 2 * kBase);
    CHECK(directions(upTo(1000)) == 512);

    std::uint64_t last = 0;
    for (const double tolerance : {0.1, 0.01, 0.003, 0.001}) {
        StopRule stop = upTo(1 << 16);
        stop.tolerance = tolerance;
        const ProbeResult r = estimator.radianceSh(Vec3d(0.0), 3, 5, workspace, false, stop);
        const Vec3d noise2 = irradianceNorm2(3, r.stderr_.data());
        CAPTURE(tolerance, r.directions, noise2.x);
        CHECK(std::sqrt(noise2.x) <= tolerance * kPi);
        CHECK(r.directions >= last);
        last = r.directions;
    }
    CHECK(last > 1024);
    CHECK(last < (1 << 16));
}

TEST_CASE("few directions tell how many a sample will have", "[stop][outlook]")
{
    const auto scene = std::make_shared<const Scene>(hiddenSixth());
    const Tracer tracer(scene);
    ProbeOptions options;
    options.rays = 16;
    const ProbeEstimator few(tracer, options);
    options.rays = kBase;
    const ProbeEstimator estimator(tracer, options);
    ProbeEstimator::Workspace ofFew, workspace;
    const ProbeResult r = few.radianceSh(Vec3d(0.0), 3, 1, ofFew);
    CHECK(foreseenDirections(r, 3, StopRule(), kBase) == kBase);
    CHECK(foreseenDirections(r, 3, upTo(1000), kBase) == 512);
    StopRule easy = upTo(1000);
    easy.tolerance = 1;
    CHECK(foreseenDirections(r, 3, easy, kBase) == kBase);

    // Noise of stratified directions falls faster than that of independent ones, which is what is
    // foreseen: more directions than there will be, by less than their ratio to the few.
    StopRule stop = upTo(1 << 16);
    for (const double tolerance : {0.03, 0.01, 0.003}) {
        stop.tolerance = tolerance;
        double foreseen = 0, had = 0;
        for (std::uint64_t key = 0; key < 64; ++key) {
            const ProbeResult look = few.radianceSh(Vec3d(0.0), 3, key, ofFew);
            foreseen += static_cast<double>(foreseenDirections(look, 3, stop, kBase)) / 64;
            const ProbeResult full
                = estimator.radianceSh(Vec3d(0.0), 3, key, workspace, false, stop);
            had += static_cast<double>(full.directions) / 64;
        }
        CAPTURE(tolerance, foreseen, had);
        CHECK(foreseen >= had);
        CHECK(foreseen < had * std::sqrt(had / 16) * 2);
    }
}

TEST_CASE("stopping by the rays' own noise leaves the mean alone", "[stop]")
{
    const auto scene = std::make_shared<const Scene>(hiddenSixth());
    const Tracer tracer(scene);
    StopRule stop = upTo(1 << 14);
    stop.tolerance = 0.01;
    const Trials t = tryOut(tracer, kBase, stop);
    CAPTURE(t.mean, t.rms, t.directions);
    CHECK(t.directions > 1.5 * kBase);
    CHECK(std::abs(t.mean) < 4 * t.rms / std::sqrt(kSeeds));
}

TEST_CASE("a lattice point that stands for more space has more directions", "[stop]")
{
    const auto scene = std::make_shared<const Scene>(hiddenSixth());
    const Tracer tracer(scene);
    SampleSettings settings;
    settings.spacing = 1e-3; // so that all places are alike
    settings.probe.rays = 2;
    settings.levels = 4;
    settings.stop.meanE = Vec3d(kPi);
    settings.stop.perDeviation = 2e5;
    settings.stop.most = 1 << 20;
    const SampleBaker baker(tracer, settings);
    ProbeEstimator::Workspace workspace;
    const auto directions = [&](const Coord& c) {
        return static_cast<double>(baker.bake(c, workspace).result.directions);
    };
    const double finest = directions({1, 0, 0}), second = directions({2, 4, 0}),
                 coarsest = directions({0, 16, 32});
    CAPTURE(finest, second, coarsest);
    // √8 more for each level where σ is the same; powers of two, and σ falls a little with N.
    CHECK(second >= finest);
    CHECK(coarsest >= 16 * finest);
    CHECK(coarsest <= 128 * finest);
    CHECK(directions({16, 0, 0}) == directions({64, 0, 0}));
}
