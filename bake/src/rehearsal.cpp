// SPDX-License-Identifier: Apache-2.0
#include "rehearsal.h"

#include "adaptive_bake.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

/// Directions of a sample as a share of the bake's.
constexpr int kShare = 64, kLeastShare = 16;
constexpr int kFewestRays = 4, kRays = 16, kMostRays = 64;
/// Few directions take longer, each, than many.
constexpr double kPace = 0.8;
constexpr double kPathOverCache = 5;
/// Seconds to find what a cell sees, before any are known.
constexpr double kSecondsPerCell = 5e-5;

} // namespace

/// Points are traced by `path`, which may have been much faster with the cache.
void AdaptiveBake::foreseeVerification(double error)
{
    double seconds = 0;
    for (const Outlook::Step& step : mProgress.steps())
        seconds += step.work == Outlook::Work::Samples ? step.seconds : 0;
    const double directions = static_cast<double>(mStore->size()) * mRehearsalRays;
    const double slower = mPlan.samples.probe.cache ? kPathOverCache : 1;
    const double perPoint
        = kPace * slower * seconds / std::max(1.0, directions) * referenceRays() * 2;
    mProgress.add(mRefiner->steps() + 1, Outlook::Work::Points, perPoint * kFirstPoints);
    if (error >= kClearlyMissed * mOptions.target.error) return;
    mProgress.add(mRefiner->steps() + 2, Outlook::Work::Points,
        perPoint * static_cast<double>(kVerifyPoints - kFirstPoints));
}

double AdaptiveBake::foreseenError() const
{
    double square = std::pow(mPlan.truncation, 2) + std::pow(mPlan.sampleNoise(), 2);
    for (const double c : mCells.contribution) square += c;
    return kVerifiedError * std::sqrt(square);
}

void AdaptiveBake::rehearse()
{
    const bool hasTarget = mOptions.target.error > 0;
    double threshold = hasTarget ? 2 * mPlan.goal : mOptions.refine.error;
    for (int round = 0;; ++round) {
        hasTarget ? refineRound(threshold, round) : refine(threshold, 0);
        mProgress.add(mRefiner->steps(), Outlook::Work::Cells,
            kSecondsPerCell * static_cast<double>(mCells.cells.size()));
        if (!hasTarget) return;
        const double error = foreseenError();
        foreseeVerification(error);
        if (error <= mOptions.target.error || mRefiner->isLimited() || isLast(round)) return;
        threshold = nextThreshold(threshold, error);
    }
}

void rehearse(const Tracer& tracer, const BakeOptions& options, const BakePlan& plan,
    const BakeReport& report, Outlook& outlook)
{
    const int rays = plan.samples.probe.rays;
    const int few
        = std::clamp(rays / kLeastShare, kFewestRays, std::clamp(rays / kShare, kRays, kMostRays));
    outlook.begin("look ahead", 1);
    BakeReport unused = report;
    Outlook steps(outlook, false);
    AdaptiveBake(tracer, options, plan, unused, steps, few).rehearse();
    outlook.plan(steps.steps(), kPace * rays / few);
}

} // namespace lumivdb
