// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file blockers.h
/// A scene's surfaces as pieces that stand in light's way: what the geometry volume of a light
/// propagation volume is made of.

#include <lumivdb/bake/lpv.h>
#include <lumivdb/bake/tracer.h>

#include <cstdint>
#include <optional>
#include <vector>

namespace lumivdb {

struct BlockerOptions {
    double spacing = 1; ///< of the cells that they are for, world units
    int perFace = 16; ///< blockers on an area of spacing², 1 … 4096
    std::optional<Box3d> region; ///< world box; only what is inside comes back. Default: all
    std::uint64_t seed = 1;
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

/// Points spread evenly over the triangles' area, systematically, each with its equal share of it.
/// Masked texels leave out what they cut. A single-sided surface is black from behind. The same
/// scene, options and seed give the same bits for any number of threads.
/// @throws Error(Usage) where the spacing asks for more than 2^27 of them; Error(Interrupted).
std::vector<Blocker> surfaceBlockers(
    const Tracer& tracer, const BlockerOptions& options, Progress* progress = nullptr);

} // namespace lumivdb
