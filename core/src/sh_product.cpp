// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/sh.h>

#include "sh_internal.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;

/// One non-zero Gaunt integral ∫ Y_i Y_j Y_k dω with i ≤ j.
struct GauntEntry {
    int i;
    int j;
    int k;
    double value;
};

struct GauntTable {
    std::vector<GauntEntry> entries; // by the highest of the three degrees
    std::array<std::size_t, kMaxBands + 1> end{}; // entries of a product of b bands: [0, end[b])
};

struct SpherePoint {
    double weight;
    double y[kMaxCoefficients];
};

/// Gauss–Legendre in z times equal steps in φ. The integrand has degree ≤ 3·5 = 15: eight nodes
/// are exact to degree 15, sixteen steps to frequency 15, so this is the integral to rounding.
std::vector<SpherePoint> tripleProductRule()
{
    constexpr int kNodes = 8;
    constexpr int kSteps = 16;
    std::vector<SpherePoint> points(kNodes * kSteps);
    for (int a = 0; a < kNodes; ++a) {
        // Root a of the Legendre polynomial P_8 by Newton from Chebyshev-like starting points.
        double z = std::cos(kPi * (a + 0.75) / (kNodes + 0.5));
        double derivative = 0.0;
        for (int step = 0; step < 8; ++step) {
            double p = z;
            double previous = 1.0;
            for (int l = 2; l <= kNodes; ++l) {
                const double next = ((2 * l - 1) * z * p - (l - 1) * previous) / l;
                previous = p;
                p = next;
            }
            derivative = kNodes * (z * p - previous) / (z * z - 1.0);
            z -= p / derivative;
        }
        const double r = std::sqrt(1.0 - z * z);
        const double weight = 2.0 / (r * r * derivative * derivative) * (2.0 * kPi / kSteps);
        for (int b = 0; b < kSteps; ++b) {
            const double phi = 2.0 * kPi * b / kSteps;
            SpherePoint& point = points[a * kSteps + b];
            point.weight = weight;
            evalShBasis(kMaxBands, Vec3d(r * std::cos(phi), r * std::sin(phi), z), point.y);
        }
    }
    return points;
}

/// Integrals vanish by symmetry unless the degrees fulfil the triangle inequality with an even sum.
bool mayBeNonZero(int i, int j, int k)
{
    const int li = degreeOf(i);
    const int lj = degreeOf(j);
    const int lk = degreeOf(k);
    return std::abs(li - lj) <= lk && lk <= li + lj && (li + lj + lk) % 2 == 0;
}

GauntTable makeGauntTable()
{
    // The smallest non-zero integral of these bands is 0.0096, rounding is about 1e-16.
    constexpr double kZero = 1e-9;
    const std::vector<SpherePoint> points = tripleProductRule();
    GauntTable table;
    for (int bands = 1; bands <= kMaxBands; ++bands) {
        const int inner = coefficientCount(bands - 1);
        for (int i = 0; i < coefficientCount(bands); ++i)
            for (int j = i; j < coefficientCount(bands); ++j)
                for (int k = 0; k < coefficientCount(bands); ++k) {
                    if (std::max(j, k) < inner || !mayBeNonZero(i, j, k)) continue;
                    double sum = 0.0;
                    for (const SpherePoint& p : points) sum += p.weight * p.y[i] * p.y[j] * p.y[k];
                    if (std::abs(sum) > kZero) table.entries.push_back({i, j, k, sum});
                }
        table.end[bands] = table.entries.size();
    }
    return table;
}

const GauntTable& gauntTable()
{
    static const GauntTable table = makeGauntTable();
    return table;
}

} // namespace

void productSh(int bands, const double* a, const double* b, double* out)
{
    detail::checkBands(bands);
    const GauntTable& table = gauntTable();
    std::fill_n(out, coefficientCount(bands), 0.0);
    for (std::size_t e = 0; e < table.end[bands]; ++e) {
        const GauntEntry& g = table.entries[e];
        const double pair = g.i == g.j ? a[g.i] * b[g.i] : a[g.i] * b[g.j] + a[g.j] * b[g.i];
        out[g.k] += g.value * pair;
    }
}

} // namespace lumivdb
