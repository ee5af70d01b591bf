// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file path_kernels.h
/// The arithmetic of a batch of paths, in vectors, compiled for several instruction sets in
/// path_kernels.cpp with the same bits on each: nothing is fused, every sum has one sequence.
/// Structures of arrays: index i of all arrays is one path, ray or emitter. Local space.

#include "emitters.h"
#include "packets.h"

#include <lumivdb/core/random.h>

#include <cstdint>

namespace lumivdb {

struct VectorBatch {
    alignas(64) float x[kBatch] = {}, y[kBatch] = {}, z[kBatch] = {};

    Vec3f operator[](int i) const { return {x[i], y[i], z[i]}; }
    void set(int i, const Vec3f& v)
    {
        x[i] = v.x;
        y[i] = v.y;
        z[i] = v.z;
    }
};

struct ColorBatch {
    alignas(64) float channel[3][kBatch] = {};

    Color operator[](int i) const { return {channel[0][i], channel[1][i], channel[2][i]}; }
    void set(int i, const Color& color)
    {
        for (int c = 0; c < 3; ++c) channel[c][i] = color[c];
    }
    void add(int i, const Color& color)
    {
        for (int c = 0; c < 3; ++c) channel[c][i] += color[c];
    }
};

/// Emitters drawn, see EmitterPoint.
struct EmitterBatch {
    VectorBatch place, normal;
    alignas(64) float offset[kBatch] = {}, density[kBatch] = {};
    alignas(64) float backShines[kBatch] = {}; ///< 1, or 0
    ColorBatch radiance;

    void set(int i, const EmitterPoint& e)
    {
        place.set(i, e.place);
        normal.set(i, e.normal);
        offset[i] = e.offset;
        density[i] = e.density;
        backShines[i] = e.twoSided ? 1.0f : 0.0f;
        radiance.set(i, e.radiance);
    }
};

/// Shadow rays and what they bring if they meet nothing.
struct ShadowBatch {
    RayBatch rays;
    ColorBatch value;
    alignas(64) std::int32_t stratum[kBatch] = {};
    std::uint8_t occluded[kBatch] = {};

    void push(int toStratum, const Color& brings, const Vec3f& from, const Vec3f& ray, float far)
    {
        value.set(rays.count, brings);
        stratum[rays.count] = toStratum;
        rays.push(from, ray, far);
    }
};

/// Triangles that rays met.
struct MetBatch {
    int count = 0;
    alignas(64) std::int32_t ray[kBatch] = {}; ///< number of the ray
    const Tracer::Impl::Triangle* triangle[kBatch] = {};
    VectorBatch a, b, c; ///< corners
    Texels::Footprint texels[kBatch]; ///< see Tracer::Impl::placeAlbedo()
    VectorBatch direction; ///< of the ray, unit
    /// See Tracer::Impl::offsetOf(): of the corners' rounding, and at least.
    alignas(64) float stretch[kBatch] = {}, least[kBatch] = {};
    /// Filled in by findSurfaces(): cosine of the front's normal and the ray, positive where the
    /// back was met; NaN where single precision does not hold the triangle's area.
    alignas(64) float facing[kBatch] = {};
    bool backFace[kBatch] = {}; ///< as SurfacePoint::backFace
    int emitter[kBatch] = {}; ///< −1: does not shine towards the ray
    ColorBatch emission; ///< where it does
};

/// Paths, each at a surface, from which it goes on.
struct PathBatch {
    int count = 0;
    // The surface, as in SurfacePoint.
    VectorBatch leaving, normal;
    ColorBatch albedo;
    alignas(64) float u[kBatch] = {}, v[kBatch] = {};
    alignas(64) float distance[kBatch] = {}; ///< from where the path came
    std::uint32_t triangle[kBatch] = {};
    bool behind[kBatch] = {};
    // The path.
    ColorBatch throughput;
    alignas(64) std::int32_t stratum[kBatch] = {};
    CounterRng rng[kBatch];
    bool goesOn[kBatch] = {}; ///< of a path that the cache ends: after this surface

    Receiver receiver(int i) const { return {leaving[i], normal[i]}; }
    void moveSurface(int from, int to);
    void movePath(int from, int to);
};

/// What scatter() leaves of the surfaces that its rays come from.
struct ScatterBatch {
    VectorBatch normal;
    alignas(64) float cosine[kBatch] = {}; ///< between that and the ray
    alignas(64) std::int32_t path[kBatch] = {}; ///< number before
    // Random numbers, filled in before: survival, direction.
    alignas(64) float survive[kBatch] = {}, u[kBatch] = {}, v[kBatch] = {};
};

/// Shadow rays end this much short of the light, in their length: Embree's distances round.
constexpr float kShadowEnd = 1 - 0x1p-17f;

/// Shadow rays from @a p to @a count emitters, emitter i that of stratum i, to the end of
/// @a shadow; each brings L / (pdf + 1/4π): balance heuristic of one uniform and one emitter
/// direction a stratum. @a direction: unit, (0, 0, 1) where there is none.
void aimFrom(const Vec3f& p, const EmitterBatch& emitters, int count, VectorBatch& direction,
    ShadowBatch& shadow);
/// The same from surfaces, whose reflected light it is: of @a samples such emitters a path, and a
/// cosine-distributed ray (balance heuristic).
void aimFromSurfaces(
    const PathBatch& paths, const EmitterBatch& emitters, int samples, ShadowBatch& shadow);

/// Where the rays of @a met met their triangles: position, normal and its side. Barycentrics are
/// those of @a paths, same numbers.
void findSurfaces(MetBatch& met, PathBatch& paths);

/// Reflects paths: throughput times albedo, Russian roulette (a path survives with min(@a longest,
/// 2 · its largest channel)), and of those that survive the cosine-distributed rays (Malley; frame
/// of Duff et al., JCGT 6(1), 2017), throughputs and @a s, dense. Returns how many; the rest of a
/// path has still to be moved there from s.path.
int scatterPaths(PathBatch& paths, float longest, ScatterBatch& s, RayBatch& rays);
/// Cosine-distributed rays of all paths from s.u, s.v, unit to rounding.
void cosineRays(const PathBatch& paths, ScatterBatch& s, RayBatch& rays);

/// Sums over consecutive strata for many functions: value f_i = uniform_i · y(uniform direction) +
/// emitter_i · y(emitter direction), and squared differences of consecutive ones. Bases are
/// [function][stratum], @a count strata; the others [function · 3 + channel].
struct StrataSums {
    int count, functions;
    const ColorBatch* uniform;
    const ColorBatch* emitter;
    const float* uniformBasis;
    const float* emitterBasis;
    bool hasPrevious; ///< else the first stratum has no difference
    float* previous; ///< value of the last stratum before, then of the last one
    double* sum;
    double* differences2;
};
void sumStrata(const StrataSums& sums);

} // namespace lumivdb
