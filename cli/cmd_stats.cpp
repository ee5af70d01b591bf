// SPDX-License-Identifier: Apache-2.0
/// lumivdb stats: what is in a volume file.

#include "common.h"
#include "numbers.h"
#include "output.h"

#include <lumivdb/vdb_io/statistics.h>

#include <nlohmann/json.hpp>

#include <algorithm>

namespace lumivdb::cli {

namespace {

class StatsCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    CommonOptions mCommon;
    std::string mVolume;
};

Json channelsJson(const VolumeStatistics& s)
{
    Json list = Json::array();
    for (const ChannelStatistics& c : s.channels) {
        list.push_back(
            {{"name", c.name}, {"type", c.type}, {"min", c.min}, {"max", c.max}, {"mean", c.mean},
                {"nan", c.nan}, {"active_voxels", c.activeVoxels}, {"tiles", c.tiles}});
    }
    return list;
}

Json errorJson(const VolumeMetadata& m)
{
    const bool measured = m.errorReached >= 0;
    Json json;
    json["asked"] = m.errorAsked > 0 ? Json(m.errorAsked) : Json();
    json["reached"] = measured ? Json(m.errorReached) : Json();
    json["confidence"] = measured ? Json(m.errorConfidence) : Json();
    return json;
}

void addMetadata(Json& json, const VolumeMetadata& m)
{
    json["error"] = errorJson(m);
    json["options"] = m.options;
    json["scene_hash"] = m.sceneHash;
    json["contribution"] = m.contribution;
    json["light_group"] = m.lightGroup;
    json["up_axis"] = m.upAxis;
    json["seed"] = m.seed;
    json["rays_per_sample"] = m.raysPerSample;
    json["integrator"] = m.integrator;
    json["cache_bias"]
        = m.cacheBias >= 0 ? Json({{"rms", m.cacheBias}, {"upper", m.cacheBiasUpper}}) : Json();
}

Json statisticsJson(const VolumeStatistics& s)
{
    Json json;
    json["format_version"] = s.formatVersion;
    json["bands"] = s.bands;
    json["gradients"] = s.gradients;
    json["samples"] = s.samples;
    json["cells_by_level"] = s.cellsByLevel;
    json["leaf_nodes"] = s.leafNodes;
    json["tiles_by_size"] = Json::object();
    for (const auto& [edge, count] : s.tilesBySize) {
        json["tiles_by_size"][std::to_string(edge)] = count;
    }
    json["spacing"] = s.spacing;
    json["bounds"] = jsonOf(s.bounds);
    json["file_bytes"] = s.fileBytes;
    json["runtime_bytes"] = s.runtimeBytes;
    json["bytes_per_sample"] = s.bytesPerSample;
    json["uniform_equivalent_samples"] = s.uniformEquivalentSamples;
    json["channels"] = channelsJson(s);
    json["band_energy"] = s.bandEnergy;
    json["invalid_fraction"] = s.invalidFraction;
    json["cut_cells"] = s.cutCells;
    json["moved_samples"] = s.movedSamples;
    json["negative_irradiance_fraction"] = s.negativeIrradianceFraction;
    json["gradient"] = {{"p50", s.gradientP50}, {"p95", s.gradientP95}, {"max", s.gradientMax}};
    addMetadata(json, s.metadata);
    json["half"] = s.half;
    json["irradiance_histogram"] = {{"log10_min", s.irradianceLog10Min},
        {"log10_max", s.irradianceLog10Max}, {"counts", s.irradianceHistogram}};
    return json;
}

std::string percent(double fraction) { return rounded(100 * fraction, 3) + "%"; }

std::string listOf(const std::vector<std::uint64_t>& counts)
{
    std::string out;
    for (const std::uint64_t count : counts) out += (out.empty() ? "" : ", ") + grouped(count);
    return out;
}

std::string tilesText(const VolumeStatistics& s)
{
    std::string out = grouped(s.leafNodes) + " leaf nodes";
    for (const auto& [edge, count] : s.tilesBySize) {
        out += ", " + grouped(count) + " tiles of " + std::to_string(edge) + "^3";
    }
    return out;
}

std::string boundsText(const Box3d& box)
{
    const auto point = [](const Vec3d& p) {
        return "(" + rounded(p.x, 6) + ", " + rounded(p.y, 6) + ", " + rounded(p.z, 6) + ")";
    };
    return point(box.min) + " to " + point(box.max);
}

std::string contentsTable(const VolumeStatistics& s)
{
    const VolumeMetadata& m = s.metadata;
    return table({{"format version", std::to_string(s.formatVersion)},
        {"bands", std::to_string(s.bands)}, {"gradients", s.gradients ? "yes" : "no"},
        {"samples", grouped(s.samples)}, {"  without valid light", percent(s.invalidFraction)},
        {"  with negative irradiance", percent(s.negativeIrradianceFraction)},
        {"  moved off surfaces", grouped(s.movedSamples)},
        {"cells by level", listOf(s.cellsByLevel)}, {"  cut by walls", grouped(s.cutCells)},
        {"index tree", tilesText(s)}, {"spacing", rounded(s.spacing, 6)},
        {"bounds", boundsText(s.bounds)}, {"up axis", m.upAxis},
        {"file",
            humanBytes(s.fileBytes) + (s.half ? ", 16-bit" : ", 32-bit") + ", "
                + rounded(s.bytesPerSample) + " bytes a sample"},
        {"in memory", humanBytes(s.runtimeBytes)},
        {"uniform equivalent", grouped(s.uniformEquivalentSamples) + " samples"}});
}

std::string integratorText(const VolumeMetadata& m)
{
    if (m.integrator.empty()) return "path and cached";
    if (m.cacheBias < 0) return m.integrator;
    return m.integrator + ", bias " + percent(m.cacheBias) + ", at most "
        + percent(m.cacheBiasUpper);
}

std::string originTable(const VolumeStatistics& s)
{
    const VolumeMetadata& m = s.metadata;
    const auto orNone = [](const std::string& text) { return text.empty() ? "-" : text; };
    return table({{"contribution", m.contribution},
        {"light group", m.lightGroup.empty() ? "all" : m.lightGroup},
        {"integrator", integratorText(m)}, {"rays a sample", grouped(m.raysPerSample)},
        {"seed", std::to_string(m.seed)},
        {"error asked", m.errorAsked > 0 ? percent(m.errorAsked) : "-"},
        {"error measured",
            m.errorReached >= 0
                ? percent(m.errorReached) + ", confidence " + percent(m.errorConfidence)
                : "-"},
        {"scene hash", orNone(m.sceneHash)}, {"made by", orNone(m.options)},
        {"gradient of mean E",
            "p50 " + rounded(s.gradientP50) + ", p95 " + rounded(s.gradientP95) + ", max "
                + rounded(s.gradientMax) + " per world unit"}});
}

std::string padded(std::string text, std::size_t width, bool right)
{
    const std::string blanks(width > text.size() ? width - text.size() : 0, ' ');
    return right ? blanks + text : text + blanks;
}

std::string channelsTable(const VolumeStatistics& s)
{
    std::string out;
    const auto row = [&out](const std::vector<std::string>& fields) {
        static constexpr std::size_t kWidths[] = {14, 7, 11, 11, 11, 7, 12, 9};
        for (std::size_t i = 0; i < fields.size(); ++i) {
            out += padded(fields[i], kWidths[i], i >= 2) + (i + 1 < fields.size() ? " " : "\n");
        }
    };
    row({"channel", "type", "min", "max", "mean", "nan", "voxels", "tiles"});
    for (const ChannelStatistics& c : s.channels) {
        row({c.name, c.type, rounded(c.min), rounded(c.max), rounded(c.mean), grouped(c.nan),
            grouped(c.activeVoxels), grouped(c.tiles)});
    }
    return out;
}

std::string bar(double share)
{
    constexpr double kWidth = 50;
    const auto filled = static_cast<std::size_t>(std::clamp(share, 0.0, 1.0) * kWidth + 0.5);
    return std::string(share > 0 ? std::max<std::size_t>(filled, 1) : 0, '#');
}

std::string bandHistogram(const VolumeStatistics& s)
{
    double sum = 0;
    for (const double energy : s.bandEnergy) sum += energy;
    std::string out = "energy by degree (mean of the squared radiance coefficients):\n";
    for (std::size_t l = 0; l < s.bandEnergy.size(); ++l) {
        const double share = sum > 0 ? s.bandEnergy[l] / sum : 0;
        out += padded("l = " + std::to_string(l), 8, true)
            + padded(rounded(s.bandEnergy[l], 3), 12, true) + padded(percent(share), 10, true)
            + "  " + bar(share) + "\n";
    }
    return out;
}

std::string irradianceHistogram(const VolumeStatistics& s)
{
    const auto& counts = s.irradianceHistogram;
    const std::uint64_t largest
        = counts.empty() ? 0 : *std::max_element(counts.begin(), counts.end());
    if (largest == 0) return "";
    std::string out = "samples by log10 of E averaged over normals:\n";
    const double step
        = (s.irradianceLog10Max - s.irradianceLog10Min) / static_cast<double>(counts.size());
    for (std::size_t i = 0; i < counts.size(); ++i) {
        char low[32];
        std::snprintf(
            low, sizeof low, "%8.2f", s.irradianceLog10Min + step * static_cast<double>(i));
        const double share = static_cast<double>(counts[i]) / static_cast<double>(largest);
        const std::string drawn = bar(share);
        out += low + padded(grouped(counts[i]), 12, true) + (drawn.empty() ? "" : "  " + drawn)
            + "\n";
    }
    return out;
}

void StatsCommand::declare(Arguments& arguments)
{
    arguments.positional("VOLUME.vdb", mVolume, "the volume");
    arguments.require();
    arguments.describe("Prints a table: samples, cells, sizes, where it came from, every channel, "
                       "and histograms of energy and light. With --json the same as JSON instead.");
    mCommon.declareJson(arguments, "the same as JSON");
    mCommon.declareQuiet(arguments);
    arguments.example("lumivdb stats room.vdb", "a table to read");
    arguments.example("lumivdb stats room.vdb --json - | jq .samples", "one number for a script");
}

void StatsCommand::run(const Arguments&)
{
    mCommon.apply({mVolume});
    const VolumeStatistics statistics = computeStatistics(mVolume);
    if (!mCommon.json.empty()) {
        mCommon.writeJson(statisticsJson(statistics));
        return;
    }
    writeStdout(mVolume + "\n\n" + contentsTable(statistics) + "\n" + originTable(statistics) + "\n"
        + channelsTable(statistics) + "\n" + bandHistogram(statistics) + "\n"
        + irradianceHistogram(statistics));
}

} // namespace

std::unique_ptr<Command> makeStatsCommand() { return std::make_unique<StatsCommand>(); }

} // namespace lumivdb::cli
