// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/bake.h>

#include "bake_plan.h"
#include "seconds.h"
#include "threads.h"

#include <lumivdb/bake/visibility.h>
#include <lumivdb/core/error.h>

#include <cmath>
#include <limits>

namespace lumivdb {

namespace {

/// A cache this far off is worth a warning.
constexpr double kBiasToWarn = 0.01;
/// Directions of `path` at a place where a bias that is hard to tell from a target is measured: as
/// many as verification takes at most.
constexpr int kMostBiasRays = 16384;

/// A uniform volume: every sample straight into its record.
class UniformBake {
public:
    UniformBake(const Tracer& tracer, const SampleSettings& settings, IrradianceVolume& volume)
        : mVolume(volume)
        , mBaker(tracer, settings)
    {
    }

    void run(Progress& progress)
    {
        mNotes.resize(mVolume.sampleCount());
        std::vector<Vec3f> offsets = bakeSamples(
            mBaker, mVolume, [this](SampleId s, const BakedSample& r) { store(s, r); }, progress);
        if (!offsets.empty()) mVolume.setOffsets(std::move(offsets));
        finish();
    }

    std::uint64_t rays = 0;
    double meanRelativeStderr = 0;

private:
    struct Note {
        std::uint64_t rays;
        float mean, error; // of E averaged over normals, luminance
    };

    void store(SampleId s, const BakedSample& sample)
    {
        const ProbeResult& r = sample.result;
        std::copy(r.value.begin(), r.value.end(), mVolume.radiance(s));
        if (mVolume.hasGradients())
            std::copy(r.gradient.begin(), r.gradient.end(), mVolume.gradient(s));
        mVolume.validity(s) = r.validity;
        mVolume.distance(s) = r.distance;
        mNotes[s] = {sample.rays, luminance(r.value[0]), luminance(r.stderr_[0])};
    }

    void finish()
    {
        double mean = 0, error = 0;
        for (const Note& n : mNotes) {
            rays += n.rays;
            mean += n.mean;
            error += n.error;
        }
        meanRelativeStderr = mean > 0 ? error / mean : 0;
    }

    IrradianceVolume& mVolume;
    SampleBaker mBaker;
    std::vector<Note> mNotes;
};

IrradianceVolume bakeUniform(const Tracer& tracer, const BakeOptions& options, const BakePlan& plan,
    BakeReport& report, Progress& progress)
{
    SampleSettings s = plan.samples;
    s.gradientReach = s.spacing;
    VolumeBuilder builder(s.bands,
        s.gradients == GradientMethod::None ? GradientStorage::None
                                            : GradientStorage::PerCoefficient,
        latticeTransform(s.spacing));
    builder.addUniform(plan.box.lower, plan.box.upper);
    IrradianceVolume volume = builder.build();
    UniformBake bake(tracer, s, volume);
    {
        Seconds time(report.secondsTrace);
        bake.run(progress);
    }
    report.rays += bake.rays;
    report.meanRelativeStderr = bake.meanRelativeStderr;
    report.tracedSamples = volume.sampleCount();
    report.raysPerSample = s.probe.rays;
    if (options.visibility) {
        report.cutCells = computeVisibility(volume, tracer, 0, &progress).cutCells;
    }
    return volume;
}

void tell(SampleJournal& journal, BakeReport& report)
{
    journal.finish();
    report.journalSamples = journal.taken();
    for (const std::string& warning : journal.warnings()) report.warnings.push_back(warning);
}

/// Directions of a sample, or what a target will ask for: noise falls as 1/√rays.
double foreseenRays(const BakeOptions& options)
{
    constexpr double kRays = 1024, kError = 0.05; // two_rooms: 734 on average for 5%
    const ErrorTarget& target = options.target;
    if (!(target.error > 0) || !target.chooseRays) return options.probe.rays;
    return kRays * std::pow(kError / target.error, 2);
}

/// Solves the cache for a bake that asks for one and gains by it; says so where it cannot.
void solveCache(const Tracer& tracer, BakeOptions& options, BakeReport& report, Progress& progress)
{
    const ProbeOptions& probe = options.probe;
    if (options.integrator == Integrator::Path) return;
    options.integrator = Integrator::Path;
    if (probe.contribution == Contribution::Direct || probe.maxBounces == 0) {
        report.decisions.push_back("integrator path: direct light needs no cache");
        return;
    }
    RadianceCacheOptions cache;
    cache.box = bakeBox(tracer, options);
    cache.patches
        = RadianceCacheOptions::patchesFor(foreseenSamples(tracer, options), foreseenRays(options));
    cache.maxBounces = probe.maxBounces;
    cache.seed = probe.seed;
    try {
        const auto solved = std::make_shared<const RadianceCache>(tracer, cache, &progress);
        report.cache = solved->report();
        report.rays += report.cache.rays;
        options.probe.cache = solved;
        options.integrator = Integrator::Cached;
    } catch (const Error& e) {
        if (e.code() != ErrorCode::Input) throw;
        report.warnings.push_back(std::string(e.what()) + " It was used.");
    }
}

std::string biasText(const CacheBias& bias)
{
    return percentText(bias.rms) + ", at most " + percentText(bias.upper)
        + " with 95% confidence, at " + std::to_string(bias.points) + " places";
}

/// What the bias exceeds with the same confidence as it stays below its bound.
double lowerBound(const CacheBias& bias)
{
    return std::sqrt(std::max(0.0, 2 * bias.rms * bias.rms - bias.upper * bias.upper));
}

/// What is known of the cache's bias before a target is promised. Where noise leaves open on which
/// side of the limit it is, more is traced.
void judgeCache(const Tracer& tracer, BakeOptions& options, BakeReport& report, Progress& progress)
{
    Seconds time(report.secondsVerify);
    const Box3d box = bakeBox(tracer, options);
    const double limit = options.target.error / 2;
    CacheBiasOptions bias;
    for (bool open = true; open; bias.cachedRays *= 2, bias.pathRays *= 2) {
        report.bias = measureCacheBias(tracer, options.probe, box, bias, progress);
        report.rays += report.bias.rays;
        open = report.bias.points > 0 && report.bias.upper > limit
            && lowerBound(report.bias) <= limit && 2 * bias.pathRays <= kMostBiasRays;
    }
    const bool good = report.bias.points > 0 && report.bias.upper <= limit;
    report.decisions.push_back(std::string("integrator ") + (good ? "cached" : "path")
        + ": the cache's bias is " + biasText(report.bias)
        + (good ? "" : ", more than half of the target"));
    if (good) return;
    options.probe.cache = nullptr;
    options.integrator = Integrator::Path;
}

/// The same after a bake without a target: with a quarter of its directions, or few.
void measureBias(const Tracer& tracer, const BakeOptions& options, const IrradianceVolume& volume,
    BakeReport& report, Progress& progress)
{
    Seconds time(report.secondsVerify);
    CacheBiasOptions bias;
    const double directions
        = static_cast<double>(volume.sampleCount()) * std::max(1, report.raysPerSample);
    bias.pathRays = static_cast<int>(
        std::clamp(directions / (8.0 * static_cast<double>(bias.points)), 1024.0, 8192.0));
    const LatticeBox lattice = volume.latticeBounds();
    const auto world = [&](const Coord& c) { return Vec3d(c.x, c.y, c.z) * volume.spacing(); };
    report.bias = measureCacheBias(
        tracer, options.probe, Box3d(world(lattice.lower), world(lattice.upper)), bias, progress);
    report.rays += report.bias.rays;
    if (lowerBound(report.bias) > kBiasToWarn) {
        report.warnings.push_back("The radiance cache's bias is " + biasText(report.bias)
            + "; --integrator path has none.");
    }
}

/// Whether a target was missed that would have been met without the bias.
bool missedForBias(const BakeReport& report, const BakeOptions& options)
{
    const double upper = report.achieved.upper, bias = report.bias.upper;
    const double target = options.target.error;
    return options.integrator == Integrator::Cached && target > 0 && !report.achieved.met
        && upper * upper - bias * bias <= target * target;
}

/// Plans and bakes with the integrator of @a options.
IrradianceVolume bakePlanned(const Tracer& tracer, const BakeOptions& options,
    SampleJournal* journal, BakeReport& report, Progress& progress)
{
    BakePlan plan = planBake(tracer, options, report, progress);
    plan.samples.journal = journal;
    return plan.levels == 0 ? bakeUniform(tracer, options, plan, report, progress)
                            : bakeAdaptive(tracer, options, plan, report, progress);
}

/// The cached bake, and another by `path` where that one misses its target for the bias.
IrradianceVolume bakeWithin(const Tracer& tracer, BakeOptions& options, SampleJournal* journal,
    BakeReport& report, Progress& progress)
{
    auto decisions = report.decisions, warnings = report.warnings;
    IrradianceVolume volume = bakePlanned(tracer, options, journal, report, progress);
    if (!missedForBias(report, options)) return volume;
    report.decisions = std::move(decisions);
    report.warnings = std::move(warnings);
    report.decisions.push_back("integrator path after all: with the cache the error is up to "
        + percentText(report.achieved.upper) + ", of which its bias may be "
        + percentText(report.bias.upper));
    options.probe.cache = nullptr;
    options.integrator = Integrator::Path;
    return bakePlanned(tracer, options, journal, report, progress);
}

[[noreturn]] void refuse(const std::string& sentence) { throw Error(ErrorCode::Usage, sentence); }

} // namespace

void BakeOptions::validate() const
{
    probe.validate();
    refine.validate();
    if (bands < 0 || bands > kMaxBands) {
        refuse("bands is " + std::to_string(bands) + "; take 1 to " + std::to_string(kMaxBands)
            + ", or 0 to have them chosen.");
    }
    if (levels < -1 || levels > kMaxLevel) {
        refuse("levels is " + std::to_string(levels) + "; take 0 to " + std::to_string(kMaxLevel)
            + ", or -1 to have them chosen.");
    }
    if (!std::isfinite(spacing) || spacing < 0) {
        refuse("spacing is " + shortText(spacing) + "; take a positive length in scene units.");
    }
    if (!std::isfinite(target.error) || target.error < 0
        || !(target.confidence > 0.5 && target.confidence < 1)) {
        refuse("The error target is " + shortText(target.error) + " with confidence "
            + shortText(target.confidence)
            + "; take a positive share such as 0.02 and a confidence between 0.5 and 1.");
    }
    if (parts < 1 || part < 1 || part > parts) {
        refuse("Part " + std::to_string(part) + " of " + std::to_string(parts)
            + " does not exist; take 1/N to N/N.");
    }
    if (parts > 1 && target.error > 0) {
        refuse("A target error is measured over the whole volume; bake parts with a refinement "
               "threshold instead.");
    }
    if (parts > 1 && levels == 0) {
        refuse("Parts are for adaptive bakes; give a uniform one separate bounds instead.");
    }
    if (parts > 1 && spacing == 0) {
        refuse("Parts must share one lattice; give the spacing.");
    }
    if (!bounds) return;
    for (int a = 0; a < 3; ++a) {
        if (!(bounds->min[a] < bounds->max[a]) || !std::isfinite(bounds->min[a])
            || !std::isfinite(bounds->max[a])) {
            refuse(std::string("bounds are empty along ") + "xyz"[a] + " ("
                + shortText(bounds->min[a]) + " to " + shortText(bounds->max[a])
                + "); give x0,y0,z0,x1,y1,z1 with x0 < x1.");
        }
    }
}

const char* name(Integrator integrator)
{
    return integrator == Integrator::Cached ? "cached" : "path";
}

BakeResult bakeVolume(const Tracer& tracer, const BakeOptions& wanted, Progress* progress)
{
    wanted.validate();
    BakeOptions options = wanted;
    Progress silent;
    Progress& talk = progress ? *progress : silent;
    BakeReport report;
    const std::shared_ptr<SampleJournal> journal = openJournal(options, tracer.scene(), talk);
    std::optional<IrradianceVolume> volume;
    // Only where one stage traces all is its end that of the bake.
    const bool staged = options.levels != 0 || options.target.error > 0
        || options.integrator == Integrator::Cached;
    if (staged) talk.expect(std::numeric_limits<double>::infinity());
    withThreads(options.threads, [&] {
        solveCache(tracer, options, report, talk);
        const bool cached = options.integrator == Integrator::Cached;
        if (cached && options.target.error > 0) judgeCache(tracer, options, report, talk);
        volume.emplace(bakeWithin(tracer, options, journal.get(), report, talk));
        if (options.integrator == Integrator::Cached && !(options.target.error > 0)) {
            measureBias(tracer, options, *volume, report, talk);
        }
    });
    report.integrator = options.integrator;
    VolumeMetadata& m = volume->metadata();
    m.contribution = name(options.probe.contribution);
    m.lightGroup = options.lightGroup;
    m.seed = options.probe.seed;
    m.raysPerSample = static_cast<std::uint64_t>(report.raysPerSample);
    m.options = options.commandLine;
    m.integrator = name(options.integrator);
    if (options.integrator == Integrator::Cached && report.bias.points > 0) {
        m.cacheBias = report.bias.rms;
        m.cacheBiasUpper = report.bias.upper;
    }
    m.sceneHash = tracer.scene().contentHash;
    report.samples = volume->sampleCount();
    for (std::size_t n : volume->cellsByLevel()) report.cellsByLevel.push_back(n);
    const std::uint64_t traced = report.rays - (journal ? journal->takenRays() : 0);
    report.raysPerSecond
        = report.secondsTrace > 0 ? static_cast<double>(traced) / report.secondsTrace : 0;
    report.spacing = volume->spacing();
    if (journal) tell(*journal, report);
    return {std::move(*volume), std::move(report), journal};
}

} // namespace lumivdb
