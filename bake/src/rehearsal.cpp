// SPDX-License-Identifier: Apache-2.0
#include "rehearsal.h"

#include "adaptive_bake.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

using Work = Outlook::Work;

/// Directions of a sample as a share of the bake's.
constexpr int kShare = 64, kLeastShare = 16;
constexpr int kFewestRays = 4, kRays = 16, kMostRays = 64;
/// Strata make more of many directions than of few: those foreseen from few are too many, by this
/// power of their ratio (0.07 to 0.11 in the sample scenes).
constexpr double kStrata = 0.09;
/// Time of a direction over that of the pilot's, which have more bands and normals besides (0.61 to
/// 0.87).
constexpr double kOfPilot = 0.7;
constexpr double kPathOverCache = 3.4;
/// Directions of a proof's points, some of which are bright, over referenceRays(), 1.7 to 3.7; and
/// their cost where they are few over that.
constexpr double kForBright = 2.4, kOfFew = 1.6;
/// Time of directions with analytic gradients over that without: they are 14 to 33% of a bake.
constexpr double kWithGradients = 1.3;
/// Seconds to find what a cell sees, before any are known.
constexpr double kSecondsPerCell = 7e-5;
/// Times the samples of the first round, after which is known how many directions later ones have.
constexpr double kEnough = 2;

/// By how much a step's directions may be thought slower or quicker than others: few samples tell
/// little.
constexpr double kMostSlow = 1.5;

double secondsOfSamples(const std::vector<Outlook::Step>& steps)
{
    double sum = 0;
    for (const Outlook::Step& step : steps) sum += step.work == Work::Samples ? step.seconds : 0;
    return sum;
}

} // namespace

/// The samples of the bake, of what was rehearsed of them.
SampleCount AdaptiveBake::foreseen(SampleCount rehearsed) const
{
    const double ratio = static_cast<double>(mRehearsalRays) / mStore->meanDirections();
    if (mPlan.samples.stop.most > 0) rehearsed.directions *= std::pow(ratio, kStrata);
    return rehearsed;
}

/// What was rehearsed so far, as the first round.
void AdaptiveBake::remember()
{
    mForecast.first = mProgress.steps();
    mForecast.pass = mPass - 1;
    mForecast.places = mRefiner->steps();
    mForecast.round = foreseen(count());
    // As long as the rehearsal, and as the directions take that it did without.
    const SampleCount& round = mForecast.round;
    const double traced = mRehearsalRays * round.samples;
    const double all = secondsOfSamples(mForecast.first);
    mForecast.perDirection = kOfPilot * mPlan.secondsPerDirection;
    if (mPlan.samples.gradients == GradientMethod::Analytic)
        mForecast.perDirection *= kWithGradients;
    mForecast.perSample = std::max(0.0, all - mForecast.perDirection * traced) / round.samples;
    for (Outlook::Step& step : mForecast.first) {
        if (step.samples == 0) continue;
        // Directions take longer in some places than in others, here as in the bake.
        const double slow = std::clamp(
            step.seconds * round.samples / (step.samples * all), 1 / kMostSlow, kMostSlow);
        step.directions *= round.directions / mStore->directions();
        const double more = std::max(0.0, step.directions - mRehearsalRays * step.samples);
        step.seconds += slow * mForecast.perDirection * more;
    }
    mForecast.cells = kSecondsPerCell * static_cast<double>(mCells.cells.size());
}

Forecast AdaptiveBake::rehearse()
{
    if (mOptions.target.error == 0) {
        refineOnce();
        remember();
        return mForecast;
    }
    refineFirst();
    remember();
    // Points are traced by `path`, which may be much slower than with the cache.
    const double perRay = 2 * kForBright * mPlan.secondsPerDirection
        * (mPlan.samples.probe.cache ? kPathOverCache : 1);
    mForecast.look = kOfFew * perRay * referenceRays(kFirstError * mThreshold) * kFirstPoints;
    mForecast.proof = perRay * referenceRays(mPlan.goal) * kVerifyPoints;
    const double first = mThreshold, thought2 = thoughtError2();
    const double truth2 = std::pow(verifiedError(1), 2)
        * std::max(1.0, std::pow(kFirstError * first, 2) / thought2);
    const SampleCount round = mForecast.round;
    while (mStore->size() < kEnough * round.samples && !mRefiner->isLimited()
        && mThreshold > first * firstFall()) {
        mThreshold *= kStep;
        refine();
    }
    const SampleCount all = foreseen(count());
    const SampleCount more{all.samples - round.samples, all.directions - round.directions};
    if (more.samples > 0) {
        mForecast.growth
            = std::log(all.directions / round.directions) / std::log(all.samples / round.samples);
    }
    mForecast.ahead = ahead(round, thought2, truth2);
    return mForecast;
}

Forecast rehearse(const Tracer& tracer, const BakeOptions& options, const BakePlan& plan,
    const BakeReport& report, Outlook& outlook)
{
    const int rays = plan.samples.probe.rays;
    const int least = plan.samples.stop.most > 0 ? kRays : kFewestRays;
    const int few
        = std::clamp(rays / kLeastShare, least, std::clamp(rays / kShare, kRays, kMostRays));
    outlook.begin("look ahead", 1);
    BakeReport unused = report;
    Outlook steps(outlook, false);
    return AdaptiveBake(tracer, options, plan, unused, steps, few).rehearse();
}

} // namespace lumivdb
