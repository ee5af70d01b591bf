// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file rsm.h
/// Reflective shadow maps: what the surfaces that a light sees send on, as surfels (Dachsbacher &
/// Stamminger, "Reflective shadow maps", I3D 2005), found by rays instead of a rasteriser.
///
/// A map divides the light's flux into beams, one a texel, with one ray at a random place of each.
/// Where the ray meets a surface, the beam's flux times the albedo is what a surfel reflects, and
/// the beam's cross-section over the cosine is its area. Every place of the beam is equally likely,
/// so any sum over surfels is unbiased: the fluxes sum to ∫ albedo · E dA over the surfaces lit,
/// whatever the resolution; more texels lower the noise. Only direct light counts (E from the light
/// itself); the surfels are the *first* reflection.
///
/// | light | beams |
/// |---|---|
/// | directional | N × N parallel ones over the shadow of the region's box |
/// | spot | N × N of equal solid angle over its cone, or over the region if that takes less |
/// | point | 6 · N × N of equal solid angle over a cube's faces; outside the region as a spot |
/// | emissive triangles | N points drawn by power, about N directions by cosine from each |
/// | environment | N directions drawn by luminance · solid angle, about N parallel beams each |
///
/// The sun of an environment is no special case: it gets as many directions as it has of the
/// light. The same scene, options and seed give the same bits for any number of threads.
///
/// @code
///   const Tracer tracer(scene);
///   RsmOptions options;
///   options.region = volumeBox;
///   std::vector<Surfel> lit = reflectedLight(tracer, options);
///   lit = importantSurfels(lit, 20000, options.seed);
/// @endcode

#include <lumivdb/bake/surfel.h>
#include <lumivdb/bake/tracer.h>

#include <cstdint>
#include <optional>
#include <vector>

namespace lumivdb {

struct RsmOptions {
    int resolution = 256; ///< N, 1 … 16384: a map has N × N texels, a point light's six of them
    /// World box that is to be lit: parallel beams aim at it alone, whatever stands before it.
    /// Default: the scene's box. Surfels outside it may come back too.
    std::optional<Box3d> region;
    std::uint64_t seed = 1;
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

/// First reflection of one punctual light; it need not be one of the scene's. @a progress, here and
/// below, may be null; cancelled work throws Error(Interrupted).
std::vector<Surfel> reflectedLight(const Tracer& tracer, const Light& light,
    const RsmOptions& options, Progress* progress = nullptr);
/// First reflection of all emissive triangles.
std::vector<Surfel> reflectedEmission(
    const Tracer& tracer, const RsmOptions& options, Progress* progress = nullptr);
/// First reflection of the environment.
std::vector<Surfel> reflectedEnvironment(
    const Tracer& tracer, const RsmOptions& options, Progress* progress = nullptr);
/// All of it: the lights of the scene in their sequence, the emissive triangles, the environment,
/// with a seed of its own for each. Adds the rays traced to @a rays, if given.
std::vector<Surfel> reflectedLight(const Tracer& tracer, const RsmOptions& options,
    Progress* progress = nullptr, std::uint64_t* rays = nullptr);

/// At most @a count of @a surfels, drawn with chances in proportion to the luminance of their flux
/// (systematically: a surfel that has k times its share comes back once, with the weight of k or
/// k + 1 draws). Flux and area are divided by the chance, so sums over the result are unbiased; the
/// luminance of the total stays exactly. All of them where they are no more than @a count.
std::vector<Surfel> importantSurfels(
    const std::vector<Surfel>& surfels, std::size_t count, std::uint64_t seed);

} // namespace lumivdb
