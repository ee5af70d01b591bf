// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file outlook.h
/// How long a bake will go on, for its user: nothing else depends on it.
///
/// How many samples refinement takes is known when it is done. So it is rehearsed before it begins,
/// with a few directions a sample: refinement takes noise off the errors that it compares, so it
/// decides much the same. The steps of the rehearsal are the forecast; what the steps of the bake
/// take longer than forecast so far, those that are left are thought to take longer too.

#include <lumivdb/core/progress.h>

#include <array>
#include <atomic>
#include <chrono>
#include <limits>
#include <mutex>
#include <vector>

namespace lumivdb {

/// Hands progress on, measures the steps that it is told of, and tells what is left after a plan.
class Outlook : public Progress {
public:
    /// Kinds of work, whose forecasts are wrong by factors of their own.
    enum class Work { Samples, Cells, Points };
    /// Of a plan's steps whose pass is not known yet: they come after all others.
    static constexpr int kLater = std::numeric_limits<int>::max();
    /// Place of samples whose steps are not known yet, in a plan once at most: samples of steps
    /// that are not planned are thought to be of these, and to take as long each direction.
    static constexpr int kUnknown = -1;
    struct Step {
        int pass, place; ///< in this order; the same in the rehearsal
        Work work;
        double seconds;
        double samples = 0, directions = 0; ///< as told
        bool kept = false; ///< samples come from a journal, which takes no time
    };
    /// Hands on only cancelled() where not @a talks.
    explicit Outlook(Progress& to, bool talks = true);
    ~Outlook() override;
    Outlook(const Outlook&) = delete;
    Outlook& operator=(const Outlook&) = delete;

    /// What the bake takes from now on, in order, as far as is known; ends the last step. The user
    /// is told what is left. Its seconds of samples know what those so far took.
    void plan(std::vector<Step> steps);
    /// The refinement of pass @a pass, 0, 1, …, begins.
    void enterPass(int pass) { mPass = pass; }
    /// A step begins: place @a place of the pass, ascending.
    void enter(int place, Work work);
    /// The step has one more sample, of so many directions.
    void addSample(double directions)
    {
        mSteps.back().samples += 1;
        mSteps.back().directions += directions;
    }
    /// Ends the last step. @return all so far.
    const std::vector<Step>& steps();

    void begin(const char* stage, std::uint64_t total) override;
    void advance(std::uint64_t steps) override;
    void warn(const std::string& sentence) override { mTo.warn(sentence); }
    bool cancelled() override { return mTo.cancelled(); }
    /// Seconds that are left; infinity without a plan or beyond its end.
    double secondsLeft() const;

private:
    void endStep();
    void tell();
    double factor(Work work) const;
    double planned(const Step& step) const;
    bool isUnplanned() const;
    double shareDone() const; // of the stage

    Progress& mTo;
    const bool mTalks;
    std::mutex mMutex; // of what advance() reads and tells; the bake's own thread writes
    std::vector<Step> mPlan, mSteps;
    int mPass = 0;
    bool mInStep = false;
    std::chrono::steady_clock::time_point mStepStart, mTold, mPlanStart;
    std::atomic<std::uint64_t> mDone{0}; // of the stage
    std::uint64_t mTotal = 0;
    std::array<double, 3> mPlanned{}, mTaken{}; // seconds of the steps done, by kind of work
};

} // namespace lumivdb
