// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file path.h
/// A batch of paths from one point, advanced together: what each brings back, unbiased.

#include "path_kernels.h"

#include <lumivdb/bake/probe.h>

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
    ColorBatch uniform;
    /// Directions drawn towards emitters and what they give, already divided by the density:
    /// added to the same stratum's estimate. Zero where nothing arrives.
    VectorBatch emitterDirection;
    ColorBatch emitter;
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

/// What a probe's strata have in common at all points, a batch's at a time.
struct ProbeStrata {
    EmitterBatch emitters; ///< drawn
    double position[kBatch]; ///< what they are drawn from, where that depends on the place
    ColorBatch background; ///< what a ray that meets nothing brings, weighted
};

/// Of all strata of nestedPositions()' set number @a set, in the order of @a directions; @a seed is
/// that of their pattern.
std::vector<ProbeStrata> probeStrata(const Tracer::Impl& impl, const ProbeOptions& options,
    std::uint64_t seed, const std::vector<Vec3f>& directions, int set = 0);

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
    PathTracer(const Tracer::Impl& impl, const ProbeOptions& options)
        : mImpl(impl)
        , mOptions(options)
    {
    }

    /// Strata [first, first + count) of the probe at @a p (local); first is a multiple of kBatch,
    /// count ≤ kBatch, @a strata theirs.
    void trace(const Vec3f& p, const Vec3f* directions, const ProbeStrata& strata,
        std::uint64_t first, int count, std::uint64_t key, PathBatchResult& result);

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
        std::uint32_t triangle;
        float u, v;
        bool behind;
        Color albedo;
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
    void sampleEmittersAtProbe(
        const Vec3f& p, const ProbeStrata& strata, int count, PathBatchResult& result);
    void placeEmitters(const Vec3f& p, const ProbeStrata& strata, int count);
    void startPaths(
        const ProbeStrata& strata, std::uint64_t first, std::uint64_t key, PathBatchResult& result);
    /// @a draws gives the numbers that choose emitter @a number of mEmitterSamples, else the paths'
    /// own do.
    void reflectFromEmitters(
        PathBatchResult& result, const GatherDraw* draws = nullptr, int number = 0);
    void drawEmitters(const double* t, const float* u, const float* v);
    void findOpen(const GatherDraw* draws, PathBatchResult& result);
    void reflectFromPunctual(PathBatchResult& result);
    void scatter(int bounce, PathBatchResult& result);
    void meet(const RayBatch& rays, const HitBatch& hits);
    void meetAgain(int k, const RayBatch& rays, const HitBatch& hits);
    void follow(PathBatchResult& result, bool markBacks = false);
    void lookUp(PathBatchResult& result);
    void addUnoccluded(PathBatchResult& result);

    void note(const RayBatch& rays, bool shadow);

    const Tracer::Impl& mImpl;
    const ProbeOptions& mOptions;
    std::vector<RecordedRay>* mRecorder = nullptr;

    int mEmitterSamples = 1; ///< at each surface
    PathBatch mPaths;
    EmitterBatch mEmitters;
    ShadowBatch mShadow;
    ScatterBatch mScatter;
    RayBatch mNext;
    HitBatch mNextHits;
    MetBatch mMet;
    std::vector<Seen> mSeen;
};

} // namespace lumivdb
