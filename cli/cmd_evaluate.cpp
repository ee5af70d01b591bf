// SPDX-License-Identifier: Apache-2.0
/// lumivdb evaluate: how wrong a volume is, judged by an independent trace.

#include "common.h"
#include "interrupt.h"
#include "numbers.h"
#include "output.h"
#include "points.h"
#include "scene_options.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <nlohmann/json.hpp>

#include <sstream>

namespace lumivdb::cli {

namespace {

class EvaluateCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    void declareMeasure(Arguments& arguments);
    IrradianceVolume loadYUp();
    void followVolume(const Arguments& arguments, const VolumeMetadata& metadata);
    void checkContribution(const Arguments& arguments, const VolumeMetadata& metadata);
    void print(const EvaluateReport& report) const;
    void judge(const EvaluateReport& report) const;

    CommonOptions mCommon;
    SceneOptions mScene;
    EvaluateOptions mEvaluate;
    std::string mVolume;
    std::string mPointsFile;
    std::optional<Interpolation> mMode;
    std::optional<double> mMaxError;
};

void EvaluateCommand::declareMeasure(Arguments& arguments)
{
    arguments.section("Measure");
    arguments.size("--points", mEvaluate.points, between(1, 1e9),
        "random points of free space in the volume's box");
    arguments.text("--points-file", "FILE|-", mPointsFile,
        "these points instead: CSV of x,y,z a line, in the volume's axes");
    arguments.integer(
        "--rays", mEvaluate.rays, between(2, 67108864), "directions per point of the reference");
    arguments.integer(
        "--normals", mEvaluate.normals, between(1, 100000), "normals per point, spread evenly");
    declareMode(arguments, mMode);
    declareLightTransport(arguments, mEvaluate.contribution, mEvaluate.maxBounces);
    arguments.seed("--seed", mEvaluate.seed, "random numbers of points and reference");
    arguments.real("--max-error", mMaxError, atLeast(0),
        "largest rel_rmse that is good enough, e.g. 0.02; beyond it the exit code is 1",
        "no bound");
}

void EvaluateCommand::declare(Arguments& arguments)
{
    arguments.positional("VOLUME.vdb", mVolume, "the volume");
    arguments.require();
    arguments.describe(
        "rel_rmse is the root of the mean squared error of the irradiance over its mean; p50 to "
        "max are of the absolute error over the same mean; the worst channel each. The reference "
        "has noise itself: reference_stderr, in the same unit; rel_rmse contains it.");
    arguments.describe("--contribution and --max-bounces default to those of the volume.");
    mScene.declareOption(arguments);
    mScene.declareLight(arguments);
    mScene.declareLightGroup(arguments, "[default: the volume's]");
    declareMeasure(arguments);
    arguments.section("General");
    mCommon.declareThreads(arguments);
    mCommon.declareJson(
        arguments, "the measurements; with - they replace the table on standard output");
    mCommon.declareQuiet(arguments);
    arguments.example("lumivdb evaluate room.vdb --scene room.glb", "1000 random points");
    arguments.example(
        "lumivdb evaluate room.vdb --scene room.glb --env sky.hdr --points 200 --rays 16384 "
        "--max-error 0.02",
        "a test for a script: exit code 1 when the error is above 2%");
}

IrradianceVolume EvaluateCommand::loadYUp()
{
    IrradianceVolume volume = loadVolume(mVolume);
    std::optional<IrradianceVolume> turned = broughtYUp(volume);
    if (!turned) return volume;
    mCommon.console.note("'" + mVolume + "' is " + volume.metadata().upAxis
        + "-up: turned back to the scene's Y-up for the comparison.");
    if (!mPointsFile.empty()) {
        failUsage("--points-file: '" + mVolume + "' is " + volume.metadata().upAxis
            + "-up; make a Y-up copy with 'lumivdb resample --up y' for given points.");
    }
    return std::move(*turned);
}

void EvaluateCommand::checkContribution(const Arguments& arguments, const VolumeMetadata& metadata)
{
    if (arguments.given("--contribution")) {
        if (metadata.contribution == name(mEvaluate.contribution)) return;
        failUsage(std::string("--contribution ") + name(mEvaluate.contribution) + ": '" + mVolume
            + "' holds '" + metadata.contribution + "'; leave the option out.");
    }
    for (const auto c : {Contribution::All, Contribution::Direct, Contribution::Indirect}) {
        if (metadata.contribution == name(c)) mEvaluate.contribution = c;
    }
}

/// What the bake was told and the user did not repeat here.
void EvaluateCommand::followVolume(const Arguments& arguments, const VolumeMetadata& metadata)
{
    checkContribution(arguments, metadata);
    if (mScene.lightGroup.empty()) mScene.lightGroup = metadata.lightGroup;
    if (arguments.given("--max-bounces")) return;
    std::istringstream options(metadata.options);
    for (std::string word; options >> word;) {
        if (word != "--max-bounces" || !(options >> word)) continue;
        const auto bounces = parseInteger(word);
        if (!bounces) continue;
        mEvaluate.maxBounces = static_cast<int>(*bounces);
        mCommon.console.note("--max-bounces " + word + " as in the bake of '" + mVolume + "'.");
    }
}

Json reportJson(const EvaluateReport& r, Interpolation mode)
{
    Json json;
    json["rel_rmse"] = r.relRmse;
    json["rel_rmse_debiased"] = r.relRmseDebiased;
    json["upper95"] = r.upper;
    json["p50"] = r.p50;
    json["p95"] = r.p95;
    json["p99"] = r.p99;
    json["max"] = r.max;
    json["bias"] = r.bias;
    json["reference_stderr"] = r.referenceStderr;
    json["points"] = r.points;
    json["normals"] = r.normals;
    json["mode"] = name(mode);
    json["query_ns"] = r.queryNs;
    json["worst"] = Json::array();
    for (const EvaluateReport::Worst& w : r.worst) {
        json["worst"].push_back({{"position", jsonOf(w.position)}, {"error", w.error}});
    }
    json["rejected"] = r.rejected;
    json["outside"] = r.outside;
    return json;
}

void EvaluateCommand::print(const EvaluateReport& r) const
{
    const auto percent = [](double x) { return rounded(100 * x, 4) + "%"; };
    std::string out = table({{"rel_rmse", percent(r.relRmse)},
        {"  without the reference's noise", percent(r.relRmseDebiased)},
        {"  at most, with 95% confidence", percent(r.upper)}, {"p50", percent(r.p50)},
        {"p95", percent(r.p95)}, {"p99", percent(r.p99)}, {"max", percent(r.max)},
        {"bias", percent(r.bias)}, {"reference_stderr", percent(r.referenceStderr)},
        {"points",
            grouped(r.points) + " x " + std::to_string(r.normals) + " normals ("
                + grouped(r.rejected) + " inside geometry, " + grouped(r.outside)
                + " outside the volume: not counted)"},
        {"mode", name(mEvaluate.mode)}, {"query", rounded(r.queryNs, 3) + " ns"}});
    out += "worst places (error over all normals):\n";
    for (const EvaluateReport::Worst& w : r.worst) {
        out += "  " + rounded(w.position.x, 5) + ", " + rounded(w.position.y, 5) + ", "
            + rounded(w.position.z, 5) + "   " + percent(w.error) + "\n";
    }
    writeStdout(out);
}

void EvaluateCommand::judge(const EvaluateReport& report) const
{
    // Not "rel_rmse > bound": a NaN (nothing compared, no light) has not met it either.
    if (!mMaxError || report.relRmse <= *mMaxError) return;
    throw Error(ErrorCode::BoundNotMet,
        "'" + mVolume + "': rel_rmse " + rounded(report.relRmse) + " is not within --max-error "
            + rounded(*mMaxError)
            + "; bake with a smaller --spacing, more --bands or more --rays.");
}

void EvaluateCommand::run(const Arguments& arguments)
{
    mScene.validate(arguments);
    if (!mPointsFile.empty() && arguments.given("--points")) {
        failUsage("--points and --points-file exclude each other; give one.");
    }
    mCommon.apply({mVolume, mScene.path, mPointsFile});
    const IrradianceVolume volume = loadYUp();
    throwIfInterrupted();
    followVolume(arguments, volume.metadata());
    mEvaluate.mode = modeFor(mMode, volume, mVolume);
    mEvaluate.threads = mCommon.threads;
    if (!mPointsFile.empty()) {
        mEvaluate.givenPoints = readPoints(mPointsFile).positions;
        if (mEvaluate.givenPoints.empty()) {
            throw Error(
                ErrorCode::Input, "'" + mPointsFile + "' has no points; give at least one.");
        }
    }
    mEvaluate.validate();
    const auto scene = mScene.load(mCommon.console);
    warnIfSceneDiffers(volume, mVolume, *scene, mCommon.console);

    ProgressBar progress(mCommon.console.progressStyle());
    const std::size_t points
        = mEvaluate.givenPoints.empty() ? mEvaluate.points : mEvaluate.givenPoints.size();
    TracerOptions options;
    options.expectedRays = static_cast<double>(points) * mEvaluate.rays;
    const Tracer tracer(scene, &progress, options);
    throwIfInterrupted();
    const EvaluateReport report = evaluateVolume(volume, tracer, mEvaluate, &progress);
    progress.finish();
    if (!mCommon.jsonToStdout()) print(report);
    mCommon.writeJson(reportJson(report, mEvaluate.mode));
    judge(report);
}

} // namespace

std::unique_ptr<Command> makeEvaluateCommand() { return std::make_unique<EvaluateCommand>(); }

} // namespace lumivdb::cli
