// SPDX-License-Identifier: Apache-2.0
#include "spheres.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

/// Seen from the eye and inside the volume with light to show.
bool isSeen(const Tracer& tracer, const VolumeSampler& sampler, const View& view, const Vec3d& p)
{
    Color L[kMaxCoefficients];
    const QueryInfo info = sampler.radiance(p, L);
    return info.level >= 0 && info.validity >= kValidThreshold && !tracer.occluded(view.eye, p);
}

bool isClear(const Tracer& tracer, const Sphere& sphere)
{
    double distance;
    Vec3d normal;
    return !tracer.closestSurface(sphere.centre, 1.05 * sphere.radius, &distance, &normal);
}

/// A line across the view at one depth (a plane, not a circle about the eye) and height.
struct Line {
    const View& view;
    double depth, t;
    Vec3d at(double s) const
    {
        const Vec3d d = view.direction(s, t);
        return view.eye + d * (depth / d.dot(view.forward));
    }
    double width() const { return 2 * depth * view.tanX; }
};

/// The part of the line between the outermost places that could show a sphere.
bool usablePart(const Tracer& tracer, const VolumeSampler& sampler, const Line& line, double* first,
    double* last)
{
    constexpr int kSteps = 80;
    *first = 1;
    *last = 0;
    for (int i = 0; i <= kSteps; ++i) {
        const double s = 0.1 + 0.8 * i / kSteps;
        if (!isSeen(tracer, sampler, line.view, line.at(s))) continue;
        *first = std::min(*first, s);
        *last = s;
    }
    return *first < *last;
}

std::vector<Sphere> rowOn(
    const Tracer& tracer, const VolumeSampler& sampler, const Line& line, int count)
{
    std::vector<Sphere> row;
    double first, last;
    if (!usablePart(tracer, sampler, line, &first, &last)) return row;
    const double pitch = (last - first) / count;
    const double radius = std::min(0.04, 0.4 * pitch) * line.width();
    for (int i = 0; i < count; ++i) {
        const Sphere sphere{line.at(first + (i + 0.5) * pitch), radius};
        if (isSeen(tracer, sampler, line.view, sphere.centre) && isClear(tracer, sphere))
            row.push_back(sphere);
    }
    return row;
}

} // namespace

double Sphere::intersect(const Vec3d& origin, const Vec3d& direction) const
{
    const Vec3d toCentre = centre - origin;
    const double along = toCentre.dot(direction);
    const double miss2 = (toCentre - direction * along).length2();
    const double half2 = radius * radius - miss2;
    if (half2 < 0) return -1;
    const double t = along - std::sqrt(half2);
    return t > 0 ? t : -1;
}

std::vector<Sphere> placeSpheres(
    const Tracer& tracer, const VolumeSampler& sampler, const View& view, int count)
{
    std::vector<Sphere> best;
    double bestScore = 0;
    if (count == 0) return best;
    const double full = count * std::min(0.04, 0.32 / count);
    constexpr double kGood = 0.75; // good enough to stay near the focus
    for (double factor : {1.0, 0.85, 0.7, 0.55, 0.45, 0.35, 0.25, 0.15, 1.15, 1.3}) {
        // A little below the middle first, off the vanishing point of most views.
        for (double t : {0.58, 0.7, 0.42, 0.3}) {
            const Line line{view, view.focus * factor, t};
            std::vector<Sphere> row = rowOn(tracer, sampler, line, count);
            if (row.empty()) continue;
            // Many and large.
            const double score = double(row.size()) * row.front().radius / line.width();
            if (score <= 1.001 * bestScore) continue;
            bestScore = score;
            best = std::move(row);
            if (bestScore >= kGood * full) return best;
        }
    }
    return best;
}

} // namespace lumivdb
