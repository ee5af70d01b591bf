// SPDX-License-Identifier: Apache-2.0
/// lumivdb resample: volumes from volumes.

#include "common.h"
#include "interrupt.h"
#include "numbers.h"
#include "output.h"
#include "volume_output.h"

#include <lumivdb/vdb_io/resample.h>

#include <Imath/half.h>
#include <nlohmann/json.hpp>

#include <cmath>

namespace lumivdb::cli {

namespace {

constexpr std::size_t kComparePoints = 10000;

/// A scenario or light group and its factor: FILE=W.
struct Term {
    std::string file;
    double factor;
};

class ResampleCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    void declareInputs(Arguments& arguments);
    void declareRecords(Arguments& arguments);
    void declarePlace(Arguments& arguments);
    void validate(const Arguments& arguments);
    IrradianceVolume loadInput() const;
    IrradianceVolume loadSum() const;
    IrradianceVolume loadJoin() const;
    IrradianceVolume reshape(const IrradianceVolume& input, Progress& progress);
    IrradianceVolume place(IrradianceVolume volume) const;
    double measureError(const IrradianceVolume& input, const IrradianceVolume& result) const;
    void report(const IrradianceVolume& input, const IrradianceVolume& result, double error) const;

    CommonOptions mCommon;
    VolumeOutput mOutput;
    std::vector<std::string> mInputs;
    std::vector<Term> mTerms;
    std::optional<double> mSpacing;
    bool mUniform = false;
    std::optional<Interpolation> mMode;
    std::optional<Box3d> mCrop;
    int mBands = 0; // 0: as they are
    bool mDropGradients = false;
    int mLevels = 0;
    double mTolerance = 0;
    double mScale = 1;
    std::optional<Mat4d> mTransform;
    std::string mUpAxis; // empty: as it is
};

void ResampleCommand::declareInputs(Arguments& arguments)
{
    arguments.positionals("IN.vdb", mInputs,
        "the volume; several are joined: bakes of neighbouring boxes with one spacing");
    const auto term = [this](const std::string& value) {
        const std::size_t at = value.rfind('=');
        const auto factor
            = at == std::string::npos ? std::nullopt : parseReal(value.substr(at + 1));
        if (!factor || at == 0) failValue("--add", value, "not FILE=W with a finite number W");
        mTerms.push_back({value.substr(0, at), *factor});
    };
    arguments.repeated("--add", "FILE=W", term,
        "adds W times this volume, may be repeated: sums of light groups or scenarios baked over "
        "one lattice; "
        "IN.vdb "
        "counts once, if given");
}

void ResampleCommand::declareRecords(Arguments& arguments)
{
    arguments.section("Samples");
    arguments.real("--spacing", mSpacing, greaterThan(0),
        "new distance between samples, scene units", "as it is");
    arguments.flag(
        "--uniform", mUniform, "one level of cells, of --spacing or the finest there is");
    arguments.integer("--levels", mLevels, between(0, kMaxLevel),
        "merges eight cells into one where nothing is lost, up to this many times; cells cut by "
        "walls stay");
    arguments.real("--tolerance", mTolerance, between(0, 1e30),
        "what --levels may lose at a sample: RMS of irradiance over normals, relative to the "
        "volume's mean irradiance");
    declareMode(arguments, mMode, "trilinear");
    arguments.box("--crop", mCrop, "keeps the cells in this box, in the input's axes");
    const auto bands = [this](const std::string& value) {
        const auto number = parseInteger(value);
        if (!number || *number < 1 || *number > kMaxBands) {
            failValue("--bands", value, "not an integer from 1 to 6");
        }
        mBands = static_cast<int>(*number);
    };
    arguments.custom("--bands", "N", bands,
        "SH bands to keep; more than there are: zeros [1 to 6; default: as they are]");
    const auto gradients = [this](const std::string& value) {
        if (value != "none") failValue("--gradients", value, "only none: they can be dropped");
        mDropGradients = true;
    };
    arguments.custom("--gradients", "none", gradients, "drops the gradient channels");
    arguments.real("--scale", mScale, between(-1e30, 1e30), "factor on the light");
}

void ResampleCommand::declarePlace(Arguments& arguments)
{
    arguments.section("Place (after all other steps)");
    const auto transform = [this](const std::string& value) {
        const auto v = parseReals(value);
        if (!v || (v->size() != 3 && v->size() != 16)) {
            failValue("--transform", value,
                "not 3 (a translation) or 16 finite numbers (a matrix) with commas between");
        }
        Mat4d m;
        if (v->size() == 3) m.setTranslation(Vec3d((*v)[0], (*v)[1], (*v)[2]));
        for (std::size_t i = 0; v->size() == 16 && i < 16; ++i) m[i / 4][i % 4] = (*v)[i];
        mTransform = m;
    };
    arguments.custom("--transform", "M", transform,
        "moves the volume: a translation tx,ty,tz, or 16 numbers, row by row, for row vectors "
        "(p' = p M; translation last): rotation, uniform scale, translation");
    const auto up = [this](const std::string& value) {
        if (value != "y" && value != "z") failValue("--up", value, "not one of y|z");
        mUpAxis = value;
    };
    arguments.custom("--up", "y|z", up,
        "turns grid and coefficients to this up axis, after --transform [default: as it is]");
}

void ResampleCommand::declare(Arguments& arguments)
{
    declareInputs(arguments);
    arguments.describe(
        "Steps in this order: join or add, crop, spacing, bands, gradients, "
        "levels, scale, transform, up axis. Prints how far the result is from the input: relative "
        "RMS of irradiance over random points and normals, before it is scaled and "
        "moved, after rounding to 16 bits.");
    declareRecords(arguments);
    declarePlace(arguments);
    mOutput.declare(arguments);
    arguments.section("General");
    mCommon.declareThreads(arguments);
    mCommon.declareJson(arguments, "samples, spacing, bands, error, file size, warnings");
    mCommon.declareQuiet(arguments);
    arguments.example("lumivdb resample room.vdb --bands 3 --half --up z -o blender.vdb",
        "a smaller file, turned for a Z-up program");
    arguments.example("lumivdb resample --add day.vdb=1.0 --add lamps.vdb=0.2 -o evening.vdb",
        "a scenario as a sum of bakes");
    arguments.example(
        "lumivdb resample left.vdb right.vdb -o both.vdb", "bakes of two boxes joined");
}

void ResampleCommand::validate(const Arguments& arguments)
{
    if (mInputs.empty() && mTerms.empty()) {
        failUsage("IN.vdb is missing; give a volume, or --add FILE=W.");
    }
    if (mInputs.size() > 1 && !mTerms.empty()) {
        failUsage("--add goes with one IN.vdb at most; join the others first.");
    }
    if (arguments.given("--tolerance") && mLevels == 0) {
        failUsage("--tolerance has no effect without --levels; give how many levels to merge.");
    }
    if (arguments.given("--mode") && !mSpacing && !mUniform) {
        failUsage("--mode has no effect without --spacing or --uniform; give one of them.");
    }
}

/// Reads all of @a files and hands them to @a combine; what that says of "input 1" gets names.
template <class Combine>
IrradianceVolume combined(const std::vector<std::string>& files, const Combine& combine)
{
    std::vector<IrradianceVolume> volumes;
    std::vector<const IrradianceVolume*> pointers;
    std::string named;
    for (const std::string& file : files) {
        throwIfInterrupted();
        named
            += (named.empty() ? "" : ", ") + std::to_string(volumes.size()) + " is '" + file + "'";
        volumes.push_back(loadVolume(file));
    }
    for (const IrradianceVolume& volume : volumes) pointers.push_back(&volume);
    try {
        return combine(pointers);
    } catch (const Error& e) {
        std::string sentence = e.what();
        while (!sentence.empty() && sentence.back() == '.') sentence.pop_back();
        throw Error(e.code(), sentence + " (input " + named + ").");
    }
}

IrradianceVolume ResampleCommand::loadSum() const
{
    std::vector<std::string> files = mInputs;
    std::vector<double> factors(files.size(), 1.0);
    for (const Term& term : mTerms) {
        files.push_back(term.file);
        factors.push_back(term.factor);
    }
    return combined(files, [&](const auto& volumes) { return addVolumes(volumes, factors); });
}

IrradianceVolume ResampleCommand::loadJoin() const
{
    return combined(mInputs, [](const auto& volumes) { return joinVolumes(volumes); });
}

IrradianceVolume ResampleCommand::loadInput() const
{
    if (!mTerms.empty()) return loadSum();
    return mInputs.size() == 1 ? loadVolume(mInputs.front()) : loadJoin();
}

/// Crop, spacing, bands, gradients, levels.
IrradianceVolume ResampleCommand::reshape(const IrradianceVolume& input, Progress& progress)
{
    IrradianceVolume volume = mCrop ? cropVolume(input, *mCrop) : input.clone();
    const double spacing = mSpacing.value_or(volume.spacing());
    const bool isUniform = volume.cellsByLevel().size() == 1;
    if (spacing != volume.spacing() || (mUniform && !isUniform)) {
        const std::string named = mInputs.empty() ? "the sum" : mInputs.front();
        const Interpolation mode = modeFor(mMode.value_or(Interpolation::Trilinear), volume, named);
        if (volume.hasGradients() && !mDropGradients) {
            mCommon.console.warn("Gradients cannot be resampled: the result has none.");
        }
        volume = resampleUniform(volume, spacing, mode, &progress);
    }
    if (mBands > 0 && mBands != volume.bands()) volume = withBands(volume, mBands);
    if (mDropGradients && volume.hasGradients()) volume = withoutGradients(volume);
    if (mLevels > 0) volume = coarsenVolume(volume, mLevels, mTolerance);
    return volume;
}

/// Scale, transform, up axis.
IrradianceVolume ResampleCommand::place(IrradianceVolume volume) const
{
    if (mScale != 1) scaleVolume(volume, mScale);
    if (mTransform) volume = transformVolume(volume, *mTransform);
    const std::string from = volume.metadata().upAxis;
    if (!mUpAxis.empty() && mUpAxis != from) {
        volume = transformVolume(volume, upAxisRotation(from, mUpAxis));
        volume.metadata().upAxis = mUpAxis;
    }
    return volume;
}

void roundToHalf(IrradianceVolume& volume)
{
    const auto coefficients = static_cast<std::size_t>(volume.coefficients());
    for (std::size_t s = 0; s < volume.sampleCount(); ++s) {
        Color* radiance = volume.radiance(static_cast<SampleId>(s));
        for (std::size_t i = 0; i < coefficients; ++i) {
            for (int channel = 0; channel < 3; ++channel) {
                radiance[i][channel] = Imath::half(radiance[i][channel]);
            }
        }
    }
}

double ResampleCommand::measureError(
    const IrradianceVolume& input, const IrradianceVolume& result) const
{
    if (!mOutput.options.half) return compareVolumes(input, result, kComparePoints, 1);
    IrradianceVolume stored = result.clone();
    // It is the scaled light that is rounded: by a small factor, digits or all of it are lost.
    if (mScale != 0) scaleVolume(stored, mScale);
    roundToHalf(stored);
    if (mScale != 0) scaleVolume(stored, 1 / mScale);
    return compareVolumes(input, stored, kComparePoints, 1);
}

void ResampleCommand::report(
    const IrradianceVolume& input, const IrradianceVolume& result, double error) const
{
    const std::uint64_t bytes = fileBytes(mOutput.path);
    mCommon.console.note("'" + mOutput.path + "': " + grouped(result.sampleCount()) + " samples "
        + rounded(result.spacing()) + " apart (input " + grouped(input.sampleCount()) + " and "
        + rounded(input.spacing()) + "), " + std::to_string(result.bands()) + " bands, "
        + humanBytes(bytes) + "; error against the input " + rounded(100 * error, 3) + "%.");
    Json json;
    json["samples"] = result.sampleCount();
    json["cells_by_level"] = result.cellsByLevel();
    json["spacing"] = result.spacing();
    json["bands"] = result.bands();
    json["gradients"] = result.hasGradients();
    json["bounds"] = jsonOf(result.worldBounds());
    json["error"] = {{"rel_rmse", error}, {"points", kComparePoints}};
    json["file"] = mOutput.path;
    json["file_bytes"] = bytes;
    json["warnings"] = mCommon.console.warnings();
    mCommon.writeJson(json);
}

void ResampleCommand::run(const Arguments& arguments)
{
    validate(arguments);
    mOutput.check();
    mCommon.apply({mOutput.path});
    const IrradianceVolume input = loadInput();
    throwIfInterrupted();
    ProgressBar progress(mCommon.console.progressStyle());
    IrradianceVolume shaped = reshape(input, progress);
    throwIfInterrupted();
    const double error = measureError(input, shaped);
    IrradianceVolume result = place(std::move(shaped));
    std::string& options = result.metadata().options;
    options += (options.empty() ? "" : " | ") + arguments.commandLine();
    mOutput.write(result, progress);
    progress.finish();
    report(input, result, error);
}

} // namespace

std::unique_ptr<Command> makeResampleCommand() { return std::make_unique<ResampleCommand>(); }

} // namespace lumivdb::cli
