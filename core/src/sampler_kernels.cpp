// SPDX-License-Identifier: Apache-2.0
#include "sampler_kernels.h"

#include <lumivdb/core/sh.h>

#include <Imath/half.h>

#include <algorithm>
#include <cmath>
#include <limits>

// Vectors of scalable length cannot be held in arrays; processors that have them have others too.
// Of x86: none, SSE4 and AVX2, since each more takes a quarter of a minute to compile and AVX-512
// gains nothing here.
#define HWY_DISABLED_TARGETS                                                                       \
    (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV | HWY_SSSE3 | HWY_AVX3 | HWY_AVX3_DL)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "sampler_kernels.cpp"
#include <hwy/foreach_target.h> // compiles this file once for each target

#include <hwy/cache_control.h>
#include <hwy/highway.h>

#include "sampler_locate_inl.h"

HWY_BEFORE_NAMESPACE();
namespace lumivdb::detail {
namespace HWY_NAMESPACE {

// Sums are of eight lanes everywhere, multiplications and additions round apart, and all reductions
// have one order: every target gives the same bits.
using Lanes = hn::CappedTag<float, 8>;
using Vector = hn::Vec<Lanes>;
constexpr int kLanes = static_cast<int>(hn::MaxLanes(Lanes())); // 8, 4 or (no SIMD) 1
constexpr int kParts = 8 / kLanes;

/// Queries in flight at once: enough to hide memory's latency, few enough to stay in the cache.
constexpr int kBatch = 32;
/// A denominator below has no digits left.
constexpr float kSmallestWeight = 1e-37f;
/// Distance in cells to keep from a corner where the weights of all valid ones vanish.
constexpr float kNudge = 1e-6f;

// ---- Sums of records

template <bool Half, class D> HWY_INLINE hn::Vec<D> loadNumbers(D d, const std::byte* at)
{
    if constexpr (Half) {
        return hn::PromoteTo(d,
            hn::Load(hn::Rebind<hwy::float16_t, D>(), reinterpret_cast<const hwy::float16_t*>(at)));
    } else {
        return hn::Load(d, reinterpret_cast<const float*>(at));
    }
}

/// Weights are @a step numbers apart. The eight corners' sum of Vectors vectors of D from lane @a
/// first on, to out[first …].
template <int Vectors, bool Half, class D>
HWY_INLINE void addVectors(D d, const std::byte* const* node, const float* weight, int step,
    int blocks, int laneCount, int first, float* out)
{
    constexpr int kBytes = Half ? 2 : 4;
    constexpr int kStep = static_cast<int>(hn::MaxLanes(D()));
    hn::Vec<D> sum[Vectors];
    for (int v = 0; v < Vectors; ++v) sum[v] = hn::Zero(d);
    for (int b = 0; b < blocks; ++b) {
        const int offset = (b * laneCount + first) * kBytes;
        for (int i = 0; i < 8; ++i) {
            const hn::Vec<D> w = hn::Set(d, weight[(8 * b + i) * step]);
            const std::byte* record = node[i] + offset;
            for (int v = 0; v < Vectors; ++v) {
                const hn::Vec<D> x = loadNumbers<Half>(d, record + v * kStep * kBytes);
                sum[v] = hn::Add(sum[v], hn::Mul(w, x));
            }
        }
    }
    for (int v = 0; v < Vectors; ++v) hn::Store(sum[v], d, out + first + v * kStep);
}

template <int Groups, bool Half, int First = 0>
HWY_INLINE void addAll(
    const std::byte* const* node, const float* weight, int step, int blocks, float* out)
{
    constexpr int kNow = Groups - First < 4 ? Groups - First : 4;
    // Sixteen lanes at once where there are such vectors: each lane's sum is the same.
    using Wide = hn::CappedTag<float, 16>;
    constexpr int kWide = static_cast<int>(hn::MaxLanes(Wide()));
    if constexpr (kWide == 16 && kNow % 2 == 0) {
        addVectors<kNow / 2, Half>(Wide(), node, weight, step, blocks, Groups * 8, First * 8, out);
    } else {
        addVectors<kNow * kParts, Half>(
            Lanes(), node, weight, step, blocks, Groups * 8, First * 8, out);
    }
    if constexpr (First + kNow < Groups) {
        addAll<Groups, Half, First + kNow>(node, weight, step, blocks, out);
    }
}

/// Samples and parents of ghosts, by weight over distance.
template <int Groups, bool Half, class B>
HWY_NOINLINE void addInverse(const SamplerForm& f, const B& b, int query, float* out)
{
    std::fill(out, out + 8 * Groups, 0.0f);
    const std::byte* node[8];
    float weight[8];
    int count = 0;
    const auto flush = [&]() HWY_ATTR {
        for (int i = count; i < 8; ++i) {
            node[i] = node[0]; // has weight: finite, or the sum is not anyway
            weight[i] = 0;
        }
        alignas(64) float part[8 * Groups];
        addAll<Groups, Half>(node, weight, 1, 1, part);
        for (int k = 0; k < 8 * Groups; ++k) out[k] += part[k];
        count = 0;
    };
    const auto add = [&](std::uint32_t id, float share) HWY_ATTR {
        if (share == 0) return;
        const Coord& at = f.nodePosition[id];
        const double x = b.p[0][query] - at.x, y = b.p[1][query] - at.y, z = b.p[2][query] - at.z;
        // At a sample its own weight is all.
        const double distance = std::sqrt(x * x + y * y + z * z) + 1e-12;
        node[count] = f.records.data() + id * f.stride;
        weight[count++] = static_cast<float>(share / distance);
        if (count == 8) flush();
    };
    for (int i = 0; i < 8; ++i) {
        const float w = b.weight[i][query];
        if (w == 0) continue;
        const std::uint32_t id = nodeAt(f, b.query[query].node[i]);
        if (id < f.firstGhost) {
            add(id, w);
            continue;
        }
        for (std::uint32_t k = f.parentBegin[id - f.firstGhost];
             k < f.parentBegin[id - f.firstGhost + 1]; ++k)
            add(f.parents[k].node, w * f.parents[k].share);
    }
    if (count > 0) flush();
}

/// Numerators, weight and validity of the prepared query; the weight is never zero.
template <int Groups, bool Half, Interpolation Mode, class B>
HWY_INLINE void sumRecords(const SamplerForm& f, B& b, int k, float* out)
{
    constexpr int kWeight = 8 * Groups - 5;
    Query& q = b.query[k];
    const bool inverse = Mode == kAnyMode && f.options.mode == Interpolation::InverseDistance;
    if constexpr (Mode == kAnyMode) setOtherWeights(f, b, k);
    if (HWY_UNLIKELY(!f.finite)) avoidInfinite(b, k);
    for (int attempt = 0; attempt < 2; ++attempt) {
        if (HWY_UNLIKELY(inverse)) {
            addInverse<Groups, Half>(f, b, k, out);
        } else {
            addAll<Groups, Half>(q.node, b.weight[0] + k, B::kSize, blocksOf<Mode>(q), out);
        }
        if (HWY_LIKELY(out[kWeight] > kSmallestWeight)) return;
        // On a corner, edge or face without any valid one: look from a little further inside.
        for (int a = 0; a < 3; ++a) b.t[a][k] = std::min(std::max(b.t[a][k], kNudge), 1 - kNudge);
        setWeights<Mode>(f, b);
        if constexpr (Mode == kAnyMode) setOtherWeights(f, b, k);
    }
}

/// Validity by linear weights, where the sums have it by others.
template <class B> HWY_NOINLINE float validityOf(const SamplerForm& f, const B& b, int k)
{
    const Query& q = b.query[k];
    const hn::CappedTag<float, 1> d;
    hn::Vec<decltype(d)> t[3], w[8];
    for (int a = 0; a < 3; ++a) t[a] = hn::Set(d, q.cut ? q.cutT[a] : b.t[a][k]);
    linearWeights(d, t, w);
    float sum = 0;
    for (int i = 0; i < 8; ++i) {
        sum += hn::GetLane(w[i])
            * (q.cut ? q.cut->validity[i] : recordNumber(f, q.node[i], f.layout.validityLane()));
    }
    return sum;
}

template <Interpolation Mode> HWY_INLINE bool hasOwnValidity(const SamplerForm& f, const Query& q)
{
    if (q.cut || Mode != kAnyMode) return q.cut;
    return f.options.mode == Interpolation::Nearest || f.options.mode == Interpolation::Taylor
        || f.options.mode == Interpolation::InverseDistance;
}

// ---- Irradiance

struct Basis {
    alignas(32) float lane[40]; // coefficients 1 …, times the cosine lobe's
    float first;
};

/// Three bands, as evalShBasis().
HWY_INLINE void setBasis3(const Vec3f& n, Basis& basis)
{
    constexpr float a0 = static_cast<float>(kCosineLobe[0] * 0.28209479177387814347),
                    a1 = static_cast<float>(kCosineLobe[1] * 0.48860251190291992159),
                    a20 = static_cast<float>(kCosineLobe[2] * 0.31539156525252000603),
                    a21 = static_cast<float>(kCosineLobe[2] * 1.09254843059207907054),
                    a22 = static_cast<float>(kCosineLobe[2] * 0.54627421529603953527);
    basis.first = a0;
    basis.lane[0] = -a1 * n.y;
    basis.lane[1] = a1 * n.z;
    basis.lane[2] = -a1 * n.x;
    const float mz = -a21 * n.z;
    basis.lane[3] = a21 * n.x * n.y;
    basis.lane[4] = mz * n.y;
    basis.lane[5] = a20 * (3.0f * n.z * n.z - 1.0f);
    basis.lane[6] = mz * n.x;
    basis.lane[7] = a22 * (n.x * n.x - n.y * n.y);
}

HWY_INLINE void setBasis(int bands, int pad, const Vec3f& n, Basis& basis)
{
    if (HWY_LIKELY(bands == 3)) return setBasis3(n, basis);
    float y[kMaxCoefficients];
    evalShBasis(bands, n, y);
    basis.first = y[0] * static_cast<float>(kCosineLobe[0]);
    int i = 1;
    for (int l = 1; l < bands; ++l) {
        const auto lobe = static_cast<float>(kCosineLobe[static_cast<std::size_t>(l)]);
        for (; i < (l + 1) * (l + 1); ++i) basis.lane[i - 1] = y[i] * lobe;
    }
    for (; i <= pad; ++i) basis.lane[i - 1] = 0;
}

#if HWY_TARGET == HWY_SCALAR
HWY_INLINE void foldChannels(const Vector (*dot)[kParts], float* e)
{
    for (int c = 0; c < 3; ++c) {
        float four[4];
        for (int k = 0; k < 4; ++k) four[k] = hn::GetLane(hn::Add(dot[c][k], dot[c][k + 4]));
        e[c] = (four[0] + four[2]) + (four[1] + four[3]);
    }
}
#else
using Four = hn::CappedTag<float, 4>;

template <class V> HWY_INLINE hn::Vec<Four> foldEight(const V* dot)
{
    if constexpr (kParts == 1) {
        return hn::Add(hn::LowerHalf(Four(), dot[0]), hn::UpperHalf(Four(), dot[0]));
    } else {
        return hn::Add(dot[0], dot[kParts - 1]);
    }
}

/// Sums of eight lanes of three channels: lanes k and k + 4, then k and k + 2, then the two.
HWY_INLINE void foldChannels(const Vector (*dot)[kParts], float* e)
{
    const Four d;
    const auto red = foldEight(dot[0]), green = foldEight(dot[1]), blue = foldEight(dot[2]);
    const auto rb = hn::Add(hn::InterleaveLower(d, red, blue), hn::InterleaveUpper(d, red, blue));
    const auto g = hn::Add(
        hn::InterleaveLower(d, green, hn::Zero(d)), hn::InterleaveUpper(d, green, hn::Zero(d)));
    hn::Store(hn::Add(hn::InterleaveLower(d, rb, g), hn::InterleaveUpper(d, rb, g)), d, e);
}
#endif

template <int Groups>
HWY_INLINE Color irradianceOf(const SamplerForm& f, const float* sum, const Basis& basis)
{
    constexpr int kGroups = (Groups - 1) / 3; // of one channel
    constexpr int kPad = 8 * kGroups;
    const Lanes d;
    HWY_ALIGN float e[4] = {};
    if constexpr (kGroups > 0) {
        Vector dot[3][kParts];
        for (int c = 0; c < 3; ++c)
            for (int part = 0; part < kParts; ++part) {
                dot[c][part] = hn::Zero(d);
                for (int g = 0; g < kGroups; ++g) {
                    const int at = 8 * g + part * kLanes;
                    dot[c][part] = hn::Add(dot[c][part],
                        hn::Mul(hn::Load(d, sum + c * kPad + at), hn::Load(d, basis.lane + at)));
                }
            }
        foldChannels(dot, e);
    }
    const float scale = f.unscale / sum[3 * kPad + 3];
    Color E;
    for (int c = 0; c < 3; ++c) E[c] = (e[c] + sum[3 * kPad + c] * basis.first) * scale;
    return E;
}

template <int Groups, bool Half, Interpolation Mode, class B>
HWY_INLINE void finishIrradiance(
    const SamplerForm& f, B& b, int k, const Basis& basis, Color* E, QueryInfo* info)
{
    Query& q = b.query[k];
    if (HWY_UNLIKELY(q.level < 0)) {
        *E = Color(std::numeric_limits<float>::quiet_NaN());
        if (info) *info = QueryInfo();
        return;
    }
    alignas(64) float sum[8 * Groups];
    if (info) {
        info->level = q.level;
        if (HWY_UNLIKELY(hasOwnValidity<Mode>(f, q))) info->validity = validityOf(f, b, k);
    }
    sumRecords<Groups, Half, Mode>(f, b, k, sum);
    if (info && !hasOwnValidity<Mode>(f, q)) info->validity = sum[8 * Groups - 4];
    *E = irradianceOf<Groups>(f, sum, basis);
}

template <class B> HWY_INLINE void setPosition(const Vec3d& p, B& b, int i)
{
    for (int a = 0; a < 3; ++a) b.p[a][i] = p[a];
}

/// Nodes and weights of the queries whose positions are set. Each step goes over all of them, so
/// that what the next one reads is on its way.
template <Interpolation Mode, class B> HWY_INLINE void locate(const SamplerForm& f, int count, B& b)
{
    toLattice(f, b);
    for (int i = 0; i < count; ++i) findColumn(f, voxelOf(b, i), b.query[i]);
    int special[B::kSize];
    int specials = 0;
    for (int i = 0; i < count; ++i) {
        Query& q = b.query[i];
        const Coord v = voxelOf(b, i);
        findCode(v, q);
        if (HWY_LIKELY(q.code < kCellCode)) {
            enterRows(f, v, b, i);
        } else {
            special[specials++] = i;
            if (q.code == kCellCode) hwy::Prefetch(f.cells.data() + q.id);
        }
    }
    for (int k = 0; k < specials; ++k) enterSpecial(f, b, special[k]);
    setPlaces(count, b);
    setWeights<Mode>(f, b);
}

template <int Groups, bool Half, Interpolation Mode> HWY_INLINE void prefetchRecords(const Query& q)
{
    constexpr std::size_t kBlockBytes = Groups * 8 * (Half ? 2 : 4);
    if (HWY_UNLIKELY(q.level < 0)) return;
    const std::size_t bytes = kBlockBytes * static_cast<std::size_t>(blocksOf<Mode>(q));
    for (const std::byte* node : q.node)
        for (std::size_t at = 0; at < bytes; at += 64) hwy::Prefetch(node + at);
}

/// While a batch's records are on their way, the one before is answered.
template <int Groups, bool Half, Interpolation Mode>
void irradianceBatch(const SamplerForm& f, std::size_t count, const Vec3d* p, const Vec3f* n,
    Color* E, QueryInfo* info)
{
    using B = Batch<kBatch, rowsOf<Mode>()>;
    B batches[2];
    const double bias = f.options.normalBias;
    const auto prepare = [&](std::size_t begin, B& b) HWY_ATTR {
        const int size = static_cast<int>(std::min<std::size_t>(B::kSize, count - begin));
        for (int i = 0; i < B::kSize; ++i) {
            // The last ones over again, where there are no more.
            const std::size_t k = begin + static_cast<std::size_t>(std::min(i, size - 1));
            setPosition(bias == 0 ? p[k] : p[k] + Vec3d(n[k]) * bias, b, i);
        }
        locate<Mode>(f, size, b);
        return size;
    };
    int size = prepare(0, batches[0]);
    for (int i = 0; i < size; ++i) prefetchRecords<Groups, Half, Mode>(batches[0].query[i]);
    for (std::size_t begin = 0, which = 0; begin < count; begin += kBatch, which ^= 1) {
        B& now = batches[which];
        B& next = batches[which ^ 1];
        const int nextSize = begin + kBatch < count ? prepare(begin + kBatch, next) : 0;
        for (int i = 0; i < size; ++i) {
            if (i < nextSize) prefetchRecords<Groups, Half, Mode>(next.query[i]);
            const std::size_t k = begin + static_cast<std::size_t>(i);
            Basis basis;
            setBasis(f.bands, f.layout.pad, n[k], basis);
            finishIrradiance<Groups, Half, Mode>(
                f, now, i, basis, E + k, info ? info + k : nullptr);
        }
        size = nextSize;
    }
}

template <int Groups, bool Half, Interpolation Mode>
void irradianceOne(const SamplerForm& f, const Vec3d& p, const Vec3f& n, Color* E, QueryInfo* info)
{
    Batch<1, rowsOf<Mode>()> b;
    const double bias = f.options.normalBias;
    setPosition(bias == 0 ? p : p + Vec3d(n) * bias, b, 0);
    locate<Mode>(f, 1, b);
    // All records are asked for at once; until they are there the basis is made, whose numbers are
    // written one by one and read eight at a time, which takes a while.
    prefetchRecords<Groups, Half, Mode>(b.query[0]);
    Basis basis;
    setBasis(f.bands, f.layout.pad, n, basis);
    finishIrradiance<Groups, Half, Mode>(f, b, 0, basis, E, info);
}

template <int Groups, bool Half, Interpolation Mode>
QueryInfo radianceAt(const SamplerForm& f, const Vec3d& p, Color* L)
{
    Batch<1, rowsOf<Mode>()> b;
    QueryInfo info;
    const int n = f.layout.coefficients;
    setPosition(p, b, 0);
    locate<Mode>(f, 1, b);
    const Query& q = b.query[0];
    if (q.level < 0) {
        std::fill(L, L + n, Color(std::numeric_limits<float>::quiet_NaN()));
        return info;
    }
    alignas(64) float sum[8 * Groups];
    info.level = q.level;
    if (hasOwnValidity<Mode>(f, q)) info.validity = validityOf(f, b, 0);
    sumRecords<Groups, Half, Mode>(f, b, 0, sum);
    if (!hasOwnValidity<Mode>(f, q)) info.validity = sum[8 * Groups - 4];
    const float scale = f.unscale / sum[8 * Groups - 5];
    for (int i = 0; i < n; ++i)
        for (int c = 0; c < 3; ++c) L[i][c] = sum[f.layout.lane(i, c)] * scale;
    return info;
}

template <int Groups, bool Half, Interpolation Mode>
void irradianceMany(const SamplerForm& f, std::size_t count, const Vec3d* p, const Vec3f* n,
    Color* E, QueryInfo* info)
{
    if (count == 1) return irradianceOne<Groups, Half, Mode>(f, *p, *n, E, info);
    if (count > 1) irradianceBatch<Groups, Half, Mode>(f, count, p, n, E, info);
}

template <bool Half>
void irradianceByBands(const SamplerForm& f, std::size_t count, const Vec3d* p, const Vec3f* n,
    Color* E, QueryInfo* info)
{
    switch (f.layout.lanes / 8) {
    case 1:
        return irradianceMany<1, Half, kAnyMode>(f, count, p, n, E, info);
    case 4: // two bands and three
        if (f.options.mode == Interpolation::Trilinear)
            return irradianceMany<4, Half, Interpolation::Trilinear>(f, count, p, n, E, info);
        if (f.options.mode == Interpolation::Gradient)
            return irradianceMany<4, Half, Interpolation::Gradient>(f, count, p, n, E, info);
        return irradianceMany<4, Half, kAnyMode>(f, count, p, n, E, info);
    case 7:
        return irradianceMany<7, Half, kAnyMode>(f, count, p, n, E, info);
    case 10:
        return irradianceMany<10, Half, kAnyMode>(f, count, p, n, E, info);
    default:
        return irradianceMany<kMaxGroups, Half, kAnyMode>(f, count, p, n, E, info);
    }
}

template <bool Half> QueryInfo radianceByBands(const SamplerForm& f, const Vec3d& p, Color* L)
{
    constexpr Interpolation Mode = kAnyMode;
    switch (f.layout.lanes / 8) {
    case 1:
        return radianceAt<1, Half, Mode>(f, p, L);
    case 4:
        return radianceAt<4, Half, Mode>(f, p, L);
    case 7:
        return radianceAt<7, Half, Mode>(f, p, L);
    case 10:
        return radianceAt<10, Half, Mode>(f, p, L);
    default:
        return radianceAt<kMaxGroups, Half, Mode>(f, p, L);
    }
}

void irradianceAll(const SamplerForm& f, std::size_t count, const Vec3d* p, const Vec3f* n,
    Color* E, QueryInfo* info)
{
    f.options.precision == Precision::Half ? irradianceByBands<true>(f, count, p, n, E, info)
                                           : irradianceByBands<false>(f, count, p, n, E, info);
}

QueryInfo radiance(const SamplerForm& f, const Vec3d& p, Color* L)
{
    return f.options.precision == Precision::Half ? radianceByBands<true>(f, p, L)
                                                  : radianceByBands<false>(f, p, L);
}

} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lumivdb::detail {

HWY_EXPORT(irradianceAll);
HWY_EXPORT(radiance);

void queryIrradiance(const SamplerForm& form, std::size_t count, const Vec3d* p, const Vec3f* n,
    Color* E, QueryInfo* info)
{
    HWY_DYNAMIC_DISPATCH(irradianceAll)(form, count, p, n, E, info);
}

QueryInfo queryRadiance(const SamplerForm& form, const Vec3d& p, Color* L)
{
    return HWY_DYNAMIC_DISPATCH(radiance)(form, p, L);
}

} // namespace lumivdb::detail
#endif
