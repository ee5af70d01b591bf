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
    double shadowShare = 0; ///< of the rays
    double probeSeconds = 0; ///< radianceSh() at all points: tracing, shading, projection
    double intersect1Seconds = 0; ///< the same rays, each by rtcIntersect1, nothing else
    double mixedSeconds = 0; ///< the same, shadow rays by rtcOccluded1
    double relativeStderr = 0; ///< of E averaged over normals, mean over points
};

/// One thread; the fastest of @a repeats for each, taken in turn.
RayBenchmark benchmarkRays(const Tracer& tracer, const ProbeOptions& options, int bands,
    const std::vector<Vec3d>& points, int repeats);

} // namespace lumivdb
