// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/tracer.h>

#include "tracer_build.h"
#include "tracer_impl.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

namespace lumivdb {

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

template <class T>
T interpolate(const std::vector<T>& values, const std::array<std::uint32_t, 3>& t, float u, float v)
{
    return values[t[0]] * (1 - u - v) + values[t[1]] * u + values[t[2]] * v;
}

/// Coordinates in the texture of @a slot. @pre the mesh has such coordinates
Vec2f placeInSlot(
    const TextureSlot& slot, const Mesh& mesh, std::uint32_t triangle, float u, float v)
{
    const std::vector<Vec2f>& uv = mesh.uv[slot.uvSet == 1 ? 1 : 0];
    const Vec2f st = interpolate(uv, mesh.triangles[triangle], u, v);
    const auto& m = slot.transform;
    return {m[0] * st.x + m[1] * st.y + m[2], m[3] * st.x + m[4] * st.y + m[5]};
}

} // namespace

Tracer::Impl::~Impl()
{
    if (embree) rtcReleaseScene(embree);
    if (device) rtcReleaseDevice(device);
}

Texels::Footprint Tracer::Impl::placeAlbedo(const Triangle& t, float u, float v) const
{
    const Texels* const image = looks[t.mesh].texels;
    if (!image) return {};
    const Vec2f place
        = placeInSlot(materialOf(t).baseColorTexture, scene->meshes[t.mesh], t.index, u, v);
    const Texels::Footprint footprint = image->find(place.x, place.y);
    image->prefetch(footprint);
    return footprint;
}

Color Tracer::Impl::albedoFrom(
    const Triangle& t, const Texels::Footprint& at, float u, float v, float* alpha) const
{
    const Mesh& mesh = scene->meshes[t.mesh];
    const Material& material = materialOf(t);
    const Texels* const image = looks[t.mesh].texels;
    const auto texel = image ? image->sample(at) : std::array<float, 4>{1, 1, 1, 1};
    Color albedo(material.baseColor.x * texel[0], material.baseColor.y * texel[1],
        material.baseColor.z * texel[2]);
    float a = material.alphaFactor * texel[3];
    if (!mesh.colors.empty()) {
        const auto& tri = mesh.triangles[t.index];
        const float w[3] = {1 - u - v, u, v};
        float c[4] = {0, 0, 0, 0};
        for (int k = 0; k < 3; ++k) {
            for (std::size_t i = 0; i < 4; ++i) c[i] += w[k] * mesh.colors[tri[k]][i];
        }
        albedo *= Color(c[0], c[1], c[2]);
        a *= c[3];
    }
    if (alpha) *alpha = a;
    for (int i = 0; i < 3; ++i) albedo[i] = std::clamp(albedo[i], 0.0f, 1.0f);
    return albedo;
}

Color Tracer::Impl::emissionFound(const Triangle& t, float u, float v) const
{
    const Material& material = materialOf(t);
    if (material.alphaMask) {
        // A texel that rays pass through gives no light either.
        float alpha = 1;
        albedoAt(t, u, v, &alpha);
        if (alpha < material.alphaCutoff) return Color(0.0f);
    }
    const TextureSlot& slot = material.emissionTexture;
    const Mesh& mesh = scene->meshes[t.mesh];
    if (slot.texture < 0 || mesh.uv[slot.uvSet == 1 ? 1 : 0].empty()) return material.emission;
    const Vec2f place = placeInSlot(slot, mesh, t.index, u, v);
    const auto texel = texels[static_cast<std::size_t>(slot.texture)].sample(place.x, place.y);
    return {material.emission.x * texel[0], material.emission.y * texel[1],
        material.emission.z * texel[2]};
}

SurfacePoint Tracer::Impl::placeAt(
    std::uint32_t triangle, float u, float v, const Vec3f& rayDirection) const
{
    const Instance* instance = instanceOf(triangle);
    const Triangle& t = stored(triangle, instance);
    const Corners p = corners(t, instance);
    SurfacePoint s;
    s.position = p.a * (1 - u - v) + p.b * u + p.c * v;
    s.normal = p.areaVector().normalized();
    s.albedo = s.emission = Color(0.0f);
    s.offset = offsetOf(p, instance);
    s.emitter = t.emitter;
    s.triangle = triangle;
    s.u = u;
    s.v = v;
    s.behind = s.normal.dot(rayDirection) > 0;
    if (s.behind) s.normal = -s.normal;
    s.backFace = s.behind && !looks[t.mesh].doubleSided;
    return s;
}

SurfacePoint Tracer::Impl::surfaceAt(
    std::uint32_t triangle, float u, float v, const Vec3f& rayDirection) const
{
    SurfacePoint s = placeAt(triangle, u, v, rayDirection);
    if (s.backFace) return s;
    const Triangle& t = this->triangle(triangle);
    s.albedo = albedoAt(t, u, v, nullptr);
    if (t.emitter >= 0 && !(s.behind && looks[t.mesh].emitsFrontOnly)) {
        s.emission = emissionAt(t, u, v);
    }
    return s;
}

namespace {

struct FrontContext {
    RTCIntersectContext context; // first: Embree hands back a pointer to it
    const Tracer::Impl* impl;
    Vec3f direction; // the ray's, which filters see in the space of the instance
};

/// Rejects the backs of single-sided triangles.
void frontFilter(const RTCFilterFunctionNArguments* args)
{
    const auto& context = *reinterpret_cast<const FrontContext*>(args->context);
    const Tracer::Impl& impl = *context.impl;
    for (unsigned i = 0; i < args->N; ++i) {
        if (args->valid[i] != -1) continue;
        const std::uint32_t t = impl.triangleOf(RTCHitN_geomID(args->hit, args->N, i),
            RTCHitN_primID(args->hit, args->N, i), RTCHitN_instID(args->hit, args->N, i, 0));
        const bool behind = impl.corners(t).areaVector().dot(context.direction) > 0;
        if (behind && !impl.materialOf(t).doubleSided) args->valid[i] = 0;
    }
}

} // namespace

SurfacePoint Tracer::Impl::surfaceSeen(const Vec3f& from, const Vec3f& direction,
    std::uint32_t triangle, float t, float u, float v) const
{
    const SurfacePoint s = surfaceAt(triangle, u, v, direction);
    if (!s.backFace) return s;
    const float tolerance = std::max(t * 0x1p-18f, s.offset);
    FrontContext context;
    rtcInitIntersectContext(&context.context);
    context.context.filter = frontFilter;
    context.impl = this;
    context.direction = direction;
    RTCRayHit r{};
    r.ray = {from.x, from.y, from.z, std::max(0.0f, t - tolerance), direction.x, direction.y,
        direction.z, 0, t + tolerance, ~0u, 0, 0};
    r.hit.geomID = r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(embree, &context.context, &r);
    if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return s;
    return surfaceAt(
        triangleOf(r.hit.geomID, r.hit.primID, r.hit.instID[0]), r.hit.u, r.hit.v, direction);
}

Tracer::Tracer(std::shared_ptr<const Scene> scene, Progress* progress, const TracerOptions& options)
    : mImpl(std::make_unique<Impl>())
{
    const auto start = std::chrono::steady_clock::now();
    if (progress) progress->begin("build the ray structure", 1);
    mImpl->scene = std::move(scene);
    const std::vector<Texture>& textures = mImpl->scene->textures;
    mImpl->texels.reserve(textures.size());
    for (const Texture& texture : textures) mImpl->texels.emplace_back(texture);
    buildTracer(*mImpl, options);
    if (progress) progress->advance(1);
    mImpl->buildSeconds
        = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

Tracer::~Tracer() = default;

const Scene& Tracer::scene() const { return *mImpl->scene; }
double Tracer::buildSeconds() const { return mImpl->buildSeconds; }

SurfaceHit Tracer::intersect(const Vec3d& origin, const Vec3d& direction) const
{
    RTCRayHit r{};
    const Vec3f o = mImpl->toLocal(origin);
    r.ray.org_x = o.x;
    r.ray.org_y = o.y;
    r.ray.org_z = o.z;
    r.ray.dir_x = static_cast<float>(direction.x);
    r.ray.dir_y = static_cast<float>(direction.y);
    r.ray.dir_z = static_cast<float>(direction.z);
    r.ray.tfar = kInfinity;
    r.ray.mask = ~0u;
    r.hit.geomID = r.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(mImpl->embree, &context, &r);

    SurfaceHit h;
    if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return h;
    const SurfacePoint s = mImpl->surfaceSeen(o, Vec3f(direction),
        mImpl->triangleOf(r.hit.geomID, r.hit.primID, r.hit.instID[0]), r.ray.tfar, r.hit.u,
        r.hit.v);
    const Impl::Triangle& t = mImpl->triangle(s.triangle);
    h.hit = true;
    h.distance = r.ray.tfar;
    h.position = Vec3d(s.position) + mImpl->origin;
    h.normal = mImpl->corners(s.triangle).areaVector().normalized();
    h.backFace = h.normal.dot(Vec3f(direction)) > 0;
    h.albedo = s.albedo;
    h.emission = s.emission;
    h.mesh = static_cast<int>(t.mesh);
    h.triangle = static_cast<int>(t.index);
    return h;
}

bool Tracer::occluded(const Vec3d& from, const Vec3d& to) const
{
    const Vec3f o = mImpl->toLocal(from), e = mImpl->toLocal(to), d = e - o;
    // Both ends may lie on surfaces: leave out what rounding there amounts to (see offsetOf()).
    const float rounding = std::max(maxAbs(o), maxAbs(e)) * 0x1p-20f;
    const float margin = std::max(0x1p-17f, mImpl->roundingOf(rounding) / d.length());
    if (!(margin < 0.5f)) return false;
    RTCRay ray{};
    ray.org_x = o.x;
    ray.org_y = o.y;
    ray.org_z = o.z;
    ray.dir_x = d.x;
    ray.dir_y = d.y;
    ray.dir_z = d.z;
    ray.tnear = margin;
    ray.tfar = 1 - margin;
    ray.mask = ~0u;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcOccluded1(mImpl->embree, &context, &ray);
    return ray.tfar < 0;
}

namespace {

/// Closest point of triangle abc to p (Ericson, "Real-Time Collision Detection", 5.1.5).
Vec3f closestOnTriangle(const Vec3f& p, const Vec3f& a, const Vec3f& b, const Vec3f& c)
{
    const Vec3f ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
    const float d1 = ab.dot(ap), d2 = ac.dot(ap);
    if (d1 <= 0 && d2 <= 0) return a;
    const float d3 = ab.dot(bp), d4 = ac.dot(bp);
    if (d3 >= 0 && d4 <= d3) return b;
    const float vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + ab * (d1 / (d1 - d3));
    const float d5 = ab.dot(cp), d6 = ac.dot(cp);
    if (d6 >= 0 && d5 <= d6) return c;
    const float vb = d5 * d2 - d1 * d6;
    if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + ac * (d2 / (d2 - d6));
    const float va = d3 * d6 - d5 * d4;
    if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    const float scale = 1 / (va + vb + vc);
    return a + ab * (vb * scale) + ac * (vc * scale);
}

struct ClosestQuery {
    const Tracer::Impl* impl;
    Vec3f p;
    float distance;
    std::uint32_t triangle;
    bool found = false;
};

/// Triangles that are a line or a point in single precision have no normal; rays miss them too.
bool isDegenerate(const Vec3f& a, const Vec3f& b, const Vec3f& c)
{
    constexpr double kSine2 = 1e-12;
    const Vec3d ab(b - a), ac(c - a);
    return !(ab.cross(ac).length2() > kSine2 * ab.length2() * ac.length2());
}

bool visitTriangle(RTCPointQueryFunctionArguments* args)
{
    auto& q = *static_cast<ClosestQuery*>(args->userPtr);
    const std::uint32_t id
        = q.impl->triangleOf(args->geomID, args->primID, args->context->instID[0]);
    const auto [a, b, c] = q.impl->corners(id);
    if (isDegenerate(a, b, c)) return false;
    const float distance = (closestOnTriangle(q.p, a, b, c) - q.p).length();
    // Ties go to the lower index, whatever order the tree is walked in.
    if (distance > q.distance || (q.found && distance == q.distance && id > q.triangle)) {
        return false;
    }
    q.distance = distance;
    q.triangle = id;
    q.found = true;
    args->query->radius = distance;
    return true;
}

ClosestQuery closest(const Tracer::Impl& impl, const Vec3d& p, double radius)
{
    ClosestQuery q{&impl, impl.toLocal(p), static_cast<float>(radius), 0};
    RTCPointQuery query{};
    query.x = q.p.x;
    query.y = q.p.y;
    query.z = q.p.z;
    query.radius = q.distance;
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    rtcPointQuery(impl.embree, &query, &context, visitTriangle, &q);
    return q;
}

} // namespace

bool Tracer::closestSurface(const Vec3d& p, double radius, double* distance, Vec3d* normal) const
{
    const ClosestQuery q = closest(*mImpl, p, radius);
    if (!q.found) return false;
    if (distance) *distance = q.distance;
    if (normal) *normal = Vec3d(mImpl->corners(q.triangle).areaVector().normalized());
    return true;
}

double Tracer::surfaceRounding(const Vec3d& p, double radius) const
{
    const ClosestQuery q = closest(*mImpl, p, radius);
    if (!q.found) return 0;
    return Impl::offsetOf(mImpl->corners(q.triangle), mImpl->instanceOf(q.triangle));
}

} // namespace lumivdb
