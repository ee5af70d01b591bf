// SPDX-License-Identifier: Apache-2.0
#include "emitters.h"

#include <algorithm>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kAlmostOne = 0x1.fffffffffffffp-1;

LightBound boundOf(const EmitterTable::Triangle& t)
{
    LightBound b;
    const Vec3f corners[3] = {t.a, t.a + t.ab, t.a + t.ac};
    for (int i = 0; i < 3; ++i) {
        b.lower[i] = std::min({corners[0][i], corners[1][i], corners[2][i]});
        b.upper[i] = std::max({corners[0][i], corners[1][i], corners[2][i]});
    }
    b.axis = t.normal;
    b.twoSided = t.doubleSided;
    b.intensity = t.power / (kPi * (t.doubleSided ? 2 : 1));
    return b;
}

} // namespace

int EmitterTable::add(const Triangle& triangle)
{
    mTriangles.push_back(triangle);
    return static_cast<int>(mTriangles.size()) - 1;
}

void EmitterTable::finish(std::shared_ptr<const Environment> environment)
{
    mEnvironment = std::move(environment);
    const bool environmentLit = mEnvironment && mEnvironment->power() > 0;
    double trianglePower = 0;
    for (const Triangle& t : mTriangles) trianglePower += t.power;
    mCdf.clear();
    if (!environmentLit && !(trianglePower > 0)) return;
    // Which of the two lights a place is anyone's guess (a lamp in a closed room under a bright
    // sky): equal shares bound what a wrong guess costs.
    mEnvironmentProbability = !environmentLit ? 0 : trianglePower > 0 ? 0.5 : 1;
    double sum = 0;
    for (Triangle& t : mTriangles) {
        t.probability
            = trianglePower > 0 ? t.power / trianglePower * (1 - mEnvironmentProbability) : 0.0;
        sum += t.probability;
        mCdf.push_back(sum);
    }
    if (environmentLit) {
        mPerEnvironmentProbability = 1 / mEnvironmentProbability;
        mEnvironmentStart = mCdf.empty() ? 0.0 : mCdf.back();
    }
    mCdf.push_back(1.0);
    // Rounding must not leave a gap at the end that nothing owns.
    if (!environmentLit) mCdf[mCdf.size() - 2] = 1.0;
    if (mTriangles.size() <= kFewEmitters || !(trianglePower > 0)) return;
    std::vector<LightBound> bounds;
    for (const Triangle& t : mTriangles) bounds.push_back(boundOf(t));
    mTree = LightTree(bounds);
}

EmitterTable::Choice EmitterTable::choose(const Receiver& to, double& t) const
{
    if (!mTree.empty()) return chooseFromTree(to, t);
    const auto it = std::upper_bound(mCdf.begin(), mCdf.end() - 1, t);
    const auto index = static_cast<std::size_t>(it - mCdf.begin());
    const double low = index == 0 ? 0.0 : mCdf[index - 1];
    const double width = mCdf[index] - low;
    t = width > 0 ? std::clamp((t - low) / width, 0.0, kAlmostOne) : 0.0;
    return {index, index < mTriangles.size() ? mTriangles[index].probability : width};
}

EmitterTable::Choice EmitterTable::chooseFromTree(const Receiver& to, double& t) const
{
    const double triangles = 1 - mEnvironmentProbability;
    if (t < triangles) {
        t = std::min(t / triangles, kAlmostOne);
        const LightTree::Choice c = mTree.choose(to, t);
        return {c.light, c.probability * triangles};
    }
    t = std::clamp((t - triangles) / mEnvironmentProbability, 0.0, kAlmostOne);
    return {mTriangles.size(), mEnvironmentProbability};
}

EmitterSample EmitterTable::environmentSample(const Environment::Sample& e) const
{
    EmitterSample s;
    s.direction = Vec3f(e.direction);
    s.infinite = true;
    s.radiance = e.radiance;
    s.pdf = e.pdf * mEnvironmentProbability;
    return s;
}

EmitterSample EmitterTable::sampleEnvironment(double u, double v) const
{
    return mEnvironment ? environmentSample(mEnvironment->sample(u, v)) : EmitterSample();
}

EmitterSample EmitterTable::sampleEnvironmentTexel(std::int64_t texel, double u, double v) const
{
    return environmentSample(mEnvironment->sampleTexel(static_cast<std::uint32_t>(texel), u, v));
}

double EmitterTable::pdfTriangle(
    const Receiver& to, int emitter, double distance, double cosine) const
{
    if (!(cosine > 0)) return 0;
    const Triangle& e = mTriangles[static_cast<std::size_t>(emitter)];
    const double chance = mTree.empty() ? e.probability
                                        : mTree.probability(to, static_cast<std::uint32_t>(emitter))
            * (1 - mEnvironmentProbability);
    return chance / e.area * distance * distance / cosine;
}

double EmitterTable::pdfEnvironment(const Vec3f& direction) const
{
    return mEnvironmentProbability > 0
        ? mEnvironmentProbability * mEnvironment->pdf(Vec3d(direction))
        : 0.0;
}

double rangeWindow(double distance, double range)
{
    if (!(range > 0)) return 1;
    const double r = distance / range;
    return std::clamp(1 - r * r * r * r, 0.0, 1.0);
}

PunctualSample samplePunctual(const Light& light, const Vec3f& localPosition, const Vec3f& to)
{
    PunctualSample s;
    if (light.type == LightType::Directional) {
        s.direction = Vec3f(-light.direction);
        s.infinite = true;
        s.irradiance = light.intensity;
        return s;
    }
    const Vec3d d = Vec3d(localPosition) - Vec3d(to);
    const double distance2 = d.length2();
    if (!(distance2 > 0)) return s; // exactly on the light there is no direction
    const double distance = std::sqrt(distance2);
    double factor = rangeWindow(distance, light.range) / distance2;
    if (light.type == LightType::Spot) {
        // KHR_lights_punctual, "Inner and Outer Cone Angles".
        const double cosOuter = std::cos(light.outerConeAngle);
        const double scale = 1 / std::max(0.001, std::cos(light.innerConeAngle) - cosOuter);
        const double cd = -light.direction.dot(d) / distance;
        const double a = std::clamp((cd - cosOuter) * scale, 0.0, 1.0);
        factor *= a * a;
    }
    if (!(factor > 0)) return s;
    s.direction = Vec3f(d / distance);
    s.target = localPosition;
    s.irradiance = light.intensity * static_cast<float>(factor);
    return s;
}

} // namespace lumivdb
