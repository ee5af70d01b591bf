// SPDX-License-Identifier: Apache-2.0
// The arithmetic of one link, for vectors of cells; compiled once per instruction set by the files
// that include it (hence the guard that Highway toggles).

#if defined(LUMIVDB_LPV_LINK_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LUMIVDB_LPV_LINK_INL_H
#undef LUMIVDB_LPV_LINK_INL_H
#else
#define LUMIVDB_LPV_LINK_INL_H
#endif

#include "lpv_kernel.h"

#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace lumivdb::detail {
namespace HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
/// A row of a leaf is eight cells.
using Row = hn::CappedTag<float, kLeafWidth>;
using Vec = hn::Vec<Row>;

constexpr float kAlong = 0.8944271909999159f; // 2/√5
constexpr float kAcross = 0.4472135954999579f; // 1/√5

/// A and B of some cells, one channel.
struct State {
    Vec a, b[3];
};

/// Fluxes over Ω of a link: front, and towards the side faces +u, −u, +v, −v.
struct Fluxes {
    Vec f[5];
};

template <bool Clamp> HWY_INLINE Vec limited(Vec v)
{
    if constexpr (Clamp) return hn::Max(v, hn::Zero(Row()));
    return v;
}

/// What cells of state @a s send along the link Up ? +Axis : −Axis.
template <int Axis, bool Up, bool Clamp> HWY_INLINE Fluxes send(const State& s)
{
    const Row d;
    const Vec along = hn::Mul(hn::Set(d, kAlong), s.b[Axis]);
    const Vec front = Up ? hn::Add(s.a, s.b[Axis]) : hn::Sub(s.a, s.b[Axis]);
    const Vec middle = Up ? hn::Add(s.a, along) : hn::Sub(s.a, along);
    const Vec u = hn::Mul(hn::Set(d, kAcross), s.b[(Axis + 1) % 3]);
    const Vec v = hn::Mul(hn::Set(d, kAcross), s.b[(Axis + 2) % 3]);
    return {{limited<Clamp>(front), limited<Clamp>(hn::Add(middle, u)),
        limited<Clamp>(hn::Sub(middle, u)), limited<Clamp>(hn::Add(middle, v)),
        limited<Clamp>(hn::Sub(middle, v))}};
}

/// Sums over the links of some cells: fluxes through front and side faces, and their differences
/// along the axes.
struct Sums {
    Vec front, side, frontAlong[3], sideAlong[3];
};

HWY_INLINE Sums noSums()
{
    const Vec zero = hn::Zero(Row());
    return {zero, zero, {zero, zero, zero}, {zero, zero, zero}};
}

template <int Axis, bool Up> HWY_INLINE void receive(const Fluxes& x, Sums& sums)
{
    constexpr int u = (Axis + 1) % 3, v = (Axis + 2) % 3;
    sums.front = hn::Add(sums.front, x.f[0]);
    sums.frontAlong[Axis]
        = Up ? hn::Add(sums.frontAlong[Axis], x.f[0]) : hn::Sub(sums.frontAlong[Axis], x.f[0]);
    sums.side = hn::Add(sums.side, hn::Add(hn::Add(x.f[1], x.f[2]), hn::Add(x.f[3], x.f[4])));
    sums.sideAlong[u] = hn::Add(sums.sideAlong[u], hn::Sub(x.f[1], x.f[2]));
    sums.sideAlong[v] = hn::Add(sums.sideAlong[v], hn::Sub(x.f[3], x.f[4]));
}

HWY_INLINE State fromSums(const Sums& sums)
{
    const Row d;
    const Vec front = hn::Set(d, kFrontWeight), side = hn::Set(d, kSideWeight);
    const Vec front2 = hn::Set(d, 2 * kFrontWeight), side2 = hn::Set(d, 2 * kSideWeight);
    State s;
    s.a = hn::Add(hn::Mul(front, sums.front), hn::Mul(side, sums.side));
    for (int k = 0; k < 3; ++k) {
        s.b[k] = hn::Add(hn::Mul(front2, sums.frontAlong[k]), hn::Mul(side2, sums.sideAlong[k]));
    }
    return s;
}

HWY_INLINE State loadState(const float* p, std::ptrdiff_t stride)
{
    const Row d;
    return {hn::LoadU(d, p),
        {hn::LoadU(d, p + stride), hn::LoadU(d, p + 2 * stride), hn::LoadU(d, p + 3 * stride)}};
}

} // namespace
} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#endif
