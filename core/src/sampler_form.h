// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file sampler_form.h
/// The compiled form of a volume that VolumeSampler queries.
///
/// A *node* is a place with coefficients: a sample, or a ghost between samples. Its record holds
/// homogeneous coordinates: coefficients times weight, the weight itself, and the validity. Weights
/// are 1 for a valid sample and 0 for an invalid one, ghosts have those that follow. Interpolating
/// numerator and denominator alike and dividing once renormalises over the valid nodes without a
/// branch, and keeps ghosts exact: the interpolant on a face depends on the nodes of that face
/// only, whether it is split or not.

#include "volume_impl.h"

#include <lumivdb/core/sampler.h>

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <vector>

namespace lumivdb::detail {

/// A record is `blocks` blocks of `lanes` numbers: [R_1 … R_pad][G_1 …][B_1 …][R_0 G_0 B_0 weight]
/// [validity 0 0 0]. Three bands make 32 numbers, which as halves are one line of a cache. Blocks:
/// the value; its derivatives along the lattice's x, y, z, per lattice step; then (Hermite data of
/// ghosts) those along yz… in the order of kBlockAxes.
struct RecordLayout {
    int coefficients = 9;
    int pad = 8; ///< coefficients 1 … of a channel, rounded up to eight
    int lanes = 32;
    int blocks = 1;
    int scalarBytes = 4;

    RecordLayout() = default;
    RecordLayout(int bands, int blockCount, Precision precision)
        : coefficients(coefficientCount(bands))
        , pad((coefficients - 1 + 7) / 8 * 8)
        , lanes(3 * pad + 8)
        , blocks(blockCount)
        , scalarBytes(precision == Precision::Half ? 2 : 4)
    {
    }
    int lane(int coefficient, int channel) const
    {
        return coefficient == 0 ? 3 * pad + channel : channel * pad + coefficient - 1;
    }
    int weightLane() const { return 3 * pad + 3; }
    int validityLane() const { return 3 * pad + 4; }
    /// Bytes from one record to the next: whole cache lines, or a power of two below one.
    std::size_t stride() const
    {
        const std::size_t bytes = static_cast<std::size_t>(blocks) * lanes * scalarBytes;
        std::size_t s = 16;
        while (s < bytes && s < 64) s *= 2;
        return s >= bytes ? s : (bytes + 63) / 64 * 64;
    }
};

/// Derivative of each block, bit a for axis a. The first four are what samples have.
constexpr int kBlockAxes[8] = {0, 1, 2, 4, 3, 5, 6, 7};

/// Memory aligned to cache lines; large pieces to 2 MiB with huge pages asked for, since random
/// look-ups in small pages miss the TLB more often than the cache. To be freed.
void* allocateLines(std::size_t bytes);

template <class T> struct LineAllocator {
    using value_type = T;
    LineAllocator() = default;
    template <class U> LineAllocator(const LineAllocator<U>&) { }
    T* allocate(std::size_t n) { return static_cast<T*>(allocateLines(n * sizeof(T))); }
    void deallocate(T* p, std::size_t) { std::free(p); }
    bool operator==(const LineAllocator&) const { return true; }
    bool operator!=(const LineAllocator&) const { return false; }
};
template <class T> using LineVector = std::vector<T, LineAllocator<T>>;

/// Where a look-up ends, or goes on. One cache line.
struct alignas(64) FormCell {
    enum Kind : std::uint8_t {
        Whole, ///< eight nodes
        Split, ///< eight cells of half the size from `next` on
        Cut, ///< what cuts[next] says
    };
    std::uint32_t node[8];
    Coord origin;
    float size; ///< lattice steps
    float inverseSize;
    std::int32_t next;
    Kind kind;
    std::uint8_t level; ///< of the volume's cell
    std::uint8_t usable; ///< corners with weight, for the modes that take one of them
    std::uint8_t wide; ///< nodes are in SamplerForm::wide
};

/// A cell that geometry cuts. One cache line.
struct alignas(64) FormCut {
    float normal[3][3];
    float offset[3];
    std::uint64_t masks; ///< with a corner with weight in each
    std::int32_t level;
};
/// What few queries ask of it.
struct FormCutMore {
    float validity[8]; ///< of the volume's corners
    std::int32_t split[8]; ///< by region: first of eight cells, −1: the corners
};

/// The eight voxels (x, y, 0 … 7) of a block of 8³, with all that finds the nodes of their cells:
/// one cache line. Samples are numbered along z, so that those of a row follow each other. A column
/// has the four rows of one level's cells; other cells in it are FormCells.
struct alignas(64) FormColumn {
    std::uint32_t first[4]; ///< node of the first sample of the rows at the cell's corners 0 … 3
    std::uint16_t present[4]; ///< bit z: the row has a sample at z, 0 … 8
    std::uint8_t code[8]; ///< VoxelCode
    std::int32_t id[8]; ///< of a cut or a cell, where the code says so
};

/// Codes of voxels. Below kCutCode: a plain cell of that level (0 … 2); then, of the same levels,
/// cells that geometry cuts.
enum VoxelCode : std::uint8_t { kCutCode = 3, kCellCode = 6, kEmptyCode = 7 };

/// A block all of whose voxels are plain cells of level 0 and rows lie at equal distances, as in a
/// uniform volume: node(x, y, z) = first + x·stepX + y·stepY + z. Small, so that all of them stay
/// in the cache.
struct FormLattice {
    std::uint32_t first, stepX, stepY;
};

struct SamplerForm {
    static constexpr int kBlockLog2 = 3;
    static constexpr int kBlockSize = 1 << kBlockLog2;
    static constexpr int kBlockVoxels = kBlockSize * kBlockSize * kBlockSize;
    static constexpr int kColumns = kBlockSize * kBlockSize; ///< of a block
    static constexpr std::int32_t kEmptyBlock = -1;
    /// Points this close to an outer face, in lattice steps, count as on it.
    static constexpr double kFaceTolerance = 1e-6;

    SamplerOptions options;
    int bands = 3;
    double toIndex[4][3]; ///< world → lattice, rows as Imath's
    float unscale = 1; ///< what records must be multiplied by
    bool finite = true; ///< all coefficients are

    RecordLayout layout; ///< of samples and ghosts
    std::size_t stride = 0;
    LineVector<std::byte> records;
    RecordLayout
        wideLayout; ///< of all nodes of split cells, where Hermite data of ghosts is needed
    std::size_t wideStride = 0;
    LineVector<std::byte> wide;

    Coord blockMin, blockDim;
    /// kEmptyBlock; ≤ −2: −2 − cell; else twice the place in lattices, plus one, or twice that of
    /// kColumns columns, at 8x + y.
    std::vector<std::int32_t> table;
    std::vector<FormLattice> lattices;
    LineVector<FormColumn> columns;
    LineVector<FormCell> cells;
    LineVector<FormCut> cuts;
    std::vector<FormCutMore> cutsMore; // of cuts[i]
    /// Answers where the table would be too large; then cells are numbered as the volume's.
    std::shared_ptr<const Topology> topology;
    bool useTree = false;

    /// InverseDistance: ghosts as sums of samples, entries parentBegin[g] … parentBegin[g + 1] of
    /// ghost firstGhost + g.
    struct Parent {
        std::uint32_t node;
        float share;
    };
    std::uint32_t firstGhost = 0;
    std::vector<std::uint32_t> parentBegin;
    std::vector<Parent> parents;
    /// Lattice position of the nodes before firstGhost.
    std::vector<Coord> nodePosition;

    std::size_t memoryBytes() const;
};

std::shared_ptr<const SamplerForm> compileSampler(
    const IrradianceVolume& volume, const SamplerOptions& options);

/// The volume's cell at @a voxel, or kNoCell, where there is no table.
CellId findInTree(const SamplerForm& form, const Coord& voxel);

inline Coord blockOf(const Coord& voxel)
{
    constexpr int s = SamplerForm::kBlockLog2;
    return {voxel.x >> s, voxel.y >> s, voxel.z >> s};
}

inline int voxelInBlock(const Coord& v) { return ((v.x & 7) << 6) | ((v.y & 7) << 3) | (v.z & 7); }

} // namespace lumivdb::detail
