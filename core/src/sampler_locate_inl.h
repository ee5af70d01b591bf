// SPDX-License-Identifier: Apache-2.0

/// @file sampler_locate_inl.h
/// The part of sampler_kernels.cpp that finds a point's nodes and their weights. Compiled once for
/// each target, hence Highway's kind of include guard.

#if defined(LUMIVDB_SAMPLER_LOCATE_INL_H) == defined(HWY_TARGET_TOGGLE)
#ifdef LUMIVDB_SAMPLER_LOCATE_INL_H
#undef LUMIVDB_SAMPLER_LOCATE_INL_H
#else
#define LUMIVDB_SAMPLER_LOCATE_INL_H
#endif

#include "sampler_form.h"

#include <Imath/half.h>
#include <hwy/cache_control.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <limits>

HWY_BEFORE_NAMESPACE();
namespace lumivdb::detail {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

constexpr int kMaxGroups = 16; // of eight lanes, six bands

/// What differs between queries in more than numbers.
struct Query {
    const std::byte* node[8];
    int blocks;
    int level; // −1: outside
    unsigned usable; // corners with weight
    bool rows; // usable is not known
    const FormCut* region; // that the mask is still to be had from
    const FormCutMore* cut;
    float cutT[3]; // in the cut cell, of which this may be a part
    // On the way there:
    const FormColumn* column;
    const FormLattice* lattice;
    unsigned code;
    std::int32_t id;
};

/// Size queries at once; numbers of query i are at [i], so that vectors hold those of many. Rows
/// are weights of a query, eight a block.
template <int Size, int Rows> struct alignas(64) Batch {
    static constexpr int kSize = Size;
    static constexpr int kRows = Rows;
    double p[3][Size]; // world position, then that in the lattice
    std::int32_t voxel[3][Size];
    std::int32_t origin[3][Size]; // of the cell
    float size[Size];
    float t[3][Size]; // in the cell
    std::int32_t mask[Size]; // corners that count
    float weight[Rows][Size];
    Query query[Size];
};

// ---- Where a point is

// Beyond any lattice (or NaN): outside, before a cast could overflow.
constexpr double kLatticeLimit = 2147483000.0;

template <class B> HWY_INLINE bool isInLattice(const B& b, int i)
{
    return std::abs(b.p[0][i]) < kLatticeLimit && std::abs(b.p[1][i]) < kLatticeLimit
        && std::abs(b.p[2][i]) < kLatticeLimit;
}

/// World positions to lattice positions and voxels.
template <class B> HWY_INLINE void toLattice(const SamplerForm& f, B& b)
{
    const hn::CappedTag<double, B::kSize> d;
    const hn::Rebind<std::int32_t, decltype(d)> voxels;
    const auto limit = hn::Set(d, kLatticeLimit);
    for (int i = 0; i < B::kSize; i += static_cast<int>(hn::MaxLanes(d))) {
        const auto x = hn::Load(d, b.p[0] + i), y = hn::Load(d, b.p[1] + i),
                   z = hn::Load(d, b.p[2] + i);
        for (int a = 0; a < 3; ++a) {
            auto q = hn::Mul(x, hn::Set(d, f.toIndex[0][a]));
            q = hn::Add(q, hn::Mul(y, hn::Set(d, f.toIndex[1][a])));
            q = hn::Add(q, hn::Mul(z, hn::Set(d, f.toIndex[2][a])));
            q = hn::Add(q, hn::Set(d, f.toIndex[3][a]));
            hn::Store(q, d, b.p[a] + i);
            const auto v = hn::IfThenElse(
                hn::Lt(hn::Abs(q), limit), hn::Floor(q), hn::Set(d, -kLatticeLimit));
            hn::Store(hn::DemoteTo(voxels, v), voxels, b.voxel[a] + i);
        }
    }
}

/// First step of a look-up: the column of the voxel, or the cell that is larger.
HWY_INLINE void findColumn(const SamplerForm& f, const Coord& v, Query& q)
{
    q.column = nullptr;
    q.lattice = nullptr;
    q.code = kEmptyCode;
    q.level = -1;
    if (HWY_UNLIKELY(f.useTree)) {
        q.id = findInTree(f, v);
        if (q.id >= 0) q.code = kCellCode;
        return;
    }
    const Coord r = blockOf(v) - f.blockMin;
    if (static_cast<unsigned>(r.x) >= static_cast<unsigned>(f.blockDim.x)
        || static_cast<unsigned>(r.y) >= static_cast<unsigned>(f.blockDim.y)
        || static_cast<unsigned>(r.z) >= static_cast<unsigned>(f.blockDim.z)) {
        return;
    }
    const std::int32_t entry
        = f.table[(static_cast<std::size_t>(r.x) * f.blockDim.y + r.y) * f.blockDim.z + r.z];
    if (entry >= 0) {
        const auto at = static_cast<std::size_t>(entry >> 1);
        if (entry & 1) {
            q.lattice = f.lattices.data() + at;
            q.code = 0;
        } else {
            q.column = f.columns.data() + at * SamplerForm::kColumns
                + ((v.x & 7) * SamplerForm::kBlockSize + (v.y & 7));
            hwy::Prefetch(q.column);
        }
    } else if (entry != SamplerForm::kEmptyBlock) {
        q.code = kCellCode;
        q.id = -2 - entry;
    }
}

/// Second step: what the voxel is of.
HWY_INLINE void findCode(const Coord& v, Query& q)
{
    if (!q.column) return;
    q.code = q.column->code[v.z & 7];
    q.id = q.column->id[v.z & 7];
}

template <class B> HWY_INLINE void setPlace(const Coord& origin, float size, B& b, int i)
{
    for (int a = 0; a < 3; ++a) b.origin[a][i] = origin[a];
    b.size[i] = size;
}

/// Third step for cells of a level below 3: corners by rows of samples.
template <class B> HWY_INLINE void enterRows(const SamplerForm& f, const Coord& v, B& b, int i)
{
    Query& q = b.query[i];
    const bool cut = q.code >= kCutCode;
    const int level = static_cast<int>(cut ? q.code - kCutCode : q.code), size = 1 << level;
    const std::byte* records = f.records.data();
    if (q.lattice) {
        const FormLattice& l = *q.lattice;
        const std::uint32_t first = l.first + static_cast<std::uint32_t>(v.x & 7) * l.stepX
            + static_cast<std::uint32_t>(v.y & 7) * l.stepY + static_cast<std::uint32_t>(v.z & 7);
        const std::uint32_t corner[4]
            = {first, first + l.stepX, first + l.stepY, first + l.stepX + l.stepY};
        for (int k = 0; k < 4; ++k) {
            q.node[k] = records + corner[k] * f.stride;
            q.node[k + 4] = q.node[k] + f.stride;
        }
    } else {
        const FormColumn& column = *q.column;
        const int z = v.z & 7 & -size;
        // The sample at z is there, so is the one at z + size.
        const unsigned below = (1u << z) - 1, between = ((1u << size) - 1) << z;
        for (int k = 0; k < 4; ++k) {
            const unsigned present = column.present[k];
            const std::uint32_t node
                = column.first[k] + static_cast<std::uint32_t>(__builtin_popcount(present & below));
            const auto step = static_cast<std::size_t>(__builtin_popcount(present & between));
            q.node[k] = records + node * f.stride;
            q.node[k + 4] = q.node[k] + step * f.stride;
        }
    }
    setPlace({v.x & -size, v.y & -size, v.z & -size}, static_cast<float>(size), b, i);
    b.mask[i] = 0xff;
    q.blocks = f.layout.blocks;
    q.level = level;
    q.usable = 0xff;
    q.rows = true;
    q.region = nullptr;
    q.cut = nullptr;
    if (cut) {
        q.region = f.cuts.data() + q.id;
        q.cut = f.cutsMore.data() + q.id;
        hwy::Prefetch(q.region);
    }
}

HWY_INLINE float placeIn(double p, int origin, float size)
{
    return static_cast<float>(std::min(std::max((p - origin) * (1.0 / size), 0.0), 1.0));
}

HWY_INLINE unsigned maskOf(const FormCut& cut, const float* t, int& region)
{
    const float c[3] = {t[0] - 0.5f, t[1] - 0.5f, t[2] - 0.5f};
    region = 0;
    for (int k = 0; k < 3; ++k) {
        const float* n = cut.normal[k];
        region |= (n[0] * c[0] + n[1] * c[1] + n[2] * c[2] >= cut.offset[k]) << k;
    }
    return cut.masks >> (8 * region) & 0xff;
}

/// The same for all others: down to the part that has nodes.
template <class B> HWY_INLINE void enterCell(const SamplerForm& f, B& b, int i)
{
    Query& q = b.query[i];
    const FormCell* cell = &f.cells[static_cast<std::size_t>(q.id)];
    q.level = cell->level;
    q.usable = cell->usable;
    q.rows = false;
    q.region = nullptr;
    q.cut = nullptr;
    b.mask[i] = 0xff;
    if (cell->kind != FormCell::Whole) {
        float t[3];
        for (int a = 0; a < 3; ++a) t[a] = placeIn(b.p[a][i], cell->origin[a], cell->size);
        std::int32_t parts = cell->next;
        if (cell->kind == FormCell::Cut) {
            int region;
            const unsigned mask = maskOf(f.cuts[static_cast<std::size_t>(cell->next)], t, region);
            q.cut = f.cutsMore.data() + cell->next;
            std::copy(t, t + 3, q.cutT);
            parts = q.cut->split[region];
            if (parts < 0) b.mask[i] = static_cast<std::int32_t>(mask);
        }
        const int octant = (t[0] >= 0.5f) | (t[1] >= 0.5f) << 1 | (t[2] >= 0.5f) << 2;
        if (parts >= 0) cell = &f.cells[static_cast<std::size_t>(parts + octant)];
    }
    const std::byte* base = cell->wide ? f.wide.data() : f.records.data();
    const std::size_t stride = cell->wide ? f.wideStride : f.stride;
    for (int k = 0; k < 8; ++k) q.node[k] = base + cell->node[k] * stride;
    q.blocks = cell->wide ? f.wideLayout.blocks : f.layout.blocks;
    setPlace(cell->origin, cell->size, b, i);
}

template <class B> HWY_INLINE Coord voxelOf(const B& b, int i)
{
    return {b.voxel[0][i], b.voxel[1][i], b.voxel[2][i]};
}

/// Where the point's own voxel is empty: the cells that it lies on a face of.
template <class B> HWY_NOINLINE void enterByFace(const SamplerForm& f, B& b, int i)
{
    Query& q = b.query[i];
    setPlace({0, 0, 0}, 1, b, i);
    b.mask[i] = 0xff;
    q.region = nullptr;
    if (!isInLattice(b, i)) return;
    int candidates[3][2];
    int count[3];
    for (int a = 0; a < 3; ++a) {
        const double p = b.p[a][i], nearest = std::round(p);
        candidates[a][0] = static_cast<int>(std::floor(p));
        count[a] = 1;
        if (std::abs(p - nearest) < SamplerForm::kFaceTolerance) {
            const int below = static_cast<int>(nearest) - 1;
            candidates[a][1] = candidates[a][0] == below ? below + 1 : below;
            count[a] = 2;
        }
    }
    for (int x = 0; x < count[0]; ++x)
        for (int y = 0; y < count[1]; ++y)
            for (int z = 0; z < count[2]; ++z) {
                const Coord v(candidates[0][x], candidates[1][y], candidates[2][z]);
                findColumn(f, v, q);
                findCode(v, q);
                if (q.code == kEmptyCode) continue;
                q.code < kCellCode ? enterRows(f, v, b, i) : enterCell(f, b, i);
                return;
            }
}

template <class B> HWY_INLINE void enterSpecial(const SamplerForm& f, B& b, int i)
{
    b.query[i].code == kEmptyCode ? enterByFace(f, b, i) : enterCell(f, b, i);
}

/// Last step: places in the cells, and masks that depend on them.
template <class B> HWY_INLINE void setPlaces(int count, B& b)
{
    for (int i = count; i < B::kSize; ++i) {
        setPlace({0, 0, 0}, 1, b, i);
        b.mask[i] = 0xff;
    }
    const hn::CappedTag<double, B::kSize> d;
    const hn::Rebind<std::int32_t, decltype(d)> ints;
    const hn::Rebind<float, decltype(d)> floats;
    for (int i = 0; i < B::kSize; i += static_cast<int>(hn::MaxLanes(d))) {
        const auto inverse
            = hn::Div(hn::Set(d, 1.0), hn::PromoteTo(d, hn::Load(floats, b.size + i)));
        for (int a = 0; a < 3; ++a) {
            const auto origin = hn::PromoteTo(d, hn::Load(ints, b.origin[a] + i));
            auto t = hn::Mul(hn::Sub(hn::Load(d, b.p[a] + i), origin), inverse);
            t = hn::Min(hn::Max(t, hn::Zero(d)), hn::Set(d, 1.0));
            hn::Store(hn::DemoteTo(floats, t), floats, b.t[a] + i);
        }
    }
    for (int i = 0; i < count; ++i) {
        Query& q = b.query[i];
        if (HWY_LIKELY(!q.region)) continue;
        for (int a = 0; a < 3; ++a) q.cutT[a] = b.t[a][i];
        int region;
        b.mask[i] = static_cast<std::int32_t>(maskOf(*q.region, q.cutT, region));
    }
}

// ---- Weights

/// Products of the corners' shares along the axes. To eight rows.
template <class D> HWY_INLINE void linearWeights(D d, const hn::Vec<D>* t, hn::Vec<D>* w)
{
    const auto one = hn::Set(d, 1.0f);
    const auto x1 = hn::Sub(one, t[0]), y1 = hn::Sub(one, t[1]), z1 = hn::Sub(one, t[2]);
    const hn::Vec<D> xy[4]
        = {hn::Mul(x1, y1), hn::Mul(t[0], y1), hn::Mul(x1, t[1]), hn::Mul(t[0], t[1])};
    for (int i = 0; i < 4; ++i) {
        w[i] = hn::Mul(xy[i], z1);
        w[i + 4] = hn::Mul(xy[i], t[2]);
    }
}

/// Gradients weigh as values do, times half the way from the corner, as sampler.h says of
/// Interpolation::Gradient. Where the mask leaves corners out, the mean way from the others is not
/// zero; half of that is added, which keeps linear functions.
template <class D>
HWY_INLINE void halfTaylorWeights(D d, const hn::Vec<D>* t, hn::Vec<D> size, hn::Mask<D> all,
    const hn::Vec<D>* w, hn::Vec<D> (*out)[8])
{
    const auto half = hn::Set(d, 0.5f);
    auto sum = hn::Zero(d);
    for (int i = 0; i < 8; ++i) sum = hn::Add(sum, w[i]);
    const auto none = hn::Or(all, hn::Not(hn::Gt(sum, hn::Zero(d))));
    for (int a = 0; a < 3; ++a) {
        const hn::Vec<D> way[2]
            = {hn::Mul(t[a], size), hn::Mul(hn::Sub(t[a], hn::Set(d, 1.0f)), size)};
        auto mean = hn::Zero(d);
        if (!hn::AllTrue(d, none)) {
            for (int i = 0; i < 8; ++i) mean = hn::Add(mean, hn::Mul(w[i], way[i >> a & 1]));
            mean = hn::IfThenElse(none, hn::Zero(d), hn::Div(mean, sum));
        }
        const hn::Vec<D> moved[2]
            = {hn::Mul(half, hn::Add(way[0], mean)), hn::Mul(half, hn::Add(way[1], mean))};
        for (int i = 0; i < 8; ++i) out[a][i] = hn::Mul(w[i], moved[i >> a & 1]);
    }
}

/// Two modes are compiled apart, since most queries are theirs; kAnyMode asks the form.
constexpr Interpolation kAnyMode = static_cast<Interpolation>(-1);

template <Interpolation Mode> constexpr int rowsOf()
{
    return Mode == Interpolation::Trilinear ? 8 : Mode == Interpolation::Gradient ? 32 : 64;
}

template <Interpolation Mode> constexpr int blocksOf(const Query& q)
{
    return Mode == kAnyMode ? q.blocks : rowsOf<Mode>() / 8;
}

/// Trilinear weights, and those of gradients in that mode.
template <Interpolation Mode, class B> HWY_INLINE void setWeights(const SamplerForm& f, B& b)
{
    const hn::CappedTag<float, B::kSize> d;
    const hn::Rebind<std::int32_t, decltype(d)> ints;
    using V = hn::Vec<decltype(d)>;
    const bool gradients = (Mode == kAnyMode ? f.options.mode : Mode) == Interpolation::Gradient;
    for (int k = 0; k < B::kSize; k += static_cast<int>(hn::MaxLanes(d))) {
        const V t[3] = {hn::Load(d, b.t[0] + k), hn::Load(d, b.t[1] + k), hn::Load(d, b.t[2] + k)};
        const auto mask = hn::Load(ints, b.mask + k);
        V w[8];
        linearWeights(d, t, w);
        for (int i = 0; i < 8; ++i) {
            const auto counts = hn::TestBit(mask, hn::Set(ints, 1 << i));
            w[i] = hn::IfThenElseZero(hn::RebindMask(d, counts), w[i]);
            hn::Store(w[i], d, b.weight[i] + k);
        }
        if constexpr (B::kRows >= 32) {
            if (!gradients) continue;
            const auto all = hn::RebindMask(d, hn::Eq(mask, hn::Set(ints, 0xff)));
            V more[3][8];
            halfTaylorWeights(d, t, hn::Load(d, b.size + k), all, w, more);
            for (int a = 0; a < 3; ++a)
                for (int i = 0; i < 8; ++i) hn::Store(more[a][i], d, b.weight[8 * (a + 1) + i] + k);
        }
    }
}

HWY_INLINE float recordNumber(const SamplerForm& f, const std::byte* record, int lane)
{
    if (f.layout.scalarBytes == 4) return reinterpret_cast<const float*>(record)[lane];
    Imath::half h;
    h.setBits(reinterpret_cast<const std::uint16_t*>(record)[lane]);
    return h;
}

HWY_INLINE std::uint32_t nodeAt(const SamplerForm& f, const std::byte* record)
{
    return static_cast<std::uint32_t>(
        static_cast<std::size_t>(record - f.records.data()) / f.stride);
}

/// The nearest corner with weight takes all; Taylor moves it by its gradient.
template <class B> HWY_INLINE void setNearestWeights(const SamplerForm& f, B& b, int k)
{
    Query& q = b.query[k];
    unsigned candidates = q.usable;
    if (q.rows) {
        candidates = 0;
        for (int i = 0; i < 8; ++i)
            if (recordNumber(f, q.node[i], f.layout.weightLane()) > 0) candidates |= 1u << i;
    }
    const auto mask = static_cast<unsigned>(b.mask[k]);
    if (candidates & mask) candidates &= mask;
    int best = 0;
    float least = std::numeric_limits<float>::infinity();
    for (int i = 0; i < 8; ++i) {
        if (!(candidates >> i & 1)) continue;
        float distance = 0;
        for (int a = 0; a < 3; ++a) {
            const float d = b.t[a][k] - static_cast<float>(i >> a & 1);
            distance += d * d;
        }
        if (distance < least) {
            least = distance;
            best = i;
        }
    }
    b.mask[k] = 0xff;
    for (int i = 0; i < 8; ++i) {
        q.node[i] = q.node[best];
        b.weight[i][k] = i == best ? 1.0f : 0.0f;
        for (int a = 0; a < 3; ++a) {
            const float way = (b.t[a][k] - static_cast<float>(i >> a & 1)) * b.size[k];
            b.weight[8 * (a + 1) + i][k] = b.weight[i][k] * way;
        }
    }
}

template <class B> HWY_INLINE void setHermiteWeights(B& b, int k)
{
    float h[3][2][2]; // axis, derivative or value, end
    const float size = b.size[k];
    for (int a = 0; a < 3; ++a) {
        const float t = b.t[a][k], u = 1.0f - t;
        h[a][0][0] = (1.0f + 2.0f * t) * u * u;
        h[a][0][1] = (1.0f + 2.0f * u) * t * t;
        h[a][1][0] = t * u * u * size;
        h[a][1][1] = -(u * t * t) * size;
    }
    for (int block = 0; block < b.query[k].blocks; ++block) {
        const int axes = kBlockAxes[block];
        const float *x = h[0][axes & 1], *y = h[1][axes >> 1 & 1], *z = h[2][axes >> 2];
        for (int i = 0; i < 8; ++i)
            b.weight[8 * block + i][k]
                = b.mask[k] >> i & 1 ? x[i & 1] * y[i >> 1 & 1] * z[i >> 2] : 0.0f;
    }
}

/// Weights of the modes that are not made of the trilinear ones.
template <class B> HWY_NOINLINE void setOtherWeights(const SamplerForm& f, B& b, int k)
{
    switch (f.options.mode) {
    case Interpolation::Nearest:
    case Interpolation::Taylor:
        setNearestWeights(f, b, k);
        break;
    case Interpolation::Tricubic:
        setHermiteWeights(b, k);
        break;
    default:
        break;
    }
}

/// 0 · ∞ is not a number: corners without weight are not to be read where a volume has infinities.
template <class B> HWY_NOINLINE void avoidInfinite(B& b, int k)
{
    alignas(64) static const std::byte kZeros[kMaxGroups * 8 * 8 * sizeof(float)] = {};
    Query& q = b.query[k];
    for (int i = 0; i < 8; ++i) {
        bool weight = false;
        for (int block = 0; block < q.blocks; ++block)
            weight = weight || b.weight[8 * block + i][k] != 0;
        if (!weight) q.node[i] = kZeros;
    }
}

} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#endif
