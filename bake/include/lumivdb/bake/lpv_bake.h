// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file lpv_bake.h
/// From a scene to a volume by light propagation: a preview of a bake's indirect light, in a
/// fraction of its time and with an error that evaluateVolume() tells.
///
/// Reflective shadow maps of all lights (rsm.h) give the first reflection as surfels, the scene's
/// triangles what stands in the way (blockers.h); both go into a light propagation volume (lpv.h),
/// which is propagated until little is left. Rays then look round each sample for its validity and
/// distance, and for direct light where that is asked for: the propagation itself carries only what
/// was reflected.

#include <lumivdb/bake/lpv.h>
#include <lumivdb/bake/probe.h>

#include <optional>
#include <string>
#include <vector>

namespace lumivdb {

/// Lengths in scene units.
struct LpvBakeOptions {
    LpvOptions lpv = unspaced(); ///< spacing 0: chosen from the scene
    LpvStop stop{256, 1e-3};
    /// One: a box of cells, see `bounds`. Several: cubes of `cells` cells around `center`.
    LpvCascadeOptions cascades{1};
    std::optional<Box3d> bounds; ///< of one cascade; default: the scene's, grown by one cell
    std::optional<Vec3d> center; ///< of several; default: the middle of the scene's box
    int rsmResolution = 256; ///< see RsmOptions::resolution
    std::size_t maxSurfels = 0; ///< keeps so many by importance; 0: all
    int blockersPerFace = 16; ///< see BlockerOptions::perFace
    Contribution contribution = Contribution::Indirect; ///< or All
    /// Directions per sample, for validity, distance and direct light; 0: samples are not looked
    /// at, all are valid (indirect light only).
    int rays = 64;
    bool visibility = true; ///< masks as in a bake; needs rays
    std::uint64_t seed = 1;
    std::string lightGroup, commandLine; ///< stored in the metadata
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;

    static LpvOptions unspaced();
};

struct LpvBakeReport {
    std::uint64_t samples = 0;
    std::vector<std::uint64_t> cellsByLevel;
    std::uint64_t surfels = 0; ///< injected
    std::uint64_t surfelsOutside = 0; ///< of them, not in the volume: their light is not in it
    std::uint64_t blockers = 0;
    std::uint64_t rays = 0; ///< of the maps and round the samples
    LpvReport propagation;
    std::size_t cutCells = 0; ///< with visibility masks
    double spacing = 0; ///< the one used
    double secondsRsm = 0, secondsInject = 0, secondsPropagate = 0, secondsSamples = 0;
    std::vector<std::string> decisions; ///< what was chosen where nothing was given, and why
    std::vector<std::string> warnings;
};

struct LpvBakeResult {
    IrradianceVolume volume;
    LpvBakeReport report;
};

/// Two bands on the lattice that bakes use. Same inputs, same bits, for any thread count.
/// @throws Error(Usage) for bad options; Error(Interrupted).
LpvBakeResult bakeLpv(
    const Tracer& tracer, const LpvBakeOptions& options, Progress* progress = nullptr);

} // namespace lumivdb
