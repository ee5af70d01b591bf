// SPDX-License-Identifier: Apache-2.0
#include "bench_study.h"

#include "common.h"

#include <lumivdb/core/random.h>

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>

namespace lumivdb::cli {

namespace {

constexpr int kNormals = 32;
constexpr int kMaxRounds = 64;
constexpr std::size_t kTimedQueries = 20000;

const std::vector<Interpolation> kWithoutGradients
    = {Interpolation::Nearest, Interpolation::Trilinear, Interpolation::InverseDistance};
const std::vector<Interpolation> kWithGradients
    = {Interpolation::Taylor, Interpolation::Gradient, Interpolation::Tricubic};

class Builder {
public:
    Builder(const Box3d& bounds, double finest)
        : mSize(bounds.size())
        , mFinest(finest)
    {
    }

    void uniform(double spacings, int bands, GradientMethod gradients,
        const std::vector<Interpolation>& modes)
    {
        BenchConfiguration c;
        c.spacing = mFinest * spacings;
        c.bands = bands;
        c.gradients = gradients;
        c.modes = modes;
        c.expectedCost = samples(c.spacing) * (gradients == GradientMethod::Central ? 7 : 1);
        all.push_back(c);
    }

    void adaptive(int levels, double threshold, int bands, GradientMethod gradients,
        const std::vector<Interpolation>& modes)
    {
        BenchConfiguration c;
        c.spacing = mFinest;
        c.levels = levels;
        c.threshold = threshold;
        c.bands = bands;
        c.gradients = gradients;
        c.modes = modes;
        // Nobody knows before; tests of cells count as well.
        c.expectedCost = 0.5 * samples(mFinest);
        all.push_back(c);
    }

    /// The same volumes as those of paths without gradients and with the analytic ones, of three
    /// bands, each with the interpolation that suits it best.
    void cached()
    {
        const std::vector<BenchConfiguration> paths = all;
        for (BenchConfiguration c : paths) {
            if (c.bands != 3 || c.gradients == GradientMethod::Central) continue;
            const bool plain = c.gradients == GradientMethod::None;
            c.method = BenchMethod::Cached;
            c.modes = {plain ? Interpolation::Trilinear : Interpolation::Gradient};
            all.push_back(c);
        }
    }

    void propagated(double spacings, BenchMethod method)
    {
        BenchConfiguration c;
        c.method = method;
        c.spacing = mFinest * spacings;
        c.bands = 2;
        c.modes = {Interpolation::Trilinear};
        c.expectedCost = 0.1 * samples(c.spacing);
        all.push_back(c);
    }

    std::vector<BenchConfiguration> all;

private:
    double samples(double spacing) const
    {
        return (mSize.x / spacing + 2) * (mSize.y / spacing + 2) * (mSize.z / spacing + 2);
    }

    Vec3d mSize;
    double mFinest;
};

void buildQuick(Builder& builder)
{
    using G = GradientMethod;
    builder.uniform(4, 3, G::None, {Interpolation::Trilinear});
    builder.uniform(2, 3, G::None, kWithoutGradients);
    builder.uniform(2, 5, G::None, {Interpolation::Trilinear});
    builder.uniform(4, 3, G::Central, {Interpolation::Gradient});
    builder.uniform(4, 3, G::Analytic, kWithGradients);
    builder.uniform(2, 3, G::Analytic, {Interpolation::Gradient});
    for (const double threshold : {0.2, 0.05}) {
        builder.adaptive(3, threshold, 3, G::None, {Interpolation::Trilinear});
        builder.adaptive(3, threshold, 3, G::Analytic, {Interpolation::Gradient});
    }
}

void buildFull(Builder& builder)
{
    using G = GradientMethod;
    for (const double spacings : {4, 2, 1}) {
        for (const int bands : {2, 4, 5})
            builder.uniform(spacings, bands, G::None, {Interpolation::Trilinear});
        builder.uniform(spacings, 3, G::None, kWithoutGradients);
        builder.uniform(spacings, 3, G::Analytic, kWithGradients);
        if (spacings > 1) builder.uniform(spacings, 3, G::Central, kWithGradients);
    }
    for (const double threshold : {0.4, 0.2, 0.1, 0.05, 0.025}) {
        builder.adaptive(3, threshold, 3, G::None, {Interpolation::Trilinear});
        builder.adaptive(
            3, threshold, 3, G::Analytic, {Interpolation::Gradient, Interpolation::Tricubic});
    }
    builder.adaptive(2, 0.1, 3, G::None, {Interpolation::Trilinear});
    builder.adaptive(4, 0.1, 3, G::None, {Interpolation::Trilinear});
    builder.adaptive(3, 0.1, 5, G::None, {Interpolation::Trilinear});
    builder.adaptive(3, 0.1, 5, G::Analytic, {Interpolation::Gradient});
    builder.adaptive(3, 0.1, 3, G::Central, {Interpolation::Gradient});
}

void buildPropagated(Builder& builder, bool quick)
{
    for (const double spacings : {4, 2, 1}) {
        if (quick && spacings != 2) continue;
        for (const BenchMethod m : {BenchMethod::Lpv, BenchMethod::LpvMany, BenchMethod::LpvOpen})
            builder.propagated(spacings, m);
    }
}

bool isBeaten(double cost, double error, double otherCost, double otherError)
{
    return otherCost <= cost && otherError <= error && (otherCost < cost || otherError < error);
}

} // namespace

const char* name(GradientMethod gradients)
{
    switch (gradients) {
    case GradientMethod::Central:
        return "central";
    case GradientMethod::Analytic:
        return "analytic";
    case GradientMethod::None:
        break;
    }
    return "none";
}

const char* integrator(const BenchConfiguration& c)
{
    switch (c.method) {
    case BenchMethod::Path:
        return "path";
    case BenchMethod::Cached:
        return "cached";
    case BenchMethod::Lpv:
    case BenchMethod::LpvMany:
    case BenchMethod::LpvOpen:
        break;
    }
    return "lpv";
}

const char* representation(const BenchConfiguration& c)
{
    switch (c.method) {
    case BenchMethod::Lpv:
        return "lpv";
    case BenchMethod::LpvMany:
        return "lpv-many";
    case BenchMethod::LpvOpen:
        return "lpv-open";
    case BenchMethod::Path:
    case BenchMethod::Cached:
        break;
    }
    return c.levels == 0 ? "uniform" : "adaptive";
}

std::vector<BenchConfiguration> benchConfigurations(
    const Box3d& bounds, double finest, bool quick, Contribution contribution)
{
    Builder builder(bounds, finest);
    if (quick)
        buildQuick(builder);
    else
        buildFull(builder);
    if (contribution != Contribution::Direct) { // neither is of use for it
        builder.cached();
        buildPropagated(builder, quick);
    }
    return std::move(builder.all);
}

void markPareto(std::vector<BenchRow>& rows)
{
    for (BenchRow& row : rows) {
        const auto beatenBy = [&](auto cost) {
            return std::any_of(rows.begin(), rows.end(), [&](const BenchRow& other) {
                return other.scene == row.scene
                    && isBeaten(cost(row), row.relRmse, cost(other), other.relRmse);
            });
        };
        row.bestForSeconds = !beatenBy([](const BenchRow& r) { return r.bakeSeconds; });
        row.bestForBytes
            = !beatenBy([](const BenchRow& r) { return static_cast<double>(r.bytes); });
    }
}

BenchReference::BenchReference(const Tracer& tracer, std::size_t points, int rays,
    Contribution contribution, std::uint64_t seed, Progress& progress)
    : mBounds(tracer.scene().bounds())
    , mSeed(seed)
    , mNormals(uniformNormals(kNormals))
{
    ProbeOptions options;
    options.rays = rays;
    options.contribution = contribution;
    options.seed = seed;
    const ProbeEstimator estimator(tracer, options);
    for (std::size_t round = 0, begin = 0; round < kMaxRounds && mPoints.size() < points; ++round) {
        const std::size_t count = points - mPoints.size();
        tracePoints(estimator, begin, count, progress);
        begin += count;
    }
    if (mPoints.empty())
        throw Error(ErrorCode::Input,
            "No point of the scene's box lies in free space, so there is nothing to measure; take "
            "a scene with room in it.");
}

void BenchReference::tracePoints(
    const ProbeEstimator& estimator, std::size_t begin, std::size_t count, Progress& progress)
{
    std::vector<Point> found(count);
    tbb::enumerable_thread_specific<ProbeEstimator::Workspace> workspaces;
    std::atomic<bool> stop{false};
    tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
        if (stop || progress.cancelled()) {
            stop = true;
            return;
        }
        const std::uint64_t key = hashCombine(mixBits(mSeed), begin + i);
        CounterRng rng(key);
        Vec3d p;
        for (int a = 0; a < 3; ++a)
            p[a] = mBounds.min[a] + rng.nextDouble() * (mBounds.max[a] - mBounds.min[a]);
        ProbeResult result = estimator.irradiance(p, mNormals, key, workspaces.local());
        if (result.validity < kValidThreshold) return; // inside geometry
        found[i] = {p, std::move(result.value), std::move(result.stderr_)};
    });
    if (stop) throw Error(ErrorCode::Interrupted, "Interrupted: nothing was written.");
    for (Point& point : found)
        if (!point.irradiance.empty()) mPoints.push_back(std::move(point));
}

double BenchReference::queryNs(const VolumeSampler& sampler) const
{
    std::vector<Vec3d> positions(kTimedQueries);
    std::vector<Vec3f> normals(kTimedQueries);
    CounterRng rng(mSeed + 1);
    for (std::size_t i = 0; i < kTimedQueries; ++i) {
        for (int a = 0; a < 3; ++a)
            positions[i][a] = mBounds.min[a] + rng.nextDouble() * (mBounds.max[a] - mBounds.min[a]);
        normals[i] = mNormals[i % mNormals.size()];
    }
    std::vector<Color> E(kTimedQueries);
    double best = 1e300;
    for (int run = 0; run < 3; ++run) {
        const Stopwatch watch;
        sampler.irradiance(kTimedQueries, positions.data(), normals.data(), E.data());
        best = std::min(best, watch.seconds());
    }
    return best * 1e9 / static_cast<double>(kTimedQueries);
}

void BenchReference::measure(const IrradianceVolume& volume, BenchRow& row) const
{
    const VolumeSampler sampler(volume, row.mode);
    Vec3d mean(0), square(0), noise(0);
    std::vector<double> absolute[3];
    for (const Point& point : mPoints) {
        for (std::size_t k = 0; k < mNormals.size(); ++k) {
            const Vec3d reference(point.irradiance[k]), error(point.error[k]);
            const Vec3d difference
                = Vec3d(sampler.irradiance(point.position, mNormals[k])) - reference;
            mean += reference;
            for (int c = 0; c < 3; ++c) {
                square[c] += difference[c] * difference[c];
                noise[c] += error[c] * error[c];
                absolute[c].push_back(std::abs(difference[c]));
            }
        }
    }
    if (!std::isfinite(square.x + square.y + square.z))
        throw Error(ErrorCode::Input,
            "The light of '" + row.scene + "' is not a finite number somewhere; check its lights.");
    row.queryNs = queryNs(sampler);
    row.bytes = sampler.memoryBytes();
    const double n = static_cast<double>(mPoints.size() * mNormals.size());
    for (int c = 0; c < 3; ++c) {
        if (!(mean[c] > 0)) continue; // a colour that the scene has not
        const double scale = n / mean[c];
        row.relRmse = std::max(row.relRmse, std::sqrt(square[c] / n) * scale);
        row.referenceStderr = std::max(row.referenceStderr, std::sqrt(noise[c] / n) * scale);
        std::sort(absolute[c].begin(), absolute[c].end());
        const auto percentile = [&](double share) {
            return absolute[c][static_cast<std::size_t>(std::ceil(share * n) - 1)] * scale;
        };
        row.p50 = std::max(row.p50, percentile(0.50));
        row.p95 = std::max(row.p95, percentile(0.95));
        row.p99 = std::max(row.p99, percentile(0.99));
    }
}

} // namespace lumivdb::cli
