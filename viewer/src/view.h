// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file view.h
/// The camera of a picture, and how one is found where none is given.

#include <lumivdb/viewer/picture.h>

namespace lumivdb {

/// A pinhole camera. Image coordinates (s, t) run over [0,1]² from the upper left corner.
struct View {
    Vec3d eye, forward, right, up; ///< world; the axes are orthonormal
    double tanX = 1, tanY = 1; ///< tangents of half the field of view
    double focus = 1; ///< distance to what the picture is about, world units

    Vec3d direction(double s, double t) const
    {
        const Vec3d d = forward + right * ((2 * s - 1) * tanX) + up * ((1 - 2 * t) * tanY);
        return d.normalized();
    }
};

/// The camera of @a options: eye and target where given, else the scene's first camera, else a view
/// of the bounds (of the scene, or of the volume where the scene is empty):
/// - a scene with one open vertical side (a Cornell box) is seen from outside through that side;
/// - an enclosed one from inside, from the end with the longest view along its longest horizontal
///   axis, a third of the height up;
/// - any other from above, from the direction that sees most fronts.
/// @throws Error(Usage) when eye and target coincide, or there is nothing to look at.
View chooseView(const Tracer& tracer, const Box3d& volumeBounds, const PictureOptions& options);

} // namespace lumivdb
