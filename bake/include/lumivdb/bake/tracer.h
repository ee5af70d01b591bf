// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file tracer.h
/// A scene ready for rays: Embree's acceleration structure, materials and light tables.
/// rtcore.h is included by tracer.cpp and its neighbours in bake/src only.

#include <lumivdb/bake/scene.h>
#include <lumivdb/core/progress.h>

#include <cstdint>
#include <memory>

namespace lumivdb {

/// Where a ray met a surface.
struct SurfaceHit {
    bool hit = false;
    bool backFace = false; ///< met from behind the triangle's counter-clockwise side
    double distance = 0; ///< world units
    Vec3d position; ///< world
    Vec3f normal; ///< unit geometric normal of the front side
    Color albedo; ///< linear reflectance; 0 on the back of a single-sided surface
    Color emission; ///< radiance towards the ray's origin; 0 on the back of a single-sided one
    int mesh = -1;
    int triangle = -1;
};

struct TracerOptions {
    /// Meshes with instances are expanded, those that add least first, as long as the world then
    /// has no more triangles than this. Up to about there rays are as fast or, among small meshes,
    /// faster by an eighth; beyond, what is kept once stays in the caches and is faster.
    std::uint64_t expandUpTo = std::uint64_t(1) << 17;
    /// Rays that will be traced, roughly; 0: not known, taken as many. Fewer than triangles in
    /// memory do not earn back what a good structure takes to build, so they get a quick one.
    /// Both find the same closest hits; where two surfaces lie at the very same distance, each may
    /// find another of the two. So where results are to agree to the last bit, as parts of one bake
    /// are, give all the same number or none.
    double expectedRays = 0;
};

/// Immutable after construction and safe to trace from many threads.
///
/// Meshes that are not expanded are kept once and traced through one transform each. Positions of
/// an expanded mesh and of one that is not agree up to rounding; edges where an instance meets
/// something else are not watertight to the last bit, as those within a mesh are. Emissive meshes,
/// those of up to four triangles and transforms that would cost more than six bits are always
/// expanded.
class Tracer {
public:
    /// Builds the structure (robust) and shares @a scene.
    /// @throws Error(Input) where the world has 2³² − 1 triangles or more, those of instances
    /// counted each time, and where Embree runs out of memory.
    explicit Tracer(std::shared_ptr<const Scene> scene, Progress* progress = nullptr,
        const TracerOptions& options = {});
    ~Tracer();

    const Scene& scene() const;
    double buildSeconds() const;

    /// First surface along unit @a direction from world point @a origin; alpha-masked texels let
    /// rays pass.
    SurfaceHit intersect(const Vec3d& origin, const Vec3d& direction) const;
    /// Whether anything lies strictly between the two points.
    bool occluded(const Vec3d& from, const Vec3d& to) const;
    /// Closest surface within @a radius: its distance and unit normal. False where there is none.
    bool closestSurface(const Vec3d& p, double radius, double* distance, Vec3d* normal) const;
    /// By how much single precision may have moved that surface, world units; 0 where there is
    /// none.
    double surfaceRounding(const Vec3d& p, double radius) const;

    struct Impl;
    const Impl& impl() const { return *mImpl; }

private:
    std::unique_ptr<Impl> mImpl;
};

} // namespace lumivdb
