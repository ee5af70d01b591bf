// SPDX-License-Identifier: Apache-2.0
/// lumivdb lpv: a scene in, an irradiance volume out, by light propagation instead of paths.

#include "numbers.h"
#include "volume_command.h"

#include <lumivdb/bake/lpv_bake.h>

#include <nlohmann/json.hpp>

namespace lumivdb::cli {

namespace {

class LpvCommand : public VolumeCommand {
public:
    void declare(Arguments& arguments) override;

private:
    void declareGrid(Arguments& arguments);
    void declarePropagation(Arguments& arguments);
    void declareSampling(Arguments& arguments);
    void declareOther(Arguments& arguments);
    LpvBakeOptions bakeOptions(const Arguments& arguments) const;
    void prepare(const Arguments& arguments) override { mBake = bakeOptions(arguments); }
    Made make(const Tracer& tracer, Progress& progress) override;
    bool spacingFromScene(const Arguments&) const override { return !mSpacing; }
    void summarise(const Seconds& seconds) const override;
    Json report(const Scene& scene, const Seconds& seconds) const override;

    LpvBakeOptions mBake;
    std::optional<double> mSpacing;
    bool mNoOcclusion = false;
    std::optional<LpvBakeResult> mResult;
};

void LpvCommand::declareGrid(Arguments& arguments)
{
    arguments.section("Volume");
    arguments.real("--spacing", mSpacing, greaterThan(0),
        "width of a cell, and distance between samples, scene units; of the finest cascade",
        "from the scene's size, printed");
    arguments.box("--bounds", mBake.bounds,
        "box to fill with one cascade, scene units; grown to whole cells [default: the scene's "
        "box, one cell larger]");
    arguments.integer("--cascades", mBake.cascades.cascades, between(1, 8),
        "nested volumes of doubling spacing around --center; 1: one volume over --bounds");
    arguments.integer("--cells", mBake.cascades.cells, between(24, 1024),
        "cells along each axis of each of several cascades, a multiple of 8");
    arguments.vector("--center", mBake.center,
        "place that several cascades lie around, scene units [default: the scene's middle]");
    declareVolume(arguments, mBake.visibility);
}

void LpvCommand::declarePropagation(Arguments& arguments)
{
    arguments.section("Propagation");
    arguments.integer("--iterations", mBake.stop.iterations, between(0, 1000000),
        "at most; light moves by a cell in each");
    arguments.real("--tolerance", mBake.stop.tolerance, between(0, 0.999),
        "share of the light that may be left on its way; 0: until --iterations");
    arguments.choice<LpvScheme>("--scheme", mBake.lpv.scheme,
        {{"clamped", LpvScheme::Clamped}, {"conservative", LpvScheme::Conservative}},
        "clamped: negative lobes are cut off, as in the paper, which adds light; conservative: no "
        "flux is gained or lost");
    arguments.flag("--no-occlusion", mNoOcclusion,
        "nothing stands in the way: faster, and light passes through walls");
    arguments.choice<LpvBounces>("--bounces", mBake.lpv.bounces,
        {{"one", LpvBounces::One}, {"many", LpvBounces::Many}},
        "reflections: the first alone, or also of light that the geometry volume stops");
}

void LpvCommand::declareSampling(Arguments& arguments)
{
    arguments.section("Light that is fed in");
    arguments.integer("--rsm", mBake.rsmResolution, between(1, 16384),
        "texels along a side of the reflective shadow map of each light; a point light has six, "
        "area lights and the environment have N small ones");
    arguments.size("--surfels", mBake.maxSurfels, between(0, 1e9),
        "keep so many of the maps' lit pieces, drawn by importance; 0: all");
    arguments.choice<Contribution>("--contribution", mBake.contribution,
        {{"indirect", Contribution::Indirect}, {"all", Contribution::All}},
        "indirect: what was reflected, which is what propagates; all: direct light is traced at "
        "each sample and added");
    arguments.integer("--rays", mBake.rays, between(0, 67108864),
        "directions per sample for its validity and distance, and for direct light with "
        "--contribution all; 0: samples are not looked at");
    arguments.seed("--seed", mBake.seed, "random numbers; same seed, same bits");
}

void LpvCommand::declareOther(Arguments& arguments)
{
    declareOutput(arguments, "report: samples, surfels, iterations, residual, seconds");
    arguments.example(
        "lumivdb lpv room.glb -o room.vdb", "the indirect light of a room: spacing from the scene");
    arguments.example("lumivdb lpv sponza.glb --sun-direction 0.3,1,0.2 --sun-lux 8 --spacing 0.5 "
                      "--bounces many -o sponza.vdb",
        "an atrium under a sun, reflected more than once");
    arguments.example(
        "lumivdb lpv city.glb --env sky.hdr --cascades 3 --center 10,2,-5 --spacing 0.5 -o c.vdb",
        "cells of 0.5, 1 and 2 around a place");
    arguments.example("lumivdb evaluate room.vdb --scene room.glb",
        "how far that is from the truth: evaluate compares indirect light with indirect light");
}

void LpvCommand::declare(Arguments& arguments)
{
    arguments.describe(
        "A preview of 'lumivdb bake': what lights shine on is found by reflective shadow maps and "
        "sent from cell to cell of a grid (light propagation volumes, Kaplanyan & Dachsbacher "
        "2010). Fast, with two bands, and an error of tens of per cent; 'lumivdb evaluate' "
        "measures it. By default the volume holds indirect light: renderers that light with it "
        "add the lights themselves.");
    declareScene(arguments);
    declareGrid(arguments);
    declarePropagation(arguments);
    declareSampling(arguments);
    declareOther(arguments);
}

LpvBakeOptions LpvCommand::bakeOptions(const Arguments& arguments) const
{
    LpvBakeOptions options = mBake;
    options.lpv.spacing = mSpacing.value_or(0);
    options.lpv.threads = mCommon.threads;
    options.lightGroup = mScene.lightGroup;
    options.commandLine = arguments.commandLine();
    if (mNoOcclusion) {
        options.lpv.occlusion = LpvOcclusion::Off;
        if (mBake.lpv.bounces == LpvBounces::Many) {
            failUsage("--bounces many needs geometry to reflect from; leave --no-occlusion out.");
        }
    }
    if (mBake.cascades.cascades > 1 && mBake.bounds) {
        failUsage("--bounds is for one cascade; several are cubes around --center.");
    }
    for (const char* option : {"--center", "--cells"}) {
        if (arguments.given(option) && mBake.cascades.cascades == 1) {
            failUsage(std::string(option) + " belongs to --cascades of 2 or more; give that too.");
        }
    }
    if (mBake.rays == 1) failValue("--rays", "1", "take 2 or more, or 0 for none");
    if (mBake.rays == 0 && mBake.contribution == Contribution::All) {
        failUsage("--contribution all traces direct light; give --rays 2 or more.");
    }
    if (mBake.cascades.cells % 8 != 0) {
        failValue("--cells", std::to_string(mBake.cascades.cells), "not a multiple of 8");
    }
    options.validate();
    return options;
}

LpvCommand::Made LpvCommand::make(const Tracer& tracer, Progress& progress)
{
    mResult = bakeLpv(tracer, mBake, &progress);
    const LpvBakeReport& r = mResult->report;
    return {mResult->volume, r.warnings, r.decisions, r.spacing};
}

Json LpvCommand::report(const Scene&, const Seconds& seconds) const
{
    const LpvBakeReport& r = mResult->report;
    Json json;
    json["samples"] = r.samples;
    json["cells_by_level"] = r.cellsByLevel;
    json["surfels"] = r.surfels;
    json["surfels_outside"] = r.surfelsOutside;
    json["blockers"] = r.blockers;
    json["rays"] = r.rays;
    json["iterations"] = r.propagation.iterations;
    json["residual"] = r.propagation.residual;
    json["seconds"] = {{"load", seconds.load}, {"build", seconds.build}, {"rsm", r.secondsRsm},
        {"inject", r.secondsInject}, {"propagate", r.secondsPropagate},
        {"samples", r.secondsSamples}, {"write", seconds.write}};
    json["decisions"] = r.decisions;
    json["warnings"] = mCommon.console.warnings();
    json["contribution"] = mResult->volume.metadata().contribution;
    json["scheme"] = mBake.lpv.scheme == LpvScheme::Clamped ? "clamped" : "conservative";
    json["occlusion"] = !mNoOcclusion;
    json["bounces"] = mBake.lpv.bounces == LpvBounces::One ? "one" : "many";
    json["cascades"] = mBake.cascades.cascades;
    json["spacing"] = r.spacing;
    json["bands"] = mResult->volume.bands();
    json["bounds"] = jsonOf(mResult->volume.worldBounds());
    addFile(json, mResult->volume);
    return json;
}

void LpvCommand::summarise(const Seconds& seconds) const
{
    const LpvBakeReport& r = mResult->report;
    const Console& console = mCommon.console;
    noteLevels(r.cellsByLevel);
    console.note(grouped(r.samples) + " samples " + rounded(r.spacing) + " apart; "
        + grouped(r.surfels) + " lit pieces of surface, " + grouped(r.surfelsOutside)
        + " of them outside, " + grouped(r.blockers) + " in the way.");
    console.note(grouped(static_cast<std::uint64_t>(r.propagation.iterations)) + " iterations; "
        + rounded(100 * r.propagation.residual, 2) + "% of the light was left on its way.");
    noteFile(seconds.load + seconds.build + seconds.make + seconds.write,
        "load " + humanSeconds(seconds.load) + ", build " + humanSeconds(seconds.build) + ", maps "
            + humanSeconds(r.secondsRsm) + ", inject " + humanSeconds(r.secondsInject)
            + ", propagate " + humanSeconds(r.secondsPropagate) + ", samples "
            + humanSeconds(r.secondsSamples) + ", write " + humanSeconds(seconds.write));
}

} // namespace

std::unique_ptr<Command> makeLpvCommand() { return std::make_unique<LpvCommand>(); }

} // namespace lumivdb::cli
