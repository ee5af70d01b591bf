// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file scene_makers.h
/// Small scenes with derived answers.

#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/probe.h>
#include <lumivdb/bake/scene.h>

#include <memory>

namespace lumivdb::test {

inline int addMaterial(Scene& scene, const Color& albedo, const Color& emission, bool doubleSided)
{
    Material m;
    m.baseColor = albedo;
    m.emission = emission;
    m.doubleSided = doubleSided;
    scene.materials.push_back(m);
    return static_cast<int>(scene.materials.size()) - 1;
}

/// Quad a, a+u, a+u+v, a+v; its front is the side u × v points to.
inline void addQuad(Scene& scene, int material, const Vec3d& a, const Vec3d& u, const Vec3d& v)
{
    Mesh mesh;
    mesh.material = material;
    mesh.positions = {a, a + u, a + u + v, a + v};
    mesh.triangles = {{{0, 1, 2}}, {{0, 2, 3}}};
    scene.meshes.push_back(mesh);
}

/// Closed box whose fronts look inward.
inline void addInwardBox(Scene& scene, int material, const Vec3d& lower, const Vec3d& size)
{
    const Vec3d x(size.x, 0, 0), y(0, size.y, 0), z(0, 0, size.z), upper = lower + size;
    addQuad(scene, material, lower, z, x);
    addQuad(scene, material, lower, x, y);
    addQuad(scene, material, lower, y, z);
    addQuad(scene, material, upper, -x, -z);
    addQuad(scene, material, upper, -y, -x);
    addQuad(scene, material, upper, -z, -y);
}

/// Irradiance at @a p, normal @a n, from a uniform convex polygon of radiance 1 that lies wholly
/// above the horizon: Lambert's formula, E = ½ Σ Γ_i · n with Γ_i the angle-weighted edge normals.
inline double polygonIrradiance(const Vec3d& p, const Vec3d& n, const std::vector<Vec3d>& polygon)
{
    double sum = 0;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
        const Vec3d a = (polygon[i] - p).normalized();
        const Vec3d b = (polygon[(i + 1) % polygon.size()] - p).normalized();
        const Vec3d cross = a.cross(b);
        sum += std::acos(std::max(-1.0, std::min(1.0, a.dot(b)))) * cross.normalized().dot(n);
    }
    return std::abs(0.5 * sum);
}

/// A probe of one point with everything owned.
class Bench {
public:
    Bench(Scene scene, const ProbeOptions& options)
        : mTracer(std::make_shared<Scene>(std::move(scene)))
        , mEstimator(mTracer, options)
    {
    }
    ProbeResult sh(const Vec3d& p, int bands, std::uint64_t key = 1)
    {
        return mEstimator.radianceSh(p, bands, key, mWorkspace);
    }
    ProbeResult irradiance(const Vec3d& p, const std::vector<Vec3f>& normals, std::uint64_t key = 1)
    {
        return mEstimator.irradiance(p, normals, key, mWorkspace);
    }
    const Tracer& tracer() const { return mTracer; }

private:
    Tracer mTracer;
    ProbeEstimator mEstimator;
    ProbeEstimator::Workspace mWorkspace;
};

} // namespace lumivdb::test
