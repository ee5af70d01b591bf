// SPDX-License-Identifier: Apache-2.0
/// lumivdb render: a picture of a scene lit by a volume, or a slice through the volume.

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

namespace lumivdb::cli {

namespace {

struct SliceRequest {
    int axis;
    double position;
};

class RenderCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    void declareView(Arguments& arguments);
    void declareSlice(Arguments& arguments);
    void validate(const Arguments& arguments) const;
    void renderScene(const IrradianceVolume& volume);
    void renderSliceImage(const IrradianceVolume& volume);

    CommonOptions mCommon;
    SceneOptions mScene;
    PictureOptions mPicture;
    std::string mVolume;
    std::string mOutput;
    std::optional<Interpolation> mMode;
    std::optional<double> mExposure;
    std::optional<double> mFov;
    std::optional<SliceRequest> mSlice;
};

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
        "the volume's axes, as false colours over its logarithm; the range is printed");
}

void RenderCommand::declare(Arguments& arguments)
{
    mScene.declarePositional(arguments);
    arguments.text("--volume", "VOLUME.vdb", mVolume, "the volume that lights it");
    arguments.require();
    arguments.text("-o,--output", "OUT.png|exr", mOutput,
        "the image: .png (sRGB, exposed) or .exr (linear, as is)");
    arguments.require();
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
}

void RenderCommand::validate(const Arguments& arguments) const
{
    mScene.validate(arguments);
    if (mPicture.eye.has_value() != mPicture.target.has_value()) {
        failUsage("--eye and --target make one view; give both or none.");
    }
    if (mPicture.eye && *mPicture.eye == *mPicture.target) {
        failUsage("--eye and --target are the same point; move one.");
    }
    checkImagePath(mOutput);
}

void RenderCommand::renderScene(const IrradianceVolume& volume)
{
    const auto scene = mScene.load(mCommon.console);
    std::optional<IrradianceVolume> turned = broughtYUp(volume);
    const IrradianceVolume& yUp = turned ? *turned : volume;
    if (yUp.metadata().lightGroup.empty()) {
        warnIfSceneDiffers(yUp, mVolume, *scene, mCommon.console);
    }
    ProgressBar progress(mCommon.console.progressStyle());
    const Tracer tracer(scene, &progress);
    throwIfInterrupted();
    if (mFov) mPicture.yfovDegrees = *mFov;
    mPicture.mode = modeFor(mMode, volume, mVolume);
    const Image image = renderPicture(tracer, yUp, mPicture, &progress);
    progress.finish();
    throwIfInterrupted();
    writeImage(image, mOutput, mExposure.value_or(std::numeric_limits<double>::quiet_NaN()));
    mCommon.writeJson({{"file", mOutput}, {"width", image.width}, {"height", image.height},
        {"mode", name(mPicture.mode)}, {"warnings", mCommon.console.warnings()}});
}

void RenderCommand::renderSliceImage(const IrradianceVolume& volume)
{
    SliceOptions options;
    options.axis = mSlice->axis;
    options.position = mSlice->position;
    options.width = mPicture.width;
    options.mode = modeFor(mMode, volume, mVolume);
    const Box3d box = volume.worldBounds();
    if (options.position < box.min[options.axis] || options.position > box.max[options.axis]) {
        failValue("--slice", std::string(1, "xyz"[options.axis]) + "=" + toText(options.position),
            "outside '" + mVolume + "', which spans " + rounded(box.min[options.axis]) + " to "
                + rounded(box.max[options.axis]));
    }
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

void RenderCommand::run(const Arguments& arguments)
{
    validate(arguments);
    checkReplaceable(mOutput, "-o");
    checkIsNoneOf(mOutput, "-o", {mScene.path, mVolume});
    mCommon.apply({mScene.path, mVolume, mOutput});
    const IrradianceVolume volume = loadVolume(mVolume);
    throwIfInterrupted();
    if (mSlice) {
        renderSliceImage(volume);
    } else {
        renderScene(volume);
    }
}

} // namespace

std::unique_ptr<Command> makeRenderCommand() { return std::make_unique<RenderCommand>(); }

} // namespace lumivdb::cli
