// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file cache_views.h
/// What probes of a box will see of the surfaces, so that the radiance cache is fine there.

#include "tracer_impl.h"

#include <cstdint>
#include <vector>

namespace lumivdb {

/// Where a ray met a surface (Tracer::Impl's numbers), and from how far.
struct SeenPlace {
    std::uint32_t triangle;
    float u, v, distance;
    bool behind;
};

/// What @a count rays meet, each from a random place of its own in @a box (world), in a random
/// direction. Misses and backs of single-sided surfaces (seen from inside of solids) are left out.
std::vector<SeenPlace> lookAround(
    const Tracer::Impl& impl, const Box3d& box, std::size_t count, std::uint64_t seed);

} // namespace lumivdb
