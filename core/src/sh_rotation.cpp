// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/sh.h>

#include "sh_internal.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace lumivdb {

namespace {

/// Offset of the block of degree l in the blocks put end to end: Σ_{k<l} (2k+1)².
constexpr int blockOffset(int l) { return l * (4 * l * l - 1) / 3; }

int entryIndex(int l, int m, int n) { return blockOffset(l) + (m + l) * (2 * l + 1) + n + l; }

/// The rotation nearest to R, which is one to within 1e-6. Each Newton–Schulz step
/// R ← R (3I − RᵀR)/2 squares the distance, so two reach rounding: matrices that a host keeps in
/// single precision do not scale the light when they are applied again and again.
Mat3d nearestRotation(const Mat3d& R)
{
    double deviation = 0.0;
    const Mat3d gram = R.transposed() * R;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            deviation = std::max(deviation, std::abs(gram[i][j] - (i == j ? 1.0 : 0.0)));
    // A NaN anywhere makes the determinant NaN, which is not greater than 0.
    if (deviation > 1e-6 || !(R.determinant() > 0.0))
        throw Error(ErrorCode::Usage,
            "the 3x3 matrix given for rotating spherical harmonics is not a rotation (R^T R "
            "differs from the identity by more than 1e-6, or it mirrors); remove scale, shear and "
            "reflection first");
    Mat3d q = R;
    for (int step = 0; step < 2; ++step) q = q * ((Mat3d() * 3.0 - q.transposed() * q) * 0.5);
    return q;
}

/// The recurrence of Ivanic & Ruedenberg (1996), Tables 1 and 2 with the errata of 1998, in their
/// basis, which has no Condon–Shortley sign. Blocks R^0 … R^{l−1} are in place when row m of
/// degree l is asked for.
class Recurrence {
public:
    explicit Recurrence(double* blocks)
        : mBlocks(blocks)
    {
    }

    double entry(int l, int m, int n) const
    {
        // u, v, w of their Table 1. The numerators vanish where U, V, W would leave the block.
        const int am = std::abs(m);
        const double d = std::abs(n) < l ? (l + n) * (l - n) : 2 * l * (2 * l - 1);
        double sum = 0.0;
        if (am < l) sum += std::sqrt((l + m) * (l - m) / d) * p(0, l, m, n);
        if (m == 0)
            sum -= 0.5 * std::sqrt(2 * (l - 1) * l / d) * v(l, m, n);
        else
            sum += 0.5 * std::sqrt((l + am - 1) * (l + am) / d) * v(l, m, n);
        if (m != 0 && am < l - 1) sum -= 0.5 * std::sqrt((l - am - 1) * (l - am) / d) * w(l, m, n);
        return sum;
    }

private:
    double at(int l, int m, int n) const { return mBlocks[entryIndex(l, m, n)]; }

    double p(int i, int l, int mu, int n) const
    {
        if (n == l) return at(1, i, 1) * at(l - 1, mu, l - 1) - at(1, i, -1) * at(l - 1, mu, 1 - l);
        if (n == -l)
            return at(1, i, 1) * at(l - 1, mu, 1 - l) + at(1, i, -1) * at(l - 1, mu, l - 1);
        return at(1, i, 0) * at(l - 1, mu, n);
    }

    double v(int l, int m, int n) const
    {
        const double root2 = std::sqrt(2.0);
        if (m == 0) return p(1, l, 1, n) + p(-1, l, -1, n);
        if (m == 1) return root2 * p(1, l, 0, n);
        if (m == -1) return root2 * p(-1, l, 0, n);
        if (m > 0) return p(1, l, m - 1, n) - p(-1, l, 1 - m, n);
        return p(1, l, m + 1, n) + p(-1, l, -m - 1, n);
    }

    double w(int l, int m, int n) const
    {
        if (m > 0) return p(1, l, m + 1, n) + p(-1, l, -m - 1, n);
        return p(1, l, m - 1, n) - p(-1, l, 1 - m, n);
    }

    double* mBlocks;
};

template <class Sum, class T>
void applyBlocks(int bands, const std::vector<double>& blocks, const T* in, T* out)
{
    T result[kMaxCoefficients];
    const double* row = blocks.data();
    for (int l = 0; l < bands; ++l)
        for (int m = -l; m <= l; ++m, row += 2 * l + 1) {
            Sum sum(0.0);
            for (int n = 0; n < 2 * l + 1; ++n) sum += row[n] * Sum(in[l * l + n]);
            result[l * (l + 1) + m] = T(sum);
        }
    std::copy_n(result, coefficientCount(bands), out);
}

} // namespace

ShRotation::ShRotation(int bands, const Mat3d& R)
    : mBands(bands)
{
    detail::checkBands(bands);
    const Mat3d q = nearestRotation(R);
    mBlocks.resize(blockOffset(bands));
    mBlocks[0] = 1.0;
    if (bands == 1) return;

    // f'(d) = f(d Rᵀ), so c'_m = Σ_n c_n ∫ Y_n(e) Y_m(e R) de: the matrix entry (m, n) is the
    // coefficient of Y_n in Y_m(e R). Degree 1 without signs is Y_m(e) ∝ e[axis(m)], axes y, z, x.
    constexpr int axis[3] = {1, 2, 0};
    for (int m = -1; m <= 1; ++m)
        for (int n = -1; n <= 1; ++n) mBlocks[entryIndex(1, m, n)] = q[axis[n + 1]][axis[m + 1]];
    const Recurrence recurrence(mBlocks.data());
    for (int l = 2; l < bands; ++l)
        for (int m = -l; m <= l; ++m)
            for (int n = -l; n <= l; ++n) mBlocks[entryIndex(l, m, n)] = recurrence.entry(l, m, n);

    // Our Y_lm is (−1)^m times theirs: conjugate with these signs.
    for (int l = 1; l < bands; ++l)
        for (int m = -l; m <= l; ++m)
            for (int n = -l; n <= l; ++n)
                if ((m + n) % 2 != 0) mBlocks[entryIndex(l, m, n)] *= -1.0;
}

void ShRotation::apply(const double* in, double* out) const
{
    applyBlocks<double>(mBands, mBlocks, in, out);
}

void ShRotation::apply(const Color* in, Color* out) const
{
    // Sums in double: one rounding per application, which is what limits the drift.
    applyBlocks<Vec3d>(mBands, mBlocks, in, out);
}

double ShRotation::entry(int l, int m, int n) const
{
    if (l < 0 || l >= mBands || std::abs(m) > l || std::abs(n) > l)
        throw Error(ErrorCode::Usage,
            "a rotation of " + std::to_string(mBands) + " bands has no entry (" + std::to_string(m)
                + ", " + std::to_string(n) + ") of degree " + std::to_string(l)
                + "; ask for |m|, |n| <= degree < bands");
    return mBlocks[entryIndex(l, m, n)];
}

} // namespace lumivdb
