// SPDX-License-Identifier: Apache-2.0
//
// Probes among more lights than are weighed one by one, against closed forms and against few lights
// that give the same.
#include "bake_makers.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

double worstDeviation(const ProbeResult& r, const std::vector<double>& truth)
{
    double worst = 0;
    for (std::size_t k = 0; k < truth.size(); ++k)
        for (int c = 0; c < 3; ++c)
            worst = std::max(worst, std::abs(r.value[k][c] - truth[k]) / r.stderr_[k][c]);
    return worst;
}

/// Unit square @a n × n in quads of its own, for addInwardBox's walls.
void addTiled(Scene& scene, int material, const Vec3d& a, const Vec3d& u, const Vec3d& v, int n)
{
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j)
            addQuad(scene, material, a + u * (double(i) / n) + v * (double(j) / n), u / n, v / n);
}

Scene tiledFurnace(float albedo, int n)
{
    Scene scene;
    const int m = addMaterial(scene, Color(albedo), Color(1.0f), false);
    const Vec3d x(1, 0, 0), y(0, 1, 0), z(0, 0, 1), one(1.0);
    for (const auto& [a, u, v] : std::vector<std::array<Vec3d, 3>>{{Vec3d(0.0), z, x},
             {Vec3d(0.0), x, y}, {Vec3d(0.0), y, z}, {one, -x, -z}, {one, -y, -x}, {one, -z, -y}}) {
        addTiled(scene, m, a, u, v, n);
    }
    return scene;
}

} // namespace

TEST_CASE("A furnace of many emitters gives L/(1 - albedo)", "[many_lights]")
{
    ProbeOptions options;
    options.rays = 8192;
    Bench bench(tiledFurnace(0.5f, 8), options);
    const ProbeResult r = bench.irradiance({0.3, 0.6, 0.45}, {{0, 1, 0}, {1, 0, 0}, {0, 0, -1}});
    CHECK(worstDeviation(r, std::vector<double>(3, kPi * 2)) < 4);
    CHECK(r.stderr_[0].x < 0.02 * 2 * kPi);
}

TEST_CASE("Many panels on a sphere give the sum of Lambert's formula", "[many_lights]")
{
    // Every panel looks at the middle; a third looks away and is not seen.
    Scene scene;
    std::vector<int> materials;
    for (int i = 0; i < 8; ++i)
        materials.push_back(addMaterial(scene, Color(0.0f), Color(std::pow(3.0f, i)), false));
    const Vec3d p(0.4, 0.1, -0.3);
    const std::vector<Vec3f> normals = {{0, 1, 0}, {1, 0, 0}};
    std::vector<double> truth(normals.size(), 0.0);
    CounterRng rng(31);
    constexpr int kPanels = 900;
    for (int i = 0; i < kPanels; ++i) {
        const double z = 1 - 2 * (i + 0.5) / kPanels, phi = 2.399963 * i, r = std::sqrt(1 - z * z);
        const Vec3d out(r * std::cos(phi), z, r * std::sin(phi));
        const Vec3d u = Vec3d(out.y, -out.x, 0).normalized() * 0.03, v = out.cross(u);
        const Vec3d a = out * 2;
        const auto m = static_cast<std::size_t>(rng.nextDouble() * 8);
        const bool seen = i % 3 != 0;
        // u × v points outward.
        if (seen)
            addQuad(scene, materials[m], a, v, u);
        else
            addQuad(scene, materials[m], a, u, v);
        for (std::size_t k = 0; seen && k < normals.size(); ++k) {
            const Vec3d n(normals[k]);
            if ((a - p).dot(n) > 0.05)
                truth[k]
                    += std::pow(3.0, m) * polygonIrradiance(p, n, {a, a + v, a + v + u, a + u});
        }
    }
    ProbeOptions options;
    options.rays = 4096;
    Bench bench(std::move(scene), options);
    const ProbeResult r = bench.irradiance(p, normals);
    // Panels across the horizon are left out of the truth: less than this share of it.
    CHECK(worstDeviation(r, truth) < 4);
    CHECK(r.stderr_[0].x < 0.03 * truth[0]);
}

TEST_CASE("Lights in twenty parts light as they did whole", "[many_lights]")
{
    const auto room = [](int parts) {
        Scene scene = litRoom();
        scene.lights.clear();
        CounterRng rng(8);
        for (int i = 0; i < 40; ++i) {
            Light light;
            const double x = rng.nextDouble(), y = rng.nextDouble();
            light.position = Vec3d(x, y, rng.nextDouble()) * 1.5 + Vec3d(0.05);
            light.intensity = Color(static_cast<float>(rng.nextDouble())) / float(parts);
            if (i % 3 == 1) {
                light.type = LightType::Spot;
                light.direction = Vec3d(0.6, 0, 0.8);
                light.innerConeAngle = 0.4;
            }
            if (i % 13 == 5) {
                light.type = LightType::Directional;
                light.direction = Vec3d(0.48, -0.6, 0.64);
            }
            if (i % 4 == 2) light.range = 1;
            for (int k = 0; k < parts; ++k) scene.lights.push_back(light);
        }
        return scene;
    };
    ProbeOptions options;
    options.rays = 8192;
    Bench few(room(1), options), many(room(20), options);
    for (const Vec3d& p : {Vec3d(0.8, 0.8, 0.8), Vec3d(0.3, 1.2, 0.5)}) {
        const ProbeResult a = few.sh(p, 2), b = many.sh(p, 2, 77);
        for (std::size_t k = 0; k < a.value.size(); ++k) {
            const double sigma = std::hypot(a.stderr_[k].x, b.stderr_[k].x);
            CHECK(std::abs(a.value[k].x - b.value[k].x) < 4.5 * sigma);
        }
        // Equal chances would need twenty times the rays for this.
        CHECK(b.stderr_[0].x < 2 * a.stderr_[0].x);
    }
}

TEST_CASE("Hundreds of lights at a probe: each its inverse square, shadow and gradient",
    "[many_lights][gradient]")
{
    // More than a batch. A black sheet hides what is above it.
    Scene scene;
    const int black = addMaterial(scene, Color(0.0f), Color(0.0f), true);
    addQuad(scene, black, {-500, 1, -500}, {0, 0, 1000}, {1000, 0, 0});
    CounterRng rng(4);
    const Vec3d p(0.1, -0.3, 0.2), normal(0.6, 0, 0.8);
    double E = 0, intensity = 0;
    Vec3d change(0.0);
    for (int i = 0; i < 700; ++i) {
        Light light;
        const double x = rng.nextDouble(), y = rng.nextDouble(), z = rng.nextDouble();
        light.position = Vec3d(x, y, z) * 8.0 - Vec3d(4.0);
        light.intensity = Color(static_cast<float>(rng.nextDouble()));
        scene.lights.push_back(light);
        if (light.position.y > 1) continue;
        const Vec3d d = light.position - p;
        const double d2 = d.length2(), I = light.intensity.x;
        E += I * std::max(0.0, normal.dot(d)) / (d2 * std::sqrt(d2));
        intensity += I / d2;
        change += d * (2 * I / (d2 * d2));
    }
    ProbeOptions options;
    options.rays = 64;
    Bench bench(scene, options);
    CHECK(bench.irradiance(p, {Vec3f(normal)}).value[0].x == Approx(E).epsilon(2e-5));
    ProbeEstimator::Workspace workspace;
    const ProbeResult r
        = ProbeEstimator(bench.tracer(), options).radianceSh(p, 2, 1, workspace, true);
    const double Y0 = 0.5 / std::sqrt(kPi);
    CHECK(r.value[0].x == Approx(Y0 * intensity).epsilon(2e-5));
    CHECK(r.stderr_[0].x == 0);
    for (int axis = 0; axis < 3; ++axis) {
        const auto k = static_cast<std::size_t>(axis) * r.value.size();
        CHECK(r.gradient[k].x == Approx(Y0 * change[axis]).margin(1e-4 * Y0 * change.length()));
    }
}
