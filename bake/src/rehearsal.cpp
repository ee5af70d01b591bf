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
/// Seconds to find what a cell sees, before any are known.
constexpr double kSecondsPerCell = 5e-5;
/// Passes take longer as before, but not by less or more than this.
constexpr double kLeastGrowth = 1, kMostGrowth = 1.5;

double secondsOfSamples(const std::vector<Outlook::Step>& steps)
{
    double sum = 0;
    for (const Outlook::Step& step : steps) sum += step.work == Work::Samples ? step.seconds : 0;
    return sum;
}

} // namespace

Forecast::Pass Forecast::pass(std::size_t i) const
{
    const std::size_t n = passes.size();
    if (i < n) return passes[i];
    const Pass &newest = passes[n - 1], &before = passes[n > 1 ? n - 2 : 0];
    const double seconds = secondsOfSamples(newest.steps);
    const double growth = std::clamp(
        seconds / std::max(1e-9, secondsOfSamples(before.steps)), kLeastGrowth, kMostGrowth);
    const int more = static_cast<int>(i - n) + 1, number = newest.number + more;
    return {number, newest.cells,
        {{number, places - 1, Work::Samples, seconds * std::pow(growth, more)}}};
}

std::vector<Outlook::Step> Forecast::plan(int end) const
{
    std::vector<Outlook::Step> steps;
    for (std::size_t i = 0;; ++i) {
        const Pass p = pass(i);
        const bool ends = p.number >= end;
        steps.insert(steps.end(), p.steps.begin(), p.steps.end());
        if (i == 0 || ends) steps.push_back({p.number, places, Work::Cells, p.cells});
        if (i == 0) steps.push_back({p.number, places + 1, Work::Points, look});
        if (!ends) continue;
        steps.push_back({p.number, places + 2, Work::Points, proof});
        return steps;
    }
}

/// What was rehearsed since the last pass that @a forecast has.
void AdaptiveBake::remember(Forecast& forecast)
{
    const int after = forecast.passes.empty() ? -1 : forecast.passes.back().number;
    std::vector<Outlook::Step> steps;
    for (const Outlook::Step& step : mProgress.steps()) {
        if (step.pass > after) steps.push_back(step);
    }
    // What the bake traces takes longer, what it decides does not.
    const double all = secondsOfSamples(steps), traced = mStore->seconds() - mRehearsedSeconds;
    const double decided = all > 0 ? std::max(0.0, all - traced) / all : 0;
    const double ratio = static_cast<double>(mRehearsalRays) / mStore->meanDirections();
    const double perDirection
        = mPlan.secondsPerDirection * (mPlan.samples.stop.most > 0 ? std::pow(ratio, kStrata) : 1);
    for (Outlook::Step& step : steps) {
        step.seconds = decided * step.seconds + perDirection * step.directions;
    }
    mRehearsedSeconds = mStore->seconds();
    forecast.passes.push_back(
        {mPass - 1, kSecondsPerCell * static_cast<double>(mCells.cells.size()), std::move(steps)});
}

Forecast AdaptiveBake::rehearse()
{
    Forecast forecast;
    forecast.places = mRefiner->steps();
    if (mOptions.target.error == 0) {
        refineOnce();
        remember(forecast);
        return forecast;
    }
    refineFirst();
    remember(forecast);
    // Points are traced by `path`, which may be much slower than with the cache.
    const double perPoint = mPlan.secondsPerDirection * 2 * referenceRays()
        * (mPlan.samples.probe.cache ? kPathOverCache : 1);
    forecast.look = perPoint * kFirstPoints;
    forecast.proof = perPoint * kVerifyPoints;
    // As the bake will, but for measuring: few directions leave so much noise in what refinement
    // thinks is wrong that it is no guide to where the bake will end.
    const double error = kVerifiedError * std::sqrt(fixedError2() + thoughtError2());
    if (!isHopeless() && error < mOptions.target.error) return forecast;
    startRound(1, truthOfThought2(error));
    const int last = lastPass();
    while (mPass <= last && !mRefiner->isLimited() && mThreshold * kStep >= mRound.least) {
        mThreshold *= kStep;
        refine();
        remember(forecast);
    }
    forecast.last = mRefiner->isLimited() ? mPass - 1 : last;
    return forecast;
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
