// SPDX-License-Identifier: Apache-2.0
#include "outlook.h"

#include "sample_baker.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <tuple>
#include <utility>

namespace lumivdb {

namespace {

constexpr double kTellSeconds = 0.2;
/// The plan alone counts as much as steps done that are this share of it: single steps are wrong by
/// up to a half.
constexpr double kPriorShare = 0.1;

double secondsSince(std::chrono::steady_clock::time_point start)
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

bool isBefore(const Outlook::Step& a, const Outlook::Step& b)
{
    return std::tie(a.pass, a.place) < std::tie(b.pass, b.place);
}

} // namespace

Outlook::Outlook(Progress& to, bool talks)
    : mTo(to)
    , mTalks(talks)
{
}

Outlook::~Outlook()
{
    if (mTalks) mTo.expect(std::numeric_limits<double>::infinity());
}

void Outlook::plan(std::vector<Step> steps)
{
    const std::lock_guard<std::mutex> guard(mMutex);
    endStep(); // which was planned before
    mPlan = std::move(steps);
    const auto samples = static_cast<std::size_t>(Work::Samples);
    mPlanned[samples] = mTaken[samples] = 0;
    mPlanStart = std::chrono::steady_clock::now();
    tell();
}

void Outlook::enter(int place, Work work)
{
    const std::lock_guard<std::mutex> guard(mMutex);
    endStep();
    mSteps.push_back({mPass, place, work, 0});
    mInStep = true;
    mStepStart = std::chrono::steady_clock::now();
    mTotal = 0;
    mDone = 0;
}

const std::vector<Outlook::Step>& Outlook::steps()
{
    const std::lock_guard<std::mutex> guard(mMutex);
    endStep();
    return mSteps;
}

void Outlook::endStep()
{
    if (!mInStep) return;
    mInStep = false;
    Step& step = mSteps.back();
    step.seconds = secondsSince(mStepStart);
    // Samples of a journal take no time, and what was not planned any: they say nothing about what
    // is left of the plan.
    const double thought = planned(step);
    if (!step.kept && thought > 0) {
        const auto w = static_cast<std::size_t>(step.work);
        mPlanned[w] += thought;
        mTaken[w] += step.seconds;
    }
}

double Outlook::planned(const Step& step) const
{
    const auto at = std::lower_bound(mPlan.begin(), mPlan.end(), step, isBefore);
    if (at != mPlan.end() && !isBefore(step, *at)) return at->seconds;
    const bool unknown = at != mPlan.end() && at->place == kUnknown;
    return unknown ? step.directions / at->directions * at->seconds : 0;
}

double Outlook::factor(Work work) const
{
    const auto w = static_cast<std::size_t>(work);
    double all = 0;
    for (const Step& step : mPlan) all += step.work == work ? step.seconds : 0;
    double took = mTaken[w] + kPriorShare * all, thought = mPlanned[w] + kPriorShare * all;
    if (mInStep && !isUnplanned() && !mSteps.back().kept && mSteps.back().work == work) {
        thought += shareDone() * planned(mSteps.back());
        took += shareDone() > 0 ? secondsSince(mStepStart) : 0;
    }
    return thought > 0 ? took / thought : 1;
}

double Outlook::shareDone() const
{
    if (mTotal == 0) return 0;
    return std::min(1.0, static_cast<double>(mDone.load()) / static_cast<double>(mTotal));
}

double Outlook::secondsLeft() const
{
    const bool beyond = mPlan.empty() || (!mSteps.empty() && isBefore(mPlan.back(), mSteps.back()));
    if (beyond) return std::numeric_limits<double>::infinity();
    // Of the step itself: the further it is, the more its own pace counts.
    double own = 0;
    if (mInStep) {
        const Step& now = mSteps.back();
        const double share = shareDone();
        const double whole
            = (1 - share) * factor(now.work) * planned(now) + secondsSince(mStepStart);
        own = (1 - share) * whole;
    }
    double left = 0;
    for (const Step& step : mPlan) {
        if (!mSteps.empty() && !isBefore(mSteps.back(), step)) continue;
        double whole = factor(step.work) * step.seconds;
        if (step.place == kUnknown && isUnplanned()) {
            whole = std::max(own, whole - secondsSince(mPlanStart));
            own = 0;
        }
        left += whole;
    }
    return left + own;
}

/// Whether the step is of the unknown ones.
bool Outlook::isUnplanned() const
{
    if (!mInStep) return false;
    const auto at = std::lower_bound(mPlan.begin(), mPlan.end(), mSteps.back(), isBefore);
    return at != mPlan.end() && at->place == kUnknown;
}

void Outlook::tell()
{
    mTold = std::chrono::steady_clock::now();
    mTo.expect(secondsLeft());
}

void Outlook::begin(const char* stage, std::uint64_t total)
{
    if (!mTalks) return;
    mTo.begin(stage, total);
    const std::lock_guard<std::mutex> guard(mMutex);
    mTotal = total;
    mDone = 0;
    if (mInStep && std::strcmp(stage, kJournalStage) == 0) mSteps.back().kept = true;
    tell();
}

void Outlook::advance(std::uint64_t steps)
{
    if (!mTalks) return;
    mDone.fetch_add(steps, std::memory_order_relaxed);
    {
        const std::unique_lock<std::mutex> guard(mMutex, std::try_to_lock);
        if (guard && secondsSince(mTold) >= kTellSeconds) tell();
    }
    mTo.advance(steps);
}

} // namespace lumivdb
