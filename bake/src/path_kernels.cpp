// SPDX-License-Identifier: Apache-2.0
#include "path_kernels.h"

#include <limits>

// Of x86: none, SSE4 and AVX2, as in core/src/sampler_kernels.cpp.
#define HWY_DISABLED_TARGETS                                                                       \
    (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV | HWY_SSSE3 | HWY_AVX3 | HWY_AVX3_DL)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "path_kernels.cpp"
#include <hwy/foreach_target.h> // compiles this file once for each target
#include <hwy/highway.h>

#ifndef LUMIVDB_PATH_KERNELS_ORDER // once for all targets
#define LUMIVDB_PATH_KERNELS_ORDER
namespace lumivdb::detail {
/// For every mask of eight lanes: those it selects, then the others, and how many it selects. Its
/// first entries serve shorter vectors.
struct LaneOrder {
    alignas(32) std::int32_t lanes[256][8] = {};
    int count[256] = {};

    constexpr LaneOrder()
    {
        for (int mask = 0; mask < 256; ++mask) {
            for (int lane = 0; lane < 8; ++lane) count[mask] += mask >> lane & 1;
            int selected = 0, other = count[mask];
            for (int lane = 0; lane < 8; ++lane) {
                lanes[mask][mask >> lane & 1 ? selected++ : other++] = lane;
            }
        }
    }
};
constexpr LaneOrder kOrder;
} // namespace lumivdb::detail
#endif

HWY_BEFORE_NAMESPACE();
namespace lumivdb::detail {
namespace HWY_NAMESPACE {

namespace {

namespace hn = hwy::HWY_NAMESPACE;
using Lanes = hn::CappedTag<float, 8>;
using Integers = hn::RebindToSigned<Lanes>;
using Vector = hn::Vec<Lanes>;
using Mask = hn::Mask<Lanes>;
constexpr int kLanes = static_cast<int>(hn::MaxLanes(Lanes())); // 8, 4 or (no SIMD) 1
constexpr float kPi = 3.14159265358979323846f;

HWY_INLINE Vector set(float x) { return hn::Set(Lanes(), x); }
HWY_INLINE Vector load(const float* from) { return hn::Load(Lanes(), from); }

struct Vector3 {
    Vector x, y, z;
};
HWY_INLINE Vector3 load(const VectorBatch& b, int i)
{
    return {load(b.x + i), load(b.y + i), load(b.z + i)};
}
HWY_INLINE Vector3 operator+(const Vector3& a, const Vector3& b)
{
    return {hn::Add(a.x, b.x), hn::Add(a.y, b.y), hn::Add(a.z, b.z)};
}
HWY_INLINE Vector3 operator-(const Vector3& a, const Vector3& b)
{
    return {hn::Sub(a.x, b.x), hn::Sub(a.y, b.y), hn::Sub(a.z, b.z)};
}
HWY_INLINE Vector3 operator*(const Vector3& a, Vector s)
{
    return {hn::Mul(a.x, s), hn::Mul(a.y, s), hn::Mul(a.z, s)};
}
HWY_INLINE Vector dot(const Vector3& a, const Vector3& b)
{
    return hn::Add(hn::Add(hn::Mul(a.x, b.x), hn::Mul(a.y, b.y)), hn::Mul(a.z, b.z));
}
HWY_INLINE Vector difference(Vector a, Vector b, Vector c, Vector d) // ab − cd
{
    return hn::Sub(hn::Mul(a, b), hn::Mul(c, d));
}
HWY_INLINE Vector3 cross(const Vector3& a, const Vector3& b)
{
    return {difference(a.y, b.z, a.z, b.y), difference(a.z, b.x, a.x, b.z),
        difference(a.x, b.y, a.y, b.x)};
}
HWY_INLINE Vector3 choose(Mask which, const Vector3& a, const Vector3& b)
{
    return {hn::IfThenElse(which, a.x, b.x), hn::IfThenElse(which, a.y, b.y),
        hn::IfThenElse(which, a.z, b.z)};
}
HWY_INLINE Vector largest(const Vector3& v) { return hn::Max(hn::Max(v.x, v.y), v.z); }
HWY_INLINE Vector largestAbs(const Vector3& v)
{
    return largest({hn::Abs(v.x), hn::Abs(v.y), hn::Abs(v.z)});
}

/// Stores the lanes of vectors that a mask selects one after the other. (Highway's CompressStore
/// finds the permutation anew for every vector.)
class Packer {
public:
    HWY_INLINE explicit Packer(Mask which)
    {
        std::uint8_t bits[8] = {};
        hn::StoreMaskBits(Lanes(), which, bits);
        mCount = kOrder.count[bits[0]];
        mOrder = hn::IndicesFromVec(Lanes(), hn::LoadU(Integers(), kOrder.lanes[bits[0]]));
    }
    HWY_INLINE int count() const { return mCount; }
    /// Writes whole vectors, so @a to must not lie behind the lanes in their array.
    HWY_INLINE void put(Vector v, float* to) const
    {
        hn::StoreU(hn::TableLookupLanes(v, mOrder), Lanes(), to);
    }
    HWY_INLINE void put(const Vector3& v, float* x, float* y, float* z) const
    {
        put(v.x, x);
        put(v.y, y);
        put(v.z, z);
    }
    HWY_INLINE void put(hn::Vec<Integers> v, std::int32_t* to) const
    {
        const Vector moved = hn::TableLookupLanes(hn::BitCast(Lanes(), v), mOrder);
        hn::StoreU(hn::BitCast(Integers(), moved), Integers(), to);
    }

private:
    int mCount;
    decltype(hn::IndicesFromVec(Lanes(), hn::Zero(Integers()))) mOrder;
};

/// The way to emitters.
struct Aim {
    Vector3 ray; ///< to the emitter, or unit where that is infinitely far away
    Vector far;
    Vector3 direction; ///< unit
    Vector pdf; ///< per steradian
    Mask lit; ///< whether light can come that way
};

HWY_INLINE Aim aimAt(const EmitterBatch& e, const Vector3& from, int i, int count)
{
    const Vector zero = hn::Zero(Lanes());
    const Vector offset = load(e.offset + i), density = load(e.density + i);
    const Vector3 place = load(e.place, i), normal = load(e.normal, i);
    const Mask infinite = hn::Lt(offset, zero);
    const Vector facing = dot(normal, from - place);
    const Vector3 target = place + normal * hn::CopySign(offset, facing);
    const Vector3 ray = target - from;
    const Vector distance2 = dot(ray, ray);
    const Vector3 direction = ray * hn::Div(set(1.0f), hn::Sqrt(distance2));
    const Vector cosine = hn::Abs(dot(normal, direction));
    const Vector pdf = hn::Div(hn::Mul(density, distance2), cosine);
    const Mask side
        = hn::Or(hn::Gt(facing, zero), hn::Lt(hn::Mul(facing, load(e.backShines + i)), zero));
    const Mask seen = hn::And(side, hn::And(hn::Gt(distance2, zero), hn::Gt(cosine, zero)));
    const auto inBatch = hn::FirstN(Lanes(), static_cast<std::size_t>(count - i));
    Aim aim;
    aim.ray = choose(infinite, place, ray);
    aim.far
        = hn::IfThenElse(infinite, set(std::numeric_limits<float>::infinity()), set(kShadowEnd));
    aim.direction = choose(infinite, place, direction);
    aim.pdf = hn::IfThenElse(infinite, density, pdf);
    aim.lit = hn::And(inBatch, hn::And(hn::Or(infinite, seen), hn::Gt(aim.pdf, zero)));
    return aim;
}

/// Adds the rays of @a aim that are lit.
HWY_INLINE void push(const Aim& aim, Mask lit, const Vector3& from, const Vector3& value,
    hn::Vec<Integers> stratum, ShadowBatch& shadow)
{
    RayBatch& rays = shadow.rays;
    const int n = rays.count;
    const Packer packer(lit);
    packer.put(from, rays.ox + n, rays.oy + n, rays.oz + n);
    packer.put(aim.ray, rays.dx + n, rays.dy + n, rays.dz + n);
    packer.put(aim.far, rays.tfar + n);
    packer.put(value, shadow.value.channel[0] + n, shadow.value.channel[1] + n,
        shadow.value.channel[2] + n);
    packer.put(stratum, shadow.stratum + n);
    rays.count += packer.count();
}

HWY_INLINE Vector3 load(const ColorBatch& b, int i)
{
    return {load(b.channel[0] + i), load(b.channel[1] + i), load(b.channel[2] + i)};
}
HWY_INLINE Vector3 operator*(const Vector3& a, const Vector3& b)
{
    return {hn::Mul(a.x, b.x), hn::Mul(a.y, b.y), hn::Mul(a.z, b.z)};
}

/// Sine and cosine of 2πu, 0 ≤ u < 1, to about a rounding (polynomials of Cephes' sinf, cosf).
HWY_INLINE void turn(Vector u, Vector& sine, Vector& cosine)
{
    const Integers integers;
    const Vector quarters = hn::Mul(u, set(4.0f));
    const hn::Vec<Integers> nearest = hn::NearestInt(quarters);
    const Vector x = hn::Mul(hn::Sub(quarters, hn::ConvertTo(Lanes(), nearest)), set(0.5f * kPi));
    const Vector x2 = hn::Mul(x, x);
    Vector s = hn::Add(hn::Mul(set(-1.9515295891e-4f), x2), set(8.3321608736e-3f));
    s = hn::Add(hn::Mul(s, x2), set(-1.6666654611e-1f));
    s = hn::Add(hn::Mul(hn::Mul(s, x2), x), x);
    Vector c = hn::Add(hn::Mul(set(2.443315711809948e-5f), x2), set(-1.388731625493765e-3f));
    c = hn::Add(hn::Mul(c, x2), set(4.166664568298827e-2f));
    c = hn::Add(hn::Mul(hn::Mul(c, x2), x2), hn::Sub(set(1.0f), hn::Mul(set(0.5f), x2)));
    const auto bit = [&](int added, int which) {
        const hn::Vec<Integers> k = hn::Add(nearest, hn::Set(integers, added));
        return hn::RebindMask(Lanes(), hn::TestBit(k, hn::Set(integers, which)));
    };
    const Mask swap = bit(0, 1);
    sine = hn::IfThenElse(swap, c, s);
    cosine = hn::IfThenElse(swap, s, c);
    sine = hn::IfThenElse(bit(0, 2), hn::Neg(sine), sine);
    cosine = hn::IfThenElse(bit(1, 2), hn::Neg(cosine), cosine);
}

HWY_INLINE Vector3 cosineDirection(const Vector3& n, Vector u, Vector v)
{
    const Vector one = set(1.0f), sign = hn::CopySign(one, n.z);
    const Vector a = hn::Div(set(-1.0f), hn::Add(sign, n.z));
    const Vector b = hn::Mul(hn::Mul(n.x, n.y), a);
    const Vector xa = hn::Mul(hn::Mul(n.x, n.x), a), ya = hn::Mul(hn::Mul(n.y, n.y), a);
    const Vector3 t{hn::Add(one, hn::Mul(sign, xa)), hn::Mul(sign, b), hn::Neg(hn::Mul(sign, n.x))};
    const Vector3 s{b, hn::Add(sign, ya), hn::Neg(n.y)};
    Vector sine, cosine;
    turn(v, sine, cosine);
    const Vector r = hn::Sqrt(u);
    const Vector up = hn::Sqrt(hn::Max(hn::Sub(one, u), set(1e-12f)));
    return t * hn::Mul(r, cosine) + s * hn::Mul(r, sine) + n * up;
}

} // namespace

void aimFromPoint(
    const Vec3f& p, const EmitterBatch& e, int count, VectorBatch& direction, ShadowBatch& shadow)
{
    const Vector3 from{set(p.x), set(p.y), set(p.z)};
    const Vector3 none{set(0.0f), set(0.0f), set(1.0f)};
    for (int i = 0; i < count; i += kLanes) {
        const Aim aim = aimAt(e, from, i, count);
        const Vector weight = hn::Div(set(1.0f), hn::Add(aim.pdf, set(1 / (4 * kPi))));
        const Vector3 to = choose(aim.lit, aim.direction, none);
        hn::Store(to.x, Lanes(), direction.x + i);
        hn::Store(to.y, Lanes(), direction.y + i);
        hn::Store(to.z, Lanes(), direction.z + i);
        push(aim, aim.lit, from, load(e.radiance, i) * weight, hn::Iota(Integers(), i), shadow);
    }
}

void aimFromPaths(const PathBatch& paths, const EmitterBatch& e, int samples, ShadowBatch& shadow)
{
    const Vector densities = set(static_cast<float>(samples) * kPi);
    for (int i = 0; i < paths.count; i += kLanes) {
        const Vector3 from = load(paths.leaving, i);
        const Aim aim = aimAt(e, from, i, paths.count);
        const Vector cosine = dot(load(paths.normal, i), aim.direction);
        const Mask lit = hn::And(aim.lit, hn::Gt(cosine, hn::Zero(Lanes())));
        // f cos / (n p_emitter + p_cosine), where f = albedo / π and p_cosine = cos / π
        const Vector weight = hn::Div(cosine, hn::Add(hn::Mul(densities, aim.pdf), cosine));
        const Vector3 reflected = load(paths.throughput, i) * load(paths.albedo, i);
        push(aim, lit, from, reflected * load(e.radiance, i) * weight,
            hn::Load(Integers(), paths.stratum + i), shadow);
    }
}

void surfacesOf(MetBatch& met, PathBatch& paths)
{
    for (int i = 0; i < met.count; i += kLanes) {
        const Vector3 a = load(met.a, i), b = load(met.b, i), c = load(met.c, i);
        const Vector u = load(paths.u + i), v = load(paths.v + i);
        const Vector3 area = cross(b - a, c - a);
        const Vector length2 = dot(area, area);
        const Vector3 front = area * hn::Div(set(1.0f), hn::Sqrt(length2));
        const Vector facing = dot(front, load(met.direction, i));
        const Mask holds = hn::And(hn::Gt(length2, set(1e-30f)), hn::Lt(length2, set(1e30f)));
        hn::Store(hn::IfThenElse(holds, facing, set(std::numeric_limits<float>::quiet_NaN())),
            Lanes(), met.facing + i);
        const Mask behind = hn::Gt(facing, hn::Zero(Lanes()));
        const Vector3 normal
            = choose(behind, {hn::Neg(front.x), hn::Neg(front.y), hn::Neg(front.z)}, front);
        const Vector most = hn::Max(hn::Max(largestAbs(a), largestAbs(b)), largestAbs(c));
        const Vector rounding = hn::Mul(most, set(0x1p-20f));
        const Vector offset
            = hn::Max(hn::Mul(rounding, load(met.stretch + i)), load(met.least + i));
        const Vector first = hn::Sub(hn::Sub(set(1.0f), u), v);
        const Vector3 leaving = a * first + b * u + c * v + normal * offset;
        hn::Store(leaving.x, Lanes(), paths.leaving.x + i);
        hn::Store(leaving.y, Lanes(), paths.leaving.y + i);
        hn::Store(leaving.z, Lanes(), paths.leaving.z + i);
        hn::Store(normal.x, Lanes(), paths.normal.x + i);
        hn::Store(normal.y, Lanes(), paths.normal.y + i);
        hn::Store(normal.z, Lanes(), paths.normal.z + i);
    }
}

int scatterAll(PathBatch& paths, float longest, ScatterBatch& s, RayBatch& rays)
{
    int alive = 0;
    ColorBatch& carried = paths.throughput;
    for (int i = 0; i < paths.count; i += kLanes) {
        const Vector3 throughput = load(carried, i) * load(paths.albedo, i);
        const Vector chance
            = hn::Min(hn::Min(set(1.0f), hn::Mul(set(2.0f), largest(throughput))), set(longest));
        const Mask survives
            = hn::And(hn::FirstN(Lanes(), static_cast<std::size_t>(paths.count - i)),
                hn::Lt(load(s.survive + i), chance));
        const Packer packer(survives);
        const Vector3 normal = load(paths.normal, i);
        const Vector3 d = cosineDirection(normal, load(s.u + i), load(s.v + i));
        const Vector3 more{hn::Div(throughput.x, chance), hn::Div(throughput.y, chance),
            hn::Div(throughput.z, chance)};
        packer.put(load(paths.leaving, i), rays.ox + alive, rays.oy + alive, rays.oz + alive);
        packer.put(d, rays.dx + alive, rays.dy + alive, rays.dz + alive);
        packer.put(set(std::numeric_limits<float>::infinity()), rays.tfar + alive);
        packer.put(normal, s.normal.x + alive, s.normal.y + alive, s.normal.z + alive);
        packer.put(dot(normal, d), s.cosine + alive);
        packer.put(hn::Iota(Integers(), i), s.path + alive);
        packer.put(more, carried.channel[0] + alive, carried.channel[1] + alive,
            carried.channel[2] + alive);
        alive += packer.count();
    }
    rays.count = alive;
    return alive;
}

void cosineRaysOf(const PathBatch& paths, ScatterBatch& s, RayBatch& rays)
{
    for (int i = 0; i < paths.count; i += kLanes) {
        const Vector3 normal = load(paths.normal, i), from = load(paths.leaving, i);
        const Vector3 d = cosineDirection(normal, load(s.u + i), load(s.v + i));
        hn::Store(from.x, Lanes(), rays.ox + i);
        hn::Store(from.y, Lanes(), rays.oy + i);
        hn::Store(from.z, Lanes(), rays.oz + i);
        hn::Store(d.x, Lanes(), rays.dx + i);
        hn::Store(d.y, Lanes(), rays.dy + i);
        hn::Store(d.z, Lanes(), rays.dz + i);
        hn::Store(set(std::numeric_limits<float>::infinity()), Lanes(), rays.tfar + i);
        hn::Store(normal.x, Lanes(), s.normal.x + i);
        hn::Store(normal.y, Lanes(), s.normal.y + i);
        hn::Store(normal.z, Lanes(), s.normal.z + i);
        hn::Store(dot(normal, d), Lanes(), s.cosine + i);
        hn::Store(hn::Iota(Integers(), i), Integers(), s.path + i);
    }
    rays.count = paths.count;
}

void sumStrataOf(const StrataSums& w)
{
    // Eight partial sums, whatever the vectors' length.
    constexpr int kSums = 8, kParts = kSums / kLanes;
    alignas(64) float values[kBatch + 2 * kSums] = {};
    float* const f = values + kSums; // f[−1] is the stratum before
    const auto n = w.count;
    for (int k = 0; k < w.functions; ++k) {
        for (int c = 0; c < 3; ++c) {
            const float *uniform = w.uniform->channel[c], *emitter = w.emitter->channel[c];
            const float *yu = w.uniformBasis + k * n, *ye = w.emitterBasis + k * n;
            int i = 0;
            for (; i + kLanes <= n; i += kLanes) {
                const Vector a = hn::Mul(load(uniform + i), hn::LoadU(Lanes(), yu + i));
                const Vector b = hn::Mul(load(emitter + i), hn::LoadU(Lanes(), ye + i));
                hn::Store(hn::Add(a, b), Lanes(), f + i);
            }
            for (; i < n; ++i) f[i] = uniform[i] * yu[i] + emitter[i] * ye[i];
            const int j = k * 3 + c;
            f[-1] = w.hasPrevious ? w.previous[j] : f[0];
            w.previous[j] = f[n - 1];
            Vector s[kParts], d[kParts];
            for (int part = 0; part < kParts; ++part) s[part] = d[part] = hn::Zero(Lanes());
            for (i = 0; i + kSums <= n; i += kSums) {
                for (int part = 0; part < kParts; ++part) {
                    const float* const at = f + i + part * kLanes;
                    const Vector v = load(at);
                    const Vector delta = hn::Sub(v, hn::LoadU(Lanes(), at - 1));
                    s[part] = hn::Add(s[part], v);
                    d[part] = hn::Add(d[part], hn::Mul(delta, delta));
                }
            }
            alignas(64) float sums[kSums], squares[kSums];
            for (int part = 0; part < kParts; ++part) {
                hn::Store(s[part], Lanes(), sums + part * kLanes);
                hn::Store(d[part], Lanes(), squares + part * kLanes);
            }
            for (int l = 0; i + l < n; ++l) {
                const float v = f[i + l], delta = v - f[i + l - 1];
                sums[l] += v;
                squares[l] += delta * delta;
            }
            for (int l = 0; l < kSums; ++l) {
                w.sum[j] += static_cast<double>(sums[l]);
                w.differences2[j] += static_cast<double>(squares[l]);
            }
        }
    }
}

} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lumivdb {

namespace detail {

HWY_EXPORT(aimFromPoint);
HWY_EXPORT(aimFromPaths);
HWY_EXPORT(surfacesOf);
HWY_EXPORT(scatterAll);
HWY_EXPORT(cosineRaysOf);
HWY_EXPORT(sumStrataOf);

} // namespace detail

void aimFrom(const Vec3f& p, const EmitterBatch& emitters, int count, VectorBatch& direction,
    ShadowBatch& shadow)
{
    using namespace detail;
    HWY_DYNAMIC_DISPATCH(aimFromPoint)(p, emitters, count, direction, shadow);
}
void aimFromSurfaces(
    const PathBatch& paths, const EmitterBatch& emitters, int samples, ShadowBatch& shadow)
{
    using namespace detail;
    HWY_DYNAMIC_DISPATCH(aimFromPaths)(paths, emitters, samples, shadow);
}
void findSurfaces(MetBatch& met, PathBatch& paths)
{
    using namespace detail;
    HWY_DYNAMIC_DISPATCH(surfacesOf)(met, paths);
}
int scatterPaths(PathBatch& paths, float longest, ScatterBatch& s, RayBatch& rays)
{
    using namespace detail;
    return HWY_DYNAMIC_DISPATCH(scatterAll)(paths, longest, s, rays);
}
void cosineRays(const PathBatch& paths, ScatterBatch& s, RayBatch& rays)
{
    using namespace detail;
    HWY_DYNAMIC_DISPATCH(cosineRaysOf)(paths, s, rays);
}
void sumStrata(const StrataSums& sums)
{
    using namespace detail;
    HWY_DYNAMIC_DISPATCH(sumStrataOf)(sums);
}

void PathBatch::moveSurface(int from, int to)
{
    leaving.set(to, leaving[from]);
    normal.set(to, normal[from]);
    albedo.set(to, albedo[from]);
    u[to] = u[from];
    v[to] = v[from];
    distance[to] = distance[from];
    triangle[to] = triangle[from];
    behind[to] = behind[from];
}

void PathBatch::movePath(int from, int to)
{
    throughput.set(to, throughput[from]);
    stratum[to] = stratum[from];
    rng[to] = rng[from];
    goesOn[to] = goesOn[from];
}

} // namespace lumivdb
#endif
