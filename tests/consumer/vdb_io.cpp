// SPDX-License-Identifier: Apache-2.0
// Writes a volume of constant light, loads it and queries it, with the installed library only.
#include <lumivdb/core/sampler.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <cmath>
#include <cstdio>

int main(int argc, char** argv)
{
    using namespace lumivdb;
    const char* path = argc > 1 ? argv[1] : "consumer.vdb";
    VolumeBuilder builder(3, GradientStorage::None, latticeTransform(0.5));
    builder.addUniform({0, 0, 0}, {4, 4, 4});
    IrradianceVolume volume = builder.build();
    // Radiance 1 from everywhere: L_00 = ∫ Y_00 dω = 4π / √(4π).
    const float L00 = static_cast<float>(std::sqrt(4.0 * 3.14159265358979323846));
    for (SampleId s = 0; s < volume.sampleCount(); ++s) volume.radiance(s)[0] = Color(L00);
    saveVolume(volume, path);

    const IrradianceVolume loaded = loadVolume(path);
    const VolumeSampler sampler(loaded);
    const Color E = sampler.irradiance({0.7, 1.1, 0.3}, {0, 1, 0});
    std::printf("E = %.7f %.7f %.7f, expected pi\n", E.x, E.y, E.z);
    return loaded.sampleCount() == 125 && std::abs(E.x - 3.14159265f) < 1e-5f ? 0 : 1;
}
