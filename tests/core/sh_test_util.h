// SPDX-License-Identifier: Apache-2.0
#pragma once

// What the tests of spherical harmonics share. Written apart from the library's own code: the
// quadrature, the rotations and the reference basis here use none of it.

#include <lumivdb/core/random.h>
#include <lumivdb/core/sh.h>

#include <cmath>
#include <cstddef>
#include <vector>

namespace sh_test {

using lumivdb::CounterRng;
using lumivdb::Mat3d;
using lumivdb::Vec3d;

constexpr double kPi = 3.14159265358979323846;

struct Node {
    Vec3d d;
    double weight; // sr
};

/// Gauss–Legendre in z with @a n nodes times 2n steps in φ: exact for polynomials on the sphere of
/// degree ≤ 2n − 1.
inline std::vector<Node> sphereRule(int n)
{
    std::vector<Node> nodes;
    for (int a = 1; a <= n; ++a) {
        long double z = std::cos(3.14159265358979323846L * (a - 0.25L) / (n + 0.5L));
        long double slope = 0;
        for (int step = 0; step < 10; ++step) {
            // std::legendre is C++17's; P_n' = n (z P_n − P_{n−1}) / (z² − 1).
            const long double p = std::legendre(static_cast<unsigned>(n), z);
            const long double q = std::legendre(static_cast<unsigned>(n - 1), z);
            slope = n * (z * p - q) / (z * z - 1);
            z -= p / slope;
        }
        const long double r = std::sqrt(1 - z * z);
        const double w = static_cast<double>(2 / (r * r * slope * slope)) * kPi / n;
        for (int b = 0; b < 2 * n; ++b) {
            const double phi = kPi * (b + 0.5) / n;
            nodes.push_back({Vec3d(static_cast<double>(r) * std::cos(phi),
                                 static_cast<double>(r) * std::sin(phi), static_cast<double>(z)),
                w});
        }
    }
    return nodes;
}

inline Vec3d randomDirection(CounterRng& rng)
{
    const double z = 2.0 * rng.nextDouble() - 1.0;
    const double phi = 2.0 * kPi * rng.nextDouble();
    const double r = std::sqrt(1.0 - z * z);
    return Vec3d(r * std::cos(phi), r * std::sin(phi), z);
}

/// Rotation by @a angle about unit @a axis as a matrix for row vectors (Rodrigues, transposed).
inline Mat3d rotationAbout(const Vec3d& axis, double angle)
{
    const double c = std::cos(angle);
    const double s = std::sin(angle);
    const double t = 1.0 - c;
    const double x = axis.x, y = axis.y, z = axis.z;
    return Mat3d(t * x * x + c, t * x * y + s * z, t * x * z - s * y, //
        t * x * y - s * z, t * y * y + c, t * y * z + s * x, //
        t * x * z + s * y, t * y * z - s * x, t * z * z + c);
}

inline Mat3d randomRotation(CounterRng& rng)
{
    const Vec3d axis = randomDirection(rng);
    return rotationAbout(axis, 2.0 * kPi * rng.nextDouble());
}

/// @a count values, uniform in [−1, 1).
inline std::vector<double> randomCoefficients(CounterRng& rng, int count)
{
    std::vector<double> c(static_cast<std::size_t>(count));
    for (double& v : c) v = 2.0 * rng.nextDouble() - 1.0;
    return c;
}

/// Radiance coefficients of a distant light from @a towards that gives irradiance 1 (per channel)
/// on a surface that faces it: L_lm = ∫ δ(ω − s) Y_lm = Y_lm(s).
inline std::vector<lumivdb::Color> distantLight(int bands, const Vec3d& towards)
{
    double y[lumivdb::kMaxCoefficients];
    lumivdb::evalShBasis(bands, towards, y);
    std::vector<lumivdb::Color> L;
    for (int i = 0; i < lumivdb::coefficientCount(bands); ++i)
        L.emplace_back(static_cast<float>(y[i]));
    return L;
}

} // namespace sh_test
