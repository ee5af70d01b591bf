// SPDX-License-Identifier: Apache-2.0
#include "evaluator.h"

#include "directions.h"
#include "mean_bound.h"
#include "visibility_cell.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstring>
#include <limits>

namespace lumivdb {

namespace {

/// Random points are drawn in rounds until enough are in free space, but not for ever.
constexpr int kMaxRounds = 64;
constexpr std::size_t kWorstPlaces = 10;
constexpr std::size_t kTimedQueries = 20000;
constexpr const char* kReferenceStage = "trace the reference";
/// Points that share directions share some of their error: those of a `twice` are spread over pairs
/// of as many patterns as have so many directions in all.
constexpr int kPatternDirections = 1 << 17, kFewestPatterns = 2, kMostPatterns = 512;
/// Least and most directions of a point over EvaluateOptions::rays, where points have their own.
constexpr double kLeastShare = 0.25, kMostShare = 64, kShareStep = 4;
constexpr double kFewestRays = 16, kMostRays = 1 << 16;
constexpr double kInf = std::numeric_limits<double>::infinity();

ProbeOptions probeOptions(const EvaluateOptions& o)
{
    ProbeOptions p;
    p.rays = o.rays;
    p.seed = o.seed;
    p.maxBounces = o.maxBounces;
    p.contribution = o.contribution;
    return p;
}

bool isFinite(const Color& c)
{
    return std::isfinite(c.x) && std::isfinite(c.y) && std::isfinite(c.z);
}

/// A NaN would pass every comparison of errors unseen.
[[noreturn]] void throwNotFinite(const Vec3d& p)
{
    throw Error(ErrorCode::Input,
        "The volume's or the scene's light at (" + std::to_string(p.x) + ", " + std::to_string(p.y)
            + ", " + std::to_string(p.z)
            + ") is not a finite number; check the volume's samples and the scene's lights "
              "there.");
}

} // namespace

Evaluator::Evaluator(const IrradianceVolume& volume, const Tracer& tracer,
    const EvaluateOptions& options, const Vec3d& means)
    : mVolume(volume)
    , mTracer(tracer)
    , mOptions(options)
    , mSampler(volume, options.mode)
    , mNormals(uniformNormals(options.normals))
    , mMeans(means)
{
    if (means == Vec3d(0.0)) {
        mReferences.push_back(references(tracer, options.rays));
        return;
    }
    for (double share = kLeastShare; share <= kMostShare; share *= kShareStep) {
        const double rays = std::clamp(share * options.rays, kFewestRays, kMostRays);
        mReferences.push_back(references(tracer, static_cast<int>(rays)));
    }
}

/// One, or pairs of independent ones.
Evaluator::References Evaluator::references(const Tracer& tracer, int rays) const
{
    const int patterns = std::clamp(kPatternDirections / rays, kFewestPatterns, kMostPatterns);
    const auto pairs = static_cast<std::uint64_t>(patterns / SamplingPattern::count(rays));
    const std::uint64_t count = mOptions.twice ? 2 * pairs : 1;
    References result;
    for (std::uint64_t i = 0; i < count; ++i) {
        ProbeOptions o = probeOptions(mOptions);
        o.rays = rays;
        if (i > 0) o.seed = hashCombine(o.seed, i);
        result.push_back(std::make_unique<OwnEstimator>(tracer, o));
    }
    return result;
}

/// Of two independent references the errors' product, whose variance goes as w² V⁴ / rays², V being
/// what the volume says, is summed: least with rays in proportion to (w V²)^⅔. They depend on the
/// volume alone, not on what a reference finds, which would bias it.
const Evaluator::References& Evaluator::referencesFor(const Comparison& c) const
{
    if (mReferences.size() == 1) return mReferences.front();
    double bright2 = 0;
    for (int i = 0; i < 3; ++i) {
        double square = 0;
        for (const Color& v : c.volume) square += static_cast<double>(v[i]) * v[i];
        const double mean2 = static_cast<double>(c.volume.size()) * mMeans[i] * mMeans[i];
        if (mean2 > 0) bright2 = std::max(bright2, square / mean2);
    }
    const double share = std::pow(c.weight * bright2, 2.0 / 3);
    const double step = std::log(std::max(share, kLeastShare) / kLeastShare) / std::log(kShareStep);
    const double last = static_cast<double>(mReferences.size()) - 1;
    return mReferences[static_cast<std::size_t>(std::min(std::round(step), last))];
}

void Evaluator::addRandom(Progress& progress)
{
    progress.begin(kReferenceStage, mOptions.points);
    const std::size_t wanted = mComparisons.size() + mOptions.points;
    for (int round = 0; round < kMaxRounds && mComparisons.size() < wanted; ++round) {
        // Later rounds replace what was rejected, with some to spare.
        const std::size_t missing = wanted - mComparisons.size();
        const std::size_t count
            = round == 0 ? mOptions.points : std::min(mOptions.points, 2 * missing + 16);
        compare(randomPoints(count, round), {}, missing, progress);
    }
}

void Evaluator::add(
    const std::vector<Vec3d>& points, const std::vector<double>& weights, Progress& progress)
{
    progress.begin(kReferenceStage, points.size());
    mOutside += compare(points, weights, points.size(), progress);
}

EvaluateReport Evaluator::report(double confidence) const
{
    if (mComparisons.empty()) {
        throw Error(ErrorCode::Input,
            "No point of the volume lies in free space inside it, so there is nothing to compare; "
            "check that the scene is the one the volume was baked from.");
    }
    EvaluateReport report;
    report.normals = mOptions.normals;
    report.points = mComparisons.size();
    report.rejected = mRejected;
    report.outside = mOutside;
    Vec3d means(0.0);
    for (int c = 0; c < 3; ++c) means[c] = summariseChannel(c, confidence, report);
    listWorst(means, report);
    report.queryNs = timeQueries();
    return report;
}

std::vector<Vec3d> Evaluator::randomPoints(std::size_t count, int round) const
{
    const LatticeBox box = mVolume.latticeBounds();
    std::vector<Vec3d> points(count);
    for (std::size_t i = 0; i < count; ++i) {
        CounterRng rng(
            hashCombine(hashCombine(mixBits(mOptions.seed), i), static_cast<std::uint64_t>(round)));
        for (int a = 0; a < 3; ++a) {
            points[i][a] = box.lower[a]
                + rng.nextDouble() * (static_cast<double>(box.upper[a]) - box.lower[a]);
        }
        points[i] = points[i] * mVolume.indexToWorld();
    }
    return points;
}

std::size_t Evaluator::compare(const std::vector<Vec3d>& points, const std::vector<double>& weights,
    std::size_t most, Progress& progress)
{
    std::vector<Comparison> found(points.size());
    std::vector<Fate> fates(points.size());
    std::atomic<bool> stop{false};
    tbb::parallel_for(std::size_t{0}, points.size(), [&](std::size_t i) {
        if (stop || progress.cancelled()) {
            stop = true;
            return;
        }
        if (!weights.empty()) found[i].weight = weights[i];
        fates[i] = compare(points[i], found[i]);
        if (fates[i] == Fate::Compared) progress.advance(1);
    });
    if (stop) throw Error(ErrorCode::Interrupted, "The evaluation was interrupted.");
    const std::size_t wanted = mComparisons.size() + most;
    std::size_t outside = 0;
    for (std::size_t i = 0; i < points.size() && mComparisons.size() < wanted; ++i) {
        if (fates[i] == Fate::NotFinite) throwNotFinite(points[i]);
        if (fates[i] == Fate::InsideGeometry) ++mRejected;
        if (fates[i] == Fate::OutsideVolume) ++outside;
        if (fates[i] == Fate::Compared) mComparisons.push_back(std::move(found[i]));
    }
    return outside;
}

/// Behind a single-sided surface, but so little that a cell of @a level counts it to the front; its
/// validity is ½, give or take noise.
bool Evaluator::isOnBack(const Vec3d& p, int level) const
{
    const double behind = kBehind * mVolume.spacing() * (1 << level);
    Vec3d front;
    if (!mTracer.closestSurface(p, behind, nullptr, &front)) return false;
    const SurfaceHit hit = mTracer.intersect(p, front);
    if (!hit.hit || !hit.backFace || hit.distance > behind) return false;
    const Scene& scene = mTracer.scene();
    const int material = scene.meshes[static_cast<std::size_t>(hit.mesh)].material;
    return !scene.materials[static_cast<std::size_t>(material)].doubleSided;
}

Evaluator::Fate Evaluator::compare(const Vec3d& p, Comparison& c)
{
    QueryInfo info;
    mSampler.irradiance(p, mNormals[0], &info);
    if (info.level < 0) return Fate::OutsideVolume;
    if (isOnBack(p, info.level)) return Fate::InsideGeometry;
    // The key depends on the place alone: the same point has the same reference in any list.
    std::uint64_t key = mixBits(mOptions.seed);
    for (int a = 0; a < 3; ++a) {
        std::uint64_t bits;
        static_assert(sizeof bits == sizeof p[a]);
        std::memcpy(&bits, &p[a], sizeof bits);
        key = hashCombine(key, bits);
    }
    c.position = p;
    for (const Vec3f& n : mNormals) c.volume.push_back(mSampler.irradiance(p, n));
    const References& references = referencesFor(c);
    const std::size_t first = mOptions.twice ? 2 * (key % (references.size() / 2)) : 0;
    ProbeResult r = references[first]->irradiance(p, mNormals, key);
    if (r.validity < kValidThreshold) return Fate::InsideGeometry;
    c.reference = std::move(r.value);
    c.error = std::move(r.stderr_);
    if (mOptions.twice) join(references[first + 1]->irradiance(p, mNormals, ~key), c);
    const bool finite = std::all_of(c.volume.begin(), c.volume.end(), isFinite)
        && std::all_of(c.reference.begin(), c.reference.end(), isFinite);
    return finite ? Fate::Compared : Fate::NotFinite;
}

/// The mean with a second, independent reference. (a − b)²/4 has the mean's variance as its
/// expectation, so squared errors less it are (V − a)(V − b), where no noise is left.
void Evaluator::join(const ProbeResult& second, Comparison& c)
{
    for (std::size_t k = 0; k < c.reference.size(); ++k) {
        c.error[k] = (c.reference[k] - second.value[k]) * 0.5f;
        c.reference[k] = (c.reference[k] + second.value[k]) * 0.5f;
    }
}

/// The worst channel so far of everything; returns the channel's mean.
double Evaluator::summariseChannel(int c, double confidence, EvaluateReport& report) const
{
    double weights = 0, mean = 0, bias = 0, square = 0, noise = 0;
    std::vector<std::pair<double, double>> absolute; // error, weight
    // By point, times its weight; the first two are means over its normals.
    std::vector<double> squares, values, pointWeights;
    for (const Comparison& point : mComparisons) {
        const double w = point.weight / static_cast<double>(point.reference.size());
        double square1 = 0, noise1 = 0, mean1 = 0;
        for (std::size_t k = 0; k < point.reference.size(); ++k) {
            const double reference = point.reference[k][c];
            const double difference = point.volume[k][c] - reference;
            mean1 += w * reference;
            bias += w * difference;
            square1 += w * difference * difference;
            noise1 += w * static_cast<double>(point.error[k][c]) * point.error[k][c];
            absolute.emplace_back(std::abs(difference), w);
        }
        mean += mean1;
        square += square1;
        noise += noise1;
        squares.push_back(mOptions.twice ? square1 - noise1 : square1);
        values.push_back(mean1);
        pointWeights.push_back(point.weight);
        weights += point.weight;
    }
    mean /= weights;
    const auto relative = [&](double v) { return mean > 0 ? v / mean : v == 0 ? 0 : kInf; };
    std::sort(absolute.begin(), absolute.end());
    const auto percentile = [&](double q) {
        double left = q * weights;
        for (const auto& [error, w] : absolute) {
            if ((left -= w) <= 0) return relative(error);
        }
        return relative(absolute.back().first);
    };
    report.relRmse = std::max(report.relRmse, relative(std::sqrt(square / weights)));
    report.referenceStderr = std::max(report.referenceStderr, relative(std::sqrt(noise / weights)));
    report.p50 = std::max(report.p50, percentile(0.50));
    report.p95 = std::max(report.p95, percentile(0.95));
    report.p99 = std::max(report.p99, percentile(0.99));
    report.max = std::max(report.max, relative(absolute.back().first));
    const double signedBias = bias < 0 ? -relative(-bias / weights) : relative(bias / weights);
    if (std::abs(signedBias) > std::abs(report.bias)) report.bias = signedBias;

    // The bound keeps a single reference's noise in: the standard errors, which are taken off
    // the estimate, err on the large side.
    const double debiased = std::max(0.0, square / weights - noise / weights);
    report.relRmseDebiased = std::max(report.relRmseDebiased, relative(std::sqrt(debiased)));
    const double upper = mean > 0
        ? std::sqrt(std::max(0.0, upperRelativeSquare(squares, values, pointWeights, confidence)))
        : relative(std::sqrt(square / weights));
    report.upper = std::max(report.upper, upper);
    return mean;
}

void Evaluator::listWorst(const Vec3d& means, EvaluateReport& report) const
{
    const double mean = (means.x + means.y + means.z) / 3;
    for (const Comparison& point : mComparisons) {
        double square = 0;
        for (std::size_t k = 0; k < point.reference.size(); ++k) {
            square += (point.volume[k] - point.reference[k]).length2();
        }
        const double rms = std::sqrt(square / (3.0 * static_cast<double>(point.reference.size())));
        report.worst.push_back({point.position, mean > 0 ? rms / mean : rms == 0 ? 0 : kInf});
    }
    std::stable_sort(report.worst.begin(), report.worst.end(),
        [](const auto& a, const auto& b) { return a.error > b.error; });
    if (report.worst.size() > kWorstPlaces) report.worst.resize(kWorstPlaces);
}

/// One thread, places in random order.
double Evaluator::timeQueries() const
{
    const std::vector<Vec3d> points = randomPoints(kTimedQueries, kMaxRounds);
    std::vector<Vec3f> normals(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) normals[i] = mNormals[i % mNormals.size()];
    std::vector<Color> E(points.size());
    const auto start = std::chrono::steady_clock::now();
    mSampler.irradiance(points.size(), points.data(), normals.data(), E.data());
    const double seconds
        = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return seconds * 1e9 / static_cast<double>(points.size());
}

} // namespace lumivdb
