// SPDX-License-Identifier: Apache-2.0
// Analytic gradients against converged central differences, and what must hold of them whatever
// the scene: the same bits for any number of threads, covariance under rotation, limits.

#include "../../bake/src/directions.h"
#include "../../bake/src/strata_cells.h"
#include "gradient_fixture.h"

#include <catch2/catch.hpp>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <limits>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

/// Norm of the difference of two mean gradients, and what chance alone would make of it.
struct Difference {
    double norm = 0, chance = 0;
};

Difference difference(const MeanGradient& a, const MeanGradient& b)
{
    Difference d;
    for (std::size_t i = 0; i < a.mean.size(); ++i) {
        d.norm += std::pow(a.mean[i] - b.mean[i], 2);
        d.chance += a.error[i] * a.error[i] + b.error[i] * b.error[i];
    }
    return {std::sqrt(d.norm), std::sqrt(d.chance)};
}

/// The mean of eight seeds agrees with central differences but for chance (twice its expected
/// norm) and a bias of @a bias of the gradient, and chance is small enough to mean something.
void checkAgainstCentral(
    const Tracer& tracer, const ProbeOptions& options, const Vec3d& p, double delta, double bias)
{
    const MeanGradient analytic = analyticGradient(tracer, options, p, 3, 8);
    ProbeOptions many = options;
    many.rays = 1 << 15;
    const MeanGradient central = centralMean(tracer, many, p, 3, delta, 4);
    const Difference d = difference(analytic, central);
    CAPTURE(p, d.norm, d.chance, central.norm());
    CHECK(d.norm <= 2 * d.chance + bias * central.norm());
    CHECK(d.chance <= 0.35 * central.norm());
}

ProbeResult probe(const Tracer& tracer, int rays, const Vec3d& p, int bands)
{
    const ProbeEstimator estimator(tracer, withRays(rays));
    ProbeEstimator::Workspace workspace;
    return estimator.radianceSh(p, bands, 7, workspace, true);
}

bool sameBits(const std::vector<Color>& a, const std::vector<Color>& b)
{
    return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(Color)) == 0;
}

} // namespace

TEST_CASE("gradients in a lit room agree with central differences", "[gradient][heavy]")
{
    const auto tracer = makeTracer(litRoom());
    for (const Vec3d& p : {Vec3d(0.7, 0.6, 0.75), Vec3d(0.3, 1.1, 1.2), Vec3d(0.05, 0.5, 0.6),
             Vec3d(0.9, 1.45, 0.8)}) {
        const double nearest = std::min({p.x, p.y, p.z, 1.6 - p.x, 1.6 - p.y, 1.6 - p.z, 0.05});
        checkAgainstCentral(*tracer, withRays(4096), p, nearest / 4, 0.06);
    }
}

TEST_CASE("gradients of direct and of indirect light add up", "[gradient][heavy]")
{
    const auto tracer = makeTracer(litRoom());
    const Vec3d p(0.4, 0.5, 0.9);
    ProbeOptions options = withRays(2048);
    std::vector<Color> gradient[3];
    for (const Contribution c : {Contribution::All, Contribution::Direct, Contribution::Indirect}) {
        options.contribution = c;
        const ProbeEstimator estimator(*tracer, options);
        ProbeEstimator::Workspace workspace;
        gradient[static_cast<int>(c)] = estimator.radianceSh(p, 3, 7, workspace, true).gradient;
    }
    double scale = 0;
    for (const Color& c : gradient[0]) scale = std::max(scale, std::abs(static_cast<double>(c.x)));
    // The paths' random numbers are the same, so the sum is exact but for rounding.
    for (std::size_t i = 0; i < gradient[0].size(); ++i) {
        CAPTURE(i);
        CHECK(static_cast<double>(gradient[1][i].x + gradient[2][i].x)
            == Approx(static_cast<double>(gradient[0][i].x)).margin(1e-4 * scale));
    }
    checkAgainstCentral(*tracer, options, p, 0.06, 0.06);
}

TEST_CASE("gradients of the Cornell box agree with central differences", "[gradient][heavy]")
{
    const std::string path = std::string(LUMIVDB_SAMPLES) + "/cornell_box.glb";
    auto scene = std::make_shared<Scene>(loadScene(path));
    const Tracer tracer(scene);
    const Box3d box = scene->bounds();
    const auto at
        = [&](double x, double y, double z) { return box.min + Vec3d(x, y, z) * box.size(); };
    const double size = box.size().y;
    checkAgainstCentral(tracer, withRays(4096), at(0.5, 0.75, 0.5), 0.01 * size, 0.06);
    checkAgainstCentral(tracer, withRays(4096), at(0.04, 0.3, 0.8), 0.01 * size, 0.06);
}

TEST_CASE("gradients turn with the scene", "[gradient]")
{
    // A quarter turn about z, (x, y) → (−y, x), of a lit quad beside a black one.
    const auto build = [](bool turned) {
        const auto place = [&](const Vec3d& v) { return turned ? Vec3d(-v.y, v.x, v.z) : v; };
        Scene scene;
        const int lamp = addMaterial(scene, Color(0.3f), Color(2.0f), true);
        const int grey = addMaterial(scene, Color(0.6f), Color(0.0f), true);
        addQuad(scene, lamp, place({1, -0.5, -0.5}), place({0, 1, 0}), place({0, 0, 1}));
        addQuad(scene, grey, place({-1, 0.6, -1}), place({1.5, 0, 0}), place({0, 0, 2}));
        return scene;
    };
    const auto straight = makeTracer(build(false)), turned = makeTracer(build(true));
    const int bands = 3, n = coefficientCount(bands);
    const MeanGradient a = analyticGradient(*straight, withRays(2048), {0.1, 0.2, 0.3}, bands, 16);
    const MeanGradient b = analyticGradient(*turned, withRays(2048), {-0.2, 0.1, 0.3}, bands, 16);
    // Row vectors: x' = x R. World x becomes y, y becomes −x.
    const Mat3d R(0, 1, 0, -1, 0, 0, 0, 0, 1);
    const ShRotation rotation(bands, R);
    const int axisOf[3] = {1, 0, 2};
    const double sign[3] = {1, -1, 1};
    double largest = 0;
    for (const double v : a.mean) largest = std::max(largest, std::abs(v));
    for (int axis = 0; axis < 3; ++axis) {
        std::vector<double> expected(static_cast<std::size_t>(n));
        rotation.apply(a.mean.data() + axis * n, expected.data());
        for (int k = 0; k < n; ++k) {
            const double value = sign[axis] * b.at(axisOf[axis], k);
            CAPTURE(axis, k, largest);
            CHECK(std::abs(value - expected[static_cast<std::size_t>(k)])
                <= 6 * b.errorAt(axisOf[axis], k) + 0.02 * largest);
        }
    }
}

TEST_CASE("gradients have the same bits for any number of threads", "[gradient]")
{
    const auto tracer = makeTracer(litRoom());
    // Several chunks of 4096 strata, the last one partial; a workspace that is used again.
    const int rays = 3 * 4096 + 777;
    std::vector<Color> one, many;
    {
        const tbb::global_control threads(tbb::global_control::max_allowed_parallelism, 1);
        one = probe(*tracer, rays, {0.5, 0.6, 0.7}, 4).gradient;
    }
    const tbb::global_control threads(tbb::global_control::max_allowed_parallelism, 4);
    const ProbeEstimator estimator(*tracer, withRays(rays));
    ProbeEstimator::Workspace workspace;
    estimator.radianceSh({0.1, 0.2, 0.3}, 2, 5, workspace, true);
    many = estimator.radianceSh({0.5, 0.6, 0.7}, 4, 7, workspace, true).gradient;
    CHECK(sameBits(one, many));
    CHECK(one.size() == 48);
}

TEST_CASE("gradients of points in parallel are those of points one by one", "[gradient]")
{
    // Threads that wait for a point's chunks take up other points, with the same workspace.
    const auto tracer = makeTracer(litRoom());
    const ProbeEstimator estimator(*tracer, withRays(2 * 4096));
    const auto place = [](std::size_t i) { return Vec3d(0.1 + 0.05 * static_cast<double>(i)); };
    std::vector<std::vector<Color>> parallel(24);
    const tbb::global_control threads(tbb::global_control::max_allowed_parallelism, 4);
    tbb::enumerable_thread_specific<ProbeEstimator::Workspace> workspaces;
    tbb::parallel_for(std::size_t(0), parallel.size(), [&](std::size_t i) {
        parallel[i] = estimator.radianceSh(place(i), 3, i, workspaces.local(), true).gradient;
    });
    ProbeEstimator::Workspace workspace;
    for (std::size_t i = 0; i < parallel.size(); ++i) {
        CAPTURE(i);
        CHECK(
            sameBits(parallel[i], estimator.radianceSh(place(i), 3, i, workspace, true).gradient));
    }
}

TEST_CASE("asking for gradients does not change the values", "[gradient]")
{
    const auto tracer = makeTracer(litRoom());
    const ProbeEstimator estimator(*tracer, withRays(1000));
    ProbeEstimator::Workspace workspace;
    const ProbeResult with = estimator.radianceSh({0.5, 0.6, 0.7}, 3, 7, workspace, true);
    const ProbeResult without = estimator.radianceSh({0.5, 0.6, 0.7}, 3, 7, workspace, false);
    CHECK(sameBits(with.value, without.value));
    CHECK(sameBits(with.stderr_, without.stderr_));
    CHECK(with.rays == without.rays);
    CHECK(without.gradient.empty());
}

TEST_CASE("gradients are finite for few rays and on surfaces", "[gradient]")
{
    const auto tracer = makeTracer(litRoom(Vec3d(0.0), 1.6, true));
    for (const int rays : {2, 3, 4, 7, 64, 1025}) {
        for (const Vec3d& p : {Vec3d(0.5, 0.6, 0.7), Vec3d(0.0, 0.6, 0.7), Vec3d(0.0),
                 Vec3d(0.8, 0.95 * 1.6, 0.8), Vec3d(1e-20, 0.6, 0.7), Vec3d(50, 60, 70)}) {
            for (const Color& c : probe(*tracer, rays, p, 6).gradient) {
                CHECK(std::isfinite(c.x + c.y + c.z));
            }
        }
    }
}

TEST_CASE("cells of strata tile the sphere and close", "[gradient]")
{
    for (const std::size_t strata : {2, 3, 5, 100, 1024, 1500, 5000}) {
        CAPTURE(strata);
        const StrataCells cells(strata);
        REQUIRE(cells.count() == strata);
        double area = 0;
        for (std::size_t i = 0; i < strata; ++i) {
            CHECK(cells.solidAngle(i) > 0);
            area += static_cast<double>(cells.solidAngle(i));
        }
        CHECK(area == Approx(4 * kPi).epsilon(1e-5));
        // Around a cell, ∮ n dl = −2 ∫ ω dω (divergence of a constant vector's tangential part). A
        // border that is missing or faces the wrong way spoils it.
        std::vector<Vec3d> outward(strata, Vec3d(0.0)), inside(strata, Vec3d(0.0));
        const StrataCells::Borders& b = cells.borders();
        for (std::size_t s = 0; s < b.size(); ++s) {
            const Vec3d n(b.nx[s], b.ny[s], b.nz[s]);
            outward[b.a[s]] += n;
            outward[b.b[s]] -= n;
        }
        const int many = 400000;
        for (int i = 0; i < many; ++i) { // spherical Fibonacci points
            const double z = 1 - (2 * i + 1.0) / many, phi = 2.39996322972865332 * i;
            const double r = std::sqrt(1 - z * z);
            const Vec3d d(r * std::cos(phi), r * std::sin(phi), z);
            inside[cells.cellAt(Vec3f(d))] -= d * (8 * kPi / many);
        }
        double worst = 0;
        for (std::size_t i = 0; i < strata; ++i) {
            worst = std::max(worst, (outward[i] - inside[i]).length());
        }
        CHECK(worst < 0.01);
    }
}

TEST_CASE("strata beyond the largest grid share cells", "[gradient]")
{
    const StrataCells cells(StrataCells::kMaxCells + 5);
    CHECK(cells.count() == StrataCells::kMaxCells / 2 + 3);
    CHECK(cells.cellOf(0) == cells.cellOf(1));
    CHECK(cells.startsCell(2));
    CHECK_FALSE(cells.startsCell(3));
    CHECK(cells.strataInCellOf(3) == 2);
    CHECK(cells.strataInCellOf(StrataCells::kMaxCells + 4) == 1);
}

TEST_CASE("central differences stay in front of the nearest surface", "[gradient]")
{
    // Under a constant sky beside a wall, steps through the wall would see the other side. Half the
    // distance, 0.01, keeps them here: the derivative is that of the near field.
    const Vec3d a(-50, 0, -50), u(0, 0, 100), v(100, 0, 0);
    Scene scene;
    addQuad(scene, addMaterial(scene, Color(0.0f), Color(3.0f), true), a, u, v);
    const auto tracer = makeTracer(scene);
    const ProbeEstimator estimator(*tracer, withRays(4096));
    ProbeEstimator::Workspace workspace;
    ProbeResult r;
    const auto traced = centralGradient(*tracer, estimator, {0, 0.02, 0}, 2, 8.0, 1, workspace, r);
    REQUIRE(r.gradient.size() == 12);
    CHECK(traced >= 6 * 4096);
    // Half of the sphere is lit from either side, and sh_1 ∝ −y would change its sign across.
    CHECK(std::abs(r.gradient[4 + 1].x) < 0.1f);
}

TEST_CASE("gradients are limited to where they hold", "[gradient]")
{
    ProbeResult r;
    r.gradient = {Color(1, 2, 3), Color(-4, 5, 6), Color(0.5f)};
    const auto limited = [&](float distance, double reach) {
        ProbeResult copy = r;
        copy.distance = distance;
        limitGradient(reach, copy);
        return copy.gradient;
    };
    CHECK(limited(1.0f, 0.7) == r.gradient);
    CHECK(limited(std::numeric_limits<float>::infinity(), 1e9) == r.gradient);
    // 0.7 · 0.5 / 0.7: half of it remains, in the same direction.
    const auto half = limited(0.5f, 0.7);
    for (std::size_t i = 0; i < half.size(); ++i) {
        for (int c = 0; c < 3; ++c) CHECK(half[i][c] == Approx(0.5f * r.gradient[i][c]));
    }
    r.gradient[1].y = std::numeric_limits<float>::quiet_NaN();
    CHECK(limited(1.0f, 0.1)[1] == Color(0.0f));
    CHECK(limited(0.0f, 0.1)[2] == Color(0.0f));
}

TEST_CASE("the map of strata has an inverse", "[gradient]")
{
    for (int i = 0; i < 40; ++i) {
        for (int j = 0; j < 40; ++j) {
            const Vec2d p((i + 0.3) / 40, (j + 0.7) / 40);
            const Vec2f back = sphereToSquare(Vec3f(squareToSphere(p)));
            CHECK((Vec2d(back) - p).length() < 5e-5);
        }
    }
}
