// SPDX-License-Identifier: Apache-2.0
#include "sh_test_util.h"

#include <lumivdb/core/sh.h>

#include <catch2/catch.hpp>

#include <cmath>
#include <thread>

using namespace lumivdb;
using namespace sh_test;

namespace {

/// Coefficient k of Y_i · Y_j, in six bands: one Gaunt integral.
double gaunt(int i, int j, int k)
{
    double a[36] = {}, b[36] = {}, out[36];
    a[i] = 1.0;
    b[j] = 1.0;
    productSh(6, a, b, out);
    return out[k];
}

double factorial(int n) { return std::tgamma(n + 1.0); }

/// Square of Wigner's 3j symbol (a b c; 0 0 0) for even a + b + c (Racah's closed form).
double wigner000Squared(int a, int b, int c)
{
    const int sum = a + b + c;
    const int g = sum / 2;
    if (sum % 2 != 0 || a > b + c || b > a + c || c > a + b) return 0.0;
    const double root = factorial(g) / (factorial(g - a) * factorial(g - b) * factorial(g - c));
    return factorial(sum - 2 * a) * factorial(sum - 2 * b) * factorial(sum - 2 * c)
        / factorial(sum + 1) * root * root;
}

} // namespace

TEST_CASE("triple products of zonal functions have their closed form", "[sh][product]")
{
    // ∫ Y_a0 Y_b0 Y_c0 = √((2a+1)(2b+1)(2c+1)/4π) (a b c; 0 0 0)².
    for (int a = 0; a < 6; ++a)
        for (int b = 0; b < 6; ++b)
            for (int c = 0; c < 6; ++c) {
                const double expected
                    = std::sqrt((2 * a + 1) * (2 * b + 1) * (2 * c + 1) / (4.0 * kPi))
                    * wigner000Squared(a, b, c);
                const double measured = gaunt(a * (a + 1), b * (b + 1), c * (c + 1));
                REQUIRE(std::abs(measured - expected) < 1e-13);
            }
}

TEST_CASE("triple products by hand", "[sh][product]")
{
    // Y_0 is the constant 1/√4π: a product with it scales.
    for (int i = 0; i < 36; ++i)
        for (int k = 0; k < 36; ++k)
            REQUIRE(
                gaunt(0, i, k) == Approx(i == k ? 1.0 / std::sqrt(4.0 * kPi) : 0.0).margin(1e-14));
    // x·y: Y_3 Y_1 = (3/4π) xy = (3/4π)/√(15/4π) Y_4, and nothing else.
    const double xy = 3.0 / (4.0 * kPi) / std::sqrt(15.0 / (4.0 * kPi));
    for (int k = 0; k < 36; ++k) REQUIRE(gaunt(3, 1, k) == Approx(k == 4 ? xy : 0.0).margin(1e-14));
    // y·z has Y_1 = −c y, Y_2 = +c z, Y_5 = −c' yz: the sign is kept.
    REQUIRE(gaunt(1, 2, 5) == Approx(xy));
    // x²: Y_3 Y_3 = (3/4π) x², x² = 1/3 − (3z²−1)/6 + (x²−y²)/2.
    REQUIRE(gaunt(3, 3, 0) == Approx(1.0 / std::sqrt(4.0 * kPi)));
    REQUIRE(gaunt(3, 3, 6) == Approx(-3.0 / (4.0 * kPi) / 6.0 / std::sqrt(5.0 / (16.0 * kPi))));
    REQUIRE(gaunt(3, 3, 8) == Approx(3.0 / (4.0 * kPi) / 2.0 / std::sqrt(15.0 / (16.0 * kPi))));
}

TEST_CASE("no triple product lies between rounding and the smallest true value", "[sh][product]")
{
    double smallest = 1.0;
    for (int i = 0; i < 36; ++i)
        for (int j = i; j < 36; ++j) {
            double a[36] = {}, b[36] = {}, out[36];
            a[i] = 1.0;
            b[j] = 1.0;
            productSh(6, a, b, out);
            for (double v : out)
                if (v != 0.0) smallest = std::min(smallest, std::abs(v));
        }
    INFO("smallest non-zero triple product " << smallest);
    REQUIRE(smallest > 5e-3);
}

TEST_CASE("the product is the projection of the pointwise product", "[sh][product]")
{
    // Degree ≤ 5 + 5 + 5: eight nodes are exact; ten leave no doubt.
    const std::vector<Node> rule = sphereRule(10);
    CounterRng rng(31);
    double worst = 0.0;
    for (int bands = 1; bands <= kMaxBands; ++bands)
        for (int k = 0; k < 10; ++k) {
            const int n = coefficientCount(bands);
            const auto a = randomCoefficients(rng, n), b = randomCoefficients(rng, n);
            std::vector<double> expected(n, 0.0), out(n + 1, 77.0);
            for (const Node& node : rule) {
                double y[36];
                evalShBasis(bands, node.d, y);
                const double value = dotSh(bands, a.data(), y) * dotSh(bands, b.data(), y);
                for (int i = 0; i < n; ++i) expected[i] += node.weight * value * y[i];
            }
            productSh(bands, a.data(), b.data(), out.data());
            REQUIRE(out[n] == 77.0);
            for (int i = 0; i < n; ++i) worst = std::max(worst, std::abs(out[i] - expected[i]));
        }
    WARN("largest error of the product of two functions with coefficients in [-1, 1]: " << worst);
    REQUIRE(worst < 1e-12);
}

TEST_CASE("the product is exact where nothing is truncated", "[sh][product]")
{
    // Three bands by three bands have degree 4: in five bands or more the product is the function.
    CounterRng rng(32);
    auto a = randomCoefficients(rng, 36), b = randomCoefficients(rng, 36);
    for (std::size_t i = 9; i < 36; ++i) a[i] = b[i] = 0.0;
    std::vector<double> product(36);
    productSh(6, a.data(), b.data(), product.data());
    for (int k = 0; k < 100; ++k) {
        const Vec3d d = randomDirection(rng);
        REQUIRE(evalSh(6, product.data(), d)
            == Approx(evalSh(6, a.data(), d) * evalSh(6, b.data(), d)).margin(1e-12));
    }
}

TEST_CASE("the dot product is the integral of the product", "[sh][product]")
{
    // ∫ ab = √4π (ab)_0, by quadrature too.
    CounterRng rng(33);
    for (int bands = 1; bands <= kMaxBands; ++bands) {
        const int n = coefficientCount(bands);
        const auto a = randomCoefficients(rng, n), b = randomCoefficients(rng, n);
        std::vector<double> product(n);
        productSh(bands, a.data(), b.data(), product.data());
        double integral = 0.0;
        for (const Node& node : sphereRule(6))
            integral
                += node.weight * evalSh(bands, a.data(), node.d) * evalSh(bands, b.data(), node.d);
        const double dot = dotSh(bands, a.data(), b.data());
        REQUIRE(dot == Approx(integral).margin(1e-12));
        REQUIRE(dot == Approx(std::sqrt(4.0 * kPi) * product[0]).margin(1e-12));

        std::vector<Color> colour(n);
        std::vector<float> transfer(n);
        for (int i = 0; i < n; ++i) {
            colour[i] = Color(1.0f, -2.0f, 0.5f) * static_cast<float>(a[i]);
            transfer[i] = static_cast<float>(b[i]);
        }
        const Color c = dotSh(bands, colour.data(), transfer.data());
        REQUIRE(c.x == Approx(dot).margin(1e-5));
        REQUIRE(c.y == Approx(-2.0 * dot).margin(2e-5));
        REQUIRE(c.z == Approx(0.5 * dot).margin(1e-5));
    }
}

TEST_CASE("threads get the same product", "[sh][product]")
{
    CounterRng rng(34);
    const auto a = randomCoefficients(rng, 36), b = randomCoefficients(rng, 36);
    std::vector<std::vector<double>> out(8, std::vector<double>(36));
    std::vector<std::thread> threads;
    for (auto& result : out)
        threads.emplace_back([&] { productSh(6, a.data(), b.data(), result.data()); });
    for (std::thread& t : threads) t.join();
    for (const auto& result : out) REQUIRE(result == out[0]);
}
