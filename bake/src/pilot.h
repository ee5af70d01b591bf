// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file pilot.h
/// A first look at a scene's light: a few probes at random places, before the bake decides.

#include <lumivdb/bake/probe.h>
#include <lumivdb/core/sh.h>

#include <array>

namespace lumivdb {

struct Pilot {
    std::size_t points = 0; ///< in free space
    Vec3d meanE{0, 0, 0}; ///< irradiance, mean over points and normals
    /// [B]: RMS of the irradiance that B bands leave out, over the mean, worst channel.
    std::array<double, kMaxBands + 1> truncation{};
    /// RMS standard error of irradiance with one ray / mean; with N rays it is 1/√N of that.
    double noisePerRay = 0;
    /// Mean over points of each one's own, at most as much.
    double meanNoisePerRay = 0;
    std::uint64_t rays = 0;
    double secondsPerDirection = 0; ///< of all threads together
};

/// Probes at up to @a count free places of @a box. The same box, count and options give the same
/// result.
Pilot lookAhead(const Tracer& tracer, const ProbeOptions& probe, const Box3d& box,
    std::size_t count, Progress& progress);

} // namespace lumivdb
