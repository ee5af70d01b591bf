// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file adaptive_bake.h
/// A bake whose cells are decided as its samples are traced; and its rehearsal.

#include "bake_plan.h"
#include "refiner.h"
#include "rehearsal.h"
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

    /// Decides what run() would, from samples of fewer directions. For one that was given a number
    /// of rays for it.
    Forecast rehearse();
    /// What run() will tell its outlook by.
    void foresee(Forecast forecast);

    IrradianceVolume run();

private:
    /// Rare places make much of an error (under eaves, one point in 2,000 made an eighth of the
    /// square): a bound needs many points more than exact ones.
    static constexpr std::size_t kVerifyPoints = 4096, kMaxVerifyPoints = 16384;
    /// A first look at the first round's volume can say no: where it finds so many times the
    /// target, nothing needs to be proven. What follows goes by it.
    static constexpr std::size_t kFirstPoints = 8192;
    static constexpr double kClearlyMissed = 1.25;
    /// The first round's error over its threshold, as it is thought of before the first look: 1.2
    /// to 1.75 in the sample scenes, rather little of that as directions foreseen are too many.
    static constexpr double kFirstError = 1.35;
    /// What verification finds, with its confidence, over what the look before did and refinement
    /// thinks: 1.02 to 1.2 in the sample scenes from the first one on. Aiming at more of it, few
    /// proofs fail; without gradients, where the error falls slowly, that costs more than it saves.
    static constexpr double kVerifiedError = 1.2, kVerifiedErrorLater = 1.1;
    /// By how much thresholds fall between looks at what refinement thinks is wrong, and how far at
    /// most before the next measurement, but for the second one.
    static constexpr double kStep = 0.866, kLaterFall = 0.4;
    /// Passes of the first round: with gradients, and perhaps anew without.
    static constexpr int kFirstPasses = 2;

    void start();
    void choosePart();
    bool isOwn(const CellKey& cell) const;

    IrradianceVolume runOnce();
    IrradianceVolume runToTarget();
    void refine();
    void refineOnce();
    void refineFirst();
    void approach(int round);
    void foresee(bool done);
    bool isThoughtEnough() const;
    bool goesOn() const;
    double firstFall() const;
    double verifiedError(int round) const;
    SampleCount count() const
    {
        return {static_cast<double>(mStore->size()), mStore->directions()};
    }
    double missingSamples(double samples, double thought2, double truth2) const;
    SampleCount ahead(const SampleCount& now, double thought2, double truth2) const;
    void plan(const SampleCount& now, const SampleCount& ahead, int pass);
    SampleCount foreseen(SampleCount rehearsed) const;
    void remember();
    bool isLast(int round) const;
    /// Whether the bands alone leave out more than the target.
    bool isHopeless() const { return mPlan.truncation >= mOptions.target.error; }
    void reconsiderGradients();
    void spendWhatIsLeft();
    bool looksWrong(const IrradianceVolume& volume);
    void verify(const IrradianceVolume& volume, int round, bool last);
    double measureNoise2() const;
    int referenceRays(double error) const;
    double fixedError2() const;
    double thoughtError2() const;
    double allowedError2() const;
    double truthOfThought2(double error) const;
    void summarise(int rounds);
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
    double mThreshold = 0; // of mCells
    double mNoise2 = 0; // of mCells, see measureNoise2()
    int mPass = 0; // of refinement, the next
    struct {
        int number = 0;
        double least = 0; // threshold
        double truth2 = 0; // see truthOfThought2()
    } mRound;
    double mFirstThought2 = 0; // after the first round
    Forecast mForecast;
    std::uint64_t mDroppedRays = 0;
    int mLooks = 0; // of verifications so far
    std::size_t mVerifyPoints = kVerifyPoints;
};

} // namespace lumivdb
