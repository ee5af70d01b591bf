// SPDX-License-Identifier: Apache-2.0
//
// The tree against brute force: its chances add up to one and follow what arrives, choices follow
// the chances, and sums over choices are sums over all lights.
#include "../../bake/src/light_tree.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <cmath>
#include <cstring>

using namespace lumivdb;

namespace {

constexpr float kPi = 3.14159265f;

Vec3f unitVector(CounterRng& rng)
{
    const float z = 2 * rng.next() - 1, phi = 2 * kPi * rng.next(), r = std::sqrt(1 - z * z);
    return {r * std::cos(phi), r * std::sin(phi), z};
}

Vec3f pointIn(CounterRng& rng, float size)
{
    const float x = rng.next(), y = rng.next();
    return Vec3f(x, y, rng.next()) * size;
}

LightBound pointLight(const Vec3f& p, double intensity)
{
    LightBound b;
    b.lower = b.upper = p;
    b.spread = kPi;
    b.intensity = intensity;
    return b;
}

/// A small flat light that shines along @a axis, as the cosine.
LightBound panel(const Vec3f& p, const Vec3f& axis, double intensity, bool twoSided = false)
{
    LightBound b = pointLight(p, intensity);
    b.axis = axis;
    b.spread = 0;
    b.twoSided = twoSided;
    return b;
}

/// Irradiance of one light at a receiver; without a normal, on a surface that faces the light.
double arriving(const LightBound& b, const Receiver& r)
{
    Vec3f towards = -b.axis;
    double e = b.intensity;
    if (!b.infinite) {
        const Vec3f d = b.lower - r.position;
        towards = d.normalized();
        double cosine = b.spread > 0 ? 1.0 : -b.axis.dot(towards);
        if (b.twoSided) cosine = std::abs(cosine);
        e *= d.length() > b.range ? 0.0 : std::max(0.0, cosine) / d.length2();
    }
    return r.oneSided() ? e * std::max(0.0f, r.normal.dot(towards)) : e;
}

/// Lights of all kinds over three decades.
std::vector<LightBound> mixed(std::size_t n, std::uint64_t seed)
{
    CounterRng rng(seed);
    std::vector<LightBound> lights;
    for (std::size_t i = 0; i < n; ++i) {
        const Vec3f p = pointIn(rng, 10), axis = unitVector(rng);
        const double intensity = std::pow(10.0, -3 * rng.nextDouble());
        LightBound b = i % 3 == 0 ? pointLight(p, intensity)
                                  : panel(p, axis, intensity, i % 3 == 1 && i % 2 == 0);
        if (i % 5 == 0) b.range = 4;
        if (i % 40 == 7) {
            b.infinite = true;
            b.intensity *= 0.01;
        }
        lights.push_back(b);
    }
    return lights;
}

Receiver receiverAt(CounterRng& rng, bool oneSided)
{
    Receiver r;
    r.position = pointIn(rng, 10);
    if (oneSided) r.normal = unitVector(rng);
    return r;
}

double sumOfProbabilities(const LightTree& tree, const Receiver& r, std::size_t lights)
{
    double sum = 0;
    for (std::size_t i = 0; i < lights; ++i)
        sum += tree.probability(r, static_cast<std::uint32_t>(i));
    return sum;
}

} // namespace

TEST_CASE("A light tree's chances add up to one", "[light_tree]")
{
    for (const std::size_t n : {1u, 2u, 3u, 37u, 1000u}) {
        std::vector<LightBound> points;
        CounterRng rng(n);
        for (std::size_t i = 0; i < n; ++i)
            points.push_back(pointLight(pointIn(rng, 10), rng.nextDouble()));
        const LightTree everywhere(points), some(mixed(n, n));
        for (int i = 0; i < 20; ++i) {
            // Point lights arrive everywhere; of others a descent may find that nothing does.
            const Receiver r = receiverAt(rng, false);
            CHECK(std::abs(sumOfProbabilities(everywhere, r, n) - 1) < 1e-12);
            CHECK(sumOfProbabilities(some, r, n) <= 1 + 1e-12);
        }
    }
}

TEST_CASE("Every light that arrives can be chosen", "[light_tree]")
{
    const auto lights = mixed(500, 3);
    const LightTree tree(lights);
    CounterRng rng(6);
    int arrivals = 0;
    for (int i = 0; i < 200; ++i) {
        const Receiver r = receiverAt(rng, i % 2 == 1);
        for (std::uint32_t l = 0; l < lights.size(); ++l) {
            if (!(arriving(lights[l], r) > 0)) continue;
            ++arrivals;
            CHECK(tree.probability(r, l) > 0);
        }
    }
    CHECK(arrivals > 10000);
}

TEST_CASE("Choices of a light tree follow its chances", "[light_tree]")
{
    const auto lights = mixed(200, 8);
    const LightTree tree(lights);
    CounterRng rng(7);
    for (const bool oneSided : {false, true}) {
        const Receiver r = receiverAt(rng, oneSided);
        constexpr int kDraws = 200000;
        std::vector<int> drawn(lights.size(), 0);
        int none = 0;
        for (int i = 0; i < kDraws; ++i) {
            double t = rng.nextDouble();
            const LightTree::Choice c = tree.choose(r, t);
            REQUIRE((t >= 0 && t < 1));
            if (!(c.probability > 0)) {
                ++none;
                continue;
            }
            REQUIRE(c.probability == tree.probability(r, c.light));
            ++drawn[c.light];
        }
        // Chi-square over the lights drawn often enough; the rest is one cell.
        double chi2 = 0, rest = kDraws, restDrawn = kDraws;
        int cells = 0;
        for (std::uint32_t l = 0; l < lights.size(); ++l) {
            const double expected = kDraws * tree.probability(r, l);
            if (expected == 0) CHECK(drawn[l] == 0);
            if (expected < 10) continue;
            chi2 += (drawn[l] - expected) * (drawn[l] - expected) / expected;
            rest -= expected;
            restDrawn -= drawn[l];
            ++cells;
        }
        REQUIRE(cells > 10);
        if (rest > 10) chi2 += (restDrawn - rest) * (restDrawn - rest) / rest;
        // Normal approximation of chi-square: mean k, variance 2k; four standard deviations.
        CHECK(chi2 < cells + 4 * std::sqrt(2.0 * cells));
        CHECK(none < kDraws / 2);
    }
}

TEST_CASE("A sum by choices is the sum over all lights, and needs few of them", "[light_tree]")
{
    const auto lights = mixed(2000, 12);
    const LightTree tree(lights);
    double power = 0;
    for (const LightBound& b : lights) power += b.intensity;
    CounterRng rng(9);
    double treeVariance = 0, powerVariance = 0;
    for (int k = 0; k < 20; ++k) {
        const Receiver r = receiverAt(rng, k % 2 == 1);
        double truth = 0, byTree = 0, byPower = 0; // the latter: second moments
        for (std::uint32_t l = 0; l < lights.size(); ++l) {
            const double e = arriving(lights[l], r);
            if (!(e > 0)) continue;
            truth += e;
            byTree += e * e / tree.probability(r, l);
            byPower += e * e / (lights[l].intensity / power);
        }
        constexpr int kDraws = 4000;
        double sum = 0;
        for (int i = 0; i < kDraws; ++i) {
            double t = rng.nextDouble();
            const LightTree::Choice c = tree.choose(r, t);
            if (c.probability > 0) sum += arriving(lights[c.light], r) / c.probability;
        }
        const double variance = byTree - truth * truth;
        CHECK(std::abs(sum / kDraws - truth) < 5 * std::sqrt(variance / kDraws));
        treeVariance += variance / (truth * truth);
        powerVariance += (byPower - truth * truth) / (truth * truth);
    }
    CHECK(treeVariance < powerVariance / 5);
}

TEST_CASE("Stratified numbers give a light tree less noise than random ones", "[light_tree]")
{
    const auto lights = mixed(1000, 20);
    const LightTree tree(lights);
    CounterRng rng(21);
    const Receiver r = receiverAt(rng, false);
    double truth = 0;
    for (const LightBound& b : lights) truth += arriving(b, r);
    constexpr int kStrata = 256, kTrials = 100;
    double stratified = 0, random = 0;
    for (int trial = 0; trial < kTrials; ++trial) {
        double sums[2] = {0, 0};
        for (int i = 0; i < kStrata; ++i) {
            double t[2] = {(i + rng.nextDouble()) / kStrata, rng.nextDouble()};
            for (int k = 0; k < 2; ++k) {
                const LightTree::Choice c = tree.choose(r, t[k]);
                if (c.probability > 0) sums[k] += arriving(lights[c.light], r) / c.probability;
            }
        }
        stratified += std::pow(sums[0] / kStrata - truth, 2);
        random += std::pow(sums[1] / kStrata - truth, 2);
    }
    CHECK(stratified < 0.5 * random);
}

TEST_CASE("What is left of the number is even within each light", "[light_tree]")
{
    const auto lights = mixed(50, 4);
    const LightTree tree(lights);
    CounterRng rng(2);
    const Receiver r = receiverAt(rng, false);
    constexpr int kDraws = 20000;
    double sum = 0;
    for (int i = 0; i < kDraws; ++i) {
        double t = (i + 0.5) / kDraws;
        tree.choose(r, t);
        sum += t;
    }
    CHECK(std::abs(sum / kDraws - 0.5) < 0.02);
}

TEST_CASE("Lights behind, dark, coincident and at the receiver", "[light_tree]")
{
    const Receiver up{Vec3f(0.0f), Vec3f(0, 0, 1)}, anywhere{Vec3f(0.0f), Vec3f(0.0f)};
    double t = 0.3;
    SECTION("behind the receiver, or shining away from it: none")
    {
        const LightTree tree(
            {pointLight({0, 0, -1}, 1), pointLight({1, 0, -2}, 1), panel({0, 0, 3}, {0, 0, 1}, 1)});
        CHECK(tree.choose(up, t).probability == 0);
        CHECK(sumOfProbabilities(tree, up, 3) == 0);
        t = 0.3;
        CHECK(tree.choose(anywhere, t).probability > 0);
        CHECK(tree.probability(anywhere, 2) == 0);
    }
    SECTION("one light, seen or not")
    {
        const LightTree tree({panel({0, 0, 3}, {0, 0, -1}, 1)});
        CHECK(tree.choose(up, t).probability == 1);
        CHECK(t == 0.3);
        CHECK(tree.choose({Vec3f(0, 0, 5), Vec3f(0.0f)}, t).probability == 0);
    }
    SECTION("dark ones are never drawn")
    {
        const LightTree tree(
            {pointLight({0, 0, 1}, 0), pointLight({0, 1, 1}, 2), pointLight({1, 0, 1}, 0)});
        CHECK(tree.probability(up, 1) == 1);
        CHECK(tree.probability(up, 0) == 0);
        const LightTree dark({pointLight({0, 0, 1}, 0), pointLight({0, 1, 1}, 0)});
        CHECK(dark.choose(up, t).probability == 0);
    }
    SECTION("coincident ones by their intensity, even a thousand of them")
    {
        std::vector<LightBound> lights(1000, pointLight({0, 0, 2}, 1));
        lights[17].intensity = 1000;
        const LightTree tree(lights);
        CHECK(std::abs(tree.probability(up, 17) - 1000.0 / 1999) < 1e-6);
        CHECK(std::abs(sumOfProbabilities(tree, up, 1000) - 1) < 1e-12);
    }
    SECTION("a point light at the receiver gives nothing and hides nothing")
    {
        const LightTree tree({pointLight(Vec3f(0.0f), 1e30), pointLight({0, 0, 1}, 1e-3)});
        CHECK(tree.probability(up, 0) == 0);
        CHECK(tree.probability(up, 1) == 1);
        CHECK(tree.probability(anywhere, 1) == 1);
    }
    SECTION("beyond its range a light gives nothing")
    {
        std::vector<LightBound> lights = {pointLight({0, 0, 9}, 5), pointLight({0, 0, 1}, 1)};
        lights[0].range = 8;
        CHECK(LightTree(lights).probability(up, 1) == 1);
    }
    SECTION("a sun far brighter than the lamps leaves them their chance")
    {
        LightBound sun = panel(Vec3f(0.0f), Vec3f(0, 0, -1), 1e9);
        sun.infinite = true;
        const LightTree tree({sun, pointLight({0, 0, 1}, 1), pointLight({0, 1, 1}, 1)});
        CHECK(tree.probability(up, 0) > 0.7);
        CHECK(tree.probability(up, 1) > 0.1);
        CHECK(tree.probability({Vec3f(0.0f), Vec3f(0.1f, 0, -1).normalized()}, 0) == 0);
    }
}

TEST_CASE("The same lights give the same tree, whatever their extent", "[light_tree]")
{
    // In a row, exponentially spread: splits by place alone would be as deep as there are lights.
    std::vector<LightBound> lights;
    for (int i = 0; i < 120; ++i) lights.push_back(pointLight({std::ldexp(1.0f, -i), 0, 1}, 1));
    for (int i = 0; i < 4000; ++i) lights.push_back(pointLight({0, 0, 1}, 1));
    const LightTree a(lights), b(lights);
    const Receiver r{Vec3f(0.3f, 0.1f, 0), Vec3f(0, 0, 1)};
    double sum = 0;
    for (std::uint32_t l = 0; l < lights.size(); ++l) {
        REQUIRE(a.probability(r, l) == b.probability(r, l));
        sum += a.probability(r, l);
    }
    CHECK(std::abs(sum - 1) < 1e-9);
}
