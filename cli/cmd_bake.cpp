// SPDX-License-Identifier: Apache-2.0
/// lumivdb bake: a scene in, an irradiance volume out.

#include "numbers.h"
#include "output.h"
#include "volume_command.h"

#include <lumivdb/bake/bake.h>

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <sstream>

namespace lumivdb::cli {

namespace {

class BakeCommand : public VolumeCommand {
public:
    void declare(Arguments& arguments) override;

private:
    void declareGrid(Arguments& arguments);
    void declareRefinement(Arguments& arguments);
    void declareTracing(Arguments& arguments);
    void declareOther(Arguments& arguments);
    BakeOptions bakeOptions(const Arguments& arguments) const;
    void prepare(const Arguments& arguments) override;
    Made make(const Tracer& tracer, Progress& progress) override;
    bool spacingFromScene(const Arguments& arguments) const override;
    double traceSeconds(const Seconds& seconds) const;
    void summarise(const Seconds& seconds) const override;
    Json report(const Scene& scene, const Seconds& seconds) const override;
    void written() override;
    std::string afterError(ErrorCode code) const override;
    void judge() const override;

    BakeOptions mBake;
    std::optional<double> mSpacing, mTargetError;
    std::optional<BakeResult> mResult;
};

/// An integer of a range, or "auto" for @a automatic.
void declareOrAuto(Arguments& arguments, const std::string& name, const std::string& valueName,
    int& target, int automatic, const Range& range, const std::string& help)
{
    const auto convert = [&target, automatic, range, name](const std::string& value) {
        const auto number = parseInteger(value);
        if (value == "auto") {
            target = automatic;
        } else if (!number || !range.contains(static_cast<double>(*number))) {
            failValue(name, value, "not an integer from " + range.text() + ", nor auto");
        } else {
            target = static_cast<int>(*number);
        }
    };
    arguments.custom(name, valueName + "|auto", convert,
        help + " [" + range.text() + " or auto; default " + std::to_string(target)
            + ", auto with --target-error]");
}

const std::vector<std::pair<std::string, RefineHeuristic>>& heuristics()
{
    static const std::vector<std::pair<std::string, RefineHeuristic>> words
        = {{"error", RefineHeuristic::Error}, {"gradient", RefineHeuristic::Gradient},
            {"geometry", RefineHeuristic::Geometry}, {"harmonic", RefineHeuristic::Harmonic},
            {"brute", RefineHeuristic::Brute}};
    return words;
}

void declareHeuristics(Arguments& arguments, std::vector<RefineHeuristic>& target)
{
    const auto convert = [&target](const std::string& value) {
        target.clear();
        std::istringstream list(value + (value.back() == ',' ? "," : ""));
        for (std::string word; std::getline(list, word, ',');) {
            const auto& words = heuristics();
            const auto found = std::find_if(
                words.begin(), words.end(), [&](const auto& w) { return w.first == word; });
            if (found == words.end()) {
                failValue("--refine", value,
                    "'" + word + "' is not one of error|gradient|geometry|harmonic|brute");
            }
            target.push_back(found->second);
        }
        if (target.empty()) failValue("--refine", value, "names no heuristic");
    };
    arguments.custom("--refine", "LIST", convert,
        "what splits a cell, comma list of: error (what the sample in the middle has over the "
        "interpolation), gradient, geometry, harmonic (mean distance below the cell's width), "
        "brute (split all, merge what is redundant) [default error]");
}

void declareThresholds(Arguments& arguments, RefineOptions& refine)
{
    const auto convert = [&refine](const std::string& value) {
        const auto equals = value.find('=');
        const std::string word = value.substr(0, equals);
        const auto number
            = equals == std::string::npos ? std::nullopt : parseReal(value.substr(equals + 1));
        const bool zero = word == "geometry" || word == "cull";
        if (!number || *number < 0 || (*number == 0 && !zero)) {
            failValue("--refine-threshold", value,
                std::string("not NAME=V with a number V ") + (zero ? "of 0 or more" : "above 0"));
        }
        if (word == "error") {
            refine.error = *number;
        } else if (word == "gradient") {
            refine.gradient = *number;
        } else if (word == "harmonic") {
            refine.harmonic = *number;
        } else if (word == "brute") {
            refine.brute = *number;
        } else if (word == "cull") {
            refine.cull = *number;
        } else if (word == "geometry" && *number == std::floor(*number) && *number <= kMaxLevel) {
            refine.geometry = static_cast<int>(*number);
        } else {
            failValue("--refine-threshold", value,
                "not one of error|gradient|harmonic|brute|cull=V, geometry=LEVEL");
        }
    };
    arguments.repeated("--refine-threshold", "NAME=V", convert,
        "of a heuristic: error=0.05 (share of the mean irradiance, in the coarsest cells), "
        "gradient=0.5 (the same share, across a cell), geometry=0 (level to go down to), "
        "harmonic=1 (cell widths), brute=0.05, cull (children are merged below it; default a "
        "quarter of error, or brute)");
}

void declarePart(Arguments& arguments, BakeOptions& bake)
{
    const auto convert = [&bake](const std::string& value) {
        const auto slash = value.find('/');
        const auto part = parseInteger(value.substr(0, slash));
        const auto parts
            = slash == std::string::npos ? std::nullopt : parseInteger(value.substr(slash + 1));
        if (!part || !parts || *part < 1 || *parts < *part || *parts > 1000000) {
            failValue("--part", value, "not I/N with 1 <= I <= N");
        }
        bake.part = static_cast<int>(*part);
        bake.parts = static_cast<int>(*parts);
    };
    arguments.custom("--part", "I/N", convert,
        "bake part I of N of an adaptive volume, on a machine of its own; 'lumivdb resample' joins "
        "parts to the very grids of the whole");
}

void BakeCommand::declareGrid(Arguments& arguments)
{
    arguments.section("Volume");
    arguments.box("--bounds", mBake.bounds,
        "box to fill, scene units; grown to whole cells [default: the scene's box, one cell "
        "larger]");
    arguments.real("--spacing", mSpacing, greaterThan(0),
        "finest distance between samples, scene units", "from the scene's size, printed");
    declareOrAuto(arguments, "--levels", "K", mBake.levels, -1, between(0, kMaxLevel),
        "coarser levels above it: cells up to spacing * 2^K; 0: uniform");
    declareOrAuto(arguments, "--bands", "N", mBake.bands, 0, between(1, kMaxBands),
        "SH bands of the radiance: N*N coefficients a sample; 3 is off by a few percent under "
        "concentrated light, 5 repairs it");
    arguments.choice<GradientMethod>("--gradients", mBake.gradients,
        {{"none", GradientMethod::None}, {"central", GradientMethod::Central},
            {"analytic", GradientMethod::Analytic}},
        "derivatives of every coefficient; analytic: from the same rays; central: six more "
        "projections a sample, spacing/8 away; chosen with --target-error");
    declareVolume(arguments, mBake.visibility);
}

void BakeCommand::declareRefinement(Arguments& arguments)
{
    arguments.section("Error and refinement");
    arguments.real("--target-error", mTargetError, between(1e-4, 1),
        "relative RMS error of irradiance to meet, e.g. 0.02, proven on points the bake does not "
        "use; whatever is not given is then chosen. Exit code 1 where it cannot be met; the "
        "volume is written all the same",
        "none");
    arguments.real(
        "--confidence", mBake.target.confidence, between(0.51, 0.9999), "of that proof, one-sided");
    arguments.size("--max-samples", mBake.target.maxSamples, between(1000, 1e9),
        "samples to trace before giving up");
    declareHeuristics(arguments, mBake.refine.heuristics);
    declareThresholds(arguments, mBake.refine);
    declarePart(arguments, mBake);
}

void BakeCommand::declareTracing(Arguments& arguments)
{
    arguments.section("Tracing");
    arguments.integer("--rays", mBake.probe.rays, between(2, 67108864),
        "directions per sample; chosen with --target-error");
    declareLightTransport(arguments, mBake.probe.contribution, mBake.probe.maxBounces);
    declareIntegrator(arguments, mBake.integrator);
    arguments.seed("--seed", mBake.probe.seed, "random numbers; same seed, same bits");
}

void BakeCommand::declareOther(Arguments& arguments)
{
    arguments.section("Output");
    arguments.flag("--resume", mBake.resume,
        "go on with a bake that was interrupted or killed: takes from OUT.vdb.journal, which every "
        "bake keeps until its volume is written, what was traced already, and ends in the same "
        "bytes; any --threads");
    arguments.neutral();
    declareOutput(arguments, "report: samples, rays, seconds, decisions, warnings");
    arguments.example("lumivdb bake room.glb -o room.vdb",
        "everything by default: spacing from the scene, 3 bands, 1024 rays a sample");
    arguments.example("lumivdb bake sponza.glb --env sky.hdr --sun-direction 0.3,1,0.2 --sun-lux 8 "
                      "--spacing 0.5 --rays 4096 -o sponza.vdb --json -",
        "an atrium under a sky and a sun; the report goes to standard output");
    arguments.example("lumivdb bake room.glb --target-error 0.02 -o room.vdb",
        "as many samples, bands and rays as a proven error of 2% takes, where they are needed");
    arguments.example("lumivdb bake room.glb --spacing 0.05 --levels 4 -o room.vdb",
        "cells from 0.05 to 0.8, small where the light changes");
}

void BakeCommand::declare(Arguments& arguments)
{
    declareScene(arguments);
    declareGrid(arguments);
    declareRefinement(arguments);
    declareTracing(arguments);
    declareOther(arguments);
}

BakeOptions BakeCommand::bakeOptions(const Arguments& arguments) const
{
    BakeOptions options = mBake;
    options.spacing = mSpacing.value_or(0);
    options.lightGroup = mScene.lightGroup;
    options.commandLine = arguments.commandLine();
    options.journal = mOutput.path + ".journal";
    options.threads = mCommon.threads;
    const bool refines = arguments.given("--refine") || arguments.given("--refine-threshold");
    if (refines && !arguments.given("--levels")) options.levels = -1;
    if (refines && options.levels == 0 && !mTargetError) {
        failUsage("--levels 0 makes a uniform volume, where nothing is refined; leave --refine and "
                  "--refine-threshold out, or give more levels.");
    }
    for (const char* option : {"--confidence", "--max-samples"}) {
        if (arguments.given(option) && !mTargetError) {
            failUsage(std::string(option) + " belongs to --target-error; give that too.");
        }
    }
    if (mTargetError) {
        options.target.error = *mTargetError;
        if (!arguments.given("--bands")) options.bands = 0;
        options.target.chooseRays = !arguments.given("--rays");
        options.target.chooseGradients = !arguments.given("--gradients");
    }
    options.validate();
    return options;
}

void BakeCommand::prepare(const Arguments& arguments)
{
    validateLightTransport(mBake.probe.contribution, mBake.probe.maxBounces);
    mBake = bakeOptions(arguments);
}

BakeCommand::Made BakeCommand::make(const Tracer& tracer, Progress& progress)
{
    const bool there = fileBytes(mBake.journal) > 0;
    const std::string named = "'" + mBake.journal + "'";
    if (mBake.resume) {
        mCommon.console.note(there ? "Going on from " + named + "."
                                   : "There is no " + named + " to go on from: starting anew.");
    } else if (there) {
        mCommon.console.note(
            named + " of an earlier bake is not used; --resume would have gone on from it.");
    }
    mResult = bakeVolume(tracer, mBake, &progress);
    const BakeReport& baked = mResult->report;
    return {mResult->volume, baked.warnings, baked.decisions, baked.spacing};
}

bool BakeCommand::spacingFromScene(const Arguments& arguments) const
{
    return !mSpacing && !mTargetError && mBake.levels == 0 && !arguments.given("--refine")
        && !arguments.given("--refine-threshold");
}

Json achieved(const AchievedError& a)
{
    if (a.points == 0) return {{"rel_rmse", nullptr}, {"confidence", nullptr}, {"points", nullptr}};
    Json json = {{"rel_rmse", a.upper}, {"confidence", a.confidence}, {"points", a.points},
        {"estimate", a.relRmse}, {"met", a.met}};
    json["worst"] = Json::array();
    for (const AchievedError::Place& w : a.worst) {
        json["worst"].push_back({{"position", jsonOf(w.position)}, {"error", w.error}});
    }
    return json;
}

Json integratorJson(const BakeReport& baked)
{
    Json json = {{"name", name(baked.integrator)}};
    if (baked.cache.patches > 0) {
        const RadianceCacheReport& c = baked.cache;
        json["cache"] = {{"patches", c.patches}, {"mixed", c.mixed}, {"joined", c.joined},
            {"rays", c.rays}, {"bytes", c.bytes}, {"iterations", c.iterations},
            {"residual", c.residual}, {"seconds", c.seconds}};
    }
    if (baked.bias.points > 0) {
        const CacheBias& b = baked.bias;
        json["bias"] = {{"rms", b.rms}, {"upper", b.upper}, {"confidence", 0.95}, {"mean", b.mean},
            {"mean_stderr", b.meanStderr}, {"points", b.points}, {"rays", b.rays}};
    }
    return json;
}

double BakeCommand::traceSeconds(const Seconds& seconds) const
{
    return seconds.make - mResult->report.secondsRefine - mResult->report.secondsVerify;
}

Json BakeCommand::report(const Scene& scene, const Seconds& seconds) const
{
    const BakeReport& baked = mResult->report;
    Json json;
    json["samples"] = baked.samples;
    json["traced_samples"] = baked.tracedSamples;
    json["journal_samples"] = baked.journalSamples;
    json["cells_by_level"] = baked.cellsByLevel;
    json["rays"] = baked.rays;
    json["rays_per_second"] = baked.raysPerSecond;
    json["seconds"] = {{"load", seconds.load}, {"build", seconds.build},
        {"trace", traceSeconds(seconds)}, {"refine", baked.secondsRefine},
        {"verify", baked.secondsVerify}, {"write", seconds.write}};
    json["target_error"] = mTargetError ? Json(*mTargetError) : Json(nullptr);
    json["achieved"] = achieved(baked.achieved);
    json["integrator"] = integratorJson(baked);
    json["decisions"] = baked.decisions;
    json["warnings"] = mCommon.console.warnings();
    json["spacing"] = baked.spacing;
    json["bands"] = mResult->volume.bands();
    json["bounds"] = jsonOf(mResult->volume.worldBounds());
    json["mean_relative_stderr"] = baked.meanRelativeStderr;
    json["triangles"] = scene.triangleCount();
    addFile(json, mResult->volume);
    return json;
}

void BakeCommand::summarise(const Seconds& seconds) const
{
    const BakeReport& baked = mResult->report;
    const Console& console = mCommon.console;
    noteLevels(baked.cellsByLevel);
    if (mBake.resume) {
        console.note(
            grouped(baked.journalSamples) + " samples were taken from the journal, not traced.");
    }
    if (baked.achieved.points > 0) {
        console.note("Error: " + rounded(100 * baked.achieved.relRmse, 3) + "%, at most "
            + rounded(100 * baked.achieved.upper, 3) + "% with "
            + rounded(100 * baked.achieved.confidence, 4) + "% confidence, at "
            + grouped(baked.achieved.points) + " points that the bake did not use.");
    }
    console.note(grouped(baked.samples) + " samples " + rounded(baked.spacing) + " apart, "
        + std::to_string(mResult->volume.bands()) + " bands; " + grouped(baked.rays) + " rays, "
        + rounded(baked.raysPerSecond / 1e6, 3) + " million a second; standard error of E "
        + rounded(100 * baked.meanRelativeStderr, 2) + "% on average.");
    if (baked.integrator == Integrator::Cached) {
        console.note("Radiance cache: " + grouped(baked.cache.patches) + " patches, "
            + humanBytes(baked.cache.bytes) + ", solved in " + humanSeconds(baked.cache.seconds)
            + "; bias " + rounded(100 * baked.bias.rms, 2) + "%, at most "
            + rounded(100 * baked.bias.upper, 2) + "% with 95% confidence.");
    }
    noteFile(seconds.load + seconds.build + seconds.make + seconds.write,
        "load " + humanSeconds(seconds.load) + ", build " + humanSeconds(seconds.build) + ", trace "
            + humanSeconds(traceSeconds(seconds)) + ", refine " + humanSeconds(baked.secondsRefine)
            + ", verify " + humanSeconds(baked.secondsVerify) + ", write "
            + humanSeconds(seconds.write));
}

void BakeCommand::written() { removeJournal(*mResult); }

std::string BakeCommand::afterError(ErrorCode code) const
{
    const bool later = code == ErrorCode::Interrupted || code == ErrorCode::Output;
    if (!later || fileBytes(mBake.journal) == 0) return "";
    return " What was traced is in '" + mBake.journal + "': go on with --resume.";
}

void BakeCommand::judge() const
{
    const AchievedError& a = mResult->report.achieved;
    if (!mTargetError || a.met) return;
    std::string places;
    for (std::size_t i = 0; i < a.worst.size() && i < 3; ++i) {
        const Vec3d& p = a.worst[i].position;
        places += (i > 0 ? ", (" : " (") + rounded(p.x, 4) + ", " + rounded(p.y, 4) + ", "
            + rounded(p.z, 4) + ")";
    }
    throw Error(ErrorCode::BoundNotMet,
        "'" + mOutput.path + "': the target error " + rounded(*mTargetError)
            + " was not met; the volume was written with an error of at most " + rounded(a.upper, 3)
            + ". It is worst at" + places
            + ": raise --max-samples, or leave thin walls and lamps out with --bounds.");
}

} // namespace

std::unique_ptr<Command> makeBakeCommand() { return std::make_unique<BakeCommand>(); }

} // namespace lumivdb::cli
