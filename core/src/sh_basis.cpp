// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/sh.h>

#include "sh_internal.h"

// Of x86: none, SSE4 and AVX2, as in sampler_kernels.cpp.
#define HWY_DISABLED_TARGETS                                                                       \
    (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV | HWY_SSSE3 | HWY_AVX3 | HWY_AVX3_DL)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sh_basis.cpp"
#include <hwy/foreach_target.h> // compiles what follows once per instruction set
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace lumivdb::detail {
namespace HWY_NAMESPACE {

namespace {

namespace hn = hwy::HWY_NAMESPACE;
using Lanes = hn::CappedTag<float, 8>;
constexpr std::size_t kLanes = hn::MaxLanes(Lanes());

/// Several directions' numbers, with the arithmetic of one.
struct Floats {
    hn::Vec<Lanes> v;

    Floats() = default;
    HWY_INLINE explicit Floats(hn::Vec<Lanes> vector)
        : v(vector)
    {
    }
    HWY_INLINE explicit Floats(double x)
        : v(hn::Set(Lanes(), static_cast<float>(x)))
    {
    }
};
HWY_INLINE Floats operator+(const Floats& a, const Floats& b) { return Floats(hn::Add(a.v, b.v)); }
HWY_INLINE Floats operator-(const Floats& a, const Floats& b) { return Floats(hn::Sub(a.v, b.v)); }
HWY_INLINE Floats operator*(const Floats& a, const Floats& b) { return Floats(hn::Mul(a.v, b.v)); }

// Y_lm = (−1)^m k_lm P_lm(z) {s_|m|, c_m}: k from the normalisation, P_lm a polynomial in z alone,
// and c_m + i s_m = (x + iy)^m (Sloan 2013). Each constant is the square root beside it, to more
// digits than double holds.
constexpr double k00 = 0.28209479177387814347; // sqrt(1/(4 pi))
constexpr double k10 = 0.48860251190291992159; // sqrt(3/(4 pi))
constexpr double k20 = 0.31539156525252000603; // sqrt(5/(16 pi))
constexpr double k21 = 1.09254843059207907054; // sqrt(15/(4 pi))
constexpr double k22 = 0.54627421529603953527; // sqrt(15/(16 pi))
constexpr double k30 = 0.37317633259011539141; // sqrt(7/(16 pi))
constexpr double k31 = 0.45704579946446573616; // sqrt(21/(32 pi))
constexpr double k32 = 1.44530572132027702769; // sqrt(105/(16 pi))
constexpr double k33 = 0.59004358992664351035; // sqrt(35/(32 pi))
constexpr double k40 = 0.10578554691520430380; // sqrt(9/(256 pi))
constexpr double k41 = 0.66904654355728916795; // sqrt(45/(32 pi))
constexpr double k42 = 0.47308734787878000905; // sqrt(45/(64 pi))
constexpr double k43 = 1.77013076977993053104; // sqrt(315/(32 pi))
constexpr double k44 = 0.62583573544917613459; // sqrt(315/(256 pi))
constexpr double k50 = 0.11695032245342359644; // sqrt(11/(256 pi))
constexpr double k51 = 0.45294665119569692130; // sqrt(165/(256 pi))
constexpr double k52 = 2.39676839248666187750; // sqrt(1155/(64 pi))
constexpr double k53 = 0.48923829943525038768; // sqrt(385/(512 pi))
constexpr double k54 = 2.07566231488104127900; // sqrt(3465/(256 pi))
constexpr double k55 = 0.65638205684017010281; // sqrt(693/(512 pi))

// One template for one direction and for vectors of them: the same arithmetic, and bitwise equal,
// since -ffp-contract=off.

template <class T> HWY_INLINE void degree1(T x, T y, T z, T* out)
{
    out[1] = T(-k10) * y;
    out[2] = T(k10) * z;
    out[3] = T(-k10) * x;
}

template <class T> HWY_INLINE void degree2(T x, T y, T z, T zz, T s2, T c2, T* out)
{
    const T p1 = T(-k21) * z;
    out[4] = T(k22) * s2;
    out[5] = p1 * y;
    out[6] = T(3 * k20) * zz - T(k20);
    out[7] = p1 * x;
    out[8] = T(k22) * c2;
}

template <class T> HWY_INLINE void degree3(T x, T y, T z, T zz, T s2, T c2, T s3, T c3, T* out)
{
    const T p1 = T(-5 * k31) * zz + T(k31);
    const T p2 = T(k32) * z;
    out[9] = T(-k33) * s3;
    out[10] = p2 * s2;
    out[11] = p1 * y;
    out[12] = z * (T(5 * k30) * zz - T(3 * k30));
    out[13] = p1 * x;
    out[14] = p2 * c2;
    out[15] = T(-k33) * c3;
}

template <class T>
HWY_INLINE void degree4(T x, T y, T z, T zz, T s2, T c2, T s3, T c3, T s4, T c4, T* out)
{
    const T p1 = z * (T(-7 * k41) * zz + T(3 * k41));
    const T p2 = T(7 * k42) * zz - T(k42);
    const T p3 = T(-k43) * z;
    out[16] = T(k44) * s4;
    out[17] = p3 * s3;
    out[18] = p2 * s2;
    out[19] = p1 * y;
    out[20] = (T(35 * k40) * zz - T(30 * k40)) * zz + T(3 * k40);
    out[21] = p1 * x;
    out[22] = p2 * c2;
    out[23] = p3 * c3;
    out[24] = T(k44) * c4;
}

template <class T>
HWY_INLINE void degree5(T x, T y, T z, T zz, T s2, T c2, T s3, T c3, T s4, T c4, T* out)
{
    const T s5 = x * s4 + y * c4;
    const T c5 = x * c4 - y * s4;
    const T p1 = (T(-21 * k51) * zz + T(14 * k51)) * zz - T(k51);
    const T p2 = z * (T(3 * k52) * zz - T(k52));
    const T p3 = T(-9 * k53) * zz + T(k53);
    const T p4 = T(k54) * z;
    out[25] = T(-k55) * s5;
    out[26] = p4 * s4;
    out[27] = p3 * s3;
    out[28] = p2 * s2;
    out[29] = p1 * y;
    out[30] = z * ((T(63 * k50) * zz - T(70 * k50)) * zz + T(15 * k50));
    out[31] = p1 * x;
    out[32] = p2 * c2;
    out[33] = p3 * c3;
    out[34] = p4 * c4;
    out[35] = T(-k55) * c5;
}

template <int Bands, class T> HWY_INLINE void basis(T x, T y, T z, T* out)
{
    out[0] = T(k00);
    if constexpr (Bands > 1) degree1(x, y, z, out);
    if constexpr (Bands > 2) {
        const T zz = z * z;
        const T s2 = T(2) * x * y;
        const T c2 = x * x - y * y;
        degree2(x, y, z, zz, s2, c2, out);
        if constexpr (Bands > 3) {
            const T s3 = x * s2 + y * c2;
            const T c3 = x * c2 - y * s2;
            degree3(x, y, z, zz, s2, c2, s3, c3, out);
            if constexpr (Bands > 4) {
                const T s4 = x * s3 + y * c3;
                const T c4 = x * c3 - y * s3;
                degree4(x, y, z, zz, s2, c2, s3, c3, s4, c4, out);
                if constexpr (Bands > 5) degree5(x, y, z, zz, s2, c2, s3, c3, s4, c4, out);
            }
        }
    }
}

template <class T> void evalBasis(int bands, T x, T y, T z, T* out)
{
    switch (bands) {
    case 1:
        return basis<1>(x, y, z, out);
    case 2:
        return basis<2>(x, y, z, out);
    case 3:
        return basis<3>(x, y, z, out);
    case 4:
        return basis<4>(x, y, z, out);
    case 5:
        return basis<5>(x, y, z, out);
    case 6:
        return basis<6>(x, y, z, out);
    default:
        checkBands(bands);
    }
}

template <int Bands>
void evalBatch(std::size_t count, const float* x, const float* y, const float* z, float* out)
{
    constexpr std::size_t kValues = coefficientCount(Bands);
    std::size_t k = 0;
    for (; k + kLanes <= count; k += kLanes) {
        const auto load = [&](const float* from) { return Floats(hn::LoadU(Lanes(), from + k)); };
        Floats values[kValues];
        basis<Bands>(load(x), load(y), load(z), values);
        for (std::size_t i = 0; i < kValues; ++i) {
            hn::StoreU(values[i].v, Lanes(), out + i * count + k);
        }
    }
    for (; k < count; ++k) {
        float values[kValues];
        basis<Bands>(x[k], y[k], z[k], values);
        for (std::size_t i = 0; i < kValues; ++i) out[i * count + k] = values[i];
    }
}

} // namespace

void evalDouble(int bands, const Vec3d& d, double* y) { evalBasis(bands, d.x, d.y, d.z, y); }
void evalFloat(int bands, const Vec3f& d, float* y) { evalBasis(bands, d.x, d.y, d.z, y); }

void evalMany(
    int bands, std::size_t count, const float* x, const float* yy, const float* z, float* y)
{
    switch (bands) {
    case 1:
        return evalBatch<1>(count, x, yy, z, y);
    case 2:
        return evalBatch<2>(count, x, yy, z, y);
    case 3:
        return evalBatch<3>(count, x, yy, z, y);
    case 4:
        return evalBatch<4>(count, x, yy, z, y);
    case 5:
        return evalBatch<5>(count, x, yy, z, y);
    case 6:
        return evalBatch<6>(count, x, yy, z, y);
    default:
        checkBands(bands);
    }
}

} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lumivdb {

namespace detail {
HWY_EXPORT(evalMany);
} // namespace detail

void evalShBasis(int bands, const Vec3d& dir, double* y)
{
    detail::HWY_STATIC_DISPATCH(evalDouble)(bands, dir, y);
}

void evalShBasis(int bands, const Vec3f& dir, float* y)
{
    detail::HWY_STATIC_DISPATCH(evalFloat)(bands, dir, y);
}

void evalShBasisBatch(
    int bands, std::size_t count, const float* x, const float* yy, const float* z, float* y)
{
    using namespace detail;
    HWY_DYNAMIC_DISPATCH(evalMany)(bands, count, x, yy, z, y);
}

Color evalSh(int bands, const Color* c, const Vec3f& dir)
{
    float y[kMaxCoefficients];
    evalShBasis(bands, dir, y);
    Color sum(0.0f);
    for (int i = 0; i < coefficientCount(bands); ++i) sum += c[i] * y[i];
    return sum;
}

double evalSh(int bands, const double* c, const Vec3d& dir)
{
    double y[kMaxCoefficients];
    evalShBasis(bands, dir, y);
    return dotSh(bands, c, y);
}

Color irradiance(int bands, const Color* L, const Vec3f& n)
{
    float y[kMaxCoefficients];
    evalShBasis(bands, n, y);
    Color sum(0.0f);
    for (int l = 0; l < bands; ++l) {
        const auto lobe = static_cast<float>(kCosineLobe[l]);
        if (lobe == 0.0f) continue; // degrees 3 and 5 do not reach a Lambertian surface
        Color degree(0.0f);
        for (int i = l * l; i < (l + 1) * (l + 1); ++i) degree += L[i] * y[i];
        sum += degree * lobe;
    }
    return sum;
}

void convolveSh(int bands, const double* kernel, const Color* in, Color* out)
{
    detail::checkBands(bands);
    for (int l = 0; l < bands; ++l)
        for (int i = l * l; i < (l + 1) * (l + 1); ++i)
            for (int c = 0; c < 3; ++c) out[i][c] = static_cast<float>(kernel[l] * in[i][c]);
}

double dotSh(int bands, const double* a, const double* b)
{
    detail::checkBands(bands);
    double sum = 0.0;
    for (int i = 0; i < coefficientCount(bands); ++i) sum += a[i] * b[i];
    return sum;
}

Color dotSh(int bands, const Color* a, const float* b)
{
    detail::checkBands(bands);
    Color sum(0.0f);
    for (int i = 0; i < coefficientCount(bands); ++i) sum += a[i] * b[i];
    return sum;
}

} // namespace lumivdb
#endif
