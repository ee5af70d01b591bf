// SPDX-License-Identifier: Apache-2.0
#include "directions.h"

#include <lumivdb/core/random.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

Vec2d hilbertPoint(double t)
{
    // Two bits of t a level choose the quadrant; the curve's state is a reflection/transposition
    // that is applied from the finest level up (Lam & Shapiro 1994).
    constexpr int kLevels = 20;
    constexpr double kScale = static_cast<double>(std::uint64_t{1} << (2 * kLevels));
    const auto d = static_cast<std::uint64_t>(t * kScale);
    double x = 0.5, y = 0.5;
    double size = 1;
    for (int level = 0; level < kLevels; ++level) {
        const auto rx = static_cast<int>(d >> (2 * level + 1) & 1);
        const auto ry = static_cast<int>((d >> (2 * level) ^ static_cast<unsigned>(rx)) & 1);
        if (ry == 0) {
            if (rx == 1) {
                x = size - x;
                y = size - y;
            }
            std::swap(x, y);
        }
        x += size * rx;
        y += size * ry;
        size *= 2;
    }
    return {x / size, y / size};
}

Vec3d squareToSphere(const Vec2d& uv)
{
    const double u = 2 * uv.x - 1, v = 2 * uv.y - 1;
    const double au = std::abs(u), av = std::abs(v);
    const double signedDistance = 1 - (au + av);
    const double r = 1 - std::abs(signedDistance);
    const double phi = (r == 0 ? 1 : (av - au) / r + 1) * (3.14159265358979323846 / 4);
    const double z = std::copysign(1 - r * r, signedDistance);
    const double s = r * std::sqrt(std::max(0.0, 2 - r * r));
    return {std::copysign(std::cos(phi) * s, u), std::copysign(std::sin(phi) * s, v), z};
}

Vec2f sphereToSquare(const Vec3f& d)
{
    const float r = std::sqrt(std::max(0.0f, 1 - std::abs(d.z)));
    const float ax = std::abs(d.x), ay = std::abs(d.y), most = std::max(ax, ay);
    // 2/π · atan of the smaller over the larger (Abramowitz & Stegun 4.4.49, error 1e-5).
    const float q = most > 0 ? std::min(ax, ay) / most : 0.0f, q2 = q * q;
    const float angle = q * 0.636619772f
        * (0.9998660f
            + q2 * (-0.3302995f + q2 * (0.1801410f + q2 * (-0.0851330f + q2 * 0.0208351f))));
    float v = r * (ay > ax ? 1 - angle : angle);
    float u = r - v;
    if (d.z < 0) {
        const float folded = 1 - v;
        v = 1 - u;
        u = folded;
    }
    return {0.5f + 0.5f * std::copysign(u, d.x), 0.5f + 0.5f * std::copysign(v, d.y)};
}

double jitteredStratum(std::uint64_t seed, std::uint64_t i, std::uint64_t count)
{
    CounterRng rng(hashCombine(mixBits(seed), i));
    const double t = (static_cast<double>(i) + rng.nextDouble()) / static_cast<double>(count);
    return std::min(t, 0x1.fffffffffffffp-1);
}

std::vector<Vec3f> stratifiedDirections(std::uint64_t seed, int count)
{
    std::vector<Vec3f> directions(static_cast<std::size_t>(count));
    for (std::size_t i = 0; i < directions.size(); ++i) {
        const double t = jitteredStratum(seed, i, directions.size());
        directions[i] = Vec3f(squareToSphere(hilbertPoint(t)));
    }
    return directions;
}

} // namespace lumivdb
