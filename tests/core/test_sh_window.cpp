// SPDX-License-Identifier: Apache-2.0
#include "sh_test_util.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/sh.h>

#include <catch2/catch.hpp>

#include <cstdio>
#include <limits>
#include <string>

using namespace lumivdb;
using namespace sh_test;

namespace {

/// Irradiance of a distant light of irradiance 1 at n·s = t under window factors:
/// Σ f_l A_l (2l+1)/4π P_l(t).
double windowedLobe(int bands, const double* factor, double t)
{
    double e = 0.0;
    for (int l = 0; l < bands; ++l)
        e += factor[l] * kCosineLobe[l] * (2 * l + 1) / (4.0 * kPi)
            * std::legendre(static_cast<unsigned>(l), t);
    return e;
}

struct Effect {
    double lambda;
    double minimum; // of E, in units of the light's E
    double maximum;
    double l2; // ‖E − max(0, n·s)‖ / ‖max(0, n·s)‖ over the sphere
    double l2Clamped; // the same for max(0, E)
};

/// Window applied to a distant light from @a s, irradiance seen over the sphere by quadrature.
Effect measure(ShWindow window, int bands, const Vec3d& s)
{
    std::vector<Color> L = distantLight(bands, s);
    Effect effect{windowSh(window, bands, L.data()), 1.0, -1.0, 0.0, 0.0};
    double error = 0.0, clamped = 0.0, norm = 0.0;
    for (const Node& node : sphereRule(100)) {
        const double e = irradiance(bands, L.data(), Vec3f(node.d)).x;
        const double truth = std::max(0.0, node.d.dot(s));
        effect.minimum = std::min(effect.minimum, e);
        effect.maximum = std::max(effect.maximum, e);
        error += node.weight * (e - truth) * (e - truth);
        clamped += node.weight * std::pow(std::max(0.0, e) - truth, 2);
        norm += node.weight * truth * truth;
    }
    effect.l2 = std::sqrt(error / norm);
    effect.l2Clamped = std::sqrt(clamped / norm);
    return effect;
}

/// The lowest irradiance found on many more normals than the library looks at, channel red.
double denseMinimum(int bands, const std::vector<Color>& L)
{
    double lowest = irradiance(bands, L.data(), Vec3f(0, 0, 1)).x;
    for (const Node& node : sphereRule(120))
        lowest = std::min<double>(lowest, irradiance(bands, L.data(), Vec3f(node.d)).x);
    return lowest;
}

} // namespace

TEST_CASE("window factors", "[sh][window]")
{
    double f[6];
    windowFactors(ShWindow::None, 6, f);
    for (double v : f) REQUIRE(v == 1.0);
    windowFactors(ShWindow::Hanning, 4, f); // w = 4: ½(1 + cos(πl/4))
    REQUIRE(f[0] == 1.0);
    REQUIRE(f[1] == Approx(0.5 + 0.25 * std::sqrt(2.0)));
    REQUIRE(f[2] == Approx(0.5));
    REQUIRE(f[3] == Approx(0.5 - 0.25 * std::sqrt(2.0)));
    windowFactors(ShWindow::Lanczos, 3, f); // sin(πl/3)/(πl/3)
    REQUIRE(f[0] == 1.0);
    REQUIRE(f[1] == Approx(std::sqrt(3.0) / 2.0 * 3.0 / kPi));
    REQUIRE(f[2] == Approx(std::sqrt(3.0) / 2.0 * 1.5 / kPi));
    windowFactors(ShWindow::Laplacian, 3, f, 0.25); // 1/(1 + λ l²(l+1)²)
    REQUIRE(f[0] == 1.0);
    REQUIRE(f[1] == Approx(1.0 / 2.0));
    REQUIRE(f[2] == Approx(1.0 / 10.0));
    REQUIRE_THROWS_AS(windowFactors(ShWindow::Laplacian, 3, f, -1.0), Error);
}

TEST_CASE("windows never change the mean and never touch a constant", "[sh][window]")
{
    CounterRng rng(41);
    for (ShWindow w : {ShWindow::None, ShWindow::Hanning, ShWindow::Lanczos, ShWindow::Laplacian})
        for (int bands = 1; bands <= 6; ++bands) {
            auto L = distantLight(bands, randomDirection(rng));
            const Color mean = L[0];
            windowSh(w, bands, L.data());
            REQUIRE(L[0] == mean);
        }
}

TEST_CASE("the lowest irradiance is found", "[sh][window]")
{
    // Three bands of a distant light: −19/480 (see the test of irradiance()). Colour channels:
    // the lowest of them counts.
    CounterRng rng(42);
    for (int k = 0; k < 20; ++k) {
        auto L = distantLight(3, randomDirection(rng));
        REQUIRE(minIrradiance(3, L.data()) == Approx(-19.0 / 480.0).margin(1e-4));
        for (Color& c : L) c = Color(0.5f * c.x, 2.0f * c.y, c.z);
        REQUIRE(minIrradiance(3, L.data()) == Approx(-19.0 / 240.0).margin(2e-4));
    }
    std::vector<Color> constant(9, Color(0.0f));
    constant[0] = Color(static_cast<float>(std::sqrt(4.0 * kPi)));
    REQUIRE(minIrradiance(3, constant.data()) == Approx(kPi));
    constant[4].z = std::numeric_limits<float>::quiet_NaN();
    REQUIRE(std::isnan(minIrradiance(3, constant.data())));
}

TEST_CASE("the Laplacian window finds the smallest lambda", "[sh][window]")
{
    // Three bands of a distant light: E(t) = 1/4 + f1 t/2 + f2 (5/32)(3t² − 1) with
    // f1 = 1/(1+4λ), f2 = 1/(1+36λ). Its minimum is at t = −(8/15) f1/f2 or, beyond, at t = −1.
    // Here: λ where that minimum is 0, by bisection.
    const auto minimum = [](double lambda) {
        const double f1 = 1.0 / (1.0 + 4.0 * lambda), f2 = 1.0 / (1.0 + 36.0 * lambda);
        const double t = std::max(-1.0, -(8.0 / 15.0) * f1 / f2);
        return 0.25 + f1 * t / 2.0 + f2 * (5.0 / 32.0) * (3.0 * t * t - 1.0);
    };
    double low = 0.0, high = 1.0;
    REQUIRE(minimum(high) > 0.0);
    for (int k = 0; k < 60; ++k) {
        const double middle = 0.5 * (low + high);
        (minimum(middle) < 0.0 ? low : high) = middle;
    }
    CounterRng rng(43);
    for (int k = 0; k < 20; ++k) {
        auto L = distantLight(3, randomDirection(rng));
        const double lambda = windowSh(ShWindow::Laplacian, 3, L.data());
        INFO("lambda " << lambda << ", closed form " << high);
        REQUIRE(lambda == Approx(high).epsilon(1e-4));
        REQUIRE(denseMinimum(3, L) > -1e-6);
    }
}

TEST_CASE("the Laplacian window leaves non-negative functions alone", "[sh][window]")
{
    // L = 1 + s·ω with |s| < 1 is non-negative, so is its irradiance.
    std::vector<Color> L(9, Color(0.0f));
    L[0] = Color(static_cast<float>(std::sqrt(4.0 * kPi)));
    L[2] = Color(1.9f);
    const auto before = L;
    REQUIRE(windowSh(ShWindow::Laplacian, 3, L.data()) == 0.0);
    REQUIRE(L == before);
    // Only the channel that rings is touched.
    for (std::size_t i = 1; i < 9; ++i) L[i].y = i == 2 ? 40.0f : 0.0f;
    const auto ringing = L;
    REQUIRE(windowSh(ShWindow::Laplacian, 3, L.data()) > 0.0);
    REQUIRE(L[2].y < ringing[2].y);
    REQUIRE(L[2].x == ringing[2].x);
    REQUIRE(minIrradiance(3, L.data()) > -1e-5f);
}

TEST_CASE("the Laplacian window ends on what is no radiance", "[sh][window]")
{
    // No λ helps a negative mean, NaN or infinity: such functions stay as they are.
    for (float mean : {0.0f, -1.0f, std::numeric_limits<float>::quiet_NaN(),
             std::numeric_limits<float>::infinity()}) {
        std::vector<Color> L(36, Color(3.0f));
        L[0] = Color(mean);
        REQUIRE(windowSh(ShWindow::Laplacian, 6, L.data()) == 0.0);
        REQUIRE(L[35] == Color(3.0f));
    }
    // A faint mean under strong higher bands: a large λ, and it is enough.
    std::vector<Color> L(36, Color(1e6f));
    L[0] = Color(1e-6f);
    REQUIRE(windowSh(ShWindow::Laplacian, 6, L.data()) > 1e6);
    REQUIRE(minIrradiance(6, L.data()) > -1e-12f);
}

TEST_CASE(
    "random radiance keeps non-negative irradiance after the Laplacian window", "[sh][window]")
{
    CounterRng rng(44);
    double worst = 0.0;
    int windowed = 0;
    for (int k = 0; k < 40; ++k) {
        const int bands = 3 + k % 4;
        // A few distant lights: non-negative radiance, strongly ringing.
        std::vector<Color> L(static_cast<std::size_t>(coefficientCount(bands)), Color(0.0f));
        for (int light = 0; light < 1 + k % 3; ++light) {
            const auto one = distantLight(bands, randomDirection(rng));
            const float power = rng.next();
            for (std::size_t i = 0; i < L.size(); ++i) L[i] += one[i] * power;
        }
        if (windowSh(ShWindow::Laplacian, bands, L.data()) > 0.0) ++windowed;
        // In units of the mean irradiance π L_00 Y_00.
        const double mean = kPi * L[0].x / std::sqrt(4.0 * kPi);
        worst = std::min(worst, denseMinimum(bands, L) / mean);
    }
    INFO("lowest irradiance on the sphere over the mean: " << worst);
    REQUIRE(windowed > 20);
    REQUIRE(worst > -1e-5);
}

TEST_CASE("the effect of the windows on a distant light", "[sh][window]")
{
    const Vec3d s = Vec3d(0.3, 0.5, -0.8).normalized();
    const struct {
        ShWindow window;
        const char* name;
    } windows[] = {{ShWindow::None, "none"}, {ShWindow::Hanning, "Hanning"},
        {ShWindow::Lanczos, "Lanczos"}, {ShWindow::Laplacian, "Laplacian"}};
    // Squared error: what the window takes from the degrees it has, Σ (1 − f_l)² A_l²(2l+1)/4π, and
    // all of those beyond, which hold 2π/3 − Σ A_l²(2l+1)/4π.
    const double total = 2.0 * kPi / 3.0;
    std::string table = "bands window      lambda    min E    max E  L2 error  (clamped at 0)\n";
    for (int bands : {3, 4, 5, 6})
        for (const auto& w : windows) {
            const Effect e = measure(w.window, bands, s);
            char line[100];
            std::snprintf(line, sizeof line, "%5d %-9s %8.5f %8.5f %8.5f %9.5f %9.5f\n", bands,
                w.name, e.lambda, e.minimum, e.maximum, e.l2, e.l2Clamped);
            table += line;

            // The same from the zonal closed form: the rotation to s must not matter.
            double factor[6];
            windowFactors(w.window, bands, factor, e.lambda);
            double lowest = 1.0;
            for (int k = 0; k <= 4000; ++k)
                lowest = std::min(lowest, windowedLobe(bands, factor, -1.0 + k / 2000.0));
            REQUIRE(e.minimum == Approx(lowest).margin(1e-4));
            double squared = total;
            for (int l = 0; l < bands; ++l)
                squared -= (1.0 - (1.0 - factor[l]) * (1.0 - factor[l])) * kCosineLobe[l]
                    * kCosineLobe[l] * (2 * l + 1) / (4.0 * kPi);
            REQUIRE(e.l2 == Approx(std::sqrt(squared / total)).epsilon(1e-3));
            if (w.window == ShWindow::Laplacian)
                REQUIRE(e.minimum > -1e-6);
            else
                REQUIRE(e.minimum < -0.01);
        }
    WARN(table);
}
