// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file surfel.h
/// What a light propagation volume is fed with: pieces of surface.

#include <lumivdb/core/types.h>

namespace lumivdb {

/// A small piece of surface that reflects (or emits) light, or only stands in its way.
struct Surfel {
    Vec3d position; ///< world
    Vec3f normal; ///< unit, the side that sends the light
    /// Radiant flux sent into the hemisphere round the normal, diffusely: pi * L * area; scene
    /// units.
    Color flux;
    float area = 0; ///< world units squared
};

} // namespace lumivdb
