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
    const Receiver& to, double t, const Emission& emission) const
{
    const Choice choice = choose(to, t);
    const Vec2d square = hilbertPoint(t);
    return samplePoint(choice, to, square.x, square.y, emission);
}

template <class Emission>
EmitterSample EmitterTable::sample(
    const Receiver& to, double t, double u, double v, const Emission& emission) const
{
    const std::int64_t texel = skyTexel(to, t);
    if (texel >= 0) return sampleSkyTexel(to, texel, u, v);
    const Choice choice = choose(to, t);
    return samplePoint(choice, to, u, v, emission);
}

template <class Emission>
EmitterSample EmitterTable::samplePoint(const Choice& choice, const Receiver& to, double squareU,
    double squareV, const Emission& emission) const
{
    if (!(choice.probability > 0)) return {};
    if (choice.emitter >= mTriangles.size()) {
        const bool sun = choice.emitter == mTriangles.size();
        return environmentSample(to,
            sun ? mEnvironment->sampleSun(squareU, squareV)
                : mEnvironment->sampleSky(squareU, squareV));
    }
    const Vec3f from = to.position;
    const Vec2f place = squareToTriangle({squareU, squareV});
    const float u = place.x, v = place.y;
    const Triangle& e = mTriangles[choice.emitter];
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
    s.pdf = choice.probability / e.area * distance2 / cosine;
    s.radiance = emission(e.triangle, u, v);
    return s;
}

} // namespace lumivdb
