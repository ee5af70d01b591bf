// SPDX-License-Identifier: Apache-2.0
#include "emitters.h"

#include <algorithm>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kAlmostOne = 0x1.fffffffffffffp-1;
constexpr double kMostSunStrata = 0.25;
/// Irradiance of an even sky over its flux, πL / 4πL.
constexpr double kEvenSky = 0.25;

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

/// Share of the environment's strata that its sun gets. A few say all where it is seen or hidden as
/// a whole, so it need not be that of its light; a power of two, so that no stratum is part sun
/// and part sky where their number is one: a single sample more or less of the sun is much.
double sunStrata(const Environment::Sun& sun)
{
    double share = kMostSunStrata;
    while (share > sun.share) share /= 2;
    return share;
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
    mEnvironmentStart = trianglePower > 0 ? 1 - mEnvironmentProbability : 0;
    if (environmentLit) {
        mPerEnvironmentProbability = 1 / mEnvironmentProbability;
        mSun = mEnvironment->sun();
        mSunSine = std::sin(mSun.radius);
        mSunStrata = mSun.share > 0 ? sunStrata(mSun) : 0;
    }
    if (!(trianglePower > 0)) return;
    double sum = 0;
    for (Triangle& t : mTriangles) {
        t.probability = t.power / trianglePower * (1 - mEnvironmentProbability);
        sum += t.probability;
        mCdf.push_back(sum);
    }
    mCdf.back() = 1 - mEnvironmentProbability; // rounding must not leave a gap that nothing owns
    if (mTriangles.size() <= kFewEmitters) return;
    std::vector<LightBound> bounds;
    for (const Triangle& t : mTriangles) bounds.push_back(boundOf(t));
    mTree = LightTree(bounds);
}

EmitterTable::Choice EmitterTable::choose(const Receiver& to, double& t) const
{
    const double rest = environmentRest(t);
    if (!(rest >= 0)) return chooseTriangle(to, t);
    const std::size_t sun = mTriangles.size(), sky = sun + 1;
    const double share = sunChance(to);
    if (rest < share) {
        t = rest / share;
        return {sun, mEnvironmentProbability * share};
    }
    t = std::min((rest - share) / (1 - share), kAlmostOne);
    return {sky, mEnvironmentProbability * (1 - share)};
}

EmitterTable::Choice EmitterTable::chooseTriangle(const Receiver& to, double& t) const
{
    if (mCdf.empty()) return {0, 0.0};
    if (!mTree.empty()) {
        const double triangles = 1 - mEnvironmentProbability;
        t = std::min(t / triangles, kAlmostOne);
        const LightTree::Choice c = mTree.choose(to, t);
        return {c.light, c.probability * triangles};
    }
    const auto it = std::upper_bound(mCdf.begin(), mCdf.end() - 1, t);
    const auto index = static_cast<std::size_t>(it - mCdf.begin());
    const double low = index == 0 ? 0.0 : mCdf[index - 1];
    const double width = mCdf[index] - low;
    t = width > 0 ? std::clamp((t - low) / width, 0.0, kAlmostOne) : 0.0;
    return {index, mTriangles[index].probability};
}

EmitterPoint EmitterTable::environmentSample(const Receiver& to, const Environment::Sample& e) const
{
    EmitterPoint s;
    s.place = Vec3f(e.direction);
    s.offset = -1;
    s.radiance = e.radiance;
    s.density = static_cast<float>(e.pdf * environmentDensity(to, e.sun));
    return s;
}

EmitterPoint EmitterTable::sampleSkyTexel(
    const Receiver& to, std::uint32_t texel, double u, double v) const
{
    return environmentSample(to, mEnvironment->sampleTexel(texel, u, v));
}

double EmitterTable::sunChance(const Receiver& to) const
{
    if (!to.oneSided() || !(mSun.share > 0)) return mSunStrata;
    // A part of it above the horizon is as much as its edge.
    const double cosine = Vec3d(to.normal).dot(mSun.direction);
    if (!(cosine > -mSunSine)) return 0;
    const double sun = mSun.share * std::max(cosine, mSunSine);
    return sun / (sun + (1 - mSun.share) * kEvenSky);
}

double EmitterTable::environmentDensity(const Receiver& to, bool sun) const
{
    if (!(mSun.share > 0)) return mEnvironmentProbability;
    const double chance = sunChance(to);
    return mEnvironmentProbability * (sun ? chance / mSun.share : (1 - chance) / (1 - mSun.share));
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
