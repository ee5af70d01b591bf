// SPDX-License-Identifier: Apache-2.0
// Queries against answers worked out by hand: linear fields, a slow trilinear reference, brute
// force look-up, and every way a point can lie on the border.

#include "volume_makers.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/sampler.h>

#include <catch2/catch.hpp>

#include <array>
#include <cstring>
#include <limits>

using namespace lumivdb;
using namespace volume_test;

namespace {

constexpr Interpolation kModes[]
    = {Interpolation::Nearest, Interpolation::Taylor, Interpolation::Trilinear,
        Interpolation::Gradient, Interpolation::Tricubic, Interpolation::InverseDistance};
constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

Vec3d randomIn(CounterRng& rng, const Vec3d& lower, const Vec3d& upper)
{
    Vec3d p;
    for (int a = 0; a < 3; ++a) p[a] = lower[a] + rng.nextDouble() * (upper[a] - lower[a]);
    return p;
}

/// Band-0 colour at @a p. Most tests need no more: all coefficients take the same way.
Color at(const VolumeSampler& sampler, const Vec3d& p, QueryInfo* info = nullptr)
{
    Color L[kMaxCoefficients];
    const QueryInfo found = sampler.radiance(p, L);
    if (info) *info = found;
    return L[0];
}

struct Pose {
    const char* name;
    Mat4d indexToWorld;
};

/// Lattices that hurt: fine, coarse, far from the origin, rotated.
std::vector<Pose> poses()
{
    Mat4d offset = latticeTransform(0.1);
    offset[3][0] = 1e6;
    offset[3][1] = -1e6;
    offset[3][2] = 1e6;
    Mat4d turned;
    turned.setEulerAngles(Vec3d(0.4, 1.1, -2.0));
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) turned[i][j] *= 0.3;
    turned[3][0] = 5;
    return {{"unit", Mat4d()}, {"spacing 1e-4", latticeTransform(1e-4)},
        {"spacing 1e5", latticeTransform(1e5)}, {"origin 1e6", offset}, {"rotated", turned}};
}

/// Value at the point (x, y, z)/2 of @a cell, coordinates 0, 1, 2: the sample there, else the mean
/// of its neighbours along each axis on which it is in the middle.
Vec3d nodeValue(const IrradianceVolume& v, const BoxCell& cell, Coord at, int coefficient)
{
    const int half = (1 << cell.level) / 2;
    const bool corner = at.x != 1 && at.y != 1 && at.z != 1;
    const Coord p = cell.level > 0 ? cell.origin + at * half : cell.origin + at / 2;
    const auto s = cell.level > 0 || corner ? v.findSample(p) : -1;
    if (s >= 0) return Vec3d(v.radiance(static_cast<SampleId>(s))[coefficient]);
    REQUIRE(!corner);
    Vec3d sum(0.0);
    int count = 0;
    for (int a = 0; a < 3; ++a) {
        if (at[a] != 1) continue;
        for (const int end : {0, 2}) {
            Coord q = at;
            q[a] = end;
            sum += nodeValue(v, cell, q, coefficient);
            ++count;
        }
    }
    return sum / count;
}

/// Trilinear interpolation in double precision from the cells' list alone; false outside. Every
/// cell is split in eight: where no finer cell is near, the mean of corners is what the whole
/// cell's interpolant has there, and nothing changes.
bool reference(const IrradianceVolume& v, const std::vector<BoxCell>& cells, const Vec3d& p,
    int coefficient, Vec3d& value, int& level)
{
    const BoxCell* c = searchCell(cells,
        Coord(static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
            static_cast<int>(std::floor(p.z))));
    if (!c) return false;
    Vec3d t = (p - Vec3d(c->origin)) / (1 << c->level) * 2;
    Coord lower;
    for (int a = 0; a < 3; ++a) {
        lower[a] = t[a] >= 1;
        t[a] -= lower[a];
    }
    value = Vec3d(0.0);
    level = c->level;
    for (int i = 0; i < 8; ++i) {
        const Coord corner(i & 1, i >> 1 & 1, i >> 2 & 1);
        double w = 1;
        for (int a = 0; a < 3; ++a) w *= corner[a] ? t[a] : 1 - t[a];
        value += nodeValue(v, *c, lower + corner, coefficient) * w;
    }
    return true;
}

} // namespace

TEST_CASE("modes have names, need gradients or not, and the best one is taken", "[sampler]")
{
    const IrradianceVolume plain = uniformVolume(2, GradientStorage::None, {0, 0, 0}, {2, 2, 2});
    const IrradianceVolume rich
        = uniformVolume(2, GradientStorage::PerCoefficient, {0, 0, 0}, {2, 2, 2});
    CHECK(VolumeSampler::bestMode(plain) == Interpolation::Trilinear);
    CHECK(VolumeSampler::bestMode(rich) == Interpolation::Gradient);
    const char* names[] = {"nearest", "taylor", "trilinear", "gradient", "tricubic", "idw"};
    for (std::size_t i = 0; i < 6; ++i) {
        CHECK(std::string(name(kModes[i])) == names[i]);
        CHECK(VolumeSampler(rich, kModes[i]).mode() == kModes[i]);
        if (!needsGradients(kModes[i])) {
            CHECK_NOTHROW(VolumeSampler(plain, kModes[i]));
            continue;
        }
        try {
            VolumeSampler refused(plain, kModes[i]);
            FAIL("no error");
        } catch (const Error& e) {
            CHECK(e.code() == ErrorCode::Usage);
            CHECK(std::string(e.what()).find(names[i]) != std::string::npos);
        }
    }
}

TEST_CASE("a constant field comes back from every mode", "[sampler]")
{
    for (const Pose& pose : poses()) {
        IrradianceVolume v = uniformVolume(
            3, GradientStorage::PerCoefficient, {-2, -2, -2}, {3, 3, 3}, pose.indexToWorld);
        for (SampleId s = 0; s < v.sampleCount(); ++s)
            for (int i = 0; i < 9; ++i)
                v.radiance(s)[i] = Color(0.5f, 2.0f, 1e6f) * static_cast<float>(i + 1);
        for (const Interpolation mode : kModes) {
            const VolumeSampler sampler(v, mode);
            CounterRng rng(3);
            for (int k = 0; k < 200; ++k) {
                const Vec3d p = randomIn(rng, Vec3d(-2.0), Vec3d(3.0)) * v.indexToWorld();
                Color L[9];
                CAPTURE(pose.name, name(mode), p);
                REQUIRE(sampler.radiance(p, L).level == 0);
                for (int i = 0; i < 9; ++i) {
                    REQUIRE(L[i].x == Approx(0.5 * (i + 1)).epsilon(1e-6));
                    REQUIRE(L[i].z == Approx(1e6 * (i + 1)).epsilon(1e-6));
                }
            }
        }
    }
}

TEST_CASE("linear fields: exact by trilinear, Taylor and gradient interpolation", "[sampler]")
{
    // Trilinear weights reproduce linear functions; I + ∇I·d does from any one corner.
    for (const Pose& pose : poses()) {
        IrradianceVolume v = uniformVolume(
            2, GradientStorage::PerCoefficient, {-3, -1, 0}, {2, 4, 5}, pose.indexToWorld);
        // Slopes of about 1 per lattice step; sizes of values about 10 anywhere in the world.
        const LinearField field{Vec3d(0.0) * v.indexToWorld(), 1 / v.spacing()};
        fill(v, field);
        for (const Interpolation mode :
            {Interpolation::Trilinear, Interpolation::Taylor, Interpolation::Gradient}) {
            const VolumeSampler sampler(v, mode);
            CounterRng rng(17);
            for (int k = 0; k < 500; ++k) {
                const Vec3d p = randomIn(rng, {-3, -1, 0}, {2, 4, 5}) * v.indexToWorld();
                Color L[4];
                CAPTURE(pose.name, name(mode), p);
                REQUIRE(sampler.radiance(p, L).level == 0);
                for (int i = 0; i < 4; ++i)
                    for (int c = 0; c < 3; ++c) {
                        const double expected = field.value(p, i, c);
                        // Float records of values up to about 40.
                        REQUIRE(std::abs(L[i][c] - expected) < 2e-5);
                    }
            }
        }
    }
}

TEST_CASE("at a sample every mode gives that sample", "[sampler]")
{
    for (const Pose& pose : poses()) {
        IrradianceVolume v = uniformVolume(
            2, GradientStorage::PerCoefficient, {-2, -2, -2}, {2, 2, 2}, pose.indexToWorld);
        fillRandom(v, 4);
        for (const Interpolation mode : kModes) {
            const VolumeSampler sampler(v, mode);
            for (SampleId s = 0; s < v.sampleCount(); ++s) {
                Color L[4];
                CAPTURE(pose.name, name(mode), v.samplePosition(s));
                REQUIRE(sampler.radiance(v.sampleWorld(s), L).level == 0);
                // Not bit for bit off the unit lattice: p · worldToIndex rounds.
                for (int i = 0; i < 4; ++i) REQUIRE((L[i] - v.radiance(s)[i]).length() < 4e-6f);
            }
        }
    }
    // On the unit lattice trilinear is exact, and what has no weight may even be infinite.
    IrradianceVolume v = uniformVolume(1, GradientStorage::None, {0, 0, 0}, {2, 2, 2});
    fillRandom(v, 4);
    v.radiance(static_cast<SampleId>(v.findSample({1, 1, 1})))[0]
        = Color(std::numeric_limits<float>::infinity());
    const VolumeSampler sampler(v);
    for (SampleId s = 0; s < v.sampleCount(); ++s)
        CHECK(at(sampler, v.sampleWorld(s)) == v.radiance(s)[0]);
}

TEST_CASE("outer faces, edges and corners are inside; beyond them is not", "[sampler][border]")
{
    for (const Pose& pose : poses()) {
        IrradianceVolume v
            = uniformVolume(1, GradientStorage::None, {-2, 1, 5}, {1, 3, 9}, pose.indexToWorld);
        fill(v, LinearField{Vec3d(0.0) * v.indexToWorld(), 1 / v.spacing()});
        const VolumeSampler sampler(v);
        const Vec3d lower(-2, 1, 5), upper(1, 3, 9);
        int inside = 0, outside = 0;
        for (int n = 0; n < 27; ++n) {
            const int side[3] = {n % 3, n / 3 % 3, n / 9};
            Vec3d p = (lower + upper) * 0.5 + Vec3d(0.013, 0.21, 0.37), beyond = p;
            for (int a = 0; a < 3; ++a) {
                if (side[a] == 1) continue;
                p[a] = side[a] ? upper[a] : lower[a];
                beyond[a] = p[a] + (side[a] ? 1 : -1) * 1e-4;
            }
            CAPTURE(pose.name, p);
            QueryInfo info;
            const Color L = at(sampler, p * v.indexToWorld(), &info);
            CHECK(info.level == 0);
            CHECK(info.validity == Approx(1));
            CHECK(std::isfinite(L.x));
            ++inside;
            if (n == 13) continue; // the middle has no outside
            CHECK(isNan(at(sampler, beyond * v.indexToWorld(), &info)));
            CHECK(info.level == -1);
            CHECK(info.validity == 0);
            ++outside;
        }
        CHECK(inside == 27);
        CHECK(outside == 26);
    }
}

TEST_CASE(
    "inner borders of a volume with gaps belong to the cells beside them", "[sampler][border]")
{
    // Two cells that share nothing but an edge, and one apart.
    IrradianceVolume v = volumeOf({{{0, 0, 0}, 0}, {{1, 1, 0}, 0}, {{5, 0, 0}, 1 - 1}}, 1);
    fill(v, {});
    const VolumeSampler sampler(v);
    const auto level = [&](const Vec3d& p) {
        QueryInfo info;
        at(sampler, p, &info);
        return info.level;
    };
    CHECK(level({1, 0.5, 0.5}) == 0); // high face of the first, voxel (1,0,0) is empty
    CHECK(level({1, 1.5, 1}) == 0);
    CHECK(level({2, 2, 1}) == 0);
    CHECK(level({1.5, 1, 0.5}) == 0);
    CHECK(level({1.5, 0.5, 0.5}) == -1);
    CHECK(level({0.5, 1.5, 0.5}) == -1);
    CHECK(level({3, 0.5, 0.5}) == -1);
    CHECK(level({6, 1, 1}) == 0);
    CHECK(level({1 + 1e-9, 0.5, 0.5}) == 0); // rounding of a transform
    CHECK(level({-1e-9, 0.5, 0.5}) == 0);
    CHECK(level({-1e-4, 0.5, 0.5}) == -1);
}

TEST_CASE("NaN, infinite and far positions: level -1 and NaN, never a crash", "[sampler][hard]")
{
    IrradianceVolume v = uniformVolume(3, GradientStorage::PerCoefficient, {0, 0, 0}, {2, 2, 2});
    fillRandom(v, 2);
    const double inf = std::numeric_limits<double>::infinity();
    for (const Interpolation mode : kModes) {
        const VolumeSampler sampler(v, mode);
        for (const double bad : {static_cast<double>(kNan), inf, -inf, 1e300, -1e300, 2147483647.0,
                 2147483648.0, -2147483648.0, -2147483649.0, 4294967296.0, 4294967297.0, 1e19}) {
            for (int a = 0; a < 3; ++a) {
                Vec3d p(1.0);
                p[a] = bad;
                CAPTURE(name(mode), bad, a);
                Color L[9];
                const QueryInfo info = sampler.radiance(p, L);
                CHECK(info.level == -1);
                CHECK(info.validity == 0);
                for (const Color& c : L) CHECK(isNan(c));
                QueryInfo again;
                CHECK(isNan(sampler.irradiance(p, {0, 1, 0}, &again)));
                CHECK(again.level == -1);
            }
        }
    }
}

TEST_CASE("invalid samples never contribute: weights are renormalised", "[sampler][validity]")
{
    IrradianceVolume v = uniformVolume(1, GradientStorage::PerCoefficient, {0, 0, 0}, {1, 1, 1});
    CounterRng rng(8);
    for (int round = 0; round < 200; ++round) {
        const unsigned mask = 1 + static_cast<unsigned>(rng.next() * 255); // never 0
        fillRandom(v, static_cast<std::uint64_t>(round));
        for (SampleId s = 0; s < 8; ++s) {
            const Coord c = v.samplePosition(s);
            const bool valid = mask >> (c.x + 2 * c.y + 4 * c.z) & 1;
            v.validity(s) = valid ? 0.75f : 0.49f;
            if (!valid) {
                // Poison: any use of it shows.
                for (int i = 0; i < 4; ++i) v.radiance(s)[i] = Color(kNan);
            }
        }
        const Vec3d t = randomIn(rng, Vec3d(0.0), Vec3d(1.0));
        Vec3d sum(0.0), idw(0.0);
        double weight = 0, idwWeight = 0, validity = 0, nearest = 1e9;
        Color nearestValue(0.0f);
        for (SampleId s = 0; s < 8; ++s) {
            const Coord c = v.samplePosition(s);
            double w = 1;
            for (int a = 0; a < 3; ++a) w *= c[a] ? t[a] : 1 - t[a];
            validity += w * v.validity(s);
            if (!v.isValid(s)) continue;
            const double distance = (t - Vec3d(c)).length();
            sum += Vec3d(v.radiance(s)[0]) * w;
            weight += w;
            idw += Vec3d(v.radiance(s)[0]) * w / distance;
            idwWeight += w / distance;
            if (distance < nearest) {
                nearest = distance;
                nearestValue = v.radiance(s)[0];
            }
        }
        CAPTURE(mask, t);
        QueryInfo info;
        const VolumeSampler trilinear(v), inverse(v, Interpolation::InverseDistance);
        const Color L = at(trilinear, t, &info);
        REQUIRE(info.validity == Approx(validity).epsilon(1e-5));
        REQUIRE((Vec3d(L) - sum / weight).length() < 1e-5);
        REQUIRE((Vec3d(at(inverse, t)) - idw / idwWeight).length() < 1e-5);
        REQUIRE(at(VolumeSampler(v, Interpolation::Nearest), t) == nearestValue);
        for (const Interpolation mode :
            {Interpolation::Taylor, Interpolation::Gradient, Interpolation::Tricubic})
            REQUIRE(std::isfinite(at(VolumeSampler(v, mode), t).x));
    }
}

TEST_CASE("gradient interpolation is exact for quadratic fields, trilinear is not", "[sampler]")
{
    const double h = 0.25;
    IrradianceVolume v = uniformVolume(
        1, GradientStorage::PerCoefficient, {-2, -2, -2}, {2, 2, 2}, latticeTransform(h));
    const auto field = [](const Vec3d& p) {
        return 1 + p.x - 2 * p.y + 3 * p.x * p.x + p.x * p.y - p.y * p.z + 2 * p.z * p.z;
    };
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const Vec3d p = v.sampleWorld(s);
        v.radiance(s)[0] = Color(static_cast<float>(field(p)));
        const Vec3d slope(1 + 6 * p.x + p.y, -2 + p.x - p.z, -p.y + 4 * p.z);
        for (int a = 0; a < 3; ++a) v.gradient(s)[a] = Color(static_cast<float>(slope[a]));
    }
    const VolumeSampler gradient(v, Interpolation::Gradient), linear(v);
    CounterRng rng(5);
    double worstLinear = 0;
    for (int k = 0; k < 300; ++k) {
        const Vec3d p = randomIn(rng, Vec3d(-2 * h), Vec3d(2 * h));
        REQUIRE(at(gradient, p).x == Approx(field(p)).margin(2e-6));
        worstLinear = std::max(worstLinear, std::abs(at(linear, p).x - field(p)));
    }
    CHECK(worstLinear > 0.05);
}

TEST_CASE("on top of an invalid corner, or where none is valid", "[sampler][validity]")
{
    IrradianceVolume v = uniformVolume(1, GradientStorage::PerCoefficient, {0, 0, 0}, {1, 1, 1});
    fillRandom(v, 1);
    // Only the corner (1,1,1) is valid and the point sits on (0,0,0), where its weight is zero.
    for (SampleId s = 0; s < 7; ++s) v.validity(s) = 0;
    for (const Interpolation mode : kModes) {
        CAPTURE(name(mode));
        QueryInfo info;
        Color expected = v.radiance(7)[0];
        if (needsGradients(mode)) {
            // Hermite: h10(t)/h00(t) = t/(1+2t) is the share of the slope, 1/3 at the far end.
            const float share = mode == Interpolation::Tricubic ? 1.0f / 3
                : mode == Interpolation::Gradient               ? 0.5f
                                                                : 1.0f;
            for (int a = 0; a < 3; ++a) expected -= v.gradient(7)[a] * share;
        }
        // The limit from inside, looked at from a millionth of the cell away.
        const Color L = at(VolumeSampler(v, mode), Vec3d(0.0), &info);
        CHECK((L - expected).length() < 1e-5f);
        CHECK(info.level == 0);
        CHECK(info.validity < 1e-5f);
    }
    // No valid corner: all of them, and validity tells.
    v.validity(7) = 0.25f;
    QueryInfo info;
    Vec3d mean(0.0);
    for (SampleId s = 0; s < 8; ++s) mean += Vec3d(v.radiance(s)[0]) / 8;
    const Color L = at(VolumeSampler(v), Vec3d(0.5), &info);
    CHECK((Vec3d(L) - mean).length() < 1e-6);
    CHECK(info.validity == Approx(0.25 / 8));
    CHECK(info.level == 0);
}

TEST_CASE("nearest takes the nearest corner, Taylor its gradient too", "[sampler]")
{
    IrradianceVolume v = uniformVolume(
        1, GradientStorage::PerCoefficient, {-2, -2, -2}, {2, 2, 2}, latticeTransform(0.5));
    fillRandom(v, 6);
    const VolumeSampler nearest(v, Interpolation::Nearest), taylor(v, Interpolation::Taylor);
    CounterRng rng(2);
    for (int k = 0; k < 500; ++k) {
        const Vec3d p = randomIn(rng, Vec3d(-1.0), Vec3d(1.0));
        const Coord c(static_cast<int>(std::round(p.x * 2)), static_cast<int>(std::round(p.y * 2)),
            static_cast<int>(std::round(p.z * 2)));
        const auto s = static_cast<SampleId>(v.findSample(c));
        REQUIRE(at(nearest, p) == v.radiance(s)[0]);
        const Vec3d d = p - v.sampleWorld(s);
        Vec3d expected(v.radiance(s)[0]);
        for (int a = 0; a < 3; ++a) expected += Vec3d(v.gradient(s)[a]) * d[a];
        REQUIRE((Vec3d(at(taylor, p)) - expected).length() < 1e-6);
    }
}

TEST_CASE("gradient interpolation: the trilinear mean of eight half expansions", "[sampler]")
{
    IrradianceVolume v = uniformVolume(
        2, GradientStorage::PerCoefficient, {0, 0, 0}, {1, 1, 1}, latticeTransform(0.2));
    fillRandom(v, 12);
    const VolumeSampler sampler(v, Interpolation::Gradient);
    CounterRng rng(21);
    for (int k = 0; k < 100; ++k) {
        const Vec3d t = randomIn(rng, Vec3d(0.0), Vec3d(1.0)), p = t * 0.2;
        Color L[4];
        sampler.radiance(p, L);
        for (int i = 0; i < 4; ++i) {
            Vec3d expected(0.0);
            for (SampleId s = 0; s < 8; ++s) {
                const Coord c = v.samplePosition(s);
                double w = 1;
                for (int a = 0; a < 3; ++a) w *= c[a] ? t[a] : 1 - t[a];
                Vec3d value(v.radiance(s)[i]);
                for (int a = 0; a < 3; ++a)
                    value += Vec3d(v.gradient(s)[a * 4 + i]) * (0.5 * (p[a] - 0.2 * c[a]));
                expected += value * w;
            }
            REQUIRE((Vec3d(L[i]) - expected).length() < 1e-6);
        }
    }
}

TEST_CASE("irradiance is that of the interpolated radiance; outside it is NaN", "[sampler]")
{
    IrradianceVolume v = uniformVolume(4, GradientStorage::None, {0, 0, 0}, {2, 2, 2});
    fillRandom(v, 30);
    const VolumeSampler sampler(v);
    CounterRng rng(31);
    for (int k = 0; k < 50; ++k) {
        const Vec3d p = randomIn(rng, Vec3d(0.0), Vec3d(2.0));
        const Vec3f n = Vec3f(randomIn(rng, Vec3d(-1.0), Vec3d(1.0))).normalized();
        Color L[16];
        sampler.radiance(p, L);
        // Another order of the same sum.
        REQUIRE((sampler.irradiance(p, n) - irradiance(4, L, n)).length() < 1e-6f);
    }
}

TEST_CASE("levels 0 to 7: every query equals brute force", "[sampler][levels]")
{
    const std::vector<BoxCell> cells = multiLevelCells();
    IrradianceVolume v = volumeOf(cells);
    fillRandom(v, 40);
    const VolumeSampler sampler(v);
    CHECK(sampler.memoryBytes() > 0);
    CounterRng rng(41);
    std::array<int, 8> byLevel{};
    int outside = 0;
    for (int k = 0; k < 4000; ++k) {
        const double reach = k % 3 == 0 ? 400 : k % 3 == 1 ? 60 : 8;
        const Vec3d focus = k % 3 == 0 ? Vec3d(0.0) : Vec3d(-37, 5, 20);
        const Vec3d p = focus + randomIn(rng, Vec3d(-reach), Vec3d(reach));
        Vec3d expected(0.0);
        int level = -1;
        QueryInfo info;
        Color L[4];
        info = sampler.radiance(p, L);
        CAPTURE(p);
        if (!reference(v, cells, p, 3, expected, level)) {
            REQUIRE(info.level == -1);
            REQUIRE(isNan(L[3]));
            ++outside;
            continue;
        }
        REQUIRE(info.level == level);
        REQUIRE((Vec3d(L[3]) - expected).length() < 1e-5);
        ++byLevel[static_cast<std::size_t>(level)];
    }
    for (int n : byLevel) CHECK(n > 20);
    CHECK(outside > 50);
}

TEST_CASE("a level's linear field is exact at every level", "[sampler][levels]")
{
    IrradianceVolume v
        = volumeOf(multiLevelCells(), 2, GradientStorage::PerCoefficient, latticeTransform(0.01));
    const LinearField field;
    fill(v, field);
    for (const Interpolation mode :
        {Interpolation::Trilinear, Interpolation::Taylor, Interpolation::Gradient}) {
        const VolumeSampler sampler(v, mode);
        CounterRng rng(50);
        for (int k = 0; k < 2000; ++k) {
            const Vec3d p = randomIn(rng, Vec3d(-3.8), Vec3d(3.8));
            Color L[4];
            if (sampler.radiance(p, L).level < 0) continue;
            for (int i = 0; i < 4; ++i)
                for (int c = 0; c < 3; ++c)
                    REQUIRE(std::abs(L[i][c] - field.value(p, i, c)) < 3e-5);
        }
    }
}

TEST_CASE("two cells at the ends of a huge lattice: small table or none", "[sampler][hard]")
{
    // A table of all blocks between them would take 2^51 and (four thousand steps) 2^27 entries.
    for (const int far : {(1 << 21) - 2, 4000}) {
        const std::vector<BoxCell> cells = {{{0, 0, 0}, 0}, {Coord(far), 0}};
        IrradianceVolume v = volumeOf(cells);
        fillRandom(v, 60);
        const VolumeSampler sampler(v);
        CAPTURE(far);
        CHECK(sampler.memoryBytes() < 16u << 20);
        CounterRng rng(61);
        for (int k = 0; k < 200; ++k) {
            const Vec3d p = randomIn(rng, Vec3d(0.0), Vec3d(1.0)) + Vec3d(k % 2 ? far : 0);
            Vec3d expected(0.0);
            int level = 0;
            REQUIRE(reference(v, cells, p, 2, expected, level));
            Color L[4];
            REQUIRE(sampler.radiance(p, L).level == 0);
            REQUIRE((Vec3d(L[2]) - expected).length() < 1e-5);
        }
        CHECK(isNan(at(sampler, Vec3d(far / 2))));
        CHECK(std::isfinite(at(sampler, Vec3d(far + 1)).x)); // outer corner
    }
    // One cell of the coarsest level covers 2^27 blocks.
    const IrradianceVolume big = volumeOf({{{-4096, 0, 0}, kMaxLevel}}, 1);
    const VolumeSampler sampler(big);
    CHECK(sampler.memoryBytes() < 16u << 20);
    CHECK(at(sampler, {-0.5, 4095.5, 17}) == Color(0.0f));
    CHECK(isNan(at(sampler, {0.5, 4095.5, 17})));
}

TEST_CASE("table and tree give the same bits", "[sampler][levels]")
{
    // The same fine cells, with and without a far one that makes the table too large.
    std::vector<BoxCell> cells = multiLevelCells();
    IrradianceVolume near = volumeOf(cells);
    cells.push_back({Coord(1 << 20), 0});
    IrradianceVolume wide = volumeOf(cells);
    fillRandom(near, 70);
    fillRandom(wide, 70);
    const VolumeSampler table(near), tree(wide);
    // The table is there for one of them only: three samples' records more, yet smaller.
    REQUIRE(tree.memoryBytes() < table.memoryBytes());
    CounterRng rng(71);
    for (int k = 0; k < 3000; ++k) {
        Vec3d p = randomIn(rng, Vec3d(-390.0), Vec3d(390.0));
        if (k % 4 == 0) p[k / 4 % 3] = std::round(p[k / 4 % 3]); // on faces
        if (k % 8 == 0) p = Vec3d(std::round(p.x), std::round(p.y), std::round(p.z));
        Color a[4], b[4];
        const QueryInfo i = table.radiance(p, a), j = tree.radiance(p, b);
        CAPTURE(p);
        REQUIRE(i.level == j.level);
        REQUIRE(std::memcmp(a, b, sizeof a) == 0);
    }
}

TEST_CASE("one cell, and bounds that begin inside a block", "[sampler][hard]")
{
    for (const Coord& origin : {Coord(0, 0, 0), Coord(7, -1, -8), Coord(-9, 8, 15)}) {
        IrradianceVolume v = volumeOf({{origin, 0}}, 1);
        fill(v, {});
        const VolumeSampler sampler(v);
        for (int i = 0; i < 27; ++i) {
            const Vec3d p = Vec3d(origin) + Vec3d(i % 3, i / 3 % 3, i / 9) * 0.5;
            QueryInfo info;
            const Color L = at(sampler, p, &info);
            CAPTURE(origin, p);
            REQUIRE(info.level == 0);
            REQUIRE(L.x == Approx(LinearField{}.value(p, 0, 0)).margin(1e-5));
        }
        for (int x = -17; x < 25; ++x) {
            if (x == origin.x) continue;
            QueryInfo info;
            at(sampler, Vec3d(x + 0.5, origin.y + 0.5, origin.z + 0.5), &info);
            REQUIRE(info.level == -1);
        }
    }
}
