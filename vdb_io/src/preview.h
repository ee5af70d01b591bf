// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file preview.h
/// Grids to look at: what hosts draw when they open a volume.

#include <lumivdb/core/volume.h>

#include <openvdb/openvdb.h>

namespace lumivdb {

struct PreviewGrids {
    openvdb::Vec3SGrid::Ptr color; ///< mean irradiance over all normals / π
    openvdb::FloatGrid::Ptr density; ///< its Rec. 709 luminance, not below 0
};

/// @a voxel world units; 0: the spacing, doubled until a grid has at most 2^24 voxels and at
/// most 2^18 or eight a sample, whichever is more.
/// Voxels are leaf voxels (no tiles); the value at index i is that of the world point of index i.
PreviewGrids makePreview(const IrradianceVolume& volume, double voxel);

} // namespace lumivdb
