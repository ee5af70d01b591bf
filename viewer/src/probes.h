// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file probes.h
/// A volume's samples as spheres in a picture.

#include "spheres.h"

#include <vector>

namespace lumivdb {

/// All samples, sorted into tiles of the picture: a ray looks at the few that its tile may show.
class Probes {
public:
    /// Refers to @a volume.
    Probes(const IrradianceVolume& volume, const View& view, int width, int height);

    /// The nearest sphere before @a nearest along the unit ray through pixel (x, y): its radiance,
    /// or black with @a invalid set. False where there is none.
    bool shade(const Vec3d& eye, const Vec3d& direction, int x, int y, double nearest,
        Color* colour, bool* invalid) const;

private:
    struct Probe {
        Sphere sphere;
        SampleId sample;
    };
    void addToTiles(const View& view, int width, int height, std::uint32_t index);

    const IrradianceVolume& mVolume;
    std::vector<Probe> mProbes;
    int mColumns, mRows;
    std::vector<std::vector<std::uint32_t>> mTiles;
};

} // namespace lumivdb
