// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file spheres.h
/// The row of white test spheres in a picture.

#include "view.h"

namespace lumivdb {

struct Sphere {
    Vec3d centre; ///< world
    double radius;
    /// Distance along the unit ray to the sphere's outside, or −1.
    double intersect(const Vec3d& origin, const Vec3d& direction) const;
};

/// Up to @a count spheres in a row across @a view, all at one depth and height: of some depths
/// about the view's focus and some heights, where most and the largest have room.
std::vector<Sphere> placeSpheres(
    const Tracer& tracer, const VolumeSampler& sampler, const View& view, int count);

} // namespace lumivdb
