// SPDX-License-Identifier: Apache-2.0
/// lumivdb probe: the light at given points of a scene, traced, without a volume.

#include "common.h"
#include "interrupt.h"
#include "numbers.h"
#include "points.h"
#include "scene_options.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/core/random.h>

#include <nlohmann/json.hpp>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cstring>

namespace lumivdb::cli {

namespace {

class ProbeCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    void declareTracing(Arguments& arguments);
    void validate(const Arguments& arguments) const;
    std::shared_ptr<const RadianceCache> solveCache(
        const Tracer& tracer, const std::vector<Vec3d>& points, Progress& progress);
    std::vector<ProbeResult> probeAll(
        const Tracer& tracer, const std::vector<Vec3d>& points, Progress& progress);
    void print(const std::vector<Vec3d>& points, const std::vector<ProbeResult>& probed) const;

    CommonOptions mCommon;
    SceneOptions mScene;
    ProbeOptions mProbe;
    Integrator mIntegrator = Integrator::Path;
    std::string mPoints;
    int mBands = 3;
    GradientMethod mGradients = GradientMethod::None;
    std::optional<double> mDelta;
    double mStep = 0; // world units, of central differences away from surfaces
};

/// A point is on a surface within half this many of its roundings, and moved off it by so many: a
/// share of the scene's size would carry points of a small room in a wide scene through its walls.
constexpr double kOnSurface = 4;
/// Share of the scene's diagonal that surfaces are looked for in: more than any rounding.
constexpr double kSearch = 1e-5;

std::uint64_t bitsOf(double value)
{
    const double positiveZero = value + 0.0; // −0 is the same place
    std::uint64_t bits;
    std::memcpy(&bits, &positiveZero, sizeof bits);
    return bits;
}

/// A point has the same random numbers wherever it stands in the file.
std::uint64_t keyOf(std::uint64_t seed, const Vec3d& p)
{
    std::uint64_t key = mixBits(seed + 0x9e3779b97f4a7c15ull);
    for (int axis = 0; axis < 3; ++axis) key = hashCombine(key, bitsOf(p[axis]));
    return key;
}

Json jsonOf(const std::vector<Color>& colors)
{
    Json list = Json::array();
    for (const Color& color : colors) list.push_back(cli::jsonOf(color));
    return list;
}

/// Standard error of E averaged over normals, worst channel: that mean is A_0 L_00 Y_00.
double averageStderr(const ProbeResult& light)
{
    constexpr double kY00 = 0.28209479177387814347;
    const Color& c = light.stderr_[0];
    return kCosineLobe[0] * kY00 * std::max({c.x, c.y, c.z});
}

void ProbeCommand::declareTracing(Arguments& arguments)
{
    arguments.section("Tracing");
    arguments.integer("--rays", mProbe.rays, between(2, 67108864), "directions per point");
    arguments.integer("--bands", mBands, between(1, kMaxBands), "SH bands: N*N coefficients");
    arguments.choice<GradientMethod>("--gradients", mGradients,
        {{"none", GradientMethod::None}, {"central", GradientMethod::Central},
            {"analytic", GradientMethod::Analytic}},
        "derivatives of the coefficients, from six more probes with the same directions or from "
        "the same rays; in the JSON only");
    arguments.real("--delta", mDelta, greaterThan(0),
        "distance of the six probes, scene units; less near surfaces, to stay before them",
        "an eighth of the spacing that bake would choose");
    declareLightTransport(arguments, mProbe.contribution, mProbe.maxBounces);
    declareIntegrator(arguments, mIntegrator);
    arguments.seed("--seed", mProbe.seed, "random numbers; same seed and point, same bits");
}

void ProbeCommand::declare(Arguments& arguments)
{
    mScene.declarePositional(arguments);
    arguments.describe("Prints CSV: x,y,z,validity,distance,stderr,sh_0_r,sh_0_g,sh_0_b,sh_1_r,... "
                       "(radiance coefficients). validity: share of rays that met no back face; "
                       "distance: harmonic mean to what they met; stderr: standard error of E "
                       "averaged over normals, worst channel.");
    arguments.text("--points", "FILE|-", mPoints,
        "CSV of x,y,z a line, scene units, column names optional; - is standard input. A point on "
        "a "
        "surface is moved off it by 1e-5 of the scene's diagonal, to its inner side");
    arguments.require();
    mScene.declareLight(arguments);
    mScene.declareLightGroup(arguments, "[default: all light]");
    declareTracing(arguments);
    arguments.section("General");
    mCommon.declareThreads(arguments);
    mCommon.declareJson(arguments,
        "an array of objects: the columns, the standard error of each coefficient, gradients; with "
        "- it replaces the CSV, with FILE it comes besides it");
    mCommon.declareQuiet(arguments);
    arguments.example(
        "echo 0,1,0 | lumivdb probe room.glb --points - --rays 65536", "the light at one point");
    arguments.example("lumivdb probe room.glb --points p.csv --gradients analytic --json -",
        "with gradients and standard errors, as JSON");
}

void ProbeCommand::validate(const Arguments& arguments) const
{
    mScene.validate(arguments);
    validateLightTransport(mProbe.contribution, mProbe.maxBounces);
    mProbe.validate();
    const bool central = mGradients == GradientMethod::Central;
    if (mGradients != GradientMethod::None && mCommon.json.empty()) {
        failUsage(std::string("--gradients ") + (central ? "central" : "analytic")
            + " has no effect without --json; give --json FILE or -.");
    }
    if (mDelta && !central) {
        failUsage("--delta has no effect without --gradients central; give both or none.");
    }
}

/// None where it brings nothing, or, with a warning, where the scene has no place for one.
std::shared_ptr<const RadianceCache> ProbeCommand::solveCache(
    const Tracer& tracer, const std::vector<Vec3d>& points, Progress& progress)
{
    if (mProbe.contribution == Contribution::Direct || mProbe.maxBounces == 0) return nullptr;
    RadianceCacheOptions cache;
    cache.maxBounces = mProbe.maxBounces;
    cache.seed = mProbe.seed;
    cache.patches
        = RadianceCacheOptions::patchesFor(static_cast<double>(points.size()), mProbe.rays);
    for (const Vec3d& p : points) cache.box.extendBy(p);
    try {
        return std::make_shared<const RadianceCache>(tracer, cache, &progress);
    } catch (const Error& e) {
        if (e.code() != ErrorCode::Input) throw;
        mCommon.console.warn(std::string(e.what()) + " It was used.");
        return nullptr;
    }
}

std::vector<ProbeResult> ProbeCommand::probeAll(
    const Tracer& tracer, const std::vector<Vec3d>& points, Progress& progress)
{
    ProbeOptions probe = mProbe;
    if (mIntegrator == Integrator::Cached) probe.cache = solveCache(tracer, points, progress);
    const ProbeEstimator estimator(tracer, probe);
    const Box3d box = tracer.scene().bounds();
    const double search = box.isEmpty() ? 0 : kSearch * box.size().length();
    std::vector<ProbeResult> probed(points.size());
    tbb::enumerable_thread_specific<ProbeEstimator::Workspace> workspaces;
    progress.begin("trace points", points.size());
    const auto body = [&](std::size_t i) {
        throwIfInterrupted();
        const double clearance = kOnSurface * tracer.surfaceRounding(points[i], search);
        const Vec3d p = clearance > 0 ? moveOffSurfaces(tracer, points[i], clearance) : points[i];
        const std::uint64_t key = keyOf(mProbe.seed, points[i]);
        ProbeEstimator::Workspace& workspace = workspaces.local();
        probed[i] = estimator.radianceSh(
            p, mBands, key, workspace, mGradients == GradientMethod::Analytic);
        if (mGradients == GradientMethod::Central) {
            centralGradient(tracer, estimator, p, mBands, 8 * mStep, key, workspace, probed[i]);
        }
        progress.advance(1);
    };
    tbb::parallel_for(std::size_t(0), points.size(), body);
    return probed;
}

void ProbeCommand::print(
    const std::vector<Vec3d>& points, const std::vector<ProbeResult>& probed) const
{
    std::vector<std::string> columns{"x", "y", "z", "validity", "distance", "stderr"};
    appendShColumns(columns, coefficientCount(mBands));
    RowWriter rows(std::move(columns), !mCommon.jsonToStdout(), !mCommon.json.empty());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const Vec3d& p = points[i];
        const ProbeResult& light = probed[i];
        std::vector<double> values{p.x, p.y, p.z, jsonNumber(light.validity),
            jsonNumber(light.distance), averageStderr(light)};
        appendShValues(values, light.value.data(), coefficientCount(mBands));
        std::vector<std::pair<std::string, Json>> more{{"sh_stderr", jsonOf(light.stderr_)}};
        for (int axis = 0; axis < 3 && !light.gradient.empty(); ++axis) {
            const auto first = light.gradient.begin() + axis * coefficientCount(mBands);
            more.emplace_back(std::string("sh_d") + "xyz"[axis],
                jsonOf(std::vector<Color>(first, first + coefficientCount(mBands))));
        }
        rows.add(values, more);
    }
    rows.finish(mCommon.json);
}

void ProbeCommand::run(const Arguments& arguments)
{
    validate(arguments);
    mCommon.apply({mScene.path});
    const PointList points = readPoints(mPoints);
    const auto scene = mScene.load(mCommon.console);
    if (mGradients == GradientMethod::Central) {
        mStep = mDelta ? *mDelta : defaultSpacing(scene->bounds()) / 8;
    }
    ProgressBar progress(mCommon.console.progressStyle());
    TracerOptions options;
    // A cache takes millions of rays, whatever the points: then it is left unknown.
    if (mIntegrator == Integrator::Path) {
        options.expectedRays = static_cast<double>(points.positions.size()) * mProbe.rays;
    }
    const Tracer tracer(scene, &progress, options);
    throwIfInterrupted();
    const std::vector<ProbeResult> probed = probeAll(tracer, points.positions, progress);
    progress.finish();
    print(points.positions, probed);
}

} // namespace

std::unique_ptr<Command> makeProbeCommand() { return std::make_unique<ProbeCommand>(); }

} // namespace lumivdb::cli
