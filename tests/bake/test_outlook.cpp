// SPDX-License-Identifier: Apache-2.0
// What a bake tells of the time that is left, and that telling it changes nothing.

#include "bake_makers.h"

#include "../../bake/src/outlook.h"

#include <catch2/catch.hpp>

#include <cmath>
#include <mutex>
#include <vector>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

using Work = Outlook::Work;

/// Keeps what it is told, and how many samples were traced by then.
class Listener : public Progress {
public:
    explicit Listener(bool wants)
        : mWants(wants)
    {
    }
    void begin(const char* stage, std::uint64_t total) override
    {
        const std::lock_guard<std::mutex> guard(mMutex);
        if (std::string(stage) == "trace samples") samples += total;
    }
    void expect(double seconds) override
    {
        const std::lock_guard<std::mutex> guard(mMutex);
        if (samples == 0 && std::isfinite(seconds)) beforeSamples = seconds;
        last = seconds;
    }
    bool wantsForecast() override { return mWants; }
    std::uint64_t samples = 0;
    double beforeSamples = 0, last = 0;

private:
    const bool mWants;
    std::mutex mMutex;
};

} // namespace

TEST_CASE("an outlook adds what is planned and not done", "[bake][outlook]")
{
    Progress nobody;
    Outlook outlook(nobody);
    CHECK(std::isinf(outlook.secondsLeft()));
    outlook.plan({{0, 0, Work::Samples, 40}, {0, 1, Work::Cells, 7}, {1, 0, Work::Samples, 160}});
    CHECK(outlook.secondsLeft() == Approx(40 + 7 + 160));
    outlook.enter(0, Work::Samples);
    outlook.begin("trace samples", 4);
    CHECK(outlook.secondsLeft() == Approx(40 + 7 + 160).epsilon(0.01));
    // In no time: what is left of that kind is thought to be far quicker too, but the plan counts
    // as a tenth of itself.
    const double quicker = 0.1 * 200 / (40 + 0.1 * 200);
    outlook.advance(4);
    CHECK(outlook.secondsLeft() == Approx(7 + quicker * 160).epsilon(0.01));
    outlook.enter(1, Work::Cells);
    CHECK(outlook.secondsLeft() > 7);
    outlook.enterPass(1);
    outlook.enter(0, Work::Samples);
    CHECK(outlook.secondsLeft() == Approx(quicker * 160).epsilon(0.01));
    outlook.enterPass(2); // of which the plan knows nothing
    outlook.enter(0, Work::Samples);
    CHECK(std::isinf(outlook.secondsLeft()));
}

TEST_CASE("steps that no plan knows take off what is unknown", "[bake][outlook]")
{
    Progress nobody;
    Outlook outlook(nobody);
    const double directions = 1000, later = 7;
    const Outlook::Step unknown
        = {Outlook::kLater, Outlook::kUnknown, Work::Samples, 500, 100, directions};
    const Outlook::Step proof = {Outlook::kLater, 3, Work::Points, later};
    outlook.plan({{0, 0, Work::Samples, 40}, unknown, proof});
    CHECK(outlook.secondsLeft() == Approx(40 + 500 + later));
    outlook.enter(0, Work::Samples);
    outlook.begin("trace samples", 4);
    CHECK(outlook.secondsLeft() == Approx(40 + 500 + later).epsilon(0.01));
    outlook.advance(4);
    outlook.enterPass(1);
    outlook.plan({unknown, proof}); // by whoever knows that samples took no time so far
    CHECK(outlook.secondsLeft() == Approx(500 + later).epsilon(0.01));
    // Such a step counts as its directions do: a tenth of the unknown, in no time.
    outlook.enter(0, Work::Samples);
    outlook.addSample(directions / 10);
    outlook.enter(1, Work::Samples);
    const double left = 0.1 * 500 / (0.1 * 500 + 0.1 * 500) * 500; // but what is gone by now
    CHECK(outlook.secondsLeft() == Approx(left + later).epsilon(0.01));
    outlook.plan({{1, 3, Work::Points, later}});
    CHECK(outlook.secondsLeft() == Approx(later).margin(0.1));
}

TEST_CASE("a bake that tells how long it takes is the same bake", "[bake][outlook][heavy]")
{
    const auto tracer = makeTracer(litRoom());
    BakeOptions adaptive = bakeOptions(0.1, Vec3d(0.0), Vec3d(1.6), 256);
    adaptive.levels = 3;
    BakeOptions target = bakeOptions(0.1, Vec3d(0.2), Vec3d(1.0), 32);
    target.levels = 2;
    target.target.error = 0.2;
    target.target.chooseRays = false;
    BakeOptions choosing = target;
    choosing.target.chooseRays = true;
    choosing.target.error = 0.1;
    for (const BakeOptions& options : {adaptive, target, choosing}) {
        Listener deaf(false), listener(true);
        const BakeResult silent = bakeVolume(*tracer, options, &deaf);
        const BakeResult told = bakeVolume(*tracer, options, &listener);
        CHECK(listener.beforeSamples > 0);
        CHECK(std::isinf(listener.last)); // what comes after the bake is not its affair
        CHECK(deaf.beforeSamples == 0);
        CHECK(listener.samples == deaf.samples);
        CHECK(differentRecords(silent.volume, told.volume) == 0);
        CHECK(silent.report.rays == told.report.rays);
        CHECK(silent.report.tracedSamples == told.report.tracedSamples);
        CHECK(silent.report.decisions == told.report.decisions);
        CHECK(silent.report.warnings == told.report.warnings);
        CHECK(silent.report.achieved.upper == told.report.achieved.upper);
    }
}
