// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/bake.h>

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include "directions.h"
#include "threads.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>

namespace lumivdb {

namespace {

/// A sample closer to a surface than half this share of the spacing is moved off it, by this share.
constexpr double kOnSurface = 1e-3;
/// Rounding allowed when bounds are snapped to the lattice, in lattice steps.
constexpr double kSnap = 1e-6;

std::string format(double v)
{
    char text[32];
    std::snprintf(text, sizeof text, "%.6g", v);
    return text;
}

int latticeFloor(double v) { return static_cast<int>(std::floor(v + kSnap)); }
int latticeCeil(double v) { return static_cast<int>(std::ceil(v - kSnap)); }

struct LatticeBox {
    Coord lower, upper; // cells with lower ≤ origin < upper
};

LatticeBox latticeBox(const Box3d& bounds, double spacing)
{
    LatticeBox box;
    for (int a = 0; a < 3; ++a) {
        const double low = bounds.min[a] / spacing, high = bounds.max[a] / spacing;
        if (!(std::abs(low) < 1e9 && std::abs(high) < 1e9)) {
            throw Error(ErrorCode::Usage,
                "The bounds lie " + format(std::max(std::abs(low), std::abs(high)))
                    + " samples from the origin, beyond the lattice's 1e9; take a larger spacing.");
        }
        box.lower[a] = latticeFloor(low);
        box.upper[a] = std::max(latticeCeil(high), box.lower[a] + 1);
    }
    return box;
}

/// How a place looks around: shares of 64 rays that meet back faces and that escape.
struct Surroundings {
    double backFaces = 0, escapes = 0;
};

Surroundings lookAround(const Tracer& tracer, const Vec3d& p)
{
    constexpr int kRays = 64;
    static const std::vector<Vec3f> directions = stratifiedDirections(0, kRays);
    Surroundings s;
    for (const Vec3f& d : directions) {
        const SurfaceHit hit = tracer.intersect(p, Vec3d(d));
        if (!hit.hit) s.escapes += 1.0 / kRays;
        const bool doubleSided = hit.hit
            && tracer.scene()
                   .materials[static_cast<std::size_t>(
                       tracer.scene().meshes[static_cast<std::size_t>(hit.mesh)].material)]
                   .doubleSided;
        if (hit.backFace && !doubleSided) s.backFaces += 1.0 / kRays;
    }
    return s;
}

/// The places off all surfaces that moves along the normals of those nearby lead to, fronts first.
void collectPlaces(
    const Tracer& tracer, const Vec3d& p, double clearance, int moves, std::vector<Vec3d>& places)
{
    double distance = 0;
    Vec3d normal;
    if (!tracer.closestSurface(p, 0.5 * clearance, &distance, &normal)) {
        places.push_back(p);
    } else if (moves > 0) {
        collectPlaces(tracer, p + normal * clearance, clearance, moves - 1, places);
        collectPlaces(tracer, p - normal * clearance, clearance, moves - 1, places);
    }
}

/// The best of the places offered: the one that sees fewest back faces, then the one from which
/// fewest rays escape (inside rather than outside), then the first.
class BestPlace {
public:
    explicit BestPlace(const Tracer& tracer)
        : mTracer(tracer)
    {
    }
    void offer(const Vec3d& p)
    {
        const Surroundings s = lookAround(mTracer, p);
        const bool better = s.backFaces != mSeen.backFaces ? s.backFaces < mSeen.backFaces
                                                           : s.escapes < mSeen.escapes;
        if (!better) return;
        mPlace = p;
        mSeen = s;
    }
    const Vec3d& place() const { return mPlace; }
    /// Whether it looks like the wrong side: a place inside sees none or a few odd ones.
    bool isDoubtful() const { return mSeen.backFaces > 0.03; }

private:
    const Tracer& mTracer;
    Vec3d mPlace{0, 0, 0};
    Surroundings mSeen{2, 2}; // worse than any
};

class Baker {
public:
    Baker(const Tracer& tracer, const BakeOptions& options, IrradianceVolume& volume)
        : mTracer(tracer)
        , mOptions(options)
        , mVolume(volume)
        , mEstimator(tracer, options.probe)
    {
    }

    void run(Progress& progress)
    {
        progress.begin("trace samples", mVolume.sampleCount());
        tbb::enumerable_thread_specific<ProbeEstimator::Workspace> workspaces;
        std::vector<Noise> noise(mVolume.sampleCount());
        std::atomic<bool> stop{false};
        tbb::parallel_for(
            tbb::blocked_range<SampleId>(0, static_cast<SampleId>(mVolume.sampleCount()), 1),
            [&](const tbb::blocked_range<SampleId>& range) {
                for (SampleId s = range.begin(); s != range.end(); ++s) {
                    if (stop || progress.cancelled()) {
                        stop = true;
                        return;
                    }
                    noise[s] = bakeSample(s, workspaces.local());
                    progress.advance(1);
                }
            });
        if (stop)
            throw Error(ErrorCode::Interrupted, "The bake was interrupted; nothing was written.");
        summarise(noise);
    }

    std::uint64_t rays = 0;
    double meanRelativeStderr = 0;

private:
    struct Noise {
        std::uint64_t rays;
        float mean, error; // of E averaged over normals, luminance
    };

    Noise bakeSample(SampleId s, ProbeEstimator::Workspace& workspace)
    {
        const Coord& c = mVolume.samplePosition(s);
        const std::uint64_t key = hashPoint(mOptions.probe.seed, c.x, c.y, c.z);
        const Vec3d p
            = moveOffSurfaces(mTracer, mVolume.sampleWorld(s), kOnSurface * mVolume.spacing());
        const ProbeResult r = mEstimator.radianceSh(p, mOptions.bands, key, workspace);
        std::copy(r.value.begin(), r.value.end(), mVolume.radiance(s));
        mVolume.validity(s) = r.validity;
        mVolume.distance(s) = r.distance;
        Noise noise{r.rays, luminance(r.value[0]), luminance(r.stderr_[0])};
        if (mVolume.hasGradients())
            noise.rays += differentiate(s, p, r.minDistance, key, workspace);
        return noise;
    }

    std::uint64_t differentiate(SampleId s, const Vec3d& p, double clearance, std::uint64_t key,
        ProbeEstimator::Workspace& workspace)
    {
        const double h = mVolume.spacing();
        double delta = h / 8, nearest = 0;
        if (mTracer.closestSurface(p, std::min(clearance, 2 * delta), &nearest, nullptr)) {
            delta = std::min(delta, std::max(0.5 * nearest, 1e-4 * h));
        }
        std::uint64_t traced = 0;
        const int n = mVolume.coefficients();
        for (int a = 0; a < 3; ++a) {
            Vec3d step(0.0);
            step[a] = delta;
            const ProbeResult plus
                = mEstimator.radianceSh(p + step, mOptions.bands, key, workspace);
            const ProbeResult minus
                = mEstimator.radianceSh(p - step, mOptions.bands, key, workspace);
            for (int i = 0; i < n; ++i) {
                const auto k = static_cast<std::size_t>(i);
                mVolume.gradient(s)[a * n + i]
                    = (plus.value[k] - minus.value[k]) * static_cast<float>(0.5 / delta);
            }
            traced += plus.rays + minus.rays;
        }
        return traced;
    }

    void summarise(const std::vector<Noise>& noise)
    {
        double mean = 0, error = 0;
        for (const Noise& n : noise) {
            rays += n.rays;
            mean += n.mean;
            error += n.error;
        }
        meanRelativeStderr = mean > 0 ? error / mean : 0;
    }

    const Tracer& mTracer;
    const BakeOptions& mOptions;
    IrradianceVolume& mVolume;
    ProbeEstimator mEstimator;
};

} // namespace

// Places are compared once they are off *all* surfaces: rays that begin on one see either of its
// sides, by rounding.
Vec3d moveOffSurfaces(const Tracer& tracer, const Vec3d& point, double clearance)
{
    constexpr int kMoves = 4; // the three surfaces of a corner, and one more
    std::vector<Vec3d> places;
    collectPlaces(tracer, point, clearance, kMoves, places);
    if (places.size() == 1) return places[0];
    BestPlace best(tracer);
    for (const Vec3d& p : places) best.offer(p);
    if (!places.empty() && !best.isDoubtful()) return best.place();

    // In an acute edge no move along one normal stays inside: look further, all around.
    constexpr int kDirections = 256;
    static const std::vector<Vec3f> directions = stratifiedDirections(0, kDirections);
    if (places.empty()) best.offer(point);
    for (const Vec3f& d : directions) {
        const Vec3d p = point + Vec3d(d) * (4 * clearance);
        if (!tracer.closestSurface(p, 0.25 * clearance, nullptr, nullptr)) best.offer(p);
    }
    return best.place();
}

void BakeOptions::validate() const
{
    probe.validate();
    if (bands < 1 || bands > kMaxBands) {
        throw Error(ErrorCode::Usage,
            "bands is " + std::to_string(bands) + "; take 1 to " + std::to_string(kMaxBands) + ".");
    }
    if (!std::isfinite(spacing) || spacing < 0) {
        throw Error(ErrorCode::Usage,
            "spacing is " + format(spacing) + "; take a positive length in scene units.");
    }
    if (!bounds) return;
    for (int a = 0; a < 3; ++a) {
        if (!(bounds->min[a] < bounds->max[a]) || !std::isfinite(bounds->min[a])
            || !std::isfinite(bounds->max[a])) {
            throw Error(ErrorCode::Usage,
                std::string("bounds are empty along ") + "xyz"[a] + " (" + format(bounds->min[a])
                    + " to " + format(bounds->max[a]) + "); give x0,y0,z0,x1,y1,z1 with x0 < x1.");
        }
    }
}

double defaultSpacing(const Box3d& sceneBounds)
{
    if (sceneBounds.isEmpty()) return 0.1;
    const Vec3d size = sceneBounds.size();
    const double target = std::max({size.x, size.y, size.z}) / 20;
    if (!(target > 0)) return 0.1;
    if (target < kMinSpacing) return kMinSpacing;
    const double decade = std::pow(10.0, std::floor(std::log10(target) + 1e-12));
    const double steps = target / decade * (1 + 1e-12);
    return decade * (steps >= 5 ? 5 : steps >= 2 ? 2 : 1);
}

BakeResult bakeVolume(const Tracer& tracer, const BakeOptions& options, Progress* progress)
{
    options.validate();
    Progress silent;
    BakeReport report;
    const Box3d sceneBounds = tracer.scene().bounds();
    double h = options.spacing;
    if (h == 0) {
        h = defaultSpacing(sceneBounds);
        report.decisions.push_back("spacing " + format(h)
            + ": a twentieth of the scene's longest side, rounded down to 1, 2 or 5 times a power "
              "of ten");
    }
    Box3d bounds = options.bounds.value_or(sceneBounds);
    if (!options.bounds) {
        if (bounds.isEmpty()) {
            bounds = Box3d(Vec3d(-1.0), Vec3d(1.0));
            report.decisions.push_back("bounds -1 to 1: the scene has no geometry");
        } else {
            bounds.min -= Vec3d(h);
            bounds.max += Vec3d(h);
        }
    }
    const LatticeBox box = latticeBox(bounds, h);
    const Coord size = box.upper - box.lower;
    const double samples = (size.x + 1.0) * (size.y + 1.0) * (size.z + 1.0);
    if (samples > 2147483647.0) {
        throw Error(ErrorCode::Usage,
            "spacing " + format(h) + " over these bounds needs " + format(samples)
                + " samples, more than 2^31; take a larger spacing or smaller bounds.");
    }

    VolumeBuilder builder(options.bands,
        options.gradients == GradientMethod::None ? GradientStorage::None
                                                  : GradientStorage::PerCoefficient,
        latticeTransform(h));
    builder.addUniform(box.lower, box.upper);
    IrradianceVolume volume = builder.build();
    VolumeMetadata& m = volume.metadata();
    m.contribution = name(options.probe.contribution);
    m.lightGroup = options.lightGroup;
    m.seed = options.probe.seed;
    m.raysPerSample = static_cast<std::uint64_t>(options.probe.rays);
    m.options = options.commandLine;
    m.sceneHash = tracer.scene().contentHash;

    const auto start = std::chrono::steady_clock::now();
    Baker baker(tracer, options, volume);
    withThreads(options.threads, [&] { baker.run(progress ? *progress : silent); });
    report.secondsTrace
        = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    report.samples = volume.sampleCount();
    for (std::size_t n : volume.cellsByLevel()) report.cellsByLevel.push_back(n);
    report.rays = baker.rays;
    report.raysPerSecond
        = report.secondsTrace > 0 ? static_cast<double>(baker.rays) / report.secondsTrace : 0;
    report.spacing = h;
    report.meanRelativeStderr = baker.meanRelativeStderr;
    return {std::move(volume), std::move(report)};
}

} // namespace lumivdb
