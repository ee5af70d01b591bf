// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file channels.h
/// Names and order of the grids, the metadata they carry, and the trees they share a shape with.

#include <lumivdb/core/volume.h>

#include <openvdb/openvdb.h>

#include <optional>
#include <string>
#include <vector>

namespace lumivdb {

constexpr const char* kLevelGrid = "level";
constexpr const char* kValidityGrid = "validity";
constexpr const char* kDistanceGrid = "distance";
constexpr const char* kOffsetGrid = "offset";
constexpr const char* kBlockingGrid = "blocking";
constexpr const char* kColorGrid = "color";
constexpr const char* kDensityGrid = "density";
constexpr const char* kMetadataPrefix = "lumivdb_";
constexpr float kHalfMax = 65504.0f;

/// One Vec3S grid of the file and where its values lie in a sample's records.
struct ColorChannel {
    std::string name;
    bool gradient = false; ///< in IrradianceVolume::gradient() instead of radiance()
    int offset = 0; ///< index into that record
};

/// sh_0 … sh_{n−1}, then for every coefficient sh_i_dx, sh_i_dy, sh_i_dz where there are gradients.
std::vector<ColorChannel> colorChannels(int bands, bool gradients);

/// Grids of CellVisibility, all or none: normals, offsets of the three planes, and the two words of
/// the masks, low word first. They hold the covering cell's at every voxel.
constexpr const char* kWallGrids[3] = {"wall_0", "wall_1", "wall_2"};
constexpr const char* kWallOffsetGrid = "wall_offset";
constexpr const char* kMaskGrids[2] = {"mask_0", "mask_1"};
/// Names of the six.
const std::vector<std::string>& cutGridNames();

/// The `lumivdb_` metadata of @a volume.
openvdb::MetaMap makeMetadata(const IrradianceVolume& volume);

/// What a reader needs before it can make the volume.
struct FileMetadata {
    int version = 0;
    int bands = 0;
    bool gradients = false;
    std::int64_t cutCells = 0; ///< cells with visibility; 0: no such grids
    std::optional<std::int64_t> movedSamples; ///< with an offset other than 0; none: no such grid
    std::optional<std::int64_t> blockedCells; ///< with blocking other than 0; none: no such grid
    VolumeMetadata volume;
};

/// True when the grid carries any `lumivdb_` metadata.
bool hasLumivdbMetadata(const openvdb::MetaMap& map);
/// Reads and checks it. @throws Error(Input); @a where names file and grid in the message.
FileMetadata parseMetadata(const openvdb::MetaMap& map, const std::string& where);
/// Name of the first `lumivdb_` entry that differs, or empty.
std::string metadataDifference(const openvdb::MetaMap& a, const openvdb::MetaMap& b);

/// Quotes for messages: lattice point "(x, y, z)".
std::string pointText(const Coord& p);

/// The active voxels and tiles of every channel grid; a value is the id of the sample whose record
/// stands there: the sample at the voxel or at the tile's lower corner where there is one, else the
/// one at the origin of the cell that covers it.
openvdb::Int32Tree::Ptr makeSourceTree(const IrradianceVolume& volume);
/// Same shape, levels of the covering cells, −1 at samples that no cell covers.
openvdb::Int32Tree::Ptr makeLevelTree(
    const IrradianceVolume& volume, const openvdb::Int32Tree& source);

/// Same shape, ids of the covering cells where they have visibility, −1 elsewhere.
openvdb::Int32Tree::Ptr makeCutTree(
    const IrradianceVolume& volume, const openvdb::Int32Tree& source);

/// Same shape, ids of the covering cells, −1 at samples that no cell covers.
openvdb::Int32Tree::Ptr makeCellTree(
    const IrradianceVolume& volume, const openvdb::Int32Tree& source);

openvdb::math::Transform::Ptr makeTransform(const Mat4d& indexToWorld);
Mat4d matrixOf(const openvdb::math::Transform& transform);

inline openvdb::Coord toVdb(const Coord& p) { return openvdb::Coord(p.x, p.y, p.z); }
inline Coord fromVdb(const openvdb::Coord& p) { return Coord(p.x(), p.y(), p.z()); }

} // namespace lumivdb
