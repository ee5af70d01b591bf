// SPDX-License-Identifier: Apache-2.0
//
// A cube map as spherical harmonics: moments of the texels (sh_cube_moments.cpp), then harmonics
// from moments.
#include <lumivdb/core/sh.h>

#include "sh_internal.h"
#include "sh_projection.h"

#include <algorithm>
#include <cmath>
#include <memory>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;

/// Gauss–Legendre on [−½, ½], repeated so often that monomials over a texel of @a width are
/// integrated to 1e-7: two points err by (8w)⁴/4320, three by (8w)⁶/2016000, relatively.
struct TexelRule {
    explicit TexelRule(double width)
    {
        const double a2 = std::sqrt(1.0 / 12.0), a3 = std::sqrt(0.15);
        if (width < 0.0163) {
            add(0.5 - a2, 0.5, 1);
            add(0.5 + a2, 0.5, 1);
        } else {
            const int pieces = static_cast<int>(std::ceil(width / 0.06));
            for (int i = 0; i < pieces; ++i) {
                add(i + 0.5 - a3, 5.0 / 18, pieces);
                add(i + 0.5, 8.0 / 18, pieces);
                add(i + 0.5 + a3, 5.0 / 18, pieces);
            }
        }
    }
    std::vector<double> x, w;

private:
    void add(double position, double weight, int pieces)
    {
        x.push_back(position / pieces - 0.5);
        w.push_back(weight / pieces);
    }
};

/// A homogeneous polynomial Σ c[i][j] xⁱ yʲ z^(degree−i−j).
struct Polynomial {
    int degree = 0;
    double c[kMaxBands][kMaxBands] = {};

    Polynomial times(double factor) const
    {
        Polynomial p = *this;
        for (auto& line : p.c)
            for (double& value : line) value *= factor;
        return p;
    }
    Polynomial plus(const Polynomial& q) const
    {
        Polynomial p = *this;
        for (int i = 0; i <= degree; ++i)
            for (int j = 0; i + j <= degree; ++j) p.c[i][j] += q.c[i][j];
        return p;
    }
    /// Times x^a y^b z^(degree − a − b) of this degree.
    Polynomial shifted(int by, int a, int b) const
    {
        Polynomial p;
        p.degree = degree + by;
        for (int i = 0; i <= degree; ++i)
            for (int j = 0; i + j <= degree; ++j) p.c[i + a][j + b] = c[i][j];
        return p;
    }
    Polynomial timesX() const { return shifted(1, 1, 0); }
    Polynomial timesY() const { return shifted(1, 0, 1); }
    Polynomial timesZ() const { return shifted(1, 0, 0); }
    /// Times x² + y² + z², which is 1 on the sphere.
    Polynomial raised() const
    {
        return shifted(2, 2, 0).plus(shifted(2, 0, 2)).plus(shifted(2, 0, 0));
    }
};

Vec3d integral(Polynomial p, int degree, const detail::CubeMoments& moments)
{
    while (p.degree < degree) p = p.raised();
    Vec3d sum(0);
    for (int i = 0; i <= degree; ++i)
        for (int j = 0; i + j <= degree; ++j)
            if (p.c[i][j] != 0) sum += Vec3d(moments[degree & 1][i][j]) * p.c[i][j];
    return sum;
}

/// sqrt((2l+1)/4π · (l−m)!/(l+m)!), times √2 for m > 0, with the sign of the basis.
double normalisation(int l, int m)
{
    double k = (2 * l + 1) / (4 * kPi) * (m > 0 ? 2 : 1);
    for (int i = l - m + 1; i <= l + m; ++i) k /= i;
    return m % 2 == 0 ? std::sqrt(k) : -std::sqrt(k);
}

/// Y_lm = (−1)^m k P_lm(z) {Re, Im} (x + iy)^m, where (l−m) P_l = (2l−1) z P_{l−1} − (l+m−1)
/// P_{l−2} and P_m = 1·3·…·(2m−1).
void harmonicsOf(int bands, const detail::CubeMoments& moments, Vec3d* out)
{
    Polynomial power[2]; // Re, Im of (x + iy)^m times P_mm
    power[0].c[0][0] = 1;
    for (int m = 0; m < bands; ++m) {
        for (int part = 0; part < (m == 0 ? 1 : 2); ++part) {
            Polynomial p = power[part], before;
            before.degree = p.degree - 1;
            for (int l = m; l < bands; ++l) {
                const int degree = detail::highestDegree(bands, l & 1);
                out[l * (l + 1) + (part == 0 ? m : -m)]
                    = integral(p, degree, moments) * normalisation(l, m);
                if (l + 1 == bands) break;
                Polynomial next = p.timesZ().times(2 * l + 1);
                if (l > m) next = next.plus(before.raised().times(-(l + m)));
                before = p;
                p = next.times(1.0 / (l + 1 - m));
            }
        }
        if (m + 1 == bands) break;
        const Polynomial re = power[0], im = power[1];
        power[0] = re.timesX().plus(im.timesY().times(-1)).times(2 * m + 1);
        power[1] = im.timesX().plus(re.timesY()).times(2 * m + 1);
        power[1].degree = power[0].degree;
    }
}

/// Sums over the faces.
void sumMoments(detail::CubeJob& job)
{
    using detail::CubeJob;
    const TexelRule rule(2.0 / job.size);
    job.node = rule.x.data();
    job.nodeWeight = rule.w.data();
    job.nodes = rule.x.size();
    job.half = (job.size + 1) / 2;
    job.padded = (static_cast<std::size_t>(job.half) + 7) / 8 * 8;
    job.flatLength = (3 * static_cast<std::size_t>(job.size) + 7) / 8 * 8;
    const std::size_t rows = CubeJob::kWeightRows + CubeJob::kFoldedRows;
    std::vector<double> buffer(rows * job.padded + 4 * job.flatLength + 8);
    void* start = buffer.data();
    std::size_t space = buffer.size() * sizeof(double);
    job.weight = static_cast<double*>(std::align(64, space - 64, start, space));
    job.folded = job.weight + CubeJob::kWeightRows * job.padded;
    job.flat = job.folded + CubeJob::kFoldedRows * job.padded;
    detail::sumCubeMoments(job);
}

} // namespace

void projectCubeMap(
    int bands, int size, const std::array<const Color*, 6>& faces, Vec3d* out, CubeTexels texels)
{
    detail::checkBands(bands);
    if (size < 1 || size > kMaxCubeMapSize)
        throw Error(ErrorCode::Usage,
            "a cube map has faces of 1 to " + std::to_string(kMaxCubeMapSize)
                + " texels a side, not " + std::to_string(size) + "; choose a size in that range");
    if (std::find(faces.begin(), faces.end(), nullptr) != faces.end())
        throw Error(ErrorCode::Usage, "a cube map needs the texels of all six faces; give them");
    detail::CubeJob job{};
    job.bands = bands;
    job.size = size;
    job.centres = texels == CubeTexels::Centres;
    for (int f = 0; f < 6; ++f) job.faces[f] = &faces[f]->x;
    sumMoments(job);
    harmonicsOf(bands, job.moments, out);
}

void projectCubeMap(
    int bands, int size, const std::array<const Color*, 6>& faces, Color* out, CubeTexels texels)
{
    Vec3d exact[kMaxCoefficients];
    projectCubeMap(bands, size, faces, exact, texels);
    std::copy_n(exact, coefficientCount(bands), out);
}

} // namespace lumivdb
