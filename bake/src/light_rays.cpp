// SPDX-License-Identifier: Apache-2.0
#include "light_rays.h"

#include "directions.h"

#include <lumivdb/bake/rsm.h>
#include <lumivdb/core/random.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;

Vec2d jittered(CounterRng& rng, std::size_t texel, std::size_t n)
{
    const double x = static_cast<double>(texel % n) + rng.nextDouble();
    const double y = static_cast<double>(texel / n) + rng.nextDouble();
    return Vec2d(x, y) / static_cast<double>(n);
}

/// Area-preserving map of the unit square onto the unit disc (Shirley & Chiu 1997).
Vec2d squareToDisc(const Vec2d& uv)
{
    const double a = 2 * uv.x - 1, b = 2 * uv.y - 1;
    if (a == 0 && b == 0) return {0, 0};
    const bool wide = std::abs(a) > std::abs(b);
    const double r = wide ? a : b;
    const double phi = wide ? kPi / 4 * (b / a) : kPi / 2 - kPi / 4 * (a / b);
    return {r * std::cos(phi), r * std::sin(phi)};
}

/// Solid-angle-preserving map of the unit square onto the face [-1,1]² of a cube one away from
/// its middle: x from the share of the solid angle to its left, 2 atan(x/√(2+x²)), then y from
/// the share below it along that line, y √(2+x²)/√(1+x²+y²).
Vec2d squareToCubeFace(const Vec2d& uv)
{
    const double t = std::tan((uv.x - 0.5) * kPi / 3);
    const double x = t * std::sqrt(2 / (1 - t * t));
    const double s = (2 * uv.y - 1) / std::sqrt(2 + x * x);
    return {x, s * std::sqrt((1 + x * x) / (1 - s * s))};
}

/// Right-handed frame round a direction.
struct Frame {
    Vec3d s, t, n;
    /// @a axis unit. `s` is near the world axis that is farthest from n, so a light along an axis
    /// has its map along the others.
    explicit Frame(const Vec3d& axis)
        : n(axis)
    {
        const Vec3d a(std::abs(n.x), std::abs(n.y), std::abs(n.z));
        const Vec3d side = a.x <= a.y && a.x <= a.z ? Vec3d(1, 0, 0)
            : a.z <= a.y                            ? Vec3d(0, 0, 1)
                                                    : Vec3d(0, 1, 0);
        s = (side - n * n.dot(side)).normalized();
        t = n.cross(s);
    }
    Vec3d world(double x, double y, double z) const { return s * x + t * y + n * z; }
};

/// What of @a a is in @a b.
Box3d intersection(Box3d a, const Box3d& b)
{
    for (int i = 0; i < 3; ++i) {
        a.min[i] = std::max(a.min[i], b.min[i]);
        a.max[i] = std::min(a.max[i], b.max[i]);
    }
    return a;
}

/// The part of the scene's box that is to be lit.
Box3d localRegion(const Tracer::Impl& tracer, const RsmOptions& options)
{
    Box3d box = tracer.scene->bounds();
    if (options.region) box = intersection(box, *options.region);
    if (box.isEmpty()) return box;
    box.min -= tracer.origin;
    box.max -= tracer.origin;
    return box;
}

/// Extent of @a box along @a axis.
struct Extent {
    double low, high;
    Extent(const Box3d& box, const Vec3d& axis)
    {
        const Vec3d middle = box.center(), half = box.size() * 0.5;
        const double reach
            = half.x * std::abs(axis.x) + half.y * std::abs(axis.y) + half.z * std::abs(axis.z);
        low = middle.dot(axis) - reach;
        high = middle.dot(axis) + reach;
    }
    double size() const { return high - low; }
    double at(double share) const { return low + share * size(); }
};

/// Parallel beams that cover a box, from outside the scene.
class ParallelBeams {
public:
    ParallelBeams(const Box3d& region, const Box3d& scene, const Vec3d& direction)
        : mFrame(direction)
        , mS(region, mFrame.s)
        , mT(region, mFrame.t)
    {
        const Extent along(scene, direction);
        mStart = along.low - 1e-3 * along.size();
    }

    double section() const { return mS.size() * mT.size(); }

    /// The beam at @a uv of the unit square; section and flux of the whole.
    LightRay ray(const Vec2d& uv) const
    {
        LightRay r;
        r.origin = Vec3f(mFrame.world(mS.at(uv.x), mT.at(uv.y), mStart));
        r.direction = Vec3f(mFrame.n);
        r.section = static_cast<float>(section());
        return r;
    }

private:
    Frame mFrame;
    Extent mS, mT;
    double mStart;
};

class DirectionalRays : public LightRays {
public:
    DirectionalRays(const Tracer::Impl& tracer, const Light& light, const RsmOptions& options)
        : mN(static_cast<std::size_t>(options.resolution))
        , mSeed(options.seed)
        , mIrradiance(light.intensity)
        , mBeams(
              localRegion(tracer, options), localRegion(tracer, {}), light.direction.normalized())
    {
    }

    std::size_t count() const override { return mN * mN; }

    LightRay ray(std::size_t i) const override
    {
        CounterRng rng(hashCombine(mSeed, i));
        LightRay r = mBeams.ray(jittered(rng, i, mN));
        r.section /= static_cast<float>(mN * mN);
        r.flux = mIrradiance * r.section;
        return r;
    }

private:
    std::size_t mN;
    std::uint64_t mSeed;
    Color mIrradiance;
    ParallelBeams mBeams;
};

/// From one place: over a cone, or everywhere.
class PointRays : public LightRays {
public:
    PointRays(const Tracer::Impl& tracer, const Light& light, const RsmOptions& options)
        : mN(static_cast<std::size_t>(options.resolution))
        , mSeed(options.seed)
        , mLight(light)
        , mPosition(tracer.toLocal(light.position))
        , mAxis(light.direction)
    {
        mLight.range = 0; // seen to by who knows the distance
        mRange = light.range;
        if (light.type == LightType::Spot) mCone = 1 - std::cos(light.outerConeAngle);
        narrow(localRegion(tracer, options));
    }

    std::size_t count() const override { return (mCone < kSphere ? 1 : 6) * mN * mN; }
    double range() const override { return mRange; }

    LightRay ray(std::size_t i) const override
    {
        CounterRng rng(hashCombine(mSeed, i));
        const std::size_t face = i / (mN * mN);
        const Vec2d uv = jittered(rng, i % (mN * mN), mN);
        LightRay r;
        r.origin = mPosition;
        r.direction = Vec3f(mCone < kSphere ? coneDirection(uv) : cubeDirection(face, uv));
        r.solidAngle = static_cast<float>(2 * kPi * mCone / static_cast<double>(count()));
        // Irradiance at distance 1 is the intensity.
        r.flux = samplePunctual(mLight, Vec3f(0.0f), r.direction).irradiance * r.solidAngle;
        return r;
    }

private:
    /// 1 − cos of a cone's half angle; of the sphere, 2.
    static constexpr double kSphere = 2;

    /// A light outside the region's sphere needs no beams beside it.
    void narrow(const Box3d& region)
    {
        const Vec3d to = region.center() - Vec3d(mPosition);
        const double distance = to.length(), radius = 0.5 * region.size().length();
        if (distance <= radius * (1 + 1e-6)) return;
        const double sine = radius * (1 + 1e-6) / distance;
        const double cone = sine * sine / (1 + std::sqrt(1 - sine * sine));
        if (cone >= mCone) return;
        mCone = cone;
        mAxis = Frame(to / distance);
    }

    Vec3d coneDirection(const Vec2d& uv) const
    {
        const Vec2d disc = squareToDisc(uv);
        const double k = mCone * disc.length2(); // 1 − cosine
        const double scale = std::sqrt(mCone * (2 - k)); // sine / radius
        return mAxis.world(disc.x * scale, disc.y * scale, 1 - k);
    }

    static Vec3d cubeDirection(std::size_t face, const Vec2d& uv)
    {
        const Vec2d p = squareToCubeFace(uv);
        const double sign = face & 1 ? -1 : 1;
        const unsigned axis = static_cast<unsigned>(face / 2);
        Vec3d d;
        d[axis] = sign;
        d[(axis + 1) % 3] = p.x;
        d[(axis + 2) % 3] = p.y;
        return d.normalized();
    }

    std::size_t mN;
    std::uint64_t mSeed;
    Light mLight;
    Vec3f mPosition;
    double mRange = 0;
    double mCone = kSphere;
    Frame mAxis;
};

/// Maps of a light that needs many: N of about N texels.
struct ManyMaps {
    std::size_t maps, side;
    explicit ManyMaps(int resolution)
        : maps(static_cast<std::size_t>(resolution))
        , side(static_cast<std::size_t>(std::lround(std::sqrt(resolution))))
    {
    }
    std::size_t texels() const { return side * side; }
    std::size_t count() const { return maps * texels(); }
};

class EmissionRays : public LightRays {
public:
    EmissionRays(const Tracer::Impl& tracer, const RsmOptions& options)
        : mTracer(tracer)
        , mSize(options.resolution)
        , mSeed(options.seed)
    {
        for (const auto& e : tracer.emitters.triangles()) {
            mCdf.push_back((mCdf.empty() ? 0.0 : mCdf.back()) + e.power);
        }
    }

    bool dark() const { return mCdf.empty() || !(mCdf.back() > 0); }
    std::size_t count() const override { return mSize.count(); }

    LightRay ray(std::size_t i) const override
    {
        const std::size_t map = i / mSize.texels();
        double t = jitteredStratum(mSeed, map, mSize.maps);
        const std::size_t chosen = choose(t);
        const EmitterTable::Triangle& e = mTracer.emitters.triangles()[chosen];
        const double chance = e.power / mCdf.back();
        double side = 1;
        if (e.doubleSided) {
            side = t < 0.5 ? 1 : -1;
            t = 2 * t - (t < 0.5 ? 0 : 1);
        }
        const Vec2f place = squareToTriangle(hilbertPoint(t));
        const Vec3f normal = e.normal * static_cast<float>(side);

        CounterRng rng(hashCombine(hashCombine(mSeed, ~map), i % mSize.texels()));
        const Vec2d disc = squareToDisc(jittered(rng, i % mSize.texels(), mSize.side));
        const double cosine = std::sqrt(std::max(1 - disc.length2(), 1e-12));
        LightRay r;
        r.origin = e.a + e.ab * place.x + e.ac * place.y + normal * e.offset;
        r.direction = Vec3f(Frame(Vec3d(normal)).world(disc.x, disc.y, cosine).normalized());
        const auto share = static_cast<float>(kPi / static_cast<double>(mSize.count()));
        const float sides = e.doubleSided ? 2 : 1;
        r.flux = mTracer.emissionAt(mTracer.triangles[e.triangle], place.x, place.y)
            * (share * e.area * sides / static_cast<float>(chance));
        // The surfaces are seen from every point: each has its share of their area.
        r.solidAngle = share / static_cast<float>(cosine);
        return r;
    }

private:
    std::size_t choose(double& t) const
    {
        const double x = t * mCdf.back();
        const auto it = std::upper_bound(mCdf.begin(), mCdf.end() - 1, x);
        const double low = it == mCdf.begin() ? 0 : *(it - 1);
        t = *it > low ? std::clamp((x - low) / (*it - low), 0.0, 0x1.fffffffffffffp-1) : 0;
        return static_cast<std::size_t>(it - mCdf.begin());
    }

    const Tracer::Impl& mTracer;
    ManyMaps mSize;
    std::uint64_t mSeed;
    std::vector<double> mCdf;
};

class EnvironmentRays : public LightRays {
public:
    EnvironmentRays(const Tracer::Impl& tracer, const RsmOptions& options)
        : mEnvironment(*tracer.scene->environment)
        , mRegion(localRegion(tracer, options))
        , mScene(localRegion(tracer, {}))
        , mSize(options.resolution)
        , mSeed(options.seed)
    {
    }

    std::size_t count() const override { return mSize.count(); }

    LightRay ray(std::size_t i) const override
    {
        const std::size_t map = i / mSize.texels();
        const Vec2d uv = hilbertPoint(jitteredStratum(mSeed, map, mSize.maps));
        const Environment::Sample sky = mEnvironment.sample(uv.x, uv.y);
        if (!(sky.pdf > 0)) return {};
        CounterRng rng(hashCombine(hashCombine(mSeed, ~map), i % mSize.texels()));
        const ParallelBeams beams(mRegion, mScene, -sky.direction);
        LightRay r = beams.ray(jittered(rng, i % mSize.texels(), mSize.side));
        r.section /= static_cast<float>(count());
        r.flux = sky.radiance * (r.section / static_cast<float>(sky.pdf));
        return r;
    }

private:
    const Environment& mEnvironment;
    Box3d mRegion, mScene;
    ManyMaps mSize;
    std::uint64_t mSeed;
};

} // namespace

std::unique_ptr<LightRays> punctualRays(
    const Tracer::Impl& tracer, const Light& light, const RsmOptions& options)
{
    if (localRegion(tracer, options).isEmpty()) return nullptr;
    if (light.type == LightType::Directional) {
        return std::make_unique<DirectionalRays>(tracer, light, options);
    }
    return std::make_unique<PointRays>(tracer, light, options);
}

std::unique_ptr<LightRays> emissionRays(const Tracer::Impl& tracer, const RsmOptions& options)
{
    if (localRegion(tracer, options).isEmpty()) return nullptr;
    auto rays = std::make_unique<EmissionRays>(tracer, options);
    if (rays->dark()) return nullptr;
    return rays;
}

std::unique_ptr<LightRays> environmentRays(const Tracer::Impl& tracer, const RsmOptions& options)
{
    const auto& environment = tracer.scene->environment;
    if (!environment || !(environment->power() > 0)) return nullptr;
    if (localRegion(tracer, options).isEmpty()) return nullptr;
    return std::make_unique<EnvironmentRays>(tracer, options);
}

} // namespace lumivdb
