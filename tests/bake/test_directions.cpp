// SPDX-License-Identifier: Apache-2.0
// The directions: uniform over the sphere, one in each stratum, neighbours in order.

#include "../../bake/src/directions.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/core/random.h>
#include <lumivdb/core/sh.h>

#include <catch2/catch.hpp>

#include <algorithm>
#include <cmath>
#include <set>

using namespace lumivdb;

namespace {

constexpr double kPi = 3.14159265358979323846;

std::pair<int, int> cellOf(const Vec2d& p, int side)
{
    return {static_cast<int>(p.x * side), static_cast<int>(p.y * side)};
}

} // namespace

TEST_CASE("Hilbert curve: every cell once, neighbour after neighbour", "[directions]")
{
    for (const int side : {2, 4, 32, 128}) {
        const int cells = side * side;
        std::set<std::pair<int, int>> seen;
        std::pair<int, int> previous;
        for (int i = 0; i < cells; ++i) {
            const auto cell = cellOf(hilbertPoint((i + 0.5) / cells), side);
            if (i > 0) {
                const int step = std::abs(cell.first - previous.first)
                    + std::abs(cell.second - previous.second);
                REQUIRE(step == 1);
            }
            previous = cell;
            seen.insert(cell);
        }
        REQUIRE(seen.size() == static_cast<std::size_t>(cells));
    }
    for (const double t : {0.0, 1e-300, 0.5, 1 - 1e-16, 0x1.fffffffffffffp-1}) {
        const Vec2d p = hilbertPoint(t);
        CAPTURE(t);
        CHECK((p.x >= 0 && p.x < 1 && p.y >= 0 && p.y < 1));
    }
}

TEST_CASE("square to sphere: unit vectors, equal areas, no seam", "[directions]")
{
    const double e = 1e-5;
    double worst = 0;
    for (int i = 0; i < 200; ++i)
        for (int j = 0; j < 200; ++j) {
            const Vec2d p((i + 0.37) / 200, (j + 0.61) / 200);
            const Vec3d d = squareToSphere(p);
            REQUIRE(d.length() == Approx(1).epsilon(1e-12));
            // |∂d/∂u × ∂d/∂v| is the area of the sphere for an area of the square: 4π.
            const Vec3d du = squareToSphere({p.x + e, p.y}) - squareToSphere({p.x - e, p.y});
            const Vec3d dv = squareToSphere({p.x, p.y + e}) - squareToSphere({p.x, p.y - e});
            // Creases of the octahedron aside.
            const double u = 2 * p.x - 1, v = 2 * p.y - 1;
            if (std::min({std::abs(u), std::abs(v), std::abs(1 - std::abs(u) - std::abs(v))})
                < 1e-3)
                continue;
            worst = std::max(worst, std::abs(du.cross(dv).length() / (4 * e * e) / (4 * kPi) - 1));
        }
    CHECK(worst < 1e-5);
    // Corners, edges and the centre, where the map's angle is undefined.
    for (int i = 0; i <= 2; ++i)
        for (int j = 0; j <= 2; ++j) {
            const Vec3d d = squareToSphere({i * 0.5, j * 0.5});
            CHECK(d.length() == Approx(1));
        }
    // The four edges fold: mirror points of an edge are one direction.
    for (int k = 0; k < 50; ++k) {
        const double t = (k + 0.5) / 100;
        CHECK((squareToSphere({0, 0.5 + t}) - squareToSphere({0, 0.5 - t})).length() < 1e-7);
        CHECK((squareToSphere({0.5 + t, 1}) - squareToSphere({0.5 - t, 1})).length() < 1e-7);
    }
}

TEST_CASE("one direction in each stratum, jittered inside it", "[directions]")
{
    constexpr int kCount = 1024; // 32² strata
    std::set<std::pair<int, int>> seen;
    double mean = 0, square = 0;
    for (std::uint64_t i = 0; i < kCount; ++i) {
        const double t = jitteredStratum(7, i, kCount),
                     inside = t * kCount - static_cast<double>(i);
        REQUIRE(inside >= 0);
        REQUIRE(inside < 1);
        mean += inside / kCount;
        square += inside * inside / kCount;
        seen.insert(cellOf(hilbertPoint(t), 32));
        REQUIRE(jitteredStratum(7, i, kCount) == t);
    }
    CHECK(seen.size() == kCount);
    // Uniform jitter: mean 1/2 with error 1/√(12·1024) = 0.009, mean square 1/3 with 0.0093.
    CHECK(std::abs(mean - 0.5) < 0.036);
    CHECK(std::abs(square - 1 / 3.0) < 0.037);
    CHECK(jitteredStratum(8, 5, kCount) != jitteredStratum(7, 5, kCount));
}

TEST_CASE("directions fill the sphere uniformly", "[directions]")
{
    for (const int count : {4096, 5000}) {
        for (const std::uint64_t seed : {1ull, 2ull, 12345678901234ull}) {
            const std::vector<Vec3f> directions = stratifiedDirections(seed, count);
            REQUIRE(directions.size() == static_cast<std::size_t>(count));
            double y[25], gram[25][25] = {};
            for (const Vec3f& d : directions) {
                REQUIRE(std::abs(d.length() - 1) < 1e-6f);
                evalShBasis(5, Vec3d(d), y);
                for (int i = 0; i < 25; ++i)
                    for (int j = 0; j <= i; ++j) gram[i][j] += 4 * kPi * y[i] * y[j] / count;
            }
            // Orthonormality of five bands = moments up to degree 8. Independent directions would
            // have errors of 1/√count = 0.016; strata of diameter 0.06 do far better.
            double worst = 0;
            for (int i = 0; i < 25; ++i)
                for (int j = 0; j <= i; ++j)
                    worst = std::max(worst, std::abs(gram[i][j] - (i == j)));
            CAPTURE(count, seed);
            CHECK(worst < 0.01);
        }
    }
}

TEST_CASE("chi-square over equal-area cells is that of strata", "[directions]")
{
    // 16 × 32 cells of equal area in (z, φ), 128 directions expected in each. Independent ones
    // would give χ² = 511 ± 32; strata are more even than chance, by far.
    const std::vector<Vec3f> directions = stratifiedDirections(3, 65536);
    int counts[16][32] = {};
    for (const Vec3f& d : directions) {
        const int i = std::min(15, static_cast<int>((d.z + 1) * 8));
        const double phi = std::atan2(d.y, d.x) / (2 * kPi) + 0.5;
        ++counts[i][std::min(31, static_cast<int>(phi * 32))];
    }
    double chi2 = 0;
    for (const auto& row : counts)
        for (const int n : row) chi2 += (n - 128.0) * (n - 128.0) / 128;
    CHECK(chi2 < 150);
    CHECK(chi2 > 0); // the cells' borders are not the strata's
}

TEST_CASE("consecutive directions are neighbours", "[directions]")
{
    // Points of adjacent strata are at most √5 of their sides apart in the square. A side is 1/32;
    // the map stretches lengths by at most about 2√π · √2 (area by 4π, anisotropy up to 2).
    const double bound = std::sqrt(5.0) / 32 * 2 * std::sqrt(kPi) * std::sqrt(2.0);
    for (const std::uint64_t seed : {1ull, 99ull}) {
        const std::vector<Vec3f> d = stratifiedDirections(seed, 1024);
        double worst = 0, mean = 0;
        for (std::size_t i = 1; i < d.size(); ++i) {
            const double angle = 2 * std::asin(0.5 * (Vec3d(d[i]) - Vec3d(d[i - 1])).length());
            worst = std::max(worst, angle);
            mean += angle / 1023;
        }
        CHECK(worst < bound);
        CHECK(mean < 0.14); // the stratum's own size is √(4π/1024) = 0.11
    }
}

TEST_CASE("few directions, other seeds", "[directions]")
{
    for (int count = 2; count < 20; ++count) {
        for (const Vec3f& d : stratifiedDirections(1, count))
            REQUIRE(std::abs(d.length() - 1) < 1e-6f);
    }
    const auto a = stratifiedDirections(1, 64), b = stratifiedDirections(1, 64),
               c = stratifiedDirections(2, 64);
    CHECK(a == b);
    CHECK(a != c);
}

TEST_CASE("nested sets of directions: together one in each finer stratum", "[directions]")
{
    for (const std::uint64_t count : {2, 5, 32}) {
        std::vector<double> all;
        for (int set = 0; set < 6; ++set) {
            const std::vector<double> added = nestedPositions(9, count, set);
            REQUIRE(added.size() == (set == 0 ? count : all.size()));
            REQUIRE(std::is_sorted(added.begin(), added.end()));
            all.insert(all.end(), added.begin(), added.end());
            std::set<std::uint64_t> strata;
            for (const double t : all) {
                REQUIRE((t >= 0 && t < 1));
                strata.insert(static_cast<std::uint64_t>(t * static_cast<double>(all.size())));
            }
            REQUIRE(strata.size() == all.size());
        }
    }
    // The first set is what stratifiedDirections() always was.
    const auto first = nestedPositions(3, 64, 0);
    for (std::uint64_t i = 0; i < 64; ++i) CHECK(first[i] == jitteredStratum(3, i, 64));
}

TEST_CASE("evaluation's normals: unit, mean zero, second moment a third", "[directions]")
{
    for (const int count : {1, 2, 32, 1000}) {
        const std::vector<Vec3f> normals = uniformNormals(count);
        REQUIRE(normals.size() == static_cast<std::size_t>(count));
        Vec3d mean(0.0), square(0.0);
        for (const Vec3f& n : normals) {
            CHECK(std::abs(n.length() - 1) < 1e-6f);
            mean += Vec3d(n) / count;
            square += Vec3d(n) * Vec3d(n) / count;
        }
        if (count < 32) continue;
        CHECK(mean.length() < 2.0 / count);
        for (int a = 0; a < 3; ++a) CHECK(square[a] == Approx(1 / 3.0).margin(1.0 / count));
    }
}
