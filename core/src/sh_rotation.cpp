// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/sh.h>

#include "sh_internal.h"
#include "sh_rotation_kernel.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace lumivdb {

namespace {

using detail::blockOffset;

int entryIndex(int l, int m, int n)
{
    return blockOffset(l) + (n + l) * detail::blockStride(l) + m + l;
}

/// Products of a few rotations in double precision are no farther from being one.
constexpr double kRounding = 4e-15;

/// The rotation nearest to R, which is one to within 1e-6. Each Newton–Schulz step
/// R ← R (3I − RᵀR)/2 squares the distance, so two reach rounding: matrices that a host keeps in
/// single precision do not scale the light when they are applied again and again.
/// @return R itself, or @a repaired.
const Mat3d& nearestRotation(const Mat3d& R, Mat3d& repaired)
{
    const auto offBy = [&](int i, int j) {
        const double dot = R[i][0] * R[j][0] + R[i][1] * R[j][1] + R[i][2] * R[j][2];
        return std::abs(i == j ? dot - 1.0 : dot);
    };
    const double deviation = std::max(std::max(std::max(offBy(0, 0), offBy(1, 1)), offBy(2, 2)),
        std::max(std::max(offBy(0, 1), offBy(1, 2)), offBy(2, 0)));
    // A NaN anywhere makes the determinant NaN, which is not greater than 0.
    if (deviation > 1e-6 || !(R.determinant() > 0.0))
        throw Error(ErrorCode::Usage,
            "the 3x3 matrix given for rotating spherical harmonics is not a rotation (R^T R "
            "differs from the identity by more than 1e-6, or it mirrors); remove scale, shear and "
            "reflection first");
    if (deviation < kRounding) return R;
    repaired = R;
    for (int step = 0; step < 2; ++step)
        repaired = repaired * ((Mat3d() * 3.0 - repaired.transposed() * repaired) * 0.5);
    return repaired;
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

/// Degree l for all m and n, from the blocks of lower degrees in the recurrence's basis.
void fillBlocks(int bands, const Mat3d& q, double* blocks)
{
    blocks[0] = 1.0;
    if (bands == 1) return;
    // f'(d) = f(d Rᵀ), so c'_m = Σ_n c_n ∫ Y_n(e) Y_m(e R) de: the matrix entry (m, n) is the
    // coefficient of Y_n in Y_m(e R). Degree 1 without signs is Y_m(e) ∝ e[axis(m)], axes y, z, x.
    constexpr int axis[3] = {1, 2, 0};
    for (int m = -1; m <= 1; ++m)
        for (int n = -1; n <= 1; ++n) blocks[entryIndex(1, m, n)] = q[axis[n + 1]][axis[m + 1]];
    const Recurrence recurrence(blocks);
    for (int l = 2; l < bands; ++l)
        for (int m = -l; m <= l; ++m)
            for (int n = -l; n <= l; ++n) blocks[entryIndex(l, m, n)] = recurrence.entry(l, m, n);

    // Our Y_lm is (−1)^m times theirs: conjugate with these signs.
    for (int l = 1; l < bands; ++l)
        for (int m = -l; m <= l; ++m)
            for (int n = -l; n <= l; ++n)
                if ((m + n) % 2 != 0) blocks[entryIndex(l, m, n)] *= -1.0;
}

/// @a q = Z(first) · Y · Z(last) for row vectors, Z about z, Y the turn of x towards z. The last
/// angle is taken from where z goes, the first one from what is left, so that nothing is lost where
/// z hardly moves.
detail::EulerTurn eulerOf(const Mat3d& q)
{
    const double s = std::sqrt(q[2][0] * q[2][0] + q[2][1] * q[2][1]);
    const double c2 = s > 0 ? -q[2][0] / s : 1.0, s2 = s > 0 ? -q[2][1] / s : 0.0;
    const double cosine[3] = {q[1][1] * c2 - q[1][0] * s2, q[2][2], c2};
    const double sine[3] = {q[0][1] * c2 - q[0][0] * s2, s, s2};
    detail::EulerTurn turn;
    for (int k = 0; k < 3; ++k) {
        double *c = turn.cosine[k], *d = turn.sine[k];
        c[0] = 1.0;
        d[0] = 0.0;
        c[1] = cosine[k];
        d[1] = sine[k];
        for (int m = 2; m < kMaxBands; ++m) { // halves are ready sooner than the one before
            const int i = m / 2, j = m - i;
            c[m] = c[i] * c[j] - d[i] * d[j];
            d[m] = d[i] * c[j] + c[i] * d[j];
        }
    }
    return turn;
}

template <class Vector> void toLanes(const Vector& v, double* lanes)
{
    for (int c = 0; c < 3; ++c) lanes[c] = v[c];
    lanes[3] = 0.0;
}

Color fromLanes(const double* lanes)
{
    return Color(
        static_cast<float>(lanes[0]), static_cast<float>(lanes[1]), static_cast<float>(lanes[2]));
}

/// Degree 1 is (−y, z, −x).
template <class T> void turnVector(const Mat3d& q, const T* in, T* out)
{
    const T x = in[3], y = in[1], z = in[2];
    out[1] = x * q[0][1] + y * q[1][1] - z * q[2][1];
    out[2] = z * q[2][2] - x * q[0][2] - y * q[1][2];
    out[3] = x * q[0][0] + y * q[1][0] - z * q[2][0];
}

/// Coefficients 1 … Count−1 in double precision.
template <int Count, class Change> void throughDoubles(const Color* in, Color* out, Change change)
{
    Vec3d v[Count];
    for (int i = 1; i < Count; ++i) v[i] = Vec3d(in[i]);
    change(v);
    for (int i = 1; i < Count; ++i) out[i] = Color(v[i]);
}

/// Degree 1 by its block.
template <class T> void applyVector(const double* blocks, const T* in, T* out)
{
    const double* b = blocks + blockOffset(1);
    constexpr int stride = detail::blockStride(1);
    const T v[3] = {in[1], in[2], in[3]};
    for (int i = 0; i < 3; ++i)
        out[1 + i] = b[i] * v[0] + b[stride + i] * v[1] + b[2 * stride + i] * v[2];
}

/// Degree 2 is a symmetric matrix N without trace, f(d) = ½ k d N dᵀ with k of xy: it becomes qᵀ N
/// q.
template <class T> void turnQuadric(const Mat3d& q, const T* in, T* out)
{
    const double root3 = 1.73205080756887729353;
    const T zz = in[6] * (2.0 / root3);
    const T xx = in[8] - zz * 0.5, yy = -in[8] - zz * 0.5;
    const T xy = in[4], yz = -in[5], xz = -in[7];
    T a[3][3]; // N q
    for (int j = 0; j < 3; ++j) {
        a[0][j] = xx * q[0][j] + xy * q[1][j] + xz * q[2][j];
        a[1][j] = xy * q[0][j] + yy * q[1][j] + yz * q[2][j];
        a[2][j] = xz * q[0][j] + yz * q[1][j] + zz * q[2][j];
    }
    const auto entry
        = [&](int i, int j) { return q[0][i] * a[0][j] + q[1][i] * a[1][j] + q[2][i] * a[2][j]; };
    const T turnedZz = entry(2, 2);
    out[4] = entry(0, 1);
    out[5] = -entry(1, 2);
    out[6] = turnedZz * (root3 / 2.0);
    out[7] = -entry(0, 2);
    out[8] = entry(0, 0) + turnedZz * 0.5;
}

} // namespace

ShRotation::ShRotation(int bands, const Mat3d& R)
    : mBands(bands)
{
    detail::checkBands(bands);
    Mat3d repaired;
    const Mat3d& q = nearestRotation(R, repaired);
    mBlocks.resize(blockOffset(bands));
    fillBlocks(bands, q, mBlocks.data());
}

void ShRotation::apply(const double* in, double* out) const
{
    out[0] = in[0];
    if (mBands == 2) applyVector(mBlocks.data(), in, out);
    if (mBands <= 2) return;
    double result[kMaxCoefficients + 4];
    detail::applyBlocksToOne(mBands, mBlocks.data(), in, result);
    for (int i = 1; i < coefficientCount(mBands); ++i) out[i] = result[i];
}

void ShRotation::apply(const Color* in, Color* out) const
{
    // Sums in double: one rounding per application, which is what limits the drift.
    out[0] = in[0];
    if (mBands == 2)
        throughDoubles<4>(in, out, [&](Vec3d* v) { applyVector(mBlocks.data(), v, v); });
    if (mBands <= 2) return;
    detail::ShLanes lanes, result;
    const int count = coefficientCount(mBands);
    for (int i = 1; i < count; ++i) toLanes(in[i], lanes[i]);
    detail::applyBlocks(mBands, mBlocks.data(), lanes, result);
    for (int i = 1; i < count; ++i) out[i] = fromLanes(result[i]);
}

void rotateSh(int bands, const Mat3d& R, const double* in, double* out)
{
    detail::checkBands(bands);
    Mat3d repaired;
    const Mat3d& q = nearestRotation(R, repaired);
    out[0] = in[0];
    if (bands > 1) turnVector(q, in, out);
    if (bands > 2) turnQuadric(q, in, out);
    if (bands <= 3) return;
    double result[kMaxCoefficients];
    detail::applyEulerToOne(bands, eulerOf(q), in, result);
    for (int i = 9; i < coefficientCount(bands); ++i) out[i] = result[i];
}

void rotateSh(int bands, const Mat3d& R, const Color* in, Color* out)
{
    detail::checkBands(bands);
    Mat3d repaired;
    const Mat3d& q = nearestRotation(R, repaired);
    out[0] = in[0];
    if (bands == 2) {
        for (int c = 0; c < 3; ++c) {
            const double L[4] = {0.0, in[1][c], in[2][c], in[3][c]};
            double turned[4];
            turnVector(q, L, turned);
            for (int i = 1; i < 4; ++i) out[i][c] = static_cast<float>(turned[i]);
        }
    }
    if (bands <= 2) return;
    detail::ShLanes lanes, result;
    const int count = coefficientCount(bands);
    for (int i = 9; i < count; ++i) toLanes(in[i], lanes[i]);
    throughDoubles<9>(in, out, [&](Vec3d* v) {
        turnVector(q, v, v);
        turnQuadric(q, v, v);
    });
    if (bands > 3) detail::applyEuler(bands, eulerOf(q), lanes, result);
    for (int i = 9; i < count; ++i) out[i] = fromLanes(result[i]);
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
