// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/error.h>
#include <lumivdb/core/volume.h>

#include "volume_impl.h"

#include <tbb/parallel_for.h>
#include <tbb/parallel_sort.h>

#include <algorithm>
#include <limits>
#include <tuple>

namespace lumivdb {

namespace {

std::string toString(const Coord& c)
{
    return "(" + std::to_string(c.x) + ", " + std::to_string(c.y) + ", " + std::to_string(c.z)
        + ")";
}

/// Keeps coordinates, and what is added to them here, far from int's ends.
void requireLattice(const Coord& lower, const Coord& upper)
{
    for (int a = 0; a < 3; ++a) {
        if (lower[a] >= -kMaxLattice && upper[a] <= kMaxLattice) continue;
        throw Error(ErrorCode::Usage,
            "Cells from lattice point " + toString(lower)
                + " leave the lattice, which ends 2^30 steps from its origin; take a larger "
                  "spacing.");
    }
}

Coord cornerOf(const Cell& cell, int i)
{
    const int size = 1 << cell.level;
    return cell.origin + Coord(i & 1 ? size : 0, i & 2 ? size : 0, i & 4 ? size : 0);
}

void findBounds(Topology& t)
{
    t.minLattice = Coord(std::numeric_limits<int>::max());
    t.maxLattice = Coord(std::numeric_limits<int>::min());
    for (const Cell& cell : t.cells) {
        const Coord upper = cornerOf(cell, 7);
        for (int a = 0; a < 3; ++a) {
            t.minLattice[a] = std::min(t.minLattice[a], cell.origin[a]);
            t.maxLattice[a] = std::max(t.maxLattice[a], upper[a]);
        }
    }
    t.latticeKeys = LatticeKeys(t.minLattice);
    if (!t.latticeKeys.contains(t.maxLattice)) {
        throw Error(ErrorCode::Usage,
            "The volume spans more than 2^21 lattice steps along an axis; take a larger spacing or "
            "smaller bounds.");
    }
}

/// Samples: the union of all corners, sorted; then every cell's corners point to them.
void numberSamples(Topology& t)
{
    std::vector<std::uint64_t> keys(t.cells.size() * 8);
    tbb::parallel_for(std::size_t{0}, t.cells.size(), [&](std::size_t c) {
        for (int i = 0; i < 8; ++i) keys[c * 8 + i] = t.latticeKeys.key(cornerOf(t.cells[c], i));
    });
    tbb::parallel_sort(keys.begin(), keys.end());
    keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
    if (keys.size() > static_cast<std::size_t>(std::numeric_limits<std::int32_t>::max())) {
        throw Error(ErrorCode::Usage,
            "The volume would have more than 2^31 samples; take a larger spacing.");
    }
    keys.shrink_to_fit();
    t.keys = std::move(keys);
    t.positions.resize(t.keys.size());
    tbb::parallel_for(std::size_t{0}, t.cells.size(), [&](std::size_t c) {
        for (int i = 0; i < 8; ++i) {
            const std::uint64_t key = t.latticeKeys.key(cornerOf(t.cells[c], i));
            const auto it = std::lower_bound(t.keys.begin(), t.keys.end(), key);
            t.cells[c].corners[i] = static_cast<SampleId>(it - t.keys.begin());
        }
    });
    constexpr std::uint64_t kMask = (std::uint64_t{1} << LatticeKeys::kAxisBits) - 1;
    tbb::parallel_for(std::size_t{0}, t.keys.size(), [&](std::size_t s) {
        const std::uint64_t key = t.keys[s];
        t.positions[s] = t.minLattice
            + Coord(static_cast<int>(key >> (2 * LatticeKeys::kAxisBits)),
                static_cast<int>((key >> LatticeKeys::kAxisBits) & kMask),
                static_cast<int>(key & kMask));
    });
}

/// Fills the index tree. The sum of the cells' volumes tells whether any two overlap.
void indexCells(Topology& t)
{
    t.index = std::make_shared<openvdb::Int32Tree>(kNoCell);
    openvdb::tree::ValueAccessor<openvdb::Int32Tree> accessor(*t.index);
    std::uint64_t voxels = 0;
    for (std::size_t c = 0; c < t.cells.size(); ++c) {
        const Cell& cell = t.cells[c];
        const openvdb::Coord lower(cell.origin.x, cell.origin.y, cell.origin.z);
        const auto id = static_cast<CellId>(c);
        if (cell.level == 0) {
            accessor.setValueOn(lower, id);
        } else {
            t.index->fill(openvdb::CoordBBox::createCube(lower, 1 << cell.level), id, true);
            accessor.clear();
        }
        voxels += std::uint64_t{1} << (3 * cell.level);
        if (t.cellsByLevel.size() <= static_cast<std::size_t>(cell.level)) {
            t.cellsByLevel.resize(static_cast<std::size_t>(cell.level) + 1);
        }
        ++t.cellsByLevel[static_cast<std::size_t>(cell.level)];
    }
    if (voxels != t.index->activeVoxelCount()) {
        throw Error(ErrorCode::Usage, "Cells of the volume overlap; every place needs one cell.");
    }
}

/// 2:1 balance: no cell touches another that is more than twice its size. A neighbour region of a
/// cell's own size is either finer or inside one cell, so one voxel of each of the 26 suffices.
void checkBalance(const Topology& t)
{
    if (t.cellsByLevel.size() <= 2) return;
    openvdb::tree::ValueAccessor<const openvdb::Int32Tree> accessor(*t.index);
    for (const Cell& cell : t.cells) {
        const int size = 1 << cell.level;
        for (int n = 0; n < 27; ++n) {
            const Coord step(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
            const Coord p = cell.origin + step * size;
            const CellId other = accessor.getValue(openvdb::Coord(p.x, p.y, p.z));
            if (other == kNoCell) continue;
            const Cell& neighbour = t.cells[static_cast<std::size_t>(other)];
            if (neighbour.level > cell.level + 1) {
                throw Error(ErrorCode::Usage,
                    "The cell of level " + std::to_string(cell.level) + " at lattice point "
                        + toString(cell.origin) + " touches one of level "
                        + std::to_string(neighbour.level)
                        + "; neighbours may differ by one level only.");
            }
        }
    }
}

} // namespace

VolumeBuilder::VolumeBuilder(int bands, GradientStorage gradients, const Mat4d& indexToWorld)
    : mBands(bands)
    , mGradients(gradients)
    , mIndexToWorld(indexToWorld)
{
}

void VolumeBuilder::addCell(const Coord& origin, int level)
{
    const bool inRange = level >= 0 && level <= kMaxLevel;
    const int mask = inRange ? (1 << level) - 1 : 0;
    if (!inRange || (origin.x & mask) || (origin.y & mask) || (origin.z & mask)) {
        throw Error(ErrorCode::Usage,
            "A cell of level " + std::to_string(level) + " cannot begin at lattice point "
                + toString(origin) + "; levels are 0 to " + std::to_string(kMaxLevel)
                + " and origins multiples of 2^level.");
    }
    requireLattice(origin, origin); // before a sum could overflow
    requireLattice(origin, origin + Coord(1 << level));
    mCells.push_back({origin, level, {}});
}

void VolumeBuilder::addUniform(const Coord& lower, const Coord& upper)
{
    if (lower.x >= upper.x || lower.y >= upper.y || lower.z >= upper.z) return;
    requireLattice(lower, upper);
    for (int x = lower.x; x < upper.x; ++x)
        for (int y = lower.y; y < upper.y; ++y)
            for (int z = lower.z; z < upper.z; ++z) mCells.push_back({Coord(x, y, z), 0, {}});
}

IrradianceVolume VolumeBuilder::build()
{
    if (mCells.empty()) {
        throw Error(ErrorCode::Usage, "The volume has no cell; give bounds of positive size.");
    }
    if (mCells.size() > static_cast<std::size_t>(std::numeric_limits<CellId>::max())) {
        throw Error(
            ErrorCode::Usage, "The volume would have more than 2^31 cells; take a larger spacing.");
    }
    auto t = std::make_shared<Topology>();
    t->cells = std::move(mCells);
    mCells.clear();
    tbb::parallel_sort(t->cells.begin(), t->cells.end(), [](const Cell& a, const Cell& b) {
        return std::tie(a.origin.x, a.origin.y, a.origin.z, a.level)
            < std::tie(b.origin.x, b.origin.y, b.origin.z, b.level);
    });
    findBounds(*t);
    indexCells(*t);
    checkBalance(*t);
    numberSamples(*t);
    return IrradianceVolume(IrradianceVolume::Impl::create(
        t, mBands, mGradients == GradientStorage::PerCoefficient, mIndexToWorld));
}

} // namespace lumivdb
