// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "directions.h"

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
EmitterPoint EmitterTable::sampleStratum(
    const Receiver& to, double t, const Emission& emission) const
{
    const Choice choice = choose(to, t);
    const Vec2d square = hilbertPoint(t);
    return samplePoint(choice, to, square.x, square.y, emission);
}

template <class Emission>
EmitterPoint EmitterTable::sampleElsewhere(
    const Receiver& to, double t, double u, double v, const Emission& emission) const
{
    const Choice choice = choose(to, t);
    return samplePoint(choice, to, u, v, emission);
}

template <class Emission>
EmitterPoint EmitterTable::samplePoint(const Choice& choice, const Receiver& to, double squareU,
    double squareV, const Emission& emission) const
{
    if (!(choice.probability > 0)) return {};
    if (choice.emitter >= mTriangles.size()) {
        const bool sun = choice.emitter == mTriangles.size();
        return environmentSample(to,
            sun ? mEnvironment->sampleSun(squareU, squareV)
                : mEnvironment->sampleSky(squareU, squareV));
    }
    const Vec2f at = squareToTriangle({squareU, squareV});
    const Triangle& e = mTriangles[choice.emitter];
    EmitterPoint s;
    s.place = e.a + e.ab * at.x + e.ac * at.y;
    s.normal = e.normal;
    s.offset = e.offset;
    s.twoSided = e.doubleSided;
    s.density = static_cast<float>(choice.probability / e.area);
    s.radiance = emission(e.triangle, at.x, at.y);
    return s;
}

} // namespace lumivdb
