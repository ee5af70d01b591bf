// SPDX-License-Identifier: Apache-2.0
#include "adaptive_bake.h"

#include "seconds.h"

#include <lumivdb/bake/visibility.h>
#include <lumivdb/core/error.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

namespace lumivdb {

namespace {

/// Decisions about a root depend on others up to this many roots away, and no further: splits look
/// at neighbours of their own size once a level, balance and merging do alike.
constexpr int kPartHalo = 5;
constexpr int kMaxRounds = 24;
/// Where the bands alone leave out more than the target.
constexpr int kHopelessRounds = 3;
/// The reference's own noise over the error to be found; it takes no part in the bound but as
/// spread.
constexpr double kReferenceShare = 1;
constexpr double kMaxReferenceRays = 4096;
/// Mean of Σ w² of trilinear weights over a cell: how much of its corners' noise it keeps.
constexpr double kInterpolatedNoise = 0.3;
/// Gradients stay where trilinear interpolation is at least this much more wrong, as RMS.
constexpr double kGradientsPay = 1.2;
/// The same with the noise of a rehearsal (1.14 to 2.8 there where they pay, else 1.00).
constexpr double kRehearsedGradientsPay = 1.07;
/// Of the first round, in shares of the target; in the coarsest cells.
constexpr double kFirstThreshold = 2;
/// Interpolation's least share of the target's square, whatever else there is.
constexpr double kLeastAllowed = 0.05;
constexpr double kNothing2 = 1e-12;
/// What refinement thinks is wrong goes as this power of 1 / samples: 0.71 to 0.91 in the sample
/// scenes with gradients, 0.35 to 0.55 without. Never less than the least.
constexpr double kFallWith = 0.8, kFallWithout = 0.4, kLeastFall = 0.3;
/// So far, in ln(samples), a bake has to go to tell as much as knowing that, and as what its
/// rehearsal tells of directions.
constexpr double kFallTrust = 2, kGrowthTrust = 2;
/// Of the samples so far, what a round is thought to take that is not needed for what was measured.
constexpr double kAgain = 0.4;

} // namespace

IrradianceVolume AdaptiveBake::run()
{
    IrradianceVolume volume = mOptions.target.error > 0 ? runToTarget() : runOnce();
    mReport.tracedSamples = mStore->size();
    mReport.rays += mStore->rays() + mDroppedRays;
    mReport.meanRelativeStderr = mStore->meanRelativeStderr();
    mReport.raysPerSample = mStore->meanDirections();
    return volume;
}

void AdaptiveBake::start()
{
    SampleSettings samples = mPlan.samples;
    if (mRehearsalRays > 0) {
        samples.rehearsedRays = samples.probe.rays;
        samples.probe.rays = mRehearsalRays;
        samples.journal = nullptr;
    }
    mStore = std::make_unique<SampleStore>(mTracer, samples);
    mRefiner = std::make_unique<Refiner>(
        mTracer, *mStore, mOptions.refine, mPlan.box, mPlan.levels, mPlan.meanE);
    mRefiner->limitSamples(mOptions.target.maxSamples);
    if (mOptions.parts > 1) choosePart();
}

/// This part's roots, and around them what decisions about them depend on.
void AdaptiveBake::choosePart()
{
    const std::vector<CellKey> all = Octree(mPlan.box, mPlan.levels).roots();
    const auto bound = [&](int part) {
        return all.size() * static_cast<std::size_t>(part)
            / static_cast<std::size_t>(mOptions.parts);
    };
    const std::size_t first = bound(mOptions.part - 1), last = bound(mOptions.part);
    if (first == last) {
        throw Error(ErrorCode::Usage,
            "There are only " + std::to_string(all.size()) + " cells of the coarsest level for "
                + std::to_string(mOptions.parts) + " parts; take fewer parts or fewer levels.");
    }
    mOwnRoots.assign(all.begin() + static_cast<std::ptrdiff_t>(first),
        all.begin() + static_cast<std::ptrdiff_t>(last));
    std::vector<CellKey> near;
    const int reach = kPartHalo << mPlan.levels;
    for (const CellKey& root : all) {
        const bool close = std::any_of(mOwnRoots.begin(), mOwnRoots.end(), [&](const CellKey& own) {
            const Coord d = root.origin - own.origin;
            return std::max({std::abs(d.x), std::abs(d.y), std::abs(d.z)}) <= reach;
        });
        if (close) near.push_back(root);
    }
    mRefiner->setRoots(near);
}

bool AdaptiveBake::isOwn(const CellKey& cell) const
{
    if (mOwnRoots.empty()) return true;
    CellKey root = cell;
    while (root.level < mPlan.levels) root = root.parent();
    return std::binary_search(mOwnRoots.begin(), mOwnRoots.end(), root);
}

IrradianceVolume AdaptiveBake::runOnce()
{
    refineOnce();
    if (mRefiner->isLimited()) {
        mReport.warnings.push_back("Cells were to be split further, but "
            + std::to_string(mStore->size()) + " samples are traced and "
            + std::to_string(mOptions.target.maxSamples) + " allowed: the coarser ones are kept.");
    }
    return assemble();
}

IrradianceVolume AdaptiveBake::build(const std::vector<CellKey>& cells) const
{
    const SampleSettings& s = mPlan.samples;
    const bool gradients = s.gradients != GradientMethod::None;
    // Levels chosen here leave room for finer cells than it turns out to need; the file does
    // without. Not so a lattice that was asked for, or that parts have to share.
    int finest = 0;
    if (mOptions.spacing == 0 && mOptions.parts == 1) {
        finest = kMaxLevel;
        for (const CellKey& cell : cells) finest = std::min(finest, cell.level);
    }
    const int step = 1 << finest;
    VolumeBuilder builder(s.bands,
        gradients ? GradientStorage::PerCoefficient : GradientStorage::None,
        latticeTransform(s.spacing * step));
    for (const CellKey& cell : cells) builder.addCell(cell.origin / step, cell.level - finest);
    IrradianceVolume volume = builder.build();
    const std::size_t stride
        = static_cast<std::size_t>(volume.coefficients()) * (gradients ? 4 : 1);
    std::vector<Vec3f> offsets(volume.sampleCount());
    bool moved = false;
    for (SampleId id = 0; id < volume.sampleCount(); ++id) {
        const std::size_t i = mStore->find(volume.samplePosition(id) * step);
        const SampleStore::Info& info = mStore->info(i);
        std::copy(mStore->radiance(i), mStore->radiance(i) + stride, volume.radiance(id));
        volume.validity(id) = info.validity;
        volume.distance(id) = info.distance;
        offsets[id] = info.offset;
        moved = moved || info.offset != Vec3f(0.0f);
    }
    if (moved) volume.setOffsets(std::move(offsets));
    if (gradients) limitGradients(volume);
    LatticeBox box;
    for (int a = 0; a < 3; ++a) {
        box.lower[a] = mPlan.box.lower[a] >> finest;
        box.upper[a] = (mPlan.box.upper[a] + step - 1) >> finest;
    }
    volume.metadata().bounds = box;
    return volume;
}

/// To what they are used for: the largest cell around each sample.
void AdaptiveBake::limitGradients(IrradianceVolume& volume)
{
    std::vector<int> level(volume.sampleCount(), 0);
    for (CellId id = 0; id < static_cast<CellId>(volume.cellCount()); ++id) {
        const Cell& cell = volume.cell(id);
        for (const SampleId s : cell.corners) level[s] = std::max(level[s], cell.level);
    }
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        const float factor = gradientFactor(volume.distance(s), volume.spacing() * (1 << level[s]));
        Color* gradient = volume.gradient(s);
        for (int i = 0; i < 3 * volume.coefficients(); ++i) gradient[i] *= factor;
    }
}

IrradianceVolume AdaptiveBake::assemble()
{
    Seconds time(mReport.secondsRefine);
    IrradianceVolume volume = build(mCells.cells);
    fillInvalid(volume);
    if (!mOwnRoots.empty()) {
        // What was filled depends on neighbours, which belong to other parts.
        std::vector<CellKey> own;
        for (const CellKey& cell : mCells.cells) {
            if (isOwn(cell)) own.push_back(cell);
        }
        IrradianceVolume part = build(own);
        const std::size_t stride
            = static_cast<std::size_t>(part.coefficients()) * (part.hasGradients() ? 4 : 1);
        for (SampleId id = 0; id < part.sampleCount(); ++id) {
            const auto from = static_cast<SampleId>(volume.findSample(part.samplePosition(id)));
            std::copy(volume.radiance(from), volume.radiance(from) + stride, part.radiance(id));
        }
        volume = std::move(part);
    }
    if (mOptions.visibility) {
        mProgress.enter(mRefiner->steps(), Outlook::Work::Cells);
        mReport.cutCells = computeVisibility(volume, mTracer, 0, &mProgress).cutCells;
    }
    return volume;
}

/// Directions at a point of verification, twice, to find an error of about @a error.
int AdaptiveBake::referenceRays(double error) const
{
    // The reference's own noise is that of paths, of which a cached bake's rays know nothing.
    const bool cached = mPlan.samples.probe.cache != nullptr;
    const double noisePerRay = cached ? mReport.bias.pathNoise : mPlan.noisePerRay;
    const double wanted = std::pow(noisePerRay / (kReferenceShare * error), 2);
    const double most = cached || mOptions.target.chooseRays
        ? kMaxReferenceRays
        : std::clamp(2.0 * mPlan.samples.probe.rays, 256.0, kMaxReferenceRays);
    return static_cast<int>(std::clamp(wanted, 64.0, most) / 2);
}

/// A first look at the first round, which is seldom enough, can only say no: it takes nothing of
/// the confidence. An error so large is found by few directions, and so at many points.
bool AdaptiveBake::looksWrong(const IrradianceVolume& volume)
{
    mProgress.enter(mRefiner->steps() + 1, Outlook::Work::Points);
    Verification verification(
        mTracer, mOptions, mPlan, mCells, volume, referenceRays(kFirstError * mThreshold), 0);
    mReport.achieved = verification.look(kFirstPoints, mOptions.target.confidence, mProgress);
    mReport.achieved.met = false;
    return mReport.achieved.relRmse >= kClearlyMissed * mOptions.target.error;
}

void AdaptiveBake::verify(const IrradianceVolume& volume, int round, bool last)
{
    Seconds time(mReport.secondsVerify);
    if (!last && round == 0 && looksWrong(volume)) return;
    Verification verification(
        mTracer, mOptions, mPlan, mCells, volume, referenceRays(mPlan.goal), round + 1);
    mProgress.enter(mRefiner->steps() + 2, Outlook::Work::Points);
    for (;; mVerifyPoints *= 2) {
        // Each look may pass by luck. The risks of all add up to what the confidence allows: shares
        // 1/2, 1/6, 1/12, … = 1/(k(k+1)) of it.
        ++mLooks;
        const double confidence = 1 - (1 - mOptions.target.confidence) / (mLooks * (mLooks + 1.0));
        mReport.achieved = verification.look(mVerifyPoints, confidence, mProgress);
        // Good enough, but too few points to be sure: look at more before tracing more.
        const AchievedError& a = mReport.achieved;
        const bool unsure = !a.met && a.relRmse < 0.95 * mOptions.target.error;
        if (!unsure || mVerifyPoints >= kMaxVerifyPoints) return;
    }
}

/// After the coarse levels: whether gradients make interpolation so much better that they are worth
/// four times the memory.
void AdaptiveBake::reconsiderGradients()
{
    if (!mOptions.target.chooseGradients || mPlan.samples.gradients == GradientMethod::None) return;
    const double with = mRefiner->rmsSurplus(true), without = mRefiner->rmsSurplus(false);
    const double least = mRehearsalRays > 0 ? kRehearsedGradientsPay : kGradientsPay;
    const bool pay = without > least * with;
    mReport.decisions.push_back(std::string("gradients ") + (pay ? "analytic" : "none")
        + ": with them the surplus is " + percentText(with) + " of the mean irradiance, without "
        + percentText(without));
    if (pay) return;
    mPlan.samples.gradients = GradientMethod::None;
    mDroppedRays += mStore->rays();
    start();
}

/// Mean squared standard error of the corners of all cells, which count by their volume.
double AdaptiveBake::measureNoise2() const
{
    Vec3d sum(0.0);
    for (const CellKey& cell : mCells.cells) {
        const double share = mRefiner->share(cell) / 8;
        for (int i = 0; i < 8; ++i) {
            sum += Vec3d(mStore->info(mStore->find(cell.corner(i))).variance) * share;
        }
    }
    double worst = 0;
    for (int c = 0; c < 3; ++c) {
        const double mean = mPlan.meanE[c];
        if (mean > 0) worst = std::max(worst, sum[c] / (mean * mean));
    }
    // A rehearsal's samples have more noise than the bake's will.
    if (mRehearsalRays > 0) worst *= static_cast<double>(mRehearsalRays) / mStore->meanDirections();
    return worst;
}

/// What refinement does not take away, squared: what the bands leave out, noise, a cache's bias.
double AdaptiveBake::fixedError2() const
{
    const double bias = mPlan.samples.probe.cache ? mReport.bias.rms : 0;
    return std::pow(mPlan.truncation, 2) + kInterpolatedNoise * mNoise2 + bias * bias;
}

/// What refinement itself thinks interpolation leaves out, squared.
double AdaptiveBake::thoughtError2() const
{
    const auto& parts = mCells.contribution;
    return std::max(kNothing2, std::accumulate(parts.begin(), parts.end(), 0.0));
}

/// What interpolation may leave out, squared.
double AdaptiveBake::allowedError2() const
{
    const double goal2 = mPlan.goal * mPlan.goal;
    // Where the bands leave out more than the target, interpolation leaves out as much as they do.
    return isHopeless() ? goal2 : std::max(kLeastAllowed * goal2, goal2 - fixedError2());
}

/// What measuring finds of interpolation's error, over what refinement thinks it is, squared.
/// @a error is all that was measured.
double AdaptiveBake::truthOfThought2(double error) const
{
    return std::max(kNothing2, error * error - fixedError2()) / thoughtError2();
}

/// Whether the error is what it may be, as far as the round knows.
bool AdaptiveBake::isThoughtEnough() const
{
    return mRound.truth2 * thoughtError2() <= allowedError2();
}

/// Whether the round goes on: not further than it may, whatever is missing then.
bool AdaptiveBake::goesOn() const
{
    return !mRefiner->isLimited() && mThreshold * kStep >= mRound.least && !isThoughtEnough();
}

/// How far the threshold falls at most before the second measurement. Without gradients the error
/// falls so slowly with the samples that going too far costs more than measuring once more.
double AdaptiveBake::firstFall() const
{
    return mPlan.samples.gradients != GradientMethod::None ? 0.02 : 0.1;
}

double AdaptiveBake::verifiedError(int round) const
{
    const bool gradients = mPlan.samples.gradients != GradientMethod::None;
    return round == 1 && gradients ? kVerifiedError : kVerifiedErrorLater;
}

/// Samples that are missing from @a samples on until the error is what it may be. What refinement
/// thinks is wrong falls as a power of their number, far more evenly than with the threshold.
double AdaptiveBake::missingSamples(double samples, double thought2, double truth2) const
{
    const double gone = std::log(samples / mForecast.round.samples);
    const double fallen = gone > 0 ? 0.5 * std::log(mFirstThought2 / thought2) : 0;
    const bool gradients = mPlan.samples.gradients != GradientMethod::None;
    const double power = gradients ? kFallWith : kFallWithout;
    const double known = std::max(kLeastFall, (kFallTrust * power + fallen) / (kFallTrust + gone));
    const double missing = 0.5 * std::log(truth2 * thought2 / allowedError2());
    const double most = static_cast<double>(mOptions.target.maxSamples);
    const double end = std::min(most, samples * std::exp(std::max(0.0, missing) / known));
    return std::max(0.0, end - samples);
}

/// The same with their directions, which go as a power of the samples: later ones stand for less
/// space and have fewer.
SampleCount AdaptiveBake::ahead(const SampleCount& now, double thought2, double truth2) const
{
    const SampleCount& first = mForecast.round;
    const double samples = missingSamples(now.samples, thought2, truth2);
    const double power
        = (mForecast.growth * kGrowthTrust + std::log(now.directions / first.directions))
        / (kGrowthTrust + std::log(now.samples / first.samples));
    return {samples, now.directions * (std::pow(1 + samples / now.samples, power) - 1)};
}

/// Refines with ever lower thresholds, until what refinement thinks is wrong has fallen as far as
/// the measured error has to.
void AdaptiveBake::approach(int round)
{
    Seconds time(mReport.secondsTrace);
    const double truth2 = truthOfThought2(verifiedError(round) * mReport.achieved.relRmse);
    mRound.number = round;
    mRound.least = mThreshold * (round == 1 ? firstFall() : kLaterFall);
    // A proof that fails where it was to succeed is often one that happened to find too much.
    const bool unlucky = round > 1 && isThoughtEnough();
    mRound.truth2 = unlucky ? (mRound.truth2 + truth2) / 2 : truth2;
    foresee(false);
    for (bool more = true; more;) {
        const double missing = missingSamples(count().samples, thoughtError2(), mRound.truth2);
        mThreshold = mRefiner->lowerThreshold(mCells, missing, mThreshold * kStep);
        refine();
        more = goesOn();
        foresee(!more);
    }
}

void AdaptiveBake::summarise(int rounds)
{
    const AchievedError& a = mReport.achieved;
    mReport.decisions.push_back("error threshold " + percentText(mThreshold) + " in the coarsest "
        + "cells, after " + std::to_string(rounds) + (rounds == 1 ? " round" : " rounds")
        + " of measuring at new points");
    if (mPlan.samples.stop.most > 0) {
        mReport.decisions.push_back(
            "rays " + std::to_string(mStore->meanDirections()) + " per sample on average");
    }
    if (a.met) return;
    mReport.warnings.push_back("The target error " + percentText(mOptions.target.error)
        + " is not met: " + percentText(a.relRmse) + " was reached, at most " + percentText(a.upper)
        + " with " + percentText(a.confidence) + " confidence, after "
        + std::to_string(mStore->size()) + " samples."
        + (isHopeless() ? " What " + std::to_string(mPlan.samples.bands)
                    + " bands leave out alone is " + percentText(mPlan.truncation) + "."
                        : ""));
    warnOfPointLights();
}

/// E² goes as 1/d⁴ around them, whose mean over space is infinite.
void AdaptiveBake::warnOfPointLights()
{
    if (mOptions.probe.contribution == Contribution::Indirect) return;
    for (const Light& light : mTracer.scene().lights) {
        const Vec3d p = light.position / mPlan.samples.spacing;
        bool inside = light.type != LightType::Directional;
        for (int a = 0; a < 3; ++a)
            inside = inside && p[a] >= mPlan.box.lower[a] && p[a] <= mPlan.box.upper[a];
        if (!inside) continue;
        mReport.warnings.push_back("The light '" + light.name
            + "' lies inside the bounds, and the squared irradiance around a point has no finite "
              "mean: bake indirect light, or keep it out of the bounds.");
        return;
    }
}

/// Where the samples end before a round does, the lowest threshold that they suffice for.
void AdaptiveBake::spendWhatIsLeft()
{
    Seconds time(mReport.secondsTrace);
    for (int i = 0; i < 12 && mRefiner->isLimited(); ++i) {
        mThreshold *= 1.3;
        mCells = mRefiner->run(mThreshold, mProgress);
    }
    mNoise2 = measureNoise2();
}

IrradianceVolume AdaptiveBake::runToTarget()
{
    for (int round = 0;; ++round) {
        round == 0 ? refineFirst() : approach(round);
        const bool limited = mRefiner->isLimited();
        if (limited) spendWhatIsLeft();
        IrradianceVolume volume = assemble();
        const bool last = limited || isLast(round);
        verify(volume, round, last);
        if (mReport.achieved.met || last) {
            summarise(round + 1);
            VolumeMetadata& m = volume.metadata();
            m.errorAsked = mOptions.target.error;
            m.errorReached = mReport.achieved.upper;
            m.errorConfidence = mReport.achieved.confidence;
            return volume;
        }
    }
}

void AdaptiveBake::refineFirst()
{
    Seconds time(mReport.secondsTrace);
    mThreshold = kFirstThreshold * mPlan.goal;
    refine();
    reconsiderGradients();
    if (mStore->size() == 0) refine();
    mPass = kFirstPasses;
    mProgress.enterPass(kFirstPasses - 1);
    mFirstThought2 = thoughtError2();
    mForecast.round = count();
}

void AdaptiveBake::refineOnce()
{
    Seconds time(mReport.secondsTrace);
    mThreshold = mOptions.refine.error;
    refine();
}

void AdaptiveBake::foresee(Forecast forecast)
{
    mForecast = std::move(forecast);
    const int pass = mForecast.ahead.samples > 0 ? Outlook::kLater : mForecast.pass;
    plan(mForecast.round, mForecast.ahead, pass);
}

void AdaptiveBake::foresee(bool done)
{
    if (mForecast.first.empty()) return;
    const SampleCount now = count();
    SampleCount more;
    if (!done) more = ahead(now, thoughtError2(), mRound.truth2);
    // Something is done in each round.
    if (!done && more.samples == 0) more = {kAgain * now.samples, kAgain * now.directions};
    plan(now, more, done ? mPass - 1 : Outlook::kLater);
}

/// Tells the outlook what there is to do from @a now on: the samples @a ahead, and the proof of
/// pass @a pass.
void AdaptiveBake::plan(const SampleCount& now, const SampleCount& ahead, int pass)
{
    using Work = Outlook::Work;
    const Forecast& f = mForecast;
    const auto seconds = [&](const SampleCount& of) {
        return f.perSample * of.samples + f.perDirection * of.directions;
    };
    // Those so far tell how long the others will take.
    double took = 0, directions = 0;
    for (const Outlook::Step& step : mProgress.steps()) {
        if (step.work != Work::Samples || step.kept) continue;
        took += step.seconds;
        directions += step.directions;
    }
    const double pace = directions > 0 ? took * now.directions / (directions * seconds(now)) : 1;
    std::vector<Outlook::Step> steps;
    if (mPass == 0) {
        steps = f.first;
        steps.push_back({f.pass, f.places, Work::Cells, f.cells});
        steps.push_back({f.pass, f.places + 1, Work::Points, f.look});
    }
    if (ahead.samples > 0) {
        steps.push_back({pass, Outlook::kUnknown, Work::Samples, pace * seconds(ahead),
            ahead.samples, ahead.directions});
    }
    if (mPass > 0 || ahead.samples > 0) {
        const double grown = (now.samples + ahead.samples) / f.round.samples;
        steps.push_back({pass, f.places, Work::Cells, f.cells * grown});
    }
    steps.push_back({pass, f.places + 2, Work::Points, f.proof});
    // Where no proof can succeed, it is known how many there will be.
    const int again = kHopelessRounds - 1 - std::max(1, mRound.number);
    if (mOptions.target.error > 0 && isHopeless() && again > 0) {
        const double all = pace * (seconds(now) + seconds(ahead));
        steps.push_back({Outlook::kLater, f.places + 3, Work::Points, again * f.proof});
        steps.push_back({Outlook::kLater, f.places + 4, Work::Samples, again * kAgain * all});
    }
    mProgress.plan(std::move(steps));
}

void AdaptiveBake::refine()
{
    mProgress.enterPass(mPass++);
    mCells = mRefiner->run(mThreshold, mProgress);
    mNoise2 = measureNoise2();
}

bool AdaptiveBake::isLast(int round) const
{
    return round + 1 == (isHopeless() ? kHopelessRounds : kMaxRounds);
}

IrradianceVolume bakeAdaptive(const Tracer& tracer, const BakeOptions& options,
    const BakePlan& plan, BakeReport& report, Progress& progress)
{
    Outlook outlook(progress);
    AdaptiveBake bake(tracer, options, plan, report, outlook);
    if (progress.wantsForecast()) bake.foresee(rehearse(tracer, options, plan, report, outlook));
    return bake.run();
}

} // namespace lumivdb
