// SPDX-License-Identifier: Apache-2.0
#include "pilot.h"

#include "seconds.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>

namespace lumivdb {

namespace {

constexpr int kNormals = 32;
/// Separates the pilot's places from those of the bake and of evaluations.
constexpr std::uint64_t kPilotStream = 0x9c1e3f5b7a2d4861ull;

/// Irradiance for all normals, direct and by SH, of one place.
struct Look {
    bool free = false;
    std::vector<Color> direct, error, expanded; // expanded: [bands][normal]
    std::uint64_t rays = 0;
};

class Looker {
public:
    Looker(const Tracer& tracer, const ProbeOptions& probe)
        : mEstimator(tracer, probe)
        , mNormals(uniformNormals(kNormals))
    {
    }

    Look look(const Vec3d& p, std::uint64_t key)
    {
        ProbeEstimator::Workspace& workspace = mWorkspaces.local();
        Look look;
        // Both see the same rays, so that their difference is the expansion alone.
        const ProbeResult r
            = mEstimator.radianceShAndIrradiance(p, kMaxBands, mNormals, key, workspace);
        look.rays = r.rays;
        look.free = r.validity >= kValidThreshold;
        if (!look.free) return look;
        for (int bands = 1; bands <= kMaxBands; ++bands) {
            for (const Vec3f& n : mNormals) {
                look.expanded.push_back(irradiance(bands, r.value.data(), n));
            }
        }
        look.direct.assign(r.value.begin() + kMaxCoefficients, r.value.end());
        look.error.assign(r.stderr_.begin() + kMaxCoefficients, r.stderr_.end());
        return look;
    }

private:
    ProbeEstimator mEstimator;
    std::vector<Vec3f> mNormals;
    tbb::enumerable_thread_specific<ProbeEstimator::Workspace> mWorkspaces;
};

Pilot summarise(const std::vector<Look>& looks, int rays)
{
    Pilot pilot;
    std::array<Vec3d, kMaxBands + 1> missing;
    missing.fill(Vec3d(0.0)); // a Vec3d is not zero by itself
    Vec3d noise(0.0), deviations(0.0);
    for (const Look& look : looks) {
        pilot.rays += look.rays;
        if (!look.free) continue;
        ++pilot.points;
        Vec3d own(0.0);
        for (std::size_t n = 0; n < look.direct.size(); ++n) {
            pilot.meanE += Vec3d(look.direct[n]);
            const Vec3d e(look.error[n]);
            own += e * e;
            for (std::size_t b = 1; b <= kMaxBands; ++b) {
                const Vec3d d(look.expanded[(b - 1) * look.direct.size() + n] - look.direct[n]);
                missing[b] += d * d;
            }
        }
        noise += own;
        for (int c = 0; c < 3; ++c) deviations[c] += std::sqrt(own[c] * kNormals);
    }
    const double count = std::max<double>(1.0, static_cast<double>(pilot.points) * kNormals);
    pilot.meanE /= count;
    for (int c = 0; c < 3; ++c) {
        if (!(pilot.meanE[c] > 0)) continue;
        const auto relative
            = [&](const Vec3d& sum) { return std::sqrt(sum[c] / count) / pilot.meanE[c]; };
        for (std::size_t b = 1; b <= kMaxBands; ++b) {
            pilot.truncation[b] = std::max(pilot.truncation[b], relative(missing[b]));
        }
        pilot.noisePerRay = std::max(pilot.noisePerRay, relative(noise) * std::sqrt(rays));
        pilot.meanNoisePerRay = std::max(
            pilot.meanNoisePerRay, deviations[c] / count / pilot.meanE[c] * std::sqrt(rays));
    }
    return pilot;
}

} // namespace

Pilot lookAhead(const Tracer& tracer, const ProbeOptions& probe, const Box3d& box,
    std::size_t count, Progress& progress)
{
    progress.begin("look at the light", count);
    Looker looker(tracer, probe);
    std::vector<Look> looks(count);
    std::atomic<bool> stop{false};
    double seconds = 0;
    {
        Seconds time(seconds);
        tbb::parallel_for(std::size_t{0}, count, [&](std::size_t i) {
            if (stop || progress.cancelled()) {
                stop = true;
                return;
            }
            const std::uint64_t key = hashCombine(mixBits(probe.seed ^ kPilotStream), i);
            CounterRng rng(key);
            Vec3d p;
            for (int a = 0; a < 3; ++a) {
                p[a] = box.min[a] + rng.nextDouble() * (box.max[a] - box.min[a]);
            }
            looks[i] = looker.look(p, key);
            progress.advance(1);
        });
    }
    if (stop) throw Error(ErrorCode::Interrupted, "The bake was interrupted; nothing was written.");
    Pilot pilot = summarise(looks, probe.rays);
    pilot.secondsPerDirection = seconds / (static_cast<double>(count) * probe.rays);
    return pilot;
}

} // namespace lumivdb
