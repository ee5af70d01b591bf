// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file volume_output.h
/// -o OUT.vdb and how it is stored: shared by bake and resample.

#include "common.h"

#include <lumivdb/vdb_io/volume_file.h>

namespace lumivdb::cli {

class VolumeOutput {
public:
    void declare(Arguments& arguments);
    /// Before long work: whether the file can be written at all. @throws Error(Usage, Output).
    void check() const;
    void write(const IrradianceVolume& volume, Progress& progress) const;

    std::string path;
    SaveOptions options;
};

} // namespace lumivdb::cli
