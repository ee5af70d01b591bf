// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file ray_benchmark.h
/// The probe stage against Embree alone, on the rays the probe stage really traces.

#include <lumivdb/bake/probe.h>

#include <cstdint>
#include <vector>

namespace lumivdb {

struct RayBenchmark {
    std::uint64_t rays = 0; ///< of all points, shadow rays included
    std::uint64_t paths = 0; ///< of all points
    double shadowShare = 0; ///< of the rays
    double relativeStderr = 0; ///< of E averaged over normals, mean over points
    /// Processor time counts all threads and leaves out what other programs take.
    struct Time {
        double wall, processor; ///< seconds
    };
    /// Fastest of each, on one thread and on as many as were asked for.
    struct Times {
        Time probe; ///< radianceSh() at all points: tracing, shading, projection
        Time intersect1; ///< the same rays, each by rtcIntersect1, nothing else
        Time mixed; ///< the same, shadow rays by rtcOccluded1
    } one, several;
};

/// The fastest of @a repeats for each, taken in turn. Threads take whole points in all three.
RayBenchmark benchmarkRays(const Tracer& tracer, const ProbeOptions& options, int bands,
    const std::vector<Vec3d>& points, int repeats, int threads);

} // namespace lumivdb
