// SPDX-License-Identifier: Apache-2.0
// Visibility, measured offsets, precision, bias, tricubic interpolation, batches and processors.

#include "volume_makers.h"

#include <lumivdb/core/sampler.h>

#include <catch2/catch.hpp>
#include <hwy/targets.h>
#include <tbb/parallel_for.h>

#include <cstring>
#include <limits>

using namespace lumivdb;
using namespace volume_test;

namespace {

constexpr Interpolation kModes[]
    = {Interpolation::Nearest, Interpolation::Taylor, Interpolation::Trilinear,
        Interpolation::Gradient, Interpolation::Tricubic, Interpolation::InverseDistance};

Vec3d randomIn(CounterRng& rng, const Vec3d& lower, const Vec3d& upper)
{
    Vec3d p;
    for (int a = 0; a < 3; ++a) p[a] = lower[a] + rng.nextDouble() * (upper[a] - lower[a]);
    return p;
}

Color at(const VolumeSampler& sampler, const Vec3d& p)
{
    Color L[kMaxCoefficients];
    sampler.radiance(p, L);
    return L[0];
}

/// A wall at x = 0.3 of the cell: each side sees the corners of its own.
CellVisibility wall()
{
    CellVisibility v;
    v.offset[0] = 0.3f - 0.5f;
    v.masks = 0;
    for (int r = 0; r < 8; ++r) v.masks |= std::uint64_t{r & 1 ? 0xaau : 0x55u} << (8 * r);
    return v;
}

} // namespace

TEST_CASE("a cut cell answers from the corners that the point's region sees", "[sampler][masks]")
{
    IrradianceVolume v = uniformVolume(1, GradientStorage::PerCoefficient, {0, 0, 0}, {1, 1, 1});
    fillRandom(v, 3);
    v.setVisibility({{0, wall()}});
    CounterRng rng(4);
    for (const Interpolation mode : kModes) {
        const VolumeSampler sampler(v, mode);
        for (int k = 0; k < 200; ++k) {
            const Vec3d t = randomIn(rng, Vec3d(0.0), Vec3d(1.0));
            // Dark what is behind the wall: nothing of it must show.
            IrradianceVolume other = v.clone();
            const int side = t.x >= 0.3f;
            for (SampleId s = 0; s < 8; ++s)
                if (v.samplePosition(s).x != side) other.radiance(s)[0] = Color(1e9f);
            CAPTURE(name(mode), t);
            REQUIRE(at(sampler, t) == at(VolumeSampler(other, mode), t));
            if (mode != Interpolation::Trilinear) continue;
            // x drops out; bilinear in y and z.
            Vec3d expected(0.0);
            for (SampleId s = 0; s < 8; ++s) {
                const Coord c = v.samplePosition(s);
                if (c.x != side) continue;
                expected += Vec3d(v.radiance(s)[0]) * (c.y ? t.y : 1 - t.y) * (c.z ? t.z : 1 - t.z);
            }
            REQUIRE((Vec3d(at(sampler, t)) - expected).length() < 1e-6);
        }
    }
}

TEST_CASE("a region that sees no valid corner takes all valid ones", "[sampler][masks]")
{
    IrradianceVolume v = uniformVolume(1, GradientStorage::None, {0, 0, 0}, {1, 1, 1});
    for (SampleId s = 0; s < 8; ++s) {
        const Coord c = v.samplePosition(s);
        v.radiance(s)[0] = Color(static_cast<float>(c.x + 1));
        v.validity(s) = c.x == 0 ? 0.0f : 1.0f;
    }
    v.setVisibility({{0, wall()}});
    for (const Interpolation mode :
        {Interpolation::Nearest, Interpolation::Trilinear, Interpolation::InverseDistance}) {
        const VolumeSampler sampler(v, mode);
        // Below 0.3 it sees x = 0 only, which is invalid.
        CHECK(at(sampler, {0.1, 0.4, 0.6}).x == Approx(2));
        CHECK(at(sampler, {0.9, 0.4, 0.6}).x == Approx(2));
    }
    CellVisibility blind;
    blind.masks = 0;
    v.setVisibility({{0, blind}});
    QueryInfo info;
    Color L[1];
    info = VolumeSampler(v).radiance({0.25, 0.5, 0.5}, L);
    CHECK(L[0].x == Approx(2));
    CHECK(info.validity == Approx(0.25)); // of all corners, seen or not
    // No valid corner at all: all of them.
    for (SampleId s = 0; s < 8; ++s) v.validity(s) = 0;
    info = VolumeSampler(v).radiance({0.25, 0.5, 0.5}, L);
    CHECK(L[0].x == Approx(1.25));
    CHECK(info.validity == 0);
}

TEST_CASE("a cut cell beside finer ones: ghosts are made of what is seen", "[sampler][masks]")
{
    // One cell of level 1, split because eight of level 0 lie behind its high z face.
    std::vector<BoxCell> cells = {{{0, 0, 0}, 1}};
    for (int i = 0; i < 4; ++i) cells.push_back({{i & 1, i >> 1, 2}, 0});
    IrradianceVolume v = volumeOf(cells, 1, GradientStorage::PerCoefficient);
    fillRandom(v, 7);
    const CellId coarse = v.findCell({0, 0, 0});
    REQUIRE(v.cell(coarse).level == 1);
    v.setVisibility({{coarse, wall()}});
    for (const Interpolation mode : {Interpolation::Trilinear, Interpolation::Gradient,
             Interpolation::Tricubic, Interpolation::InverseDistance}) {
        const VolumeSampler sampler(v, mode);
        CounterRng rng(8);
        // Inside one region the field is continuous across the parts' borders at 1.
        for (int k = 0; k < 500; ++k) {
            Vec3d p = randomIn(rng, Vec3d(0.0), Vec3d(2.0));
            if (p.x < 0.61 && p.x > 0.59) continue;
            Vec3d q = p;
            const int a = p.x < 0.6 ? 1 + k % 2 : k % 3;
            p[a] = 1 - 1e-6;
            q[a] = 1 + 1e-6;
            CAPTURE(name(mode), p, q);
            REQUIRE((at(sampler, p) - at(sampler, q)).length() < 5e-5f);
        }
        // Nothing comes through the wall: samples with x ≥ 1 do not show below x = 0.6. (Sample
        // (1, y, 2) hangs on an edge of which one end is seen: the ghost there is of that end.)
        IrradianceVolume other = v.clone();
        for (SampleId s = 0; s < v.sampleCount(); ++s) {
            if (v.samplePosition(s).x == 0) continue;
            other.radiance(s)[0] = Color(1e9f);
        }
        const VolumeSampler changed(other, mode);
        for (int k = 0; k < 500; ++k) {
            const Vec3d p = randomIn(rng, Vec3d(0.0), Vec3d(0.599, 2, 2));
            CAPTURE(name(mode), p);
            REQUIRE(at(sampler, p) == at(changed, p));
        }
    }
    // Trilinear, by hand: seen corners are those of x = 0, whose ghosts do not depend on x. On the
    // face z = 2 the hanging sample (0, 1, 2) has both ends seen.
    const VolumeSampler sampler(v);
    const auto value = [&](int x, int y, int z) {
        return Vec3d(v.radiance(static_cast<SampleId>(v.findSample({x, y, z})))[0]);
    };
    const Vec3d expected = (value(0, 1, 2) + value(0, 2, 2)) * 0.5;
    CHECK((Vec3d(at(sampler, {0.0, 1.5, 2 - 1e-9})) - expected).length() < 1e-6);
}

TEST_CASE("gradient interpolation keeps linear fields where a wall hides corners",
    "[sampler][visibility]")
{
    IrradianceVolume v = uniformVolume(1, GradientStorage::PerCoefficient, {0, 0, 0}, {1, 1, 1});
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const Vec3d p = v.sampleWorld(s);
        // Behind the wall of wall() it is another field.
        v.radiance(s)[0] = Color(static_cast<float>(p.x < 0.5 ? 1 + 2 * p.y - p.z : 100 + p.x));
        for (int a = 0; a < 3; ++a) v.gradient(s)[a] = Color(0.0f);
        v.gradient(s)[0] = Color(p.x < 0.5 ? 3.0f : 1.0f);
        if (p.x < 0.5) v.gradient(s)[1] = Color(2.0f), v.gradient(s)[2] = Color(-1.0f);
    }
    v.setVisibility({{v.findCell({0, 0, 0}), wall()}});
    const VolumeSampler sampler(v, Interpolation::Gradient);
    CounterRng rng(3);
    for (int k = 0; k < 200; ++k) {
        const Vec3d p = randomIn(rng, Vec3d(0.0), Vec3d(0.299, 1, 1));
        REQUIRE(at(sampler, p).x == Approx(1 + 3 * p.x + 2 * p.y - p.z).margin(1e-5));
    }
}

TEST_CASE("samples measured elsewhere: expansions count from there", "[sampler][offsets]")
{
    // A linear field: exact again once offsets are known, whatever they are.
    Mat4d turned;
    turned.setEulerAngles(Vec3d(0.4, 1.1, -2.0));
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) turned[i][j] *= 0.3;
    IrradianceVolume v
        = uniformVolume(2, GradientStorage::PerCoefficient, {0, 0, 0}, {3, 3, 3}, turned);
    const LinearField field;
    std::vector<Vec3f> offsets(v.sampleCount());
    CounterRng rng(5);
    for (Vec3f& o : offsets) o = Vec3f(randomIn(rng, Vec3d(-0.1), Vec3d(0.1)));
    v.setOffsets(offsets);
    for (SampleId s = 0; s < v.sampleCount(); ++s)
        for (int i = 0; i < 4; ++i)
            for (int c = 0; c < 3; ++c) {
                v.radiance(s)[i][c] = static_cast<float>(field.value(v.measuredWorld(s), i, c));
                for (int a = 0; a < 3; ++a)
                    v.gradient(s)[a * 4 + i][c] = static_cast<float>(field.slope(i, c)[a]);
            }
    for (const Interpolation mode :
        {Interpolation::Taylor, Interpolation::Gradient, Interpolation::Tricubic}) {
        const VolumeSampler sampler(v, mode);
        for (int k = 0; k < 300; ++k) {
            const Vec3d p = randomIn(rng, Vec3d(0.0), Vec3d(3.0)) * v.indexToWorld();
            Color L[4];
            sampler.radiance(p, L);
            CAPTURE(name(mode), p);
            for (int i = 0; i < 4; ++i)
                for (int c = 0; c < 3; ++c)
                    REQUIRE(std::abs(L[i][c] - field.value(p, i, c)) < 1e-5);
        }
    }
}

TEST_CASE("tricubic: sums of cubics of one variable are exact, slopes have no step",
    "[sampler][tricubic]")
{
    // Zero mixed derivatives are theirs; so Hermite interpolation is exact, in coarse cells too,
    // and where they are split, since restriction is.
    std::vector<BoxCell> cells;
    for (int x = -1; x < 1; ++x)
        for (int y = -1; y < 1; ++y)
            for (int z = -1; z < 1; ++z) refineTowards({2, 1, -3}, {Coord(x, y, z) * 8, 3}, cells);
    IrradianceVolume v
        = volumeOf(cells, 1, GradientStorage::PerCoefficient, latticeTransform(0.125));
    const auto cubic = [](double x, int a) { return ((0.7 - a) * x * x + 0.5 * a - 1) * x + a; };
    const auto slope = [](double x, int a) { return 3 * (0.7 - a) * x * x + 0.5 * a - 1; };
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        const Vec3d p = v.sampleWorld(s);
        v.radiance(s)[0] = Color(static_cast<float>(cubic(p.x, 0) + cubic(p.y, 1) + cubic(p.z, 2)));
        for (int a = 0; a < 3; ++a) v.gradient(s)[a] = Color(static_cast<float>(slope(p[a], a)));
    }
    const VolumeSampler sampler(v, Interpolation::Tricubic);
    CounterRng rng(6);
    for (int k = 0; k < 4000; ++k) {
        const Vec3d p = randomIn(rng, Vec3d(-0.999), Vec3d(0.999));
        CAPTURE(p);
        REQUIRE(
            at(sampler, p).x == Approx(cubic(p.x, 0) + cubic(p.y, 1) + cubic(p.z, 2)).margin(2e-6));
    }
}

TEST_CASE("half precision: within 1e-3, whatever the size of the values", "[sampler][half][heavy]")
{
    const std::vector<BoxCell> cells = multiLevelCells();
    for (const float scale : {1.0f, 1e-30f, 1e9f, 1e30f}) {
        for (int bands = 1; bands <= kMaxBands; ++bands) {
            IrradianceVolume v
                = volumeOf(cells, bands, GradientStorage::PerCoefficient, latticeTransform(0.1));
            fillRandom(v, 90);
            for (SampleId s = 0; s < v.sampleCount(); ++s) {
                for (int i = 0; i < 4 * v.coefficients(); ++i) v.radiance(s)[i] *= scale;
                if (s % 7 == 0) v.validity(s) = 0.3f;
            }
            for (const Interpolation mode : {Interpolation::Nearest, Interpolation::Trilinear,
                     Interpolation::Gradient, Interpolation::Tricubic}) {
                const VolumeSampler full(v, mode), half(v, {mode, Precision::Half, 0});
                CHECK(half.memoryBytes() < full.memoryBytes());
                CounterRng rng(91);
                double worst = 0;
                for (int k = 0; k < 200; ++k) {
                    const Vec3d p = randomIn(rng, Vec3d(-30.0), Vec3d(30.0));
                    Color a[kMaxCoefficients], b[kMaxCoefficients];
                    if (full.radiance(p, a).level < 0) continue;
                    REQUIRE(half.radiance(p, b).level >= 0);
                    // All summands are positive: errors of the records pass on, and no more.
                    double size = 0, error = 0;
                    for (int i = 0; i < v.coefficients(); ++i) {
                        size = std::max(size, Vec3d(a[i]).length());
                        error = std::max(error, (Vec3d(a[i]) - Vec3d(b[i])).length());
                    }
                    worst = std::max(worst, error / size);
                }
                CAPTURE(scale, bands, name(mode));
                CHECK(worst > 0);
                if (mode == Interpolation::Trilinear || mode == Interpolation::Nearest) {
                    CHECK(worst < 1e-3);
                } else {
                    // Expansions of both signs over coarse cells: larger summands than the sum.
                    CHECK(worst < 5e-3);
                }
            }
        }
    }
}

TEST_CASE("the normal bias looks off the surface", "[sampler]")
{
    IrradianceVolume v = uniformVolume(2, GradientStorage::None, {0, 0, 0}, {4, 4, 4});
    fillRandom(v, 2);
    const VolumeSampler plain(v), biased(v, {Interpolation::Trilinear, Precision::Float, 0.25});
    const Vec3f n(0, 0.6f, 0.8f);
    const Vec3d p(1.3, 2.2, 1.9);
    CHECK(biased.irradiance(p, n) == plain.irradiance(p + Vec3d(n) * 0.25, n));
    CHECK(biased.irradiance(p, n) != plain.irradiance(p, n));
    CHECK(biased.options().normalBias == 0.25);
    Color a[4], b[4];
    biased.radiance(p, a); // no normal: no bias
    plain.radiance(p, b);
    CHECK(std::memcmp(a, b, sizeof a) == 0);
}

TEST_CASE("a sampler needs its volume no more once it is made", "[sampler]")
{
    auto v = std::make_unique<IrradianceVolume>(volumeOf(multiLevelCells()));
    fillRandom(*v, 1);
    const VolumeSampler sampler(*v);
    const VolumeSampler copy = sampler;
    const Color before = at(sampler, {1.5, 2.5, 3.5});
    v.reset();
    CHECK(at(sampler, {1.5, 2.5, 3.5}) == before);
    CHECK(at(copy, {1.5, 2.5, 3.5}) == before);
}

TEST_CASE("every processor gives the same bits, in batches and one by one", "[sampler][simd]")
{
    IrradianceVolume v = volumeOf(multiLevelCells(), 3, GradientStorage::PerCoefficient);
    fillRandom(v, 80);
    std::vector<std::pair<CellId, CellVisibility>> cut;
    for (CellId c = 0; c < static_cast<CellId>(v.cellCount()); c += 5) cut.push_back({c, wall()});
    v.setVisibility(cut);
    for (SampleId s = 0; s < v.sampleCount(); s += 3) v.validity(s) = 0.2f;
    constexpr std::size_t kCount = 3000;
    std::vector<Vec3d> p(kCount);
    std::vector<Vec3f> n(kCount);
    CounterRng rng(81);
    for (std::size_t i = 0; i < kCount; ++i) {
        const double reach = i % 2 ? 400 : 20;
        p[i] = Vec3d(-37, 5, 20) * (i % 2 ? 0 : 1) + randomIn(rng, Vec3d(-reach), Vec3d(reach));
        n[i] = Vec3f(randomIn(rng, Vec3d(-1.0), Vec3d(1.0))).normalized();
    }
    const std::int64_t supported = hwy::SupportedTargets();
    int targets = 0;
    for (const Precision precision : {Precision::Float, Precision::Half}) {
        for (const Interpolation mode : kModes) {
            const VolumeSampler sampler(v, {mode, precision, 0.01});
            std::vector<Color> first;
            for (std::int64_t rest = supported; rest != 0; rest &= rest - 1) {
                hwy::SetSupportedTargetsForTest(rest & -rest);
                ++targets;
                std::vector<Color> batch(kCount);
                std::vector<QueryInfo> info(kCount);
                sampler.irradiance(kCount, p.data(), n.data(), batch.data(), info.data());
                if (first.empty()) first = batch;
                std::size_t different = 0;
                for (std::size_t i = 0; i < kCount; ++i) {
                    QueryInfo one;
                    const Color single = sampler.irradiance(p[i], n[i], &one);
                    different += one.level != info[i].level || one.validity != info[i].validity;
                    if (one.level < 0) continue;
                    different += single != batch[i] || first[i] != batch[i];
                }
                CAPTURE(name(mode), hwy::TargetName(rest & -rest));
                CHECK(different == 0);
            }
            hwy::SetSupportedTargetsForTest(0);
        }
    }
    CHECK(targets >= 12);
}

TEST_CASE("batches and threads: the same bits as one query at a time", "[sampler]")
{
    IrradianceVolume v = volumeOf(multiLevelCells(), 3, GradientStorage::PerCoefficient);
    fillRandom(v, 80);
    for (SampleId s = 0; s < v.sampleCount(); s += 3) v.validity(s) = 0.2f;
    constexpr std::size_t kCount = 20000;
    std::vector<Vec3d> p(kCount);
    std::vector<Vec3f> n(kCount);
    CounterRng rng(81);
    for (std::size_t i = 0; i < kCount; ++i) {
        p[i] = randomIn(rng, Vec3d(-400.0), Vec3d(400.0));
        if (i % 100 == 0) p[i].x = std::numeric_limits<double>::quiet_NaN();
        n[i] = Vec3f(randomIn(rng, Vec3d(-1.0), Vec3d(1.0))).normalized();
    }
    for (const Interpolation mode : kModes) {
        const VolumeSampler sampler(v, mode);
        std::vector<Color> single(kCount), batch(kCount), bare(kCount), threads(kCount);
        std::vector<QueryInfo> info(kCount);
        std::size_t different = 0;
        sampler.irradiance(kCount, p.data(), n.data(), batch.data(), info.data());
        sampler.irradiance(kCount, p.data(), n.data(), bare.data());
        tbb::parallel_for(std::size_t{0}, kCount,
            [&](std::size_t i) { threads[i] = sampler.irradiance(p[i], n[i]); });
        for (std::size_t i = 0; i < kCount; ++i) {
            QueryInfo one;
            single[i] = sampler.irradiance(p[i], n[i], &one);
            different += one.level != info[i].level || one.validity != info[i].validity;
            // The sign and payload of a NaN are nobody's promise.
            different += one.level < 0
                ? !(isNan(single[i]) && isNan(batch[i]) && isNan(bare[i]) && isNan(threads[i]))
                : single[i] != batch[i] || single[i] != bare[i] || single[i] != threads[i];
        }
        CAPTURE(name(mode));
        CHECK(different == 0);
    }
    CHECK_NOTHROW(VolumeSampler(v).irradiance(0, nullptr, nullptr, nullptr));
}
