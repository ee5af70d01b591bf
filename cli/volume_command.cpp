// SPDX-License-Identifier: Apache-2.0
#include "volume_command.h"

#include "interrupt.h"
#include "numbers.h"
#include "output.h"

#include <lumivdb/vdb_io/resample.h>

#include <nlohmann/json.hpp>

namespace lumivdb::cli {

void VolumeCommand::declareScene(Arguments& arguments)
{
    mScene.declarePositional(arguments);
    mScene.declareLight(arguments);
    mScene.declareLightGroup(arguments, "[default: all light]");
}

void VolumeCommand::declareVolume(Arguments& arguments, bool& visibility)
{
    arguments.choice<bool>("--visibility", visibility, {{"on", true}, {"off", false}},
        "masks that keep light on its side of walls in cells that geometry cuts");
    arguments.choice<std::string>("--up", mUpAxis, {{"y", "y"}, {"z", "z"}},
        "up axis of the file; z turns grid and coefficients for Z-up programs such as Blender");
}

void VolumeCommand::declareOutput(Arguments& arguments, const std::string& report)
{
    mOutput.declare(arguments);
    arguments.section("General");
    mCommon.declareThreads(arguments);
    mCommon.declareJson(arguments, report);
    mCommon.declareQuiet(arguments);
}

void VolumeCommand::noteLevels(const std::vector<std::uint64_t>& cellsByLevel) const
{
    if (cellsByLevel.size() < 2) return;
    std::string levels;
    for (const std::uint64_t n : cellsByLevel) levels += " " + grouped(n);
    mCommon.console.note("Cells by level, finest first:" + levels + ".");
}

void VolumeCommand::noteFile(double seconds, const std::string& stages) const
{
    mCommon.console.note("'" + mOutput.path + "': " + humanBytes(fileBytes(mOutput.path))
        + " after " + humanSeconds(seconds) + " (" + stages + ").");
}

void VolumeCommand::addFile(Json& json, const IrradianceVolume& volume) const
{
    json["scene_hash"] = volume.metadata().sceneHash;
    json["file"] = mOutput.path;
    json["file_bytes"] = fileBytes(mOutput.path);
}

void VolumeCommand::run(const Arguments& arguments)
{
    mScene.validate(arguments);
    prepare(arguments);
    mOutput.check();
    checkIsNoneOf(mOutput.path, "-o", {mScene.path});
    mCommon.apply({mScene.path, mOutput.path});
    Seconds seconds;
    Stopwatch watch;
    const auto scene = mScene.load(mCommon.console);
    seconds.load = watch.restart();

    ProgressBar progress(mCommon.console.progressStyle(),
        [this](const std::string& warning) { mCommon.console.warn(warning); });
    const Tracer tracer(scene, &progress);
    throwIfInterrupted();
    seconds.build = watch.restart();
    const Made made = makeAndWrite(arguments, tracer, progress, seconds);
    progress.finish();

    mCommon.console.warn(made.warnings);
    for (const std::string& decision : made.decisions) mCommon.console.note(decision);
    summarise(seconds);
    mCommon.writeJson(report(*scene, seconds));
    judge();
}

VolumeCommand::Made VolumeCommand::makeAndWrite(
    const Arguments& arguments, const Tracer& tracer, ProgressBar& progress, Seconds& seconds)
try {
    Stopwatch watch;
    const Made made = make(tracer, progress);
    seconds.make = watch.restart();
    VolumeMetadata& metadata = made.volume.metadata();
    metadata.options = arguments.commandLine();
    if (spacingFromScene(arguments)) metadata.options += " --spacing " + toText(made.spacing);
    if (mUpAxis != "y") {
        made.volume = transformVolume(made.volume, upAxisRotation("y", mUpAxis));
        made.volume.metadata().upAxis = mUpAxis;
    }
    mOutput.write(made.volume, progress);
    seconds.write = watch.restart();
    written();
    return made;
} catch (const Error& e) {
    throw Error(e.code(), e.what() + afterError(e.code()));
}

} // namespace lumivdb::cli
