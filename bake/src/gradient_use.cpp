// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/probe.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

std::uint64_t centralGradient(const Tracer& tracer, const ProbeEstimator& estimator, const Vec3d& p,
    int bands, double spacing, std::uint64_t key, ProbeEstimator::Workspace& workspace,
    ProbeResult& result)
{
    double delta = spacing / 8, nearest = 0;
    if (tracer.closestSurface(p, 2 * delta, &nearest, nullptr)) {
        delta = std::min(delta, std::max(0.5 * nearest, 1e-4 * spacing));
    }
    const auto n = static_cast<std::size_t>(coefficientCount(bands));
    result.gradient.resize(3 * n);
    std::uint64_t traced = 0;
    for (int axis = 0; axis < 3; ++axis) {
        Vec3d step(0.0);
        step[axis] = delta;
        const ProbeResult plus = estimator.radianceSh(p + step, bands, key, workspace);
        const ProbeResult minus = estimator.radianceSh(p - step, bands, key, workspace);
        for (std::size_t k = 0; k < n; ++k) {
            result.gradient[static_cast<std::size_t>(axis) * n + k]
                = (plus.value[k] - minus.value[k]) * static_cast<float>(0.5 / delta);
        }
        traced += plus.rays + minus.rays;
    }
    return traced;
}

// Measured on Cornell, the samples and Sponza, near surfaces and away from them, with cells of a
// twentieth to an eighth of the room: the harmonic mean distance is what tells good gradients from
// bad ones. Limits by the size of the change, which were tried as well, also take from gradients
// that are right, and the smallest distance, which one thin thing nearby decides, does so more.
float gradientFactor(double distance, double reach)
{
    constexpr double kReach = 0.7; // valid so far, in harmonic mean distances
    const double valid = kReach * distance;
    return static_cast<float>(valid < reach ? valid / reach : 1.0);
}

void limitGradient(double reach, ProbeResult& result)
{
    const float factor = gradientFactor(static_cast<double>(result.distance), reach);
    for (Color& c : result.gradient) {
        c *= factor;
        if (!std::isfinite(c.x) || !std::isfinite(c.y) || !std::isfinite(c.z)) c = Color(0.0f);
    }
}

} // namespace lumivdb
