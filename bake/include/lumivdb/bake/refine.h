// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file refine.h
/// Where a bake puts its cells: options of adaptive refinement.
///
/// A volume with K levels begins with cells of 2^K spacings. A cell is split in eight where one of
/// the chosen heuristics asks for it. Afterwards the octree is balanced 2:1 across faces, edges and
/// corners, and eight children whose parent would have interpolated the same are merged again.

#include <string>
#include <vector>

namespace lumivdb {

enum class RefineHeuristic {
    /// Hierarchical surplus: the sample at the cell's centre (and on its faces, where geometry cuts
    /// the cell) minus what the corners interpolate there, as irradiance averaged over normals:
    /// ‖Δ‖² = Σ A_l² |ΔL_lm|² / 4π, less what the samples' own noise explains. In relation to the
    /// mean irradiance of the volume. The threshold counts for the coarsest cells; a cell of half
    /// the width holds an eighth of the space and may be 2^1.5 times as wrong: all cells then add
    /// alike to the mean squared error.
    Error,
    Gradient, ///< change of irradiance across the cell / mean irradiance of the volume (seed 000)
    Geometry, ///< the cell contains geometry (seed 000); the threshold is the level to go down to
    Harmonic, ///< harmonic mean distance at a corner < threshold · cell width (seed 000)
    Brute ///< everything is split; the merge afterwards decides with this threshold (seed 000)
};

const char* name(RefineHeuristic heuristic);

struct RefineOptions {
    /// A cell is split where any of them asks for it.
    std::vector<RefineHeuristic> heuristics = {RefineHeuristic::Error};
    double error = 0.05;
    double gradient = 0.5;
    int geometry = 0;
    double harmonic = 1.0;
    double brute = 0.05;
    /// Eight children are merged where the parent's interpolation is off by less than this, in the
    /// measure of RefineHeuristic::Error; < 0: a quarter of the error threshold with that
    /// heuristic, brute's threshold with that, else 0 (nothing is merged).
    double cull = -1;
    /// Cells that contain geometry are split down to this level whatever the heuristics say; −1:
    /// one level below the coarsest.
    int geometryLevel = -1;

    bool uses(RefineHeuristic heuristic) const;
    double cullThreshold() const;
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

} // namespace lumivdb
