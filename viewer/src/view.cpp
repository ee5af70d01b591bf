// SPDX-License-Identifier: Apache-2.0
#include "view.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/core/error.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kDefaultFov = 50;

View lookAt(const Vec3d& eye, const Vec3d& target, double yfov, double aspect)
{
    View view;
    view.eye = eye;
    view.focus = (target - eye).length();
    if (!(view.focus > 0) || !std::isfinite(view.focus))
        throw Error(ErrorCode::Usage,
            "The camera's eye and target are the same point or not finite; give two points.");
    view.forward = (target - eye) / view.focus;
    // Straight up or down, −Z is the upper edge, as on a map.
    const bool vertical = std::abs(view.forward.y) > 0.99999;
    const Vec3d guide = vertical ? Vec3d(0, 0, -1) : Vec3d(0, 1, 0);
    view.right = view.forward.cross(guide).normalized();
    view.up = view.right.cross(view.forward);
    view.tanY = std::tan(yfov / 2);
    view.tanX = view.tanY * aspect;
    return view;
}

/// What a ray shows to somebody who judges a view.
struct Glimpse {
    double hits = 0; ///< share of rays that met a surface
    double fronts = 0; ///< share that met one with something to show, not a black back
    double depth = 0; ///< mean distance of those, the others counting 0
};

bool showsSomething(const SurfaceHit& h)
{
    return h.hit && !(h.backFace && luminance(h.albedo) == 0 && luminance(h.emission) == 0);
}

Glimpse judge(const Tracer& tracer, const View& view)
{
    constexpr int kColumns = 16, kRows = 9;
    Glimpse g;
    for (int j = 0; j < kRows; ++j) {
        for (int i = 0; i < kColumns; ++i) {
            const Vec3d d = view.direction((i + 0.5) / kColumns, (j + 0.5) / kRows);
            const SurfaceHit h = tracer.intersect(view.eye, d);
            g.hits += h.hit;
            if (!showsSomething(h)) continue;
            g.fronts += 1;
            g.depth += h.distance;
        }
    }
    const double n = kColumns * kRows;
    return {g.hits / n, g.fronts / n, g.depth / n};
}

/// Share of the rays from the centre to points of the box's face (axis, side) that get there.
double openness(const Tracer& tracer, const Box3d& box, int axis, int side)
{
    constexpr int kGrid = 6;
    const Vec3d centre = box.center();
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    int open = 0;
    for (int j = 0; j < kGrid; ++j) {
        for (int i = 0; i < kGrid; ++i) {
            Vec3d p;
            p[axis] = side ? box.max[axis] : box.min[axis];
            p[u] = box.min[u] + box.size()[u] * (i + 0.5) / kGrid;
            p[v] = box.min[v] + box.size()[v] * (j + 0.5) / kGrid;
            const Vec3d beyond = centre + (p - centre) * 1.05;
            open += !tracer.occluded(centre, beyond);
        }
    }
    return open / double(kGrid * kGrid);
}

/// Moves the eye back along the view until the whole box is in the picture.
void fitBox(View& view, const Box3d& box, double margin)
{
    const Vec3d centre = box.center();
    double distance = 0;
    for (int i = 0; i < 8; ++i) {
        const Vec3d p(i & 1 ? box.max.x : box.min.x, i & 2 ? box.max.y : box.min.y,
            i & 4 ? box.max.z : box.min.z);
        const Vec3d q = p - centre;
        const double toward = -q.dot(view.forward);
        distance = std::max({distance, toward + std::abs(q.dot(view.right)) / view.tanX,
            toward + std::abs(q.dot(view.up)) / view.tanY});
    }
    view.focus = distance * margin;
    view.eye = centre - view.forward * view.focus;
}

/// A box with one open vertical side is looked into through that side, whose frame fills the view.
bool lookThroughOpenSide(
    const Tracer& tracer, const Box3d& box, double yfov, double aspect, View& view)
{
    int openSides = 0, axis = 0, side = 0;
    for (int a : {0, 2}) {
        for (int s = 0; s < 2; ++s) {
            if (openness(tracer, box, a, s) < 0.75) continue;
            ++openSides;
            axis = a;
            side = s;
        }
    }
    if (openSides != 1 || openness(tracer, box, 1, 1) > 0.25) return false;
    Vec3d outward(0, 0, 0);
    outward[axis] = side ? 1 : -1;
    view = lookAt(box.center() + outward, box.center(), yfov, aspect);
    fitBox(view, box, 1.03);
    return judge(tracer, view).fronts > 0.2;
}

/// Eye inside near one end, looking along the longest horizontal axis: of a few such places the one
/// that sees farthest.
View lookFromInside(const Tracer& tracer, const Box3d& box, double yfov, double aspect)
{
    const Vec3d size = box.size();
    const int along = size.x >= size.z ? 0 : 2;
    const int across = 2 - along;
    const double clearance = 0.02 * std::min({size.x, size.y, size.z});
    View best;
    double bestScore = -1;
    for (double height : {0.33, 0.25, 0.45}) {
        for (double lateral : {0.5, 0.4, 0.6, 0.25, 0.75}) {
            for (double start : {0.06, 0.12, 0.2, 0.3, 0.7, 0.8, 0.88, 0.94}) {
                Vec3d eye, target;
                eye[along] = box.min[along] + size[along] * start;
                eye[across] = box.min[across] + size[across] * lateral;
                eye.y = box.min.y + size.y * height;
                target = eye;
                target[along] = box.center()[along] + size[along] * (start < 0.5 ? 0.25 : -0.25);
                target[across] = box.center()[across];
                const View view = lookAt(eye, target, yfov, aspect);
                double distance;
                Vec3d normal;
                if (tracer.closestSurface(eye, clearance, &distance, &normal)) continue;
                const Glimpse g = judge(tracer, view);
                // Far views win, but not those that look out into nothing or at black backs.
                const double score = g.depth * g.fronts * g.fronts;
                if (score <= bestScore * 1.02) continue;
                bestScore = score;
                best = view;
            }
        }
    }
    if (bestScore < 0) best = lookAt(box.center(), box.center() + Vec3d(0, 0, -1), yfov, aspect);
    best.focus = 0.4 * size[along];
    return best;
}

/// From outside at @a elevation degrees above the horizon, from the direction that sees most
/// fronts.
View lookFromOutside(const Tracer& tracer, const Box3d& box, double elevation, double yfov,
    double aspect, double* score)
{
    View best;
    *score = -1;
    const double height = std::sin(elevation * kPi / 180), level = std::cos(elevation * kPi / 180);
    for (int k = 0; k < 8; ++k) {
        // Three-quarter views first: they show depth, and win ties.
        const double azimuth = (45 + 90 * (k % 4) + (k < 4 ? 0 : 45)) * kPi / 180;
        const Vec3d d(level * std::cos(azimuth), height, level * std::sin(azimuth));
        View view = lookAt(box.center() + d, box.center(), yfov, aspect);
        fitBox(view, box, 1.0);
        const double fronts = judge(tracer, view).fronts;
        if (fronts <= *score * 1.05) continue;
        *score = fronts;
        best = view;
    }
    return best;
}

/// Steeper only where that shows much more: into a court behind walls.
View lookFromAbove(const Tracer& tracer, const Box3d& box, double yfov, double aspect)
{
    double bestScore, score;
    View best = lookFromOutside(tracer, box, 28, yfov, aspect, &bestScore);
    for (double elevation : {45.0, 65.0}) {
        const View view = lookFromOutside(tracer, box, elevation, yfov, aspect, &score);
        if (score < 1.25 * bestScore) continue;
        bestScore = score;
        best = view;
    }
    return best;
}

View viewOfBounds(const Tracer& tracer, const Box3d& box, double yfov, double aspect)
{
    View view;
    if (lookThroughOpenSide(tracer, box, yfov, aspect, view)) return view;
    constexpr int kRays = 128;
    int hits = 0;
    for (const Vec3f& d : uniformNormals(kRays))
        hits += tracer.intersect(box.center(), Vec3d(d.x, d.y, d.z)).hit;
    if (hits >= 0.75 * kRays) return lookFromInside(tracer, box, yfov, aspect);
    return lookFromAbove(tracer, box, yfov, aspect);
}

View fromSceneCamera(const Tracer& tracer, const Camera& camera, double yfov, double aspect)
{
    const Mat4d& m = camera.cameraToWorld;
    const Vec3d eye(m[3][0], m[3][1], m[3][2]);
    View view = lookAt(eye, eye - Vec3d(m[2][0], m[2][1], m[2][2]), yfov, aspect);
    // The node's own roll, not the horizon.
    const Vec3d up(m[1][0], m[1][1], m[1][2]);
    view.right = view.forward.cross(up).normalized();
    view.up = view.right.cross(view.forward);
    const SurfaceHit h = tracer.intersect(eye, view.forward);
    const Box3d box = tracer.scene().bounds();
    const double toCentre = box.isEmpty() ? 1.0 : (box.center() - eye).dot(view.forward);
    view.focus = toCentre > 0 ? toCentre : 1.0;
    if (h.hit) view.focus = std::min(view.focus, 0.95 * h.distance);
    return view;
}

} // namespace

View chooseView(const Tracer& tracer, const Box3d& volumeBounds, const PictureOptions& options)
{
    const double aspect = double(options.width) / options.height;
    const bool own = options.yfovDegrees > 0;
    const double yfov = (own ? options.yfovDegrees : kDefaultFov) * kPi / 180;
    Box3d box = tracer.scene().bounds();
    if (box.isEmpty()) box = volumeBounds;
    if (box.isEmpty())
        throw Error(ErrorCode::Usage,
            "Neither the scene nor the volume has an extent to look at; give eye and target.");
    if (options.eye) {
        const Vec3d target = options.target ? *options.target : box.center();
        return lookAt(*options.eye, target, yfov, aspect);
    }
    View view;
    if (!tracer.scene().cameras.empty()) {
        const Camera& camera = tracer.scene().cameras.front();
        view = fromSceneCamera(tracer, camera, own ? yfov : camera.yfov, aspect);
    } else {
        view = viewOfBounds(tracer, box, yfov, aspect);
    }
    // A target alone turns the default eye.
    if (options.target) view = lookAt(view.eye, *options.target, 2 * std::atan(view.tanY), aspect);
    return view;
}

} // namespace lumivdb
