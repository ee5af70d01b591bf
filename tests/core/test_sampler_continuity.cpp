// SPDX-License-Identifier: Apache-2.0
// No popping: dense walks and pairs of points on both sides of every kind of face, edge and corner,
// with random samples and gradients. The same walk by plain trilinear interpolation jumps.

#include "volume_makers.h"

#include <lumivdb/core/sampler.h>

#include <catch2/catch.hpp>

using namespace lumivdb;
using namespace volume_test;

namespace {

constexpr Interpolation kContinuous[] = {Interpolation::Trilinear, Interpolation::Gradient,
    Interpolation::Tricubic, Interpolation::InverseDistance};

/// Levels 0 to 3 round a focus: a corner of fine cells in coarse ones, 8³ and 16³ tiles, leaves
/// that are partly filled, and gaps.
std::vector<BoxCell> mixedCells(int top, const Coord& focus, bool gaps)
{
    std::vector<BoxCell> cells;
    const int size = 1 << top;
    for (int x = -2; x < 2; ++x)
        for (int y = -2; y < 2; ++y)
            for (int z = -2; z < 2; ++z) {
                if (gaps && (x + 2 * y + 3 * z + 30) % 5 == 0) continue;
                refineTowards(focus, {Coord(x, y, z) * size, top}, cells);
            }
    return cells;
}

/// Random values in [0, 1); slopes small enough that expansions over the largest cells stay so.
void fillSmooth(IrradianceVolume& v, std::uint64_t seed, int top)
{
    fillRandom(v, seed);
    if (!v.hasGradients()) return;
    for (SampleId s = 0; s < v.sampleCount(); ++s)
        for (int i = 0; i < 3 * v.coefficients(); ++i) {
            Color& g = v.gradient(s)[i];
            g = (g - Color(0.5f)) * std::ldexp(1.0f, -top);
        }
}

Color at(const VolumeSampler& sampler, const Vec3d& p, int* level = nullptr)
{
    Color L[kMaxCoefficients];
    const QueryInfo info = sampler.radiance(p, L);
    if (level) *level = info.level;
    return L[0];
}

/// Trilinear interpolation of the corners of the cell round @a p: what pops.
Color naive(const IrradianceVolume& v, const Vec3d& p)
{
    const CellId id = v.findCell(Coord(static_cast<int>(std::floor(p.x)),
        static_cast<int>(std::floor(p.y)), static_cast<int>(std::floor(p.z))));
    if (id == kNoCell) return Color(std::nanf(""));
    const Cell& cell = v.cell(id);
    const Vec3d t = (p - Vec3d(cell.origin)) / (1 << cell.level);
    Color sum(0.0f);
    for (int i = 0; i < 8; ++i) {
        double w = 1;
        for (int a = 0; a < 3; ++a) w *= i >> a & 1 ? t[a] : 1 - t[a];
        sum += v.radiance(cell.corners[i])[0] * static_cast<float>(w);
    }
    return sum;
}

float largest(const Color& c) { return std::max({std::abs(c.x), std::abs(c.y), std::abs(c.z)}); }

struct Pair {
    Vec3d a, b; ///< on two sides of a border, 2e-6 of a finest cell apart
    int levelA, levelB;
};

/// Points across faces, edges and corners of random cells, in every direction.
std::vector<Pair> pairs(const IrradianceVolume& v, int count, std::uint64_t seed)
{
    std::vector<Pair> result;
    CounterRng rng(seed);
    const VolumeSampler levels(v, Interpolation::Nearest);
    while (static_cast<int>(result.size()) < count) {
        const Cell& cell = v.cell(static_cast<CellId>(rng.bits() % v.cellCount()));
        const int size = 1 << cell.level;
        Vec3d p(cell.origin), step(0.0);
        for (int a = 0; a < 3; ++a) {
            const int kind = static_cast<int>(rng.bits() % 4);
            if (kind == 0) {
                p[a] += rng.bits() % 2 ? size : 0; // across this face
                step[a] = 1;
            } else {
                p[a] += kind == 1 ? 0.5 * size : rng.nextDouble() * size;
            }
        }
        if (step == Vec3d(0.0)) continue;
        Pair q{p - step * 1e-6, p + step * 1e-6, -1, -1};
        at(levels, q.a, &q.levelA);
        at(levels, q.b, &q.levelB);
        if (q.levelA >= 0 && q.levelB >= 0) result.push_back(q);
    }
    return result;
}

} // namespace

TEST_CASE("both sides of every border agree", "[sampler][continuity]")
{
    struct Case {
        int top;
        Coord focus;
        bool gaps;
    };
    for (const Case& c : {Case{1, {-1, 0, 0}, false}, Case{2, {3, -2, 1}, true},
             Case{3, {-7, 5, 2}, false}, Case{4, {9, 3, -20}, true}}) {
        IrradianceVolume v
            = volumeOf(mixedCells(c.top, c.focus, c.gaps), 1, GradientStorage::PerCoefficient);
        fillSmooth(v, 5, c.top);
        const std::vector<Pair> list = pairs(v, 20000, 6);
        int changes = 0;
        float naiveJump = 0;
        for (const Pair& p : list) {
            changes += p.levelA != p.levelB;
            naiveJump = std::max(naiveJump, largest(naive(v, p.a) - naive(v, p.b)));
        }
        CHECK(changes > 500);
        CHECK(naiveJump > 0.3f); // the test can fail
        for (const Interpolation mode : kContinuous) {
            const VolumeSampler sampler(v, mode);
            float jump = 0;
            Vec3d worst(0.0);
            for (const Pair& p : list) {
                const float d = largest(at(sampler, p.a) - at(sampler, p.b));
                if (d > jump || std::isnan(d)) {
                    jump = d;
                    worst = p.a;
                }
            }
            // Slopes are below 10 a step (idw is steepest), values of order 1 in single precision.
            CAPTURE(c.top, name(mode), worst, naiveJump);
            CHECK(jump < 2e-5f);
        }
    }
}

TEST_CASE(
    "a dense walk moves as far as its slope allows, a plain one jumps", "[sampler][continuity]")
{
    constexpr int kTop = 4;
    IrradianceVolume v = volumeOf(mixedCells(kTop, {5, 3, -4}, false), 1,
        GradientStorage::PerCoefficient, latticeTransform(1.0));
    fillSmooth(v, 9, kTop);
    constexpr double kStep = 1.0 / 256;
    for (const Interpolation mode : kContinuous) {
        const VolumeSampler sampler(v, mode);
        CounterRng rng(10);
        float jump = 0, naiveJump = 0;
        for (int walk = 0; walk < 24; ++walk) {
            Vec3d p, to;
            for (int a = 0; a < 3; ++a) {
                p[a] = -31 + 62 * rng.nextDouble();
                to[a] = walk % 3 ? 5 - 9 * a * (a - 1.5) : -31 + 62 * rng.nextDouble();
            }
            const double length = (to - p).length();
            const Vec3d step = (to - p) / length * kStep;
            Color before = at(sampler, p), plainBefore = naive(v, p);
            for (int k = 1; k < static_cast<int>(length / kStep); ++k) {
                const Color now = at(sampler, p + step * k), plain = naive(v, p + step * k);
                jump = std::max(jump, largest(now - before));
                naiveJump = std::max(naiveJump, largest(plain - plainBefore));
                before = now;
                plainBefore = plain;
            }
        }
        // Lipschitz constants for values in [0, 1) and cells of one step: an axis' slope is at most
        // 1 for linear weights, 3/2 for Hermite ones, and for weights over distance, which double
        // the slope at a corner, 2 or so; plus √3 of slopes ≤ ½·2^−4 and what expansions over
        // half a coarse cell add. Three axes: times √3.
        const double lipschitz = std::sqrt(3.0)
            * (mode == Interpolation::InverseDistance  ? 3.0
                    : mode == Interpolation::Trilinear ? 1.0
                                                       : 2.5);
        CAPTURE(name(mode), jump, naiveJump);
        CHECK(jump > 0);
        CHECK(jump <= lipschitz * kStep);
        CHECK(naiveJump > 10 * lipschitz * kStep);
    }
}

TEST_CASE("with invalid samples: agreement wherever a face has a valid one",
    "[sampler][continuity][validity]")
{
    IrradianceVolume v
        = volumeOf(mixedCells(3, {-7, 5, 2}, false), 1, GradientStorage::PerCoefficient);
    fillSmooth(v, 11, 3);
    CounterRng rng(12);
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        if (rng.next() < 0.85f) continue;
        v.validity(s) = 0.1f;
        v.radiance(s)[0] = Color(1e6f); // any use of it shows
    }
    for (const Interpolation mode : kContinuous) {
        const VolumeSampler sampler(v, mode);
        int compared = 0;
        float jump = 0;
        for (const Pair& p : pairs(v, 20000, 13)) {
            Color La[1], Lb[1];
            const QueryInfo info = sampler.radiance(p.a, La);
            sampler.radiance(p.b, Lb);
            REQUIRE(largest(La[0]) < 100);
            // Validity is 0.1 where no weight is on valid samples: on an edge between invalid ones,
            // where each side goes on as its own samples say, and near them slopes have no bound.
            if (info.validity < 0.3f) continue;
            ++compared;
            jump = std::max(jump, largest(La[0] - Lb[0]));
        }
        CAPTURE(name(mode));
        CHECK(compared > 15000);
        CHECK(jump < 2e-4f);
    }
}
