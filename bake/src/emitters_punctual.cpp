// SPDX-License-Identifier: Apache-2.0
#include "emitters.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;

LightBound boundOf(const Light& light, const Vec3f& position)
{
    LightBound b;
    b.intensity = luminance(light.intensity);
    b.lower = b.upper = position;
    b.axis = Vec3f(light.direction);
    if (light.range > 0) b.range = static_cast<float>(light.range);
    switch (light.type) {
    case LightType::Point:
        b.spread = static_cast<float>(kPi);
        break;
    case LightType::Spot:
        b.spread = static_cast<float>(std::min(light.innerConeAngle, light.outerConeAngle));
        b.reach = static_cast<float>(
            std::clamp(light.outerConeAngle - light.innerConeAngle, 0.001, 0.5 * kPi));
        break;
    case LightType::Directional:
        b.infinite = true;
        break;
    }
    return b;
}

} // namespace

PunctualTable::PunctualTable(const std::vector<Light>& lights, const Vec3d& origin)
    : mLights(&lights)
{
    std::vector<LightBound> bounds;
    for (const Light& light : lights) {
        mPositions.push_back(Vec3f(light.position - origin));
        bounds.push_back(boundOf(light, mPositions.back()));
    }
    if (lights.size() > kWeighedLights) mTree = LightTree(bounds);
}

PunctualSample PunctualTable::at(std::size_t light, const Vec3f& to) const
{
    return samplePunctual((*mLights)[light], mPositions[light], to);
}

bool PunctualTable::sample(const Receiver& to, double t, PunctualSample& light) const
{
    if (empty()) return false;
    if (mTree.empty()) return sampleWeighed(to, t, light);
    const LightTree::Choice choice = mTree.choose(to, t);
    if (!(choice.probability > 0)) return false;
    light = at(choice.light, to.position);
    light.irradiance *= static_cast<float>(1 / choice.probability);
    return to.normal.dot(light.direction) > 0;
}

bool PunctualTable::sampleWeighed(const Receiver& to, double t, PunctualSample& light) const
{
    if (mPositions.size() == 1) {
        light = at(0, to.position);
        return to.normal.dot(light.direction) > 0 && luminance(light.irradiance) > 0;
    }
    float weights[kWeighedLights];
    float total = 0;
    for (std::size_t i = 0; i < mPositions.size(); ++i) {
        const PunctualSample candidate = at(i, to.position);
        weights[i]
            = std::max(0.0f, to.normal.dot(candidate.direction)) * luminance(candidate.irradiance);
        total += weights[i];
    }
    if (!(total > 0) || !std::isfinite(total)) return false;
    double target = t * total;
    std::size_t chosen = mPositions.size();
    for (std::size_t i = 0; i < mPositions.size(); ++i) {
        if (!(weights[i] > 0)) continue;
        chosen = i;
        target -= weights[i];
        if (target < 0) break;
    }
    light = at(chosen, to.position);
    light.irradiance *= total / weights[chosen];
    return true;
}

} // namespace lumivdb
