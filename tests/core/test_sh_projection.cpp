// SPDX-License-Identifier: Apache-2.0
#include "sh_test_util.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/sh.h>

#include <catch2/catch.hpp>
#include <hwy/highway.h>

#include <array>
#include <cstring>
#include <limits>

using namespace lumivdb;
using namespace sh_test;

namespace {

/// Where texel centres of a cube map look, as OpenGL, Vulkan and Direct3D define it: written out
/// from the table of their specifications, (s, t) to the right and downwards in [−1, 1].
Vec3d lookup(int face, double s, double t)
{
    const Vec3d table[6] = {Vec3d(1, -t, -s), Vec3d(-1, -t, s), Vec3d(s, 1, t), Vec3d(s, -1, -t),
        Vec3d(s, -t, 1), Vec3d(-s, -t, -1)};
    return table[face];
}

struct CubeMap {
    explicit CubeMap(int n)
        : size(n)
        , texels(6 * static_cast<std::size_t>(n) * n, Color(0.0f))
    {
    }
    Color& at(int face, int x, int y)
    {
        return texels[(static_cast<std::size_t>(face) * size + y) * size + x];
    }
    std::array<const Color*, 6> faces() const
    {
        std::array<const Color*, 6> result;
        for (std::size_t f = 0; f < 6; ++f) result[f] = texels.data() + f * texels.size() / 6;
        return result;
    }
    int size;
    std::vector<Color> texels;
};

CubeMap noise(int size, std::uint64_t seed)
{
    CubeMap map(size);
    CounterRng rng(seed);
    for (Color& c : map.texels)
        c = Color(std::exp(6 * rng.next() - 3), rng.next() - 0.5f, rng.next());
    return map;
}

/// ∫ over the solid angle below the corner (a, b) of a face, from its centre: the antiderivative
/// of (1 + a² + b²)^(−3/2) in both.
long double solidAngleBelow(long double a, long double b)
{
    return std::atan2(a * b, std::sqrt(1 + a * a + b * b));
}

/// Σ L Y(centre) ΔΩ in extended precision.
std::vector<Vec3d> sumAtCentres(int bands, CubeMap& map)
{
    const int n = map.size;
    std::vector<std::array<long double, 3>> sums(coefficientCount(bands), {0, 0, 0});
    double basis[kMaxCoefficients];
    for (int f = 0; f < 6; ++f)
        for (int y = 0; y < n; ++y)
            for (int x = 0; x < n; ++x) {
                const long double a = 2.0L * x / n - 1, b = 2.0L * y / n - 1, w = 2.0L / n;
                const long double solidAngle = solidAngleBelow(a + w, b + w)
                    - solidAngleBelow(a, b + w) - solidAngleBelow(a + w, b) + solidAngleBelow(a, b);
                const Vec3d d
                    = lookup(f, static_cast<double>(a + w / 2), static_cast<double>(b + w / 2));
                evalShBasis(bands, d.normalized(), basis);
                for (std::size_t i = 0; i < sums.size(); ++i)
                    for (int c = 0; c < 3; ++c)
                        sums[i][c] += map.at(f, x, y)[c] * solidAngle * basis[i];
            }
    std::vector<Vec3d> result;
    for (const auto& s : sums)
        result.emplace_back(
            static_cast<double>(s[0]), static_cast<double>(s[1]), static_cast<double>(s[2]));
    return result;
}

/// The integral of the piecewise constant map: five Gauss nodes a side of every piece of a texel,
/// no piece wider than 1/8.
std::vector<Vec3d> integralOverAreas(int bands, CubeMap& map)
{
    const double node[5] = {-0.906179845938663993, -0.538469310105683091, 0, 0.538469310105683091,
        0.906179845938663993};
    const double weight[5] = {0.236926885056189088, 0.478628670499366468, 0.568888888888888889,
        0.478628670499366468, 0.236926885056189088};
    const int pieces = std::max(1, 16 / map.size), n = map.size * pieces;
    std::vector<Vec3d> sums(coefficientCount(bands), Vec3d(0));
    double basis[kMaxCoefficients];
    for (int f = 0; f < 6; ++f)
        for (int y = 0; y < n; ++y)
            for (int x = 0; x < n; ++x)
                for (int q = 0; q < 5; ++q)
                    for (int p = 0; p < 5; ++p) {
                        const Vec3d d = lookup(
                            f, (2 * x + 1 + node[p]) / n - 1, (2 * y + 1 + node[q]) / n - 1);
                        evalShBasis(bands, d.normalized(), basis);
                        const double area
                            = weight[p] * weight[q] / (n * n) / std::pow(d.length(), 3);
                        const Vec3d L(map.at(f, x / pieces, y / pieces));
                        for (std::size_t i = 0; i < sums.size(); ++i)
                            sums[i] += L * (area * basis[i]);
                    }
    return sums;
}

/// Largest error of a coefficient over the norm of all, per channel.
double errorOf(const Vec3d* c, const std::vector<Vec3d>& expected)
{
    double worst = 0;
    for (int channel = 0; channel < 3; ++channel) {
        double norm = 0, largest = 0;
        for (std::size_t i = 0; i < expected.size(); ++i) {
            norm += expected[i][channel] * expected[i][channel];
            largest = std::max(largest, std::abs(c[i][channel] - expected[i][channel]));
        }
        worst = std::max(worst, largest / std::sqrt(norm));
    }
    return worst;
}

} // namespace

TEST_CASE("a cube map's texels count as areas", "[sh][projection]")
{
    for (int size : {1, 2, 3, 5, 8, 16, 33}) {
        CubeMap map = noise(size, 40 + size);
        const std::vector<Vec3d> expected = integralOverAreas(6, map);
        for (int bands = 1; bands <= kMaxBands; ++bands) {
            Vec3d c[kMaxCoefficients];
            projectCubeMap(bands, size, map.faces(), c);
            const std::vector<Vec3d> part(
                expected.begin(), expected.begin() + coefficientCount(bands));
            INFO("size " << size << ", bands " << bands);
            REQUIRE(errorOf(c, part) < 2e-8);
        }
    }
}

TEST_CASE("a cube map summed at its texels' centres", "[sh][projection]")
{
    for (int size : {1, 2, 7, 16, 128}) {
        CubeMap map = noise(size, 50 + size);
        const std::vector<Vec3d> expected = sumAtCentres(6, map);
        for (int bands = 1; bands <= kMaxBands; ++bands) {
            Vec3d c[kMaxCoefficients];
            projectCubeMap(bands, size, map.faces(), c, CubeTexels::Centres);
            const std::vector<Vec3d> part(
                expected.begin(), expected.begin() + coefficientCount(bands));
            INFO("size " << size << ", bands " << bands);
            REQUIRE(errorOf(c, part) < 1e-8);
        }
    }
}

TEST_CASE("a constant cube map has one coefficient", "[sh][projection]")
{
    // ∫ L Y_0 = L √(4π); all others vanish over the whole sphere.
    CubeMap map(128);
    std::fill(map.texels.begin(), map.texels.end(), Color(1, 2, 3));
    Vec3d c[kMaxCoefficients];
    projectCubeMap(6, 128, map.faces(), c);
    REQUIRE(c[0].y == Approx(2 * std::sqrt(4 * kPi)).epsilon(1e-9));
    for (int i = 1; i < kMaxCoefficients; ++i) REQUIRE(std::abs(c[i].z) < 1e-8);
}

TEST_CASE("one bright texel lights the side that it lies on", "[sh][projection]")
{
    // A texel of a fine map is nearly a distant light: L_lm = L ΔΩ Y_lm(d).
    const int size = 64;
    for (int face = 0; face < 6; ++face) {
        CubeMap map(size);
        map.at(face, 50, 10) = Color(1000.0f);
        const Vec3d d = lookup(face, 101.0 / 64 - 1, 21.0 / 64 - 1).normalized();
        double basis[kMaxCoefficients];
        evalShBasis(6, d, basis);
        Vec3d c[kMaxCoefficients];
        projectCubeMap(6, size, map.faces(), c);
        const double power = c[0].x / basis[0];
        REQUIRE(power
            == Approx(
                1000 * 4.0 / (64 * 64) / std::pow(1 / d[face / 2], 3) * (d[face / 2] < 0 ? -1 : 1))
                   .epsilon(2e-3));
        for (int i = 0; i < kMaxCoefficients; ++i)
            REQUIRE(std::abs(c[i].x - power * basis[i]) < 2e-3 * power);
    }
}

TEST_CASE("every instruction set projects a cube map to the same bits", "[sh][projection]")
{
    for (int size : {1, 5, 16, 31}) {
        CubeMap map = noise(size, 60 + size);
        for (const CubeTexels texels : {CubeTexels::Areas, CubeTexels::Centres}) {
            Vec3d best[kMaxCoefficients], other[kMaxCoefficients];
            projectCubeMap(6, size, map.faces(), best, texels);
            int tried = 0;
            for (std::int64_t left = hwy::SupportedTargets(); left != 0;
                 left &= left - 1, ++tried) {
                hwy::SetSupportedTargetsForTest(left); // the best ones go first
                hwy::GetChosenTarget().Update(hwy::SupportedTargets());
                projectCubeMap(6, size, map.faces(), other, texels);
                REQUIRE(std::memcmp(best, other, sizeof(best)) == 0);
            }
            hwy::SetSupportedTargetsForTest(0);
            hwy::GetChosenTarget().DeInit();
            REQUIRE(tried > 0);
        }
    }
}

TEST_CASE("single precision coefficients are the rounded ones", "[sh][projection]")
{
    CubeMap map = noise(9, 70);
    Vec3d exact[kMaxCoefficients];
    Color rounded[kMaxCoefficients];
    projectCubeMap(5, 9, map.faces(), exact);
    projectCubeMap(5, 9, map.faces(), rounded);
    for (int i = 0; i < 25; ++i) REQUIRE(rounded[i] == Color(exact[i]));
}

TEST_CASE("dark texels beside a sun keep their light", "[sh][projection]")
{
    // Range 1e8: the sum without the sun comes back when the sun is taken away again.
    CubeMap map = noise(32, 71);
    Vec3d without[kMaxCoefficients], with[kMaxCoefficients], sun[kMaxCoefficients];
    map.at(2, 7, 9) = Color(0.0f);
    projectCubeMap(6, 32, map.faces(), without);
    map.at(2, 7, 9) = Color(1e8f);
    projectCubeMap(6, 32, map.faces(), with);
    std::fill(map.texels.begin(), map.texels.end(), Color(0.0f));
    map.at(2, 7, 9) = Color(1e8f);
    projectCubeMap(6, 32, map.faces(), sun);
    for (int i = 0; i < kMaxCoefficients; ++i)
        REQUIRE((with[i] - sun[i] - without[i]).length() < 1e-7 * without[0].length());
}

TEST_CASE("cube maps that are none are refused", "[sh][projection]")
{
    CubeMap map(4);
    Vec3d c[kMaxCoefficients];
    auto faces = map.faces();
    REQUIRE_THROWS_AS(projectCubeMap(0, 4, faces, c), Error);
    REQUIRE_THROWS_AS(projectCubeMap(7, 4, faces, c), Error);
    REQUIRE_THROWS_AS(projectCubeMap(3, 0, faces, c), Error);
    REQUIRE_THROWS_AS(projectCubeMap(3, kMaxCubeMapSize + 1, faces, c), Error);
    faces[3] = nullptr;
    REQUIRE_THROWS_AS(projectCubeMap(3, 4, faces, c), Error);
}
