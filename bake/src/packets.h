// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file packets.h
/// Rays in structure-of-arrays batches, traced by Embree in packets.

#include "tracer_impl.h"

#include <cstdint>

namespace lumivdb {

constexpr int kBatch = 256;
constexpr std::uint32_t kMiss = 0xffffffffu;

/// Up to kBatch rays, local space. A direction need not be unit: distances count in its length.
struct RayBatch {
    alignas(64) float ox[kBatch], oy[kBatch], oz[kBatch];
    alignas(64) float dx[kBatch], dy[kBatch], dz[kBatch];
    alignas(64) float tfar[kBatch];
    int count = 0;

    void set(int i, const Vec3f& origin, const Vec3f& direction, float far)
    {
        ox[i] = origin.x;
        oy[i] = origin.y;
        oz[i] = origin.z;
        dx[i] = direction.x;
        dy[i] = direction.y;
        dz[i] = direction.z;
        tfar[i] = far;
    }
    void push(const Vec3f& origin, const Vec3f& direction, float far)
    {
        set(count++, origin, direction, far);
    }
    Vec3f direction(int i) const { return {dx[i], dy[i], dz[i]}; }
};

struct HitBatch {
    alignas(64) float t[kBatch], u[kBatch], v[kBatch];
    alignas(64) std::uint32_t triangle[kBatch]; ///< into Tracer::Impl::triangles, kMiss: none
};

/// Closest hits of neighbouring rays, in packets of sixteen.
void intersectCoherent(const Tracer::Impl& impl, const RayBatch& rays, HitBatch& hits);
/// Closest hits of rays that have little in common, in packets of eight of one octant.
void intersectScattered(const Tracer::Impl& impl, const RayBatch& rays, HitBatch& hits);
/// occluded[i] = 1 where something lies between origin and origin + tfar · direction, else 0; for
/// neighbouring rays and for others.
void occlude(const Tracer::Impl& impl, const RayBatch& rays, std::uint8_t* occluded);
void occludeScattered(const Tracer::Impl& impl, const RayBatch& rays, std::uint8_t* occluded);

} // namespace lumivdb
