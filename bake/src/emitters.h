// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file emitters.h
/// Everything that gives light, as tables to choose from. Local space (see tracer_impl.h).

#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/scene.h>

#include "light_tree.h"

#include <algorithm>
#include <cstdint>
#include <memory>
#include <vector>

namespace lumivdb {

/// A place that gives light, drawn by EmitterTable::sample(): on a triangle, or infinitely far
/// away.
struct EmitterPoint {
    Vec3f place{0, 0, 0}; ///< on the triangle; where infinite, the unit direction towards it
    Vec3f normal{0, 0, 0}; ///< unit, of the triangle's front; 0 where infinite
    float offset = 0; ///< see SurfacePoint::offset; negative: infinitely far away
    bool twoSided = false; ///< whether the back shines too
    /// Of the draw, choice of the emitter included: per unit of area, per steradian where infinite.
    /// 0: nothing was drawn.
    float density = 0;
    Color radiance{0, 0, 0};

    bool infinite() const { return offset < 0; }
};

/// Emissive triangles and the environment, which is as likely as all of them. Up to kFewEmitters
/// triangles are chosen by their power, more of them by a LightTree: by about what they give there.
///
/// An environment's sun is an emitter of its own. On a surface its share of the environment's is
/// that of what it would give there unhidden, beside an even sky of the sky's flux: none below the
/// horizon. For a receiver without a normal, whose samples come in strata, it is fixed.
class EmitterTable {
public:
    struct Triangle {
        std::uint32_t triangle; ///< into Tracer::Impl::triangles
        Vec3f a, ab, ac; ///< vertex and edges
        Vec3f normal; ///< unit, front
        float area;
        float offset; ///< see SurfacePoint::offset
        bool doubleSided;
        double power; ///< luminance, both sides
        double probability = 0; ///< of the choice by power
    };

    int add(const Triangle& triangle);
    void finish(std::shared_ptr<const Environment> environment);

    bool empty() const { return mCdf.empty() && !(mEnvironmentProbability > 0); }
    bool hasSky() const { return mEnvironmentProbability > 0; }
    /// Whether what is drawn depends on the receiver's place.
    bool dependsOnPlace() const { return !mTree.empty(); }
    std::size_t triangleCount() const { return mTriangles.size(); }
    const std::vector<Triangle>& triangles() const { return mTriangles; }

    static constexpr std::size_t kFewEmitters = 32;

    /// Draws from t ∈ [0,1): first the emitter, then, with what t has left, a point on it along a
    /// Hilbert curve. Stratified t give stratified emitters and stratified points of each.
    /// @a emission(triangle index, u, v) gives the radiance of a triangle's front.
    template <class Emission>
    EmitterPoint sampleStratum(const Receiver& to, double t, const Emission& emission) const;

    /// From independent random numbers: the emitter by t, the point on it by u, v. The sky's texels
    /// are all over memory, so that many draws go step by step: first skyRest(t), and prefetchSky()
    /// where that is not negative; then skyTexel() of those; then sampleSkyTexel() of them and
    /// sampleElsewhere() of the others.
    /// What t ∈ [0, 1) has left where it draws the sky (all of an environment without a sun).
    double skyRest(const Receiver& to, double t) const
    {
        const double rest = environmentRest(t);
        if (!(rest >= 0) || !(mSun.share > 0)) return rest;
        const double sun = sunChance(to);
        return rest < sun ? -1.0 : std::min((rest - sun) / (1 - sun), 0x1.fffffffffffffp-1);
    }
    void prefetchSky(double rest) const { mEnvironment->prefetchDraw(rest); }
    std::uint32_t skyTexel(double rest) const { return mEnvironment->drawTexel(rest); }
    template <class Emission>
    EmitterPoint sampleElsewhere(
        const Receiver& to, double t, double u, double v, const Emission& emission) const;
    EmitterPoint sampleSkyTexel(const Receiver& to, std::uint32_t texel, double u, double v) const;

    /// Density of these draws at @a to for a triangle met at @a distance under |cos| = @a cosine.
    double pdfTriangle(const Receiver& to, int emitter, double distance, double cosine) const;
    /// Density at @a to of all that draws directions of the environment (its part @a sun, or the
    /// sky), over that of Environment::sample().
    double environmentDensity(const Receiver& to, bool sun) const;

private:
    /// An emitter, triangleCount() being the sun and one more the sky (all of an environment that
    /// has no sun), and the chance to draw it.
    struct Choice {
        std::size_t emitter;
        double probability; ///< 0: none
    };
    Choice choose(const Receiver& to, double& t) const;
    Choice chooseTriangle(const Receiver& to, double& t) const;
    template <class Emission>
    EmitterPoint samplePoint(const Choice& choice, const Receiver& to, double s, double t,
        const Emission& emission) const;
    /// What t ∈ [0, 1) has left where it draws the environment, else negative.
    double environmentRest(double t) const
    {
        return mEnvironmentProbability > 0
            ? std::min((t - mEnvironmentStart) * mPerEnvironmentProbability, 0x1.fffffffffffffp-1)
            : -1.0;
    }
    /// Of drawing the sun, where the environment is drawn.
    double sunChance(const Receiver& to) const;
    EmitterPoint environmentSample(const Receiver& to, const Environment::Sample& e) const;

    std::vector<Triangle> mTriangles;
    std::shared_ptr<const Environment> mEnvironment;
    double mEnvironmentProbability = 0, mPerEnvironmentProbability = 0;
    double mEnvironmentStart = 0; // of the t that draw it
    Environment::Sun mSun;
    double mSunSine = 0; // of its radius
    double mSunStrata = 0; // share of the environment's where there is no normal
    std::vector<double> mCdf; // triangles in order; ends where the environment starts
    LightTree mTree; // of the triangles, where they are many
};

/// glTF's recommended window: 1 on the light, 0 from @a range on; 1 everywhere where that is 0.
double rangeWindow(double distance, double range);

/// Light of a punctual light at @a to, unshadowed. Irradiance on a surface that faces it.
struct PunctualSample {
    Vec3f direction{0, 0, 0}; ///< unit, towards the light; 0: no light arrives
    Vec3f target{0, 0, 0};
    bool infinite = false;
    Color irradiance{0, 0, 0};
};
PunctualSample samplePunctual(const Light& light, const Vec3f& localPosition, const Vec3f& to);

/// Point, spot and directional lights, to draw one of them for a place on a surface. Up to
/// kWeighedLights are weighed one by one by what they give there, more of them by a LightTree.
class PunctualTable {
public:
    static constexpr std::size_t kWeighedLights = 64;

    PunctualTable() = default;
    /// @a origin: world position of local zero. Keeps @a lights, which must outlive it.
    PunctualTable(const std::vector<Light>& lights, const Vec3d& origin);

    bool empty() const { return mLights == nullptr || mLights->empty(); }

    /// Draws a light from @a t ∈ [0,1); its irradiance, unshadowed, is divided by the chance to
    /// draw it. The receiver needs a normal. False: no light arrives.
    bool sample(const Receiver& to, double t, PunctualSample& light) const;

private:
    PunctualSample at(std::size_t light, const Vec3f& to) const;
    bool sampleWeighed(const Receiver& to, double t, PunctualSample& light) const;

    const std::vector<Light>* mLights = nullptr;
    std::vector<Vec3f> mPositions; // local
    LightTree mTree; // where they are many
};

} // namespace lumivdb

#include "emitters_sample.h"
