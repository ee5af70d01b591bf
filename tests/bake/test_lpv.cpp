// SPDX-License-Identifier: Apache-2.0
// Propagation in open space: against the plain scheme, exact cell values, conservation, symmetry.

#include "lpv_makers.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>

using namespace lumivdb;
using namespace lumivdb::test;
using nlohmann::json;

namespace {

void checkCell(const PlainLpv::Cell& got, const PlainLpv::Cell& expected, double tolerance)
{
    for (std::size_t k = 0; k < 4; ++k) CHECK(std::abs(got[k] - expected[k]) <= tolerance);
}

/// Cells of one step of the reference; all others are dark.
void checkStep(const LightPropagationVolume& lpv, const json& step)
{
    double sum = 0;
    for (const auto& [name, values] : step["cells"].items()) {
        std::istringstream in(name);
        Coord at;
        char comma;
        in >> at.x >> comma >> at.y >> comma >> at.z;
        CAPTURE(step["step"].get<int>(), name);
        checkCell(frontOf(lpv, at), values.get<PlainLpv::Cell>(), 1e-6);
    }
    sum = lpv.frontFlux().x * kY0; // ∫I = √(4π) c00 = c00 / Y0
    CHECK(sum == Approx(step["sum_L00"].get<double>()).epsilon(1e-6));
}

Surfel lobeAlongX()
{
    // The reference's source is the lobe over π, with coefficient (√π/2)/π = √π/(2π), that is a
    // flux of 1. Injected half a cell before its place.
    return surfelAt({-0.5, 0, 0}, {1, 0, 0}, Color(1.0f));
}

} // namespace

TEST_CASE("LPV cells against the reference", "[lpv][assets]")
{
    const std::filesystem::path file
        = std::filesystem::path(LUMIVDB_ASSETS) / "lpv-reference" / "lpv_reference.json";
    if (!std::filesystem::exists(file)) {
        WARN("skipped: " << file << " is absent");
        return;
    }
    json reference;
    std::ifstream(file) >> reference;
    SECTION("isotropic source")
    {
        for (const LpvScheme scheme : {LpvScheme::Clamped, LpvScheme::Conservative}) {
            LightPropagationVolume lpv(plainOptions(scheme));
            injectIsotropic(lpv);
            const json& steps = reference["isotropic_source_c00=1"];
            REQUIRE(steps.size() == 4);
            for (const json& step : steps) {
                lpv.step();
                checkStep(lpv, step);
            }
        }
    }
    SECTION("cosine lobe")
    {
        LightPropagationVolume lpv(plainOptions(LpvScheme::Clamped));
        lpv.inject({lobeAlongX()});
        const json& steps = reference["cosine_lobe_source_+x (lobe/pi)"];
        REQUIRE(steps.size() == 3);
        for (const json& step : steps) {
            lpv.step();
            checkStep(lpv, step);
        }
    }
}

TEST_CASE("LPV: the first step in closed form", "[lpv]")
{
    // From c00 = 1 every direction has I = Y0. A neighbour along +x gets, over π, Ω_f Y0 times the
    // lobe of +x and Ω_s Y0 times four lobes whose first bands cancel: c00 = Y0/π (Ω_f + 4Ω_s) √π/2
    // = Y0/π · 2π/3 · √π/2 = 1/6 and c_x = Y0/π Ω_f √(π/3) = 0.0368167960.
    LightPropagationVolume lpv(plainOptions(LpvScheme::Clamped));
    injectIsotropic(lpv);
    lpv.step();
    const double front = 4 * std::atan(std::sqrt(11.0) / 33);
    const double cx = kY0 / kPi * front * std::sqrt(kPi / 3);
    CHECK(cx == Approx(0.036816796).epsilon(1e-8));
    checkCell(frontOf(lpv, {1, 0, 0}), {1.0 / 6, 0, 0, cx}, 3e-8);
    checkCell(frontOf(lpv, {0, -1, 0}), {1.0 / 6, -cx, 0, 0}, 3e-8);
    checkCell(frontOf(lpv, {0, 0, 1}), {1.0 / 6, 0, cx, 0}, 3e-8);
    checkCell(frontOf(lpv, {0, 0, 0}), {0, 0, 0, 0}, 0);
}

TEST_CASE("LPV against the plain scheme across leaves", "[lpv]")
{
    for (const LpvScheme scheme : {LpvScheme::Clamped, LpvScheme::Conservative}) {
        LightPropagationVolume lpv(plainOptions(scheme));
        PlainLpv plain;
        plain.clamp = scheme == LpvScheme::Clamped;
        // On leaf borders, and of every direction.
        const Coord places[3] = {{0, 0, 0}, {7, -1, 8}, {6, 2, -3}};
        for (int i = 0; i < 3; ++i) {
            const Vec3f n = Vec3f(float(i) - 1, 0.5f, 0.3f * float(i)).normalized();
            const Vec3d p = Vec3d(places[i]) - 0.5 * Vec3d(n);
            lpv.inject({surfelAt(p, n, Color(float(i) + 1))});
            PlainLpv::Cell& cell = plain.front[{places[i].x, places[i].y, places[i].z}];
            const double flux = i + 1;
            const double lobe[4] = {std::sqrt(kPi) / 2, std::sqrt(kPi / 3) * double(n.y),
                std::sqrt(kPi / 3) * double(n.z), std::sqrt(kPi / 3) * double(n.x)};
            for (std::size_t k = 0; k < 4; ++k) cell[k] += flux / kPi * lobe[k];
        }
        for (int step = 0; step < 12; ++step) {
            lpv.step();
            plain.step();
        }
        double largest = 0, worst = 0;
        for (const auto& [at, cell] : plain.front) {
            const PlainLpv::Cell got = frontOf(lpv, {at.x, at.y, at.z}, 1);
            for (std::size_t k = 0; k < 4; ++k) {
                largest = std::max(largest, std::abs(cell[k]));
                worst = std::max(worst, std::abs(got[k] - cell[k]));
            }
        }
        CHECK(plain.front.size() > 3000);
        CHECK(worst < 2e-6 * largest);
    }
}

TEST_CASE("LPV: flux is conserved, and what clamping adds", "[lpv][heavy]")
{
    SECTION("200 steps in an unbounded volume")
    {
        LightPropagationVolume lpv(plainOptions(LpvScheme::Conservative));
        lpv.inject({surfelAt({0.2, -0.1, 0.3}, Vec3f(1, 2, -2) / 3.0f, Color(1, 10, 0.01f))});
        const LpvReport report = lpv.propagate({200, 0});
        CHECK(report.iterations == 200);
        CHECK(std::abs(report.residual - 1) < 1e-5);
        for (int c = 0; c < 3; ++c)
            CHECK(std::abs(lpv.frontFlux()[c] / lpv.injectedFlux()[c] - 1) < 1e-5);
    }
    SECTION("clamping")
    {
        // The lobe (1 + 2 cos θ)/4π of flux 1 is negative where cos θ < −1/2: along −x (−1/4π) and
        // at the four side faces of that link (1 − 4/√5)/4π. Without clamping these are lost:
        // what clamping adds is (Ω_f + 4 Ω_s (4/√5 − 1))/4π = 0.138.
        const double front = 4 * std::atan(std::sqrt(11.0) / 33);
        const double side = 2 * std::atan(3 / std::sqrt(11.0)) - kPi / 3;
        const double gain = (front + 4 * side * (4 / std::sqrt(5.0) - 1)) / (4 * kPi);
        CHECK(gain == Approx(0.138).margin(5e-4));
        LightPropagationVolume lpv(plainOptions(LpvScheme::Clamped));
        lpv.inject({lobeAlongX()});
        lpv.step();
        CHECK(lpv.frontFlux().x == Approx(1 + gain).epsilon(1e-6));
        lpv.propagate({20, 0}); // lobes are wide enough afterwards
        CHECK(lpv.frontFlux().x == Approx(1 + gain).epsilon(1e-5));
    }
}

TEST_CASE("LPV: mirrored and turned light gives mirrored and turned cells", "[lpv]")
{
    // x' = M x for the 48 symmetries of the cube.
    for (int perm = 0; perm < 6; ++perm) {
        for (int signs = 0; signs < 8; ++signs) {
            const int order[6][3]
                = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
            const auto turned = [&](const auto& v) {
                auto t = v;
                for (int a = 0; a < 3; ++a) t[a] = (signs >> a & 1 ? -1 : 1) * v[order[perm][a]];
                return t;
            };
            LightPropagationVolume a(plainOptions(LpvScheme::Clamped));
            LightPropagationVolume b(plainOptions(LpvScheme::Clamped));
            const Vec3d p(2, -3, 9);
            const Vec3f n = Vec3f(3, -1, 2).normalized();
            a.inject({surfelAt(p - 0.5 * Vec3d(n), n, Color(1.0f))});
            b.inject({surfelAt(turned(Vec3d(p - 0.5 * Vec3d(n))), turned(n), Color(1.0f))});
            a.propagate({8, 0});
            b.propagate({8, 0});
            double worst = 0;
            int lit = 0;
            for (int i = 0; i < 1000; ++i) {
                const Coord q = Coord(i % 10, i / 10 % 10, i / 100) + Coord(-3, -8, 4);
                const PlainLpv::Cell x = frontOf(a, q), y = frontOf(b, turned(q));
                const Vec3d bx = {x[3], x[1], x[2]};
                const Vec3d by = {y[3], y[1], y[2]};
                lit += x[0] > 0;
                worst = std::max({worst, std::abs(x[0] - y[0]), (turned(bx) - by).length()});
            }
            CHECK(lit > 100);
            CHECK(worst < 1e-8); // of a largest value of 0.01
        }
    }
}

TEST_CASE("LPV: 10000 steps neither grow nor drift", "[lpv][heavy]")
{
    const LatticeBox cells{{0, 0, 0}, {20, 20, 20}};
    for (const LpvScheme scheme : {LpvScheme::Clamped, LpvScheme::Conservative}) {
        LightPropagationVolume lpv(plainOptions(scheme), cells);
        lpv.inject({surfelAt({10, 9, 10}, {0, 1, 0}, Color(1e8f, 1, 1e-6f))});
        lpv.step();
        double last = 1e300;
        Color E(0.0f);
        int steps = 0;
        for (; steps < 10000 && lpv.frontFlux().x > 0; ++steps) {
            lpv.step();
            const double flux = lpv.frontFlux().x;
            REQUIRE(std::isfinite(flux));
            REQUIRE(flux <= last * (1 + 1e-6));
            last = flux;
            if (steps == 3000) E = lpv.irradiance({3, 3, 3}, {0, 1, 0});
        }
        // Light leaves the box; what is left falls below the cutoff and is gone.
        CHECK(lpv.frontFlux().x == 0);
        lpv.propagate({10000 - steps, 0});
        if (steps > 3000) CHECK(lpv.irradiance({3, 3, 3}, {0, 1, 0}) == E);
        CHECK(std::isfinite(lpv.irradiance({3, 3, 3}, {0, 1, 0}).x));
    }
}

TEST_CASE("LPV: a front that never ends keeps its light for 10000 steps", "[lpv][heavy]")
{
    // Walls of albedo 1 on all sides. No flux leaves, none is made.
    LpvOptions options = plainOptions(LpvScheme::Conservative);
    options.occlusion = LpvOcclusion::On;
    options.bounces = LpvBounces::Many;
    LightPropagationVolume lpv(options, LatticeBox{{-2, -2, -2}, {10, 10, 10}});
    std::vector<Blocker> walls;
    for (int axis = 0; axis < 3; ++axis) {
        for (int side = 0; side < 2; ++side) {
            for (int i = -3; i <= 10; ++i) {
                for (int j = -3; j <= 10; ++j) {
                    Blocker b;
                    b.position[axis] = side ? 7.5 : -0.5;
                    b.position[(axis + 1) % 3] = i + 0.5;
                    b.position[(axis + 2) % 3] = j + 0.5;
                    b.normal = Vec3f(0.0f);
                    b.normal[axis] = side ? -1.0f : 1.0f;
                    b.area = 1;
                    b.albedo = b.albedoBehind = Color(1.0f);
                    walls.push_back(b);
                }
            }
        }
    }
    lpv.setGeometry(walls);
    injectIsotropic(lpv, 1, {2, 3, 1});
    const double before = lpv.frontFlux().x;
    lpv.propagate({10000, 0});
    CHECK(std::abs(lpv.frontFlux().x / before - 1) < 2e-4); // 1e-8 a step: the weights' rounding
}

TEST_CASE("LPV: the same bits for any number of threads", "[lpv]")
{
    std::vector<Color> values[2];
    for (int run = 0; run < 2; ++run) {
        LpvOptions options = plainOptions(LpvScheme::Clamped);
        options.threads = run == 0 ? 1 : 4;
        LightPropagationVolume lpv(options);
        CounterRng rng(7);
        std::vector<Surfel> surfels;
        for (int i = 0; i < 300; ++i) {
            float u[8];
            for (float& v : u) v = rng.next();
            const Vec3f n = Vec3f(u[0], u[1], u[2]) - Vec3f(0.5f);
            surfels.push_back(surfelAt(
                Vec3d(Vec3f(u[3], u[4], u[5])) * 30.0, n.normalized(), Color(u[6], u[7], 1)));
        }
        lpv.inject(surfels);
        lpv.propagate({20, 0});
        for (int i = 0; i < 1000; ++i) {
            Color L[4];
            lpv.radiance(Vec3d(i % 10, i / 10 % 10, i / 100) * 3.1, L);
            values[run].insert(values[run].end(), L, L + 4);
        }
    }
    CHECK(std::memcmp(values[0].data(), values[1].data(), values[0].size() * sizeof(Color)) == 0);
}

TEST_CASE("LPV: a light that moves leaves nothing behind and takes no memory", "[lpv][heavy]")
{
    const LatticeBox cells{{-3, 0, 0}, {29, 30, 31}};
    LightPropagationVolume lpv(plainOptions(LpvScheme::Clamped), cells);
    const auto shine = [](LightPropagationVolume& v, double x) {
        v.clearLight();
        v.inject({surfelAt({x, 8, 8}, {0, 1, 0}, Color(1, 2, 3))});
        v.propagate({24, 0});
    };
    for (double x = 0; x < 28; x += 4) shine(lpv, x);
    const std::size_t bytes = lpv.memoryBytes();
    for (double x = 28; x >= 2; x -= 1) shine(lpv, x);
    CHECK(lpv.memoryBytes() == bytes);
    LightPropagationVolume fresh(plainOptions(LpvScheme::Clamped), cells);
    shine(fresh, 2);
    for (int i = 0; i < 1000; ++i) {
        const Vec3d p(i % 10 * 2.9 - 3, i / 10 % 10 * 2.9, i / 100 * 2.9);
        Color a[4], b[4];
        REQUIRE(lpv.radiance(p, a));
        REQUIRE(fresh.radiance(p, b));
        REQUIRE(std::memcmp(a, b, sizeof a) == 0);
    }
}

TEST_CASE("LPV: superposition of light groups in the conservative scheme", "[lpv]")
{
    const Surfel a = surfelAt({1, 2, 3}, {0, 0, 1}, Color(1, 2, 3));
    const Surfel b = surfelAt({5, 2, 9}, {0, -1, 0}, Color(3, 0.5f, 0));
    const auto propagated = [](const std::vector<Surfel>& surfels) {
        LightPropagationVolume lpv(plainOptions(LpvScheme::Conservative));
        lpv.inject(surfels);
        lpv.propagate({16, 0});
        return lpv;
    };
    const auto one = propagated({a}), other = propagated({b}), both = propagated({a, b});
    for (int i = 0; i < 125; ++i) {
        const Vec3d p(i % 5 * 2, i / 5 % 5 * 2, i / 25 * 2);
        const Vec3f n(0, 1, 0);
        const Color sum = one.irradiance(p, n) + other.irradiance(p, n);
        CHECK((both.irradiance(p, n) - sum).length() < 1e-5f * (sum.length() + 1e-3f));
    }
}

TEST_CASE("LPV: stops when the front is spent", "[lpv]")
{
    LightPropagationVolume lpv(plainOptions(LpvScheme::Clamped), LatticeBox{{0, 0, 0}, {8, 8, 8}});
    injectIsotropic(lpv, 1, {4, 4, 4});
    const LpvReport report = lpv.propagate({1000, 0.01});
    CHECK(report.iterations < 100);
    CHECK(report.iterations > 3);
    CHECK(report.residual < 0.01);
    CHECK(report.residual > 0.005);
    // No iterations, no change; a spent front ends by itself.
    CHECK(lpv.propagate({0, 0}).residual == report.residual);
    CHECK(lpv.propagate({100000, 0}).iterations < 100000);
}

TEST_CASE("LPV: hard cases", "[lpv]")
{
    const Color white[4] = {Color(1.0f), Color(0.0f), Color(0.0f), Color(0.0f)};
    SECTION("no light")
    {
        LightPropagationVolume lpv(
            plainOptions(LpvScheme::Clamped), LatticeBox{{0, 0, 0}, {9, 9, 9}});
        const LpvReport report = lpv.propagate({10, 0});
        CHECK(report.iterations == 0);
        CHECK(report.residual == 0);
        CHECK(lpv.irradiance({4, 4, 4}, {0, 1, 0}) == Color(0.0f));
        CHECK(lpv.makeVolume().sampleCount() == 729);
        CHECK_THROWS_AS(LightPropagationVolume(LpvOptions()).makeVolume(), Error);
    }
    SECTION("light outside")
    {
        LightPropagationVolume lpv(
            plainOptions(LpvScheme::Clamped), LatticeBox{{0, 0, 0}, {9, 9, 9}});
        CHECK(lpv.inject({surfelAt({20, 4, 4}, {1, 0, 0}, Color(1.0f))}) == 0);
        CHECK_FALSE(lpv.injectSource({4, 4, 1e300}, white));
        CHECK(lpv.injectedFlux() == Vec3d(0.0));
        Color L[4];
        CHECK_FALSE(lpv.radiance({9, 4, 4}, L));
        CHECK(lpv.radiance({8, 8, 8}, L));
    }
    SECTION("one cell")
    {
        LightPropagationVolume lpv(
            plainOptions(LpvScheme::Clamped), LatticeBox{{3, 3, 3}, {4, 4, 4}});
        CHECK(lpv.injectSource({3, 3, 3}, white));
        const LpvReport report = lpv.propagate({10, 0});
        CHECK(report.iterations == 1); // all of it leaves
        CHECK(report.residual == 0);
        const IrradianceVolume volume = lpv.makeVolume();
        CHECK(volume.cellCount() == 1);
        CHECK(volume.radiance(0)[0].x > 0);
    }
    SECTION("a light on the border between cells")
    {
        // Half a cell before the surface is between cells: the further one along the normal.
        for (const float sign : {1.0f, -1.0f}) {
            LightPropagationVolume lpv(plainOptions(LpvScheme::Clamped));
            lpv.inject({surfelAt({5, 5, 5}, {sign, 0, 0}, Color(1.0f))});
            CHECK(frontOf(lpv, {5 + int(sign), 5, 5})[0] > 0);
            CHECK(lpv.frontFlux().x == Approx(1));
        }
    }
    SECTION("bright and dim lights have the same shape")
    {
        const auto shine = [](float flux) {
            LightPropagationVolume lpv(plainOptions(LpvScheme::Clamped));
            lpv.inject({surfelAt({0, 0, 0}, {0, 0, 1}, Color(flux))});
            lpv.propagate({20, 0});
            return lpv.irradiance({1, 2, 3}, {0, 0, -1}).x / flux;
        };
        CHECK(shine(1e8f) == Approx(shine(1)).epsilon(1e-5));
        CHECK(shine(1e-8f) == Approx(shine(1)).epsilon(1e-5));
    }
    SECTION("nonsense is refused")
    {
        LightPropagationVolume lpv(plainOptions(LpvScheme::Clamped));
        Surfel bad = surfelAt({0, 0, 0}, {0, 0, 1}, Color(1.0f));
        bad.flux.y = std::nanf("");
        CHECK_THROWS_AS(lpv.inject({surfelAt({0, 0, 0}, {0, 0, 1}, Color(1.0f)), bad}), Error);
        CHECK(lpv.injectedFlux() == Vec3d(0.0));
        CHECK_THROWS_AS(lpv.setCells({{0, 0, 0}, {0, 1, 1}}), Error);
        CHECK_THROWS_AS(lpv.propagate({-1, 0}), Error);
        LpvOptions options;
        options.spacing = 0;
        CHECK_THROWS_AS(LightPropagationVolume(options), Error);
        options = {};
        options.occlusion = LpvOcclusion::Off;
        options.bounces = LpvBounces::Many;
        CHECK_THROWS_AS(LightPropagationVolume(options), Error);
    }
}

TEST_CASE("LPV: interrupted between two iterations", "[lpv]")
{
    struct Stop : Progress {
        int left = 3;
        bool cancelled() override { return --left < 0; }
    } stop;
    LightPropagationVolume lpv(plainOptions(LpvScheme::Conservative));
    injectIsotropic(lpv);
    CHECK_THROWS_AS(lpv.propagate({10, 0}, &stop), Error);
    CHECK(lpv.frontFlux().x == Approx(lpv.injectedFlux().x)); // whole, and able to go on
    CHECK(frontOf(lpv, {3, 0, 0})[0] > 0);
    CHECK(frontOf(lpv, {4, 0, 0})[0] == 0);
}
