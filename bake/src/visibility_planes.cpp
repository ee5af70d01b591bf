// SPDX-License-Identifier: Apache-2.0
#include "visibility_cell.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

/// Surfaces are clipped to the cell grown by this: a wall in the cell's face belongs to it.
constexpr double kGrow = 1e-3;
/// Polygons smaller than this (cell faces) separate nothing that matters.
constexpr double kMinArea = 1e-7;
/// More triangles in one cell than this are thinned out evenly.
constexpr std::size_t kMaxTriangles = 4096;
constexpr std::size_t kMaxPlanes = 12;
/// Surfaces are coplanar up to this distance (cell widths) and cosine.
constexpr double kCoplanar = 1e-3, kParallel = 0.9998;

/// Keeps what of @a polygon has sign · t[axis] ≤ limit (Sutherland and Hodgman 1974).
void clip(std::vector<Vec3d>& polygon, int axis, double sign, double limit)
{
    std::vector<Vec3d> out;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
        const Vec3d &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
        const double da = sign * a[axis] - limit, db = sign * b[axis] - limit;
        if (da <= 0) out.push_back(a);
        if ((da < 0 && db > 0) || (da > 0 && db < 0)) out.push_back(a + (b - a) * (da / (da - db)));
    }
    polygon.swap(out);
}

Vec3d areaVector(const std::vector<Vec3d>& polygon)
{
    Vec3d sum(0.0);
    for (std::size_t i = 2; i < polygon.size(); ++i)
        sum += (polygon[i - 1] - polygon[0]).cross(polygon[i] - polygon[0]);
    return sum * 0.5;
}

/// One of the two normals of a plane, the same whichever is given: its largest component is
/// positive.
Vec3d canonical(const Vec3d& n)
{
    int axis = 0;
    for (int a = 1; a < 3; ++a)
        if (std::abs(n[a]) > std::abs(n[axis]) * (1 + 1e-6)) axis = a;
    return n[axis] < 0 ? -n : n;
}

Vec3d middleOf(const std::vector<Vec3d>& polygon)
{
    Vec3d sum(0.0);
    for (const Vec3d& p : polygon) sum += p;
    return sum / static_cast<double>(polygon.size());
}

bool liesIn(const CellSurface& s, const Vec3d& normal, const CellPlane& plane)
{
    if (normal.dot(plane.normal) < kParallel) return false;
    return std::all_of(s.polygon.begin(), s.polygon.end(), [&plane](const Vec3d& p) {
        return std::abs(plane.normal.dot(p - Vec3d(0.5)) - plane.offset) < kCoplanar;
    });
}

} // namespace

std::vector<CellSurface> clipToCell(
    const Tracer::Impl& impl, const CellFrame& frame, const std::vector<std::uint32_t>& triangles)
{
    std::vector<CellSurface> surfaces;
    const std::size_t step = (triangles.size() + kMaxTriangles - 1) / kMaxTriangles;
    for (std::size_t i = 0; i < triangles.size(); i += step) {
        const Corners t = impl.corners(triangles[i]);
        CellSurface s;
        for (const Vec3f& p : {t.a, t.b, t.c}) s.polygon.push_back(frame.cell(Vec3d(p)));
        // Of the whole triangle: slivers that clipping leaves have no good normal.
        s.normal = areaVector(s.polygon);
        const double length = s.normal.length();
        if (!(length > 0)) continue;
        s.normal /= length;
        for (int a = 0; a < 3; ++a) {
            clip(s.polygon, a, 1, 1 + kGrow);
            clip(s.polygon, a, -1, kGrow);
        }
        if (s.polygon.size() < 3) continue;
        s.area = areaVector(s.polygon).length();
        s.doubleSided = impl.materialOf(triangles[i]).doubleSided;
        if (s.area > kMinArea) surfaces.push_back(std::move(s));
    }
    std::stable_sort(surfaces.begin(), surfaces.end(),
        [](const CellSurface& a, const CellSurface& b) { return a.area > b.area; });
    return surfaces;
}

std::vector<CellPlane> planesOf(const std::vector<CellSurface>& surfaces)
{
    std::vector<CellPlane> planes;
    Vec3d normals(0.0), middle(0.0);
    double area = 0;
    for (const CellSurface& s : surfaces) {
        const Vec3d n = canonical(s.normal), m = middleOf(s.polygon);
        normals += n * s.area;
        middle += m * s.area;
        area += s.area;
        const auto same = std::find_if(planes.begin(), planes.end(),
            [&](const CellPlane& plane) { return liesIn(s, n, plane); });
        const int front = s.doubleSided ? 0 : n.dot(s.normal) > 0 ? 1 : -1;
        if (same != planes.end()) {
            same->area += s.area;
            if (same->front != front) same->front = 0;
        } else if (planes.size() < kMaxPlanes) {
            planes.push_back({n, n.dot(m - Vec3d(0.5)), s.area, front});
        }
    }
    for (CellPlane& plane : planes) plane.offset -= plane.front * kBehind;
    std::stable_sort(planes.begin(), planes.end(),
        [](const CellPlane& a, const CellPlane& b) { return a.area > b.area; });
    if (planes.size() > 1 && normals.length2() > 0) {
        const Vec3d n = canonical(normals.normalized());
        planes.push_back({n, n.dot(middle / area - Vec3d(0.5)), area});
    }
    return planes;
}

} // namespace lumivdb
