// SPDX-License-Identifier: Apache-2.0
#include "sample_baker.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/bake/visibility.h>

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstring>
#include <numeric>

namespace lumivdb {

namespace {

/// A sample closer to a surface than half this share of the spacing is moved off it, by this share.
constexpr double kOnSurface = 1e-3;
/// The same in sizes of the scene: rays begin at single-precision positions.
constexpr double kSceneClearance = 2e-6;

/// What the journal calls samples of these settings.
SampleJournal::Kind kindOf(const SampleSettings& settings)
{
    // Taken apart, so that a new member does not compile before it has found its place here.
    const auto& [probe, stop, levels, bands, gradients, spacing, gradientReach, rehearsedRays,
        journal]
        = settings;
    const auto& [meanE, perDeviation, tolerance, most] = stop;
    const auto& [rays, maxBounces, contribution, seed, cache] = probe;
    static_cast<void>(journal);
    static_cast<void>(rehearsedRays); // keeps no journal
    const auto bits = [](double v) {
        std::uint64_t u;
        std::memcpy(&u, &v, sizeof u);
        return u;
    };
    SampleJournal::Kind kind;
    for (const std::uint64_t part : {static_cast<std::uint64_t>(rays),
             static_cast<std::uint64_t>(maxBounces), static_cast<std::uint64_t>(contribution), seed,
             static_cast<std::uint64_t>(cache ? 1 : 0), static_cast<std::uint64_t>(bands),
             static_cast<std::uint64_t>(gradients), bits(spacing), bits(gradientReach),
             static_cast<std::uint64_t>(most), static_cast<std::uint64_t>(levels),
             bits(perDeviation), bits(tolerance), bits(meanE.x), bits(meanE.y), bits(meanE.z)}) {
        kind.settings = hashCombine(kind.settings, part);
    }
    kind.values = static_cast<std::uint32_t>(coefficientCount(bands));
    kind.gradients = gradients == GradientMethod::None ? 0 : 3 * kind.values;
    return kind;
}

} // namespace

SampleBaker::SampleBaker(const Tracer& tracer, const SampleSettings& settings)
    : mTracer(tracer)
    , mSettings(settings)
    , mClearance(kOnSurface * settings.spacing)
    , mEstimator(tracer, settings.probe)
    , mKind(kindOf(settings))
{
    const Box3d bounds = tracer.scene().bounds();
    if (!bounds.isEmpty()) {
        mClearance = std::max(
            mClearance, std::min(0.1 * settings.spacing, kSceneClearance * bounds.size().length()));
    }
}

BakedSample SampleBaker::bake(const Coord& c, ProbeEstimator::Workspace& workspace) const
{
    SampleJournal* journal = mSettings.journal;
    BakedSample sample;
    if (journal && journal->take(mKind, c, sample)) return sample;
    sample = trace(c, workspace);
    if (journal) journal->add(mKind, c, sample);
    return sample;
}

StopRule SampleBaker::stopRule(const Coord& c) const
{
    StopRule stop = mSettings.stop;
    const unsigned bits = static_cast<unsigned>(c.x | c.y | c.z);
    int level = 0;
    while (level < mSettings.levels && !(bits >> level & 1u)) ++level;
    stop.perDeviation *= std::pow(2.0, 1.5 * (level - mSettings.levels));
    return stop;
}

BakedSample SampleBaker::trace(const Coord& c, ProbeEstimator::Workspace& workspace) const
{
    const std::uint64_t key = hashPoint(mSettings.probe.seed, c.x, c.y, c.z);
    const bool analytic = mSettings.gradients == GradientMethod::Analytic;
    const Vec3d lattice = world(c);
    Vec3d p = moveOffSurfaces(mTracer, lattice, mClearance);
    BakedSample sample;
    const int first = mSettings.rehearsedRays;
    const StopRule asked = stopRule(c), stop = first > 0 ? StopRule() : asked;
    const auto measure = [&](const Vec3d& place) {
        ProbeResult r
            = mEstimator.radianceSh(place, mSettings.bands, key, workspace, analytic, stop);
        sample.rays += r.rays;
        return r;
    };
    sample.result = measure(p);
    if (sample.result.validity < kValidThreshold) {
        const auto outside = relocated(mTracer, lattice, mSettings.spacing, mClearance);
        ProbeResult moved;
        if (outside && (moved = measure(*outside)).validity >= kValidThreshold) {
            sample.result = std::move(moved);
            p = *outside;
        }
    }
    sample.offset = Vec3f(p - lattice);
    sample.variance = Color(irradianceNorm2(mSettings.bands, sample.result.stderr_.data()));
    if (mSettings.gradients != GradientMethod::None) addGradient(p, key, workspace, sample);
    if (first > 0) {
        sample.result.directions = foreseenDirections(
            sample.result, mSettings.bands, asked, static_cast<std::uint64_t>(first));
    }
    return sample;
}

void SampleBaker::addGradient(const Vec3d& p, std::uint64_t key,
    ProbeEstimator::Workspace& workspace, BakedSample& sample) const
{
    ProbeResult& r = sample.result;
    if (mSettings.gradients == GradientMethod::Central) {
        sample.rays += centralGradient(
            mTracer, mEstimator, p, mSettings.bands, mSettings.spacing, key, workspace, r);
    }
    limitGradient(mSettings.gradientReach, r);
}

namespace {

/// Neighbours are baked one after the other in runs of this length at most: what they see is in the
/// cache. Few samples are baked one by one, so that all threads have some.
constexpr std::size_t kLongestRun = 16, kManyRuns = 1024;

/// Runs of 0 … count − 1 in an order whose every stretch is spread over the whole: steps of about
/// the golden ratio, coprime to their number.
class MixedRuns {
public:
    explicit MixedRuns(std::size_t count)
        : mCount(count)
        , mLength(std::clamp(count / kManyRuns, std::size_t{1}, kLongestRun))
        , mRuns((count + mLength - 1) / mLength)
        , mStep(static_cast<std::size_t>(0.6180339887498949 * static_cast<double>(mRuns)) | 1)
    {
        while (std::gcd(mStep, mRuns) > 1) ++mStep;
    }
    std::size_t size() const { return mRuns; }
    std::size_t begin(std::size_t i) const { return i * mStep % mRuns * mLength; }
    std::size_t end(std::size_t i) const { return std::min(mCount, begin(i) + mLength); }

private:
    std::size_t mCount, mLength, mRuns, mStep;
};

} // namespace

void bakeSamples(const SampleBaker& baker, std::size_t count,
    const std::function<Coord(std::size_t)>& at,
    const std::function<void(std::size_t, const BakedSample&)>& store, Progress& progress)
{
    tbb::enumerable_thread_specific<ProbeEstimator::Workspace> workspaces;
    std::atomic<bool> stop{false};
    const auto bakeAll = [&](const std::vector<std::size_t>& numbers, const char* stage) {
        if (numbers.empty()) return;
        progress.begin(stage, numbers.size());
        const MixedRuns runs(numbers.size());
        tbb::parallel_for(std::size_t{0}, runs.size(), [&](std::size_t run) {
            for (std::size_t k = runs.begin(run); k != runs.end(run); ++k) {
                if (stop || progress.cancelled()) {
                    stop = true;
                    return;
                }
                store(numbers[k], baker.bake(at(numbers[k]), workspaces.local()));
                progress.advance(1);
            }
        });
        if (stop)
            throw Error(ErrorCode::Interrupted, "The bake was interrupted; nothing was written.");
    };
    std::vector<std::size_t> kept, others;
    for (std::size_t i = 0; i < count; ++i) (baker.isKept(at(i)) ? kept : others).push_back(i);
    bakeAll(kept, kJournalStage);
    bakeAll(others, "trace samples");
}

std::vector<Vec3f> bakeSamples(const SampleBaker& baker, const IrradianceVolume& volume,
    const std::function<void(SampleId, const BakedSample&)>& store, Progress& progress)
{
    std::vector<Vec3f> offsets(volume.sampleCount());
    bakeSamples(
        baker, offsets.size(),
        [&](std::size_t i) { return volume.samplePosition(static_cast<SampleId>(i)); },
        [&](std::size_t i, const BakedSample& sample) {
            offsets[i] = sample.offset;
            store(static_cast<SampleId>(i), sample);
        },
        progress);
    const bool moved = std::any_of(
        offsets.begin(), offsets.end(), [](const Vec3f& o) { return o != Vec3f(0.0f); });
    return moved ? offsets : std::vector<Vec3f>();
}

} // namespace lumivdb
