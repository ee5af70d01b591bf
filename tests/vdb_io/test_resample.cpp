// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include "../../vdb_io/src/nearest_cell.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/core/sampler.h>
#include <lumivdb/vdb_io/resample.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

using namespace vdb_test;

namespace {

Vec3f randomDirection(CounterRng& rng)
{
    const double z = 2 * rng.nextDouble() - 1, phi = 6.283185307179586 * rng.nextDouble();
    const double r = std::sqrt(1 - z * z);
    return Vec3f(Vec3d(r * std::cos(phi), r * std::sin(phi), z));
}

Vec3d randomPoint(CounterRng& rng, const Box3d& box)
{
    Vec3d p;
    for (int a = 0; a < 3; ++a) p[a] = box.min[a] + (box.max[a] - box.min[a]) * rng.nextDouble();
    return p;
}

/// The turned volume must answer the turned question like the old volume the old one:
/// E'(p m, n R) = E(p, n). @return the largest difference over the largest E.
double transformError(const IrradianceVolume& volume, const Mat4d& m, Interpolation mode)
{
    const IrradianceVolume turned = transformVolume(volume, m);
    const VolumeSampler before(volume, mode), after(turned, mode);
    CounterRng rng(17);
    double worst = 0, largest = 0;
    for (int i = 0; i < 300; ++i) {
        Vec3d q, d;
        // Inside by a margin: at the border the two can differ by a rounding about being inside.
        const Vec3d p = volume.worldBounds().center()
            + (randomPoint(rng, volume.worldBounds()) - volume.worldBounds().center()) * 0.99;
        const Vec3f n = randomDirection(rng);
        m.multVecMatrix(p, q);
        m.multDirMatrix(Vec3d(n), d);
        const Color a = before.irradiance(p, n), b = after.irradiance(q, Vec3f(d.normalized()));
        for (int k = 0; k < 3; ++k) {
            REQUIRE(std::isfinite(a[k]));
            worst = std::max(worst, std::abs(double{a[k]} - double{b[k]}));
            largest = std::max(largest, std::abs(double{a[k]}));
        }
    }
    return worst / largest;
}

Mat4d someSimilarity()
{
    Mat4d m, scale, move;
    m.setAxisAngle(Vec3d(0.3, -1, 0.5).normalized(), 2.1);
    scale.setScale(2.5);
    move.setTranslation(Vec3d(3, -7, 1.5));
    return m * scale * move;
}

int usageCode(const std::function<void()>& action)
{
    try {
        action();
    } catch (const Error& e) {
        UNSCOPED_INFO(e.what());
        return static_cast<int>(e.code());
    }
    return 0;
}

constexpr int kUsage = static_cast<int>(ErrorCode::Usage);

} // namespace

TEST_CASE("a transformed volume answers the transformed question")
{
    for (const bool gradients : {false, true}) {
        const Interpolation mode = gradients ? Interpolation::Gradient : Interpolation::Trilinear;
        for (int bands = 1; bands <= 6; ++bands) {
            INFO(bands << " bands, gradients " << gradients);
            IrradianceVolume volume = uniformVolume({-3, 0, 0}, {4, 5, 6}, bands, gradients);
            CHECK(transformError(volume, upAxisRotation("y", "z"), mode) < 2e-6);
            CHECK(transformError(volume, someSimilarity(), mode) < 2e-6);
        }
    }
}

TEST_CASE("up-axis rotation takes (x, y, z) to (x, -z, y) and back without a trace")
{
    Vec3d p;
    upAxisRotation("y", "z").multVecMatrix(Vec3d(1, 2, 3), p);
    CHECK(p == Vec3d(1, -3, 2));
    CHECK(upAxisRotation("y", "z") * upAxisRotation("z", "y") == Mat4d());
    CHECK(upAxisRotation("z", "z") == Mat4d());
    CHECK_THROWS_AS(upAxisRotation("x", "z"), Error);
    const IrradianceVolume volume = uniformVolume({0, 0, 0}, {2, 2, 2}, 3, true);
    const IrradianceVolume there = transformVolume(volume, upAxisRotation("y", "z"));
    // Light from +y, L1 Y1 = −0.4886 L1 y, must come from +z: 0.4886 L2' z, so L2' = −L1. Light
    // from +z, 0.4886 L2 z, must come from −y: −0.4886 L1' y, so L1' = L2.
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        CHECK(there.radiance(s)[2].x == Approx(-volume.radiance(s)[1].x).margin(1e-7));
        CHECK(there.radiance(s)[1].x == Approx(volume.radiance(s)[2].x).margin(1e-7));
        CHECK(there.radiance(s)[3].x == Approx(volume.radiance(s)[3].x).margin(1e-7));
    }
    const TempFolder folder; // the rotated lattice survives the file
    saveVolume(there, folder.file("z.vdb"));
    CHECK(difference(there, loadVolume(folder.file("z.vdb"))) == "");
}

TEST_CASE("gradients stay derivatives of the turned field")
{
    // Coefficient 0 linear in the world position: gradient exact; after the similarity the stored
    // gradient must be the slope between its samples.
    IrradianceVolume volume = uniformVolume({0, 0, 0}, {3, 3, 3}, 1, true);
    const Vec3d slope(0.5, -2, 1);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        volume.radiance(s)[0] = Color(static_cast<float>(slope.dot(volume.sampleWorld(s))));
        for (int a = 0; a < 3; ++a) volume.gradient(s)[a] = Color(static_cast<float>(slope[a]));
        volume.distance(s) = 2.0f;
    }
    const IrradianceVolume out = transformVolume(volume, someSimilarity());
    const Color* g = out.gradient(0);
    for (std::size_t i = 1; i < out.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        const Vec3d d = out.sampleWorld(s) - out.sampleWorld(0);
        const double predicted = g[0].x * d.x + g[1].x * d.y + g[2].x * d.z;
        const double actual = double{out.radiance(s)[0].x} - double{out.radiance(0)[0].x};
        CHECK(actual == Approx(predicted).margin(1e-5));
    }
    CHECK(out.distance(0) == 5.0f);
    CHECK(out.spacing() == Approx(1.25).epsilon(1e-12));
}

TEST_CASE("transforms that are no similarity are refused")
{
    const IrradianceVolume volume = uniformVolume({0, 0, 0}, {1, 1, 1}, 2, false);
    const auto code = [&volume](double a, double b, double c, double d, double last = 1) {
        const Mat4d m(a, d, 0, 0, 0, b, 0, 0, 0, 0, c, 0, 0, 0, 0, last);
        return usageCode([&] { transformVolume(volume, m); });
    };
    CHECK(code(1, 1, 1, 0) == 0);
    CHECK(code(1, 1, 2, 0) == kUsage); // non-uniform
    CHECK(code(1, 1, 1, 0.1) == kUsage); // shear
    CHECK(code(1, 1, -1, 0) == kUsage); // mirror
    CHECK(code(0, 0, 0, 0) == kUsage);
    CHECK(code(1, 1, 1, 0, 2) == kUsage);
    CHECK(code(std::nan(""), 1, 1, 0) == kUsage);
}

TEST_CASE("bands are cut and padded")
{
    const IrradianceVolume volume = uniformVolume({0, 0, 0}, {3, 2, 2}, 3, true);
    const IrradianceVolume two = withBands(volume, 2), five = withBands(volume, 5);
    IrradianceVolume back = withBands(withBands(volume, 6), 3);
    CHECK(back.metadata().errorReached == -1.0); // measured for another field
    back.metadata() = volume.metadata();
    CHECK(difference(volume, back) == "");
    CHECK(two.metadata().errorReached == -1.0);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        for (int c = 0; c < 4; ++c) {
            REQUIRE(two.radiance(s)[c] == volume.radiance(s)[c]);
            REQUIRE(two.gradient(s)[2 * 4 + c] == volume.gradient(s)[2 * 9 + c]);
        }
        for (int c = 9; c < 25; ++c) REQUIRE(five.radiance(s)[c] == Color(0.0f));
    }
    CHECK_THROWS_AS(withBands(volume, 7), Error);
    CHECK_FALSE(withoutGradients(volume).hasGradients());
    CHECK(withoutGradients(volume).radiance(4)[8] == volume.radiance(4)[8]);
}

TEST_CASE("resampling to the same spacing changes nothing, to half keeps every sample")
{
    IrradianceVolume volume = uniformVolume({-3, 0, 2}, {5, 4, 7}, 2, false);
    volume.metadata().errorReached = -1;
    volume.metadata().errorConfidence = 0;
    volume.metadata().cacheBias = volume.metadata().cacheBiasUpper = -1;
    const auto mode = Interpolation::Trilinear;
    CHECK(difference(volume, resampleUniform(volume, 0.5, mode)) == "");
    const IrradianceVolume fine = resampleUniform(volume, 0.25, mode);
    CHECK(fine.sampleCount() == 17u * 9 * 11);
    CHECK(difference(volume, resampleUniform(fine, 0.5, mode)) == "");
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) volume.validity(SampleId(i)) = 1;
    CHECK(compareVolumes(volume, resampleUniform(volume, 0.25, mode), 2000, 1) < 1e-6);
    CHECK(compareVolumes(volume, resampleUniform(volume, 0.7, mode), 2000, 1) > 0.01);
}

TEST_CASE("resampling is exact for a field that interpolation represents")
{
    // Linear in space, on a rotated lattice, to a spacing that divides nothing.
    Mat4d m;
    m.setAxisAngle(Vec3d(1, 2, 3).normalized(), 0.7);
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(0.3) * m);
    builder.addUniform({0, 0, 0}, {9, 9, 9});
    IrradianceVolume volume = builder.build();
    const auto field = [](const Vec3d& p) { return static_cast<float>(3 + p.x - 2 * p.y + p.z); };
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        volume.radiance(s)[0] = Color(field(volume.sampleWorld(s)));
        volume.distance(s) = std::numeric_limits<float>::infinity();
    }
    const IrradianceVolume out = resampleUniform(volume, 0.19, Interpolation::Trilinear);
    std::size_t inside = 0;
    for (std::size_t i = 0; i < out.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        REQUIRE(std::isfinite(out.radiance(s)[0].x));
        REQUIRE(std::isinf(out.distance(s)));
        Vec3d lattice;
        volume.worldToIndex().multVecMatrix(out.sampleWorld(s), lattice);
        if (std::max({lattice.x, lattice.y, lattice.z}) > 9) continue; // clamped to the old box
        CHECK(out.radiance(s)[0].x == Approx(field(out.sampleWorld(s))).margin(1e-5));
        ++inside;
    }
    CHECK(inside == 15u * 15 * 15); // 2.7 / 0.19 = 14.2: points 0 … 14 of 16 lie inside
    CHECK(out.sampleCount() == 16u * 16 * 16);
}

TEST_CASE("the nearest cell is the one that a search through all finds")
{
    const IrradianceVolume volume = adaptiveVolume({-16, 0, 0}, 5, {-3, 5, 7}, 1, false);
    const NearestCell nearest(volume);
    CounterRng rng(5);
    for (int i = 0; i < 500; ++i) {
        const Vec3d p = randomPoint(rng, Box3d(Vec3d(-40, -20, -20), Vec3d(40, 50, 50)));
        double best = std::numeric_limits<double>::infinity();
        CellId expected = kNoCell;
        for (std::size_t id = 0; id < volume.cellCount(); ++id) {
            const Cell& cell = volume.cell(static_cast<CellId>(id));
            double sum = 0;
            for (int a = 0; a < 3; ++a) {
                const double lower = cell.origin[a], upper = lower + (1 << cell.level);
                const double d = p[a] - std::clamp(p[a], lower, upper);
                sum += d * d;
            }
            if (sum < best) best = sum, expected = static_cast<CellId>(id);
        }
        REQUIRE(nearest.find(p) == expected);
    }
}

TEST_CASE("resampling fills holes and refuses bad spacings")
{
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(1.0));
    builder.addUniform({0, 0, 0}, {2, 2, 2});
    builder.addUniform({10, 0, 0}, {12, 2, 2});
    IrradianceVolume volume = builder.build();
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        volume.radiance(s)[0] = Color(static_cast<float>(volume.samplePosition(s).x));
    }
    const IrradianceVolume out = resampleUniform(volume, 0.5, Interpolation::Trilinear);
    const auto at = [&out](int x) {
        return out.radiance(static_cast<SampleId>(out.findSample({x, 1, 1})))[0].x;
    };
    CHECK(at(3) == Approx(1.5));
    CHECK(at(8) == Approx(2.0)); // x = 4: nearest point of the volume is x = 2
    CHECK(at(16) == Approx(10.0)); // x = 8: nearest is x = 10
    for (const double bad :
        {0.0, -1.0, std::nan(""), 1e-12, std::numeric_limits<double>::infinity()}) {
        CHECK(usageCode([&] { resampleUniform(volume, bad, Interpolation::Trilinear); }) == kUsage);
    }
}

TEST_CASE("an adaptive volume resampled at its finest spacing keeps its samples")
{
    IrradianceVolume volume = adaptiveVolume({0, 0, 0}, 4, {3, 5, 7}, 2, false);
    const IrradianceVolume out
        = resampleUniform(volume, volume.spacing(), Interpolation::Trilinear);
    CHECK(out.sampleCount() == 17u * 17 * 17);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        const auto t = static_cast<SampleId>(out.findSample(volume.samplePosition(s)));
        for (int c = 0; c < 4; ++c) REQUIRE(out.radiance(t)[c] == volume.radiance(s)[c]);
    }
}

TEST_CASE("cropping keeps what overlaps and joining gives the whole back")
{
    const IrradianceVolume whole = uniformVolume({0, 0, 0}, {8, 6, 5}, 3, true, 0.5);
    const auto piece = [&whole](double x0, double x1) {
        return cropVolume(whole, Box3d(Vec3d(x0, -9, -9), Vec3d(x1, 9, 9)));
    };
    const IrradianceVolume left = piece(-9, 1.5), right = piece(1.5, 9);
    CHECK(left.cellCount() == 3u * 6 * 5); // the box ends on a face: no cell beyond it
    CHECK(right.cellCount() == 5u * 6 * 5);
    IrradianceVolume joined = joinVolumes({&right, &left});
    CHECK(joined.cellCount() == whole.cellCount());
    joined.metadata() = whole.metadata(); // a crop forgets the measured error
    CHECK(difference(whole, joined) == "");
    CHECK(piece(1.4, 1.6).cellCount() == 2u * 6 * 5);
    CHECK(usageCode([&] { piece(100, 101); }) == kUsage);
    CHECK(usageCode([&] { cropVolume(whole, Box3d()); }) == kUsage);

    const TempFolder folder; // identical bytes in the file too
    saveVolume(whole, folder.file("whole.vdb"));
    saveVolume(joined, folder.file("joined.vdb"));
    CHECK(readBytes(folder.file("whole.vdb")) == readBytes(folder.file("joined.vdb")));
}

TEST_CASE("cropping works on rotated and adaptive volumes")
{
    const IrradianceVolume adaptive = adaptiveVolume({0, 0, 0}, 5, {3, 5, 7}, 2, true);
    const IrradianceVolume corner
        = cropVolume(adaptive, Box3d(Vec3d(0, 0, 0), Vec3d(2, 2, 2))); // lattice 0 … 8
    CHECK(corner.cellCount() > 50);
    CHECK(corner.cellCount() < adaptive.cellCount());
    const IrradianceVolume turned = transformVolume(adaptive, upAxisRotation("y", "z"));
    const IrradianceVolume same = cropVolume(turned, Box3d(Vec3d(0, -2, 0), Vec3d(2, 0, 2)));
    CHECK(same.cellCount() == corner.cellCount());
}

TEST_CASE("joining refuses what does not fit")
{
    const IrradianceVolume a = uniformVolume({0, 0, 0}, {4, 4, 4}, 2, false);
    IrradianceVolume b = uniformVolume({4, 0, 0}, {8, 4, 4}, 2, false);
    // fillRandom() makes the first sample of each volume special, and that of b is shared.
    const auto first = static_cast<SampleId>(a.findSample({4, 0, 0}));
    b.radiance(0)[3] = a.radiance(first)[3];
    CHECK(joinVolumes({&a, &b}).cellCount() == 2u * 64);
    b.radiance(static_cast<SampleId>(b.findSample({4, 1, 1})))[2].z += 1;
    const auto code = [&a](const IrradianceVolume& v) {
        return usageCode([&] { joinVolumes({&a, &v}); });
    };
    CHECK(code(b) == kUsage);
    CHECK(code(uniformVolume({4, 0, 0}, {8, 4, 4}, 3, false)) == kUsage);
    CHECK(code(uniformVolume({4, 0, 0}, {8, 4, 4}, 2, true)) == kUsage);
    CHECK(code(uniformVolume({4, 0, 0}, {8, 4, 4}, 2, false, 0.25)) == kUsage);
    VolumeBuilder builder(2, GradientStorage::None, latticeTransform(0.5));
    builder.addCell({0, 0, 0}, 1); // covers cells of a
    const IrradianceVolume coarse = builder.build();
    CHECK(code(coarse) == kUsage);
    CHECK(usageCode([] { joinVolumes({}); }) == kUsage);
}

TEST_CASE("sums are linear")
{
    const IrradianceVolume a = uniformVolume({0, 0, 0}, {3, 3, 3}, 3, true);
    IrradianceVolume b = uniformVolume({0, 0, 0}, {3, 3, 3}, 3, true);
    fillRandom(b, 1234);
    b.metadata().lightGroup = "moon";
    const IrradianceVolume sum = addVolumes({&a, &b}, {0.25, -3.0});
    for (std::size_t i = 0; i < a.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        for (int c = 0; c < 27; ++c) {
            const double want
                = 0.25 * double{a.gradient(s)[c].y} - 3.0 * double{b.gradient(s)[c].y};
            REQUIRE(sum.gradient(s)[c].y == static_cast<float>(want));
        }
        const double want = 0.25 * double{a.radiance(s)[8].z} - 3.0 * double{b.radiance(s)[8].z};
        REQUIRE(sum.radiance(s)[8].z == static_cast<float>(want));
        REQUIRE(sum.validity(s) == a.validity(s));
        REQUIRE(sum.distance(s) == a.distance(s));
    }
    CHECK(sum.metadata().lightGroup.empty());
    CHECK(sum.metadata().errorReached == -1.0);
    IrradianceVolume scaled = a.clone();
    scaleVolume(scaled, 2.0);
    const IrradianceVolume twice = addVolumes({&a}, {2.0});
    CHECK(scaled.radiance(5)[3] == twice.radiance(5)[3]);
    CHECK(scaled.gradient(5)[11] == twice.gradient(5)[11]);

    const IrradianceVolume shifted = uniformVolume({1, 0, 0}, {4, 3, 3}, 3, true);
    CHECK(usageCode([&] { addVolumes({&a, &shifted}, {1, 1}); }) == kUsage);
    CHECK(usageCode([&] { addVolumes({&a, &b}, {1}); }) == kUsage);
    CHECK(usageCode([&] { addVolumes({&a, &b}, {1, std::nan("")}); }) == kUsage);
    CHECK(usageCode([&] { scaleVolume(scaled, std::nan("")); }) == kUsage);
}

TEST_CASE("comparison measures the relative error")
{
    const IrradianceVolume a = uniformVolume({0, 0, 0}, {6, 6, 6}, 3, false);
    CHECK(compareVolumes(a, a, 500, 3) == 0.0);
    // b = 1.1 a: rms(0.1 E) / mean(E) ≥ 0.1, with equality for constant E.
    IrradianceVolume flat = a.clone();
    for (std::size_t i = 0; i < a.sampleCount(); ++i) {
        for (int c = 0; c < 9; ++c)
            flat.radiance(static_cast<SampleId>(i))[c] = c == 0 ? Color(1, 2, 3) : Color(0.0f);
    }
    IrradianceVolume louder = flat.clone();
    scaleVolume(louder, 1.1);
    CHECK(compareVolumes(flat, louder, 500, 3) == Approx(0.1).epsilon(1e-5));
    const IrradianceVolume far = uniformVolume({60, 0, 0}, {66, 6, 6}, 3, false);
    CHECK(usageCode([&] { compareVolumes(a, far, 10, 1); }) == kUsage);
}
