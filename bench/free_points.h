// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file free_points.h
/// Places that benchmarks measure at.

#include <lumivdb/bake/probe.h>
#include <lumivdb/core/random.h>

#include <vector>

namespace lumivdb {

/// Up to @a count points of @a box in free space, the same each time.
inline std::vector<Vec3d> freePoints(const Tracer& tracer, const Box3d& box, std::size_t count)
{
    ProbeOptions look;
    look.rays = 64;
    look.contribution = Contribution::Direct;
    const ProbeEstimator estimator(tracer, look);
    ProbeEstimator::Workspace workspace;
    std::vector<Vec3d> points;
    CounterRng rng(1);
    for (std::size_t tries = 0; points.size() < count && tries < 100 * count; ++tries) {
        Vec3d p;
        for (int a = 0; a < 3; ++a) {
            p[a] = box.min[a] + rng.nextDouble() * (box.max[a] - box.min[a]);
        }
        if (estimator.radianceSh(p, 1, tries, workspace).validity > 0.9f) points.push_back(p);
    }
    return points;
}

} // namespace lumivdb
