// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/ray_benchmark.h>

#include <lumivdb/core/random.h>

#include "directions.h"
#include "path.h"
#include "threads.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <ctime>
#include <limits>
#include <memory>

namespace lumivdb {

namespace {

using Rays = std::vector<RecordedRay>;

/// What each point's probe traces.
std::vector<Rays> recordRays(
    const Tracer::Impl& impl, const ProbeOptions& options, const std::vector<Vec3d>& points)
{
    auto paths = std::make_unique<PathTracer>(impl, options);
    auto batch = std::make_unique<PathBatchResult>();
    std::vector<Rays> rays(points.size());
    for (std::size_t p = 0; p < points.size(); ++p) {
        const std::uint64_t key = hashPoint(options.seed, static_cast<int>(p), 0, 0);
        const SamplingPattern pattern(options.seed, key, options.rays);
        const std::vector<Vec3f> directions = stratifiedDirections(pattern.seed, options.rays);
        const std::vector<ProbeStrata> strata
            = probeStrata(impl, options, pattern.seed, directions);
        paths->record(&rays[p]);
        for (std::size_t i = 0; i < directions.size(); i += kBatch) {
            const auto n = static_cast<int>(std::min<std::size_t>(kBatch, directions.size() - i));
            paths->trace(impl.toLocal(points[p]), directions.data() + i, strata[i / kBatch], i, n,
                key, *batch);
        }
    }
    return rays;
}

/// Returns the number of hits, so that no compiler can drop the loop.
std::uint64_t traceBare(const Tracer::Impl& impl, const Rays& rays, bool mixed)
{
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    std::uint64_t hits = 0;
    for (const RecordedRay& r : rays) {
        RTCRayHit h;
        h.ray = {r.origin.x, r.origin.y, r.origin.z, 0, r.direction.x, r.direction.y, r.direction.z,
            0, r.tfar, ~0u, 0, 0};
        h.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        h.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        if (mixed && r.shadow) {
            rtcOccluded1(impl.embree, &context, &h.ray);
            hits += h.ray.tfar < 0;
        } else {
            rtcIntersect1(impl.embree, &context, &h);
            hits += h.hit.geomID != RTC_INVALID_GEOMETRY_ID;
        }
    }
    return hits;
}

class Benchmark {
public:
    Benchmark(const Tracer& tracer, const ProbeOptions& options, int bands,
        const std::vector<Vec3d>& points)
        : mImpl(tracer.impl())
        , mEstimator(tracer, options)
        , mBands(bands)
        , mSeed(options.seed)
        , mPoints(points)
        , mRays(recordRays(mImpl, options, points))
        , mResults(points.size())
    {
    }

    const std::vector<Rays>& rays() const { return mRays; }
    const std::vector<ProbeResult>& results() const { return mResults; }

    /// Lowers what takes less time now.
    void run(int threads, RayBenchmark::Times& best)
    {
        const auto time = [&](RayBenchmark::Time& least, const auto& work) {
            const auto start = std::chrono::steady_clock::now();
            const std::clock_t startClock = std::clock();
            withThreads(threads, [&] { tbb::parallel_for(std::size_t{0}, mPoints.size(), work); });
            const std::clock_t ticks = std::clock() - startClock;
            const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - start;
            least.wall = std::min(least.wall, taken.count());
            least.processor
                = std::min(least.processor, static_cast<double>(ticks) / CLOCKS_PER_SEC);
        };
        time(best.probe, [&](std::size_t p) {
            mResults[p] = mEstimator.radianceSh(mPoints[p], mBands,
                hashPoint(mSeed, static_cast<int>(p), 0, 0), mWorkspaces.local());
        });
        time(best.intersect1, [&](std::size_t p) { mHits += traceBare(mImpl, mRays[p], false); });
        time(best.mixed, [&](std::size_t p) { mHits += traceBare(mImpl, mRays[p], true); });
    }

private:
    const Tracer::Impl& mImpl;
    const ProbeEstimator mEstimator;
    const int mBands;
    const std::uint64_t mSeed;
    const std::vector<Vec3d>& mPoints;
    const std::vector<Rays> mRays;
    std::vector<ProbeResult> mResults;
    tbb::enumerable_thread_specific<ProbeEstimator::Workspace> mWorkspaces;
    std::atomic<std::uint64_t> mHits{0};
};

} // namespace

RayBenchmark benchmarkRays(const Tracer& tracer, const ProbeOptions& options, int bands,
    const std::vector<Vec3d>& points, int repeats, int threads)
{
    Benchmark benchmark(tracer, options, bands, points);
    RayBenchmark b;
    std::uint64_t shadow = 0;
    for (const Rays& rays : benchmark.rays()) {
        b.rays += rays.size();
        shadow += static_cast<std::uint64_t>(
            std::count_if(rays.begin(), rays.end(), [](const RecordedRay& r) { return r.shadow; }));
    }
    b.paths = points.size() * static_cast<std::uint64_t>(options.rays);
    b.shadowShare = static_cast<double>(shadow) / std::max<double>(1, static_cast<double>(b.rays));
    constexpr double kNever = std::numeric_limits<double>::infinity();
    constexpr RayBenchmark::Time kLongest{kNever, kNever};
    b.one = b.several = {kLongest, kLongest, kLongest};
    for (int r = 0; r < repeats; ++r) {
        benchmark.run(1, b.one);
        benchmark.run(threads, b.several);
    }
    double error = 0, mean = 0;
    for (const ProbeResult& result : benchmark.results()) {
        error += luminance(result.stderr_[0]);
        mean += luminance(result.value[0]);
    }
    b.relativeStderr = mean > 0 ? error / mean : 0;
    return b;
}

} // namespace lumivdb
