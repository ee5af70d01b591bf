// SPDX-License-Identifier: Apache-2.0
#include "packets.h"

#include <algorithm>
#include <utility>

namespace lumivdb {

namespace {

template <int N> struct Packet;
template <> struct Packet<16> {
    using Ray = RTCRay16;
    using RayHit = RTCRayHit16;
    static constexpr auto intersect = rtcIntersect16;
    static constexpr auto occluded = rtcOccluded16;
};
template <> struct Packet<8> {
    using Ray = RTCRay8;
    using RayHit = RTCRayHit8;
    static constexpr auto intersect = rtcIntersect8;
    static constexpr auto occluded = rtcOccluded8;
};

/// The order in which a batch is traced.
struct InOrder {
    int operator[](int i) const { return i; }
};

/// By octant of the direction, otherwise in order: what scattered rays have in common.
class ByOctant {
public:
    explicit ByOctant(const RayBatch& rays)
    {
        std::uint8_t octants[kBatch];
        int next[8] = {};
        for (int i = 0; i < rays.count; ++i) {
            octants[i] = static_cast<std::uint8_t>(
                (rays.dx[i] < 0) | (rays.dy[i] < 0) << 1 | (rays.dz[i] < 0) << 2);
            ++next[octants[i]];
        }
        for (int o = 0, first = 0; o < 8; ++o) first += std::exchange(next[o], first);
        for (int i = 0; i < rays.count; ++i) {
            mOrder[next[octants[i]]++] = static_cast<std::uint16_t>(i);
        }
    }
    int operator[](int i) const { return mOrder[i]; }

private:
    std::uint16_t mOrder[kBatch];
};

/// What is the same in all packets and stays as it is.
template <int N, class Ray> void setConstants(Ray& ray)
{
    std::fill_n(ray.tnear, N, 0.0f);
    std::fill_n(ray.time, N, 0.0f);
    std::fill_n(ray.mask, N, ~0u);
    std::fill_n(ray.id, N, 0u);
    std::fill_n(ray.flags, N, 0u);
}

/// Copies rays [first, first + N) of the order into a packet. Lanes past the end are off but repeat
/// the first ray: Debian's Embree asserts that even those are finite.
template <int N, class Order, class Ray>
void load(const RayBatch& rays, const Order& order, int first, Ray& ray, int* valid)
{
    const int n = std::min(N, rays.count - first);
    for (int i = 0; i < N; ++i) {
        const int j = order[first + (i < n ? i : 0)];
        valid[i] = i < n ? -1 : 0;
        ray.org_x[i] = rays.ox[j];
        ray.org_y[i] = rays.oy[j];
        ray.org_z[i] = rays.oz[j];
        ray.dir_x[i] = rays.dx[j];
        ray.dir_y[i] = rays.dy[j];
        ray.dir_z[i] = rays.dz[j];
        ray.tfar[i] = rays.tfar[j];
    }
}

template <int N, class Order>
void intersectIn(const Tracer::Impl& impl, const RayBatch& rays, const Order& order,
    RTCIntersectContextFlags flags, HitBatch& hits)
{
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    context.flags = flags;
    typename Packet<N>::RayHit packet;
    setConstants<N>(packet.ray);
    alignas(64) int valid[N];
    for (int first = 0; first < rays.count; first += N) {
        load<N>(rays, order, first, packet.ray, valid);
        std::fill_n(packet.hit.geomID, N, RTC_INVALID_GEOMETRY_ID);
        std::fill_n(packet.hit.instID[0], N, RTC_INVALID_GEOMETRY_ID);
        Packet<N>::intersect(valid, impl.embree, &context, &packet);
        const int n = std::min(N, rays.count - first);
        for (int i = 0; i < n; ++i) {
            const int j = order[first + i];
            const bool hit = packet.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID;
            hits.triangle[j]
                = hit ? impl.triangleOf(packet.hit.geomID[i], packet.hit.primID[i]) : kMiss;
            hits.t[j] = packet.ray.tfar[i];
            hits.u[j] = packet.hit.u[i];
            hits.v[j] = packet.hit.v[i];
        }
    }
}

template <int N, class Order>
void occludeIn(
    const Tracer::Impl& impl, const RayBatch& rays, const Order& order, std::uint8_t* occluded)
{
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    typename Packet<N>::Ray packet;
    setConstants<N>(packet);
    alignas(64) int valid[N];
    for (int first = 0; first < rays.count; first += N) {
        load<N>(rays, order, first, packet, valid);
        Packet<N>::occluded(valid, impl.embree, &context, &packet);
        const int n = std::min(N, rays.count - first);
        for (int i = 0; i < n; ++i) occluded[order[first + i]] = packet.tfar[i] < 0 ? 1 : 0;
    }
}

} // namespace

void intersectCoherent(const Tracer::Impl& impl, const RayBatch& rays, HitBatch& hits)
{
    intersectIn<16>(impl, rays, InOrder(), RTC_INTERSECT_CONTEXT_FLAG_COHERENT, hits);
}

void intersectScattered(const Tracer::Impl& impl, const RayBatch& rays, HitBatch& hits)
{
    intersectIn<8>(impl, rays, ByOctant(rays), RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT, hits);
}

void occlude(const Tracer::Impl& impl, const RayBatch& rays, std::uint8_t* occluded)
{
    occludeIn<16>(impl, rays, InOrder(), occluded);
}

void occludeScattered(const Tracer::Impl& impl, const RayBatch& rays, std::uint8_t* occluded)
{
    occludeIn<8>(impl, rays, ByOctant(rays), occluded);
}

} // namespace lumivdb
