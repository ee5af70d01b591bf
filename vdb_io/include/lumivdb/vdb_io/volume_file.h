// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file volume_file.h
/// Irradiance volumes as standard .vdb files. The layout is specified in docs/FORMAT.md.

#include <lumivdb/core/progress.h>
#include <lumivdb/core/volume.h>

#include <string>

namespace lumivdb {

/// Version of the file layout, metadata `lumivdb_version`. A reader refuses any other.
constexpr int kFormatVersion = 1;

enum class Codec { Blosc, Zip, None };

struct SaveOptions {
    Codec codec = Codec::Blosc;
    /// Store values as 16-bit floats. A value beyond ±65504 is refused, naming grid and sample.
    bool half = false;
    /// Voxel size of the preview grids `color` and `density`, world units; 0: the finest spacing,
    /// made coarser until each preview grid has at most 2^24 voxels, and at most 2^18 or eight a
    /// sample, whichever is more; negative: no preview grids.
    double previewVoxel = 0.0;
};

/// Writes @a volume to @a path atomically: a temporary file in the same folder, fsync, rename.
/// Whatever happens, @a path then holds the old file or the new one, whole.
/// @throws Error(Output): folder missing or not writable, disk full, half overflow, NaN in a
/// channel; Error(Interrupted).
void saveVolume(const IrradianceVolume& volume, const std::string& path,
    const SaveOptions& options = {}, Progress* progress = nullptr);

/// Reads a volume. What saveVolume() wrote comes back bit for bit (16-bit: rounded once).
/// @throws Error(Input) with a sentence that names file and grid, for: missing or unreadable file,
/// truncated or damaged, not OpenVDB, no LumiVDB metadata, unknown version, missing or mistyped
/// channel, channels of different topology or transform, NaN or infinite coefficient, cells that
/// do not form a valid volume.
IrradianceVolume loadVolume(const std::string& path, Progress* progress = nullptr);

} // namespace lumivdb
