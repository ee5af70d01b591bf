// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file sampler.h
/// Answers from a volume: what light arrives at any point, for any normal.
///
/// @code
///   VolumeSampler sampler(volume);                     // compiles a flat look-up table, O(cells)
///   Color E = sampler.irradiance(position, normal);    // irradiance on a surface there
/// @endcode
///
/// The compiled form is read-only, allocation-free when queried, and shared by all threads. It
/// refers to the volume's records: the volume must outlive it and keep its topology.

#include <lumivdb/core/volume.h>

#include <cstdint>
#include <memory>
#include <vector>

namespace lumivdb {

/// How samples are combined.
enum class Interpolation {
    Nearest, ///< the nearest valid corner of the cell
    Taylor, ///< the nearest valid corner, moved by its gradient: I + ∇I·d (seed 000)
    Trilinear, ///< the eight corners, weights renormalised over valid ones
    Gradient, ///< Taylor at each corner first, then trilinear (seed 000)
    InverseDistance, ///< corners weighted by 1/distance (seed 000), exact at a corner
};

const char* name(Interpolation mode);
bool needsGradients(Interpolation mode);

/// What a query found besides its value.
struct QueryInfo {
    int level = -1; ///< level of the cell that answered; −1: outside the volume
    float validity = 0; ///< interpolated validity of the corners, 0 … 1
};

class VolumeSampler {
public:
    /// @throws Error(Usage) when @a mode needs gradients and @a volume has none.
    explicit VolumeSampler(
        const IrradianceVolume& volume, Interpolation mode = Interpolation::Trilinear);
    ~VolumeSampler();

    Interpolation mode() const { return mMode; }
    /// The best mode the volume supports: Gradient with gradients, else Trilinear.
    static Interpolation bestMode(const IrradianceVolume& volume);

    /// Radiance coefficients at world position @a p → @a L[bands²].
    /// Outside the volume (info.level = −1) L is NaN. Points on the outer faces are inside.
    /// Where no corner is valid, all corners are used and info.validity tells.
    QueryInfo radiance(const Vec3d& p, Color* L) const;

    /// Irradiance at @a p for unit normal @a n, in the volume's units times steradian.
    /// NaN outside the volume.
    Color irradiance(const Vec3d& p, const Vec3f& n, QueryInfo* info = nullptr) const;

    /// @a count queries at once: E[i] for p[i], n[i]; @a info may be null. Same values as the
    /// single calls, bit for bit.
    void irradiance(std::size_t count, const Vec3d* p, const Vec3f* n, Color* E,
        QueryInfo* info = nullptr) const;

    /// Bytes of the compiled table (the volume's records not included).
    std::size_t memoryBytes() const;

private:
    struct Corners; // the ≤ 8 samples of a query with their weights
    QueryInfo locate(const Vec3d& p, Corners& corners) const;
    CellId findCell(const Coord& voxel) const;

    const IrradianceVolume& mVolume;
    Interpolation mMode;
    // Two-level table over 8³ blocks: negative = −2−cell for a block inside one cell (or −1 for
    // none), else offset of 512 cell ids in mCells.
    Coord mBlockMin, mBlockDim;
    std::vector<std::int32_t> mBlocks;
    std::vector<CellId> mCells;
};

} // namespace lumivdb
