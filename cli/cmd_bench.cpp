// SPDX-License-Identifier: Apache-2.0
/// lumivdb bench: speed against error, over scenes and everything a bake can choose.

#include "bench_study.h"
#include "common.h"
#include "gnuplot.h"
#include "interrupt.h"
#include "numbers.h"
#include "output.h"

#include <lumivdb/bake/environment.h>

#include <nlohmann/json.hpp>

#include <algorithm>
#include <cmath>
#include <filesystem>

namespace lumivdb::cli {

namespace {

namespace fs = std::filesystem;

/// The scenes that come with the program, and the light they are meant for.
struct Sample {
    const char* file;
    bool underSky;
    bool quick; ///< part of --quick
};
constexpr Sample kSamples[] = {{"cornell_box.glb", false, true},
    {"two_rooms_door.glb", false, true}, {"two_rooms.glb", false, false}, {"house.glb", true, true},
    {"courtyard.glb", true, false}, {"furnace.glb", false, false}};

struct BenchScene {
    std::string path, environment;
    std::string label() const { return fs::path(path).stem().string(); }
};

class BenchCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    /// Tells the total of all scenes; volumes and references only ask whether to stop.
    class Inner : public Progress {
    public:
        bool cancelled() override { return interrupted(); }
    };

    std::vector<BenchScene> scenes() const;
    std::shared_ptr<const Scene> load(const BenchScene& scene);
    void measureScene(const BenchScene& scene, std::vector<BenchRow>& rows);
    BakeOptions bakeOptions(const BenchConfiguration& c) const;
    /// As the row's configuration says; fills in the rays and the stages' seconds it took.
    IrradianceVolume makeVolume(const Tracer& tracer, BenchRow& row, Progress& progress) const;
    void printTable(const std::vector<BenchRow>& rows) const;
    Json report(const std::vector<BenchRow>& rows) const;
    void drawPlot(const std::vector<BenchRow>& rows) const;

    CommonOptions mCommon;
    std::vector<std::string> mScenes;
    std::string mEnvironment, mSamples, mPlot;
    std::optional<double> mSpacing;
    bool mQuick = false;
    Contribution mContribution = Contribution::All;
    int mRays = 1024, mReferenceRays = 4096;
    std::size_t mPoints = 500;
    std::uint64_t mSeed = 7001;
};

void BenchCommand::declare(Arguments& arguments)
{
    arguments.describe(
        "Bakes each scene with uniform and adaptive cells, different spacings, bands, gradients "
        "and thresholds, by path tracing and with a radiance cache, and by light propagation (lpv; "
        "lpv-many: with many reflections; lpv-open: "
        "without occlusion), queries the volumes with every interpolation, and compares them with "
        "an "
        "independent trace at random points. bake_seconds and query_ns are this machine's, the "
        "former with their shares in percent: solving the cache, tracing, refining, verifying (the "
        "cache's bias); bytes are "
        "those of what answers queries, in memory; rel_rmse and p99 are those of 'lumivdb "
        "evaluate'. Rows that no other row of "
        "the scene beats are marked: s by bake seconds, b by bytes.");
    arguments.section("Scenes");
    arguments.repeated(
        "--scene", "FILE", [this](const std::string& value) { mScenes.push_back(value); },
        "a scene to measure, may be given more than once [default: the samples]");
    arguments.text("--env", "FILE", mEnvironment, "the environment of every --scene");
    arguments.text("--samples", "DIR", mSamples,
        "the folder of the sample scenes [default: found beside the program]");
    arguments.section("Measure");
    arguments.flag("--quick", mQuick,
        "fewer scenes and configurations, 256 rays a sample, 150 points, 1024 rays a point, unless "
        "given");
    arguments.real("--spacing", mSpacing, greaterThan(0),
        "finest distance between samples, scene units; also twice and four times of it are "
        "measured",
        "from each scene");
    arguments.integer("--rays", mRays, between(2, 67108864), "directions per sample of a volume");
    arguments.size("--points", mPoints, between(1, 1e7), "random points of free space");
    arguments.integer("--reference-rays", mReferenceRays, between(2, 67108864),
        "directions per point of the reference");
    arguments.choice<Contribution>("--contribution", mContribution,
        {{"all", Contribution::All}, {"direct", Contribution::Direct},
            {"indirect", Contribution::Indirect}},
        "which light volumes and reference have; light propagation adds traced direct light for "
        "all, and is left out for direct");
    arguments.seed("--seed", mSeed, "random numbers of points and reference");
    arguments.section("General");
    arguments.text("--plot", "FILE", mPlot,
        "error against seconds and bytes as .png or .svg, drawn by gnuplot");
    mCommon.declareThreads(arguments);
    mCommon.declareJson(arguments, "the rows; with - they replace the table on standard output");
    mCommon.declareQuiet(arguments);
    arguments.example("lumivdb bench --quick", "a first look, about a minute");
    arguments.example("lumivdb bench --json bench.json --plot bench.png", "the whole study");
    arguments.example("lumivdb bench --scene sponza.glb --env sky.hdr --spacing 0.5 --plot s.svg",
        "what pays in a scene of your own");
}

std::vector<std::string> sampleFolders()
{
    std::vector<std::string> folders;
    std::error_code failed;
    const fs::path program = fs::read_symlink("/proc/self/exe", failed);
    if (!failed) {
        const fs::path beside = program.parent_path();
        for (const char* way :
            {"samples", "../samples", "../../samples", "../share/lumivdb/samples"})
            folders.push_back((beside / way).lexically_normal().string());
    }
    folders.push_back("samples");
    return folders;
}

std::vector<BenchScene> BenchCommand::scenes() const
{
    std::vector<BenchScene> result;
    for (const std::string& path : mScenes) result.push_back({path, mEnvironment});
    if (!mScenes.empty() && !mSamples.empty())
        failUsage("--samples and --scene exclude each other; give one.");
    if (!mScenes.empty()) return result;
    if (!mEnvironment.empty()) failUsage("--env has no effect without --scene; give both or none.");
    const std::vector<std::string> folders
        = mSamples.empty() ? sampleFolders() : std::vector<std::string>{mSamples};
    for (const std::string& folder : folders) {
        std::error_code failed;
        if (!fs::exists(fs::path(folder) / kSamples[0].file, failed)) continue;
        for (const Sample& sample : kSamples) {
            if (mQuick && !sample.quick) continue;
            const fs::path in = folder;
            result.push_back({(in / sample.file).string(),
                sample.underSky ? (in / "sky.hdr").string() : std::string()});
        }
        return result;
    }
    throw Error(ErrorCode::Input,
        "The sample scenes are not in '" + folders.front()
            + "'; name their folder with --samples, or scenes with --scene.");
}

std::shared_ptr<const Scene> BenchCommand::load(const BenchScene& from)
{
    auto scene = std::make_shared<Scene>(loadScene(from.path));
    for (const std::string& warning : scene->warnings) {
        const bool isDark = warning.rfind("Nothing emits light", 0) == 0;
        if (!isDark || from.environment.empty()) mCommon.console.warn(warning);
    }
    if (!from.environment.empty()) {
        std::vector<std::string> warnings;
        requireFile(from.environment);
        scene->environment = Environment::load(from.environment, {}, warnings);
        mCommon.console.warn(warnings);
    }
    updateContentHash(*scene);
    return scene;
}

BakeOptions BenchCommand::bakeOptions(const BenchConfiguration& c) const
{
    BakeOptions options;
    options.spacing = c.spacing;
    options.bands = c.bands;
    options.gradients = c.gradients;
    options.probe.rays = mRays;
    options.probe.contribution = mContribution;
    options.levels = c.levels;
    if (c.threshold > 0) options.refine.error = c.threshold;
    options.threads = mCommon.threads;
    if (c.method == BenchMethod::Cached) options.integrator = Integrator::Cached;
    return options;
}

IrradianceVolume BenchCommand::makeVolume(
    const Tracer& tracer, BenchRow& row, Progress& progress) const
{
    const BenchConfiguration& c = row.configuration;
    if (c.method == BenchMethod::Path || c.method == BenchMethod::Cached) {
        BakeResult baked = bakeVolume(tracer, bakeOptions(c), &progress);
        const BakeReport& report = baked.report;
        row.rays = report.rays;
        row.stages = {report.cache.seconds, 0, report.secondsRefine, report.secondsVerify};
        // A scene too fragmented for the cache was baked by paths.
        if (report.integrator == Integrator::Path) row.configuration.method = BenchMethod::Path;
        return std::move(baked.volume);
    }
    LpvBakeOptions options;
    options.lpv.spacing = c.spacing;
    options.lpv.threads = mCommon.threads;
    if (c.method == BenchMethod::LpvMany) options.lpv.bounces = LpvBounces::Many;
    if (c.method == BenchMethod::LpvOpen) options.lpv.occlusion = LpvOcclusion::Off;
    options.contribution = mContribution;
    LpvBakeResult propagated = bakeLpv(tracer, options, &progress);
    row.rays = propagated.report.rays;
    return std::move(propagated.volume);
}

void BenchCommand::measureScene(const BenchScene& from, std::vector<BenchRow>& rows)
{
    const auto scene = load(from);
    const Tracer tracer(scene);
    const double finest = mSpacing.value_or(defaultSpacing(scene->bounds()));
    const auto configurations = benchConfigurations(scene->bounds(), finest, mQuick, mContribution);
    // The reference's rays carry no expansion: a quarter more work each, as measured.
    const double reference = 1.25 * static_cast<double>(mPoints) * mReferenceRays / mRays;
    double total = reference;
    for (const BenchConfiguration& c : configurations) total += c.expectedCost;

    ProgressBar bar(mCommon.console.progressStyle());
    const std::string stage = "bench " + from.label();
    bar.begin(stage.c_str(), static_cast<std::uint64_t>(total));
    Inner inner;
    const BenchReference truth(tracer, mPoints, mReferenceRays, mContribution, mSeed, inner);
    bar.advance(static_cast<std::uint64_t>(reference));
    for (const BenchConfiguration& c : configurations) {
        throwIfInterrupted();
        BenchRow row;
        row.scene = from.label();
        row.configuration = c;
        const Stopwatch watch;
        const IrradianceVolume volume = makeVolume(tracer, row, inner);
        row.bakeSeconds = watch.seconds();
        BenchStages& stages = row.stages;
        stages.trace = row.bakeSeconds - stages.solve - stages.refine - stages.verify;
        row.samples = volume.sampleCount();
        for (const Interpolation mode : c.modes) {
            BenchRow measured = row;
            measured.mode = mode;
            truth.measure(volume, measured);
            rows.push_back(std::move(measured));
        }
        bar.advance(static_cast<std::uint64_t>(c.expectedCost));
    }
    bar.advance(static_cast<std::uint64_t>(total)); // what rounding left
}

/// Shares of a bake's seconds in percent.
std::string stageShares(const BenchRow& r)
{
    std::string text;
    for (const double s : {r.stages.solve, r.stages.trace, r.stages.refine, r.stages.verify})
        text += (text.empty() ? "" : "/")
            + std::to_string(std::lround(r.bakeSeconds > 0 ? 100 * s / r.bakeSeconds : 0));
    return text;
}

/// Columns as wide as their widest entry; the first @a left of them start at the left.
std::string aligned(const std::vector<std::vector<std::string>>& lines, std::size_t left)
{
    std::vector<std::size_t> widths;
    for (const auto& line : lines) {
        widths.resize(std::max(widths.size(), line.size()));
        for (std::size_t i = 0; i < line.size(); ++i)
            widths[i] = std::max(widths[i], line[i].size());
    }
    std::string out;
    for (const auto& line : lines) {
        std::string text;
        for (std::size_t i = 0; i < line.size(); ++i) {
            const std::string blanks(widths[i] - line[i].size(), ' ');
            text += (i == 0 ? "" : "  ") + (i < left ? line[i] + blanks : blanks + line[i]);
        }
        text.erase(text.find_last_not_of(' ') + 1);
        out += text + "\n";
    }
    return out;
}

void BenchCommand::printTable(const std::vector<BenchRow>& rows) const
{
    std::vector<std::vector<std::string>> lines = {{"scene", "cells", "gradients", "interpolation",
        "integrator", "levels", "threshold", "spacing", "bands", "bake s", "stages %", "Mrays",
        "samples", "kB", "query ns", "rel_rmse", "p50", "p99", "best"}};
    const auto percent = [](double x) { return rounded(100 * x, 3) + "%"; };
    for (const BenchRow& r : rows) {
        const BenchConfiguration& c = r.configuration;
        lines.push_back({r.scene, representation(c), name(c.gradients), name(r.mode), integrator(c),
            std::to_string(c.levels), c.threshold > 0 ? rounded(c.threshold) : "-",
            rounded(c.spacing), std::to_string(c.bands), rounded(r.bakeSeconds, 3), stageShares(r),
            rounded(static_cast<double>(r.rays) / 1e6, 3), grouped(r.samples),
            grouped(r.bytes / 1000), rounded(r.queryNs, 3), percent(r.relRmse), percent(r.p50),
            percent(r.p99),
            std::string(r.bestForSeconds ? "s" : "-") + (r.bestForBytes ? "b" : "-")});
    }
    writeStdout(aligned(lines, 5));
}

Json BenchCommand::report(const std::vector<BenchRow>& rows) const
{
    Json json;
    json["rays_per_sample"] = mRays;
    json["points"] = mPoints;
    json["reference_rays"] = mReferenceRays;
    json["contribution"] = name(mContribution);
    json["threads"] = mCommon.threads;
    json["rows"] = Json::array();
    for (const BenchRow& r : rows) {
        const BenchConfiguration& c = r.configuration;
        Json row;
        row["scene"] = r.scene;
        row["representation"] = representation(c);
        row["levels"] = c.levels;
        row["threshold"] = c.threshold > 0 ? Json(c.threshold) : Json(nullptr);
        row["spacing"] = c.spacing;
        row["bands"] = c.bands;
        row["gradients"] = name(c.gradients);
        row["interpolation"] = name(r.mode);
        row["integrator"] = integrator(c);
        row["bake_seconds"] = r.bakeSeconds;
        row["seconds"] = {{"solve", r.stages.solve}, {"trace", r.stages.trace},
            {"refine", r.stages.refine}, {"verify", r.stages.verify}};
        row["rays"] = r.rays;
        row["samples"] = r.samples;
        row["bytes"] = r.bytes;
        row["query_ns"] = r.queryNs;
        row["rel_rmse"] = r.relRmse;
        row["p50"] = r.p50;
        row["p95"] = r.p95;
        row["p99"] = r.p99;
        row["reference_stderr"] = r.referenceStderr;
        row["pareto"] = Json::array();
        if (r.bestForSeconds) row["pareto"].push_back("bake_seconds");
        if (r.bestForBytes) row["pareto"].push_back("bytes");
        json["rows"].push_back(std::move(row));
    }
    return json;
}

/// In percent, and never 0: the axis is logarithmic.
double shownError(const BenchRow& r) { return std::max(100 * r.relRmse, 1e-6); }

/// Rows of a scene as data for gnuplot: "cost error", or nothing.
template <class Keep, class Cost>
std::string plotData(
    const std::vector<BenchRow>& rows, const std::string& scene, Keep keep, Cost cost)
{
    std::vector<std::pair<double, double>> points;
    for (const BenchRow& r : rows)
        if (r.scene == scene && keep(r)) points.emplace_back(cost(r), shownError(r));
    std::sort(points.begin(), points.end());
    std::string data;
    for (const auto& [x, y] : points) data += toText(x) + " " + toText(y) + "\n";
    return data;
}

struct PlotSeries {
    const char* title;
    const char* representation; ///< what that of its rows begins with
    const char* integrator;
    bool gradients;
    const char* style;
};
constexpr PlotSeries kSeries[] = {{"uniform", "uniform", "path", false, "pt 4 lc rgb '#1f77b4'"},
    {"uniform, gradients", "uniform", "path", true, "pt 5 lc rgb '#1f77b4'"},
    {"adaptive", "adaptive", "path", false, "pt 6 lc rgb '#d62728'"},
    {"adaptive, gradients", "adaptive", "path", true, "pt 7 lc rgb '#d62728'"},
    {"uniform, cached", "uniform", "cached", false, "pt 4 lc rgb '#ff7f0e'"},
    {"uniform, cached, gradients", "uniform", "cached", true, "pt 5 lc rgb '#ff7f0e'"},
    {"adaptive, cached", "adaptive", "cached", false, "pt 6 lc rgb '#9467bd'"},
    {"adaptive, cached, gradients", "adaptive", "cached", true, "pt 7 lc rgb '#9467bd'"},
    {"light propagation", "lpv", "lpv", false, "pt 8 lc rgb '#2ca02c'"}};

/// A logarithmic axis round @a values, with as many round numbers as fit.
std::string axisOf(const char* axis, const std::vector<double>& values)
{
    const auto [least, most] = std::minmax_element(values.begin(), values.end());
    const double low = *least / 1.4, high = *most * 1.4;
    std::vector<double> digits = {1};
    if (high / low < 1000) digits = {1, 2, 5};
    if (high / low < 10) digits = {1, 1.5, 2, 3, 5, 7};
    std::string tics;
    for (double power = std::pow(10.0, std::floor(std::log10(low))); power < high; power *= 10) {
        for (const double digit : digits) {
            const double tic = digit * power;
            if (tic >= low && tic <= high) tics += (tics.empty() ? "" : ", ") + rounded(tic, 3);
        }
    }
    const std::string name = axis;
    return "set " + name + "range [" + toText(low) + ":" + toText(high) + "]\nset " + name
        + "tics (" + tics + ")\n";
}

/// One panel: all rows of a scene against a cost, and the front of the best.
template <class Cost, class Best>
std::string panel(const std::vector<BenchRow>& rows, const std::string& scene, bool key,
    const std::string& axis, Cost cost, Best best)
{
    std::string data, plots;
    int block = 0;
    const auto add = [&](const std::string& points, const std::string& style) {
        if (points.empty()) return;
        const std::string blockName = "$data" + std::to_string(block++);
        data += blockName + " << END\n" + points + "END\n";
        plots += (plots.empty() ? "plot " : ", ") + blockName + " using 1:2 " + style;
    };
    add(plotData(rows, scene, best, cost),
        "with steps lw 1.5 lc rgb '#888888' title 'best of all'");
    for (const PlotSeries& s : kSeries) {
        const auto keep = [&](const BenchRow& r) {
            const std::string kind = representation(r.configuration);
            return kind.rfind(s.representation, 0) == 0
                && s.integrator == std::string(integrator(r.configuration))
                && (r.configuration.gradients != GradientMethod::None) == s.gradients;
        };
        add(plotData(rows, scene, keep, cost),
            std::string("with points ") + s.style + " title '" + s.title + "'");
    }
    std::vector<double> costs, errors;
    for (const BenchRow& r : rows) {
        if (r.scene != scene) continue;
        costs.push_back(cost(r));
        errors.push_back(shownError(r));
    }
    return data + axisOf("x", costs) + axisOf("y", errors) + "set title " + plotText(scene)
        + "\nset xlabel " + plotText(axis)
        + (key ? "\nset key bottom left samplen 1\n" : "\nunset key\n") + plots + "\n";
}

void BenchCommand::drawPlot(const std::vector<BenchRow>& rows) const
{
    if (mPlot.empty()) return;
    std::vector<std::string> names;
    for (const BenchRow& r : rows)
        if (std::find(names.begin(), names.end(), r.scene) == names.end()) names.push_back(r.scene);
    std::string script
        = "set logscale xy\nset grid lc rgb '#dddddd'\nset ylabel 'rel. RMS error, %'\n"
          "set multiplot layout "
        + std::to_string(names.size()) + ",2\n";
    for (const std::string& scene : names) {
        script += panel(
            rows, scene, scene == names.front(), "bake, s",
            [](const BenchRow& r) { return std::max(r.bakeSeconds, 1e-4); },
            [](const BenchRow& r) { return r.bestForSeconds; });
        script += panel(
            rows, scene, false, "memory, MB",
            [](const BenchRow& r) { return std::max(static_cast<double>(r.bytes), 1.0) / 1e6; },
            [](const BenchRow& r) { return r.bestForBytes; });
    }
    plot(mPlot, script + "unset multiplot\n", 960, 340 * static_cast<int>(names.size()));
}

void BenchCommand::run(const Arguments& arguments)
{
    if (mQuick && !arguments.given("--rays")) mRays = 256;
    if (mQuick && !arguments.given("--points")) mPoints = 150;
    if (mQuick && !arguments.given("--reference-rays")) mReferenceRays = 1024;
    const std::vector<BenchScene> list = scenes();
    std::vector<std::string> files;
    for (const BenchScene& scene : list) {
        files.push_back(scene.path);
        files.push_back(scene.environment);
    }
    if (!mPlot.empty()) {
        checkPlot(mPlot, "--plot");
        checkIsNoneOf(mPlot, "--plot", files);
        files.push_back(mPlot);
    }
    mCommon.apply(files);

    std::vector<BenchRow> rows;
    for (const BenchScene& scene : list) measureScene(scene, rows);
    markPareto(rows);
    if (!mCommon.jsonToStdout()) printTable(rows);
    mCommon.writeJson(report(rows));
    drawPlot(rows);
}

} // namespace

std::unique_ptr<Command> makeBenchCommand() { return std::make_unique<BenchCommand>(); }

} // namespace lumivdb::cli
