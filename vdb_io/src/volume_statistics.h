// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file volume_statistics.h
/// The part of the statistics that needs the volume and no file.

#include <lumivdb/vdb_io/statistics.h>

namespace lumivdb {

/// Fills what concerns samples, cells and their records.
void addVolumeStatistics(const IrradianceVolume& volume, VolumeStatistics& statistics);

} // namespace lumivdb
