// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "directions.h"

#include <cmath>

namespace lumivdb {

/// Barycentrics of b and c, uniform over the triangle and with little distortion (Heitz, "A
/// Low-Distortion Map Between Triangle and Square", 2019).
inline Vec2f squareToTriangle(const Vec2d& square)
{
    auto u = static_cast<float>(square.x), v = static_cast<float>(square.y);
    if (v > u) {
        u *= 0.5f;
        v -= u;
    } else {
        v *= 0.5f;
        u -= v;
    }
    return {u, v};
}

template <class Emission>
EmitterSample EmitterTable::sampleStratum(
    const Vec3f& from, double t, const Emission& emission) const
{
    const std::size_t chosen = choose(t);
    const Vec2d square = hilbertPoint(t);
    return samplePoint(chosen, from, square.x, square.y, emission);
}

template <class Emission>
EmitterSample EmitterTable::sample(
    const Vec3f& from, double t, double u, double v, const Emission& emission) const
{
    const std::int64_t texel = environmentTexel(t);
    if (texel >= 0) return sampleEnvironmentTexel(texel, u, v);
    return samplePoint(choose(t), from, u, v, emission);
}

template <class Emission>
EmitterSample EmitterTable::samplePoint(std::size_t chosen, const Vec3f& from, double squareU,
    double squareV, const Emission& emission) const
{
    if (chosen == mTriangles.size()) return sampleEnvironment(squareU, squareV);

    const Vec2f place = squareToTriangle({squareU, squareV});
    const float u = place.x, v = place.y;
    const Triangle& e = mTriangles[chosen];
    EmitterSample s;
    Vec3f point = e.a + e.ab * u + e.ac * v;
    const float facing = e.normal.dot(from - point);
    if (facing == 0 || (facing < 0 && !e.doubleSided)) return s;
    point += e.normal * (facing > 0 ? e.offset : -e.offset);
    const Vec3d d = Vec3d(point) - Vec3d(from);
    const double distance2 = d.length2();
    if (!(distance2 > 0)) return s;
    s.direction = Vec3f(d * (1 / std::sqrt(distance2)));
    s.target = point;
    s.normal = e.normal;
    const double cosine = std::abs(static_cast<double>(e.normal.dot(s.direction)));
    if (!(cosine > 0)) return s;
    s.pdf = e.probability / e.area * distance2 / cosine;
    s.radiance = emission(e.triangle, u, v);
    return s;
}

} // namespace lumivdb
