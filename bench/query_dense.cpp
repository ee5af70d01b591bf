// SPDX-License-Identifier: Apache-2.0
#include "query_contenders.h"

#include <lumivdb/core/sh.h>

#include <Imath/half.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>

#ifdef __linux__
#include <sys/mman.h>
#endif

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "query_dense.cpp"
#include <hwy/foreach_target.h> // compiles this file once for each target

#include <hwy/cache_control.h>
#include <hwy/highway.h>

#ifndef LUMIVDB_BENCH_DENSE_IMPL
#define LUMIVDB_BENCH_DENSE_IMPL
namespace query_bench {

constexpr int kRecordLanes = 32; // three bands

struct Free {
    void operator()(std::byte* p) const { std::free(p); }
};

struct DenseArray::Impl {
    int blocks = 1;
    bool half = false;
    double toIndex[4][3];
    Coord lower, dim;
    std::size_t stride = 0;
    std::unique_ptr<std::byte, Free> records;
};

} // namespace query_bench
#endif

HWY_BEFORE_NAMESPACE();
namespace query_bench {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;
using Lanes = hn::CappedTag<float, 8>;
using Vector = hn::Vec<Lanes>;
constexpr int kLanes = static_cast<int>(hn::MaxLanes(Lanes()));
constexpr int kVectors = kRecordLanes / kLanes;
/// Queries whose records are asked for while an earlier one is answered.
constexpr std::size_t kAhead = 16;

struct Query {
    const std::byte* node[8];
    float weight[32];
};

HWY_INLINE void prepare(const DenseArray::Impl& d, const Vec3d& p, Query& q)
{
    int v[3];
    float t[3];
    for (int a = 0; a < 3; ++a) {
        const double x = p.x * d.toIndex[0][a] + p.y * d.toIndex[1][a] + p.z * d.toIndex[2][a]
            + d.toIndex[3][a];
        v[a] = static_cast<int>(std::floor(x));
        t[a] = static_cast<float>(x - v[a]);
        v[a] -= d.lower[a];
    }
    const std::byte* first = d.records.get()
        + ((static_cast<std::size_t>(v[0]) * d.dim.y + v[1]) * d.dim.z + v[2]) * d.stride;
    const std::size_t step[3] = {d.stride * static_cast<std::size_t>(d.dim.y) * d.dim.z,
        d.stride * static_cast<std::size_t>(d.dim.z), d.stride};
    for (int i = 0; i < 8; ++i) {
        q.node[i] = first + (i & 1) * step[0] + (i >> 1 & 1) * step[1] + (i >> 2) * step[2];
        for (std::size_t at = 0; at < d.stride; at += 64) hwy::Prefetch(q.node[i] + at);
        q.weight[i]
            = (i & 1 ? t[0] : 1 - t[0]) * (i & 2 ? t[1] : 1 - t[1]) * (i & 4 ? t[2] : 1 - t[2]);
        if (d.blocks == 1) continue;
        for (int a = 0; a < 3; ++a)
            q.weight[8 * (a + 1) + i]
                = q.weight[i] * 0.5f * (t[a] - static_cast<float>(i >> a & 1));
    }
}

template <bool Half> HWY_INLINE Vector load(const std::byte* at)
{
    const Lanes d;
    if constexpr (Half) {
        const hn::Rebind<hwy::float16_t, Lanes> half;
        return hn::PromoteTo(d, hn::Load(half, reinterpret_cast<const hwy::float16_t*>(at)));
    } else {
        return hn::Load(d, reinterpret_cast<const float*>(at));
    }
}

template <bool Half>
HWY_INLINE Color finish(const DenseArray::Impl& dense, const Query& q, const Vec3f& n)
{
    constexpr int kBytes = Half ? 2 : 4;
    const Lanes d;
    Vector sum[kVectors];
    for (Vector& s : sum) s = hn::Zero(d);
    for (int b = 0; b < dense.blocks; ++b)
        for (int i = 0; i < 8; ++i) {
            const Vector w = hn::Set(d, q.weight[8 * b + i]);
            const std::byte* record = q.node[i] + b * kRecordLanes * kBytes;
            for (int v = 0; v < kVectors; ++v)
                sum[v] = hn::Add(sum[v], hn::Mul(w, load<Half>(record + v * kLanes * kBytes)));
        }
    HWY_ALIGN float lane[kRecordLanes];
    for (int v = 0; v < kVectors; ++v) hn::Store(sum[v], d, lane + v * kLanes);
    HWY_ALIGN float y[9];
    evalShBasis(3, n, y);
    HWY_ALIGN float basis[8];
    for (int i = 0; i < 8; ++i)
        basis[i] = y[i + 1] * static_cast<float>(kCosineLobe[i < 3 ? 1 : 2]);
    Color E;
    for (int c = 0; c < 3; ++c) {
        Vector dot = hn::Zero(d);
        for (int v = 0; v < 8; v += kLanes)
            dot = hn::Add(dot, hn::Mul(hn::Load(d, lane + 8 * c + v), hn::Load(d, basis + v)));
        E[c] = lane[24 + c] * (y[0] * static_cast<float>(kCosineLobe[0]))
            + hn::GetLane(hn::SumOfLanes(d, dot));
    }
    return E;
}

template <bool Half>
void denseBatch(
    const DenseArray::Impl& d, std::size_t count, const Vec3d* p, const Vec3f* n, Color* E)
{
    Query ring[kAhead];
    for (std::size_t k = 0; k < count + kAhead; ++k) {
        Query& q = ring[k % kAhead];
        if (k >= kAhead) E[k - kAhead] = finish<Half>(d, q, n[k - kAhead]);
        if (k < count) prepare(d, p[k], q);
    }
}

void denseAll(
    const DenseArray::Impl& d, std::size_t count, const Vec3d* p, const Vec3f* n, Color* E)
{
    d.half ? denseBatch<true>(d, count, p, n, E) : denseBatch<false>(d, count, p, n, E);
}

} // namespace HWY_NAMESPACE
} // namespace query_bench
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace query_bench {

HWY_EXPORT(denseAll);

DenseArray::DenseArray(const IrradianceVolume& volume, bool gradients, Precision precision)
    : mImpl(std::make_unique<Impl>())
{
    Impl& d = *mImpl;
    d.blocks = gradients ? 4 : 1;
    d.half = precision == Precision::Half;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 3; ++j) d.toIndex[i][j] = volume.worldToIndex()[i][j];
    d.lower = volume.minLattice();
    d.dim = volume.maxLattice() - d.lower + Coord(1);
    d.stride = static_cast<std::size_t>(d.blocks) * kRecordLanes * (d.half ? 2 : 4);
    constexpr std::size_t kHuge = std::size_t{2} << 20;
    const std::size_t bytes = (volume.sampleCount() * d.stride + kHuge - 1) / kHuge * kHuge;
    d.records.reset(static_cast<std::byte*>(std::aligned_alloc(kHuge, bytes)));
#ifdef __linux__
    madvise(d.records.get(), bytes, MADV_HUGEPAGE);
#endif
    std::memset(d.records.get(), 0, bytes);
    const double spacing = volume.spacing(); // unrotated lattices only
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        for (int k = 0; k < d.blocks * 27; ++k) {
            const int block = k / 27, i = k % 27 / 3, c = k % 3;
            const double v = block == 0 ? volume.radiance(s)[i][c]
                                        : volume.gradient(s)[(block - 1) * 9 + i][c] * spacing;
            const std::size_t lane = static_cast<std::size_t>(
                block * kRecordLanes + (i == 0 ? 24 + c : 8 * c + i - 1));
            if (d.half) {
                const std::uint16_t bits = Imath::half(static_cast<float>(v)).bits();
                std::memcpy(d.records.get() + s * d.stride + lane * 2, &bits, 2);
            } else {
                const auto f = static_cast<float>(v);
                std::memcpy(d.records.get() + s * d.stride + lane * 4, &f, 4);
            }
        }
    }
}

DenseArray::~DenseArray() = default;

void DenseArray::irradiance(std::size_t count, const Vec3d* p, const Vec3f* n, Color* E) const
{
    HWY_DYNAMIC_DISPATCH(denseAll)(*mImpl, count, p, n, E);
}

} // namespace query_bench
#endif
