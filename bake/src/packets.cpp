// SPDX-License-Identifier: Apache-2.0
#include "packets.h"

#include <algorithm>

namespace lumivdb {

namespace {

constexpr int kPacket = 16;

/// Copies rays [first, first + 16) into a packet. Lanes past the end are off but repeat the first
/// ray: Debian's Embree asserts that even those are finite.
template <class Ray> void load(const RayBatch& rays, int first, Ray& ray, int* valid)
{
    const int n = std::min(kPacket, rays.count - first);
    for (int i = 0; i < kPacket; ++i) {
        const int j = first + (i < n ? i : 0);
        valid[i] = i < n ? -1 : 0;
        ray.org_x[i] = rays.ox[j];
        ray.org_y[i] = rays.oy[j];
        ray.org_z[i] = rays.oz[j];
        ray.dir_x[i] = rays.dx[j];
        ray.dir_y[i] = rays.dy[j];
        ray.dir_z[i] = rays.dz[j];
        ray.tfar[i] = rays.tfar[j];
        ray.tnear[i] = 0;
        ray.time[i] = 0;
        ray.mask[i] = ~0u;
        ray.id[i] = 0;
        ray.flags[i] = 0;
    }
}

} // namespace

void intersectCoherent(const Tracer::Impl& impl, const RayBatch& rays, HitBatch& hits)
{
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
    RTCRayHit16 packet;
    alignas(64) int valid[kPacket];
    for (int first = 0; first < rays.count; first += kPacket) {
        load(rays, first, packet.ray, valid);
        std::fill_n(packet.hit.geomID, kPacket, RTC_INVALID_GEOMETRY_ID);
        std::fill_n(packet.hit.instID[0], kPacket, RTC_INVALID_GEOMETRY_ID);
        rtcIntersect16(valid, impl.embree, &context, &packet);
        const int n = std::min(kPacket, rays.count - first);
        for (int i = 0; i < n; ++i) {
            const bool hit = packet.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID;
            hits.triangle[first + i] = hit ? impl.triangleOf(packet.hit.geomID[i],
                                           packet.hit.primID[i], packet.hit.instID[0][i])
                                           : kMiss;
            hits.t[first + i] = packet.ray.tfar[i];
            hits.u[first + i] = packet.hit.u[i];
            hits.v[first + i] = packet.hit.v[i];
        }
    }
}

void intersectSingle(const Tracer::Impl& impl, const RayBatch& rays, HitBatch& hits)
{
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    for (int i = 0; i < rays.count; ++i) {
        RTCRayHit r;
        r.ray.org_x = rays.ox[i];
        r.ray.org_y = rays.oy[i];
        r.ray.org_z = rays.oz[i];
        r.ray.tnear = 0;
        r.ray.dir_x = rays.dx[i];
        r.ray.dir_y = rays.dy[i];
        r.ray.dir_z = rays.dz[i];
        r.ray.time = 0;
        r.ray.tfar = rays.tfar[i];
        r.ray.mask = ~0u;
        r.ray.id = 0;
        r.ray.flags = 0;
        r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        rtcIntersect1(impl.embree, &context, &r);
        const bool hit = r.hit.geomID != RTC_INVALID_GEOMETRY_ID;
        hits.triangle[i]
            = hit ? impl.triangleOf(r.hit.geomID, r.hit.primID, r.hit.instID[0]) : kMiss;
        hits.t[i] = r.ray.tfar;
        hits.u[i] = r.hit.u;
        hits.v[i] = r.hit.v;
    }
}

void occlude(const Tracer::Impl& impl, const RayBatch& rays, std::uint8_t* occluded)
{
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    RTCRay16 packet;
    alignas(64) int valid[kPacket];
    for (int first = 0; first < rays.count; first += kPacket) {
        load(rays, first, packet, valid);
        rtcOccluded16(valid, impl.embree, &context, &packet);
        const int n = std::min(kPacket, rays.count - first);
        for (int i = 0; i < n; ++i) occluded[first + i] = packet.tfar[i] < 0 ? 1 : 0;
    }
}

} // namespace lumivdb
