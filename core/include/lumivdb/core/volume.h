// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file volume.h
/// The irradiance volume in memory: one sparse topology, many channels.
///
/// The topology is an octree over a lattice. The finest cells are one lattice step wide; a cell of
/// level k spans 2^k steps and begins at a multiple of 2^k. Samples lie at cell corners, so a
/// uniform volume of nx×ny×nz cells has (nx+1)(ny+1)(nz+1) samples. An `openvdb::Int32Grid` maps
/// every lattice voxel to the id of the cell that covers it; cells of 8³ and larger are tiles of
/// that tree by themselves.
///
/// @code
///   VolumeBuilder builder(3, GradientStorage::None, indexToWorld);
///   builder.addUniform({0,0,0}, {16,16,16});          // 16³ cells, 17³ samples
///   IrradianceVolume volume = builder.build();
///   for (SampleId s = 0; s < volume.sampleCount(); ++s)
///       fill(volume.samplePosition(s), volume.radiance(s));
/// @endcode

#include <lumivdb/core/sh.h>
#include <lumivdb/core/types.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace lumivdb {

using SampleId = std::uint32_t;
using CellId = std::int32_t;

constexpr CellId kNoCell = -1;
/// Coarsest level: a cell of 2^12 steps is the root's child of OpenVDB's 5-4-3 tree.
constexpr int kMaxLevel = 12;
/// Finest spacing: OpenVDB takes a transform of determinant below 3e-15 (1.44e-5 cubed) for a
/// singular one.
constexpr double kMinSpacing = 2e-5;
/// Corners of cells lie within ±kMaxLattice on every axis.
constexpr int kMaxLattice = 1 << 30;
/// Samples whose validity (share of rays that did not meet a back face) is lower do not contribute
/// to interpolation.
constexpr float kValidThreshold = 0.5f;

struct Cell {
    Coord origin; ///< lattice position of its lower corner, a multiple of 2^level
    std::int32_t level;
    /// Samples at origin + 2^level · (i&1, i>>1&1, i>>2&1), i = 0 … 7.
    SampleId corners[8];
};

/// Who sees whom in a cell that geometry cuts. Three planes divide the cell into eight regions;
/// each region has a mask of the corners that are seen from it. Where no wall suggests better ones
/// the planes are the cell's three middle planes, and the regions its octants; a plane laid into a
/// wall keeps what is before the wall from what is behind it exactly, however the wall lies in the
/// cell.
///
/// Positions are cell coordinates t ∈ [0,1]³ along the lattice's axes, so a rotated volume keeps
/// its masks. The same planes and masks in every cell of a wall keep interpolation continuous
/// along the wall.
struct CellVisibility {
    /// Unit normals; a plane is normal · (t − ½) = offset.
    Vec3f normal[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    float offset[3] = {0, 0, 0};
    /// Byte r: corners that region r sees, bit i for corner i.
    std::uint64_t masks = ~std::uint64_t{0};

    /// Region of @a t: bit k set on the plane k or on the side its normal points to.
    int region(const Vec3f& t) const
    {
        const Vec3f c = t - Vec3f(0.5f);
        int r = 0;
        for (int k = 0; k < 3; ++k) r |= normal[k].dot(c) >= offset[k] ? 1 << k : 0;
        return r;
    }
    /// Mask of the corners seen from @a t.
    std::uint8_t corners(const Vec3f& t) const
    {
        return static_cast<std::uint8_t>(masks >> (8 * region(t)));
    }
    bool operator==(const CellVisibility& o) const
    {
        for (int k = 0; k < 3; ++k)
            if (normal[k] != o.normal[k] || offset[k] != o.offset[k]) return false;
        return masks == o.masks;
    }
};

enum class GradientStorage { None, PerCoefficient };

/// What a volume is of and how it came to be; travels with the file on every grid.
struct VolumeMetadata {
    std::string contribution = "all"; ///< all | direct | indirect
    std::string lightGroup; ///< empty: all lights
    std::string upAxis = "y"; ///< y | z
    double errorAsked = 0.0; ///< relative RMS asked for; 0: none
    double errorReached
        = -1.0; ///< relative RMS measured on points the bake never used; −1: not measured
    double errorConfidence = 0.0; ///< confidence of errorReached, 0 … 1
    std::uint64_t seed = 0;
    std::uint64_t raysPerSample = 0;
    std::string integrator = "path"; ///< path | cached | "" where volumes of both were combined
    /// Of a cached one: relative RMS bias of its light, and what it is at most with a confidence of
    /// 95%; −1: not measured.
    double cacheBias = -1.0, cacheBiasUpper = -1.0;
    std::string options; ///< the command line that reproduces it
    std::string sceneHash; ///< content hash of scene and environment, hex
    /// What was asked for, where cells reach beyond it; see IrradianceVolume::latticeBounds().
    std::optional<LatticeBox> bounds;
};

/// Samples, cells and the records of one volume. Moves, does not copy implicitly: see clone().
/// Reading is safe from many threads; writing distinct samples is too.
class IrradianceVolume {
public:
    IrradianceVolume(IrradianceVolume&&) noexcept;
    IrradianceVolume& operator=(IrradianceVolume&&) noexcept;
    ~IrradianceVolume();
    IrradianceVolume clone() const;
    /// The same topology, lattice, offsets, visibility, blocking and metadata with another record
    /// shape, all values zero, validity 1.
    IrradianceVolume cloneTopology(int bands, GradientStorage gradients) const;

    int bands() const;
    int coefficients() const { return coefficientCount(bands()); }
    bool hasGradients() const;

    /// Lattice → world: rotation, uniform scale (the spacing) and translation; row vectors.
    const Mat4d& indexToWorld() const;
    const Mat4d& worldToIndex() const;
    /// Distance between lattice points, world units.
    double spacing() const;
    /// Replaces the lattice-to-world transform. @throws Error(Usage), and keeps the old one, when
    /// it is not a similarity with positive determinant and scale ≥ kMinSpacing. Coefficients are
    /// not touched: see transformVolume() in vdb_io.
    void setIndexToWorld(const Mat4d& m);

    std::size_t sampleCount() const;
    std::size_t cellCount() const;
    /// Number of cells of each level, [0] the finest; size = coarsest level present + 1.
    std::vector<std::size_t> cellsByLevel() const;
    const Cell& cell(CellId id) const;

    /// Lattice position of a sample. Samples are sorted by (x, y, z) of their lattice position.
    const Coord& samplePosition(SampleId s) const;
    /// World position: samplePosition · indexToWorld.
    Vec3d sampleWorld(SampleId s) const;
    /// Sample at lattice point @a p, or −1 where there is none. O(log n).
    std::int64_t findSample(const Coord& p) const;
    /// Cell that covers lattice voxel @a p, or kNoCell. O(1).
    CellId findCell(const Coord& p) const;
    /// Corner samples' lattice bounds, inclusive on both ends.
    Coord minLattice() const;
    Coord maxLattice() const;
    /// World box around all samples.
    Box3d worldBounds() const;
    /// The region the volume is meant for: metadata().bounds, else from minLattice() to
    /// maxLattice(). Coarse cells of an adaptive volume may reach beyond it; errors are stated for
    /// what is inside.
    LatticeBox latticeBounds() const;

    /// Radiance coefficients of a sample: bands² colours, one contiguous record.
    Color* radiance(SampleId s);
    const Color* radiance(SampleId s) const;
    /// Derivatives per world unit along world x, y, z: 3·bands² colours, [axis·bands² +
    /// coefficient]. Null when there are none.
    Color* gradient(SampleId s);
    const Color* gradient(SampleId s) const;
    /// Share of rays that did not meet a back face, 0 … 1.
    float& validity(SampleId s);
    float validity(SampleId s) const;
    /// Harmonic mean of the distance to what the rays met, world units; +inf where all escaped.
    float& distance(SampleId s);
    float distance(SampleId s) const;
    bool isValid(SampleId s) const { return validity(s) >= kValidThreshold; }

    /// Where a sample was measured, relative to sampleWorld(), world units: samples inside geometry
    /// or on a surface are moved off it. Zero for almost all. Gradients count from there.
    bool hasOffsets() const;
    Vec3f offset(SampleId s) const;
    /// One per sample, or none at all. @throws Error(Usage) for another count.
    void setOffsets(std::vector<Vec3f> offsets);
    /// sampleWorld() + offset().
    Vec3d measuredWorld(SampleId s) const { return sampleWorld(s) + Vec3d(offset(s)); }

    /// Visibility inside cells that geometry cuts; null: every place in the cell sees every corner.
    bool hasVisibility() const;
    const CellVisibility* visibility(CellId id) const;
    /// Replaces all of it. Each cell at most once, in any order.
    void setVisibility(const std::vector<std::pair<CellId, CellVisibility>>& cut);

    /// The geometry volume of propagated light; queries do not use it. Share of the cell's cross
    /// section that surfaces in it cover, seen along the lattice's x, y and z: Σ area · |n| /
    /// width², more than 1 where they lie behind each other.
    bool hasBlocking() const;
    Vec3f blocking(CellId id) const; ///< 0 where there is none
    /// One per cell, or none at all. @throws Error(Usage) for another count.
    void setBlocking(std::vector<Vec3f> blocking);

    VolumeMetadata& metadata();
    const VolumeMetadata& metadata() const;

    /// Bytes held: records, positions, cells and the index tree.
    std::size_t memoryBytes() const;

    struct Impl;
    /// For vdb_io and tests: the index tree lives in volume_grid.h's accessor.
    const Impl& impl() const { return *mImpl; }

private:
    friend class VolumeBuilder;
    explicit IrradianceVolume(std::unique_ptr<Impl> impl);
    std::unique_ptr<Impl> mImpl;
};

/// Collects cells and makes the volume: samples are the union of the cells' corners.
class VolumeBuilder {
public:
    /// @a indexToWorld a similarity with positive determinant, its scale the spacing.
    VolumeBuilder(int bands, GradientStorage gradients, const Mat4d& indexToWorld);
    /// A cell; @a origin must be a multiple of 2^level, 0 ≤ level ≤ kMaxLevel.
    /// @throws Error(Usage) where it is not, or where the cell leaves ±kMaxLattice.
    void addCell(const Coord& origin, int level);
    /// All level-0 cells with lower ≤ origin < upper.
    void addUniform(const Coord& lower, const Coord& upper);
    /// @throws Error(Usage) for: no cell at all, overlapping cells, a misaligned origin, a level
    /// jump of more than one across a face, edge or corner, or more than 2³¹ samples.
    IrradianceVolume build();

private:
    int mBands;
    GradientStorage mGradients;
    Mat4d mIndexToWorld;
    std::vector<Cell> mCells;
};

/// Similarity with scale @a spacing and no rotation, lattice point 0 at the world origin:
/// the lattice every bake uses, so that separate bakes of one scene share their samples.
Mat4d latticeTransform(double spacing);

} // namespace lumivdb
