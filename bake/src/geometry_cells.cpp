// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/geometry_cells.h>

#include "tracer_impl.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

Vec3d absolute(const Vec3d& v) { return {std::abs(v.x), std::abs(v.y), std::abs(v.z)}; }

double maxAbs(const Vec3d& v) { return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); }

Vec3d larger(const Vec3d& a, const Vec3d& b)
{
    return {std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)};
}

/// Whether the projections of the triangle and of the box |x| ≤ h on @a axis have no point in
/// common. @a slack: rounding of the products, per unit of axis.
bool separates(const Vec3d& axis, const Vec3d (&v)[3], const Vec3d& h, double slack)
{
    const Vec3d a = absolute(axis);
    const double p[3] = {axis.dot(v[0]), axis.dot(v[1]), axis.dot(v[2])};
    const double r = h.dot(a) + slack * (a.x + a.y + a.z);
    return std::min({p[0], p[1], p[2]}) > r || std::max({p[0], p[1], p[2]}) < -r;
}

/// Thirteen axes: three of the box, the triangle's normal, nine products of edges. For a triangle
/// that is a line or a point those that vanish separate nothing and the others suffice.
bool touch(const Vec3d (&v)[3], const Vec3d& h)
{
    constexpr double kUlps = 0x1p-50;
    const double slack = kUlps * std::max({maxAbs(v[0]), maxAbs(v[1]), maxAbs(v[2]), maxAbs(h)});
    for (int a = 0; a < 3; ++a) {
        Vec3d axis(0.0);
        axis[a] = 1;
        if (separates(axis, v, h, slack)) return false;
    }
    const Vec3d edges[3] = {v[1] - v[0], v[2] - v[1], v[0] - v[2]};
    if (separates(edges[0].cross(edges[1]), v, h, slack)) return false;
    for (const Vec3d& e : edges) {
        for (const Vec3d& axis : {Vec3d(0, -e.z, e.y), Vec3d(e.z, 0, -e.x), Vec3d(-e.y, e.x, 0)}) {
            if (separates(axis, v, h, slack)) return false;
        }
    }
    return true;
}

struct BoxQuery {
    const Tracer::Impl* impl;
    Vec3d center, half; // local
    std::vector<std::uint32_t>* found; // null: one is enough
    bool any = false;

    bool touches(std::uint32_t triangle) const
    {
        const Tracer::Impl::Instance* instance = impl->instanceOf(triangle);
        const Corners c = impl->corners(impl->stored(triangle, instance), instance);
        Vec3d v[3] = {Vec3d(c.a), Vec3d(c.b), Vec3d(c.c)}, size(0.0);
        for (const Vec3d& p : v) size = larger(size, absolute(p));
        // What Impl::toLocal() rounded: half a unit of the difference's last place, and the
        // difference itself in double.
        Vec3d rounding = size * 0x1p-24 + (absolute(impl->origin) + size) * 0x1p-52;
        if (instance) rounding += Vec3d(Tracer::Impl::offsetOf(c, instance));
        for (Vec3d& p : v) p -= center;
        return touch(v, half + rounding);
    }
};

bool visitTriangle(RTCPointQueryFunctionArguments* args)
{
    auto& q = *static_cast<BoxQuery*>(args->userPtr);
    const std::uint32_t id
        = q.impl->triangleOf(args->geomID, args->primID, args->context->instID[0]);
    if ((q.any && !q.found) || !q.touches(id)) return false;
    q.any = true;
    if (q.found) {
        q.found->push_back(id);
        return false;
    }
    args->query->radius = 0; // nothing more to look for
    return true;
}

/// Asks Embree for what is near the sphere around the box, and the triangles themselves then.
bool run(const Tracer::Impl& impl, const Box3d& scene, const Box3d& worldBox,
    std::vector<std::uint32_t>* found)
{
    if (scene.isEmpty() || worldBox.isEmpty()) return false;
    Vec3d lower, upper; // the rest of a large box has no triangles
    for (int a = 0; a < 3; ++a) {
        lower[a] = std::max(worldBox.min[a] - impl.origin[a], scene.min[a]);
        upper[a] = std::min(worldBox.max[a] - impl.origin[a], scene.max[a]);
        if (!(lower[a] <= upper[a])) return false;
    }
    BoxQuery q{&impl, (lower + upper) * 0.5, (upper - lower) * 0.5, found};
    const Vec3f center(q.center);
    const double rounding = impl.roundingOf(
        static_cast<float>(std::max(maxAbs(scene.min), maxAbs(scene.max)) * 0x1p-20));
    RTCPointQuery query{};
    query.x = center.x;
    query.y = center.y;
    query.z = center.z;
    query.radius = static_cast<float>(q.half.length() * (1 + 1e-6) + rounding);
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    rtcPointQuery(impl.embree, &query, &context, visitTriangle, &q);
    return q.any;
}

} // namespace

GeometryCells::GeometryCells(const Tracer& tracer)
    : mTracer(&tracer)
{
    const Tracer::Impl& impl = tracer.impl();
    if (impl.bounds.isEmpty()) return;
    mLocal = Box3d(impl.bounds.min - impl.origin, impl.bounds.max - impl.origin);
    const Vec3d size = larger(absolute(mLocal.min), absolute(mLocal.max)) + absolute(impl.origin);
    const Vec3d rounding = size * 0x1p-22 + Vec3d(impl.roundingOf(0));
    mLocal.min -= rounding;
    mLocal.max += rounding;
}

bool GeometryCells::touches(const Box3d& worldBox) const
{
    return run(mTracer->impl(), mLocal, worldBox, nullptr);
}

void GeometryCells::collect(const Box3d& worldBox, std::vector<std::uint32_t>& triangles) const
{
    triangles.clear();
    run(mTracer->impl(), mLocal, worldBox, &triangles);
    std::sort(triangles.begin(), triangles.end());
}

} // namespace lumivdb
