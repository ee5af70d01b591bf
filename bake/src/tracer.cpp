// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/tracer.h>

#include "tracer_impl.h"

#include <lumivdb/core/error.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <tuple>

namespace lumivdb {

namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();

float maxAbs(const Vec3f& v) { return std::max({std::abs(v.x), std::abs(v.y), std::abs(v.z)}); }

/// Rounding of vertices and of Embree's distances grows with the size of the coordinates: eight
/// units in the last place of the largest.
float rayOffset(const Vec3f& a, const Vec3f& b, const Vec3f& c)
{
    return std::max({maxAbs(a), maxAbs(b), maxAbs(c)}) * 0x1p-20f;
}

template <class T>
T interpolate(const std::vector<T>& values, const std::array<std::uint32_t, 3>& t, float u, float v)
{
    return values[t[0]] * (1 - u - v) + values[t[1]] * u + values[t[2]] * v;
}

/// Coordinates in the texture of @a slot; false where there is none.
bool placeInSlot(const TextureSlot& slot, const Mesh& mesh, std::uint32_t triangle, float u,
    float v, Vec2f& place)
{
    if (slot.texture < 0) return false;
    const std::vector<Vec2f>& uv = mesh.uv[slot.uvSet == 1 ? 1 : 0];
    if (uv.empty()) return false;
    const Vec2f st = interpolate(uv, mesh.triangles[triangle], u, v);
    const auto& m = slot.transform;
    place = {m[0] * st.x + m[1] * st.y + m[2], m[3] * st.x + m[4] * st.y + m[5]};
    return true;
}

std::array<float, 4> sampleSlot(const Tracer::Impl& impl, const TextureSlot& slot, const Mesh& mesh,
    std::uint32_t triangle, float u, float v)
{
    Vec2f place;
    if (!placeInSlot(slot, mesh, triangle, u, v, place)) return {1, 1, 1, 1};
    return impl.texels[static_cast<std::size_t>(slot.texture)].sample(place.x, place.y);
}

/// Rejects hits on masked texels whose alpha is below the cut-off.
void alphaFilter(const RTCFilterFunctionNArguments* args)
{
    const auto& impl = *static_cast<const Tracer::Impl*>(args->geometryUserPtr);
    for (unsigned i = 0; i < args->N; ++i) {
        if (args->valid[i] != -1) continue;
        const unsigned primitive = RTCHitN_primID(args->hit, args->N, i);
        const auto& triangle = impl.triangles[impl.triangleOf(1, primitive)];
        float alpha = 1;
        impl.albedoAt(
            triangle, RTCHitN_u(args->hit, args->N, i), RTCHitN_v(args->hit, args->N, i), &alpha);
        if (alpha < impl.materialOf(triangle).alphaCutoff) args->valid[i] = 0;
    }
}

class Builder {
public:
    Builder(Tracer::Impl& impl)
        : mImpl(impl)
    {
    }

    void run()
    {
        placeOrigin();
        gather(false);
        mImpl.opaqueCount = static_cast<std::uint32_t>(mImpl.triangles.size());
        gather(true);
        addEmitters();
        buildEmbree();
    }

private:
    void placeOrigin()
    {
        const Box3d box = mImpl.scene->bounds();
        if (box.isEmpty()) return;
        mImpl.origin = box.center();
    }

    void gather(bool masked)
    {
        const Scene& scene = *mImpl.scene;
        for (std::size_t m = 0; m < scene.meshes.size(); ++m) {
            const Mesh& mesh = scene.meshes[m];
            if (scene.materials[static_cast<std::size_t>(mesh.material)].alphaMask != masked) {
                continue;
            }
            const auto base = static_cast<std::uint32_t>(mImpl.vertices.size());
            for (const Vec3d& p : mesh.positions) mImpl.vertices.push_back(mImpl.toLocal(p));
            for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
                const auto& v = mesh.triangles[t];
                mImpl.triangles.push_back({{base + v[0], base + v[1], base + v[2]},
                    static_cast<std::uint32_t>(m), static_cast<std::uint32_t>(t), -1});
            }
        }
    }

    /// Triangles that coincide and shine to the same side are one emitter: a ray meets one of them.
    void addEmitters()
    {
        std::map<std::array<float, 9>, std::int32_t> known;
        for (std::size_t i = 0; i < mImpl.triangles.size(); ++i) {
            Tracer::Impl::Triangle& t = mImpl.triangles[i];
            const Material& material = mImpl.materialOf(t);
            if (!(luminance(material.emission) > 0)) continue;
            const Vec3f a = mImpl.vertices[t.vertex[0]], b = mImpl.vertices[t.vertex[1]],
                        c = mImpl.vertices[t.vertex[2]];
            EmitterTable::Triangle e;
            e.triangle = static_cast<std::uint32_t>(i);
            e.a = a;
            e.ab = b - a;
            e.ac = c - a;
            e.normal = e.ab.cross(e.ac);
            e.area = 0.5f * e.normal.length();
            if (!(e.area > 0)) continue;
            e.normal.normalize();
            e.offset = rayOffset(a, b, c);
            e.doubleSided = material.doubleSided && !material.emitsFrontOnly;
            const auto twin = known.emplace(emitterKey({a, b, c}, e.doubleSided), 0);
            if (!twin.second) {
                t.emitter = twin.first->second;
                continue;
            }
            e.power = 3.14159265358979 * e.area * (e.doubleSided ? 2 : 1) * meanEmission(t);
            t.emitter = twin.first->second = mImpl.emitters.add(e);
        }
        mImpl.emitters.finish(mImpl.scene->environment);
        mImpl.punctual = PunctualTable(mImpl.scene->lights, mImpl.origin);
    }

    /// The vertices from the smallest on, in their order, or sorted where both sides shine.
    static std::array<float, 9> emitterKey(std::array<Vec3f, 3> v, bool doubleSided)
    {
        const auto less = [](const Vec3f& a, const Vec3f& b) {
            return std::tie(a.x, a.y, a.z) < std::tie(b.x, b.y, b.z);
        };
        if (doubleSided) {
            std::sort(v.begin(), v.end(), less);
        } else {
            std::rotate(v.begin(), std::min_element(v.begin(), v.end(), less), v.end());
        }
        return {v[0].x, v[0].y, v[0].z, v[1].x, v[1].y, v[1].z, v[2].x, v[2].y, v[2].z};
    }

    /// Mean luminance over a triangle from a few texels, never 0: a weight for choosing, and what
    /// the texels missed must still be found.
    double meanEmission(const Tracer::Impl::Triangle& t) const
    {
        const Material& material = mImpl.materialOf(t);
        const double untextured = luminance(material.emission);
        if (material.emissionTexture.texture < 0) return untextured;
        constexpr int kGrid = 8;
        double sum = 0;
        int count = 0;
        for (int i = 0; i < kGrid; ++i) {
            for (int j = 0; i + j < kGrid; ++j, ++count) {
                sum += luminance(
                    mImpl.emissionAt(t, (i + 1 / 3.0f) / kGrid, (j + 1 / 3.0f) / kGrid));
            }
        }
        return std::max(sum / count, 0.01 * untextured);
    }

    void buildEmbree()
    {
        // One instruction set wherever it exists, so that machines agree on the bits of a hit.
        mImpl.device = rtcNewDevice("isa=avx2");
        if (!mImpl.device) throw Error(ErrorCode::Input, "Embree cannot start on this machine.");
        mImpl.embree = rtcNewScene(mImpl.device);
        rtcSetSceneFlags(
            mImpl.embree, RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION);
        rtcSetSceneBuildQuality(mImpl.embree, RTC_BUILD_QUALITY_HIGH);
        attach(0, 0, mImpl.opaqueCount);
        attach(1, mImpl.opaqueCount, static_cast<std::uint32_t>(mImpl.triangles.size()));
        rtcCommitScene(mImpl.embree);
        if (rtcGetDeviceError(mImpl.device) != RTC_ERROR_NONE) {
            throw Error(ErrorCode::Input,
                "Embree could not build its structure for " + std::to_string(mImpl.triangles.size())
                    + " triangles; there may be too little memory.");
        }
    }

    void attach(unsigned id, std::uint32_t first, std::uint32_t last)
    {
        if (first == last) return;
        RTCGeometry g = rtcNewGeometry(mImpl.device, RTC_GEOMETRY_TYPE_TRIANGLE);
        auto* v = static_cast<float*>(rtcSetNewGeometryBuffer(
            g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, sizeof(Vec3f), mImpl.vertices.size()));
        auto* t = static_cast<std::uint32_t*>(rtcSetNewGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0,
            RTC_FORMAT_UINT3, 3 * sizeof(std::uint32_t), last - first));
        if (v && t) {
            std::copy_n(&mImpl.vertices[0].x, mImpl.vertices.size() * 3, v);
            for (std::uint32_t i = first; i < last; ++i) {
                t = std::copy_n(mImpl.triangles[i].vertex, 3, t);
            }
            rtcSetGeometryUserData(g, &mImpl);
            if (id == 1) {
                rtcSetGeometryIntersectFilterFunction(g, alphaFilter);
                rtcSetGeometryOccludedFilterFunction(g, alphaFilter);
            }
            rtcCommitGeometry(g);
            rtcAttachGeometryByID(mImpl.embree, g, id);
        }
        rtcReleaseGeometry(g);
    }

    Tracer::Impl& mImpl;
};

} // namespace

Tracer::Impl::~Impl()
{
    if (embree) rtcReleaseScene(embree);
    if (device) rtcReleaseDevice(device);
}

Color Tracer::Impl::albedoAt(const Triangle& t, float u, float v, float* alpha) const
{
    const Mesh& mesh = scene->meshes[t.mesh];
    const Material& material = materialOf(t);
    const auto texel = sampleSlot(*this, material.baseColorTexture, mesh, t.index, u, v);
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

void Tracer::Impl::prefetchAlbedo(std::uint32_t triangle, float u, float v) const
{
    const Triangle& t = triangles[triangle];
    const TextureSlot& slot = materialOf(t).baseColorTexture;
    Vec2f place;
    if (!placeInSlot(slot, scene->meshes[t.mesh], t.index, u, v, place)) return;
    texels[static_cast<std::size_t>(slot.texture)].prefetch(place.x, place.y);
}

Color Tracer::Impl::emissionAt(const Triangle& t, float u, float v) const
{
    const Material& material = materialOf(t);
    if (material.alphaMask) {
        // A texel that rays pass through gives no light either.
        float alpha = 1;
        albedoAt(t, u, v, &alpha);
        if (alpha < material.alphaCutoff) return Color(0.0f);
    }
    const auto texel
        = sampleSlot(*this, material.emissionTexture, scene->meshes[t.mesh], t.index, u, v);
    return {material.emission.x * texel[0], material.emission.y * texel[1],
        material.emission.z * texel[2]};
}

SurfacePoint Tracer::Impl::surfaceAt(
    std::uint32_t triangle, float u, float v, const Vec3f& rayDirection) const
{
    const Triangle& t = triangles[triangle];
    const Vec3f &a = vertices[t.vertex[0]], &b = vertices[t.vertex[1]], &c = vertices[t.vertex[2]];
    const Material& material = materialOf(t);
    SurfacePoint s;
    s.position = a * (1 - u - v) + b * u + c * v;
    s.normal = (b - a).cross(c - a).normalized();
    s.offset = rayOffset(a, b, c);
    s.emitter = t.emitter;
    s.triangle = triangle;
    const bool behind = s.normal.dot(rayDirection) > 0;
    if (behind) s.normal = -s.normal;
    s.backFace = behind && !material.doubleSided;
    s.albedo = s.backFace ? Color(0.0f) : albedoAt(t, u, v, nullptr);
    const bool dark = t.emitter < 0 || s.backFace || (behind && material.emitsFrontOnly);
    s.emission = dark ? Color(0.0f) : emissionAt(t, u, v);
    return s;
}

namespace {

struct FrontContext {
    RTCIntersectContext context; // first: Embree hands back a pointer to it
    const Tracer::Impl* impl;
};

/// Rejects the backs of single-sided triangles.
void frontFilter(const RTCFilterFunctionNArguments* args)
{
    const Tracer::Impl& impl = *reinterpret_cast<const FrontContext*>(args->context)->impl;
    for (unsigned i = 0; i < args->N; ++i) {
        if (args->valid[i] != -1) continue;
        const auto& t = impl.triangles[impl.triangleOf(
            RTCHitN_geomID(args->hit, args->N, i), RTCHitN_primID(args->hit, args->N, i))];
        const Vec3f d(RTCRayN_dir_x(args->ray, args->N, i), RTCRayN_dir_y(args->ray, args->N, i),
            RTCRayN_dir_z(args->ray, args->N, i));
        const Vec3f &a = impl.vertices[t.vertex[0]], &b = impl.vertices[t.vertex[1]],
                    &c = impl.vertices[t.vertex[2]];
        const bool behind = (b - a).cross(c - a).dot(d) > 0;
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
    RTCRayHit r{};
    r.ray = {from.x, from.y, from.z, std::max(0.0f, t - tolerance), direction.x, direction.y,
        direction.z, 0, t + tolerance, ~0u, 0, 0};
    r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(embree, &context.context, &r);
    if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return s;
    return surfaceAt(triangleOf(r.hit.geomID, r.hit.primID), r.hit.u, r.hit.v, direction);
}

Tracer::Tracer(std::shared_ptr<const Scene> scene, Progress* progress)
    : mImpl(std::make_unique<Impl>())
{
    const auto start = std::chrono::steady_clock::now();
    if (progress) progress->begin("build the ray structure", 1);
    mImpl->scene = std::move(scene);
    const std::vector<Texture>& textures = mImpl->scene->textures;
    mImpl->texels.reserve(textures.size());
    for (const Texture& texture : textures) mImpl->texels.emplace_back(texture);
    Builder(*mImpl).run();
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
    r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    rtcIntersect1(mImpl->embree, &context, &r);

    SurfaceHit h;
    if (r.hit.geomID == RTC_INVALID_GEOMETRY_ID) return h;
    const SurfacePoint s = mImpl->surfaceSeen(o, Vec3f(direction),
        mImpl->triangleOf(r.hit.geomID, r.hit.primID), r.ray.tfar, r.hit.u, r.hit.v);
    const Impl::Triangle& t = mImpl->triangles[s.triangle];
    h.hit = true;
    h.distance = r.ray.tfar;
    h.position = Vec3d(s.position) + mImpl->origin;
    const Vec3f &a = mImpl->vertices[t.vertex[0]], &b = mImpl->vertices[t.vertex[1]],
                &c = mImpl->vertices[t.vertex[2]];
    h.normal = (b - a).cross(c - a).normalized();
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
    // Both ends may lie on surfaces: leave out what rounding there amounts to (see rayOffset()).
    const float margin = std::max(0x1p-17f, std::max(maxAbs(o), maxAbs(e)) * 0x1p-20f / d.length());
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
    const std::uint32_t id = q.impl->triangleOf(args->geomID, args->primID);
    const auto& t = q.impl->triangles[id];
    const Vec3f &a = q.impl->vertices[t.vertex[0]], &b = q.impl->vertices[t.vertex[1]],
                &c = q.impl->vertices[t.vertex[2]];
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

} // namespace

bool Tracer::closestSurface(const Vec3d& p, double radius, double* distance, Vec3d* normal) const
{
    ClosestQuery q{mImpl.get(), mImpl->toLocal(p), static_cast<float>(radius), 0};
    RTCPointQuery query{};
    query.x = q.p.x;
    query.y = q.p.y;
    query.z = q.p.z;
    query.radius = q.distance;
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    rtcPointQuery(mImpl->embree, &query, &context, visitTriangle, &q);
    if (!q.found) return false;
    const Impl::Triangle& t = mImpl->triangles[q.triangle];
    const Vec3f &a = mImpl->vertices[t.vertex[0]], &b = mImpl->vertices[t.vertex[1]],
                &c = mImpl->vertices[t.vertex[2]];
    if (distance) *distance = q.distance;
    if (normal) *normal = Vec3d((b - a).cross(c - a).normalized());
    return true;
}

} // namespace lumivdb
