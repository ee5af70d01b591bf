// SPDX-License-Identifier: Apache-2.0
// Gradients that are known exactly: derivatives of closed forms, taken in double precision.

#include <catch2/catch.hpp>

#include "gradient_fixture.h"

#include <lumivdb/bake/environment.h>

#include <cmath>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

Scene emptyScene()
{
    Scene scene;
    addMaterial(scene, Color(1.0f), Color(0.0f), false);
    return scene;
}

std::vector<Color> gradientOf(const Tracer& tracer, int rays, const Vec3d& p, int bands)
{
    const ProbeEstimator estimator(tracer, withRays(rays));
    ProbeEstimator::Workspace workspace;
    return estimator.radianceSh(p, bands, 1, workspace, true).gradient;
}

/// Corners of the quad a, a+u, a+u+v, a+v.
std::vector<Vec3d> corners(const Vec3d& a, const Vec3d& u, const Vec3d& v)
{
    return {a, a + u, a + u + v, a + v};
}

/// Every coefficient of six bands of a light E(p)·Y(ω(p)) against its derivative.
void checkPunctual(const Light& light, const Vec3d& p, const ClosedForm& irradiance)
{
    Scene scene = emptyScene();
    scene.lights.push_back(light);
    const auto tracer = makeTracer(scene);
    const auto g = gradientOf(*tracer, 2, p, 6);
    double largest = 0;
    for (const Color& c : g) largest = std::max(largest, std::abs(static_cast<double>(c.x)));
    for (int axis = 0; axis < 3; ++axis) {
        for (int k = 0; k < 36; ++k) {
            const auto f = [&](const Vec3d& q) {
                double y[36];
                evalShBasis(6, (light.position - q).normalized(), y);
                return irradiance(q) * y[k];
            };
            CAPTURE(axis, k);
            CHECK(static_cast<double>(g[static_cast<std::size_t>(axis * 36 + k)].x)
                == Approx(derivative(f, p, axis)).margin(1e-5 * largest));
        }
    }
}

} // namespace

TEST_CASE("gradient of a point light: inverse square", "[gradient]")
{
    Light light;
    light.position = {0.4, 1.5, -0.7};
    light.intensity = Color(3.0f);
    const Vec3d p(0.1, 0.2, 0.3);
    checkPunctual(light, p, [&](const Vec3d& q) { return 3 / (light.position - q).length2(); });
}

TEST_CASE("gradient of a point light with a range", "[gradient]")
{
    Light light;
    light.position = {0.4, 1.5, -0.7};
    light.intensity = Color(3.0f);
    light.range = 2;
    checkPunctual(light, {0.1, 0.2, 0.3}, [&](const Vec3d& q) {
        const double d2 = (light.position - q).length2();
        return 3 / d2 * (1 - d2 * d2 / 16);
    });
}

TEST_CASE("gradient of a spot light inside its cone's rim", "[gradient]")
{
    Light light;
    light.type = LightType::Spot;
    light.position = {0.1, 2.2, 0.3};
    light.direction = {0, -1, 0};
    light.intensity = Color(3.0f);
    light.innerConeAngle = 0.1;
    light.outerConeAngle = 0.6;
    checkPunctual(light, {0.6, 0.9, 0.0}, [&](const Vec3d& q) {
        const Vec3d d = light.position - q;
        const double cosine = d.y / d.length();
        const double a = (cosine - std::cos(0.6)) / (std::cos(0.1) - std::cos(0.6));
        return 3 / d.length2() * a * a;
    });
}

TEST_CASE("gradient of light from infinity without geometry is exactly zero", "[gradient]")
{
    Scene scene = emptyScene();
    Light sun;
    sun.type = LightType::Directional;
    sun.direction = {0, -1, 0};
    scene.lights.push_back(sun);
    std::vector<Color> pixels(32 * 16, Color(0.5f));
    pixels[100] = Color(1e5f);
    scene.environment = Environment::fromPixels(32, 16, pixels, {});
    const auto tracer = makeTracer(scene);
    for (const int rays : {2, 3, 5, 100, 1024, 5000}) {
        for (const Color& c : gradientOf(*tracer, rays, {0.3, -0.2, 5}, 4)) {
            CHECK(c == Color(0.0f));
        }
    }
}

TEST_CASE("gradient in a closed furnace vanishes", "[gradient]")
{
    // Every surface sends the same radiance everywhere, so nothing changes with the place.
    Scene scene;
    addInwardBox(
        scene, addMaterial(scene, Color(0.5f), Color(1.0f), false), {-1, -2, -1.5}, {2, 3, 4});
    const auto tracer = makeTracer(scene);
    const MeanGradient g = analyticGradient(*tracer, withRays(1024), {0.2, 0.1, 0.4}, 3, 16);
    for (int axis = 0; axis < 3; ++axis) {
        for (int k = 0; k < 9; ++k) {
            CAPTURE(axis, k, g.at(axis, k), g.errorAt(axis, k));
            // Radiance is 2, one coefficient 2·√(4π) = 7.1.
            CHECK(std::abs(g.at(axis, k)) <= 4.5 * g.errorAt(axis, k) + 0.01);
            CHECK(g.errorAt(axis, k) < 0.15);
        }
    }
}

TEST_CASE("gradient of an emitting quad: Lambert's formula differentiated", "[gradient]")
{
    // Small and far, large and near: found by emitter samples alone, and by both.
    const struct {
        double size;
        Vec3d p;
        int rays;
    } cases[] = {{0.2, {0.1, 0.2, -0.3}, 1024}, {0.2, {0.1, 0.2, -0.3}, 1500},
        {1.5, {0.1, 0.2, -0.3}, 1024}, {4.0, {0.3, -0.4, 0.7}, 4096}};
    for (const auto& k : cases) {
        const Vec3d u = Vec3d(0.8, 0.6, 0) * k.size, v = Vec3d(-0.36, 0.48, 0.8) * k.size;
        const Vec3d normal = Vec3d(0.8, 0.6, 0).cross(Vec3d(-0.36, 0.48, 0.8));
        const Vec3d a = normal * 1.5 - (u + v) * 0.5;
        Scene scene;
        addQuad(scene, addMaterial(scene, Color(0.0f), Color(2.0f), true), a, u, v);
        const auto tracer = makeTracer(scene);
        const MeanGradient g = analyticGradient(*tracer, withRays(k.rays), k.p, 2, 24);
        CAPTURE(k.size, k.rays);
        checkClosedForm(
            g, k.p,
            [&](const Vec3d& q, int i) { return 2 * polygonCoefficient(q, corners(a, u, v), i); },
            0.01, 0.03, 1e-4);
    }
}

TEST_CASE("gradient under a constant sky beside a black quad", "[gradient][heavy]")
{
    // What the quad hides is missing from the constant sky: 4π L minus the polygon's integral.
    const Vec3d a(-1, 0.5, -1), u(0, 0, 2), v(2, 0, 0);
    Scene scene;
    addQuad(scene, addMaterial(scene, Color(0.0f), Color(0.0f), true), a, u, v);
    scene.environment = Environment::constant(Color(3.0f));
    const auto tracer = makeTracer(scene);
    for (const Vec3d& p : {Vec3d(0.2, -0.3, 0.1), Vec3d(0.9, 0.2, 0.0), Vec3d(2, 1.5, 0.3)}) {
        for (const int rays : {1024, 3000}) {
            CAPTURE(p.x, rays);
            const MeanGradient g = analyticGradient(*tracer, withRays(rays), p, 2, 24);
            checkClosedForm(
                g, p,
                [&](const Vec3d& q, int i) {
                    return -3 * polygonCoefficient(q, corners(a, u, v), i);
                },
                0.025, 0.03, 1e-4);
        }
    }
}

TEST_CASE("gradient above an endless ground vanishes", "[gradient]")
{
    // A half-space of sky looks the same from everywhere; the rim lies 1000 heights away.
    Scene scene;
    addQuad(scene, addMaterial(scene, Color(0.0f), Color(0.0f), true), {-1000, 0, -1000},
        {0, 0, 2000}, {2000, 0, 0});
    scene.environment = Environment::constant(Color(1.0f));
    const auto tracer = makeTracer(scene);
    const MeanGradient g = analyticGradient(*tracer, withRays(1024), {0.3, 1, -0.2}, 3, 4);
    for (int axis = 0; axis < 3; ++axis) {
        // A coefficient is of the order of 1; distances of 1 would make its derivative so too.
        for (int k = 0; k < 9; ++k) CHECK(std::abs(g.at(axis, k)) < 0.04);
    }
}

TEST_CASE("gradient of a light behind an edge", "[gradient]")
{
    // A black half-plane at height 1, x > 0, hides part of a quad at height 2. The part seen from p
    // ends where the line from p over the edge meets the quad.
    for (const double half : {1.5, 0.3}) {
        Scene scene;
        const int black = addMaterial(scene, Color(0.0f), Color(0.0f), true);
        addQuad(scene, black, {0, 1, -50}, {50, 0, 0}, {0, 0, 100});
        addQuad(scene, addMaterial(scene, Color(0.0f), Color(2.0f), true), {-half, 2, -half},
            {2 * half, 0, 0}, {0, 0, 2 * half});
        const auto tracer = makeTracer(scene);
        const Vec3d p(0.04, 0.1, 0.07);
        const auto form = [&](const Vec3d& q, int i) {
            const double end = q.x - q.x * (2 - q.y) / (1 - q.y);
            return 2
                * polygonCoefficient(
                    q, corners({-half, 2, -half}, {end + half, 0, 0}, {0, 0, 2 * half}), i);
        };
        const MeanGradient g = analyticGradient(*tracer, withRays(4096), p, 2, 48);
        CAPTURE(half);
        checkClosedForm(g, p, form, half > 1 ? 0.03 : 0.15, half > 1 ? 0.05 : 0.2, 1e-4);
    }
}
