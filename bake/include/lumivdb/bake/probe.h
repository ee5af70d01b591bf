// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file probe.h
/// The light arriving at one point, by unbiased path tracing.
///
/// N directions cover the sphere, stratified along a Hilbert curve over an equal-area map (He &
/// Owen, "Extensible grids: uniform sampling on a space-filling curve", JRSS B 78(4), 2016;
/// Clarberg, "Fast equal-area mapping of the (hemi)sphere using SIMD", 2008), so consecutive rays
/// are neighbours in direction and can be traced as packets. Points take turns with a few patterns
/// of directions, so that what these bring at any point is found once (interleaved sampling: Keller
/// & Heidrich, EGWR 2001). Emitters are also sampled directly; the two strategies are combined by
/// multiple importance sampling with the balance heuristic (Veach & Guibas, SIGGRAPH 1995). Point,
/// spot and directional lights are projected analytically. The standard error comes from
/// differences of consecutive strata, which never underestimates in expectation: σ² = Σ (f_i −
/// f_{i+1})² / (2(N−1)), stderr = σ/√N.

#include <lumivdb/bake/tracer.h>
#include <lumivdb/core/progress.h>
#include <lumivdb/core/sh.h>

#include <cstdint>
#include <limits>
#include <memory>
#include <vector>

namespace lumivdb {

struct GradientTables; // bake/src/gradient.h
struct SamplingPattern; // bake/src/directions.h
class RadianceCache; // radiance_cache.h

enum class Contribution {
    All,
    Direct, ///< straight from emitters, lights and the environment
    Indirect ///< reflected at least once
};

const char* name(Contribution c);

/// How derivatives are found.
enum class GradientMethod {
    None,
    Central, ///< six extra projections at ±δ under the same directions and random numbers (seed
             ///< 000)
    Analytic ///< from the same rays: the motion of the borders between strata
};

struct ProbeOptions {
    int rays = 1024; ///< directions per point, 2 … 2^26
    int maxBounces = -1; ///< reflections along a path; 0: direct light only; −1: no limit
    Contribution contribution = Contribution::All;
    std::uint64_t seed = 1;
    /// Ends paths at the first surface they meet, with the light kept there (of this tracer, solved
    /// with the same maxBounces): the `cached` integrator. Null: `path`, unbiased.
    std::shared_ptr<const RadianceCache> cache;
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

/// When a sample has enough rays. Directions are added in sets that double their number, each into
/// the halves of strata that are still empty, so the number is rays · 2^k and all of them are
/// stratified together. They are enough when
///     N ≥ perDeviation · σ/meanE   and   σ/√N ≤ tolerance · max(E, meanE),
/// σ being the sample's own standard deviation of irradiance per direction and E its irradiance,
/// RMS over normals both, worst channel. Numbers in proportion to the deviation give the least
/// error that a number of rays can (Neyman, JRSS 97, 1934). Deciding by the noise of the same rays
/// biases the mean by a part of 1/N.
struct StopRule {
    Vec3d meanE{0, 0, 0};
    double perDeviation = 0;
    double tolerance = std::numeric_limits<double>::infinity();
    int most = 0; ///< directions; ProbeOptions::rays or less: none are added
};

/// What one point receives. Values are per *basis function*: SH coefficients or irradiances.
struct ProbeResult {
    std::vector<Color> value; ///< one per basis function
    std::vector<Color> stderr_; ///< standard error of each
    /// Derivatives per world unit along world x, y, z: [axis · functions + function]; empty when
    /// not asked for.
    std::vector<Color> gradient;
    float validity = 1; ///< share of rays that did not meet a back face
    float distance = 0; ///< harmonic mean distance; +inf where all escaped
    float minDistance = 0; ///< smallest; +inf where all escaped
    std::uint64_t rays = 0; ///< rays traced, shadow rays included
    std::uint64_t directions = 0; ///< ProbeOptions::rays, or what a StopRule made of it
};

/// How many directions @a stop would make of @a first, by the noise that @a r has with some other
/// number.
std::uint64_t foreseenDirections(
    const ProbeResult& r, int bands, const StopRule& stop, std::uint64_t first);

/// Estimates light at points of one scene. Const and thread-safe; each thread brings a Workspace.
class ProbeEstimator {
public:
    ProbeEstimator(const Tracer& tracer, const ProbeOptions& options);
    ~ProbeEstimator();

    /// Scratch memory of one thread and one estimator, reused between points.
    class Workspace {
    public:
        Workspace();
        ~Workspace();
        struct Impl;
        std::unique_ptr<Impl> mImpl;
    };

    /// Radiance SH coefficients (bands² of them) at world point @a p. @a key makes the random
    /// numbers: the same point, key and options give the same bits (see hashPoint()).
    /// With @a analyticGradient, ProbeResult::gradient is filled from the same rays.
    ProbeResult radianceSh(const Vec3d& p, int bands, std::uint64_t key, Workspace& workspace,
        bool analyticGradient = false, const StopRule& stop = StopRule()) const;

    /// Irradiance for each of @a normals at @a p, without any expansion in between.
    ProbeResult irradiance(const Vec3d& p, const std::vector<Vec3f>& normals, std::uint64_t key,
        Workspace& workspace) const;

    /// Both from the same rays: first the coefficients of radianceSh(), then irradiance()s.
    ProbeResult radianceShAndIrradiance(const Vec3d& p, int bands,
        const std::vector<Vec3f>& normals, std::uint64_t key, Workspace& workspace) const;

    const ProbeOptions& options() const { return mOptions; }

private:
    struct Set;
    struct Place;
    template <class Basis>
    ProbeResult estimate(const Place& place, const Basis& basis, int set, Workspace& workspace,
        int gradientBands) const;
    std::shared_ptr<const Set> set(const SamplingPattern& pattern, int number) const;
    Place placeAt(const Vec3d& world, std::uint64_t key, Workspace& workspace) const;
    const GradientTables& gradientTables(int set, std::size_t strata) const;
    struct Tables;
    const Tracer& mTracer;
    ProbeOptions mOptions;
    std::shared_ptr<Tables> mTables; // shared by points
};

/// Σ A_l² |d_lm|² / 4π per channel: the mean over normals of the squared irradiance of @a d.
Vec3d irradianceNorm2(int bands, const Color* d);

/// Sets @a result.gradient by central differences: six projections at ±δ along the axes, under the
/// same directions and the same random numbers (@a key). δ is spacing/8, or half the distance to
/// the nearest surface where that is less, 1e-4 spacing at least.
/// @return the rays traced for it; @a result.rays is left alone.
std::uint64_t centralGradient(const Tracer& tracer, const ProbeEstimator& estimator, const Vec3d& p,
    int bands, double spacing, std::uint64_t key, ProbeEstimator::Workspace& workspace,
    ProbeResult& result);

/// Share of a gradient that holds as far as @a reach (world units; at most the size of the cells
/// around the sample) where the harmonic mean distance to the surfaces seen is @a distance. Light
/// changes over distances of that order (Ward & Heckbert 1992): where reach exceeds 0.7 of it, the
/// gradient is scaled by the ratio, so its direction stays and its change over the reach is what it
/// would be over the valid distance.
float gradientFactor(double distance, double reach);

/// Scales @a result.gradient by gradientFactor(). Derivatives that are not finite become 0.
void limitGradient(double reach, ProbeResult& result);

} // namespace lumivdb
