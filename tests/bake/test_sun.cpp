// SPDX-License-Identifier: Apache-2.0
//
// The sun of an environment as an emitter of its own: what is told from the sky, and that light
// stays what it was, at probes and at surfaces.
#include "../../bake/src/emitters.h"
#include "scene_makers.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr int kWidth = 256, kHeight = 128;
constexpr int kSunRow = 30, kSunColumn = kWidth - 1; // of 3 x 3 texels, on both sides of the seam

/// The lat-long layout of docs/CONVENTIONS.md, written out once more.
Vec3d look(double px, double py)
{
    const double theta = kPi * py / kHeight, phi = 2 * kPi * (px / kWidth - 0.5);
    return {std::sin(theta) * std::cos(phi), std::cos(theta), std::sin(theta) * std::sin(phi)};
}
double solidAngle(int row)
{
    return 2 * kPi / kWidth * (std::cos(kPi * row / kHeight) - std::cos(kPi * (row + 1) / kHeight));
}
bool isSun(int x, int y)
{
    const int dx = (x - kSunColumn + kWidth) % kWidth;
    return dx < 3 && y >= kSunRow && y < kSunRow + 3;
}
double sunSolidAngle()
{
    double omega = 0;
    for (int y = kSunRow; y < kSunRow + 3; ++y) omega += 3 * solidAngle(y);
    return omega;
}
const Vec3d kTowardsSun = look(kSunColumn + 1.5, kSunRow + 1.5);

/// @a sky everywhere but in the sun; that far from it, one texel of @a lamp.
std::shared_ptr<const Environment> skyWithSun(float sky, float sun, float lamp = 0)
{
    std::vector<Color> pixels(static_cast<std::size_t>(kWidth * kHeight), Color(sky));
    for (int y = kSunRow; y < kSunRow + 3; ++y)
        for (int i = 0; i < 3; ++i)
            pixels[static_cast<std::size_t>(y * kWidth + (kSunColumn + i) % kWidth)] = Color(sun);
    if (lamp > 0) pixels[static_cast<std::size_t>(40 * kWidth + 60)] = Color(lamp);
    return Environment::fromPixels(kWidth, kHeight, std::move(pixels), {});
}

/// What @a normal receives of a sun of radiance 1, the rest black: midpoints of 16 × 16 parts.
double sunIrradiance(const Vec3d& normal)
{
    const int parts = 16;
    double E = 0;
    for (int y = 0; y < 3 * parts; ++y) {
        const double v = kSunRow + (y + 0.5) / parts;
        for (int x = 0; x < 3 * parts; ++x) {
            const Vec3d d = look(kSunColumn + (x + 0.5) / parts, v);
            E += std::max(0.0, normal.dot(d)) * std::sin(kPi * v / kHeight);
        }
    }
    return E * 2 * kPi * kPi / kWidth / kHeight / (parts * parts);
}

struct Statistics {
    double mean, error, rms; ///< rms: of single estimates about the truth
};

/// Over @a seeds sets of @a rays directions.
Statistics estimates(const Scene& scene, const Vec3d& p, const Vec3d& normal, double truth,
    int rays = 64, int seeds = 64)
{
    const Tracer tracer(std::make_shared<Scene>(scene));
    double sum = 0, sum2 = 0, square = 0;
    for (int seed = 1; seed <= seeds; ++seed) {
        ProbeOptions options;
        options.rays = rays;
        options.seed = static_cast<std::uint64_t>(seed);
        ProbeEstimator::Workspace workspace;
        const ProbeResult r
            = ProbeEstimator(tracer, options)
                  .irradiance(p, {Vec3f(normal)}, hashCombine(7, options.seed), workspace);
        const double E = r.value[0].x;
        sum += E / seeds;
        sum2 += E * E / seeds;
        square += (E - truth) * (E - truth) / seeds;
    }
    return {sum, std::sqrt(std::max(0.0, sum2 - sum * sum) / (seeds - 1)), std::sqrt(square)};
}

void checkMean(const Statistics& s, double truth)
{
    CAPTURE(s.mean, s.error, truth);
    CHECK(std::abs(s.mean - truth) < 4.5 * s.error + 2e-5 * truth);
    CHECK(s.error < 0.01 * truth);
}

Vec3d across(const Vec3d& d) { return d.cross(Vec3d(0, 1, 0)).normalized(); }

} // namespace

TEST_CASE("A map's sun is told from its sky", "[sun][environment]")
{
    const auto env = skyWithSun(1, 3000, 2000);
    const double flux = 3000 * sunSolidAngle();
    const double rest = 4 * kPi - sunSolidAngle() + 1999 * solidAngle(40);
    CHECK(env->sun().share == Approx(flux / (flux + rest)).epsilon(1e-6));
    CHECK(env->sun().direction.dot(kTowardsSun) > std::cos(0.002));
    for (int corner = 0; corner < 4; ++corner) {
        const Vec3d d = look(kSunColumn + 3 * (corner % 2), kSunRow + 3 * (corner / 2));
        CHECK(std::acos(env->sun().direction.dot(d)) <= env->sun().radius + 1e-6);
    }
    CHECK(env->sun().radius < 2.6 * kPi / 180);
    for (int y = 0; y < kHeight; ++y)
        for (int x = 0; x < kWidth; ++x)
            if (env->arrival(look(x + 0.5, y + 0.5)).sun != isSun(x, y)) FAIL(x << ", " << y);

    const Mat3d quarter(0, 0, -1, 0, 1, 0, 1, 0, 0);
    const auto turned = env->rotated(quarter);
    CHECK((turned->sun().direction - env->sun().direction * quarter).length() < 1e-12);
    CHECK(turned->arrival(kTowardsSun * quarter).sun);

    CHECK(skyWithSun(1, 400)->sun().share > 0.1);
    CHECK(skyWithSun(1, 300)->sun().share == 0); // less than a tenth of the light
    CHECK(skyWithSun(0, 3000)->sun().share == 0); // nothing to tell it from
    CHECK(Environment::constant(Color(1))->sun().share == 0);
}

TEST_CASE("Sun and sky are drawn apart and together make the map", "[sun][environment]")
{
    const auto env = skyWithSun(1, 3000, 2000);
    const double share = env->sun().share;
    const std::vector<Vec3d> exact = env->projectDouble(2);
    CounterRng random(5);
    double sun = 0, sky = 0;
    const int n = 20000;
    Vec3d sums[2][4], squares[2][4]; // a Vec3d is not zero by itself
    for (int i = 0; i < 2; ++i) {
        std::fill_n(sums[i], 4, Vec3d(0.0));
        std::fill_n(squares[i], 4, Vec3d(0.0));
    }
    for (int k = 0; k < n; ++k) {
        const double t = random.nextDouble(), u = random.nextDouble(), v = random.nextDouble();
        const Environment::Sample a = env->sampleSun(u, v), b = env->sampleSky(u, v);
        if (!a.sun || b.sun || !env->arrival(a.direction).sun || env->arrival(b.direction).sun)
            FAIL("drawn from the other part");
        sun += a.radiance.x / (a.pdf / share) / n;
        sky += b.radiance.x / (b.pdf / (1 - share)) / n;
        const Environment::Sample whole[2] = {env->sample(u, v), env->draw(t, u, v)};
        for (int i = 0; i < 2; ++i) {
            double y[4];
            evalShBasis(2, whole[i].direction, y);
            CHECK(whole[i].sun == env->arrival(whole[i].direction).sun);
            for (int j = 0; j < 4; ++j) {
                const Vec3d f = Vec3d(whole[i].radiance) * (y[j] / whole[i].pdf);
                sums[i][j] += f / n;
                squares[i][j] += f * f / n;
            }
        }
    }
    // By luminance: every draw gives the flux of its part, to the density's change in a texel.
    CHECK(sun == Approx(share * env->power()).epsilon(1e-3));
    CHECK(sky == Approx((1 - share) * env->power()).epsilon(1e-3));
    for (int i = 0; i < 2; ++i) {
        for (std::size_t j = 1; j < 4; ++j) {
            const double mean = sums[i][j].x;
            const double sigma = std::sqrt((squares[i][j].x - mean * mean) / n);
            CAPTURE(i, j, mean, sigma);
            CHECK(std::abs(mean - exact[j].x) < 4.5 * sigma);
        }
    }
}

TEST_CASE("A sun has a quarter of a probe's strata, and what is due to it at surfaces", "[sun]")
{
    const auto env = skyWithSun(1, 3000);
    EmitterTable table;
    table.finish(env);
    const auto noTriangle = [](std::uint32_t, float, float) { return Color(0.0f); };
    int inSun = 0;
    for (int i = 0; i < 64; ++i) {
        const EmitterPoint s = table.sampleStratum({}, (i + 0.5) / 64, noTriangle);
        const Environment::Arrival there = env->arrival(Vec3d(s.place));
        CHECK(
            s.density == Approx(there.pdf * table.environmentDensity({}, there.sun)).epsilon(1e-4));
        inSun += there.sun;
    }
    CHECK(inSun == 16);

    // At a surface by what each would give: E cos of the sun, a quarter of the sky's flux.
    const double sun = 3000 * sunSolidAngle(), sky = (4 * kPi - sunSolidAngle()) / 4;
    for (const double cosine : {1.0, 0.3, -0.3}) {
        const Vec3d n = kTowardsSun * cosine + across(kTowardsSun) * std::sqrt(1 - cosine * cosine);
        const Receiver to{{0, 0, 0}, Vec3f(n)};
        inSun = 0;
        for (int i = 0; i < 1000; ++i) {
            const double t = (i + 0.5) / 1000, rest = table.skyRest(to, t);
            const EmitterPoint s = rest >= 0
                ? table.sampleSkyTexel(to, table.skyTexel(rest), 0.3, 0.6)
                : table.sampleElsewhere(to, t, 0.3, 0.6, noTriangle);
            const Environment::Arrival there = env->arrival(Vec3d(s.place));
            if (std::abs(s.density / there.pdf / table.environmentDensity(to, there.sun) - 1)
                > 1e-4)
                FAIL("density");
            inSun += there.sun;
        }
        const double E = sun * std::max(0.0, cosine);
        CHECK(std::abs(inSun - 1000 * E / (E + sky)) < 3);
    }
}

TEST_CASE("Sun and sky over free space and a lamp's light", "[sun][closed]")
{
    for (const bool lamp : {false, true}) {
        Scene scene;
        const int m = addMaterial(scene, Color(0.0f), Color(8.0f), true);
        // Behind: seen by what looks away from the sun.
        const Vec3d a = kTowardsSun * -2.0, u = across(kTowardsSun), v = u.cross(kTowardsSun);
        if (lamp) addQuad(scene, m, a - (u + v) * 0.5, u, v);
        scene.environment = skyWithSun(1, 3000);
        const std::vector<Vec3d> quad
            = {a - (u + v) * 0.5, a + (u - v) * 0.5, a + (u + v) * 0.5, a - (u - v) * 0.5};
        for (const Vec3d& n : {kTowardsSun, across(kTowardsSun), -kTowardsSun}) {
            double E = kPi + 2999 * sunIrradiance(n);
            if (lamp && n == -kTowardsSun) E += 7 * polygonIrradiance(Vec3d(0.0), n, quad);
            // Across, half of the lamp is seen.
            if (lamp && std::abs(n.dot(kTowardsSun)) < 0.5) {
                E += 7
                    * polygonIrradiance(Vec3d(0.0), n,
                        {a + v * 0.5, a - v * 0.5, a + (u * n.dot(u) - v) * 0.5,
                            a + (u * n.dot(u) + v) * 0.5});
            }
            CAPTURE(lamp, n);
            checkMean(estimates(scene, {0, 0, 0}, n, E), E);
        }
    }
}

TEST_CASE("A floor reflects sun and sky, one at the sun's horizon too", "[sun][closed]")
{
    const Vec3d horizon = across(kTowardsSun);
    // Facing it, seeing it half, and turned away.
    for (const Vec3d& normal : {Vec3d(0, 1, 0), horizon, Vec3d(0, -1, 0)}) {
        Scene scene;
        const Vec3d u = normal.cross(Vec3d(0.36, 0.48, 0.8)).normalized(), v = normal.cross(u);
        addQuad(scene, addMaterial(scene, Color(0.5f), Color(0.0f), false), (u + v) * -5e4, u * 1e5,
            v * 1e5);
        scene.environment = skyWithSun(1, 3000);
        const double E = 0.5 * (kPi + 2999 * sunIrradiance(normal));
        CAPTURE(normal);
        checkMean(estimates(scene, normal, -normal, E, 256), E);
    }
}

TEST_CASE("A hidden sun leaves the sky its strata", "[sun][closed]")
{
    // A black sheet before the sun. Sun and sky in one, two thirds of the strata were the sun's.
    Scene scene;
    const Vec3d u = across(kTowardsSun), v = u.cross(kTowardsSun);
    const Vec3d a = kTowardsSun - (u + v) * 0.5;
    addQuad(scene, addMaterial(scene, Color(0.0f), Color(0.0f), true), a, u, v);
    scene.environment = skyWithSun(1, 6000);
    const double E = kPi - polygonIrradiance(Vec3d(0.0), kTowardsSun, {a, a + u, a + u + v, a + v});
    const Statistics s = estimates(scene, {0, 0, 0}, kTowardsSun, E, 256);
    checkMean(s, E);
    CAPTURE(s.rms / E);
    CHECK(s.rms < 0.029 * E); // 0.026; 0.033 in one
}
