// SPDX-License-Identifier: Apache-2.0
/// Whole uniform volumes by both integrators at growing numbers of rays: processor seconds of each
/// stage, and the error against a volume of the same samples that many paths made. Prints JSON,
/// which bench/volume_curves.py makes tables and a picture of:
/// lumivdb_bench_volumes SCENE spacing=H [key=value ...], see usage().
///
/// Errors are of irradiance at the samples over all normals, relative to its mean, worst channel;
/// the reference's noise, known from its two halves, is taken off. As samples share patterns of
/// directions (and a cache), squares are averaged over bakes with other seeds. Bakes of both
/// integrators take turns; of each number of rays the fastest counts.

#include "program.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/bake/environment.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <nlohmann/json.hpp>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <functional>
#include <map>

#include <sys/resource.h>

using namespace lumivdb;
using Json = nlohmann::ordered_json;

namespace {

struct Settings {
    std::string scene, environment;
    double spacing = 0;
    bool sun = false, front = false;
    std::optional<Box3d> bounds;
    int first = 16, most = 1024, mostCached = 0, referenceRays = 16384, biasRays = 8192;
    int threads = 1, seeds = 3;
};

int usage(const char* program)
{
    std::fprintf(stderr,
        "usage: %s SCENE spacing=H [bounds=x,y,z,x,y,z] [env=FILE] [sun=1: add one] [front=1: "
        "lamps shine to their front]\n  [first=16] [most=1024] [mostcached=most] rays a sample, "
        "doubling [seeds=3 bakes of each] [threads=1 of them]\n  [reference=16384 rays a sample, "
        "twice, all threads] [bias=8192 rays a sample, twice; 0: not measured]\n",
        program);
    return 2;
}

bool parse(int argc, char** argv, Settings& s)
{
    const bool known = readSettings(argc, argv,
        {{"spacing", setting(s.spacing)}, {"bounds", setting(s.bounds)},
            {"env", setting(s.environment)}, {"sun", setting(s.sun)}, {"front", setting(s.front)},
            {"first", setting(s.first)}, {"most", setting(s.most)},
            {"mostcached", setting(s.mostCached)}, {"seeds", setting(s.seeds)},
            {"threads", setting(s.threads)}, {"reference", setting(s.referenceRays)},
            {"bias", setting(s.biasRays)}});
    if (s.mostCached == 0) s.mostCached = s.most;
    if (argc > 1) s.scene = argv[1];
    return known && argc > 1 && s.spacing > 0 && s.seeds > 0 && s.first > 1;
}

Scene load(const Settings& s)
{
    Scene scene = loadScene(s.scene);
    std::vector<std::string> warnings;
    if (!s.environment.empty()) scene.environment = Environment::load(s.environment, {}, warnings);
    if (s.front)
        for (Material& m : scene.materials) m.emitsFrontOnly = true;
    if (s.sun) {
        Light sun;
        sun.type = LightType::Directional;
        sun.direction = Vec3d(-0.25, -1, -0.15).normalized();
        sun.intensity = Color(10.0f);
        scene.lights.push_back(sun);
    }
    return scene;
}

double peakMegabytes()
{
    rusage used;
    getrusage(RUSAGE_SELF, &used);
    return static_cast<double>(used.ru_maxrss) / 1024;
}

/// Processor seconds of each stage that a bake tells of; what comes before the first is "rest".
class StageClock : public Progress {
public:
    void begin(const char* stage, std::uint64_t) override
    {
        close();
        const std::string s = stage;
        mStage = s == "light of the surfaces" ? "solve"
            : s == "trace samples"            ? "trace"
            : s == "find what cells see"      ? "visibility"
            : s == "measure the cache's bias" ? "verify"
                                              : "rest";
    }
    std::map<std::string, double> finish()
    {
        close();
        return mSeconds;
    }

private:
    void close()
    {
        const double now = processorSeconds();
        mSeconds[mStage] += now - mStart;
        mStart = now;
    }
    std::string mStage = "rest";
    double mStart = processorSeconds();
    std::map<std::string, double> mSeconds;
};

BakeOptions bakeOptions(const Settings& s, Integrator integrator, int rays, std::uint64_t seed)
{
    BakeOptions options;
    options.integrator = integrator;
    options.spacing = s.spacing;
    options.bounds = s.bounds;
    options.probe.rays = rays;
    options.probe.seed = seed;
    options.threads = s.threads;
    return options;
}

/// Two volumes of the same samples whose mean is the truth.
class Reference {
public:
    Reference(const Tracer& tracer, const Settings& s)
        : a(bake(tracer, s, 1001))
        , b(bake(tracer, s, 1002))
    {
        for (SampleId i = 0; i < a.sampleCount(); ++i) {
            if (!a.isValid(i) || !b.isValid(i) || a.offset(i) != b.offset(i)) continue;
            samples.push_back(i);
            mMean += Vec3d(a.radiance(i)[0] + b.radiance(i)[0]) * 0.5;
        }
        const auto half
            = [&](SampleId i, int k) { return (a.radiance(i)[k] - b.radiance(i)[k]) * 0.5f; };
        mNoise2 = meanSquare(samples, half);
    }

    /// Mean over samples and normals of (irradiance of @a coefficient(sample, number))².
    template <class Coefficient>
    Vec3d meanSquare(const std::vector<SampleId>& of, Coefficient coefficient) const
    {
        Vec3d sum(0.0);
        for (const SampleId i : of) {
            for (int k = 0; k < a.coefficients(); ++k) {
                const double lobe = kCosineLobe[static_cast<std::size_t>(std::sqrt(k))];
                const Vec3d d(coefficient(i, k));
                sum += d * d * (lobe * lobe / (4 * M_PI));
            }
        }
        return sum / static_cast<double>(of.size());
    }

    struct Error {
        double square = 0; ///< of the relative RMS of the worst channel; below 0 within the noise
        double mean = 0; ///< with sign, of the worst channel
    };
    /// Of coefficients whose own noise has the mean square @a noise2.
    template <class Coefficient>
    Error error(const std::vector<SampleId>& of, Coefficient coefficient,
        const Vec3d& noise2 = Vec3d(0.0)) const
    {
        const auto difference = [&](SampleId i, int k) {
            return coefficient(i, k) - (a.radiance(i)[k] + b.radiance(i)[k]) * 0.5f;
        };
        Error e;
        e.square = worst(meanSquare(of, difference) - mNoise2 - noise2);
        Vec3d sum(0.0);
        for (const SampleId i : of) sum += Vec3d(difference(i, 0));
        for (int c = 0; c < 3; ++c) {
            const double mean = mMean[c] > 0 ? sum[c] / mMean[c] : 0;
            if (std::abs(mean) > std::abs(e.mean)) e.mean = mean;
        }
        return e;
    }
    /// Largest of a mean square over the square of the mean.
    double worst(const Vec3d& square) const
    {
        double most = -1;
        const double toMean = kCosineLobe[0] * 0.28209479177387814347
            / static_cast<double>(samples.size()); // of E over normals: A_0 Y_00 L_00
        for (int c = 0; c < 3; ++c) {
            const double mean = mMean[c] * toMean;
            if (mean > 0) most = std::max(most, square[c] / (mean * mean));
        }
        return most;
    }
    double noise() const { return std::sqrt(worst(mNoise2)); }

    IrradianceVolume a, b;
    std::vector<SampleId> samples; ///< valid ones, measured at one place

private:
    static IrradianceVolume bake(const Tracer& tracer, const Settings& s, std::uint64_t seed)
    {
        BakeOptions options = bakeOptions(s, Integrator::Path, s.referenceRays, seed);
        options.threads = 0;
        return bakeVolume(tracer, options).volume;
    }
    Vec3d mMean{0.0}, mNoise2{0.0};
};

/// Bakes of one integrator and number of rays.
struct Row {
    int rays = 0;
    double square = 0, mean = 0, total = 1e300;
    std::map<std::string, double> seconds; // of the fastest
    std::uint64_t traced = 0, moved = 0;
    RadianceCacheReport cache;
};

void bakeOnce(const Tracer& tracer, const Settings& s, const Reference& reference,
    Integrator integrator, std::uint64_t seed, Row& row)
{
    StageClock clock;
    const BakeResult baked = bakeVolume(tracer, bakeOptions(s, integrator, row.rays, seed), &clock);
    const auto seconds = clock.finish();
    if (baked.report.integrator != integrator)
        throw Error(ErrorCode::Input, "the radiance cache could not be used");
    double total = 0;
    for (const auto& stage : seconds) total += stage.second;
    if (total < row.total) {
        row.total = total;
        row.seconds = seconds;
    }
    // A sample inside a solid is moved by what its rays saw: few rays may move it elsewhere, where
    // the light is another.
    std::vector<SampleId> same;
    for (const SampleId i : reference.samples)
        if (baked.volume.offset(i) == reference.a.offset(i)) same.push_back(i);
    const Reference::Error e
        = reference.error(same, [&](SampleId i, int k) { return baked.volume.radiance(i)[k]; });
    row.square += e.square / s.seeds;
    row.mean += e.mean / s.seeds;
    row.traced = baked.report.rays;
    row.cache = baked.report.cache;
    row.moved += reference.samples.size() - same.size();
}

Json toJson(const Row& row)
{
    Json json = {{"rays", row.rays}, {"rel_rmse", std::sqrt(std::max(0.0, row.square))},
        {"mean", row.mean}, {"traced", row.traced}, {"moved_samples", row.moved},
        {"seconds", row.seconds}, {"total", row.total}};
    const RadianceCacheReport& c = row.cache;
    if (c.patches > 0) json["cache"] = {{"patches", c.patches}, {"bytes", c.bytes}};
    return json;
}

/// One cache, two sets of many directions at the reference's places: their common error.
Json biasOf(const Tracer& tracer, const Settings& s, const Reference& reference)
{
    ProbeOptions options;
    RadianceCacheOptions cache; // as of the bake with the most rays
    cache.patches = RadianceCacheOptions::patchesFor(
        static_cast<double>(reference.a.sampleCount()), s.mostCached);
    options.cache = std::make_shared<const RadianceCache>(tracer, cache);
    options.rays = s.biasRays;
    const int bands = reference.a.bands();
    std::vector<std::vector<Color>> found[2];
    for (std::uint64_t half = 0; half < 2; ++half) {
        options.seed = 11 + half;
        const ProbeEstimator estimator(tracer, options);
        tbb::enumerable_thread_specific<ProbeEstimator::Workspace> workspaces;
        found[half].resize(reference.a.sampleCount());
        tbb::parallel_for(std::size_t{0}, reference.samples.size(), [&](std::size_t n) {
            const SampleId i = reference.samples[n];
            found[half][i] = estimator
                                 .radianceSh(reference.a.measuredWorld(i), bands,
                                     hashCombine(options.seed, i), workspaces.local())
                                 .value;
        });
    }
    const auto at
        = [&](int half, SampleId i, int k) { return found[half][i][static_cast<std::size_t>(k)]; };
    const Vec3d noise2 = reference.meanSquare(
        reference.samples, [&](SampleId i, int k) { return (at(0, i, k) - at(1, i, k)) * 0.5f; });
    const Reference::Error e = reference.error(
        reference.samples, [&](SampleId i, int k) { return (at(0, i, k) + at(1, i, k)) * 0.5f; },
        noise2);
    return {{"rms", std::sqrt(std::max(0.0, e.square))}, {"mean", e.mean},
        {"noise", std::sqrt(reference.worst(noise2))}, {"rays", s.biasRays}};
}

int run(int argc, char** argv)
{
    Settings s;
    if (!parse(argc, argv, s)) return usage(argv[0]);
    double build = processorSeconds();
    const auto scene = std::make_shared<Scene>(load(s));
    const double loaded = processorSeconds() - build;
    const Tracer tracer(scene);
    build = processorSeconds() - build - loaded;
    const Reference reference(tracer, s);
    if (reference.samples.empty()) throw Error(ErrorCode::Input, "no sample lies in free space");
    const double peakPath = peakMegabytes();
    std::fprintf(stderr, "%zu samples, %zu valid; noise of the reference %.3f%%\n",
        reference.a.sampleCount(), reference.samples.size(), 100 * reference.noise());
    Json curves[2] = {Json::array(), Json::array()};
    for (int rays = s.first; rays <= std::max(s.most, s.mostCached); rays *= 2) {
        Row rows[2];
        for (std::uint64_t seed = 1; seed <= static_cast<std::uint64_t>(s.seeds); ++seed) {
            for (const Integrator integrator : {Integrator::Path, Integrator::Cached}) {
                const bool cached = integrator == Integrator::Cached;
                if (rays > (cached ? s.mostCached : s.most)) continue;
                rows[cached].rays = rays;
                bakeOnce(tracer, s, reference, integrator, seed, rows[cached]);
            }
        }
        for (int i = 0; i < 2; ++i) {
            if (rows[i].rays == 0) continue;
            curves[i].push_back(toJson(rows[i]));
            std::fprintf(
                stderr, "%-6s %s\n", i ? "cached" : "path", curves[i].back().dump().c_str());
        }
    }
    const double peakCached = peakMegabytes();
    const Json bias = s.biasRays > 0 ? biasOf(tracer, s, reference) : Json(nullptr);
    const Json json
        = {{"scene", s.scene}, {"spacing", s.spacing}, {"samples", reference.a.sampleCount()},
            {"valid", reference.samples.size()}, {"seeds", s.seeds}, {"threads", s.threads},
            {"reference", {{"rays", 2 * s.referenceRays}, {"noise", reference.noise()}}},
            {"load", loaded}, {"build", build}, {"path", curves[0]}, {"cached", curves[1]},
            {"bias", bias}, {"peak_mb", {{"path", peakPath}, {"cached", peakCached}}}};
    std::printf("%s\n", json.dump(1).c_str());
    return 0;
}

} // namespace

int main(int argc, char** argv) { return runProgram(run, argc, argv); }
