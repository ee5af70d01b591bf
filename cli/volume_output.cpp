// SPDX-License-Identifier: Apache-2.0
#include "volume_output.h"

#include "interrupt.h"
#include "output.h"

namespace lumivdb::cli {

void VolumeOutput::declare(Arguments& arguments)
{
    arguments.section("Output");
    arguments.text("-o,--output", "OUT.vdb", path,
        "the volume to write, whole or not at all; an old file is replaced at the end");
    arguments.require();
    arguments.neutral();
    arguments.flag("--half", options.half,
        "16-bit floats: half the size, rounded to 5e-4; values beyond 65504 are refused");
    arguments.choice<Codec>("--codec", options.codec,
        {{"blosc", Codec::Blosc}, {"zip", Codec::Zip}, {"none", Codec::None}},
        "compression; zip is much slower for the same size");
    const Range range{-1, std::numeric_limits<double>::max(), false};
    arguments.real("--preview-voxel", options.previewVoxel, range,
        "voxel size of the preview grids 'color' and 'density' that 3D programs show, scene units; "
        "0: the spacing, coarser for very large volumes; -1: no preview grids");
}

void VolumeOutput::check() const { checkReplaceable(path, "-o"); }

void VolumeOutput::write(const IrradianceVolume& volume, Progress& progress) const
{
    throwIfInterrupted();
    saveVolume(volume, path, options, &progress);
}

} // namespace lumivdb::cli
