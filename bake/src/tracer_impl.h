// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file tracer_impl.h
/// The tracer's inside, in *local* space: world minus `origin`, single precision.

#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/tracer.h>

#include "emitters.h"
#include "texture.h"

#include <embree3/rtcore.h>

#include <vector>

namespace lumivdb {

/// A point of a surface as a path sees it, local space.
struct SurfacePoint {
    Vec3f position;
    Vec3f normal; ///< unit geometric normal on the side the ray came from
    Color albedo; ///< 0 on the back of a single-sided surface
    Color emission; ///< radiance towards the ray; 0 there too
    float offset; ///< how far to move off the surface so that a new ray does not meet it again
    bool backFace; ///< the ray met the back of a single-sided surface
    int emitter; ///< index into the emitter table, −1: does not emit
    std::uint32_t triangle; ///< into Tracer::Impl::triangles

    Vec3f leaving() const { return position + normal * offset; }
    Receiver receiver() const { return {leaving(), normal}; }
};

struct Tracer::Impl {
    std::shared_ptr<const Scene> scene;
    Vec3d origin{0, 0, 0}; ///< world position of local zero: the middle of the scene
    double buildSeconds = 0;

    RTCDevice device = nullptr;
    RTCScene embree = nullptr;

    /// All triangles, the opaque ones first (geometry 0), then the alpha-masked (geometry 1).
    struct Triangle {
        std::uint32_t vertex[3]; ///< into `vertices`
        std::uint32_t mesh; ///< into scene->meshes
        std::uint32_t index; ///< of that mesh
        std::int32_t emitter; ///< into `emitters`, −1: none
    };
    std::vector<Triangle> triangles;
    std::vector<Vec3f> vertices;
    std::uint32_t opaqueCount = 0;
    EmitterTable emitters;
    PunctualTable punctual;
    std::vector<Texels> texels; ///< of scene->textures

    Impl() = default;
    Impl(const Impl&) = delete;
    Impl& operator=(const Impl&) = delete;
    ~Impl();

    Vec3f toLocal(const Vec3d& world) const { return Vec3f(world - origin); }
    std::uint32_t triangleOf(unsigned geometry, unsigned primitive) const
    {
        return geometry == 0 ? primitive : opaqueCount + primitive;
    }
    const Material& materialOf(const Triangle& t) const
    {
        return scene->materials[static_cast<std::size_t>(scene->meshes[t.mesh].material)];
    }
    /// Albedo and alpha at barycentrics (u, v), sides not considered.
    Color albedoAt(const Triangle& t, float u, float v, float* alpha) const;
    /// Asks memory for what albedoAt() will read.
    void prefetchAlbedo(std::uint32_t triangle, float u, float v) const;
    /// Emission of the front at barycentrics (u, v).
    Color emissionAt(const Triangle& t, float u, float v) const;
    /// What a ray met at triangle (u, v), @a t along it. Where that is the back of a single-sided
    /// surface and a front lies at the same distance (rooms modelled back to back share the plane
    /// of their wall, and Embree may report either), it is the front.
    SurfacePoint surfaceSeen(const Vec3f& from, const Vec3f& direction, std::uint32_t triangle,
        float t, float u, float v) const;
    SurfacePoint surfaceAt(
        std::uint32_t triangle, float u, float v, const Vec3f& rayDirection) const;
};

} // namespace lumivdb
