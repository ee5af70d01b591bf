// SPDX-License-Identifier: Apache-2.0
#include "common.h"

#include "numbers.h"
#include "output.h"

#include <lumivdb/vdb_io/resample.h>

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cstdio>

namespace lumivdb::cli {

void Console::note(const std::string& sentence) const
{
    if (!mQuiet) std::fprintf(stderr, "%s\n", sentence.c_str());
}

void Console::warn(const std::string& sentence)
{
    if (std::find(mWarnings.begin(), mWarnings.end(), sentence) != mWarnings.end()) return;
    mWarnings.push_back(sentence);
    note("warning: " + sentence);
}

void Console::warn(const std::vector<std::string>& sentences)
{
    for (const std::string& sentence : sentences) warn(sentence);
}

ProgressStyle Console::progressStyle() const
{
    return mQuiet ? ProgressStyle::Silent : progressStyleOfStderr();
}

void CommonOptions::declareThreads(Arguments& arguments)
{
    arguments.integer("--threads", threads, between(0, 1024),
        "threads to use; 0: all cores. Results do not depend on it");
    arguments.neutral();
}

void CommonOptions::declareJson(Arguments& arguments, const std::string& help)
{
    arguments.text("--json", "FILE|-", json, help + "; - is standard output");
    arguments.neutral();
}

void CommonOptions::declareQuiet(Arguments& arguments)
{
    arguments.flag("--quiet", mQuiet,
        "no progress, warnings or summary on stderr, errors only; warnings stay in reports");
    arguments.neutral();
}

void CommonOptions::apply(const std::vector<std::string>& files)
{
    console.setQuiet(mQuiet);
    if (!json.empty()) checkWritable(json, "--json");
    checkIsNoneOf(json, "--json", files);
    if (threads > 0) {
        mLimit = std::make_unique<tbb::global_control>(
            tbb::global_control::max_allowed_parallelism, static_cast<std::size_t>(threads));
    }
}

void CommonOptions::writeJson(const Json& report) const
{
    if (!json.empty()) writeText(json, jsonText(report));
}

double Stopwatch::seconds() const
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - mStart).count();
}

double Stopwatch::restart()
{
    const double passed = seconds();
    mStart = std::chrono::steady_clock::now();
    return passed;
}

void declareMode(
    Arguments& arguments, std::optional<Interpolation>& mode, const std::string& whenAbsent)
{
    static const std::vector<std::pair<std::string, Interpolation>> kModes
        = {{"nearest", Interpolation::Nearest}, {"taylor", Interpolation::Taylor},
            {"trilinear", Interpolation::Trilinear}, {"gradient", Interpolation::Gradient},
            {"tricubic", Interpolation::Tricubic}, {"idw", Interpolation::InverseDistance}};
    const std::string names = "--mode";
    const auto convert = [&mode, names](const std::string& given) {
        for (const auto& [word, value] : kModes) {
            if (word == given) mode = value;
        }
        if (!mode) {
            failValue(names, given, "not one of nearest|taylor|trilinear|gradient|tricubic|idw");
        }
    };
    arguments.custom(names, "MODE", convert,
        "interpolation: nearest, taylor, trilinear, gradient, tricubic or idw (inverse distance); "
        "taylor, gradient and tricubic need a volume with gradients [default: "
            + whenAbsent + "]");
}

Interpolation modeFor(const std::optional<Interpolation>& mode, const IrradianceVolume& volume,
    const std::string& path)
{
    if (!mode) return VolumeSampler::bestMode(volume);
    if (needsGradients(*mode) && !volume.hasGradients()) {
        failUsage(std::string("--mode ") + name(*mode) + ": '" + path
            + "' has no gradients; use trilinear, or bake with --gradients central.");
    }
    return *mode;
}

Json jsonOf(const Vec3d& v) { return Json::array({v.x, v.y, v.z}); }

Json jsonOf(const Box3d& box)
{
    if (box.isEmpty()) return nullptr;
    return Json::array({box.min.x, box.min.y, box.min.z, box.max.x, box.max.y, box.max.z});
}

Json jsonOf(const Color& c)
{
    return Json::array({jsonNumber(c.x), jsonNumber(c.y), jsonNumber(c.z)});
}

std::string jsonText(const Json& json)
{
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string table(const std::vector<std::pair<std::string, std::string>>& rows)
{
    std::size_t width = 0;
    for (const auto& row : rows) width = std::max(width, row.first.size());
    std::string out;
    for (const auto& [name, value] : rows) {
        out += name + std::string(width + 2 - name.size(), ' ') + value + "\n";
    }
    return out;
}

std::optional<IrradianceVolume> broughtYUp(const IrradianceVolume& volume)
{
    if (volume.metadata().upAxis == "y") return std::nullopt;
    IrradianceVolume turned
        = transformVolume(volume, upAxisRotation(volume.metadata().upAxis, "y"));
    turned.metadata().upAxis = "y";
    return turned;
}

} // namespace lumivdb::cli
