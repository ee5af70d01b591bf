// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file path.h
/// A batch of paths from one point, advanced together: what each brings back, unbiased.

#include "packets.h"

#include <lumivdb/bake/probe.h>
#include <lumivdb/core/random.h>

#include <cstdint>
#include <vector>

namespace lumivdb {

/// A surface's tangent plane as the probe sees it: in direction ω it lies at the inverse distance
/// slope · ω, which is linear. All zero for what is infinitely far away.
struct InversePlane {
    Vec3f slope{0, 0, 0}; ///< n / (n · y), y the surface point relative to the probe
    float inverse = 0; ///< 1/|y|

    InversePlane() = default;
    InversePlane(const Vec3f& normal, const Vec3f& direction, float distance);
};

/// What a batch of consecutive strata brought back. All of it at the probe, local space.
struct PathBatchResult {
    RayBatch rays; ///< the uniform directions
    HitBatch hits; ///< what they met first
    /// Radiance along rays[i]; multiplied by the basis and 4π it estimates the integral.
    Color uniform[kBatch];
    /// Directions drawn towards emitters and what they give, already divided by the density:
    /// added to the same stratum's estimate. Zero where nothing arrives.
    float ex[kBatch], ey[kBatch], ez[kBatch];
    Color emitter[kBatch];
    /// The planes of the surfaces met by rays[i] and of the emitters drawn, for derivatives.
    InversePlane plane[kBatch], emitterPlane[kBatch];
    bool wantPlanes = true; ///< set before: false leaves them as they are
    bool backFace[kBatch];
    float open[kBatch]; ///< of gather() alone
    std::uint64_t traced = 0; ///< rays, shadow rays included
};

/// A ray as it was traced, for measuring against Embree alone.
struct RecordedRay {
    Vec3f origin, direction;
    float tfar;
    bool shadow;
};

/// What a stratum of the probe's directions has in common at all points.
struct ProbeStratum {
    double t = 0; ///< what its emitter sample is drawn from
    Vec3f infinite{0, 0, 0}; ///< direction, if that is of the environment, else 0
    Color value{0, 0, 0}; ///< its radiance, weighted, over the density
    Color background{0, 0, 0}; ///< what a ray that meets nothing brings, weighted
};

/// Of all strata of nestedPositions()' set number @a set, in the order of @a directions.
std::vector<ProbeStratum> probeStrata(const Tracer::Impl& impl, const ProbeOptions& options,
    const std::vector<Vec3f>& directions, int set = 0);

/// The random numbers of one of PathTracer::gather()'s points.
struct GatherDraw {
    Vec2f square; ///< of the cosine-distributed ray (Malley's map)
    Vec3d emitter; ///< which emitter, and the place on it; more of them follow from it
    Vec2d around; ///< of cosine-distributed rays that end at reach, see gather()
    float reach = 0; ///< 0: there is none
    std::uint64_t key; ///< of all others
};

class PathTracer {
public:
    /// @a strata: probeStrata(), if trace() shall not find them again each time.
    PathTracer(const Tracer::Impl& impl, const ProbeOptions& options,
        const std::vector<ProbeStratum>* strata = nullptr)
        : mImpl(impl)
        , mOptions(options)
        , mStrata(strata)
    {
    }

    /// From now on trace() takes these.
    void useStrata(const std::vector<ProbeStratum>& strata) { mStrata = &strata; }

    /// Strata [first, first + count) of the probe at @a p (local); count ≤ kBatch.
    void trace(const Vec3f& p, const Vec3f* directions, std::uint64_t first, int count,
        std::uint64_t key, PathBatchResult& result);

    /// For each of @a points one sample of the light it receives: result.uniform[i] is what arrives
    /// straight from emitters and lights, E/π, by @a emitterSamples of them and the cosine-
    /// distributed ray, result.emitter[i] the lights' (punctual) part of it, result.backFace[i]
    /// that its ray met the back of a single-sided surface (the point probably lies inside of a
    /// solid), and what that ray met is among seen(), in order. result.open[i]: the share of a few
    /// other such rays that meet nothing within the draw's reach. count ≤ kBatch.
    void gather(const SurfacePoint* points, const GatherDraw* draws, int count, int emitterSamples,
        PathBatchResult& result);
    /// What the rays of gather() met and reflects light: the point it came from, and where it met.
    struct Seen {
        SurfacePoint surface;
        int from;
        float distance;
    };
    const std::vector<Seen>& seen() const { return mSeen; }

    /// The scene's lights [first, first + count) at @a p, count ≤ kBatch: irradiance on a surface
    /// facing it, 0 where shadowed. Returns the rays traced.
    std::uint64_t punctual(
        std::size_t first, std::size_t count, const Vec3f& p, PunctualSample* lights);

    /// Appends every ray traced from now on to @a rays; null ends it.
    void record(std::vector<RecordedRay>* rays) { mRecorder = rays; }

private:
    struct Path {
        SurfacePoint surface;
        Color throughput;
        float distance; ///< of the surface from where the path came
        int stratum;
        bool goesOn = false; ///< of a path that the cache ends: after this surface
        CounterRng rng{0};
    };
    void sampleEmittersAtProbe(
        const Vec3f& p, const ProbeStratum* strata, int count, PathBatchResult& result);
    void startPaths(const Vec3f& p, const ProbeStratum* strata, std::uint64_t first, int count,
        std::uint64_t key, PathBatchResult& result);
    /// @a draws gives the numbers that choose emitter @a number of mEmitterSamples, else the paths'
    /// own do.
    void reflectFromEmitters(
        PathBatchResult& result, const GatherDraw* draws = nullptr, int number = 0);
    void findOpen(
        const SurfacePoint* points, const GatherDraw* draws, int count, PathBatchResult& result);
    void pushReflected(const Path& path, const EmitterSample& e);
    void reflectFromPunctual(PathBatchResult& result);
    void scatter(int bounce, PathBatchResult& result);
    void follow(PathBatchResult& result, bool markBacks = false);
    void lookUp(PathBatchResult& result);
    void addUnoccluded(PathBatchResult& result);

    void note(const RayBatch& rays, bool shadow);

    const Tracer::Impl& mImpl;
    const ProbeOptions& mOptions;
    const std::vector<ProbeStratum>* mStrata;
    std::vector<RecordedRay>* mRecorder = nullptr;

    int mEmitterSamples = 1; ///< at each surface
    ProbeStratum mOwnStrata[kBatch];
    Path mPaths[kBatch];
    int mPathCount = 0;
    RayBatch mShadow;
    Color mShadowValue[kBatch];
    int mShadowStratum[kBatch];
    std::uint8_t mOccluded[kBatch];
    RayBatch mNext;
    HitBatch mNextHits;
    std::vector<Seen> mSeen;
};

} // namespace lumivdb
