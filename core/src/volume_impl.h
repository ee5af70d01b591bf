// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <lumivdb/core/volume.h>

#include <lumivdb/core/openvdb_instances.h>

namespace lumivdb {

/// Lattice positions as sortable 64-bit keys: 21 bits an axis relative to the volume's corner, so
/// that key order is (x, y, z) order.
class LatticeKeys {
public:
    static constexpr int kAxisBits = 21;
    LatticeKeys() = default;
    explicit LatticeKeys(const Coord& lower)
        : mLower(lower)
    {
    }
    std::uint64_t key(const Coord& p) const
    {
        return (axis(p.x, mLower.x) << (2 * kAxisBits)) | (axis(p.y, mLower.y) << kAxisBits)
            | axis(p.z, mLower.z);
    }
    bool contains(const Coord& p) const
    {
        const std::uint64_t limit = std::uint64_t{1} << kAxisBits;
        return axis(p.x, mLower.x) < limit && axis(p.y, mLower.y) < limit
            && axis(p.z, mLower.z) < limit;
    }

private:
    static std::uint64_t axis(int v, int lower)
    {
        return static_cast<std::uint64_t>(static_cast<std::int64_t>(v) - lower);
    }
    Coord mLower{0, 0, 0};
};

/// What volumes of the same shape share.
struct Topology {
    std::vector<Cell> cells; // sorted by origin
    std::vector<Coord> positions; // sorted by (x, y, z)
    std::vector<std::uint64_t> keys; // of positions
    LatticeKeys latticeKeys;
    Coord minLattice, maxLattice; // of positions, inclusive
    std::vector<std::size_t> cellsByLevel;
    openvdb::Int32Tree::Ptr index; // voxel → CellId
};

struct IrradianceVolume::Impl {
    std::shared_ptr<const Topology> topology;
    openvdb::Int32Grid::ConstPtr grid; // topology->index under this volume's transform
    int bands = 3;
    bool gradients = false;
    Mat4d indexToWorld, worldToIndex;
    double spacing = 1;
    std::vector<Color> records; // sampleCount × stride()
    std::vector<float> validity, distance;
    std::vector<Vec3f> offsets; // empty: all zero
    std::vector<std::int32_t> cutOf; // cell → index in cuts, −1: uncut; empty: none is cut
    std::vector<CellVisibility> cuts;
    std::vector<Vec3f> blocking; // per cell; empty: none
    VolumeMetadata metadata;

    std::size_t stride() const
    {
        return static_cast<std::size_t>(coefficientCount(bands)) * (gradients ? 4 : 1);
    }
    /// Sizes the records of @a topology, zeroed. @throws Error(Usage) where @a m is no similarity.
    static std::unique_ptr<Impl> create(
        std::shared_ptr<const Topology> topology, int bands, bool gradients, const Mat4d& m);
    void setTransform(const Mat4d& m);
};

} // namespace lumivdb
