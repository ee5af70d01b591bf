// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file gradient_fixture.h
/// Gradients of many seeds, their mean and its standard error; closed forms to hold them against.

#include "bake_makers.h"

#include <catch2/catch.hpp>

#include <functional>
#include <vector>

namespace lumivdb::test {

inline ProbeOptions withRays(int rays)
{
    ProbeOptions o;
    o.rays = rays;
    return o;
}

/// A function of the place that is known exactly, e.g. one coefficient.
using ClosedForm = std::function<double(const Vec3d& p)>;

/// Its derivative along @a axis, by a central difference in double precision.
inline double derivative(const ClosedForm& f, const Vec3d& p, int axis, double step = 1e-4)
{
    Vec3d d(0.0);
    d[axis] = step;
    return (f(p + d) - f(p - d)) / (2 * step);
}

/// Mean of the red channel of independent gradients, and the standard error of that mean.
struct MeanGradient {
    std::vector<double> mean, error; // [axis · coefficients + coefficient]
    int coefficients = 0;
    double at(int axis, int k) const { return mean[index(axis, k)]; }
    double errorAt(int axis, int k) const { return error[index(axis, k)]; }
    double norm() const
    {
        double sum = 0;
        for (const double m : mean) sum += m * m;
        return std::sqrt(sum);
    }

private:
    std::size_t index(int axis, int k) const
    {
        return static_cast<std::size_t>(axis * coefficients + k);
    }
};

inline MeanGradient meanOf(const std::vector<std::vector<Color>>& runs)
{
    MeanGradient m;
    const std::size_t n = runs[0].size();
    m.coefficients = static_cast<int>(n / 3);
    for (std::size_t i = 0; i < n; ++i) {
        double sum = 0, sum2 = 0;
        for (const auto& run : runs) {
            const double v = static_cast<double>(run[i].x);
            sum += v;
            sum2 += v * v;
        }
        const auto count = static_cast<double>(runs.size());
        const double mean = sum / count;
        m.mean.push_back(mean);
        m.error.push_back(std::sqrt(std::max(0.0, sum2 / count - mean * mean) / (count - 1)));
    }
    return m;
}

/// Analytic gradients at @a p under @a runs seeds.
inline MeanGradient analyticGradient(
    const Tracer& tracer, ProbeOptions options, const Vec3d& p, int bands, int runs)
{
    std::vector<std::vector<Color>> gradients;
    for (int i = 0; i < runs; ++i) {
        options.seed = static_cast<std::uint64_t>(i) + 1;
        const ProbeEstimator estimator(tracer, options);
        ProbeEstimator::Workspace workspace;
        gradients.push_back(estimator.radianceSh(p, bands, options.seed, workspace, true).gradient);
    }
    return meanOf(gradients);
}

/// Central differences of step @a delta under @a runs seeds.
inline MeanGradient centralMean(
    const Tracer& tracer, ProbeOptions options, const Vec3d& p, int bands, double delta, int runs)
{
    std::vector<std::vector<Color>> gradients;
    for (int i = 0; i < runs; ++i) {
        options.seed = static_cast<std::uint64_t>(i) + 1001;
        const ProbeEstimator estimator(tracer, options);
        ProbeEstimator::Workspace workspace;
        ProbeResult r;
        centralGradient(tracer, estimator, p, bands, 8 * delta, options.seed, workspace, r);
        gradients.push_back(r.gradient);
    }
    return meanOf(gradients);
}

/// ∫ dω over a triangle seen from @a p, signed by its winding (Van Oosterom & Strackee 1983).
inline double triangleSolidAngle(const Vec3d& p, const Vec3d& a, const Vec3d& b, const Vec3d& c)
{
    const Vec3d x = (a - p).normalized(), y = (b - p).normalized(), z = (c - p).normalized();
    return 2 * std::atan2(x.dot(y.cross(z)), 1 + x.dot(y) + y.dot(z) + z.dot(x));
}

/// ∫ Y_k dω over a convex polygon for k < 4: its solid angle, and its vector irradiance by
/// Lambert's formula, ∫ ω dω = ½ Σ Γ_i.
inline double polygonCoefficient(const Vec3d& p, const std::vector<Vec3d>& polygon, int k)
{
    double solidAngle = 0;
    Vec3d vector(0.0);
    for (std::size_t i = 0; i < polygon.size(); ++i) {
        const Vec3d a = (polygon[i] - p).normalized();
        const Vec3d b = (polygon[(i + 1) % polygon.size()] - p).normalized();
        if (i > 0 && i + 1 < polygon.size()) {
            solidAngle += triangleSolidAngle(p, polygon[0], polygon[i], polygon[i + 1]);
        }
        vector += a.cross(b).normalized() * (0.5 * std::acos(std::min(1.0, a.dot(b))));
    }
    if (vector.dot(polygon[0] - p) < 0) vector = -vector;
    const double y1 = 0.48860251190291992;
    const double values[4] = {
        0.28209479177387814 * std::abs(solidAngle), -y1 * vector.y, y1 * vector.z, -y1 * vector.x};
    return values[k];
}

/// Every derivative of the four first coefficients lies within four standard errors of the closed
/// form, and a bias of @a bias of the largest derivative; standard errors stay below @a noise of
/// it.
inline void checkClosedForm(const MeanGradient& g, const Vec3d& p,
    const std::function<double(const Vec3d&, int)>& form, double bias, double noise, double step)
{
    double largest = 0;
    for (int axis = 0; axis < 3; ++axis) {
        for (int k = 0; k < 4; ++k) {
            const auto f = [&](const Vec3d& q) { return form(q, k); };
            largest = std::max(largest, std::abs(derivative(f, p, axis, step)));
        }
    }
    for (int axis = 0; axis < 3; ++axis) {
        for (int k = 0; k < 4; ++k) {
            const auto f = [&](const Vec3d& q) { return form(q, k); };
            const double expected = derivative(f, p, axis, step);
            const double value = g.at(axis, k), error = g.errorAt(axis, k);
            CAPTURE(axis, k, value, error, expected, largest);
            CHECK(std::abs(value - expected) <= 4 * error + bias * largest);
            CHECK(error <= noise * largest);
        }
    }
}

} // namespace lumivdb::test
