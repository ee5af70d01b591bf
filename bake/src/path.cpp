// SPDX-License-Identifier: Apache-2.0
#include "path.h"

#include "directions.h"

#include <lumivdb/bake/radiance_cache.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace lumivdb {

namespace {

/// Patches are near within this many of their sides: one then fills 4% of the view or more.
constexpr float kNearPatches = 1;
/// Rays of gather() that look how open a place is.
constexpr int kLooks = 2;
/// Step of a Kronecker sequence in the plane (Roberts' R2).
const Vec2d kR2(0.7548776662466927, 0.5698402909980532);
constexpr float kPi = 3.14159265358979323846f;
constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr double kUniformPdf = 1 / (4 * 3.14159265358979323846);
/// Distances below this count as it, so that their inverses stay finite.
constexpr float kNearest = 1e-12f;
constexpr float kEdgeOn = 1e-5f;
/// Separates the random numbers of emitter strata from those of the directions.
constexpr std::uint64_t kEmitterStream = 0x51ed270b35ae3d29ull;
/// Beyond this many reflections every path has a chance to end, so that a room of albedo 1 does.
/// A lower survival than the albedo squared would make the variance infinite.
constexpr int kLongPath = 2048;
constexpr float kLongPathSurvival = 0.999f;
/// Shadow rays stop this much short of the light, in their length: Embree's distances round.
constexpr float kShadowEnd = 1 - 0x1p-17f;

double fraction(double x) { return x - std::floor(x); }
float maxComponent(const Color& c) { return std::max({c.x, c.y, c.z}); }

/// Cosine-distributed direction about unit @a n, unit to rounding (Malley; frame of Duff et al.,
/// JCGT 6(1), 2017).
Vec3f cosineDirection(const Vec3f& n, float u1, float u2)
{
    const float sign = std::copysign(1.0f, n.z);
    const float a = -1 / (sign + n.z), b = n.x * n.y * a;
    const Vec3f t(1 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    const Vec3f s(b, sign + n.y * n.y * a, -n.y);
    const float r = std::sqrt(u1), phi = 2 * kPi * u2;
    return t * (r * std::cos(phi)) + s * (r * std::sin(phi))
        + n * std::sqrt(std::max(1 - u1, 1e-12f));
}

/// Survival probability of a path: paths that carry much go on for certain, the others in
/// proportion, so that what survives carries about half.
float survival(const Color& throughput, int bounce)
{
    const float q = std::min(1.0f, 2 * maxComponent(throughput));
    return bounce < kLongPath ? q : std::min(q, kLongPathSurvival);
}

void pushShadow(RayBatch& rays, const Vec3f& from, const EmitterSample& s)
{
    if (s.infinite) {
        rays.push(from, s.direction, kInfinity);
    } else {
        rays.push(from, s.target - from, kShadowEnd);
    }
}

EmitterSample sampleStratum(const Tracer::Impl& impl, const Vec3f& p, double t)
{
    return impl.emitters.sampleStratum({p}, t, [&](std::uint32_t triangle, float u, float v) {
        return impl.emissionAt(impl.triangles[triangle], u, v);
    });
}

void prefetchSurfaces(const Tracer::Impl& impl, const HitBatch& hits, int count)
{
    for (int i = 0; i < count && !impl.texels.empty(); ++i) {
        if (hits.triangle[i] == kMiss) continue;
        impl.prefetchAlbedo(hits.triangle[i], hits.u[i], hits.v[i]);
    }
}

/// Balance heuristic over one uniform and one emitter direction a stratum.
Color probeValue(const EmitterSample& s)
{
    return s.radiance * static_cast<float>(1 / (s.pdf + kUniformPdf));
}
float uniformWeight(double pdf) { return static_cast<float>(kUniformPdf / (kUniformPdf + pdf)); }

/// What a ray from @a to that leaves the scene brings, and the density of drawing that way.
Environment::Arrival background(const Tracer::Impl& impl, const Receiver& to, const Vec3f& d)
{
    if (!impl.scene->environment) return {Color(0.0f), 0};
    Environment::Arrival light = impl.scene->environment->arrival(Vec3d(d));
    light.pdf *= impl.emitters.environmentDensity(to, light.sun);
    return light;
}

ProbeStratum makeStratum(
    const Tracer::Impl& impl, const ProbeOptions& options, const Vec3f& direction, double position)
{
    ProbeStratum stratum;
    if (options.contribution == Contribution::Indirect) return stratum;
    stratum.t = position;
    const EmitterSample s
        = impl.emitters.empty() ? EmitterSample() : sampleStratum(impl, Vec3f(0), stratum.t);
    if (s.infinite && s.pdf > 0) {
        stratum.infinite = s.direction;
        stratum.value = probeValue(s);
    }
    const Environment::Arrival light = background(impl, {}, direction);
    stratum.background = light.radiance * uniformWeight(light.pdf);
    return stratum;
}

} // namespace

std::vector<ProbeStratum> probeStrata(const Tracer::Impl& impl, const ProbeOptions& options,
    const std::vector<Vec3f>& directions, int set)
{
    const auto positions = nestedPositions(
        options.seed ^ kEmitterStream, static_cast<std::uint64_t>(options.rays), set);
    std::vector<ProbeStratum> strata(directions.size());
    tbb::parallel_for(std::size_t{0}, strata.size(), [&](std::size_t i) {
        strata[i] = makeStratum(impl, options, directions[i], positions[i]);
    });
    return strata;
}

InversePlane::InversePlane(const Vec3f& normal, const Vec3f& direction, float distance)
    : inverse(1 / std::max(distance, kNearest))
{
    // Seen edge-on, a plane says nothing of the distance beside the ray: take it as constant.
    const float cosine = normal.dot(direction);
    slope = std::abs(cosine) > kEdgeOn ? normal * (inverse / cosine) : direction * inverse;
}

void PathTracer::note(const RayBatch& rays, bool shadow)
{
    if (!mRecorder) return;
    for (int i = 0; i < rays.count; ++i) {
        mRecorder->push_back(
            {Vec3f(rays.ox[i], rays.oy[i], rays.oz[i]), rays.direction(i), rays.tfar[i], shadow});
    }
}

void PathTracer::trace(const Vec3f& p, const Vec3f* directions, std::uint64_t first, int count,
    std::uint64_t key, PathBatchResult& result)
{
    const ProbeStratum* strata = mStrata ? mStrata->data() + first : mOwnStrata;
    for (int i = 0; !mStrata && i < count; ++i) {
        const double position = jitteredStratum(mOptions.seed ^ kEmitterStream,
            first + static_cast<std::uint64_t>(i), static_cast<std::uint64_t>(mOptions.rays));
        mOwnStrata[i] = makeStratum(mImpl, mOptions, directions[i], position);
    }
    result.traced = 0;
    result.rays.count = 0;
    for (int i = 0; i < count; ++i) {
        result.rays.push(p, directions[i], kInfinity);
        result.uniform[i] = Color(0.0f);
        result.emitter[i] = Color(0.0f);
        result.ex[i] = result.ey[i] = 0;
        result.ez[i] = 1;
        if (result.wantPlanes) result.emitterPlane[i] = InversePlane();
    }
    if (mOptions.contribution != Contribution::Indirect && !mImpl.emitters.empty()) {
        sampleEmittersAtProbe(p, strata, count, result);
    }
    intersectCoherent(mImpl, result.rays, result.hits);
    note(result.rays, false);
    result.traced += static_cast<std::uint64_t>(count);
    startPaths(p, strata, first, count, key, result);
    if (mOptions.contribution == Contribution::Direct || mOptions.maxBounces == 0) return;
    if (mOptions.cache) {
        lookUp(result);
        return;
    }
    for (int bounce = 1; mPathCount > 0; ++bounce) {
        if (mOptions.maxBounces >= 0 && bounce > mOptions.maxBounces) break;
        reflectFromEmitters(result);
        reflectFromPunctual(result);
        scatter(bounce, result);
    }
}

void PathTracer::sampleEmittersAtProbe(
    const Vec3f& p, const ProbeStratum* strata, int count, PathBatchResult& result)
{
    mShadow.count = 0;
    const auto add = [&](int i, const Vec3f& direction, const Color& value) {
        mShadowValue[mShadow.count - 1] = value;
        mShadowStratum[mShadow.count - 1] = i;
        result.ex[i] = direction.x;
        result.ey[i] = direction.y;
        result.ez[i] = direction.z;
    };
    for (int i = 0; i < count; ++i) {
        if (strata[i].infinite != Vec3f(0)) {
            mShadow.push(p, strata[i].infinite, kInfinity);
            add(i, strata[i].infinite, strata[i].value);
            continue;
        }
        const EmitterSample s = sampleStratum(mImpl, p, strata[i].t);
        if (!(s.pdf > 0)) continue;
        pushShadow(mShadow, p, s);
        add(i, s.direction, probeValue(s));
        if (result.wantPlanes && !s.infinite) {
            result.emitterPlane[i] = InversePlane(s.normal, s.direction, (s.target - p).length());
        }
    }
    occlude(mImpl, mShadow, mOccluded);
    note(mShadow, true);
    result.traced += static_cast<std::uint64_t>(mShadow.count);
    for (int j = 0; j < mShadow.count; ++j) {
        if (!mOccluded[j]) result.emitter[mShadowStratum[j]] = mShadowValue[j];
    }
}

void PathTracer::startPaths(const Vec3f& p, const ProbeStratum* strata, std::uint64_t first,
    int count, std::uint64_t key, PathBatchResult& result)
{
    const bool direct = mOptions.contribution != Contribution::Indirect;
    prefetchSurfaces(mImpl, result.hits, count);
    mPathCount = 0;
    for (int i = 0; i < count; ++i) {
        const Vec3f d = result.rays.direction(i);
        result.backFace[i] = false;
        if (result.wantPlanes) result.plane[i] = InversePlane();
        if (result.hits.triangle[i] == kMiss) {
            result.uniform[i] = strata[i].background;
            continue;
        }
        Path& path = mPaths[mPathCount];
        path.surface = mImpl.surfaceSeen(
            p, d, result.hits.triangle[i], result.hits.t[i], result.hits.u[i], result.hits.v[i]);
        const SurfacePoint& s = path.surface;
        result.backFace[i] = s.backFace;
        if (result.wantPlanes) result.plane[i] = InversePlane(s.normal, d, result.hits.t[i]);
        if (direct && s.emitter >= 0) {
            const double pdf = mImpl.emitters.pdfTriangle(
                {p}, s.emitter, result.hits.t[i], std::abs(s.normal.dot(d)));
            result.uniform[i] = s.emission * uniformWeight(pdf);
        }
        if (maxComponent(s.albedo) <= 0) continue;
        path.throughput = Color(1.0f);
        path.distance = result.hits.t[i];
        path.stratum = i;
        path.rng = CounterRng(hashCombine(key, first + static_cast<std::uint64_t>(i)));
        ++mPathCount;
    }
}

void PathTracer::addUnoccluded(PathBatchResult& result)
{
    occludeScattered(mImpl, mShadow, mOccluded);
    note(mShadow, true);
    result.traced += static_cast<std::uint64_t>(mShadow.count);
    for (int j = 0; j < mShadow.count; ++j) {
        if (!mOccluded[j]) result.uniform[mShadowStratum[j]] += mShadowValue[j];
    }
}

/// Reflected light at the surfaces seen, from the cache, and straight from the emitters where the
/// cache leaves that out: found by both strategies, but nothing goes on from what a ray meets.
/// Where the first surface is so near that a few patches fill the view, their error would be the
/// place's: it is gathered by a path of one more surface.
void PathTracer::lookUp(PathBatchResult& result)
{
    for (int bounce = 1; mPathCount > 0; ++bounce) {
        int kept = 0;
        for (int j = 0; j < mPathCount; ++j) {
            Path& path = mPaths[j];
            const SurfacePoint& s = path.surface;
            const RadianceCache::Light light = mOptions.cache->at(s.triangle, s.u, s.v, s.behind);
            // One surface more would be one reflection too many where they are counted.
            path.goesOn = bounce == 1 && mOptions.maxBounces < 0
                && path.distance < kNearPatches * light.extent;
            if (!path.goesOn) {
                result.uniform[path.stratum]
                    += path.throughput * s.albedo * light.irradiance * (1 / kPi);
            }
            if (path.goesOn || light.mixed) mPaths[kept++] = path;
        }
        mPathCount = kept;
        if (kept == 0) return;
        reflectFromEmitters(result);
        reflectFromPunctual(result);
        scatter(bounce, result);
        const Path* const end = std::remove_if(
            mPaths, mPaths + mPathCount, [](const Path& path) { return !path.goesOn; });
        mPathCount = static_cast<int>(end - mPaths);
    }
}

void PathTracer::gather(const SurfacePoint* points, const GatherDraw* draws, int count,
    int emitterSamples, PathBatchResult& result)
{
    mPathCount = count;
    result.traced = 0;
    for (int i = 0; i < count; ++i) {
        result.uniform[i] = Color(0.0f);
        result.backFace[i] = false;
        Path& path = mPaths[i];
        path.surface = points[i];
        path.surface.albedo = path.throughput = Color(1.0f);
        path.stratum = i;
        path.rng = CounterRng(draws[i].key);
    }
    reflectFromPunctual(result);
    std::copy_n(result.uniform, count, result.emitter);
    mEmitterSamples = emitterSamples;
    for (int i = 0; i < emitterSamples; ++i) reflectFromEmitters(result, draws, i);
    findOpen(points, draws, count, result);
    mNext.count = 0;
    for (int i = 0; i < count; ++i) {
        const Vec3f d = cosineDirection(points[i].normal, draws[i].square.x, draws[i].square.y);
        mNext.push(points[i].leaving(), d, kInfinity);
    }
    intersectCoherent(mImpl, mNext, mNextHits);
    follow(result, true);
    mEmitterSamples = 1;
    mSeen.clear();
    for (int j = 0; j < mPathCount; ++j) {
        mSeen.push_back({mPaths[j].surface, mPaths[j].stratum, mPaths[j].distance});
    }
}

void PathTracer::findOpen(
    const SurfacePoint* points, const GatherDraw* draws, int count, PathBatchResult& result)
{
    std::fill_n(result.open, count, 1.0f);
    for (int number = 0; number < kLooks; ++number) {
        mShadow.count = 0;
        for (int i = 0; i < count; ++i) {
            if (!(draws[i].reach > 0)) continue;
            const Vec2d at = draws[i].around + kR2 * number;
            const Vec3f d = cosineDirection(points[i].normal, static_cast<float>(fraction(at.x)),
                static_cast<float>(fraction(at.y)));
            mShadowStratum[mShadow.count] = i;
            mShadow.push(points[i].leaving(), d, draws[i].reach);
        }
        occludeScattered(mImpl, mShadow, mOccluded);
        note(mShadow, true);
        result.traced += static_cast<std::uint64_t>(mShadow.count);
        for (int j = 0; j < mShadow.count; ++j) {
            if (mOccluded[j]) result.open[mShadowStratum[j]] -= 1.0f / kLooks;
        }
    }
}

void PathTracer::reflectFromEmitters(PathBatchResult& result, const GatherDraw* draws, int number)
{
    if (mImpl.emitters.empty()) return;
    mShadow.count = 0;
    double t[kBatch], u[kBatch], v[kBatch];
    // Samples of one surface: strata of the choice, a Kronecker sequence over the emitter.
    const double share = number / static_cast<double>(mEmitterSamples);
    const Vec2d step = kR2 * number;
    for (int j = 0; j < mPathCount; ++j) {
        CounterRng& rng = mPaths[j].rng;
        t[j] = draws ? fraction(draws[j].emitter.x + share) : rng.nextDouble();
        u[j] = draws ? fraction(draws[j].emitter.y + step.x) : rng.nextDouble();
        v[j] = draws ? fraction(draws[j].emitter.z + step.y) : rng.nextDouble();
        mImpl.emitters.prefetch(mPaths[j].surface.receiver(), t[j]);
    }
    std::int64_t texel[kBatch]; // of the sky
    for (int j = 0; j < mPathCount; ++j) {
        texel[j] = mImpl.emitters.skyTexel(mPaths[j].surface.receiver(), t[j]);
    }
    for (int j = 0; j < mPathCount; ++j) {
        const Path& path = mPaths[j];
        const SurfacePoint& s = path.surface;
        const EmitterSample e = texel[j] >= 0
            ? mImpl.emitters.sampleSkyTexel(s.receiver(), texel[j], u[j], v[j])
            : mImpl.emitters.sample(
                s.receiver(), t[j], u[j], v[j], [&](std::uint32_t triangle, float tu, float tv) {
                    return mImpl.emissionAt(mImpl.triangles[triangle], tu, tv);
                });
        pushReflected(path, e);
    }
    addUnoccluded(result);
}

/// The shadow ray of @a e and what it brings.
void PathTracer::pushReflected(const Path& path, const EmitterSample& e)
{
    const SurfacePoint& s = path.surface;
    const float cosine = s.normal.dot(e.direction);
    if (!(e.pdf > 0) || !(cosine > 0)) return;
    // f cos / (n p_emitter + p_cosine): balance heuristic of n such samples and the cosine sample
    // of scatter(), whose density is cos / π.
    mShadowValue[mShadow.count] = path.throughput * s.albedo * e.radiance
        * static_cast<float>(cosine / (mEmitterSamples * e.pdf * kPi + cosine));
    mShadowStratum[mShadow.count] = path.stratum;
    pushShadow(mShadow, s.leaving(), e);
}

void PathTracer::reflectFromPunctual(PathBatchResult& result)
{
    if (mImpl.punctual.empty()) return;
    mShadow.count = 0;
    for (int j = 0; j < mPathCount; ++j) {
        Path& path = mPaths[j];
        PunctualSample light;
        const double t = path.rng.nextDouble();
        if (!mImpl.punctual.sample(path.surface.receiver(), t, light)) continue;
        const float cosine = path.surface.normal.dot(light.direction);
        mShadowValue[mShadow.count]
            = path.throughput * path.surface.albedo * light.irradiance * (cosine / kPi);
        mShadowStratum[mShadow.count] = path.stratum;
        const Vec3f from = path.surface.leaving();
        if (light.infinite) {
            mShadow.push(from, light.direction, kInfinity);
        } else {
            mShadow.push(from, light.target - from, kShadowEnd);
        }
    }
    addUnoccluded(result);
}

void PathTracer::scatter(int bounce, PathBatchResult& result)
{
    // Directions and survival of all paths, then one batch of rays.
    int alive = 0;
    mNext.count = 0;
    for (int j = 0; j < mPathCount; ++j) {
        Path& path = mPaths[j];
        path.throughput *= path.surface.albedo;
        const float q = survival(path.throughput, bounce);
        if (!(path.rng.next() < q)) continue;
        path.throughput /= q;
        const float u1 = path.rng.next(), u2 = path.rng.next();
        mNext.push(path.surface.leaving(), cosineDirection(path.surface.normal, u1, u2), kInfinity);
        if (alive != j) mPaths[alive] = path;
        ++alive;
    }
    intersectScattered(mImpl, mNext, mNextHits);
    follow(result);
}

/// Adds what the rays mNext of mPaths bring, and moves those paths to what they met.
void PathTracer::follow(PathBatchResult& result, bool markBacks)
{
    note(mNext, false);
    result.traced += static_cast<std::uint64_t>(mNext.count);
    prefetchSurfaces(mImpl, mNextHits, mNext.count);
    mPathCount = 0;
    for (int j = 0; j < mNext.count; ++j) {
        Path& path = mPaths[j];
        const Vec3f d = mNext.direction(j);
        const double cosinePdf = std::max(0.0f, path.surface.normal.dot(d)) / kPi;
        const auto weight = [&](double pdf) {
            return static_cast<float>(cosinePdf / (cosinePdf + mEmitterSamples * pdf));
        };
        if (!(cosinePdf > 0)) continue;
        if (mNextHits.triangle[j] == kMiss) {
            const Environment::Arrival light = background(mImpl, path.surface.receiver(), d);
            result.uniform[path.stratum] += path.throughput * light.radiance * weight(light.pdf);
            continue;
        }
        const SurfacePoint s = mImpl.surfaceSeen(path.surface.leaving(), d, mNextHits.triangle[j],
            mNextHits.t[j], mNextHits.u[j], mNextHits.v[j]);
        if (s.emitter >= 0) {
            const double pdf = mImpl.emitters.pdfTriangle(
                path.surface.receiver(), s.emitter, mNextHits.t[j], std::abs(s.normal.dot(d)));
            result.uniform[path.stratum] += path.throughput * s.emission * weight(pdf);
        }
        if (markBacks && s.backFace) result.backFace[path.stratum] = true;
        if (maxComponent(s.albedo) <= 0) continue;
        Path& next = mPaths[mPathCount++];
        next.surface = s;
        next.distance = mNextHits.t[j];
        next.throughput = path.throughput;
        next.stratum = path.stratum;
        next.goesOn = path.goesOn;
        next.rng = path.rng;
    }
}

std::uint64_t PathTracer::punctual(
    std::size_t first, std::size_t count, const Vec3f& p, PunctualSample* lights)
{
    mShadow.count = 0;
    for (std::size_t i = 0; i < count; ++i) {
        const Light& light = mImpl.scene->lights[first + i];
        PunctualSample& s = lights[i];
        s = samplePunctual(light, mImpl.toLocal(light.position), p);
        if (!(maxComponent(s.irradiance) > 0)) continue;
        mShadowStratum[mShadow.count] = static_cast<int>(i);
        mShadow.push(
            p, s.infinite ? s.direction : s.target - p, s.infinite ? kInfinity : kShadowEnd);
    }
    occlude(mImpl, mShadow, mOccluded);
    note(mShadow, true);
    for (int j = 0; j < mShadow.count; ++j) {
        if (mOccluded[j]) lights[mShadowStratum[j]].irradiance = Color(0.0f);
    }
    return static_cast<std::uint64_t>(mShadow.count);
}

} // namespace lumivdb
