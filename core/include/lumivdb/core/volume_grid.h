// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file volume_grid.h
/// The OpenVDB side of IrradianceVolume, kept apart because OpenVDB's headers are heavy.

#include <lumivdb/core/volume.h>

#include <lumivdb/core/openvdb_instances.h>

namespace lumivdb {

/// Maps every lattice voxel to the CellId that covers it; background kNoCell; active where a cell
/// is. Cells of level ≥ 3 are tiles. Its transform is the volume's indexToWorld.
const openvdb::Int32Grid& indexGrid(const IrradianceVolume& volume);

} // namespace lumivdb
