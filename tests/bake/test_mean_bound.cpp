// SPDX-License-Identifier: Apache-2.0
// The bound of a mean: how often it holds, for values as skew as squared errors are.

#include "../../bake/src/mean_bound.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <cmath>

using namespace lumivdb;

namespace {

double gaussian(CounterRng& rng)
{
    const double u = 1 - rng.nextDouble();
    return std::sqrt(-2 * std::log(u)) * std::cos(6.283185307179586 * rng.nextDouble());
}

struct Coverage {
    double normal = 0, skew = 0; ///< share of bounds at or above the true mean
};

/// Means of @a count values exp(sigma·N), half of them drawn with eight times the density where
/// they are large and weighed accordingly, as a bake's verification does.
Coverage coverage(int trials, int count, double sigma, bool weighed, double confidence)
{
    // E exp(σN) = exp(σ²/2). Tilted draws N + σ have density ratio exp(σN' − σ²/2); a half-half
    // mixture weighs 2/(1 + ratio).
    const double mean = std::exp(0.5 * sigma * sigma);
    Coverage c;
    for (int t = 0; t < trials; ++t) {
        CounterRng rng(hashCombine(91, static_cast<std::uint64_t>(t)));
        std::vector<double> values, weights;
        double sum = 0, total = 0;
        for (int i = 0; i < count; ++i) {
            const double n = gaussian(rng) + (weighed && i % 2 ? sigma : 0);
            const double ratio = std::exp(sigma * n - 0.5 * sigma * sigma);
            weights.push_back(weighed ? 2 / (1 + ratio) : 1);
            values.push_back(weights.back() * std::exp(sigma * n));
            sum += values.back();
            total += weights.back();
        }
        double variance = 0;
        for (std::size_t i = 0; i < values.size(); ++i)
            variance += std::pow(values[i] - weights[i] * sum / total, 2);
        c.normal += sum / total + normalQuantile(confidence) * std::sqrt(variance) / total >= mean;
        c.skew += upperRelativeSquare(values, weights, weights, confidence) >= mean;
    }
    return {c.normal / trials, c.skew / trials};
}

} // namespace

TEST_CASE("quantiles of the normal distribution", "[mean_bound]")
{
    CHECK(normalQuantile(0.5) == Approx(0).margin(4.5e-4));
    CHECK(normalQuantile(0.95) == Approx(1.644854).margin(4.5e-4));
    CHECK(normalQuantile(0.999) == Approx(3.090232).margin(4.5e-4));
}

TEST_CASE("the bound of equal values is their value", "[mean_bound]")
{
    CHECK(upperRelativeSquare({2, 2, 2}, {1, 1, 1}, {1, 1, 1}, 0.95) == 2);
    CHECK(upperRelativeSquare({2, 6, 1}, {2, 6, 1}, {1, 3, 0.5}, 0.95) == 0.5);
    CHECK(upperRelativeSquare({0}, {1}, {1}, 0.95) == 0);
}

TEST_CASE("the bound holds about as often as it says", "[mean_bound]")
{
    // Shares over 4,000 trials have a standard error of 0.35%.
    constexpr int kTrials = 4000;
    SECTION("values that are not skew: both do")
    {
        const Coverage c = coverage(kTrials, 400, 0.05, false, 0.95);
        CHECK(c.skew == Approx(0.95).margin(0.014));
        CHECK(c.normal == Approx(0.95).margin(0.014));
    }
    SECTION("skew values: half of what the normal bound is wrong too often is repaired")
    {
        // exp(1.25 N): skewness 11, of a mean of 250: 0.7, more than one term of the series mends.
        const Coverage c = coverage(kTrials, 250, 1.25, false, 0.95);
        CAPTURE(c.normal, c.skew);
        CHECK(c.normal < 0.90);
        CHECK(c.skew > c.normal + 0.02);
        CHECK(c.skew > 0.91);
    }
    SECTION("drawn where they are large and weighed: at least as it says")
    {
        const Coverage c = coverage(kTrials, 250, 1.25, true, 0.95);
        CAPTURE(c.normal, c.skew);
        CHECK(c.skew > 0.95 - 0.014);
    }
}

TEST_CASE("the bound knows that the mean it is relative to is uncertain", "[mean_bound]")
{
    // The squares hardly spread, the irradiance does, by half of its mean.
    constexpr int kTrials = 4000, kCount = 200;
    const double confidence = 0.95;
    int holds = 0, ignorant = 0;
    for (int t = 0; t < kTrials; ++t) {
        CounterRng rng(hashCombine(92, static_cast<std::uint64_t>(t)));
        std::vector<double> squares, values, sure;
        for (int i = 0; i < kCount; ++i) {
            squares.push_back(1 + 0.2 * gaussian(rng));
            values.push_back(2 + gaussian(rng));
        }
        const std::vector<double> weights(kCount, 1.0);
        holds += upperRelativeSquare(squares, values, weights, confidence) >= 0.25;
        double mean = 0;
        for (const double v : values) mean += v / kCount;
        sure.assign(kCount, mean);
        ignorant += upperRelativeSquare(squares, sure, weights, confidence) >= 0.25;
    }
    CHECK(static_cast<double>(holds) / kTrials == Approx(confidence).margin(0.014));
    CHECK(static_cast<double>(ignorant) / kTrials < 0.8);
}
