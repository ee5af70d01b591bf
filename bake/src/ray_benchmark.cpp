// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/ray_benchmark.h>

#include <lumivdb/core/random.h>

#include "directions.h"
#include "path.h"

#include <algorithm>
#include <chrono>
#include <limits>
#include <memory>

namespace lumivdb {

namespace {

template <class Work> double secondsOf(const Work& work)
{
    const auto start = std::chrono::steady_clock::now();
    work();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

std::vector<RecordedRay> recordRays(
    const Tracer::Impl& impl, const ProbeOptions& options, const std::vector<Vec3d>& points)
{
    const std::vector<Vec3f> directions = stratifiedDirections(options.seed, options.rays);
    auto paths = std::make_unique<PathTracer>(impl, options);
    auto batch = std::make_unique<PathBatchResult>();
    std::vector<RecordedRay> rays;
    paths->record(&rays);
    for (std::size_t p = 0; p < points.size(); ++p) {
        const std::uint64_t key = hashPoint(options.seed, static_cast<int>(p), 0, 0);
        for (std::size_t i = 0; i < directions.size(); i += kBatch) {
            const auto n = static_cast<int>(std::min<std::size_t>(kBatch, directions.size() - i));
            paths->trace(impl.toLocal(points[p]), directions.data() + i, i, n, key, *batch);
        }
    }
    return rays;
}

/// Returns the number of hits, so that no compiler can drop the loop.
std::uint64_t traceBare(const Tracer::Impl& impl, const std::vector<RecordedRay>& rays, bool mixed)
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

} // namespace

RayBenchmark benchmarkRays(const Tracer& tracer, const ProbeOptions& options, int bands,
    const std::vector<Vec3d>& points, int repeats)
{
    const Tracer::Impl& impl = tracer.impl();
    const ProbeEstimator estimator(tracer, options);
    const std::vector<RecordedRay> rays = recordRays(impl, options, points);
    RayBenchmark b;
    b.rays = rays.size();
    b.shadowShare = static_cast<double>(std::count_if(
                        rays.begin(), rays.end(), [](const RecordedRay& r) { return r.shadow; }))
        / std::max<double>(1.0, static_cast<double>(rays.size()));
    b.probeSeconds = b.intersect1Seconds = b.mixedSeconds = std::numeric_limits<double>::infinity();
    ProbeEstimator::Workspace workspace;
    volatile std::uint64_t sink = 0;
    for (int r = 0; r < repeats; ++r) {
        double error = 0, mean = 0;
        b.probeSeconds = std::min(b.probeSeconds, secondsOf([&] {
            for (std::size_t p = 0; p < points.size(); ++p) {
                const ProbeResult result = estimator.radianceSh(points[p], bands,
                    hashPoint(options.seed, static_cast<int>(p), 0, 0), workspace);
                error += luminance(result.stderr_[0]);
                mean += luminance(result.value[0]);
            }
        }));
        b.relativeStderr = mean > 0 ? error / mean : 0;
        b.intersect1Seconds = std::min(
            b.intersect1Seconds, secondsOf([&] { sink = sink + traceBare(impl, rays, false); }));
        b.mixedSeconds = std::min(
            b.mixedSeconds, secondsOf([&] { sink = sink + traceBare(impl, rays, true); }));
    }
    return b;
}

} // namespace lumivdb
