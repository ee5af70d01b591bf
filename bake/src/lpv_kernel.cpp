// SPDX-License-Identifier: Apache-2.0
#include "lpv_kernel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "lpv_kernel.cpp"
#include <hwy/foreach_target.h> // compiles what follows once per instruction set
#include <hwy/highway.h>

#include "lpv_link_inl.h"

HWY_BEFORE_NAMESPACE();
namespace lumivdb::detail {
namespace HWY_NAMESPACE {

namespace {

/// The cells one below (Up: light comes from there) or one above those at @a p, whose row begins
/// at z = 0 of a leaf; the cell outside the leaf is that of @a beyond, the row's neighbour.
template <bool Up> HWY_INLINE State loadShifted(const float* p, const float* beyond, int z)
{
    const Row d;
    constexpr std::size_t stride = kCoefficientStride;
    const auto n = static_cast<int>(hn::Lanes(d));
    State s = loadState(p + z + (Up ? -1 : 1), stride);
    if (Up ? z > 0 : z + n < kLeafWidth) return s;
    const auto own
        = Up ? hn::Not(hn::FirstN(d, 1)) : hn::FirstN(d, static_cast<std::size_t>(n - 1));
    const float* other = beyond + (Up ? kLeafWidth - 1 : 0);
    s.a = hn::IfThenElse(own, s.a, hn::Set(d, other[0]));
    for (std::size_t k = 0; k < 3; ++k)
        s.b[k] = hn::IfThenElse(own, s.b[k], hn::Set(d, other[(k + 1) * stride]));
    return s;
}

/// What stands between a row of cells and its neighbours.
struct RowFaces {
    const float* pass;
    const float* reflect;
    int face[3][2]; ///< number of the first cell's lower and upper face across each axis
};

/// Light of @a from that arrives along a link, less what is stopped on the way.
template <int Axis, bool Up, bool Clamp, bool Occlude>
HWY_INLINE void arrive(State from, const RowFaces& faces, Sums& sums)
{
    if constexpr (Occlude) {
        // What passes is the same share in all directions of the link: of the flux, of the state.
        const Vec pass
            = hn::LoadU(Row(), faces.pass + Axis * kFaceStride + faces.face[Axis][Up ? 0 : 1]);
        from.a = hn::Mul(from.a, pass);
        for (Vec& b : from.b) b = hn::Mul(b, pass);
    }
    receive<Axis, Up>(send<Axis, Up, Clamp>(from), sums);
}

/// Light that cells of state @a s send along a link and that comes back from what stops it there,
/// as a lobe against the link.
template <int Axis, bool Up, bool Clamp>
HWY_INLINE void comeBack(const State& s, const RowFaces& faces, int channel, State& result)
{
    const Row d;
    const Fluxes x = send<Axis, Up, Clamp>(s);
    const Vec sides = hn::Add(hn::Add(x.f[1], x.f[2]), hn::Add(x.f[3], x.f[4]));
    const Vec all = hn::Add(
        hn::Mul(hn::Set(d, kFrontWeight), x.f[0]), hn::Mul(hn::Set(d, kSideWeight), sides));
    const int face = faces.face[Axis][Up ? 1 : 0];
    const Vec pass = hn::LoadU(d, faces.pass + Axis * kFaceStride + face);
    const float* reflect
        = faces.reflect + ((Axis * 2 + (Up ? 0 : 1)) * 3 + channel) * kFaceStride + face;
    const Vec stopped = hn::Sub(hn::Set(d, 1.0f), pass);
    const Vec back = hn::Mul(hn::Mul(all, stopped), hn::LoadU(d, reflect));
    const Vec lobe = hn::Add(back, back);
    result.a = hn::Add(result.a, back);
    result.b[Axis] = Up ? hn::Sub(result.b[Axis], lobe) : hn::Add(result.b[Axis], lobe);
}

/// Rows of the six neighbours of a row, coefficient 0, and the row itself.
struct RowSources {
    const float *lower[3], *upper[3], *self;
};

template <bool Clamp, bool Occlude, bool Reflect>
HWY_INLINE State gatherChannel(const RowSources& rows, int channel, int z, const RowFaces& faces)
{
    constexpr int stride = kCoefficientStride;
    const int c = channel * 4 * stride;
    Sums sums = noSums();
    arrive<0, true, Clamp, Occlude>(loadState(rows.lower[0] + c + z, stride), faces, sums);
    arrive<0, false, Clamp, Occlude>(loadState(rows.upper[0] + c + z, stride), faces, sums);
    arrive<1, true, Clamp, Occlude>(loadState(rows.lower[1] + c + z, stride), faces, sums);
    arrive<1, false, Clamp, Occlude>(loadState(rows.upper[1] + c + z, stride), faces, sums);
    const float* self = rows.self + c;
    arrive<2, true, Clamp, Occlude>(loadShifted<true>(self, rows.lower[2] + c, z), faces, sums);
    arrive<2, false, Clamp, Occlude>(loadShifted<false>(self, rows.upper[2] + c, z), faces, sums);
    State result = fromSums(sums);
    if constexpr (Reflect) {
        const State own = loadState(self + z, stride);
        comeBack<0, true, Clamp>(own, faces, channel, result);
        comeBack<0, false, Clamp>(own, faces, channel, result);
        comeBack<1, true, Clamp>(own, faces, channel, result);
        comeBack<1, false, Clamp>(own, faces, channel, result);
        comeBack<2, true, Clamp>(own, faces, channel, result);
        comeBack<2, false, Clamp>(own, faces, channel, result);
    }
    return result;
}

HWY_INLINE Vec largest(Vec max, const State& s)
{
    for (const Vec& b : s.b) max = hn::Max(max, hn::Abs(b));
    return hn::Max(max, hn::Abs(s.a));
}

/// Per cell of a row, over rows: sums and maxima, lane by lane, so that they do not depend on the
/// width of vectors.
struct Lanes {
    float sum[3][kLeafWidth], max[kLeafWidth];
};

HWY_INLINE void store(const State (&s)[3], const LpvGather& g, int at, Lanes& lanes, int z)
{
    const Row d;
    Vec max = largest(largest(largest(hn::Zero(d), s[0]), s[1]), s[2]);
    if (g.inside) max = hn::Mul(max, hn::LoadU(d, g.inside + at));
    const auto lit = hn::And(hn::Ge(max, hn::Set(d, g.floor)), hn::Gt(max, hn::Zero(d)));
    hn::StoreU(
        hn::Max(hn::LoadU(d, lanes.max + z), hn::IfThenElseZero(lit, max)), d, lanes.max + z);
    for (int c = 0; c < 3; ++c) {
        float* next = g.next + at + c * 4 * kCoefficientStride;
        float* sum = g.sum + at + c * 4 * kCoefficientStride;
        const Vec a = hn::IfThenElseZero(lit, s[c].a);
        hn::StoreU(hn::Add(hn::LoadU(d, lanes.sum[c] + z), a), d, lanes.sum[c] + z);
        hn::StoreU(a, d, next);
        hn::StoreU(hn::Add(hn::LoadU(d, sum), a), d, sum);
        for (int k = 0; k < 3; ++k) {
            const Vec b = hn::IfThenElseZero(lit, s[c].b[k]);
            next += kCoefficientStride;
            sum += kCoefficientStride;
            hn::StoreU(b, d, next);
            hn::StoreU(hn::Add(hn::LoadU(d, sum), b), d, sum);
        }
    }
}

RowSources sourcesOf(const LpvGather& g, int x, int y)
{
    const int at = leafCell(x, y, 0), last = kLeafWidth - 1;
    RowSources rows;
    rows.self = g.self + at;
    rows.lower[0] = x > 0 ? rows.self - 64 : g.neighbours[0] + leafCell(last, y, 0);
    rows.upper[0] = x < last ? rows.self + 64 : g.neighbours[1] + leafCell(0, y, 0);
    rows.lower[1] = y > 0 ? rows.self - 8 : g.neighbours[2] + leafCell(x, last, 0);
    rows.upper[1] = y < last ? rows.self + 8 : g.neighbours[3] + leafCell(x, 0, 0);
    rows.lower[2] = g.neighbours[4] + at;
    rows.upper[2] = g.neighbours[5] + at;
    return rows;
}

RowFaces facesOf(const LpvGather& g, int x, int y, int z)
{
    RowFaces faces{g.pass, g.reflect, {}};
    for (int axis = 0; axis < 3; ++axis) {
        for (int side = 0; side < 2; ++side) {
            int cell[3] = {x, y, z};
            cell[axis] += side;
            faces.face[axis][side] = faceOf(axis, cell);
        }
    }
    return faces;
}

float largestOf(const float (&lanes)[kLeafWidth])
{
    float max = 0;
    for (const float v : lanes) max = v > max ? v : max;
    return max;
}

/// Adds the lanes of a row, or of a plane of rows, to the results.
void addRow(LpvGather& g, int x, int y, const Lanes& row)
{
    const float max = largestOf(row.max);
    const auto raise = [](float& at, float v) { at = v > at ? v : at; };
    if (x == 0) raise(g.faceMax[0], max);
    if (x == kLeafWidth - 1) raise(g.faceMax[1], max);
    if (y == 0) raise(g.faceMax[2], max);
    if (y == kLeafWidth - 1) raise(g.faceMax[3], max);
    raise(g.faceMax[4], row.max[0]);
    raise(g.faceMax[5], row.max[kLeafWidth - 1]);
    raise(g.max, max);
}

template <bool Clamp, bool Occlude, bool Reflect> void gatherRows(LpvGather& g)
{
    const int step = static_cast<int>(hn::Lanes(Row()));
    for (float& m : g.faceMax) m = 0;
    g.max = 0;
    double totals[3][kLeafWidth] = {};
    for (int x = 0; x < kLeafWidth; ++x) {
        Lanes plane = {};
        for (int y = 0; y < kLeafWidth; ++y) {
            const RowSources rows = sourcesOf(g, x, y);
            for (float& m : plane.max) m = 0;
            for (int z = 0; z < kLeafWidth; z += step) {
                RowFaces faces{};
                if constexpr (Occlude) faces = facesOf(g, x, y, z);
                const State s[3] = {gatherChannel<Clamp, Occlude, Reflect>(rows, 0, z, faces),
                    gatherChannel<Clamp, Occlude, Reflect>(rows, 1, z, faces),
                    gatherChannel<Clamp, Occlude, Reflect>(rows, 2, z, faces)};
                store(s, g, leafCell(x, y, z), plane, z);
            }
            addRow(g, x, y, plane);
        }
        for (int c = 0; c < 3; ++c)
            for (int z = 0; z < kLeafWidth; ++z)
                totals[c][z] += static_cast<double>(plane.sum[c][z]);
    }
    for (int c = 0; c < 3; ++c) {
        g.total[c] = 0;
        for (const double v : totals[c]) g.total[c] += v;
    }
}

template <bool Clamp> void gatherRowsFor(LpvGather& g)
{
    if (g.reflect) return gatherRows<Clamp, true, true>(g);
    if (g.pass) return gatherRows<Clamp, true, false>(g);
    gatherRows<Clamp, false, false>(g);
}

} // namespace

void gatherLeafRows(LpvGather& g)
{
    g.limit == FluxLimit::Positive ? gatherRowsFor<true>(g) : gatherRowsFor<false>(g);
}

} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lumivdb::detail {

// Ω_s = 2 atan(3/√11) − π/3 over 4π, and what is left of a sixth for the front.
const float kSideWeight = 0.0336955965593516898f;
const float kFrontWeight = static_cast<float>(1.0 / 6 - 4 * static_cast<double>(kSideWeight));

HWY_EXPORT(gatherLeafRows);

void gatherLeaf(LpvGather& gather) { HWY_DYNAMIC_DISPATCH(gatherLeafRows)(gather); }

} // namespace lumivdb::detail
#endif
