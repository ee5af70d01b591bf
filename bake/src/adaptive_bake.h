// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file adaptive_bake.h
/// A bake whose cells are decided as its samples are traced; and its rehearsal.

#include "bake_plan.h"
#include "refiner.h"
#include "verification.h"

#include <memory>
#include <vector>

namespace lumivdb {

class AdaptiveBake {
public:
    AdaptiveBake(const Tracer& tracer, const BakeOptions& options, const BakePlan& plan,
        BakeReport& report, Outlook& outlook, int rehearsalRays = 0)
        : mTracer(tracer)
        , mOptions(options)
        , mPlan(plan)
        , mReport(report)
        , mProgress(outlook)
        , mRehearsalRays(rehearsalRays)
    {
        start();
    }

    /// Decides what run() would, from samples of fewer directions, and leaves in the outlook how
    /// long the bake's steps will take. For one that was given a number of rays for it.
    void rehearse();

    IrradianceVolume run();

private:
    /// Rare places make much of an error (under eaves, one point in 2,000 made an eighth of the
    /// square): a bound needs many points more than exact ones.
    static constexpr std::size_t kVerifyPoints = 4096, kMaxVerifyPoints = 16384;
    /// Fewer can say no: where they find so many times the target, nothing needs to be proven.
    static constexpr std::size_t kFirstPoints = 1024;
    static constexpr double kClearlyMissed = 1.25;
    /// What verification finds, with its confidence, over what refinement thinks: 1.02 to 1.33 in
    /// the sample scenes.
    static constexpr double kVerifiedError = 1.12;

    void start();
    void choosePart();
    bool isOwn(const CellKey& cell) const;

    IrradianceVolume runOnce();
    IrradianceVolume runToTarget();
    void refine(double threshold, int pass);
    void refineRound(double threshold, int round);
    void foreseeVerification(double error);
    double foreseenError() const;
    bool isLast(int round) const;
    /// Whether the bands alone leave out more than the target.
    bool isHopeless() const { return mPlan.truncation >= mOptions.target.error; }
    void reconsiderGradients();
    void spendWhatIsLeft(double& threshold);
    bool looksWrong(Verification& verification);
    void verify(const IrradianceVolume& volume, int round, bool last);
    double noise2() const;
    int referenceRays() const;
    double nextThreshold(double threshold, double upper) const;
    void summarise(double threshold, int rounds);
    void warnOfPointLights();

    IrradianceVolume build(const std::vector<CellKey>& cells) const;
    static void limitGradients(IrradianceVolume& volume);
    IrradianceVolume assemble();

    const Tracer& mTracer;
    const BakeOptions& mOptions;
    BakePlan mPlan;
    BakeReport& mReport;
    Outlook& mProgress;
    const int mRehearsalRays; // 0: this is no rehearsal
    std::unique_ptr<SampleStore> mStore;
    std::unique_ptr<Refiner> mRefiner;
    std::vector<CellKey> mOwnRoots; // sorted; empty: all
    RefinedCells mCells;
    std::uint64_t mDroppedRays = 0;
    int mLooks = 0; // of verifications so far
    std::size_t mVerifyPoints = kVerifyPoints;
};

} // namespace lumivdb
