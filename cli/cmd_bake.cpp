// SPDX-License-Identifier: Apache-2.0
/// lumivdb bake: a scene in, an irradiance volume out.

#include "common.h"
#include "interrupt.h"
#include "numbers.h"
#include "output.h"
#include "scene_options.h"
#include "volume_output.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/vdb_io/resample.h>

#include <nlohmann/json.hpp>

namespace lumivdb::cli {

namespace {

struct BakeSeconds {
    double load = 0, build = 0, trace = 0, write = 0;
};

class BakeCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    void declareGrid(Arguments& arguments);
    void declareTracing(Arguments& arguments);
    void declareOther(Arguments& arguments);
    BakeOptions bakeOptions(const Arguments& arguments) const;
    void finishMetadata(BakeResult& result, const Arguments& arguments) const;
    Json report(const BakeResult& result, const Scene& scene, const BakeSeconds& seconds) const;
    void summarise(const BakeResult& result, const BakeSeconds& seconds) const;

    CommonOptions mCommon;
    SceneOptions mScene;
    VolumeOutput mOutput;
    BakeOptions mBake;
    std::optional<double> mSpacing;
    std::string mUpAxis = "y";
};

/// An option of later versions: said clearly instead of being unknown.
void declareUnavailable(Arguments& arguments, const std::string& name, const std::string& valueName,
    const std::string& instead)
{
    const auto convert = [name, instead](const std::string&) {
        failUsage(name + ": this version bakes uniform volumes only; " + instead + ".");
    };
    arguments.repeated(name, valueName, convert, "not in this version: " + instead);
}

void declareBands(Arguments& arguments, int& bands)
{
    const auto convert = [&bands](const std::string& value) {
        if (value == "auto") {
            failValue("--bands", value, "this version does not choose bands; give 1 to 6");
        }
        const auto number = parseInteger(value);
        if (!number || *number < 1 || *number > kMaxBands) {
            failValue("--bands", value, "not an integer from 1 to 6");
        }
        bands = static_cast<int>(*number);
    };
    arguments.custom("--bands", "N", convert,
        "SH bands of the radiance: N*N coefficients a sample; 3 is off by a few percent under "
        "concentrated light, 5 repairs it [1 to 6; default "
            + std::to_string(bands) + "]");
}

void declareGradients(Arguments& arguments, GradientMethod& gradients)
{
    const auto convert = [&gradients](const std::string& value) {
        if (value == "analytic") {
            failValue("--gradients", value, "this version has no analytic gradients; use central");
        }
        if (value != "none" && value != "central") {
            failValue("--gradients", value, "not one of none|central");
        }
        gradients = value == "central" ? GradientMethod::Central : GradientMethod::None;
    };
    arguments.custom("--gradients", "none|central", convert,
        "derivatives of every coefficient; central: six more projections a sample, spacing/8 away "
        "[default none]");
}

void BakeCommand::declareGrid(Arguments& arguments)
{
    arguments.section("Volume");
    arguments.box("--bounds", mBake.bounds,
        "box to fill, scene units; grown to whole cells [default: the scene's box, one cell "
        "larger]");
    arguments.real("--spacing", mSpacing, greaterThan(0), "distance between samples, scene units",
        "from the scene's size, printed");
    declareUniformLevels(arguments);
    declareBands(arguments, mBake.bands);
    declareGradients(arguments, mBake.gradients);
    arguments.choice<std::string>("--up", mUpAxis, {{"y", "y"}, {"z", "z"}},
        "up axis of the file; z turns grid and coefficients for Z-up programs such as Blender");
}

void BakeCommand::declareTracing(Arguments& arguments)
{
    arguments.section("Tracing");
    arguments.integer("--rays", mBake.probe.rays, between(2, 67108864), "directions per sample");
    declareLightTransport(arguments, mBake.probe.contribution, mBake.probe.maxBounces);
    declareIntegrator(arguments);
    arguments.seed("--seed", mBake.probe.seed, "random numbers; same seed, same bits");
    declareUnavailable(arguments, "--target-error", "E",
        "choose --spacing, --bands and --rays, and measure with 'lumivdb evaluate'");
    declareUnavailable(arguments, "--refine", "LIST", "choose a smaller --spacing");
    declareUnavailable(arguments, "--refine-threshold", "NAME=V", "choose a smaller --spacing");
}

void BakeCommand::declareOther(Arguments& arguments)
{
    mOutput.declare(arguments);
    arguments.section("General");
    mCommon.declareThreads(arguments);
    mCommon.declareJson(arguments, "report: samples, rays, seconds, decisions, warnings");
    mCommon.declareQuiet(arguments);
    arguments.example("lumivdb bake room.glb -o room.vdb",
        "everything by default: spacing from the scene, 3 bands, 1024 rays a sample");
    arguments.example("lumivdb bake sponza.glb --env sky.hdr --sun-direction 0.3,1,0.2 --sun-lux 8 "
                      "--spacing 0.5 --rays 4096 -o sponza.vdb --json -",
        "an atrium under a sky and a sun; the report goes to standard output");
}

void BakeCommand::declare(Arguments& arguments)
{
    mScene.declarePositional(arguments);
    mScene.declareLight(arguments);
    mScene.declareLightGroup(arguments, "[default: all light]");
    declareGrid(arguments);
    declareTracing(arguments);
    declareOther(arguments);
}

BakeOptions BakeCommand::bakeOptions(const Arguments& arguments) const
{
    BakeOptions options = mBake;
    options.spacing = mSpacing.value_or(0);
    options.lightGroup = mScene.lightGroup;
    options.commandLine = arguments.commandLine();
    options.threads = mCommon.threads;
    options.validate();
    return options;
}

void BakeCommand::finishMetadata(BakeResult& result, const Arguments& arguments) const
{
    VolumeMetadata& metadata = result.volume.metadata();
    metadata.options = arguments.commandLine();
    if (!mSpacing) metadata.options += " --spacing " + toText(result.report.spacing);
    if (mUpAxis == "y") return;
    result.volume = transformVolume(result.volume, upAxisRotation("y", mUpAxis));
    result.volume.metadata().upAxis = mUpAxis;
}

Json BakeCommand::report(
    const BakeResult& result, const Scene& scene, const BakeSeconds& seconds) const
{
    const BakeReport& baked = result.report;
    Json json;
    json["samples"] = baked.samples;
    json["cells_by_level"] = baked.cellsByLevel;
    json["rays"] = baked.rays;
    json["rays_per_second"] = baked.raysPerSecond;
    json["seconds"] = {{"load", seconds.load}, {"build", seconds.build}, {"trace", seconds.trace},
        {"refine", 0.0}, {"write", seconds.write}};
    json["target_error"] = nullptr;
    json["achieved"] = {{"rel_rmse", nullptr}, {"confidence", nullptr}, {"points", nullptr}};
    json["decisions"] = baked.decisions;
    json["warnings"] = mCommon.console.warnings();
    json["spacing"] = baked.spacing;
    json["bands"] = result.volume.bands();
    json["bounds"] = jsonOf(result.volume.worldBounds());
    json["mean_relative_stderr"] = baked.meanRelativeStderr;
    json["triangles"] = scene.triangleCount();
    json["scene_hash"] = result.volume.metadata().sceneHash;
    json["file"] = mOutput.path;
    json["file_bytes"] = fileBytes(mOutput.path);
    return json;
}

void BakeCommand::summarise(const BakeResult& result, const BakeSeconds& seconds) const
{
    const BakeReport& baked = result.report;
    const double total = seconds.load + seconds.build + seconds.trace + seconds.write;
    const Console& console = mCommon.console;
    console.note(grouped(baked.samples) + " samples " + rounded(baked.spacing) + " apart, "
        + std::to_string(result.volume.bands()) + " bands; " + grouped(baked.rays) + " rays, "
        + rounded(baked.raysPerSecond / 1e6, 3) + " million a second; standard error of E "
        + rounded(100 * baked.meanRelativeStderr, 2) + "% on average.");
    console.note("'" + mOutput.path + "': " + humanBytes(fileBytes(mOutput.path)) + " after "
        + humanSeconds(total) + " (load " + humanSeconds(seconds.load) + ", build "
        + humanSeconds(seconds.build) + ", trace " + humanSeconds(seconds.trace) + ", write "
        + humanSeconds(seconds.write) + ").");
}

void BakeCommand::run(const Arguments& arguments)
{
    mScene.validate(arguments);
    validateLightTransport(mBake.probe.contribution, mBake.probe.maxBounces);
    const BakeOptions options = bakeOptions(arguments);
    mOutput.check();
    checkIsNoneOf(mOutput.path, "-o", {mScene.path});
    mCommon.apply({mScene.path, mOutput.path});
    BakeSeconds seconds;
    Stopwatch watch;
    const auto scene = mScene.load(mCommon.console);
    seconds.load = watch.restart();

    ProgressBar progress(mCommon.console.progressStyle());
    const Tracer tracer(scene, &progress);
    throwIfInterrupted();
    seconds.build = watch.restart();
    BakeResult result = bakeVolume(tracer, options, &progress);
    seconds.trace = watch.restart();
    finishMetadata(result, arguments);
    mOutput.write(result.volume, progress);
    seconds.write = watch.restart();
    progress.finish();

    mCommon.console.warn(result.report.warnings);
    for (const std::string& decision : result.report.decisions) mCommon.console.note(decision);
    summarise(result, seconds);
    mCommon.writeJson(report(result, *scene, seconds));
}

} // namespace

std::unique_ptr<Command> makeBakeCommand() { return std::make_unique<BakeCommand>(); }

} // namespace lumivdb::cli
