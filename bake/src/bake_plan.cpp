// SPDX-License-Identifier: Apache-2.0
#include "bake_plan.h"

#include "pilot.h"

#include <lumivdb/core/error.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace lumivdb {

namespace {

/// Rounding allowed when bounds are snapped to the lattice, in lattice steps.
constexpr double kSnap = 1e-6;
/// Root cells along the bounds' longest side where levels are chosen here.
constexpr double kRootsAlongSide = 4;
constexpr int kDefaultLevels = 4;
/// Samples that an adaptive bake is thought to trace for each of its coarsest cells.
constexpr double kSamplesPerRoot = 64;
/// With a target, the finest spacing is out of reach in practice: samples are the limit.
constexpr int kTargetLevels = 8;
constexpr std::size_t kPilotPoints = 256;
constexpr int kPilotRays = 256, kTargetPilotRays = 1024;
/// Shares of a target that the pieces may take, as standard deviations; the rest is for
/// interpolation.
constexpr double kTruncationShare = 0.6, kNoiseShare = 1.0 / 3;
/// Least and most directions of a sample where the bake chooses.
constexpr int kFirstRays = 32, kMostRays = 1 << 20;
/// The most that one sample's standard error may be, in shares of the target.
constexpr double kMostNoise = 1;
/// Where finer lattices stand for half as much space each (they follow surfaces) and their samples
/// have directions as the square root of their cells' volume, noise is this many times as much as
/// if all were of the coarsest: Σ 2^(j/2) / Σ 2^−j, j < 6.
constexpr double kLevelsShare = 8.6;
/// What dropped bands may change where bands are chosen without a target.
constexpr double kTruncation = 0.005;

int latticeFloor(double v) { return static_cast<int>(std::floor(v + kSnap)); }
int latticeCeil(double v) { return static_cast<int>(std::ceil(v - kSnap)); }

LatticeBox latticeBox(const Box3d& bounds, double spacing)
{
    LatticeBox box;
    for (int a = 0; a < 3; ++a) {
        const double low = bounds.min[a] / spacing, high = bounds.max[a] / spacing;
        if (!(std::abs(low) < 1e9 && std::abs(high) < 1e9)) {
            throw Error(ErrorCode::Usage,
                "The bounds lie " + shortText(std::max(std::abs(low), std::abs(high)))
                    + " samples from the origin, beyond the lattice's 1e9; take a larger spacing.");
        }
        box.lower[a] = latticeFloor(low);
        box.upper[a] = std::max(latticeCeil(high), box.lower[a] + 1);
    }
    return box;
}

/// Rounded down to 1, 2 or 5 × 10^k, kMinSpacing at least.
double roundedDown(double v)
{
    if (v < kMinSpacing) return kMinSpacing;
    const double decade = std::pow(10.0, std::floor(std::log10(v) + 1e-12));
    const double steps = v / decade * (1 + 1e-12);
    return decade * (steps >= 5 ? 5 : steps >= 2 ? 2 : 1);
}

/// The 1, 2 or 5 × 10^k nearest to it by ratio.
double roundedNice(double v)
{
    const double low = roundedDown(v), high = roundedDown(2.5 * low * (1 + 1e-9));
    return v / low < high / v ? low : high;
}

double longestSide(const Box3d& box)
{
    if (box.isEmpty()) return 0;
    const Vec3d size = box.size();
    return std::max({size.x, size.y, size.z});
}

class Planner {
public:
    Planner(const Tracer& tracer, const BakeOptions& options, BakeReport& report)
        : mTracer(tracer)
        , mOptions(options)
        , mReport(report)
    {
        mAdaptive = options.levels != 0 || options.target.error > 0;
    }

    BakePlan plan(Progress& progress)
    {
        mPlan.samples.probe = mOptions.probe;
        mPlan.samples.bands = mOptions.bands;
        mPlan.samples.gradients = mOptions.gradients;
        chooseLattice();
        if (mAdaptive || mOptions.bands == 0) look(progress);
        return mPlan;
    }

    Box3d box()
    {
        chooseLattice();
        return worldBox();
    }

    double samples()
    {
        chooseLattice();
        const Coord size = mPlan.box.upper - mPlan.box.lower;
        const double uniform = (size.x + 1.0) * (size.y + 1.0) * (size.z + 1.0);
        if (!mAdaptive) return uniform;
        const double root = std::pow(2.0, mPlan.levels);
        double roots = 1;
        for (int a = 0; a < 3; ++a) roots *= std::ceil(size[a] / root);
        return std::min(
            {uniform, kSamplesPerRoot * roots, static_cast<double>(mOptions.target.maxSamples)});
    }

private:
    Box3d worldBox() const
    {
        const auto world
            = [&](const Coord& c) { return Vec3d(c.x, c.y, c.z) * mPlan.samples.spacing; };
        return {world(mPlan.box.lower), world(mPlan.box.upper)};
    }

    bool hasTarget() const { return mOptions.target.error > 0; }
    void decide(const std::string& sentence) { mReport.decisions.push_back(sentence); }

    void chooseLattice()
    {
        const Box3d sceneBounds = mTracer.scene().bounds();
        Box3d bounds = mOptions.bounds.value_or(sceneBounds);
        const double side = longestSide(bounds);
        double h = mOptions.spacing;
        mPlan.levels = mAdaptive ? mOptions.levels : 0;
        const bool chooseLevels = mAdaptive && mOptions.levels <= 0;
        if (chooseLevels) {
            mPlan.levels = hasTarget() ? kTargetLevels : kDefaultLevels;
            if (h > 0) {
                const double roots = side > 0 ? side / (kRootsAlongSide * h) : 1;
                mPlan.levels
                    = std::clamp(static_cast<int>(std::floor(std::log2(std::max(1.0, roots)))), 1,
                        kTargetLevels);
            }
        }
        if (h == 0) {
            h = mAdaptive && side > 0 ? std::max(
                    kMinSpacing, roundedNice(side / kRootsAlongSide) / std::pow(2.0, mPlan.levels))
                                      : defaultSpacing(sceneBounds);
            decide("spacing " + shortText(h)
                + (mAdaptive
                        ? ": cells of the coarsest level are about a quarter of the longest side"
                        : ": a twentieth of the scene's longest side, rounded down to 1, 2 or "
                          "5 times a power of ten"));
        }
        if (chooseLevels) {
            decide("levels " + std::to_string(mPlan.levels) + ": cells from " + shortText(h)
                + " to " + shortText(h * std::pow(2.0, mPlan.levels)));
        }
        mPlan.samples.spacing = h;
        growBounds(bounds, h);
    }

    void growBounds(Box3d bounds, double h)
    {
        if (!mOptions.bounds && bounds.isEmpty()) {
            bounds = Box3d(Vec3d(-1.0), Vec3d(1.0));
            decide("bounds -1 to 1: the scene has no geometry");
        } else if (!mOptions.bounds) {
            bounds.min -= Vec3d(h);
            bounds.max += Vec3d(h);
        }
        mPlan.box = latticeBox(bounds, h);
        const Coord size = mPlan.box.upper - mPlan.box.lower;
        const double samples = (size.x + 1.0) * (size.y + 1.0) * (size.z + 1.0);
        if (!mAdaptive && samples > 2147483647.0) {
            throw Error(ErrorCode::Usage,
                "spacing " + shortText(h) + " over these bounds needs " + shortText(samples)
                    + " samples, more than 2^31; take a larger spacing or smaller bounds.");
        }
    }

    void look(Progress& progress)
    {
        ProbeOptions probe = mOptions.probe;
        probe.rays = hasTarget() ? kTargetPilotRays : kPilotRays;
        const Pilot pilot = lookAhead(mTracer, probe, worldBox(), kPilotPoints, progress);
        mPlan.meanE = pilot.meanE;
        mPlan.noisePerRay = pilot.noisePerRay;
        mPlan.secondsPerDirection = pilot.secondsPerDirection;
        mReport.rays += pilot.rays;
        if (mOptions.bands == 0) chooseBands(pilot);
        mPlan.truncation = pilot.truncation[static_cast<std::size_t>(mPlan.samples.bands)];
        mPlan.goal = std::max(mOptions.target.error, mPlan.truncation);
        if (hasTarget() && mOptions.target.chooseRays) chooseRays(pilot);
        if (hasTarget() && mOptions.target.chooseGradients) {
            mPlan.samples.gradients = GradientMethod::Analytic;
        }
    }

    void chooseBands(const Pilot& pilot)
    {
        const double limit = hasTarget() ? kTruncationShare * mOptions.target.error : kTruncation;
        int bands = 1, best = 1;
        for (int b = 1; b <= kMaxBands; ++b) {
            const auto i = static_cast<std::size_t>(b);
            if (pilot.truncation[i] < pilot.truncation[static_cast<std::size_t>(best)]) best = b;
        }
        while (bands < best && pilot.truncation[static_cast<std::size_t>(bands)] > limit) ++bands;
        mPlan.samples.bands = bands;
        std::string why = "bands " + std::to_string(bands) + ": what they leave out is "
            + percentText(pilot.truncation[static_cast<std::size_t>(bands)])
            + " of the mean irradiance";
        if (bands > 1) {
            why += "; " + std::to_string(bands - 1) + " would leave out "
                + percentText(pilot.truncation[static_cast<std::size_t>(bands) - 1]);
        }
        if (bands < kMaxBands) {
            why += "; " + std::to_string(kMaxBands) + " would leave out "
                + percentText(pilot.truncation[kMaxBands]);
        }
        decide(why);
    }

    /// As many as each sample's own noise asks for, and the space it stands for.
    void chooseRays(const Pilot& pilot)
    {
        const double noise = kNoiseShare * mPlan.goal;
        // A quarter of what all would need if they were alike: larger sets fill packets of rays.
        const double alike = std::pow(pilot.noisePerRay / noise, 2);
        int first = kFirstRays;
        while (2 * first <= alike / 4 && first < kMostRays) first *= 2;
        mPlan.samples.probe.rays = first;
        mPlan.samples.levels = mPlan.levels;
        StopRule& stop = mPlan.samples.stop;
        stop.meanE = pilot.meanE;
        stop.perDeviation = kLevelsShare * pilot.meanNoisePerRay / (noise * noise);
        stop.tolerance = kMostNoise * mPlan.goal;
        stop.most = kMostRays;
        decide("rays " + std::to_string(first)
            + " per sample at least, doubled where its own standard error is above "
            + percentText(stop.tolerance)
            + " of the mean irradiance, or above less where it stands for much space"
            + (mPlan.goal > mOptions.target.error
                    ? "; with what the bands leave out the target is out of reach, so no more"
                    : ""));
    }

    const Tracer& mTracer;
    const BakeOptions& mOptions;
    BakeReport& mReport;
    BakePlan mPlan;
    bool mAdaptive;
};

} // namespace

std::string shortText(double v)
{
    char text[32];
    std::snprintf(text, sizeof text, "%.6g", v);
    return text;
}

std::string percentText(double v)
{
    char text[32];
    std::snprintf(text, sizeof text, "%.3g%%", 100 * v);
    return text;
}

double defaultSpacing(const Box3d& sceneBounds)
{
    const double side = longestSide(sceneBounds);
    return side > 0 ? roundedDown(side / 20) : 0.1;
}

BakePlan planBake(
    const Tracer& tracer, const BakeOptions& options, BakeReport& report, Progress& progress)
{
    return Planner(tracer, options, report).plan(progress);
}

Box3d bakeBox(const Tracer& tracer, const BakeOptions& options)
{
    BakeReport unread;
    return Planner(tracer, options, unread).box();
}

double foreseenSamples(const Tracer& tracer, const BakeOptions& options)
{
    BakeReport unread;
    return Planner(tracer, options, unread).samples();
}

} // namespace lumivdb
