// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/lpv_bake.h>

#include "bake_plan.h"
#include "sample_baker.h"
#include "threads.h"

#include <lumivdb/bake/blockers.h>
#include <lumivdb/bake/rsm.h>
#include <lumivdb/bake/visibility.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>

namespace lumivdb {

namespace {

constexpr int kBands = 2;

[[noreturn]] void refuse(const std::string& sentence) { throw Error(ErrorCode::Usage, sentence); }

/// Seconds since the last call.
class Lap {
public:
    double operator()()
    {
        const auto now = std::chrono::steady_clock::now();
        const double seconds = std::chrono::duration<double>(now - mStart).count();
        mStart = now;
        return seconds;
    }

private:
    std::chrono::steady_clock::time_point mStart = std::chrono::steady_clock::now();
};

class LpvBake {
public:
    LpvBake(const Tracer& tracer, const LpvBakeOptions& options, Progress& progress)
        : mTracer(tracer)
        , mOptions(options)
        , mProgress(progress)
    {
    }

    LpvBakeResult run()
    {
        if (mOptions.cascades.cascades == 1) return runBox();
        return runCascades();
    }

private:
    LpvBakeResult runBox()
    {
        const Box3d scene = mTracer.scene().bounds();
        double& h = mOptions.lpv.spacing;
        if (h == 0) {
            h = defaultSpacing(scene);
            decide("spacing " + shortText(h)
                + ": a twentieth of the scene's longest side, rounded down to 1, 2 or 5 times a "
                  "power of ten");
        }
        Box3d box = mOptions.bounds.value_or(scene);
        if (box.isEmpty()) {
            box = Box3d(Vec3d(-1.0), Vec3d(1.0));
            decide("bounds -1 to 1: the scene has no geometry");
        } else if (!mOptions.bounds) {
            box.min -= Vec3d(h);
            box.max += Vec3d(h);
        }
        checkSize(box, h);
        const LatticeBox cells = LightPropagationVolume::cellsOf(box, h);
        LightPropagationVolume lpv(mOptions.lpv, cells);
        return fill(lpv, {worldOf(cells, h)});
    }

    LpvBakeResult runCascades()
    {
        const Box3d scene = mTracer.scene().bounds();
        const Vec3d center
            = mOptions.center.value_or(scene.isEmpty() ? Vec3d(0.0) : scene.center());
        if (mOptions.lpv.spacing == 0) chooseCascadeSpacing(scene, center);
        LightPropagationCascades lpv(mOptions.lpv, mOptions.cascades, center);
        std::vector<Box3d> boxes;
        for (std::size_t i = 0; i < lpv.size(); ++i) {
            boxes.push_back(worldOf(*lpv[i].cells(), lpv[i].options().spacing));
        }
        return fill(lpv, boxes);
    }

    /// The coarsest cascade reaches over the scene.
    void chooseCascadeSpacing(const Box3d& scene, const Vec3d& center)
    {
        double reach = 0;
        for (int a = 0; a < 3 && !scene.isEmpty(); ++a) {
            reach = std::max({reach, scene.max[a] - center[a], center[a] - scene.min[a]});
        }
        if (!(reach > 0)) reach = 1;
        const double coarsest = std::pow(2.0, mOptions.cascades.cascades - 1);
        // Cascades move by whole blocks of eight, so half of that and a cell are kept free.
        const double cells = std::max(0.5 * mOptions.cascades.cells - 5, 1.0);
        mOptions.lpv.spacing = std::max(kMinSpacing, reach / (cells * coarsest));
        decide("spacing " + shortText(mOptions.lpv.spacing)
            + ": the coarsest of the cascades then reaches over the scene");
    }

    static void checkSize(const Box3d& box, double h)
    {
        const Vec3d size = box.size() / h;
        for (int a = 0; a < 3; ++a) {
            const double far = std::max(std::abs(box.min[a]), std::abs(box.max[a])) / h;
            if (!(far < 1e9)) {
                refuse("The bounds lie " + shortText(far)
                    + " samples from the origin, beyond the lattice's 1e9; take a larger spacing.");
            }
        }
        const double samples = (size.x + 2) * (size.y + 2) * (size.z + 2);
        if (samples > 2147483647.0) {
            refuse("spacing " + shortText(h) + " over these bounds needs " + shortText(samples)
                + " samples, more than 2^31; take a larger spacing, smaller bounds or cascades.");
        }
    }

    /// What cells of width @a h cover.
    static Box3d worldOf(const LatticeBox& cells, double h)
    {
        return Box3d(Vec3d(cells.lower.x - 0.5, cells.lower.y - 0.5, cells.lower.z - 0.5) * h,
            Vec3d(cells.upper.x - 0.5, cells.upper.y - 0.5, cells.upper.z - 0.5) * h);
    }

    /// @a boxes: of the cascades, from the finest.
    template <class Volume> LpvBakeResult fill(Volume& lpv, const std::vector<Box3d>& boxes)
    {
        Lap lap;
        const std::vector<Surfel> surfels = litSurfels(boxes.back());
        mReport.secondsRsm = lap();
        if (mOptions.lpv.occlusion == LpvOcclusion::On) lpv.setGeometry(blockers(boxes));
        const std::size_t inside = lpv.inject(surfels);
        mReport.surfels = surfels.size();
        mReport.surfelsOutside = surfels.size() - inside;
        if (surfels.empty()) {
            mReport.warnings.push_back(
                "No light falls on a surface that reflects it; the indirect light is black.");
        }
        mReport.secondsInject = lap();
        mReport.propagation = lpv.propagate(mOptions.stop, &mProgress);
        IrradianceVolume volume = lpv.makeVolume();
        mReport.secondsPropagate = lap();
        if (mOptions.rays > 0) lookRound(volume);
        mReport.secondsSamples = lap();
        finish(volume);
        return {std::move(volume), std::move(mReport)};
    }

    std::vector<Surfel> litSurfels(const Box3d& region)
    {
        RsmOptions rsm;
        rsm.resolution = mOptions.rsmResolution;
        rsm.seed = mOptions.seed;
        rsm.region = region;
        std::vector<Surfel> all = reflectedLight(mTracer, rsm, &mProgress, &mReport.rays);
        // What reflects nothing is of no use here: triangles say what is in the way.
        all.erase(std::remove_if(all.begin(), all.end(),
                      [](const Surfel& s) { return !(luminance(s.flux) > 0); }),
            all.end());
        if (mOptions.maxSurfels == 0) return all;
        return importantSurfels(all, mOptions.maxSurfels, mOptions.seed);
    }

    /// As dense as the finest cascade asks for in its box, and coarser around it.
    std::vector<Blocker> blockers(const std::vector<Box3d>& boxes)
    {
        std::vector<Blocker> all;
        BlockerOptions o;
        o.perFace = mOptions.blockersPerFace;
        o.spacing = mOptions.lpv.spacing;
        for (std::size_t i = 0; i < boxes.size(); ++i, o.spacing *= 2) {
            o.region = boxes[i];
            o.seed = hashCombine(mixBits(mOptions.seed), i);
            for (const Blocker& b : surfaceBlockers(mTracer, o, &mProgress)) {
                if (i == 0 || !boxes[i - 1].intersects(b.position)) all.push_back(b);
            }
        }
        mReport.blockers = all.size();
        return all;
    }

    /// Validity, distance, places moved off surfaces, and direct light.
    void lookRound(IrradianceVolume& volume)
    {
        SampleSettings s;
        s.bands = kBands;
        s.spacing = volume.spacing();
        s.probe.rays = mOptions.rays;
        s.probe.maxBounces = 0;
        s.probe.contribution = Contribution::Direct;
        s.probe.seed = mOptions.seed;
        const bool direct = mOptions.contribution == Contribution::All;
        const SampleBaker baker(mTracer, s);
        std::atomic<std::uint64_t> rays{0};
        std::vector<Vec3f> offsets = bakeSamples(
            baker, volume,
            [&](SampleId id, const BakedSample& sample) {
                rays += sample.rays;
                volume.validity(id) = sample.result.validity;
                volume.distance(id) = sample.result.distance;
                Color* L = volume.radiance(id);
                for (std::size_t i = 0; direct && i < sample.result.value.size(); ++i) {
                    L[i] += sample.result.value[i];
                }
            },
            mProgress);
        mReport.rays += rays;
        if (!offsets.empty()) volume.setOffsets(std::move(offsets));
        if (mOptions.visibility) {
            mReport.cutCells
                = computeVisibility(volume, mTracer, mOptions.lpv.threads, &mProgress).cutCells;
        }
    }

    void finish(IrradianceVolume& volume)
    {
        VolumeMetadata& m = volume.metadata();
        m.contribution = name(mOptions.contribution);
        m.lightGroup = mOptions.lightGroup;
        m.seed = mOptions.seed;
        m.raysPerSample = static_cast<std::uint64_t>(mOptions.rays);
        m.options = mOptions.commandLine;
        m.sceneHash = mTracer.scene().contentHash;
        mReport.samples = volume.sampleCount();
        for (const std::size_t n : volume.cellsByLevel()) mReport.cellsByLevel.push_back(n);
        mReport.spacing = volume.spacing();
    }

    void decide(const std::string& sentence) { mReport.decisions.push_back(sentence); }

    const Tracer& mTracer;
    LpvBakeOptions mOptions;
    Progress& mProgress;
    LpvBakeReport mReport;
};

} // namespace

LpvOptions LpvBakeOptions::unspaced()
{
    LpvOptions o;
    o.spacing = 0;
    return o;
}

void LpvBakeOptions::validate() const
{
    LpvOptions spaced = lpv;
    if (spaced.spacing == 0) spaced.spacing = 1;
    spaced.validate();
    cascades.validate();
    RsmOptions rsm;
    rsm.resolution = rsmResolution;
    rsm.validate();
    BlockerOptions blockers;
    blockers.perFace = blockersPerFace;
    blockers.validate();
    if (stop.iterations < 0 || !(stop.tolerance >= 0 && stop.tolerance < 1)) {
        refuse("iterations " + std::to_string(stop.iterations) + " with tolerance "
            + shortText(stop.tolerance) + ": take 0 iterations or more and a share below 1.");
    }
    if (rays < 0 || rays == 1) {
        refuse("rays is " + std::to_string(rays) + "; take 2 or more per sample, or 0 for none.");
    }
    if (contribution == Contribution::Direct) {
        refuse("Direct light does not propagate; bake it with bakeVolume().");
    }
    if (contribution == Contribution::All && rays == 0) {
        refuse("Direct light is traced; give rays, or keep to indirect light.");
    }
    if (bounds && cascades.cascades > 1) {
        refuse("Several cascades are cubes around a place; give a center instead of bounds.");
    }
    if (center && cascades.cascades == 1) {
        refuse("One cascade fills its bounds; a center belongs to several.");
    }
}

LpvBakeResult bakeLpv(const Tracer& tracer, const LpvBakeOptions& options, Progress* progress)
{
    options.validate();
    Progress silent;
    std::optional<LpvBakeResult> result;
    withThreads(options.lpv.threads,
        [&] { result.emplace(LpvBake(tracer, options, progress ? *progress : silent).run()); });
    return std::move(*result);
}

} // namespace lumivdb
