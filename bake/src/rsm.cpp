// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/rsm.h>

#include "light_rays.h"
#include "packets.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <atomic>
#include <cmath>
#include <limits>

namespace lumivdb {

namespace {

/// Least cosine that an area is divided by: a beam that grazes a surface has no end on it.
constexpr float kGrazing = 1e-4f;

/// Follows a light's beams to the surfaces, a batch of neighbours at a time.
class MapTracer {
public:
    MapTracer(const Tracer::Impl& impl, const LightRays& light)
        : mImpl(impl)
        , mLight(light)
        , mBatches((light.count() + kBatch - 1) / kBatch)
    {
    }

    std::vector<Surfel> run(Progress& progress)
    {
        progress.begin("trace reflective shadow maps", mLight.count());
        std::atomic<bool> stop{false};
        tbb::parallel_for(std::size_t{0}, mBatches.size(), [&](std::size_t b) {
            if (stop || progress.cancelled()) {
                stop = true;
                return;
            }
            progress.advance(trace(b));
        });
        if (stop) {
            throw Error(
                ErrorCode::Interrupted, "The reflective shadow maps were interrupted half-way.");
        }
        return joined();
    }

private:
    std::uint64_t trace(std::size_t batch)
    {
        const std::size_t first = batch * kBatch;
        const std::size_t count = std::min<std::size_t>(kBatch, mLight.count() - first);
        LightRay beams[kBatch];
        RayBatch rays;
        int beamOf[kBatch];
        const double range = mLight.range();
        const float far
            = range > 0 ? static_cast<float>(range) : std::numeric_limits<float>::infinity();
        for (std::size_t i = 0; i < count; ++i) {
            beams[i] = mLight.ray(first + i);
            if (!(luminance(beams[i].flux) > 0)) continue;
            beamOf[rays.count] = static_cast<int>(i);
            rays.push(beams[i].origin, beams[i].direction, far);
        }
        HitBatch hits;
        intersectCoherent(mImpl, rays, hits);
        for (int i = 0; i < rays.count; ++i) {
            if (hits.triangle[i] == kMiss) continue;
            const LightRay& beam = beams[beamOf[i]];
            const SurfacePoint s = mImpl.surfaceSeen(
                beam.origin, beam.direction, hits.triangle[i], hits.t[i], hits.u[i], hits.v[i]);
            if (!s.backFace) mBatches[batch].push_back(surfel(beam, s, hits.t[i], range));
        }
        return count;
    }

    Surfel surfel(const LightRay& beam, const SurfacePoint& s, float distance, double range) const
    {
        Surfel r;
        r.position = Vec3d(s.position) + mImpl.origin;
        r.normal = s.normal;
        r.flux = s.albedo * beam.flux * static_cast<float>(rangeWindow(distance, range));
        const float cosine = std::max(kGrazing, -s.normal.dot(beam.direction));
        r.area = (beam.section + beam.solidAngle * distance * distance) / cosine;
        return r;
    }

    std::vector<Surfel> joined()
    {
        std::size_t count = 0;
        for (const auto& b : mBatches) count += b.size();
        std::vector<Surfel> all;
        all.reserve(count);
        for (auto& b : mBatches) {
            all.insert(all.end(), b.begin(), b.end());
            std::vector<Surfel>().swap(b);
        }
        return all;
    }

    const Tracer::Impl& mImpl;
    const LightRays& mLight;
    std::vector<std::vector<Surfel>> mBatches;
};

std::vector<Surfel> reflected(const Tracer::Impl& impl, const std::unique_ptr<LightRays>& light,
    Progress* progress, std::uint64_t* rays = nullptr)
{
    if (!light) return {};
    if (rays) *rays += light->count();
    Progress silent;
    return MapTracer(impl, *light).run(progress ? *progress : silent);
}

} // namespace

void RsmOptions::validate() const
{
    if (resolution < 1 || resolution > 16384) {
        throw Error(ErrorCode::Usage,
            "resolution of the reflective shadow maps is " + std::to_string(resolution)
                + "; take 1 to 16384 texels a side.");
    }
}

std::vector<Surfel> reflectedLight(
    const Tracer& tracer, const Light& light, const RsmOptions& options, Progress* progress)
{
    options.validate();
    return reflected(tracer.impl(), punctualRays(tracer.impl(), light, options), progress);
}

std::vector<Surfel> reflectedEmission(
    const Tracer& tracer, const RsmOptions& options, Progress* progress)
{
    options.validate();
    return reflected(tracer.impl(), emissionRays(tracer.impl(), options), progress);
}

std::vector<Surfel> reflectedEnvironment(
    const Tracer& tracer, const RsmOptions& options, Progress* progress)
{
    options.validate();
    return reflected(tracer.impl(), environmentRays(tracer.impl(), options), progress);
}

std::vector<Surfel> reflectedLight(
    const Tracer& tracer, const RsmOptions& options, Progress* progress, std::uint64_t* rays)
{
    options.validate();
    const Tracer::Impl& impl = tracer.impl();
    std::vector<Surfel> all;
    RsmOptions own = options;
    std::uint64_t number = 0;
    const auto add = [&](const auto& makeRays) {
        own.seed = hashCombine(mixBits(options.seed), number++);
        const std::vector<Surfel> more = reflected(impl, makeRays(own), progress, rays);
        all.insert(all.end(), more.begin(), more.end());
    };
    for (const Light& light : tracer.scene().lights) {
        add([&](const RsmOptions& o) { return punctualRays(impl, light, o); });
    }
    add([&](const RsmOptions& o) { return emissionRays(impl, o); });
    add([&](const RsmOptions& o) { return environmentRays(impl, o); });
    return all;
}

std::vector<Surfel> importantSurfels(
    const std::vector<Surfel>& surfels, std::size_t count, std::uint64_t seed)
{
    if (surfels.size() <= count) return surfels;
    double total = 0;
    for (const Surfel& s : surfels) total += luminance(s.flux);
    std::vector<Surfel> chosen;
    if (count == 0 || !(total > 0)) return chosen;
    chosen.reserve(count);
    // Draw k lies at (k + start) steps along the running sum.
    const double step = total / static_cast<double>(count);
    const double start = CounterRng(mixBits(seed)).nextDouble();
    double sum = 0, drawn = 0;
    for (const Surfel& s : surfels) {
        const double share = luminance(s.flux);
        sum += share;
        const double until
            = std::min(static_cast<double>(count), std::ceil(std::max(0.0, sum / step - start)));
        const double draws = until - drawn;
        if (!(draws > 0)) continue;
        drawn = until;
        const auto weight = static_cast<float>(draws * step / share);
        Surfel kept = s;
        kept.flux *= weight;
        kept.area *= weight;
        chosen.push_back(kept);
    }
    return chosen;
}

} // namespace lumivdb
