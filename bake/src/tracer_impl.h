// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file tracer_impl.h
/// The tracer's inside, in *local* space: world minus `origin`, single precision.

#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/tracer.h>

#include "emitters.h"
#include "texture.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace lumivdb {

inline float maxAbs(const Vec3f& v)
{
    return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)});
}

/// The corners of a triangle, local space, counter-clockwise seen from its front.
struct Corners {
    Vec3f a, b, c;

    Vec3f areaVector() const { return (b - a).cross(c - a); } ///< of twice the area, to the front
    /// Rounding of vertices and of Embree's distances grows with the size of the coordinates: eight
    /// units in the last place of the largest.
    float rounding() const { return std::max({maxAbs(a), maxAbs(b), maxAbs(c)}) * 0x1p-20f; }
};

/// A point of a surface as a path sees it, local space.
struct SurfacePoint {
    Vec3f position;
    Vec3f normal; ///< unit geometric normal on the side the ray came from
    Color albedo; ///< 0 on the back of a single-sided surface
    Color emission; ///< radiance towards the ray; 0 there too
    float offset; ///< how far to move off the surface so that a new ray does not meet it again
    bool backFace; ///< the ray met the back of a single-sided surface
    int emitter; ///< index into the emitter table, −1: does not emit
    std::uint32_t triangle; ///< see Tracer::Impl::triangleCount
    float u, v; ///< where on it
    bool behind; ///< seen from the side opposite to the triangle's front

    Vec3f leaving() const { return position + normal * offset; }
    Receiver receiver() const { return {leaving(), normal}; }
};

struct Tracer::Impl {
    std::shared_ptr<const Scene> scene;
    Vec3d origin{0, 0, 0}; ///< world position of local zero: where most triangles are
    double buildSeconds = 0;

    RTCDevice device = nullptr;
    RTCScene embree = nullptr;
    RTCBuildQuality quality = RTC_BUILD_QUALITY_HIGH;

    struct Triangle {
        std::uint32_t vertex[3]; ///< into `vertices`
        std::uint32_t mesh; ///< into scene->meshes
        std::uint32_t index; ///< of that mesh
        std::int32_t emitter; ///< into `emitters`, −1: none
    };
    /// A mesh that is not expanded, in one place.
    struct Instance {
        std::uint32_t first; ///< number of its first triangle
        std::uint32_t stored; ///< that triangle in `triangles`
        Vec3f axes[3], shift; ///< local = x axes[0] + y axes[1] + z axes[2] + shift
        float stretch; ///< how much more rounding the transform and its inverse make, at least 1

        Vec3f place(const Vec3f& p) const
        {
            return axes[0] * p.x + axes[1] * p.y + axes[2] * p.z + shift;
        }
        float rounding() const { return maxAbs(shift) * stretch * 0x1p-20f; }
    };

    /// What paths ask most often of a mesh's material, in one place.
    struct Look {
        Color albedo, emission; ///< where they are the same everywhere
        bool evenAlbedo, evenEmission; ///< whether they are
        bool doubleSided, emitsFrontOnly;
        const Texels* texels; ///< of the albedo, null: none
    };

    /// Triangles in memory: the opaque ones of local space first (Embree's geometry 0), the
    /// alpha-masked ones of local space (geometry 1), then those of the meshes with instances, in
    /// spaces of their own (scenes of their own, placed by geometry 2 + index of the instance).
    std::vector<Triangle> triangles;
    std::vector<Vec3f> vertices;
    std::vector<Look> looks; ///< by mesh
    std::uint32_t opaqueCount = 0;
    std::uint32_t placedCount = 0; ///< those of local space
    std::vector<Instance> instances;
    float mostStretch = 1, mostRounding = 0; ///< of all instances
    /// Triangles of the world are numbered 0 … triangleCount − 1: those of local space as in
    /// `triangles`, then those of the instances, instance by instance.
    std::uint32_t triangleCount = 0;
    Box3d bounds; ///< world
    EmitterTable emitters;
    PunctualTable punctual;
    std::vector<Texels> texels; ///< of scene->textures

    Impl() = default;
    Impl(const Impl&) = delete;
    Impl& operator=(const Impl&) = delete;
    ~Impl();

    Vec3f toLocal(const Vec3d& world) const { return Vec3f(world - origin); }

    /// Number of what Embree has met. @a instance: RTCHit::instID[0].
    std::uint32_t triangleOf(unsigned geometry, unsigned primitive, unsigned instance) const
    {
        if (instance != RTC_INVALID_GEOMETRY_ID) return instances[instance - 2].first + primitive;
        return geometry == 0 ? primitive : opaqueCount + primitive;
    }
    /// The instance that triangle number @a i belongs to, null for those of local space.
    const Instance* instanceOf(std::uint32_t i) const
    {
        if (i < placedCount) return nullptr;
        const auto after = std::upper_bound(instances.begin(), instances.end(), i,
            [](std::uint32_t number, const Instance& instance) { return number < instance.first; });
        return &*(after - 1);
    }
    /// What is in memory of triangle number @a i: mesh, index, emitter.
    const Triangle& triangle(std::uint32_t i) const { return stored(i, instanceOf(i)); }
    const Triangle& stored(std::uint32_t i, const Instance* instance) const
    {
        return triangles[instance ? instance->stored + (i - instance->first) : i];
    }
    /// Asks memory for triangle(i).
    void prefetch(std::uint32_t i) const
    {
        if (i < placedCount) __builtin_prefetch(&triangles[i]);
    }
    Corners corners(std::uint32_t i) const
    {
        const Instance* instance = instanceOf(i);
        return corners(stored(i, instance), instance);
    }
    Corners corners(const Triangle& t, const Instance* instance) const
    {
        const Vec3f &a = vertices[t.vertex[0]], &b = vertices[t.vertex[1]],
                    &c = vertices[t.vertex[2]];
        if (!instance) return {a, b, c};
        return {instance->place(a), instance->place(b), instance->place(c)};
    }
    /// See SurfacePoint::offset.
    static float offsetOf(const Corners& corners, const Instance* instance)
    {
        const float r = corners.rounding();
        return instance ? std::max(r * instance->stretch, instance->rounding()) : r;
    }

    /// The same where no triangle is known: @a r is that of the coordinates alone.
    float roundingOf(float r) const { return std::max(r * mostStretch, mostRounding); }

    const Material& materialOf(const Triangle& t) const
    {
        return scene->materials[static_cast<std::size_t>(scene->meshes[t.mesh].material)];
    }
    const Material& materialOf(std::uint32_t i) const { return materialOf(triangle(i)); }
    /// Albedo and alpha at barycentrics (u, v), sides not considered.
    Color albedoAt(const Triangle& t, float u, float v, float* alpha) const
    {
        return albedoFrom(t, placeAlbedo(t, u, v), u, v, alpha);
    }
    /// albedoAt() in two steps, so that many can wait for memory together: first
    /// placeAlbedo(), which asks for the texels, for all, then albedoFrom() what that gave.
    Texels::Footprint placeAlbedo(const Triangle& t, float u, float v) const;
    Color albedoFrom(
        const Triangle& t, const Texels::Footprint& texels, float u, float v, float* alpha) const;
    /// Emission of the front at barycentrics (u, v).
    Color emissionAt(const Triangle& t, float u, float v) const
    {
        const Look& look = looks[t.mesh];
        return look.evenEmission ? look.emission : emissionFound(t, u, v);
    }
    Color emissionFound(const Triangle& t, float u, float v) const;
    /// What a ray met at triangle (u, v), @a t along it. Where that is the back of a single-sided
    /// surface and a front lies at the same distance (rooms modelled back to back share the plane
    /// of their wall, and Embree may report either), it is the front.
    SurfacePoint surfaceSeen(const Vec3f& from, const Vec3f& direction, std::uint32_t triangle,
        float t, float u, float v) const;
    SurfacePoint surfaceAt(
        std::uint32_t triangle, float u, float v, const Vec3f& rayDirection) const;
    /// The same without albedo and emission, which stay 0.
    SurfacePoint placeAt(std::uint32_t triangle, float u, float v, const Vec3f& rayDirection) const;
};

} // namespace lumivdb
