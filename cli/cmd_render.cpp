// SPDX-License-Identifier: Apache-2.0
/// lumivdb render: a picture of a scene lit by a volume or with its samples, or a slice through the
/// volume: its light, its levels, its error.

#include "common.h"
#include "interrupt.h"
#include "numbers.h"
#include "output.h"
#include "scene_options.h"

#include <lumivdb/vdb_io/volume_file.h>
#include <lumivdb/viewer/picture.h>

#include <nlohmann/json.hpp>

#include <cmath>
#include <limits>
#include <sstream>

namespace lumivdb::cli {

namespace {

struct SliceRequest {
    int axis;
    double position;
};

enum class Show { Light, Levels, Probes, Error };

class RenderCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    void declareView(Arguments& arguments);
    void declareSlice(Arguments& arguments);
    void validate(const Arguments& arguments) const;
    void renderScene(const IrradianceVolume& volume);
    void declareShow(Arguments& arguments);
    void validateShow(const Arguments& arguments) const;
    SliceOptions sliceOptions(const IrradianceVolume& volume) const;
    void renderSliceImage(const IrradianceVolume& volume);
    void renderOverScene(const IrradianceVolume& volume);
    void renderLevelsImage(const Tracer& tracer, const IrradianceVolume& volume);
    void renderErrorImage(
        const Tracer& tracer, const IrradianceVolume& volume, ProgressBar& progress);
    std::shared_ptr<const Scene> loadScene(const IrradianceVolume& yUp);

    CommonOptions mCommon;
    SceneOptions mScene;
    PictureOptions mPicture;
    std::string mVolume;
    std::string mOutput;
    std::optional<Interpolation> mMode;
    std::optional<double> mExposure;
    std::optional<double> mFov;
    std::optional<SliceRequest> mSlice;
    Show mShow = Show::Light;
    ErrorMapOptions mError;
};

/// The light that @a metadata's volume holds, so that the comparison is fair.
void followBake(const VolumeMetadata& metadata, ProbeOptions& reference)
{
    for (const auto c : {Contribution::All, Contribution::Direct, Contribution::Indirect}) {
        if (metadata.contribution == name(c)) reference.contribution = c;
    }
    std::istringstream options(metadata.options);
    for (std::string word; options >> word;) {
        if (word != "--max-bounces" || !(options >> word)) continue;
        if (const auto bounces = parseInteger(word)) {
            reference.maxBounces = static_cast<int>(*bounces);
        }
    }
    // Not the random numbers of the bake: its errors would be those of the reference.
    reference.seed = metadata.seed + 7001;
}

void declareSize(Arguments& arguments, PictureOptions& picture)
{
    const auto convert = [&picture](const std::string& value) {
        const auto parts = split(value, 'x');
        const auto width = parseInteger(parts.front());
        const auto height = parseInteger(parts.back());
        const auto good = [](const auto& n) { return n && *n >= 1 && *n <= 16384; };
        if (parts.size() != 2 || !good(width) || !good(height)) {
            failValue("--size", value, "not WIDTHxHEIGHT with 1 to 16384 pixels each");
        }
        picture.width = static_cast<int>(*width);
        picture.height = static_cast<int>(*height);
    };
    arguments.custom("--size", "WxH", convert,
        "pixels, 1 to 16384 each; of a slice the width counts [default "
            + std::to_string(picture.width) + "x" + std::to_string(picture.height) + "]");
}

void RenderCommand::declareView(Arguments& arguments)
{
    arguments.section("View");
    declareSize(arguments, mPicture);
    arguments.vector("--eye", mPicture.eye,
        "where the camera is, scene units [default: the scene's first camera, else a view of the "
        "whole]");
    arguments.vector("--target", mPicture.target, "what it looks at [goes with --eye]");
    arguments.real("--fov", mFov, between(1, 170), "vertical field of view, degrees",
        "the scene camera's where that is used, else 50");
    arguments.integer("--spheres", mPicture.spheres, between(0, 1000),
        "white test spheres in a row across the view, lit by the volume");
    arguments.integer("--samples", mPicture.samplesPerPixel, between(1, 4096), "rays a pixel");
    arguments.real("--exposure", mExposure, between(-64, 64), "stops, for PNG",
        "automatic, the 95th percentile of luminance over pixels that are not black becomes 0.8");
    declareMode(arguments, mMode);
}

void RenderCommand::declareSlice(Arguments& arguments)
{
    const auto convert = [this](const std::string& value) {
        const std::size_t axis
            = value.empty() ? std::string::npos : std::string("xyz").find(value[0]);
        const auto position
            = value.size() > 2 && value[1] == '=' ? parseReal(value.substr(2)) : std::nullopt;
        if (axis == std::string::npos || !position) {
            failValue("--slice", value, "not x=V, y=V or z=V with a finite number V");
        }
        mSlice = SliceRequest{static_cast<int>(axis), *position};
    };
    arguments.custom("--slice", "AXIS=V", convert,
        "instead of the picture: irradiance averaged over normals on the plane x=V, y=V or z=V in "
        "the volume's axes, as false colours over its logarithm; the range is printed; with --show "
        "levels or error that instead, in the scene's axes");
}

void RenderCommand::declareShow(Arguments& arguments)
{
    arguments.choice<Show>("--show", mShow,
        {{"light", Show::Light}, {"levels", Show::Levels}, {"probes", Show::Probes},
            {"error", Show::Error}},
        "light: the scene lit by the volume, or with --slice how much arrives where; levels: the "
        "cells that --slice cuts, coloured by level, to see where a bake has refined; probes: the "
        "scene with every sample as a small sphere lit by what it holds, invalid ones red; error: "
        "how far the volume is off along --slice, compared with an independent trace");
    arguments.integer("--rays", mError.reference.rays, between(2, 67108864),
        "of --show error: directions per place of the trace that the volume is compared with");
    arguments.integer("--blocks", mError.blocks, between(1, 4096),
        "of --show error: places compared across the picture");
}

void RenderCommand::declare(Arguments& arguments)
{
    mScene.declarePositional(arguments);
    arguments.text("--volume", "VOLUME.vdb", mVolume, "the volume that lights it");
    arguments.require();
    arguments.text("-o,--output", "OUT.png|exr", mOutput,
        "the image: .png (sRGB, exposed) or .exr (linear, as is)");
    arguments.require();
    declareShow(arguments);
    declareSlice(arguments);
    declareView(arguments);
    mScene.declareLight(arguments);
    arguments.section("General");
    mCommon.declareThreads(arguments);
    mCommon.declareJson(arguments, "size, mode, range of a slice, warnings");
    mCommon.declareQuiet(arguments);
    arguments.example("lumivdb render room.glb --volume room.vdb -o room.png",
        "the scene lit by the volume, with five test spheres");
    arguments.example("lumivdb render room.glb --volume room.vdb --slice y=1.2 -o slice.png",
        "how much light arrives 1.2 m above the ground");
    arguments.example(
        "lumivdb render room.glb --volume room.vdb --show error --slice y=1.2 -o error.png",
        "where the volume is wrong there, and by how much");
}

/// Options that the kind of picture would ignore are mistakes.
void RenderCommand::validateShow(const Arguments& arguments) const
{
    const std::string show = mShow == Show::Light ? "light"
        : mShow == Show::Levels                   ? "levels"
        : mShow == Show::Probes                   ? "probes"
                                                  : "error";
    const auto refuse = [&](std::initializer_list<const char*> options, const std::string& why) {
        for (const char* option : options)
            if (arguments.given(option))
                failUsage(std::string(option) + " has no part in --show " + show + ": " + why);
    };
    if (mShow != Show::Error) {
        refuse({"--rays", "--blocks"}, "only --show error traces anew; leave it out.");
    }
    if (mShow == Show::Probes) {
        refuse({"--slice", "--spheres"},
            "it is a picture of the scene with all samples; leave it out.");
    }
    if (mShow != Show::Levels && mShow != Show::Error) return;
    if (!mSlice) {
        failUsage("--show " + show + " is drawn on a plane; add one, such as --slice y=1.5.");
    }
    refuse({"--eye", "--target", "--fov", "--spheres", "--samples", "--exposure"},
        "it is a map of --slice, not a view; leave it out.");
    if (mShow == Show::Levels) refuse({"--mode"}, "it shows cells, no light; leave it out.");
}

void RenderCommand::validate(const Arguments& arguments) const
{
    mScene.validate(arguments);
    validateShow(arguments);
    if (mPicture.eye.has_value() != mPicture.target.has_value()) {
        failUsage("--eye and --target make one view; give both or none.");
    }
    if (mPicture.eye && *mPicture.eye == *mPicture.target) {
        failUsage("--eye and --target are the same point; move one.");
    }
    checkImagePath(mOutput);
}

std::shared_ptr<const Scene> RenderCommand::loadScene(const IrradianceVolume& yUp)
{
    auto scene = mScene.load(mCommon.console);
    if (yUp.metadata().lightGroup.empty()) {
        warnIfSceneDiffers(yUp, mVolume, *scene, mCommon.console);
    }
    return scene;
}

void RenderCommand::renderScene(const IrradianceVolume& volume)
{
    std::optional<IrradianceVolume> turned = broughtYUp(volume);
    const IrradianceVolume& yUp = turned ? *turned : volume;
    const auto scene = loadScene(yUp);
    ProgressBar progress(mCommon.console.progressStyle());
    const Tracer tracer(scene, &progress);
    throwIfInterrupted();
    if (mFov) mPicture.yfovDegrees = *mFov;
    mPicture.mode = modeFor(mMode, volume, mVolume);
    mPicture.probes = mShow == Show::Probes;
    const Image image = renderPicture(tracer, yUp, mPicture, &progress);
    progress.finish();
    throwIfInterrupted();
    writeImage(image, mOutput, mExposure.value_or(std::numeric_limits<double>::quiet_NaN()));
    mCommon.writeJson({{"file", mOutput}, {"width", image.width}, {"height", image.height},
        {"mode", name(mPicture.mode)}, {"warnings", mCommon.console.warnings()}});
}

SliceOptions RenderCommand::sliceOptions(const IrradianceVolume& volume) const
{
    SliceOptions options;
    options.axis = mSlice->axis;
    options.position = mSlice->position;
    options.width = mPicture.width;
    const Box3d box = volume.worldBounds();
    if (options.position < box.min[options.axis] || options.position > box.max[options.axis]) {
        failValue("--slice", std::string(1, "xyz"[options.axis]) + "=" + toText(options.position),
            "outside '" + mVolume + "', which spans " + rounded(box.min[options.axis]) + " to "
                + rounded(box.max[options.axis]));
    }
    return options;
}

void RenderCommand::renderSliceImage(const IrradianceVolume& volume)
{
    SliceOptions options = sliceOptions(volume);
    options.mode = modeFor(mMode, volume, mVolume);
    double low = 0, high = 0;
    const Image image = renderSlice(volume, options, &low, &high);
    throwIfInterrupted();
    writeDisplayImage(image, mOutput);
    mCommon.console.note("Colours span " + rounded(low) + " to " + rounded(high)
        + " (irradiance averaged over normals, logarithmic).");
    mCommon.writeJson({{"file", mOutput}, {"width", image.width}, {"height", image.height},
        {"mode", name(options.mode)}, {"low", low}, {"high", high},
        {"warnings", mCommon.console.warnings()}});
}

void RenderCommand::renderLevelsImage(const Tracer& tracer, const IrradianceVolume& volume)
{
    const Image image = renderLevels(tracer, volume, sliceOptions(volume));
    throwIfInterrupted();
    writeDisplayImage(image, mOutput);
    mCommon.writeJson({{"file", mOutput}, {"width", image.width}, {"height", image.height},
        {"cells_by_level", volume.cellsByLevel()}, {"warnings", mCommon.console.warnings()}});
}

void RenderCommand::renderErrorImage(
    const Tracer& tracer, const IrradianceVolume& volume, ProgressBar& progress)
{
    mError.slice = sliceOptions(volume);
    mError.slice.mode = modeFor(mMode, volume, mVolume);
    followBake(volume.metadata(), mError.reference);
    ErrorMapReport report;
    const Image image = renderError(tracer, volume, mError, &report, &progress);
    progress.finish();
    throwIfInterrupted();
    writeDisplayImage(image, mOutput);
    const auto percent = [](double x) { return rounded(100 * x, 3) + "%"; };
    mCommon.console.note("Mean error " + percent(report.meanError) + " of the slice's mean "
        + "irradiance; colours span " + percent(report.low) + " to " + percent(report.high)
        + "; the reference has a noise of " + percent(report.meanNoise)
        + " itself, less with more --rays.");
    mCommon.writeJson({{"file", mOutput}, {"width", image.width}, {"height", image.height},
        {"mode", name(mError.slice.mode)}, {"mean_error", report.meanError},
        {"reference_stderr", report.meanNoise}, {"mean_irradiance", report.meanReference},
        {"low", report.low}, {"high", report.high}, {"points", report.points},
        {"warnings", mCommon.console.warnings()}});
}

/// The slices that need the scene beside the volume.
void RenderCommand::renderOverScene(const IrradianceVolume& volume)
{
    std::optional<IrradianceVolume> turned = broughtYUp(volume);
    const IrradianceVolume& yUp = turned ? *turned : volume;
    sliceOptions(yUp); // refuses before the scene is read
    mScene.lightGroup = yUp.metadata().lightGroup;
    const auto scene = loadScene(yUp);
    ProgressBar progress(mCommon.console.progressStyle());
    const Tracer tracer(scene, &progress);
    throwIfInterrupted();
    if (mShow == Show::Levels) {
        renderLevelsImage(tracer, yUp);
    } else {
        renderErrorImage(tracer, yUp, progress);
    }
}

void RenderCommand::run(const Arguments& arguments)
{
    validate(arguments);
    checkReplaceable(mOutput, "-o");
    checkIsNoneOf(mOutput, "-o", {mScene.path, mVolume});
    mCommon.apply({mScene.path, mVolume, mOutput});
    const IrradianceVolume volume = loadVolume(mVolume);
    throwIfInterrupted();
    if (mShow == Show::Levels || mShow == Show::Error) {
        renderOverScene(volume);
    } else if (mSlice) {
        renderSliceImage(volume);
    } else {
        renderScene(volume);
    }
}

} // namespace

std::unique_ptr<Command> makeRenderCommand() { return std::make_unique<RenderCommand>(); }

} // namespace lumivdb::cli
