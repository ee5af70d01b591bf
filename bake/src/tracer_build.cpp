// SPDX-License-Identifier: Apache-2.0
#include "tracer_build.h"

#include "tracer_impl.h"

#include <lumivdb/core/error.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

namespace lumivdb {

namespace {

/// An instance takes more memory than as many triangles do.
constexpr std::size_t kAlwaysExpanded = 4;
constexpr float kMostStretch = 64;
constexpr unsigned kFirstInstance = 2; // of Embree's geometries, after the two of local space

/// Rejects hits on masked texels whose alpha is below the cut-off.
void alphaFilter(const RTCFilterFunctionNArguments* args)
{
    const auto& impl = *static_cast<const Tracer::Impl*>(args->geometryUserPtr);
    for (unsigned i = 0; i < args->N; ++i) {
        if (args->valid[i] != -1) continue;
        const unsigned instance = RTCHitN_instID(args->hit, args->N, i, 0);
        const std::uint32_t first = instance == RTC_INVALID_GEOMETRY_ID
            ? impl.opaqueCount
            : impl.instances[instance - kFirstInstance].stored;
        const auto& triangle = impl.triangles[first + RTCHitN_primID(args->hit, args->N, i)];
        float alpha = 1;
        impl.albedoAt(
            triangle, RTCHitN_u(args->hit, args->N, i), RTCHitN_v(args->hit, args->N, i), &alpha);
        if (alpha < impl.materialOf(triangle).alphaCutoff) args->valid[i] = 0;
    }
}

/// How many times larger rounding becomes in the inverse of @a m and back (the condition number of
/// Bauer and Skeel: that of |m⁻¹||m|); scales along the axes do not count.
double stretchOf(const Mat4d& m)
{
    Vec3d row[3];
    for (int i = 0; i < 3; ++i) row[i] = Vec3d(m[i][0], m[i][1], m[i][2]);
    const Vec3d adjugate[3] = {row[1].cross(row[2]), row[2].cross(row[0]), row[0].cross(row[1])};
    const double determinant = row[0].dot(adjugate[0]);
    double most = 0;
    for (int j = 0; j < 3; ++j) {
        double sum = 0;
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < 3; ++k) sum += std::abs(adjugate[k][i] * row[k][j]);
        }
        most = std::max(most, sum / std::abs(determinant));
    }
    return determinant != 0 ? most : HUGE_VAL;
}

std::uint64_t trianglesOf(const Mesh& mesh)
{
    return mesh.triangles.size() * std::uint64_t(mesh.uses());
}

class Builder {
public:
    Builder(Tracer::Impl& impl, const TracerOptions& options)
        : mImpl(impl)
        , mScene(*impl.scene)
        , mOptions(options)
    {
    }

    void run()
    {
        mImpl.bounds = mScene.bounds();
        if (!mImpl.bounds.isEmpty()) mImpl.origin = busiestPlace();
        chooseExpanded();
        reserve();
        gather(false);
        mImpl.opaqueCount = static_cast<std::uint32_t>(mImpl.triangles.size());
        gather(true);
        mImpl.placedCount = static_cast<std::uint32_t>(mImpl.triangles.size());
        gatherInstances();
        gatherLooks();
        addEmitters();
        chooseQuality();
        buildEmbree();
    }

private:
    /// A mesh that is not expanded.
    struct Part {
        std::uint32_t firstTriangle, lastTriangle; // into Impl::triangles
        std::uint32_t firstInstance, lastInstance;
        bool masked;
    };

    /// Median of the triangles, axis by axis: single precision is finest there. In the middle of a
    /// wide ground with a small house on it, the house would have less of it than the grass.
    Vec3d busiestPlace() const
    {
        constexpr std::uint64_t kLook = 1 << 16; // triangles, about; of each mesh one at least
        const std::uint64_t step = 1 + mScene.triangleCount() / kLook;
        std::vector<double> coordinates[3];
        for (const Mesh& mesh : mScene.meshes) {
            const std::uint64_t count = mesh.triangles.size();
            for (std::uint64_t i = 0; i < trianglesOf(mesh); i += step) {
                const Vec3d p = mesh.worldPosition(i / count, mesh.triangles[i % count][0]);
                for (int a = 0; a < 3; ++a) coordinates[a].push_back(p[a]);
            }
        }
        Vec3d median;
        for (int a = 0; a < 3; ++a) {
            const auto middle = coordinates[a].begin() + std::ptrdiff_t(coordinates[a].size() / 2);
            std::nth_element(coordinates[a].begin(), middle, coordinates[a].end());
            median[a] = *middle;
        }
        return median;
    }

    const Material& materialOf(const Mesh& mesh) const
    {
        return mScene.materials[static_cast<std::size_t>(mesh.material)];
    }

    bool mustExpand(const Mesh& mesh) const
    {
        return mesh.uses() == 1 || mesh.triangles.size() <= kAlwaysExpanded
            || luminance(materialOf(mesh).emission) > 0
            || std::any_of(mesh.instances.begin(), mesh.instances.end(),
                [](const Mat4d& m) { return !(stretchOf(m) <= kMostStretch); });
    }

    void chooseExpanded()
    {
        mExpanded.assign(mScene.meshes.size(), true);
        std::uint64_t placed = 0;
        std::vector<std::size_t> others;
        for (std::size_t m = 0; m < mScene.meshes.size(); ++m) {
            if (mustExpand(mScene.meshes[m])) {
                placed += trianglesOf(mScene.meshes[m]);
            } else {
                others.push_back(m);
            }
        }
        std::stable_sort(others.begin(), others.end(), [&](std::size_t a, std::size_t b) {
            return trianglesOf(mScene.meshes[a]) < trianglesOf(mScene.meshes[b]);
        });
        for (const std::size_t m : others) {
            placed += trianglesOf(mScene.meshes[m]);
            mExpanded[m] = placed <= mOptions.expandUpTo;
        }
    }

    /// Exactly what is needed, as vectors that grow would take up to twice that.
    void reserve()
    {
        std::uint64_t triangles = 0, vertices = 0, instances = 0;
        for (std::size_t m = 0; m < mScene.meshes.size(); ++m) {
            const Mesh& mesh = mScene.meshes[m];
            const std::uint64_t copies = mExpanded[m] ? mesh.uses() : 1;
            triangles += copies * mesh.triangles.size();
            vertices += copies * mesh.positions.size();
            if (!mExpanded[m]) instances += mesh.uses();
        }
        constexpr std::uint64_t kMost = 0xfffffffe; // one number means none
        if (mScene.triangleCount() > kMost || vertices > kMost) {
            throw Error(ErrorCode::Input,
                "The scene has " + std::to_string(mScene.triangleCount()) + " triangles, those of "
                    + "instances counted each time; " + std::to_string(kMost)
                    + " is the most, so bake parts of it.");
        }
        mImpl.triangleCount = static_cast<std::uint32_t>(mScene.triangleCount());
        mImpl.triangles.reserve(triangles);
        mImpl.vertices.reserve(vertices + 1); // Embree reads four floats at the last one
        mImpl.instances.reserve(instances);
    }

    void gather(bool masked)
    {
        for (std::size_t m = 0; m < mScene.meshes.size(); ++m) {
            const Mesh& mesh = mScene.meshes[m];
            if (!mExpanded[m] || materialOf(mesh).alphaMask != masked) continue;
            for (std::size_t use = 0; use < mesh.uses(); ++use) {
                const auto base = static_cast<std::uint32_t>(mImpl.vertices.size());
                for (std::size_t v = 0; v < mesh.positions.size(); ++v) {
                    mImpl.vertices.push_back(mImpl.toLocal(mesh.worldPosition(use, v)));
                }
                addTriangles(m, base);
            }
        }
    }

    void addTriangles(std::size_t mesh, std::uint32_t base)
    {
        std::uint32_t index = 0;
        for (const auto& v : mScene.meshes[mesh].triangles) {
            mImpl.triangles.push_back({{base + v[0], base + v[1], base + v[2]},
                static_cast<std::uint32_t>(mesh), index++, -1});
        }
    }

    void gatherLooks()
    {
        for (const Mesh& mesh : mScene.meshes) {
            const Material& m = materialOf(mesh);
            Tracer::Impl::Look look;
            const TextureSlot& slot = m.baseColorTexture;
            const bool placed = slot.texture >= 0 && !mesh.uv[slot.uvSet == 1 ? 1 : 0].empty();
            look.texels = placed ? &mImpl.texels[static_cast<std::size_t>(slot.texture)] : nullptr;
            look.evenEmission = m.emissionTexture.texture < 0 && !m.alphaMask;
            look.evenAlbedo = !look.texels && mesh.colors.empty();
            look.albedo = m.baseColor;
            for (int c = 0; c < 3; ++c) look.albedo[c] = std::clamp(look.albedo[c], 0.0f, 1.0f);
            look.emission = m.emission;
            look.doubleSided = m.doubleSided;
            look.emitsFrontOnly = m.emitsFrontOnly;
            mImpl.looks.push_back(look);
        }
    }

    void gatherInstances()
    {
        std::uint32_t number = mImpl.placedCount;
        for (std::size_t m = 0; m < mScene.meshes.size(); ++m) {
            if (mExpanded[m]) continue;
            const Mesh& mesh = mScene.meshes[m];
            const auto base = static_cast<std::uint32_t>(mImpl.vertices.size());
            const auto stored = static_cast<std::uint32_t>(mImpl.triangles.size());
            Box3d box;
            for (const Vec3d& p : mesh.positions) box.extendBy(p);
            for (const Vec3d& p : mesh.positions) {
                mImpl.vertices.push_back(Vec3f(p - box.center()));
            }
            addTriangles(m, base);
            const auto first = static_cast<std::uint32_t>(mImpl.instances.size());
            for (const Mat4d& place : mesh.instances) {
                const auto instance = instanceOf(place, box.center(), number, stored);
                mImpl.instances.push_back(instance);
                mImpl.mostStretch = std::max(mImpl.mostStretch, instance.stretch);
                mImpl.mostRounding = std::max(mImpl.mostRounding, instance.rounding());
                number += static_cast<std::uint32_t>(mesh.triangles.size());
            }
            mParts.push_back({stored, static_cast<std::uint32_t>(mImpl.triangles.size()), first,
                static_cast<std::uint32_t>(mImpl.instances.size()), materialOf(mesh).alphaMask});
        }
    }

    Tracer::Impl::Instance instanceOf(
        const Mat4d& place, const Vec3d& middle, std::uint32_t number, std::uint32_t stored) const
    {
        Tracer::Impl::Instance instance;
        instance.first = number;
        instance.stored = stored;
        for (int i = 0; i < 3; ++i) {
            instance.axes[i] = Vec3f(Vec3d(place[i][0], place[i][1], place[i][2]));
        }
        instance.shift = mImpl.toLocal(transformAffine(place, middle));
        instance.stretch = static_cast<float>(stretchOf(place));
        return instance;
    }

    /// Triangles that coincide and shine to the same side are one emitter: a ray meets one of them.
    void addEmitters()
    {
        std::map<std::array<float, 9>, std::int32_t> known;
        for (std::size_t i = 0; i < mImpl.placedCount; ++i) { // what emits is always placed
            Tracer::Impl::Triangle& t = mImpl.triangles[i];
            const Material& material = mImpl.materialOf(t);
            if (!(luminance(material.emission) > 0)) continue;
            const Corners corners = mImpl.corners(t, nullptr);
            const auto& [a, b, c] = corners;
            EmitterTable::Triangle e;
            e.triangle = static_cast<std::uint32_t>(i);
            e.a = a;
            e.ab = b - a;
            e.ac = c - a;
            e.normal = e.ab.cross(e.ac);
            e.area = 0.5f * e.normal.length();
            if (!(e.area > 0)) continue;
            e.normal.normalize();
            e.offset = corners.rounding();
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

    /// On Sponza (Crytek) and on 10⁷ triangles the surface area heuristic takes 0.1 to 0.15 µs a
    /// triangle more than a Morton curve does, and saves 0.1 to 0.12 µs a ray. (Embree 3 has no
    /// spatial splits for robust scenes: HIGH is as MEDIUM.)
    void chooseQuality()
    {
        const auto triangles = static_cast<double>(mImpl.triangles.size());
        const bool few = mOptions.expectedRays > 0 && mOptions.expectedRays < triangles;
        mImpl.quality = few ? RTC_BUILD_QUALITY_LOW : RTC_BUILD_QUALITY_HIGH;
    }

    void buildEmbree()
    {
        // One instruction set wherever it exists, so that machines agree on the bits of a hit.
        mImpl.device = rtcNewDevice("isa=avx2");
        if (!mImpl.device) throw Error(ErrorCode::Input, "Embree cannot start on this machine.");
        mImpl.embree = newScene();
        attach(mImpl.embree, 0, 0, mImpl.opaqueCount, false);
        attach(mImpl.embree, 1, mImpl.opaqueCount, mImpl.placedCount, true);
        for (const Part& part : mParts) attachInstances(part);
        rtcCommitScene(mImpl.embree);
        if (rtcGetDeviceError(mImpl.device) != RTC_ERROR_NONE) {
            throw Error(ErrorCode::Input,
                "Embree could not build its structure for " + std::to_string(mImpl.triangles.size())
                    + " triangles; there may be too little memory.");
        }
    }

    RTCScene newScene() const
    {
        RTCScene scene = rtcNewScene(mImpl.device);
        rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION);
        rtcSetSceneBuildQuality(scene, mImpl.quality);
        return scene;
    }

    /// Embree reads vertices and triangles where they are.
    void attach(RTCScene scene, unsigned id, std::uint32_t first, std::uint32_t last, bool masked)
    {
        if (first == last) return;
        RTCGeometry g = rtcNewGeometry(mImpl.device, RTC_GEOMETRY_TYPE_TRIANGLE);
        rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
            mImpl.vertices.data(), 0, sizeof(Vec3f), mImpl.vertices.size());
        rtcSetSharedGeometryBuffer(g, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
            mImpl.triangles[first].vertex, 0, sizeof(Tracer::Impl::Triangle), last - first);
        rtcSetGeometryBuildQuality(g, mImpl.quality);
        rtcSetGeometryUserData(g, &mImpl);
        if (masked) {
            rtcSetGeometryIntersectFilterFunction(g, alphaFilter);
            rtcSetGeometryOccludedFilterFunction(g, alphaFilter);
        }
        rtcCommitGeometry(g);
        rtcAttachGeometryByID(scene, g, id);
        rtcReleaseGeometry(g);
    }

    void attachInstances(const Part& part)
    {
        RTCScene scene = newScene();
        attach(scene, 0, part.firstTriangle, part.lastTriangle, part.masked);
        rtcCommitScene(scene);
        for (std::uint32_t i = part.firstInstance; i < part.lastInstance; ++i) {
            RTCGeometry g = rtcNewGeometry(mImpl.device, RTC_GEOMETRY_TYPE_INSTANCE);
            rtcSetGeometryInstancedScene(g, scene);
            rtcSetGeometryTransform(
                g, 0, RTC_FORMAT_FLOAT3X4_COLUMN_MAJOR, mImpl.instances[i].axes);
            rtcCommitGeometry(g);
            rtcAttachGeometryByID(mImpl.embree, g, kFirstInstance + i);
            rtcReleaseGeometry(g);
        }
        rtcReleaseScene(scene); // the instances keep it
    }

    Tracer::Impl& mImpl;
    const Scene& mScene;
    TracerOptions mOptions;
    std::vector<bool> mExpanded; // by mesh
    std::vector<Part> mParts;
};

} // namespace

void buildTracer(Tracer::Impl& impl, const TracerOptions& options) { Builder(impl, options).run(); }

} // namespace lumivdb
