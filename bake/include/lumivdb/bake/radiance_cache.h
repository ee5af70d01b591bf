// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file radiance_cache.h
/// The light that every surface of a scene gives off, solved once: the `cached` integrator.
///
/// A static Lambertian scene has one radiance per surface point, whoever looks. So the surfaces are
/// cut into patches (bake/src/surface_patches.h), each with one irradiance, and what a ray from a
/// probe sees is the surface's own emission and albedo, textures and all, times the patch's light:
/// one ray instead of a path. Solved by *gathering*: from places spread over each patch, cosine-
/// distributed rays find the patches that light it, shadow rays the direct light; what the rays met
/// is kept as the rows of a sparse linear system E = D + T E (radiosity with form factors from
/// rays: Cohen & Wallace, "Radiosity and Realistic Image Synthesis", 1993, ch. 4–5), which is
/// iterated to a residual without tracing again: any albedo below 1 converges.
///
/// Patches begin with a size in proportion to the scene's area, the smaller the more rays will look
/// at them (RadianceCacheOptions::patchesFor()). They are divided where the probes'
/// box sees much of them (a small room in a wide plain), where rays come near them (larger than a
/// share of the ray's length: corners) and where direct light changes across them. Where it still
/// changes in the smallest ones (edges of shadows and of sunlight), the cache keeps reflected light
/// alone and probes look for direct light at each place they see, as a path would.
///
/// The value of a patch is that of the places that can be seen from afar: each counts by the share
/// of short rays from it that meet nothing. What lies under a carpet, behind a pipe or inside a
/// solid does not darken the rest.
///
/// Where a probe sees a surface from nearer than the patch's longest side, the patch's error would
/// be the probe's: from there a path goes on by one more surface (not where reflections are
/// counted).
///
/// Biased: light is constant over a patch, and the noise of the solution is common to all probes.
/// measureCacheBias() tells how much.

#include <lumivdb/bake/probe.h>
#include <lumivdb/bake/tracer.h>

#include <cstdint>
#include <memory>

namespace lumivdb {

struct RadianceCacheOptions {
    int maxBounces = -1; ///< as ProbeOptions::maxBounces
    std::uint64_t seed = 1;
    std::size_t patches = 16384; ///< about how many to begin with, by area; 64 … 2^24
    std::size_t maxPatches = std::size_t{1} << 20; ///< dividing stops there; about 300 bytes each
    int rays = 128; ///< of a patch of that size; smaller ones send fewer, 8 at least
    double nearness = 0.5; ///< patches are divided where longer than this share of a ray to them
    /// Where probes will look from, world: what is seen from there is cut finely, in proportion to
    /// how much is seen of it, however small a part of the scene it is. Empty: the scene's bounds.
    Box3d box;
    /// Of the solution: the largest |E − D − TE| / E of all patches, so that a small room counts
    /// as much as the sunlit plain around it.
    double residual = 3e-4;
    /// How many patches to begin with for so many probes of so many rays each: the more the less
    /// noise the rays leave, and the more probes share the work. With errors that go as 1/√rays and
    /// 1/√patches, the least time to an error is where patches go as rays · √probes; the factor
    /// makes solving take about as long as tracing 500 probes. 512 … 65,536.
    static std::size_t patchesFor(double probes, double rays);
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

struct RadianceCacheReport {
    std::size_t patches = 0; ///< that hold light
    std::size_t mixed = 0; ///< of those, with direct light looked for at each place
    std::size_t joined = 0; ///< pieces that share a patch with others they do not touch
    std::uint64_t rays = 0; ///< shadow rays included
    std::size_t bytes = 0; ///< most held at once while solving
    std::size_t kept = 0; ///< bytes held afterwards
    int iterations = 0;
    double residual = 0; ///< reached
    bool full = false; ///< dividing stopped at maxPatches
    double seconds = 0;
};

/// How far the cache is off, irradiance of random places in free space against `path`, relative to
/// its mean, worst channel; the noise of both taken off.
struct CacheBias {
    double rms = 0;
    double upper = 0; ///< of rms, with a confidence of 95%
    double mean = 0, meanStderr = 0; ///< with sign
    double pathNoise = 0; ///< standard error of `path` at a place, of one ray: falls as 1/√rays
    std::size_t points = 0; ///< 0: none was free, nothing is known
    std::uint64_t rays = 0;
};

struct CacheBiasOptions {
    std::size_t points = 64;
    int cachedRays = 1024, pathRays = 2048; ///< directions a point, twice each
};

/// Measures it in @a box (world). @a probe has the cache. Two independent sets of directions a
/// point and integrator tell the noise. @throws Error(Interrupted).
CacheBias measureCacheBias(const Tracer& tracer, const ProbeOptions& probe, const Box3d& box,
    const CacheBiasOptions& options, Progress& progress);

/// Immutable once solved; threads share it. Refers to the tracer.
class RadianceCache {
public:
    /// Same inputs, same bits, for any number of threads. @throws Error(Usage), Error(Interrupted);
    /// Error(Input) where the scene falls into more than maxPatches separate pieces, those
    /// that are small and lie together counted once.
    RadianceCache(
        const Tracer& tracer, const RadianceCacheOptions& options, Progress* progress = nullptr);
    ~RadianceCache();

    const RadianceCacheOptions& options() const { return mOptions; }
    const RadianceCacheReport& report() const { return mReport; }

    /// Light at a place of a triangle's side (Tracer::Impl's numbers), over the patch it lies in.
    struct Light {
        Color irradiance; ///< without what arrives straight from emitters and lights where `mixed`
        float extent; ///< of the patch: its longest side, local units
        bool mixed;
    };
    Light at(std::uint32_t triangle, float u, float v, bool behind) const;
    /// Number of that patch; 2³² − 1 where there is none.
    std::uint32_t patchAt(std::uint32_t triangle, float u, float v, bool behind) const;

private:
    friend class CacheSolver;
    RadianceCacheOptions mOptions;
    RadianceCacheReport mReport;
    struct Impl;
    std::unique_ptr<Impl> mImpl;
};

} // namespace lumivdb
