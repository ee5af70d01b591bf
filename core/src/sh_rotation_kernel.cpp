// SPDX-License-Identifier: Apache-2.0
#include "sh_rotation_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sh_rotation_kernel.cpp"
#include <hwy/foreach_target.h> // compiles what follows once per instruction set
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace lumivdb::detail {
namespace HWY_NAMESPACE {

namespace {

namespace hn = hwy::HWY_NAMESPACE;
using Doubles = hn::CappedTag<double, 4>;

template <int L>
HWY_INLINE void multiplyLanes(const double* blocks, const ShLanes& in, ShLanes& out)
{
    constexpr int n = 2 * L + 1, stride = blockStride(L);
    const Doubles d;
    const double* block = blocks + blockOffset(L);
    for (int i = 0; i < n; ++i) {
        for (std::size_t c = 0; c < 4; c += hn::Lanes(d)) {
            auto sum = hn::Zero(d);
            for (int j = 0; j < n; ++j)
                sum = hn::Add(sum,
                    hn::Mul(hn::Set(d, block[j * stride + i]), hn::LoadU(d, in[L * L + j] + c)));
            hn::StoreU(sum, d, out[L * L + i] + c);
        }
    }
}

/// Writes up to 3 values past its degree, which the next degree overwrites.
template <int L> HWY_INLINE void multiplyOne(const double* blocks, const double* in, double* out)
{
    constexpr int n = 2 * L + 1, stride = blockStride(L);
    const Doubles d;
    const double* block = blocks + blockOffset(L);
    for (std::size_t i = 0; i < stride; i += hn::Lanes(d)) {
        auto sum = hn::Zero(d);
        for (int j = 0; j < n; ++j)
            sum = hn::Add(
                sum, hn::Mul(hn::LoadU(d, block + j * stride + i), hn::Set(d, in[L * L + j])));
        hn::StoreU(sum, d, out + L * L + i);
    }
}

/// A coefficient of one channel, or of three and a lane of padding.
template <std::size_t Width> using Lanes = double[Width];
template <std::size_t Width> using TagOf = hn::CappedTag<double, Width>;

/// cos mα c_m − sin mα c_{−m}, sin mα c_m + cos mα c_{−m}.
template <int L, std::size_t Width>
HWY_INLINE void turn(
    const double* cosine, const double* sine, const Lanes<Width>* in, Lanes<Width>* out)
{
    const TagOf<Width> d;
    for (std::size_t c = 0; c < Width; c += hn::Lanes(d)) {
        hn::StoreU(hn::LoadU(d, in[L] + c), d, out[L] + c);
        for (int m = 1; m <= L; ++m) {
            const auto plus = hn::LoadU(d, in[L + m] + c), minus = hn::LoadU(d, in[L - m] + c);
            const auto co = hn::Set(d, cosine[m]), si = hn::Set(d, sine[m]);
            hn::StoreU(hn::Sub(hn::Mul(co, plus), hn::Mul(si, minus)), d, out[L + m] + c);
            hn::StoreU(hn::Add(hn::Mul(si, plus), hn::Mul(co, minus)), d, out[L - m] + c);
        }
    }
}

/// out = in[i] a, or in[i] a + in[j] b, or in[i] a + in[j] b + in[k] e.
template <std::size_t Width>
HWY_INLINE void combine(const Lanes<Width>* in, Lanes<Width>& out, int i, double a, int j = -1,
    double b = 0, int k = -1, double e = 0)
{
    const TagOf<Width> d;
    for (std::size_t c = 0; c < Width; c += hn::Lanes(d)) {
        auto sum = hn::Mul(hn::Set(d, a), hn::LoadU(d, in[i] + c));
        if (j >= 0) sum = hn::Add(sum, hn::Mul(hn::Set(d, b), hn::LoadU(d, in[j] + c)));
        if (k >= 0) sum = hn::Add(sum, hn::Mul(hn::Set(d, e), hn::LoadU(d, in[k] + c)));
        hn::StoreU(sum, d, out + c);
    }
}

// Swapping y and z, the matrices of Pinchon & Hoggan, "Rotation matrices for real spherical
// harmonics" (J. Phys. A 40, 2007), in our signs. Each entry is a root over 16: rN = √N/16.
constexpr double r10 = 0.19764235376052370825;
constexpr double r24 = 0.30618621784789726227;
constexpr double r32 = 0.35355339059327376220;
constexpr double r42 = 0.40504629365049126444;
constexpr double r45 = 0.41926274578121056808;
constexpr double r60 = 0.48412291827592711065;
constexpr double r70 = 0.52291251658379721749;
constexpr double r80 = 0.55901699437494742410;
constexpr double r84 = 0.57282196186948000082;
constexpr double r96 = 0.61237243569579452455;
constexpr double r112 = 0.66143782776614764763;
constexpr double r120 = 0.68465319688145764182;
constexpr double r126 = 0.70156076002011400980;
constexpr double r140 = 0.73950997288745200532;
constexpr double r160 = 0.79056941504209483300;
constexpr double r162 = 0.79549512883486596495;
constexpr double r192 = 0.86602540378443864676;
constexpr double r210 = 0.90571104663683991086;
constexpr double r224 = 0.93541434669348534640;
constexpr double r240 = 0.96824583655185422129;

template <std::size_t Width> HWY_INLINE void swapDegree3(const Lanes<Width>* in, Lanes<Width>* out)
{
    combine(in, out[0], 3, r160, 5, -r96);
    combine(in, out[1], 1, 1.0);
    combine(in, out[2], 3, r96, 5, r160);
    combine(in, out[3], 0, r160, 2, r96);
    combine(in, out[4], 4, -0.25, 6, -r240);
    combine(in, out[5], 0, -r96, 2, r160);
    combine(in, out[6], 4, -r240, 6, 0.25);
}

template <std::size_t Width> HWY_INLINE void swapDegree4(const Lanes<Width>* in, Lanes<Width>* out)
{
    combine(in, out[0], 5, r224, 7, -r32);
    combine(in, out[1], 1, 0.75, 3, -r112);
    combine(in, out[2], 5, r32, 7, r224);
    combine(in, out[3], 1, -r112, 3, -0.75);
    combine(in, out[4], 4, 0.375, 6, r80, 8, r140);
    combine(in, out[5], 0, r224, 2, r32);
    combine(in, out[6], 4, r80, 6, 0.5, 8, -r112);
    combine(in, out[7], 0, -r32, 2, r224);
    combine(in, out[8], 4, r140, 6, -r112, 8, 0.125);
}

template <std::size_t Width> HWY_INLINE void swapDegree5(const Lanes<Width>* in, Lanes<Width>* out)
{
    combine(in, out[0], 5, -r126, 7, r120, 9, -r10);
    combine(in, out[1], 1, 0.5, 3, -r192);
    combine(in, out[2], 5, -r70, 7, -r24, 9, r162);
    combine(in, out[3], 1, -r192, 3, -0.5);
    combine(in, out[4], 5, -r60, 7, -r112, 9, -r84);
    combine(in, out[5], 0, -r126, 2, -r70, 4, -r60);
    combine(in, out[6], 6, 0.125, 8, r42, 10, r210);
    combine(in, out[7], 0, r120, 2, -r24, 4, -r112);
    combine(in, out[8], 6, r42, 8, 0.8125, 10, -r45);
    combine(in, out[9], 0, -r10, 2, r162, 4, -r84);
    combine(in, out[10], 6, r210, 8, -r45, 10, 0.0625);
}

template <int L, std::size_t Width>
HWY_INLINE void swapAxes(const Lanes<Width>* in, Lanes<Width>* out)
{
    if constexpr (L == 3) swapDegree3<Width>(in, out);
    if constexpr (L == 4) swapDegree4<Width>(in, out);
    if constexpr (L == 5) swapDegree5<Width>(in, out);
}

template <int L, std::size_t Width>
HWY_INLINE void turnDegree(const EulerTurn& euler, const Lanes<Width>* in, Lanes<Width>* out)
{
    double a[2 * L + 1][Width], b[2 * L + 1][Width];
    turn<L, Width>(euler.cosine[0], euler.sine[0], in + L * L, a);
    swapAxes<L, Width>(a, b);
    turn<L, Width>(euler.cosine[1], euler.sine[1], b, a);
    swapAxes<L, Width>(a, b);
    turn<L, Width>(euler.cosine[2], euler.sine[2], b, out + L * L);
}

template <std::size_t Width>
HWY_INLINE void turnDegrees(
    int bands, const EulerTurn& euler, const Lanes<Width>* in, Lanes<Width>* out)
{
    if (bands > 3) turnDegree<3, Width>(euler, in, out);
    if (bands > 4) turnDegree<4, Width>(euler, in, out);
    if (bands > 5) turnDegree<5, Width>(euler, in, out);
}

} // namespace

void multiplyAllLanes(int bands, const double* blocks, const ShLanes& in, ShLanes& out)
{
    multiplyLanes<1>(blocks, in, out);
    if (bands > 2) multiplyLanes<2>(blocks, in, out);
    if (bands > 3) multiplyLanes<3>(blocks, in, out);
    if (bands > 4) multiplyLanes<4>(blocks, in, out);
    if (bands > 5) multiplyLanes<5>(blocks, in, out);
}

void multiplyAllOfOne(int bands, const double* blocks, const double* in, double* out)
{
    multiplyOne<1>(blocks, in, out);
    if (bands > 2) multiplyOne<2>(blocks, in, out);
    if (bands > 3) multiplyOne<3>(blocks, in, out);
    if (bands > 4) multiplyOne<4>(blocks, in, out);
    if (bands > 5) multiplyOne<5>(blocks, in, out);
}

void turnAllLanes(int bands, const EulerTurn& euler, const ShLanes& in, ShLanes& out)
{
    turnDegrees<4>(bands, euler, in, out);
}

void turnAllOfOne(int bands, const EulerTurn& euler, const double* in, double* out)
{
    turnDegrees<1>(
        bands, euler, reinterpret_cast<const Lanes<1>*>(in), reinterpret_cast<Lanes<1>*>(out));
}

} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lumivdb::detail {

HWY_EXPORT(multiplyAllLanes);
HWY_EXPORT(multiplyAllOfOne);
HWY_EXPORT(turnAllLanes);
HWY_EXPORT(turnAllOfOne);

void applyBlocks(int bands, const double* blocks, const ShLanes& in, ShLanes& out)
{
    HWY_DYNAMIC_DISPATCH(multiplyAllLanes)(bands, blocks, in, out);
}

void applyBlocksToOne(int bands, const double* blocks, const double* in, double* out)
{
    HWY_DYNAMIC_DISPATCH(multiplyAllOfOne)(bands, blocks, in, out);
}

void applyEuler(int bands, const EulerTurn& turn, const ShLanes& in, ShLanes& out)
{
    HWY_DYNAMIC_DISPATCH(turnAllLanes)(bands, turn, in, out);
}

void applyEulerToOne(int bands, const EulerTurn& turn, const double* in, double* out)
{
    HWY_DYNAMIC_DISPATCH(turnAllOfOne)(bands, turn, in, out);
}

} // namespace lumivdb::detail
#endif
