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
/// power of their ratio (0.1 to 0.2 in the sample scenes).
constexpr double kStrata = 0.15;
constexpr double kPathOverCache = 3.4;
/// Time of directions with analytic gradients over that without: they are 14 to 33% of a bake.
constexpr double kWithGradients = 1.3;
/// Seconds to find what a cell sees, before any are known.
constexpr double kSecondsPerCell = 5e-5;
/// Times the samples of the first round, after which is known how many directions later ones have.
constexpr double kEnough = 2;

double secondsOfSamples(const std::vector<Outlook::Step>& steps)
{
    double sum = 0;
    for (const Outlook::Step& step : steps) sum += step.work == Work::Samples ? step.seconds : 0;
    return sum;
}

} // namespace

/// What was rehearsed so far, as the first round.
void AdaptiveBake::remember()
{
    mForecast.first = mProgress.steps();
    mForecast.pass = mPass - 1;
    mForecast.places = mRefiner->steps();
    mForecast.round = count();
    // What the bake traces takes longer, what it decides does not.
    const double all = secondsOfSamples(mForecast.first);
    const double decided = all > 0 ? std::max(0.0, all - mStore->seconds()) / all : 0;
    const double ratio = static_cast<double>(mRehearsalRays) / mStore->meanDirections();
    mForecast.perDirection
        = mPlan.secondsPerDirection * (mPlan.samples.stop.most > 0 ? std::pow(ratio, kStrata) : 1);
    if (mPlan.samples.gradients == GradientMethod::Analytic)
        mForecast.perDirection *= kWithGradients;
    for (Outlook::Step& step : mForecast.first) {
        step.seconds = decided * step.seconds + mForecast.perDirection * step.directions;
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
    const double perPoint = mPlan.secondsPerDirection * 2 * referenceRays()
        * (mPlan.samples.probe.cache ? kPathOverCache : 1);
    mForecast.look = perPoint * kFirstPoints;
    mForecast.proof = perPoint * kVerifyPoints;
    // Noise hides some of what refinement would think is wrong, which is about the threshold.
    const double first = mThreshold, thought2 = std::max(thoughtError2(), first * first);
    const double truth2 = kVerifiedError * kVerifiedError;
    const SampleCount round = mForecast.round;
    while (mStore->size() < kEnough * round.samples && !mRefiner->isLimited()
        && mThreshold > first * firstFall()) {
        mThreshold *= kStep;
        refine();
    }
    const SampleCount more{count().samples - round.samples, count().directions - round.directions};
    if (more.samples > 0) {
        mForecast.further = more.directions / more.samples * round.samples / round.directions;
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
