// SPDX-License-Identifier: Apache-2.0
#include "cache_views.h"

#include "directions.h"
#include "packets.h"

#include <lumivdb/core/random.h>

#include <algorithm>
#include <limits>

namespace lumivdb {

namespace {

/// Separates these rays from those of bakes and of the cache's patches.
constexpr std::uint64_t kViewStream = 0x2fd4e81b6a90c537ull;

} // namespace

std::vector<SeenPlace> lookAround(
    const Tracer::Impl& impl, const Box3d& box, std::size_t count, std::uint64_t seed)
{
    std::vector<SeenPlace> seen;
    if (box.isEmpty() || impl.triangleCount == 0) return seen;
    const std::uint64_t key = mixBits(seed ^ kViewStream);
    RayBatch rays;
    HitBatch hits;
    for (std::size_t first = 0; first < count; first += kBatch) {
        rays.count = 0;
        const std::size_t last = std::min(count, first + kBatch);
        for (std::size_t i = first; i < last; ++i) {
            CounterRng rng(hashCombine(key, i));
            Vec3d p;
            for (int a = 0; a < 3; ++a) {
                p[a] = box.min[a] + rng.nextDouble() * (box.max[a] - box.min[a]);
            }
            const double u = rng.nextDouble(), v = rng.nextDouble();
            rays.push(impl.toLocal(p), Vec3f(squareToSphere({u, v})),
                std::numeric_limits<float>::infinity());
        }
        intersectScattered(impl, rays, hits);
        for (int i = 0; i < rays.count; ++i) {
            if (hits.triangle[i] == kMiss) continue;
            const SurfacePoint s = impl.surfaceSeen({rays.ox[i], rays.oy[i], rays.oz[i]},
                rays.direction(i), hits.triangle[i], hits.t[i], hits.u[i], hits.v[i]);
            if (!s.backFace) seen.push_back({s.triangle, s.u, s.v, hits.t[i], s.behind});
        }
    }
    return seen;
}

} // namespace lumivdb
