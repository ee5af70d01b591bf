// SPDX-License-Identifier: Apache-2.0
#include "sh_test_util.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/sh.h>

#include <catch2/catch.hpp>

#include <cstring>

using namespace lumivdb;
using namespace sh_test;

namespace {

/// The definition: √2 N_lm P_lm(cosθ) {sin|m|φ, cos mφ}. std::sph_legendre(l, m, θ) of C++17 is
/// (−1)^m √((2l+1)/4π · (l−m)!/(l+m)!) P_lm(cosθ): our normalisation and sign.
double referenceY(int l, int m, const Vec3d& d)
{
    const double theta = std::atan2(std::hypot(d.x, d.y), d.z);
    const double phi = std::atan2(d.y, d.x);
    const auto um = static_cast<unsigned>(std::abs(m));
    const double legendre = std::sph_legendre(static_cast<unsigned>(l), um, theta);
    if (m == 0) return legendre;
    return std::sqrt(2.0) * legendre * (m > 0 ? std::cos(m * phi) : std::sin(-m * phi));
}

double maxBasisError(int bands, const Vec3d& d)
{
    double y[kMaxCoefficients];
    evalShBasis(bands, d, y);
    double worst = 0.0;
    for (int i = 0; i < coefficientCount(bands); ++i) {
        const int l = degreeOf(i);
        worst = std::max(worst, std::abs(y[i] - referenceY(l, i - l * (l + 1), d)));
    }
    return worst;
}

} // namespace

TEST_CASE("coefficient indices", "[sh]")
{
    STATIC_REQUIRE(coefficientCount(6) == 36);
    for (int l = 0, i = 0; l < 6; ++l)
        for (int m = -l; m <= l; ++m, ++i) REQUIRE(degreeOf(i) == l);
}

TEST_CASE("the first nine functions have the constants and signs of DirectX", "[sh]")
{
    CounterRng rng(1);
    for (int k = 0; k < 100; ++k) {
        const Vec3d d = randomDirection(rng);
        const double x = d.x, y = d.y, z = d.z;
        const double expected[9] = {0.282094792, -0.488602512 * y, 0.488602512 * z,
            -0.488602512 * x, 1.092548431 * x * y, -1.092548431 * y * z,
            0.315391565 * (3 * z * z - 1), -1.092548431 * x * z, 0.546274215 * (x * x - y * y)};
        double Y[9];
        evalShBasis(3, d, Y);
        for (int i = 0; i < 9; ++i) REQUIRE(Y[i] == Approx(expected[i]).margin(2e-9));
    }
}

TEST_CASE("all 36 functions are those of the definition", "[sh]")
{
    CounterRng rng(2);
    double worst = 0.0;
    for (int k = 0; k < 2000; ++k)
        worst = std::max(worst, maxBasisError(kMaxBands, randomDirection(rng)));
    // The poles and the axes, where polar coordinates degenerate.
    for (int axis = 0; axis < 3; ++axis)
        for (double sign : {-1.0, 1.0}) {
            Vec3d d(0.0);
            d[axis] = sign;
            worst = std::max(worst, maxBasisError(kMaxBands, d));
        }
    REQUIRE(worst < 1e-13);
}

TEST_CASE("fewer bands are a prefix of more bands", "[sh]")
{
    CounterRng rng(3);
    const Vec3d d = randomDirection(rng);
    double all[kMaxCoefficients];
    evalShBasis(kMaxBands, d, all);
    for (int bands = 1; bands <= kMaxBands; ++bands) {
        double y[kMaxCoefficients + 1];
        y[coefficientCount(bands)] = 77.0;
        evalShBasis(bands, d, y);
        REQUIRE(std::equal(y, y + coefficientCount(bands), all));
        REQUIRE(y[coefficientCount(bands)] == 77.0); // nothing behind the end
    }
}

TEST_CASE("the basis is orthonormal", "[sh]")
{
    // Products have degree ≤ 10: six Gauss nodes are exact.
    std::vector<double> gram(36 * 36, 0.0);
    for (const Node& node : sphereRule(6)) {
        double y[36];
        evalShBasis(6, node.d, y);
        for (int i = 0; i < 36; ++i)
            for (int j = 0; j < 36; ++j) gram[i * 36 + j] += node.weight * y[i] * y[j];
    }
    double worst = 0.0;
    for (int i = 0; i < 36; ++i)
        for (int j = 0; j < 36; ++j)
            worst = std::max(worst, std::abs(gram[i * 36 + j] - (i == j ? 1.0 : 0.0)));
    REQUIRE(worst < 1e-12);
}

TEST_CASE("addition theorem", "[sh]")
{
    // Σ_m Y_lm(a) Y_lm(b) = (2l+1)/4π P_l(a·b); with a = b it is (2l+1)/4π everywhere.
    CounterRng rng(4);
    for (int k = 0; k < 500; ++k) {
        const Vec3d a = randomDirection(rng);
        const Vec3d b = randomDirection(rng);
        double ya[36], yb[36];
        evalShBasis(6, a, ya);
        evalShBasis(6, b, yb);
        for (int l = 0; l < 6; ++l) {
            double same = 0.0, mixed = 0.0;
            for (int i = l * l; i < (l + 1) * (l + 1); ++i) {
                same += ya[i] * ya[i];
                mixed += ya[i] * yb[i];
            }
            const double scale = (2 * l + 1) / (4.0 * kPi);
            const double cosine = std::min(1.0, std::max(-1.0, a.dot(b)));
            REQUIRE(std::abs(same - scale) < 1e-12);
            REQUIRE(
                std::abs(mixed - scale * std::legendre(static_cast<unsigned>(l), cosine)) < 1e-12);
        }
    }
}

TEST_CASE("single precision is close to double and bitwise equal to the batch", "[sh]")
{
    CounterRng rng(5);
    for (std::size_t count : {0u, 1u, 31u, 32u, 33u, 257u}) {
        std::vector<float> x(count), y(count), z(count);
        for (std::size_t k = 0; k < count; ++k) {
            const Vec3f d(randomDirection(rng));
            x[k] = d.x;
            y[k] = d.y;
            z[k] = d.z;
        }
        for (int bands = 1; bands <= kMaxBands; ++bands) {
            const auto n = static_cast<std::size_t>(coefficientCount(bands));
            std::vector<float> batch(n * count + 1, 77.0f);
            evalShBasisBatch(bands, count, x.data(), y.data(), z.data(), batch.data());
            REQUIRE(batch[n * count] == 77.0f);
            for (std::size_t k = 0; k < count; ++k) {
                float single[36];
                double exact[36];
                evalShBasis(bands, Vec3f(x[k], y[k], z[k]), single);
                evalShBasis(bands, Vec3d(x[k], y[k], z[k]), exact);
                for (std::size_t i = 0; i < n; ++i) {
                    REQUIRE(std::memcmp(&batch[i * count + k], &single[i], sizeof(float)) == 0);
                    // Measured over 2e6 directions: 4.8e-7; degree 5 loses most, by cancellation
                    // near the poles.
                    REQUIRE(std::abs(single[i] - exact[i]) < 2e-6);
                }
            }
        }
    }
}

TEST_CASE("a number of bands outside 1 to 6 is refused", "[sh]")
{
    double y[64] = {};
    float f[64] = {};
    Color c[64] = {};
    for (int bands : {-1, 0, 7}) {
        REQUIRE_THROWS_AS(evalShBasis(bands, Vec3d(0, 0, 1), y), Error);
        REQUIRE_THROWS_AS(evalShBasis(bands, Vec3f(0, 0, 1), f), Error);
        REQUIRE_THROWS_AS(evalShBasisBatch(bands, 1, f, f, f, f + 4), Error);
        REQUIRE_THROWS_AS(irradiance(bands, c, Vec3f(0, 0, 1)), Error);
        REQUIRE_THROWS_AS(productSh(bands, y, y, y), Error);
        REQUIRE_THROWS_AS(ShRotation(bands, Mat3d()), Error);
        REQUIRE_THROWS_AS(windowSh(ShWindow::Hanning, bands, c), Error);
        REQUIRE_THROWS_AS(minIrradiance(bands, c), Error);
        REQUIRE_THROWS_AS(packForShader(bands, c, ShaderScale::Irradiance), Error);
    }
}

TEST_CASE("evaluation of coefficients is the sum over the basis", "[sh]")
{
    // Projecting f and evaluating gives f back for a band-limited f: f = 1 + 2x − 3yz + z⁵.
    const auto f
        = [](const Vec3d& d) { return 1.0 + 2.0 * d.x - 3.0 * d.y * d.z + std::pow(d.z, 5); };
    std::vector<double> c(36, 0.0);
    for (const Node& node : sphereRule(8)) {
        double y[36];
        evalShBasis(6, node.d, y);
        for (int i = 0; i < 36; ++i) c[i] += node.weight * f(node.d) * y[i];
    }
    std::vector<Color> colour(36);
    for (int i = 0; i < 36; ++i)
        colour[i] = Color(static_cast<float>(c[i]), static_cast<float>(2.0 * c[i]), 0.0f);
    CounterRng rng(6);
    for (int k = 0; k < 200; ++k) {
        const Vec3d d = randomDirection(rng);
        REQUIRE(evalSh(6, c.data(), d) == Approx(f(d)).margin(1e-12));
        const Color value = evalSh(6, colour.data(), Vec3f(d));
        REQUIRE(value.x == Approx(f(d)).margin(1e-5));
        REQUIRE(value.y == Approx(2.0 * f(d)).margin(2e-5));
        REQUIRE(value.z == 0.0f);
    }
}

TEST_CASE("the zonal form of the clamped cosine", "[sh]")
{
    // A_l = 2π ∫_0^1 t P_l(t) dt (Funk–Hecke).
    const int steps = 200000;
    for (int l = 0; l < kMaxBands; ++l) {
        double sum = 0.0;
        for (int k = 0; k < steps; ++k) {
            const double t = (k + 0.5) / steps;
            sum += t * std::legendre(static_cast<unsigned>(l), t);
        }
        REQUIRE(kCosineLobe[l] == Approx(2.0 * kPi * sum / steps).margin(1e-9));
    }
}

TEST_CASE("irradiance of constant radiance is pi L", "[sh]")
{
    // L(ω) = L: L_00 = L √(4π), E = π L_00 Y_00 = π L for every normal and number of bands.
    CounterRng rng(7);
    const Color radiance(0.25f, 1.0f, 40.0f);
    for (int bands = 1; bands <= kMaxBands; ++bands) {
        std::vector<Color> L(coefficientCount(bands), Color(0.0f));
        L[0] = radiance * static_cast<float>(std::sqrt(4.0 * kPi));
        for (int k = 0; k < 50; ++k) {
            const Color e = irradiance(bands, L.data(), Vec3f(randomDirection(rng)));
            for (int c = 0; c < 3; ++c) REQUIRE(e[c] == Approx(kPi * radiance[c]).epsilon(1e-6));
        }
    }
}

TEST_CASE("irradiance of linear radiance", "[sh]")
{
    // L(ω) = 1 + s·ω: E(n) = π + (2π/3) s·n, since ∫ (s·ω) max(0, n·ω) dω = (2π/3) s·n.
    const Vec3d s(0.3, -0.5, 0.7);
    const double k1 = std::sqrt(4.0 * kPi / 3.0);
    const double c[4] = {std::sqrt(4.0 * kPi), -k1 * s.y, k1 * s.z, -k1 * s.x};
    std::vector<Color> L;
    for (double v : c) L.emplace_back(static_cast<float>(v));
    CounterRng rng(8);
    for (int k = 0; k < 100; ++k) {
        const Vec3d n = randomDirection(rng);
        const Color e = irradiance(2, L.data(), Vec3f(n));
        REQUIRE(e.x == Approx(kPi + 2.0 * kPi / 3.0 * s.dot(n)).epsilon(2e-6));
    }
}

TEST_CASE("irradiance of a distant light in three bands", "[sh]")
{
    // L_lm = Y_lm(s). By the addition theorem E(t) = Σ A_l (2l+1)/4π P_l(t) with t = n·s, for three
    // bands 3/32 + t/2 + 15/32 t². Against max(0, t): the largest error is 3/32, at t = 0; the
    // smallest value is −19/480, at t = −8/15; facing the light it is 17/16.
    CounterRng rng(9);
    double worst = 0.0, lowest = 1.0;
    for (int k = 0; k < 20000; ++k) {
        const Vec3d s = k < 10000 ? Vec3d(0.0, 0.0, 1.0) : randomDirection(rng);
        const double t = k < 10000 ? -1.0 + 2.0 * k / 9999.0 : 0.0;
        const Vec3d n = k < 10000 ? Vec3d(std::sqrt(1.0 - t * t), 0.0, t) : randomDirection(rng);
        const double cosine = s.dot(n);
        const double e = irradiance(3, distantLight(3, s).data(), Vec3f(n)).x;
        REQUIRE(
            e == Approx(3.0 / 32.0 + cosine / 2.0 + 15.0 / 32.0 * cosine * cosine).margin(1e-6));
        worst = std::max(worst, std::abs(e - std::max(0.0, cosine)));
        lowest = std::min(lowest, e);
    }
    REQUIRE(worst == Approx(3.0 / 32.0).margin(1e-4));
    REQUIRE(lowest == Approx(-19.0 / 480.0).margin(1e-6));
    const auto L = distantLight(3, Vec3d(0, 0, 1));
    REQUIRE(irradiance(3, L.data(), Vec3f(0, 0, 1)).y == Approx(17.0 / 16.0).epsilon(1e-6));
}

TEST_CASE("convolution with the cosine lobe gives irradiance coefficients", "[sh]")
{
    CounterRng rng(10);
    for (int bands = 1; bands <= kMaxBands; ++bands) {
        const auto n = static_cast<std::size_t>(coefficientCount(bands));
        std::vector<Color> L(n), E(n);
        for (Color& c : L) c = Color(rng.next(), -rng.next(), rng.next());
        convolveSh(bands, kCosineLobe.data(), L.data(), E.data());
        for (int k = 0; k < 50; ++k) {
            const Vec3f d(randomDirection(rng));
            const Color a = irradiance(bands, L.data(), d);
            const Color b = evalSh(bands, E.data(), d);
            for (int c = 0; c < 3; ++c) REQUIRE(a[c] == Approx(b[c]).margin(1e-5));
        }
        const std::vector<Color> separate = E;
        E = L;
        convolveSh(bands, kCosineLobe.data(), E.data(), E.data());
        REQUIRE(E == separate);
    }
}

TEST_CASE("shader constants compute the irradiance", "[sh]")
{
    CounterRng rng(11);
    for (int bands = 1; bands <= kMaxBands; ++bands) {
        std::vector<Color> L(static_cast<std::size_t>(coefficientCount(bands)));
        for (Color& c : L)
            c = Color(2.0f * rng.next() - 1.0f, 2.0f * rng.next() - 1.0f, rng.next());
        const ShaderConstants whole = packForShader(bands, L.data(), ShaderScale::Irradiance);
        const ShaderConstants overPi = packForShader(bands, L.data(), ShaderScale::DivideByPi);
        REQUIRE(whole.cC[3] == 1.0f);
        double worst = 0.0;
        for (int k = 0; k < 1000; ++k) {
            const Vec3f n(randomDirection(rng));
            const Color e = irradiance(std::min(bands, 3), L.data(), n);
            const Color a = evalShader(whole, n);
            const Color b = evalShader(overPi, n) * static_cast<float>(kPi);
            for (int c = 0; c < 3; ++c)
                worst = std::max<double>({worst, std::abs(a[c] - e[c]), std::abs(b[c] - e[c])});
        }
        // |E| is up to 5 here: a few units in the last place.
        REQUIRE(worst < 4e-6);
    }
}

TEST_CASE("shader constants of the seed, written out", "[sh]")
{
    // One coefficient at a time: Y_lm's own polynomial times A_l must be found in its register.
    for (int i = 0; i < 9; ++i) {
        std::vector<Color> L(9, Color(0.0f));
        L[static_cast<std::size_t>(i)] = Color(0.0f, 1.0f, 0.0f);
        const ShaderConstants s = packForShader(3, L.data(), ShaderScale::DivideByPi);
        std::array<float, 4> a{}, b{};
        float cc = 0.0f;
        if (i == 0) a[3] = 0.282094792f;
        if (i == 1) a[1] = -0.325735008f; // 2/3 · 0.488602512
        if (i == 2) a[2] = 0.325735008f;
        if (i == 3) a[0] = -0.325735008f;
        if (i == 4) b[0] = 0.273137108f; // 1/4 · 1.092548431
        if (i == 5) b[1] = -0.273137108f;
        if (i == 6) { // 1/4 · 0.315391565 (3z² − 1)
            a[3] = -0.0788478913f;
            b[2] = 0.236543674f;
        }
        if (i == 7) b[3] = -0.273137108f;
        if (i == 8) cc = 0.136568554f; // 1/4 · 0.546274215
        for (std::size_t k = 0; k < 4; ++k) {
            REQUIRE(s.cA[1][k] == Approx(a[k]).margin(1e-8));
            REQUIRE(s.cB[1][k] == Approx(b[k]).margin(1e-8));
            REQUIRE(s.cA[0][k] == 0.0f);
            REQUIRE(s.cB[2][k] == 0.0f);
        }
        REQUIRE(s.cC[1] == Approx(cc).margin(1e-8));
        REQUIRE(s.cC[0] == 0.0f);
    }
}
