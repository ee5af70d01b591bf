// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file visibility.h
/// Keeping light on its side of a wall: which corners the places in a cell see, samples moved out
/// of solids, and values for those that stay inside.

#include <lumivdb/bake/tracer.h>
#include <lumivdb/core/progress.h>
#include <lumivdb/core/volume.h>
#include <lumivdb/core/volume_fill.h>

#include <cstdint>
#include <optional>

namespace lumivdb {

struct VisibilityReport {
    std::size_t touchedCells = 0; ///< that geometry touches
    std::size_t cutCells = 0; ///< of them, where some place does not see some valid corner
    std::uint64_t rays = 0;
};

/// Finds the CellVisibility of every cell that geometry touches (grown by 1e-3 of the spacing) and
/// replaces the volume's. To be called once samples are measured: it takes their measured places
/// and leaves invalid ones out (their bits are 0).
///
/// In each cell, 64 fixed places and up to 32 pairs just before and behind its surfaces look at the
/// corners. The planes of the surfaces and the cell's middle planes are candidates; as in a
/// decision tree the three are taken that leave the fewest places at odds with the majority of
/// their region, which is the region's mask. Places inside solids (that see no valid corner, and
/// back faces mostly) do not count. Same bits for any number of threads.
/// @throws Error(Interrupted), the volume unchanged.
VisibilityReport computeVisibility(
    IrradianceVolume& volume, const Tracer& tracer, int threads = 0, Progress* progress = nullptr);

/// Which of eight places @a corners (world) are seen from @a point (world): bit i for corner i.
std::uint8_t cornersSeen(const Tracer& tracer, const Vec3d& point, const Vec3d (&corners)[8]);

/// A place for a sample at @a p inside a solid: the nearest one found that lies @a clearance before
/// the front of a surface, no more than @a maxDistance (world units) from @a p, and sees no more
/// back faces than a valid sample may. None where there is no such place.
std::optional<Vec3d> relocated(
    const Tracer& tracer, const Vec3d& p, double maxDistance, double clearance);

} // namespace lumivdb
