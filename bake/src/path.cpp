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

double fraction(double x) { return x - std::floor(x); }
float maxComponent(const Color& c) { return std::max({c.x, c.y, c.z}); }
/// Balance heuristic of a uniform direction against one drawn with density @a pdf.
float uniformWeight(double pdf) { return static_cast<float>(kUniformPdf / (kUniformPdf + pdf)); }

/// What a ray from @a to that leaves the scene brings, and the density of drawing that way.
Environment::Arrival background(const Tracer::Impl& impl, const Receiver& to, const Vec3f& d)
{
    if (!impl.scene->environment) return {Color(0.0f), 0};
    Environment::Arrival light = impl.scene->environment->arrival(Vec3d(d));
    light.pdf *= impl.emitters.environmentDensity(to, light.sun);
    return light;
}

/// What EmitterTable asks for: radiance of a triangle's front.
auto emissionIn(const Tracer::Impl& impl)
{
    return [&impl](std::uint32_t triangle, float u, float v) {
        return impl.emissionAt(impl.triangles[triangle], u, v);
    };
}

} // namespace

std::vector<ProbeStrata> probeStrata(const Tracer::Impl& impl, const ProbeOptions& options,
    std::uint64_t seed, const std::vector<Vec3f>& directions, int set)
{
    std::vector<ProbeStrata> strata((directions.size() + kBatch - 1) / kBatch);
    if (options.contribution == Contribution::Indirect) return strata;
    const auto positions
        = nestedPositions(seed ^ kEmitterStream, static_cast<std::uint64_t>(options.rays), set);
    const auto emission = emissionIn(impl);
    tbb::parallel_for(std::size_t{0}, directions.size(), [&](std::size_t number) {
        ProbeStrata& batch = strata[number / kBatch];
        const int i = static_cast<int>(number % kBatch);
        batch.position[i] = positions[number];
        if (!impl.emitters.empty()) {
            batch.emitters.set(i, impl.emitters.sampleStratum({}, positions[number], emission));
        }
        const Environment::Arrival light = background(impl, {}, directions[number]);
        batch.background.set(i, light.radiance * uniformWeight(light.pdf));
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

void PathTracer::trace(const Vec3f& p, const Vec3f* directions, const ProbeStrata& strata,
    std::uint64_t first, int count, std::uint64_t key, PathBatchResult& result)
{
    result.traced = 0;
    result.rays.count = 0;
    for (int i = 0; i < count; ++i) {
        result.rays.push(p, directions[i], kInfinity);
        result.uniform.set(i, Color(0.0f));
        result.emitter.set(i, Color(0.0f));
        result.emitterDirection.set(i, Vec3f(0, 0, 1));
        if (result.wantPlanes) result.emitterPlane[i] = InversePlane();
    }
    if (mOptions.contribution != Contribution::Indirect && !mImpl.emitters.empty()) {
        sampleEmittersAtProbe(p, strata, count, result);
    }
    intersectCoherent(mImpl, result.rays, result.hits);
    note(result.rays, false);
    result.traced += static_cast<std::uint64_t>(count);
    startPaths(strata, first, key, result);
    if (mOptions.contribution == Contribution::Direct || mOptions.maxBounces == 0) return;
    if (mOptions.cache) {
        lookUp(result);
        return;
    }
    for (int bounce = 1; mPaths.count > 0; ++bounce) {
        if (mOptions.maxBounces >= 0 && bounce > mOptions.maxBounces) break;
        reflectFromEmitters(result);
        reflectFromPunctual(result);
        scatter(bounce, result);
    }
}

/// Draws again those of a batch's emitters that depend on the place.
void PathTracer::placeEmitters(const Vec3f& p, const ProbeStrata& strata, int count)
{
    mEmitters = strata.emitters;
    const auto emission = emissionIn(mImpl);
    for (int i = 0; i < count; ++i) {
        if (mEmitters.offset[i] < 0) continue; // infinitely far away
        mEmitters.set(i, mImpl.emitters.sampleStratum({p}, strata.position[i], emission));
    }
}

void PathTracer::sampleEmittersAtProbe(
    const Vec3f& p, const ProbeStrata& strata, int count, PathBatchResult& result)
{
    const bool place = mImpl.emitters.dependsOnPlace();
    if (place) placeEmitters(p, strata, count);
    const EmitterBatch& emitters = place ? mEmitters : strata.emitters;
    mShadow.rays.count = 0;
    aimFrom(p, emitters, count, result.emitterDirection, mShadow);
    occlude(mImpl, mShadow.rays, mShadow.occluded);
    note(mShadow.rays, true);
    result.traced += static_cast<std::uint64_t>(mShadow.rays.count);
    for (int j = 0; j < mShadow.rays.count; ++j) {
        const int i = mShadow.stratum[j];
        if (!mShadow.occluded[j]) result.emitter.set(i, mShadow.value[j]);
        if (result.wantPlanes && emitters.offset[i] >= 0) {
            result.emitterPlane[i] = InversePlane(
                emitters.normal[i], result.emitterDirection[i], mShadow.rays.direction(j).length());
        }
    }
}

/// Finds the surfaces that rays met: mMet, and the surfaces of mPaths, by the same numbers.
void PathTracer::meet(const RayBatch& rays, const HitBatch& hits)
{
    int count = 0;
    for (int i = 0; i < rays.count; ++i) {
        mMet.ray[count] = i;
        if (hits.triangle[i] == kMiss) continue;
        ++count;
        mImpl.prefetch(hits.triangle[i]);
    }
    mMet.count = count;
    for (int k = 0; k < count; ++k) {
        const int i = mMet.ray[k];
        const Tracer::Impl::Instance* const instance = mImpl.instanceOf(hits.triangle[i]);
        const Tracer::Impl::Triangle& triangle = mImpl.stored(hits.triangle[i], instance);
        const Corners corners = mImpl.corners(triangle, instance);
        mMet.triangle[k] = &triangle;
        mMet.a.set(k, corners.a);
        mMet.b.set(k, corners.b);
        mMet.c.set(k, corners.c);
        mMet.direction.set(k, rays.direction(i));
        mMet.stretch[k] = instance ? instance->stretch : 1.0f;
        mMet.least[k] = instance ? instance->rounding() : 0.0f;
        mPaths.triangle[k] = hits.triangle[i];
        mPaths.u[k] = hits.u[i];
        mPaths.v[k] = hits.v[i];
        mPaths.distance[k] = hits.t[i];
        if (!mImpl.looks[triangle.mesh].evenAlbedo) {
            mMet.texels[k] = mImpl.placeAlbedo(triangle, hits.u[i], hits.v[i]);
        }
    }
    findSurfaces(mMet, mPaths);
    for (int k = 0; k < count; ++k) {
        const Tracer::Impl::Triangle& triangle = *mMet.triangle[k];
        const Tracer::Impl::Look& look = mImpl.looks[triangle.mesh];
        const bool behind = mMet.facing[k] > 0;
        if (std::isnan(mMet.facing[k]) || (behind && !look.doubleSided)) {
            meetAgain(k, rays, hits);
            continue;
        }
        mPaths.behind[k] = behind;
        mMet.backFace[k] = false;
        const float u = mPaths.u[k], v = mPaths.v[k];
        mPaths.albedo.set(k,
            look.evenAlbedo ? look.albedo
                            : mImpl.albedoFrom(triangle, mMet.texels[k], u, v, nullptr));
        mMet.emitter[k] = behind && look.emitsFrontOnly ? -1 : triangle.emitter;
        if (mMet.emitter[k] >= 0) mMet.emission.set(k, mImpl.emissionAt(triangle, u, v));
    }
}

/// What surfaceSeen() says of the surface number @a k: backs, and triangles next to nothing.
void PathTracer::meetAgain(int k, const RayBatch& rays, const HitBatch& hits)
{
    const int i = mMet.ray[k];
    const SurfacePoint s = mImpl.surfaceSeen({rays.ox[i], rays.oy[i], rays.oz[i]},
        rays.direction(i), hits.triangle[i], hits.t[i], hits.u[i], hits.v[i]);
    mPaths.leaving.set(k, s.leaving());
    mPaths.normal.set(k, s.normal);
    mPaths.albedo.set(k, s.albedo);
    mPaths.u[k] = s.u;
    mPaths.v[k] = s.v;
    mPaths.triangle[k] = s.triangle;
    mPaths.behind[k] = s.behind;
    mMet.facing[k] = s.normal.dot(rays.direction(i)) * (s.behind ? -1.0f : 1.0f);
    mMet.backFace[k] = s.backFace;
    mMet.emitter[k] = s.emission == Color(0.0f) ? -1 : s.emitter;
    mMet.emission.set(k, s.emission);
}

void PathTracer::startPaths(
    const ProbeStrata& strata, std::uint64_t first, std::uint64_t key, PathBatchResult& result)
{
    const bool direct = mOptions.contribution != Contribution::Indirect;
    const RayBatch& rays = result.rays;
    for (int i = 0; i < rays.count; ++i) {
        result.backFace[i] = false;
        if (result.wantPlanes) result.plane[i] = InversePlane();
        if (result.hits.triangle[i] == kMiss) result.uniform.set(i, strata.background[i]);
    }
    meet(rays, result.hits);
    int count = 0;
    for (int k = 0; k < mMet.count; ++k) {
        const int i = mMet.ray[k];
        const Vec3f d = rays.direction(i);
        result.backFace[i] = mMet.backFace[k];
        if (result.wantPlanes) {
            result.plane[i] = InversePlane(mPaths.normal[k], d, result.hits.t[i]);
        }
        if (direct && mMet.emitter[k] >= 0) {
            const Vec3f p(rays.ox[i], rays.oy[i], rays.oz[i]);
            const double pdf = mImpl.emitters.pdfTriangle(
                {p}, mMet.emitter[k], result.hits.t[i], std::abs(mMet.facing[k]));
            result.uniform.set(i, mMet.emission[k] * uniformWeight(pdf));
        }
        if (maxComponent(mPaths.albedo[k]) <= 0) continue;
        if (count != k) mPaths.moveSurface(k, count);
        mPaths.throughput.set(count, Color(1.0f));
        mPaths.stratum[count] = i;
        mPaths.rng[count] = CounterRng(hashCombine(key, first + static_cast<std::uint64_t>(i)));
        ++count;
    }
    mPaths.count = count;
}

void PathTracer::addUnoccluded(PathBatchResult& result)
{
    occludeScattered(mImpl, mShadow.rays, mShadow.occluded);
    note(mShadow.rays, true);
    result.traced += static_cast<std::uint64_t>(mShadow.rays.count);
    for (int j = 0; j < mShadow.rays.count; ++j) {
        if (!mShadow.occluded[j]) result.uniform.add(mShadow.stratum[j], mShadow.value[j]);
    }
}

/// Reflected light at the surfaces seen, from the cache, and straight from the emitters where the
/// cache leaves that out: found by both strategies, but nothing goes on from what a ray meets.
/// Where the first surface is so near that a few patches fill the view, their error would be the
/// place's: it is gathered by a path of one more surface.
void PathTracer::lookUp(PathBatchResult& result)
{
    for (int bounce = 1; mPaths.count > 0; ++bounce) {
        int kept = 0;
        const auto keep = [&](int j) {
            if (kept != j) {
                mPaths.moveSurface(j, kept);
                mPaths.movePath(j, kept);
            }
            ++kept;
        };
        for (int j = 0; j < mPaths.count; ++j) {
            const RadianceCache::Light light = mOptions.cache->at(
                mPaths.triangle[j], mPaths.u[j], mPaths.v[j], mPaths.behind[j]);
            // One surface more would be one reflection too many where they are counted.
            mPaths.goesOn[j] = bounce == 1 && mOptions.maxBounces < 0
                && mPaths.distance[j] < kNearPatches * light.extent;
            if (!mPaths.goesOn[j]) {
                result.uniform.add(mPaths.stratum[j],
                    mPaths.throughput[j] * mPaths.albedo[j] * light.irradiance * (1 / kPi));
            }
            if (mPaths.goesOn[j] || light.mixed) keep(j);
        }
        mPaths.count = kept;
        if (kept == 0) return;
        reflectFromEmitters(result);
        reflectFromPunctual(result);
        scatter(bounce, result);
        kept = 0;
        for (int j = 0; j < mPaths.count; ++j) {
            if (mPaths.goesOn[j]) keep(j);
        }
        mPaths.count = kept;
    }
}

void PathTracer::gather(const SurfacePoint* points, const GatherDraw* draws, int count,
    int emitterSamples, PathBatchResult& result)
{
    mPaths.count = count;
    result.traced = 0;
    for (int i = 0; i < count; ++i) {
        result.uniform.set(i, Color(0.0f));
        result.backFace[i] = false;
        mPaths.leaving.set(i, points[i].leaving());
        mPaths.normal.set(i, points[i].normal);
        mPaths.albedo.set(i, Color(1.0f));
        mPaths.throughput.set(i, Color(1.0f));
        mPaths.stratum[i] = i;
        mPaths.rng[i] = CounterRng(draws[i].key);
    }
    reflectFromPunctual(result);
    result.emitter = result.uniform;
    mEmitterSamples = emitterSamples;
    for (int i = 0; i < emitterSamples; ++i) reflectFromEmitters(result, draws, i);
    findOpen(draws, result);
    for (int i = 0; i < count; ++i) {
        mScatter.u[i] = draws[i].square.x;
        mScatter.v[i] = draws[i].square.y;
    }
    cosineRays(mPaths, mScatter, mNext);
    intersectCoherent(mImpl, mNext, mNextHits);
    follow(result, true);
    mEmitterSamples = 1;
    mSeen.clear();
    for (int j = 0; j < mPaths.count; ++j) {
        mSeen.push_back({mPaths.triangle[j], mPaths.u[j], mPaths.v[j], mPaths.behind[j],
            mPaths.albedo[j], mPaths.stratum[j], mPaths.distance[j]});
    }
}

void PathTracer::findOpen(const GatherDraw* draws, PathBatchResult& result)
{
    std::fill_n(result.open, mPaths.count, 1.0f);
    for (int number = 0; number < kLooks; ++number) {
        for (int i = 0; i < mPaths.count; ++i) {
            const Vec2d at = draws[i].around + kR2 * number;
            mScatter.u[i] = static_cast<float>(fraction(at.x));
            mScatter.v[i] = static_cast<float>(fraction(at.y));
        }
        cosineRays(mPaths, mScatter, mNext);
        mShadow.rays.count = 0;
        for (int i = 0; i < mPaths.count; ++i) {
            if (!(draws[i].reach > 0)) continue;
            mShadow.push(i, Color(0.0f), mPaths.leaving[i], mNext.direction(i), draws[i].reach);
        }
        occludeScattered(mImpl, mShadow.rays, mShadow.occluded);
        note(mShadow.rays, true);
        result.traced += static_cast<std::uint64_t>(mShadow.rays.count);
        for (int j = 0; j < mShadow.rays.count; ++j) {
            if (mShadow.occluded[j]) result.open[mShadow.stratum[j]] -= 1.0f / kLooks;
        }
    }
}

void PathTracer::reflectFromEmitters(PathBatchResult& result, const GatherDraw* draws, int number)
{
    if (mImpl.emitters.empty()) return;
    double t[kBatch];
    float u[kBatch], v[kBatch];
    // Samples of one surface: strata of the choice, a Kronecker sequence over the emitter.
    const double share = number / static_cast<double>(mEmitterSamples);
    const Vec2d step = kR2 * number;
    for (int j = 0; j < mPaths.count; ++j) {
        if (draws) {
            t[j] = fraction(draws[j].emitter.x + share);
            u[j] = static_cast<float>(fraction(draws[j].emitter.y + step.x));
            v[j] = static_cast<float>(fraction(draws[j].emitter.z + step.y));
        } else {
            t[j] = mPaths.rng[j].nextDouble();
            const Vec2f square = mPaths.rng[j].nextPair();
            u[j] = square.x;
            v[j] = square.y;
        }
    }
    drawEmitters(t, u, v);
    mShadow.rays.count = 0;
    aimFromSurfaces(mPaths, mEmitters, mEmitterSamples, mShadow);
    addUnoccluded(result);
}

/// mEmitters: one for each path.
void PathTracer::drawEmitters(const double* t, const float* u, const float* v)
{
    double sky[kBatch];
    std::uint32_t texel[kBatch];
    std::fill_n(sky, mPaths.count, -1.0);
    for (int j = 0; j < mPaths.count && mImpl.emitters.hasSky(); ++j) {
        sky[j] = mImpl.emitters.skyRest(mPaths.receiver(j), t[j]);
        if (sky[j] >= 0) mImpl.emitters.prefetchSky(sky[j]);
    }
    for (int j = 0; j < mPaths.count; ++j) {
        if (sky[j] >= 0) texel[j] = mImpl.emitters.skyTexel(sky[j]);
    }
    const auto emission = emissionIn(mImpl);
    for (int j = 0; j < mPaths.count; ++j) {
        const Receiver to = mPaths.receiver(j);
        mEmitters.set(j,
            sky[j] >= 0 ? mImpl.emitters.sampleSkyTexel(to, texel[j], u[j], v[j])
                        : mImpl.emitters.sampleElsewhere(to, t[j], u[j], v[j], emission));
    }
}

void PathTracer::reflectFromPunctual(PathBatchResult& result)
{
    if (mImpl.punctual.empty()) return;
    mShadow.rays.count = 0;
    for (int j = 0; j < mPaths.count; ++j) {
        PunctualSample light;
        const Receiver to = mPaths.receiver(j);
        if (!mImpl.punctual.sample(to, mPaths.rng[j].nextDouble(), light)) continue;
        const Color value = mPaths.throughput[j] * mPaths.albedo[j] * light.irradiance
            * (to.normal.dot(light.direction) / kPi);
        mShadow.push(mPaths.stratum[j], value, to.position,
            light.infinite ? light.direction : light.target - to.position,
            light.infinite ? kInfinity : kShadowEnd);
    }
    addUnoccluded(result);
}

void PathTracer::scatter(int bounce, PathBatchResult& result)
{
    for (int j = 0; j < mPaths.count; ++j) {
        CounterRng& rng = mPaths.rng[j];
        mScatter.survive[j] = rng.next();
        const Vec2f square = rng.nextPair();
        mScatter.u[j] = square.x;
        mScatter.v[j] = square.y;
    }
    const float longest = bounce < kLongPath ? 1.0f : kLongPathSurvival;
    const int alive = scatterPaths(mPaths, longest, mScatter, mNext);
    for (int j = 0; j < alive; ++j) {
        const int from = mScatter.path[j];
        mPaths.stratum[j] = mPaths.stratum[from];
        mPaths.rng[j] = mPaths.rng[from];
        mPaths.goesOn[j] = mPaths.goesOn[from];
    }
    intersectScattered(mImpl, mNext, mNextHits);
    follow(result);
}

/// Adds what the rays mNext of mPaths bring, and moves those paths to what they met.
void PathTracer::follow(PathBatchResult& result, bool markBacks)
{
    note(mNext, false);
    result.traced += static_cast<std::uint64_t>(mNext.count);
    // Balance heuristic against the emitter samples of where a ray comes from.
    const auto weight = [&](int j, double pdf) {
        const double cosinePdf = static_cast<double>(mScatter.cosine[j]) / kPi;
        return static_cast<float>(cosinePdf / (cosinePdf + mEmitterSamples * pdf));
    };
    const auto from = [&](int j) {
        return Receiver{{mNext.ox[j], mNext.oy[j], mNext.oz[j]}, mScatter.normal[j]};
    };
    for (int j = 0; j < mNext.count; ++j) {
        if (mNextHits.triangle[j] != kMiss || !(mScatter.cosine[j] > 0)) continue;
        const Environment::Arrival light = background(mImpl, from(j), mNext.direction(j));
        result.uniform.add(
            mPaths.stratum[j], mPaths.throughput[j] * light.radiance * weight(j, light.pdf));
    }
    meet(mNext, mNextHits);
    int count = 0;
    for (int k = 0; k < mMet.count; ++k) {
        const int j = mMet.ray[k], stratum = mPaths.stratum[j];
        if (!(mScatter.cosine[j] > 0)) continue;
        if (mMet.emitter[k] >= 0) {
            const double pdf = mImpl.emitters.pdfTriangle(
                from(j), mMet.emitter[k], mNextHits.t[j], std::abs(mMet.facing[k]));
            result.uniform.add(stratum, mPaths.throughput[j] * mMet.emission[k] * weight(j, pdf));
        }
        if (markBacks && mMet.backFace[k]) result.backFace[stratum] = true;
        if (maxComponent(mPaths.albedo[k]) <= 0) continue;
        if (count != k) mPaths.moveSurface(k, count);
        if (count != j) mPaths.movePath(j, count);
        ++count;
    }
    mPaths.count = count;
}

std::uint64_t PathTracer::punctual(
    std::size_t first, std::size_t count, const Vec3f& p, PunctualSample* lights)
{
    mShadow.rays.count = 0;
    for (std::size_t i = 0; i < count; ++i) {
        const Light& light = mImpl.scene->lights[first + i];
        PunctualSample& s = lights[i];
        s = samplePunctual(light, mImpl.toLocal(light.position), p);
        if (!(maxComponent(s.irradiance) > 0)) continue;
        mShadow.push(static_cast<int>(i), Color(0.0f), p, s.infinite ? s.direction : s.target - p,
            s.infinite ? kInfinity : kShadowEnd);
    }
    occlude(mImpl, mShadow.rays, mShadow.occluded);
    note(mShadow.rays, true);
    for (int j = 0; j < mShadow.rays.count; ++j) {
        if (mShadow.occluded[j]) lights[mShadow.stratum[j]].irradiance = Color(0.0f);
    }
    return static_cast<std::uint64_t>(mShadow.rays.count);
}

} // namespace lumivdb
