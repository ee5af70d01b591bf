// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/bake.h>
#include <lumivdb/bake/radiance_cache.h>

#include "own_estimator.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/core/volume.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <memory>

namespace lumivdb {

namespace {

constexpr int kNormals = 32;
/// Places tried for one in free space.
constexpr std::size_t kTries = 8;
/// Separates these places and rays from those of bakes, pilots and evaluations.
constexpr std::uint64_t kBiasStream = 0x7b1d93c45e0fa268ull;
/// Normal quantile of a one-sided confidence of 95%.
constexpr double kConfident = 1.645;

/// Irradiance of one place for all normals, twice by each integrator.
struct Pair {
    bool free = false;
    std::vector<Color> path[2], cached[2];
    std::uint64_t rays = 0;
};

class BiasMeter {
public:
    BiasMeter(const Tracer& tracer, const ProbeOptions& probe, const CacheBiasOptions& options)
        : mNormals(uniformNormals(kNormals))
    {
        for (int half = 0; half < 2; ++half) {
            ProbeOptions o = probe;
            o.seed
                = hashCombine(mixBits(probe.seed ^ kBiasStream), static_cast<std::uint64_t>(half));
            o.rays = options.cachedRays;
            mCached[half] = std::make_unique<OwnEstimator>(tracer, o);
            o.cache = nullptr;
            o.rays = options.pathRays;
            mPath[half] = std::make_unique<OwnEstimator>(tracer, o);
        }
    }

    Pair measure(const Vec3d& p, std::uint64_t key)
    {
        Pair pair;
        for (int half = 0; half < 2; ++half) {
            // Random numbers in common would hide noise.
            const auto own = [&](std::uint64_t i) { return hashCombine(key, i); };
            const auto h = static_cast<std::uint64_t>(half);
            ProbeResult r = mCached[half]->irradiance(p, mNormals, own(h));
            pair.free = r.validity >= kValidThreshold;
            pair.rays += r.rays;
            if (!pair.free) return pair;
            pair.cached[half] = std::move(r.value);
            r = mPath[half]->irradiance(p, mNormals, own(h + 2));
            pair.rays += r.rays;
            pair.path[half] = std::move(r.value);
        }
        return pair;
    }

private:
    std::vector<Vec3f> mNormals;
    std::unique_ptr<OwnEstimator> mPath[2], mCached[2];
};

/// Of one channel: squares and sums of differences, by point.
CacheBias channelBias(const std::vector<Pair>& pairs, int pathRays, int c)
{
    std::vector<double> square, difference;
    double mean = 0, noise = 0;
    for (const Pair& pair : pairs) {
        double q = 0, d = 0;
        for (std::size_t n = 0; n < kNormals; ++n) {
            const auto value = [&](const std::vector<Color>* halves, double sign) {
                return (static_cast<double>(halves[0][n][c])
                           + sign * static_cast<double>(halves[1][n][c]))
                    / 2;
            };
            const double p = value(pair.path, 1), pNoise = value(pair.path, -1);
            const double k = value(pair.cached, 1), kNoise = value(pair.cached, -1);
            q += ((k - p) * (k - p) - pNoise * pNoise - kNoise * kNoise) / kNormals;
            d += (k - p) / kNormals;
            mean += p / kNormals;
            noise += pNoise * pNoise / kNormals;
        }
        square.push_back(q);
        difference.push_back(d);
    }
    CacheBias bias;
    const auto count = static_cast<double>(pairs.size());
    mean /= count;
    if (!(mean > 0)) return bias;
    const auto moments = [count](const std::vector<double>& values) {
        double sum = 0, squares = 0;
        for (const double v : values) sum += v;
        for (const double v : values) squares += (v - sum / count) * (v - sum / count);
        return std::pair(sum / count, std::sqrt(squares / count / std::max(1.0, count - 1)));
    };
    const auto [q, qError] = moments(square);
    const auto [d, dError] = moments(difference);
    bias.rms = std::sqrt(std::max(0.0, q)) / mean;
    bias.upper = std::sqrt(std::max(0.0, q + kConfident * qError)) / mean;
    bias.mean = d / mean;
    bias.meanStderr = dError / mean;
    // The halves together have twice the rays.
    bias.pathNoise = std::sqrt(noise / count * 2 * pathRays) / mean;
    return bias;
}

} // namespace

CacheBias measureCacheBias(const Tracer& tracer, const ProbeOptions& probe, const Box3d& box,
    const CacheBiasOptions& options, Progress& progress)
{
    progress.begin("measure the cache's bias", options.points);
    BiasMeter meter(tracer, probe, options);
    std::vector<Pair> pairs(options.points);
    std::atomic<std::uint64_t> rays{0};
    std::atomic<bool> stop{false};
    tbb::parallel_for(std::size_t{0}, pairs.size(), [&](std::size_t i) {
        for (std::size_t t = 0; t < kTries && !pairs[i].free && !stop; ++t) {
            const std::uint64_t key
                = hashCombine(mixBits(probe.seed ^ kBiasStream), i * kTries + t);
            CounterRng rng(key);
            Vec3d p;
            for (int a = 0; a < 3; ++a) {
                p[a] = box.min[a] + rng.nextDouble() * (box.max[a] - box.min[a]);
            }
            pairs[i] = meter.measure(p, key);
            rays += pairs[i].rays;
            if (progress.cancelled()) stop = true;
        }
        progress.advance(1);
    });
    if (stop) throw Error(ErrorCode::Interrupted, "The bake was interrupted; nothing was written.");
    pairs.erase(
        std::remove_if(pairs.begin(), pairs.end(), [](const Pair& pair) { return !pair.free; }),
        pairs.end());
    CacheBias worst;
    double noise = 0;
    for (int c = 0; c < 3 && !pairs.empty(); ++c) {
        const CacheBias bias = channelBias(pairs, options.pathRays, c);
        noise = std::max(noise, bias.pathNoise);
        if (c == 0 || bias.upper > worst.upper) worst = bias;
    }
    worst.pathNoise = noise;
    worst.points = pairs.size();
    worst.rays = rays;
    return worst;
}

} // namespace lumivdb
