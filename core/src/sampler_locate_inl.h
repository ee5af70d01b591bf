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

constexpr int kMaxGroups = 16; // of eight lanes, six bands

struct Query {
    const std::byte* node[8];
    double p[3]; // lattice position
    float t[3]; // in the cell
    float size;
    int blocks;
    int level; // −1: outside
    unsigned mask; // corners that count
    unsigned usable; // corners with weight
    bool rows; // usable is not known
    const FormCutMore* cut;
    float cutT[3]; // in the cut cell, of which this may be a part
    std::uint32_t nodes[8];
    // On the way there:
    Coord v; // voxel
    const FormBlockHead* block;
    unsigned code;
    std::int32_t id;
};

// ---- Where a point is

HWY_INLINE bool isInLattice(const double* p)
{
    // Beyond any lattice (or NaN): outside, before a cast could overflow.
    constexpr double kLimit = 2147483000.0;
    return std::abs(p[0]) < kLimit && std::abs(p[1]) < kLimit && std::abs(p[2]) < kLimit;
}

HWY_INLINE void toLattice(const SamplerForm& f, const Vec3d& world, double* p)
{
    for (int a = 0; a < 3; ++a) {
        p[a] = world.x * f.toIndex[0][a] + world.y * f.toIndex[1][a] + world.z * f.toIndex[2][a]
            + f.toIndex[3][a];
    }
}

/// First step of a look-up: the block of the voxel, or the cell that is larger.
HWY_INLINE void findBlock(const SamplerForm& f, Query& q)
{
    q.block = nullptr;
    q.code = kEmptyCode;
    if (HWY_UNLIKELY(f.useTree)) {
        q.id = findInTree(f, q.v);
        if (q.id >= 0) q.code = kCellCode;
        return;
    }
    const Coord r = blockOf(q.v) - f.blockMin;
    if (static_cast<unsigned>(r.x) >= static_cast<unsigned>(f.blockDim.x)
        || static_cast<unsigned>(r.y) >= static_cast<unsigned>(f.blockDim.y)
        || static_cast<unsigned>(r.z) >= static_cast<unsigned>(f.blockDim.z)) {
        return;
    }
    const std::int32_t entry
        = f.table[(static_cast<std::size_t>(r.x) * f.blockDim.y + r.y) * f.blockDim.z + r.z];
    if (entry >= 0) {
        q.block = f.heads.data() + entry;
        if (q.block->codes >= 0) {
            hwy::Prefetch(f.codes.data()
                + static_cast<std::size_t>(q.block->codes) * SamplerForm::kBlockVoxels
                + voxelInBlock(q.v));
        }
        if (q.block->stepX == 0) {
            // Of a level-0 cell, most likely.
            const FormBlock::Row* row = f.blocks[static_cast<std::size_t>(q.block->rows)].row
                + 9 * (q.v.x & 7) + (q.v.y & 7);
            hwy::Prefetch(row);
            hwy::Prefetch(row + 9);
        }
    } else if (entry != SamplerForm::kEmptyBlock) {
        q.code = kCellCode;
        q.id = -2 - entry;
    }
}

/// Second step: what the voxel is of.
HWY_INLINE void findCode(const SamplerForm& f, Query& q)
{
    if (!q.block) return;
    const auto voxel = static_cast<std::size_t>(voxelInBlock(q.v));
    q.code = q.block->codes < 0
        ? 0
        : f.codes[static_cast<std::size_t>(q.block->codes) * SamplerForm::kBlockVoxels + voxel];
    if (q.code == kCutCode || q.code == kCellCode) {
        q.id = f.ids[static_cast<std::size_t>(q.block->ids) * SamplerForm::kBlockVoxels + voxel];
    }
}

HWY_INLINE void placeIn(const Coord& origin, float size, double inverse, Query& q, float* t)
{
    const double o[3] = {static_cast<double>(origin.x), static_cast<double>(origin.y),
        static_cast<double>(origin.z)};
    for (int a = 0; a < 3; ++a) {
        t[a] = static_cast<float>(std::min(std::max((q.p[a] - o[a]) * inverse, 0.0), 1.0));
    }
    q.size = size;
}

HWY_INLINE int octantOf(const float* t)
{
    return (t[0] >= 0.5f) | (t[1] >= 0.5f) << 1 | (t[2] >= 0.5f) << 2;
}

HWY_INLINE void takeNodes(const SamplerForm& f, bool wide, Query& q)
{
    const std::byte* base = wide ? f.wide.data() : f.records.data();
    const std::size_t stride = wide ? f.wideStride : f.stride;
    for (int i = 0; i < 8; ++i) q.node[i] = base + q.nodes[i] * stride;
    q.blocks = wide ? f.wideLayout.blocks : f.layout.blocks;
}

/// Third step for cells of a level below 3: corners by the block's rows.
HWY_INLINE void enterRows(const SamplerForm& f, int level, Query& q)
{
    const int size = 1 << level, within = 7 & -size;
    const int x = q.v.x & within, y = q.v.y & within, z = q.v.z & within;
    if (HWY_LIKELY(q.block->stepX != 0)) {
        const FormBlockHead& head = *q.block;
        const std::uint32_t first = head.first + static_cast<std::uint32_t>(x) * head.stepX
            + static_cast<std::uint32_t>(y) * head.stepY + static_cast<std::uint32_t>(z);
        const std::uint32_t corner[4]
            = {first, first + head.stepX, first + head.stepY, first + head.stepX + head.stepY};
        for (int i = 0; i < 4; ++i) {
            q.nodes[i] = corner[i];
            q.nodes[i + 4] = corner[i] + 1;
        }
    } else {
        const FormBlock::Row* row
            = f.blocks[static_cast<std::size_t>(q.block->rows)].row + 9 * x + y;
        const FormBlock::Row corner[4] = {row[0], row[9 * size], row[size], row[10 * size]};
        for (int i = 0; i < 4; ++i) {
            // The sample at z is there, so is the one at z + size.
            const std::uint32_t below = corner[i].present & ((1u << z) - 1);
            const std::uint32_t between = corner[i].present & ((1u << (z + size)) - (1u << z));
            q.nodes[i] = corner[i].first + static_cast<std::uint32_t>(__builtin_popcount(below));
            q.nodes[i + 4] = q.nodes[i] + static_cast<std::uint32_t>(__builtin_popcount(between));
        }
    }
    constexpr double kInverse[3] = {1, 0.5, 0.25};
    const Coord origin(q.v.x & -size, q.v.y & -size, q.v.z & -size);
    placeIn(origin, static_cast<float>(size), kInverse[level], q, q.t);
    takeNodes(f, false, q);
    q.level = level;
    q.mask = q.usable = 0xff;
    q.rows = true;
    q.cut = nullptr;
}

HWY_INLINE int regionOf(const FormCut& cut, const float* t)
{
    const float c[3] = {t[0] - 0.5f, t[1] - 0.5f, t[2] - 0.5f};
    int region = 0;
    for (int k = 0; k < 3; ++k) {
        const float* n = cut.normal[k];
        region |= (n[0] * c[0] + n[1] * c[1] + n[2] * c[2] >= cut.offset[k]) << k;
    }
    return region;
}

/// The same for cells that geometry cuts.
HWY_INLINE void enterCut(const SamplerForm& f, Query& q)
{
    const FormCut& cut = f.cuts[static_cast<std::size_t>(q.id)];
    enterRows(f, cut.level, q);
    q.mask = cut.masks >> (8 * regionOf(cut, q.t)) & 0xff;
    q.cut = f.cutsMore.data() + q.id;
    std::copy(q.t, q.t + 3, q.cutT);
}

/// The same for all others: down to the part that has nodes.
HWY_INLINE void enterCell(const SamplerForm& f, Query& q)
{
    const FormCell* cell = &f.cells[static_cast<std::size_t>(q.id)];
    q.level = cell->level;
    q.usable = cell->usable;
    q.rows = false;
    q.mask = 0xff;
    q.cut = nullptr;
    std::int32_t parts = cell->kind == FormCell::Split ? cell->next : -1;
    if (HWY_UNLIKELY(cell->kind == FormCell::Cut)) {
        q.cut = f.cutsMore.data() + cell->next;
        placeIn(cell->origin, cell->size, static_cast<double>(cell->inverseSize), q, q.cutT);
        const FormCut& cut = f.cuts[static_cast<std::size_t>(cell->next)];
        const int region = regionOf(cut, q.cutT);
        parts = q.cut->split[region];
        q.mask = parts < 0 ? cut.masks >> (8 * region) & 0xff : 0xff;
    }
    if (parts >= 0) {
        placeIn(cell->origin, cell->size, static_cast<double>(cell->inverseSize), q, q.t);
        cell = &f.cells[static_cast<std::size_t>(parts + octantOf(q.t))];
    }
    placeIn(cell->origin, cell->size, static_cast<double>(cell->inverseSize), q, q.t);
    std::copy(cell->node, cell->node + 8, q.nodes);
    takeNodes(f, cell->wide, q);
}

HWY_INLINE void enterSpecial(const SamplerForm& f, Query& q)
{
    q.code == kCutCode ? enterCut(f, q) : enterCell(f, q);
}

/// Where the point's own voxel is empty: the cells that it lies on a face of.
HWY_NOINLINE void enterByFace(const SamplerForm& f, Query& q)
{
    q.level = -1;
    if (!isInLattice(q.p)) return;
    int candidates[3][2];
    int count[3];
    for (int a = 0; a < 3; ++a) {
        const double nearest = std::round(q.p[a]);
        candidates[a][0] = static_cast<int>(std::floor(q.p[a]));
        count[a] = 1;
        if (std::abs(q.p[a] - nearest) < SamplerForm::kFaceTolerance) {
            const int below = static_cast<int>(nearest) - 1;
            candidates[a][1] = candidates[a][0] == below ? below + 1 : below;
            count[a] = 2;
        }
    }
    for (int x = 0; x < count[0]; ++x)
        for (int y = 0; y < count[1]; ++y)
            for (int z = 0; z < count[2]; ++z) {
                q.v = Coord(candidates[0][x], candidates[1][y], candidates[2][z]);
                findBlock(f, q);
                findCode(f, q);
                if (q.code == kEmptyCode) continue;
                q.code < kCutCode ? enterRows(f, static_cast<int>(q.code), q) : enterSpecial(f, q);
                return;
            }
}

// ---- Weights

HWY_INLINE void linearWeights(const float* t, float* w)
{
    const float x = t[0], y = t[1], z = t[2];
    const float x1 = 1.0f - x, y1 = 1.0f - y, z1 = 1.0f - z;
    const float xy[4] = {x1 * y1, x * y1, x1 * y, x * y};
    for (int i = 0; i < 4; ++i) {
        w[i] = xy[i] * z1;
        w[i + 4] = xy[i] * z;
    }
}

/// Taylor expansions at the corners: gradients weigh as values do, times the way from the corner.
HWY_INLINE void taylorWeights(const Query& q, float* w)
{
    for (int a = 0; a < 3; ++a) {
        const float d[2] = {q.t[a] * q.size, (q.t[a] - 1.0f) * q.size};
        for (int i = 0; i < 8; ++i) w[8 * (a + 1) + i] = w[i] * d[i >> a & 1];
    }
}

/// Half the way, as sampler.h says of Interpolation::Gradient. Where the mask leaves corners out,
/// the mean way from the others is not zero; half of that is added, which keeps linear functions.
HWY_INLINE void halfTaylorWeights(const Query& q, float* w)
{
    float way[3][2], mean[3] = {0, 0, 0};
    for (int a = 0; a < 3; ++a) {
        way[a][0] = q.t[a] * q.size;
        way[a][1] = (q.t[a] - 1.0f) * q.size;
    }
    if (HWY_UNLIKELY(q.mask != 0xff)) {
        float sum = 0;
        for (int i = 0; i < 8; ++i) {
            if (!(q.mask >> i & 1)) continue;
            sum += w[i];
            for (int a = 0; a < 3; ++a) mean[a] += w[i] * way[a][i >> a & 1];
        }
        for (float& m : mean) m = sum > 0 ? m / sum : 0.0f;
    }
    for (int a = 0; a < 3; ++a) {
        const float d[2] = {0.5f * (way[a][0] + mean[a]), 0.5f * (way[a][1] + mean[a])};
        for (int i = 0; i < 8; ++i) w[8 * (a + 1) + i] = w[i] * d[i >> a & 1];
    }
}

HWY_INLINE void hermiteWeights(const Query& q, float* w)
{
    float h[3][2][2]; // axis, derivative or value, end
    for (int a = 0; a < 3; ++a) {
        const float t = q.t[a], u = 1.0f - t;
        h[a][0][0] = (1.0f + 2.0f * t) * u * u;
        h[a][0][1] = (1.0f + 2.0f * u) * t * t;
        h[a][1][0] = t * u * u * q.size;
        h[a][1][1] = -(u * t * t) * q.size;
    }
    for (int b = 0; b < q.blocks; ++b) {
        const int axes = kBlockAxes[b];
        const float *x = h[0][axes & 1], *y = h[1][axes >> 1 & 1], *z = h[2][axes >> 2];
        for (int i = 0; i < 8; ++i) w[8 * b + i] = x[i & 1] * y[i >> 1 & 1] * z[i >> 2];
    }
}

HWY_INLINE float recordNumber(const SamplerForm& f, const std::byte* record, int lane)
{
    if (f.layout.scalarBytes == 4) return reinterpret_cast<const float*>(record)[lane];
    Imath::half h;
    h.setBits(reinterpret_cast<const std::uint16_t*>(record)[lane]);
    return h;
}

/// The nearest corner with weight takes all.
HWY_NOINLINE void nearestWeights(const SamplerForm& f, Query& q, float* w)
{
    unsigned candidates = q.usable;
    if (q.rows) {
        candidates = 0;
        for (int i = 0; i < 8; ++i)
            if (recordNumber(f, q.node[i], f.layout.weightLane()) > 0) candidates |= 1u << i;
    }
    if (candidates & q.mask) candidates &= q.mask;
    int best = 0;
    float least = std::numeric_limits<float>::infinity();
    for (int i = 0; i < 8; ++i) {
        if (!(candidates >> i & 1)) continue;
        float distance = 0;
        for (int a = 0; a < 3; ++a) {
            const float d = q.t[a] - static_cast<float>(i >> a & 1);
            distance += d * d;
        }
        if (distance < least) {
            least = distance;
            best = i;
        }
    }
    for (int i = 0; i < 8; ++i) {
        w[i] = i == best ? 1.0f : 0.0f;
        q.node[i] = q.node[best];
    }
    q.mask = 0xff;
}

/// Two modes are compiled apart, since most queries are theirs; kAnyMode asks the form.
constexpr Interpolation kAnyMode = static_cast<Interpolation>(-1);

template <Interpolation Mode> constexpr int blocksOf(const Query& q)
{
    return Mode == Interpolation::Trilinear ? 1 : Mode == Interpolation::Gradient ? 4 : q.blocks;
}

template <Interpolation Mode> HWY_INLINE void setWeights(const SamplerForm& f, Query& q, float* w)
{
    switch (Mode == kAnyMode ? f.options.mode : Mode) {
    case Interpolation::Nearest:
        nearestWeights(f, q, w);
        break;
    case Interpolation::Taylor:
        nearestWeights(f, q, w);
        // All weight on one corner: ways from the others do not matter.
        taylorWeights(q, w);
        break;
    case Interpolation::Trilinear:
    case Interpolation::InverseDistance:
        linearWeights(q.t, w);
        break;
    case Interpolation::Gradient:
        linearWeights(q.t, w);
        halfTaylorWeights(q, w);
        break;
    case Interpolation::Tricubic:
        hermiteWeights(q, w);
        break;
    }
    if (HWY_LIKELY(q.mask == 0xff)) return;
    for (int b = 0; b < blocksOf<Mode>(q); ++b)
        for (int i = 0; i < 8; ++i)
            if (!(q.mask >> i & 1)) w[8 * b + i] = 0;
}

/// 0 · ∞ is not a number: corners without weight are not to be read where a volume has infinities.
HWY_NOINLINE void avoidInfinite(Query& q, const float* w)
{
    alignas(64) static const std::byte kZeros[kMaxGroups * 8 * 8 * sizeof(float)] = {};
    for (int i = 0; i < 8; ++i) {
        bool weight = false;
        for (int b = 0; b < q.blocks; ++b) weight = weight || w[8 * b + i] != 0;
        if (!weight) q.node[i] = kZeros;
    }
}

} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#endif
