// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file types.h
/// Vector, matrix and box types used everywhere. They are Imath's.
///
/// **Matrices follow Imath: row vectors.** A point transforms as `p' = p * M`, so `a * b` applies
/// `a` first. A column-major, column-vector matrix (glTF) has the same memory layout and can be
/// copied byte for byte.

#include <Imath/ImathBox.h>
#include <Imath/ImathMatrix.h>
#include <Imath/ImathVec.h>

namespace lumivdb {

using Vec2f = Imath::V2f;
using Vec2d = Imath::V2d;
using Vec3f = Imath::V3f;
using Vec3d = Imath::V3d;
using Box3d = Imath::Box3d;
using Mat3d = Imath::M33d;
using Mat4d = Imath::M44d;

/// Scene-linear RGB. The quantity (radiance, irradiance, albedo) is named where it is used.
using Color = Imath::V3f;

/// Integer lattice point ("voxel units").
using Coord = Imath::V3i;

/// Lattice cells with lower ≤ origin < upper; as a region: from lattice point lower to upper.
struct LatticeBox {
    Coord lower{0, 0, 0}, upper{0, 0, 0};
    bool operator==(const LatticeBox& o) const { return lower == o.lower && upper == o.upper; }
};

/// Rec. 709 relative luminance weights.
inline float luminance(const Color& c) { return 0.2126f * c.x + 0.7152f * c.y + 0.0722f * c.z; }

} // namespace lumivdb
