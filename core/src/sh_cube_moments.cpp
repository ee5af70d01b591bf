// SPDX-License-Identifier: Apache-2.0
//
// The sums over the texels of a cube map.
//
// On a face, d = (a·right + b·up + n)/r with r² = 1 + a² + b² and dω = r⁻³ da db. Harmonics of one
// parity are homogeneous polynomials of one degree D in d, lower degrees being raised by
// 1 = x² + y² + z²; so all that is needed of a face are the moments Σ L ∫ aⁱ bʲ r^(−D−3) da db,
// i + j ≤ D, of the highest even and the highest odd degree: as many as there are coefficients,
// but separable: a row is reduced to its few moments in a, which powers of b then distribute.
//
// Texels that differ only in the signs of a, b and n share |weights|: eight of them are folded into
// the eight sums and differences with the signs' parities, each of which has few moments.
//
// Four partial sums of each, added in one order, and no fused operations on any machine: the same
// bits everywhere.
#include "sh_projection.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sh_cube_moments.cpp"
#include <hwy/foreach_target.h> // compiles what follows once per instruction set
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace lumivdb::detail {
namespace HWY_NAMESPACE {

namespace {

namespace hn = hwy::HWY_NAMESPACE;
using Doubles = hn::CappedTag<double, 4>; // fewer lanes where vectors are shorter
using Floats = hn::Rebind<float, Doubles>;

/// How the two faces of an axis lie in the frame of the positive one: (right, up, axis).
struct AxisFrame {
    int right, up, normal; // world axes
    double rightSign, upSign;
    /// The negative face runs against the positive one in its columns (else: in its rows).
    bool columnsMirrored;
};
constexpr AxisFrame kFrames[3]
    = {{2, 1, 0, -1, 1, true}, {0, 2, 1, 1, -1, false}, {0, 1, 2, 1, 1, true}};

/// Σ over every fourth vector element from @a begin on of Count weights times three channels, one
/// sum for each lane.
template <int Count>
HWY_INLINE void addProducts(const double* const* weights, const double* const* channels,
    std::size_t begin, std::size_t end, double (*sums)[3][4])
{
    const Doubles d;
    using V = hn::Vec<Doubles>;
    V s00 = hn::Zero(d), s01 = s00, s02 = s00, s10 = s00, s11 = s00, s12 = s00;
    V s20 = s00, s21 = s00, s22 = s00;
    for (std::size_t x = begin; x < end; x += 4) {
        const V f0 = hn::LoadU(d, channels[0] + x), f1 = hn::LoadU(d, channels[1] + x),
                f2 = hn::LoadU(d, channels[2] + x);
        const V w0 = hn::LoadU(d, weights[0] + x);
        s00 = hn::Add(s00, hn::Mul(w0, f0));
        s01 = hn::Add(s01, hn::Mul(w0, f1));
        s02 = hn::Add(s02, hn::Mul(w0, f2));
        if constexpr (Count > 1) {
            const V w1 = hn::LoadU(d, weights[1] + x);
            s10 = hn::Add(s10, hn::Mul(w1, f0));
            s11 = hn::Add(s11, hn::Mul(w1, f1));
            s12 = hn::Add(s12, hn::Mul(w1, f2));
        }
        if constexpr (Count > 2) {
            const V w2 = hn::LoadU(d, weights[2] + x);
            s20 = hn::Add(s20, hn::Mul(w2, f0));
            s21 = hn::Add(s21, hn::Mul(w2, f1));
            s22 = hn::Add(s22, hn::Mul(w2, f2));
        }
    }
    const V all[3][3] = {{s00, s01, s02}, {s10, s11, s12}, {s20, s21, s22}};
    for (int i = 0; i < Count; ++i)
        for (int c = 0; c < 3; ++c) hn::StoreU(all[i][c], d, sums[i][c] + begin);
}

/// Σ over a row of each of Count weights times each of three channels. Four partial sums, added in
/// one order, whatever the length of vectors.
template <int Count>
HWY_INLINE void rowSums(
    const double* const* weights, const double* const* channels, std::size_t n, double (*sums)[3])
{
    double lanes[Count][3][4];
    for (std::size_t begin = 0; begin < 4; begin += hn::Lanes(Doubles()))
        addProducts<Count>(weights, channels, begin, n, lanes);
    for (int i = 0; i < Count; ++i) {
        for (int c = 0; c < 3; ++c) {
            const double* part = lanes[i][c];
            sums[i][c] = (part[0] + part[1]) + (part[2] + part[3]);
        }
    }
}

/// The sums over one cube map.
class CubeKernel {
public:
    explicit CubeKernel(CubeJob& job)
        : mJob(job)
        , mSize(job.size)
        , mPadded(job.padded)
    {
    }

    void run()
    {
        for (int y = 0; y < mJob.half; ++y) {
            for (int axis = 0; axis < 3; ++axis) {
                foldRows(mJob.faces[2 * axis], mJob.faces[2 * axis + 1], y);
                foldColumns(axis);
            }
            addRow(y);
        }
    }

private:
    int degree(int parity) const { return highestDegree(mJob.bands, parity); }
    double* weight(int parity, int i)
    {
        return mJob.weight + static_cast<std::size_t>(parity * kMaxBands + i) * mPadded;
    }
    double* folded(int axis, int kind, int c)
    {
        return mJob.folded + static_cast<std::size_t>((axis * 8 + kind) * 3 + c) * mPadded;
    }
    double* flat(int sign, int rowParity)
    {
        return mJob.flat + static_cast<std::size_t>(2 * sign + rowParity) * mJob.flatLength;
    }
    double centre(int pixel) const { return (2 * pixel + 1.0) / mSize - 1; }

    /// Classes of folded texels by the parities of the exponents of a, b and n.
    static int kindOf(int a, int b, int n) { return 4 * n + 2 * b + a; }
    /// Whether any moment has these parities.
    bool isNeeded(int a, int b, int n) const { return a + b + n <= degree((a + b + n) & 1); }

    void foldRows(const float* positive, const float* negative, int y);
    void foldColumns(int axis);
    void foldPair(const double* in, int axis, int even, int odd);
    void addRow(int y);
    void addSubRow(double b);
    void weightsOverAreas(double b, double scale);
    void weightsAtCentres(double b, double scale);
    void distribute(int axis, int kind, double b);
    void addMoment(
        const AxisFrame& frame, int parity, int i, int j, double factor, const double (&sums)[3]);

    CubeJob& mJob;
    const int mSize;
    const std::size_t mPadded;
};

/// Rows y and size − 1 − y of both faces: sums and differences, over the faces and over the rows.
void CubeKernel::foldRows(const float* positive, const float* negative, int y)
{
    const Doubles d;
    const Floats f;
    const std::size_t n = 3 * static_cast<std::size_t>(mSize);
    const std::size_t upper = n * static_cast<std::size_t>(y);
    const std::size_t lower = n * static_cast<std::size_t>(mSize - 1 - y);
    const float* pu = positive + upper;
    const float* pl = positive + lower;
    const float* nu = negative + upper;
    const float* nl = negative + lower;
    double *pp = flat(0, 0), *pm = flat(0, 1), *mp = flat(1, 0), *mm = flat(1, 1);
    std::size_t x = 0;
    for (; x + hn::Lanes(d) <= n; x += hn::Lanes(d)) {
        const auto a = hn::PromoteTo(d, hn::LoadU(f, pu + x));
        const auto b = hn::PromoteTo(d, hn::LoadU(f, pl + x));
        const auto c = hn::PromoteTo(d, hn::LoadU(f, nu + x));
        const auto e = hn::PromoteTo(d, hn::LoadU(f, nl + x));
        const auto ps = hn::Add(a, b), pd = hn::Sub(a, b);
        const auto ns = hn::Add(c, e), nd = hn::Sub(c, e);
        hn::Store(hn::Add(ps, ns), d, pp + x);
        hn::Store(hn::Add(pd, nd), d, pm + x);
        hn::Store(hn::Sub(ps, ns), d, mp + x);
        hn::Store(hn::Sub(pd, nd), d, mm + x);
    }
    for (; x < n; ++x) {
        const double a = pu[x], b = pl[x], c = nu[x], e = nl[x];
        pp[x] = (a + b) + (c + e);
        pm[x] = (a - b) + (c - e);
        mp[x] = (a + b) - (c + e);
        mm[x] = (a - b) - (c - e);
    }
}

/// Columns x and size − 1 − x of one folded row: their sum and their difference, channels apart.
/// A class of −1 is not wanted.
void CubeKernel::foldPair(const double* in, int axis, int even, int odd)
{
    const Doubles d;
    const int lanes = static_cast<int>(hn::Lanes(d));
    double *sum[3], *difference[3];
    for (int c = 0; c < 3; ++c) {
        sum[c] = folded(axis, even < 0 ? 0 : even, c);
        difference[c] = folded(axis, odd < 0 ? 0 : odd, c);
    }
    int x = 0;
    for (; x + lanes <= mSize / 2; x += lanes) {
        auto l0 = hn::Zero(d), l1 = l0, l2 = l0, r0 = l0, r1 = l0, r2 = l0;
        hn::LoadInterleaved3(d, in + 3 * x, l0, l1, l2);
        hn::LoadInterleaved3(d, in + 3 * (mSize - lanes - x), r0, r1, r2);
        r0 = hn::Reverse(d, r0);
        r1 = hn::Reverse(d, r1);
        r2 = hn::Reverse(d, r2);
        if (even >= 0) {
            hn::Store(hn::Add(l0, r0), d, sum[0] + x);
            hn::Store(hn::Add(l1, r1), d, sum[1] + x);
            hn::Store(hn::Add(l2, r2), d, sum[2] + x);
        }
        if (odd >= 0) {
            hn::Store(hn::Sub(l0, r0), d, difference[0] + x);
            hn::Store(hn::Sub(l1, r1), d, difference[1] + x);
            hn::Store(hn::Sub(l2, r2), d, difference[2] + x);
        }
    }
    for (; x < mJob.half; ++x) {
        for (int c = 0; c < 3; ++c) {
            const double l = in[3 * x + c], r = in[3 * (mSize - 1 - x) + c];
            if (even >= 0) sum[c][x] = l + r;
            if (odd >= 0) difference[c][x] = l - r;
        }
    }
}

/// Where the negative face is mirrored in its columns (rows), its part of a class that is odd in a
/// (b) has the other sign: the class is then odd in n where the faces were added.
void CubeKernel::foldColumns(int axis)
{
    const bool mirrored = kFrames[axis].columnsMirrored;
    for (int sign = 0; sign < 2; ++sign) {
        for (int b = 0; b < 2; ++b) {
            int kind[2];
            for (int a = 0; a < 2; ++a) {
                const int n = (sign + (mirrored ? a : b)) & 1;
                kind[a] = isNeeded(a, b, n) ? kindOf(a, b, n) : -1;
            }
            if (kind[0] >= 0 || kind[1] >= 0) foldPair(flat(sign, b), axis, kind[0], kind[1]);
        }
    }
}

/// Weights of a line of constant @a b through the texels: ∫ aⁱ r^(−D−3) da of each, times
/// @a scale.
void CubeKernel::weightsOverAreas(double b, double scale)
{
    const Doubles d;
    const int even = degree(0), odd = degree(1);
    const auto one = hn::Set(d, 1.0), line = hn::Set(d, 1 + b * b);
    const auto step = hn::Set(d, 2.0 / mSize), first = hn::Set(d, 1.0 / mSize - 1);
    for (std::size_t x = 0; x < mPadded; x += hn::Lanes(d)) {
        hn::Vec<Doubles> w[CubeJob::kWeightRows];
        for (auto& sum : w) sum = hn::Zero(d);
        const auto middle = hn::Add(first, hn::Mul(step, hn::Iota(d, static_cast<double>(x))));
        for (std::size_t p = 0; p < mJob.nodes; ++p) {
            const auto a = hn::Add(middle, hn::Set(d, mJob.node[p] * 2 / mSize));
            const auto inverse = hn::Div(one, hn::Add(line, hn::Mul(a, a)));
            auto e = hn::Mul(hn::Set(d, scale * mJob.nodeWeight[p]), inverse);
            auto o = hn::Mul(e, inverse);
            e = hn::Mul(e, hn::Sqrt(inverse));
            for (int k = 0; k < even; k += 2) e = hn::Mul(e, inverse);
            for (int k = 1; k < odd; k += 2) o = hn::Mul(o, inverse);
            for (int i = 0; i <= even; ++i, e = hn::Mul(e, a)) w[i] = hn::Add(w[i], e);
            for (int i = 0; i <= odd; ++i, o = hn::Mul(o, a))
                w[kMaxBands + i] = hn::Add(w[kMaxBands + i], o);
        }
        for (int i = 0; i <= even; ++i) hn::Store(w[i], d, weight(0, i) + x);
        for (int i = 0; i <= odd; ++i) hn::Store(w[kMaxBands + i], d, weight(1, i) + x);
    }
}

/// The solid angle of each texel of the row at @a b times aⁱ r^(−D) at its centre.
void CubeKernel::weightsAtCentres(double b, double scale)
{
    const Doubles d;
    const auto one = hn::Set(d, 1.0);
    const auto step = hn::Set(d, 2.0 / mSize), first = hn::Set(d, 1.0 / mSize - 1);
    for (std::size_t x = 0; x < mPadded; x += hn::Lanes(d)) {
        const auto a = hn::Add(first, hn::Mul(step, hn::Iota(d, static_cast<double>(x))));
        auto solid = hn::Zero(d);
        for (std::size_t q = 0; q < mJob.nodes; ++q) {
            const double t = b + mJob.node[q] * 2 / mSize;
            for (std::size_t p = 0; p < mJob.nodes; ++p) {
                const auto s = hn::Add(a, hn::Set(d, mJob.node[p] * 2 / mSize));
                const auto inverse = hn::Div(one, hn::Add(hn::Set(d, 1 + t * t), hn::Mul(s, s)));
                const auto w
                    = hn::Mul(hn::Set(d, mJob.nodeWeight[p] * mJob.nodeWeight[q]), inverse);
                solid = hn::Add(solid, hn::Mul(w, hn::Sqrt(inverse)));
            }
        }
        const auto inverse = hn::Div(one, hn::Add(hn::Set(d, 1 + b * b), hn::Mul(a, a)));
        for (int parity = 0; parity < 2; ++parity) {
            auto w = hn::Mul(solid, hn::Set(d, scale));
            if (parity == 1) w = hn::Mul(w, hn::Sqrt(inverse));
            for (int k = parity; k < degree(parity); k += 2) w = hn::Mul(w, inverse);
            for (int i = 0; i <= degree(parity); ++i, w = hn::Mul(w, a))
                hn::Store(w, d, weight(parity, i) + x);
        }
    }
}

void CubeKernel::addMoment(
    const AxisFrame& frame, int parity, int i, int j, double factor, const double (&sums)[3])
{
    int exponent[3];
    exponent[frame.right] = i;
    exponent[frame.up] = j;
    exponent[frame.normal] = degree(parity) - i - j;
    if (i % 2 == 1) factor *= frame.rightSign;
    if (j % 2 == 1) factor *= frame.upSign;
    double* moment = mJob.moments[parity][exponent[0]][exponent[1]];
    for (int c = 0; c < 3; ++c) moment[c] += sums[c] * factor;
}

/// One class of a folded row: its moments in a, then b to every power that goes with them.
void CubeKernel::distribute(int axis, int kind, double b)
{
    const int a = kind & 1, rowParity = kind >> 1 & 1, n = kind >> 2;
    const int parity = (a + rowParity + n) & 1;
    const int most = degree(parity) - rowParity - n; // largest exponent of a
    const double* channels[3]
        = {folded(axis, kind, 0), folded(axis, kind, 1), folded(axis, kind, 2)};
    const double* weights[3] = {};
    int count = 0;
    for (int i = a; i <= most; i += 2) weights[count++] = weight(parity, i);
    double sums[3][3];
    if (count == 1) rowSums<1>(weights, channels, mPadded, sums);
    if (count == 2) rowSums<2>(weights, channels, mPadded, sums);
    if (count == 3) rowSums<3>(weights, channels, mPadded, sums);
    double power = rowParity == 0 ? 1.0 : b;
    for (int j = rowParity; j <= degree(parity); j += 2, power *= b * b)
        for (int k = 0; k < count && a + 2 * k + j <= degree(parity); ++k)
            addMoment(kFrames[axis], parity, a + 2 * k, j, power, sums[k]);
}

void CubeKernel::addSubRow(double b)
{
    // The middle column of an odd size is folded with itself.
    if (mSize % 2 == 1)
        for (int parity = 0; parity < 2; ++parity)
            for (int i = 0; i <= degree(parity); ++i) weight(parity, i)[mJob.half - 1] *= 0.5;
    for (int axis = 0; axis < 3; ++axis)
        for (int kind = 0; kind < 8; ++kind)
            if (isNeeded(kind & 1, kind >> 1 & 1, kind >> 2)) distribute(axis, kind, b);
}

void CubeKernel::addRow(int y)
{
    const double up = -centre(y); // rows run downwards
    const double texel = 4.0 / mSize / mSize * (2 * y + 1 == mSize ? 0.5 : 1.0);
    if (mJob.centres) {
        weightsAtCentres(up, texel);
        addSubRow(up);
        return;
    }
    for (std::size_t q = 0; q < mJob.nodes; ++q) {
        const double b = up + mJob.node[q] * 2 / mSize;
        weightsOverAreas(b, texel * mJob.nodeWeight[q]);
        addSubRow(b);
    }
}

} // namespace

void sumMoments(CubeJob& job) { CubeKernel(job).run(); }

} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lumivdb::detail {

HWY_EXPORT(sumMoments);

void sumCubeMoments(CubeJob& job) { HWY_DYNAMIC_DISPATCH(sumMoments)(job); }

} // namespace lumivdb::detail
#endif
