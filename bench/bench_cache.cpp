// SPDX-License-Identifier: Apache-2.0
/// Processor time against error of both integrators at the same points of free space, and the
/// cache's bias:
/// lumivdb_bench_cache SCENE [key=value ...], see usage().

#include "free_points.h"
#include "program.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/radiance_cache.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <tbb/enumerable_thread_specific.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <limits>
#include <sstream>

using namespace lumivdb;

namespace {

constexpr int kNormals = 32;

struct Settings {
    std::string scene, environment;
    bool sun = false, front = false, lights = true;
    Contribution contribution = Contribution::All;
    Box3d bounds;
    std::size_t points = 200;
    int referenceRays = 8192, threads = 1, most = 2048, repeats = 3, seeds = 1;
    int solutions = 0, directions = 65536;
    RadianceCacheOptions cache;
};

int usage(const char* program)
{
    std::fprintf(stderr,
        "usage: %s SCENE [env=FILE] [sun=1] [lights=0: none of the file's] [bounds=x,y,z,x,y,z] "
        "[points=200] [threads=1]\n"
        "  [reference=8192 rays a point, twice] [most=2048 rays a point] [repeats=3]\n  [seeds=1: "
        "directions, which all points share, to take the mean square error over]\n  [front=1: "
        "lamps shine to their front] [contribution=all|direct|indirect]\n"
        "  [patches=N] [rays=N a patch] [nearness=R] [maxpatches=N]\n"
        "or, instead of time against error, what N solutions have in common and how they differ:\n"
        "  solutions=N [directions=65536 a point]\n",
        program);
    return 2;
}

bool parse(int argc, char** argv, Settings& s)
{
    if (argc < 2) return false;
    s.scene = argv[1];
    const auto contribution = [&](const char* name) {
        s.contribution = std::strcmp(name, "direct") == 0 ? Contribution::Direct
            : std::strcmp(name, "indirect") == 0          ? Contribution::Indirect
                                                          : Contribution::All;
    };
    return readSettings(argc, argv,
        {{"env", setting(s.environment)}, {"sun", setting(s.sun)}, {"lights", setting(s.lights)},
            {"contribution", contribution}, {"front", setting(s.front)},
            {"bounds", setting(s.bounds)}, {"points", setting(s.points)},
            {"threads", setting(s.threads)}, {"repeats", setting(s.repeats)},
            {"seeds", setting(s.seeds)}, {"reference", setting(s.referenceRays)},
            {"most", setting(s.most)}, {"solutions", setting(s.solutions)},
            {"directions", setting(s.directions)}, {"patches", setting(s.cache.patches)},
            {"maxpatches", setting(s.cache.maxPatches)}, {"rays", setting(s.cache.rays)},
            {"nearness", setting(s.cache.nearness)}});
}

/// Irradiance at all points for all normals, and how long it took.
struct Field {
    std::vector<Color> values; // [point * kNormals + normal]
    double seconds = 0;
    std::uint64_t rays = 0;
};

Field measure(const Tracer& tracer, const ProbeOptions& options, const std::vector<Vec3d>& points)
{
    const std::vector<Vec3f> normals = uniformNormals(kNormals);
    const ProbeEstimator estimator(tracer, options);
    tbb::enumerable_thread_specific<ProbeEstimator::Workspace> workspaces;
    Field f;
    f.values.resize(points.size() * kNormals);
    std::vector<std::uint64_t> rays(points.size());
    const double start = processorSeconds();
    tbb::parallel_for(std::size_t{0}, points.size(), [&](std::size_t i) {
        const ProbeResult r = estimator.irradiance(
            points[i], normals, hashCombine(options.seed, i), workspaces.local());
        std::copy(
            r.value.begin(), r.value.end(), f.values.begin() + static_cast<long>(i * kNormals));
        rays[i] = r.rays;
    });
    f.seconds = processorSeconds() - start;
    for (const std::uint64_t r : rays) f.rays += r;
    return f;
}

struct Reference {
    std::vector<Color> values;
    Vec3d mean{0.0}, noise2{0.0}; // of E; mean square of the values' noise
};

Reference referenceOf(const Field& a, const Field& b)
{
    Reference r;
    const auto n = static_cast<double>(a.values.size());
    for (std::size_t i = 0; i < a.values.size(); ++i) {
        const Color v = (a.values[i] + b.values[i]) * 0.5f;
        const Vec3d d((a.values[i] - b.values[i]) * 0.5f);
        r.values.push_back(v);
        r.mean += Vec3d(v) / n;
        r.noise2 += d * d / n;
    }
    return r;
}

/// Relative RMS error of the worst channel, the reference's noise taken off; and the mean error.
std::pair<double, double> errorOf(const std::vector<Color>& values, const Reference& ref)
{
    Vec3d square(0.0), sum(0.0);
    const auto n = static_cast<double>(values.size());
    for (std::size_t i = 0; i < values.size(); ++i) {
        const Vec3d d(values[i] - ref.values[i]);
        square += d * d / n;
        sum += d / n;
    }
    double rms = 0, mean = 0;
    for (int c = 0; c < 3; ++c) {
        if (!(ref.mean[c] > 0)) continue;
        rms = std::max(rms, std::sqrt(std::max(0.0, square[c] - ref.noise2[c])) / ref.mean[c]);
        if (std::abs(sum[c] / ref.mean[c]) > std::abs(mean)) mean = sum[c] / ref.mean[c];
    }
    return {rms, mean};
}

/// One point of a curve: seconds of one probe, relative RMS error of all.
struct Cost {
    double rays, seconds, error;
};

std::vector<Cost> curve(const char* name, const Tracer& tracer, ProbeOptions options,
    const Settings& s, const std::vector<Vec3d>& points, const Reference& ref)
{
    std::vector<Cost> costs;
    const std::uint64_t first = options.seed;
    for (options.rays = 32; options.rays <= s.most; options.rays *= 2) {
        options.seed = first;
        Field f = measure(tracer, options, points);
        auto [rms, mean] = errorOf(f.values, ref);
        double square = rms * rms, sum = mean;
        for (int again = 1; again < std::max(s.repeats, s.seeds); ++again) {
            options.seed = first + static_cast<std::uint64_t>(again % s.seeds);
            const Field other = measure(tracer, options, points);
            f.seconds = std::min(f.seconds, other.seconds);
            if (again >= s.seeds) continue;
            const auto error = errorOf(other.values, ref);
            square += error.first * error.first;
            sum += error.second;
        }
        rms = std::sqrt(square / s.seeds);
        mean = sum / s.seeds;
        const double seconds = f.seconds / static_cast<double>(points.size());
        std::printf(
            "%-7s %6d rays  %8.3f ms a point  %6.1f Mrays/s  rel_rmse %7.3f%%  mean %+.3f%%\n",
            name, options.rays, seconds * 1e3, static_cast<double>(f.rays) / f.seconds * 1e-6,
            100 * rms, 100 * mean);
        std::fflush(stdout);
        costs.push_back({static_cast<double>(options.rays), seconds, rms});
    }
    return costs;
}

/// Seconds of one probe at @a error: between the measured counts, or beyond them (@a beyond) along
/// the line of the last four, in logarithms; infinite where the error no longer falls.
double secondsAt(const std::vector<Cost>& costs, double error, bool& beyond)
{
    const auto line = [&](const Cost& a, const Cost& b) {
        const double t = std::log(error / a.error) / std::log(b.error / a.error);
        return a.seconds * std::pow(b.seconds / a.seconds, t);
    };
    beyond = false;
    for (std::size_t i = 1; i < costs.size(); ++i) {
        if (costs[i].error <= error) return line(costs[i - 1], costs[i]);
    }
    beyond = true;
    // A biased curve ends flat, and no line from there leads to the error.
    const Cost& before = costs[costs.size() - std::min<std::size_t>(costs.size(), 2)];
    if (!(costs.back().error < 0.9 * before.error)) return std::numeric_limits<double>::infinity();
    return line(costs[costs.size() - std::min<std::size_t>(costs.size(), 4)], costs.back());
}

void compare(const std::vector<Cost>& path, const std::vector<Cost>& cached, double solve)
{
    for (const double error : {0.05, 0.02, 0.01}) {
        bool pathBeyond, cachedBeyond;
        const double p = secondsAt(path, error, pathBeyond);
        const double c = secondsAt(cached, error, cachedBeyond);
        std::printf("to %.0f%%: path %s%.3f ms, cached %s%.3f ms a point: %.1fx;", 100 * error,
            pathBeyond ? "~" : "", 1e3 * p, cachedBeyond ? "~" : "", 1e3 * c, p / c);
        for (const double samples : {512.0, 4096.0, 32768.0}) {
            std::printf(" %.0f samples, solving included %.1fx%s", samples,
                samples * p / (solve + samples * c), samples < 30000 ? "," : "\n");
        }
    }
}

/// Errors that solutions of several seeds share, and how far each is from their mean: the first are
/// of patches, the second of the noise they were solved with.
void compareSolutions(const Tracer& tracer, const Settings& s, ProbeOptions options,
    const std::vector<Vec3d>& points, const Reference& ref)
{
    const auto count = static_cast<double>(s.solutions);
    std::vector<std::vector<Color>> fields;
    std::vector<double> means;
    std::vector<Color> mean(ref.values.size(), Color(0.0f));
    options.rays = s.directions;
    double seconds = 0;
    for (int k = 1; k <= s.solutions; ++k) {
        RadianceCacheOptions cache = s.cache;
        cache.seed = options.seed = static_cast<std::uint64_t>(k);
        seconds -= processorSeconds();
        options.cache = std::make_shared<const RadianceCache>(tracer, cache);
        seconds += processorSeconds();
        fields.push_back(measure(tracer, options, points).values);
        means.push_back(errorOf(fields.back(), ref).second);
        for (std::size_t i = 0; i < mean.size(); ++i)
            mean[i] += fields.back()[i] * static_cast<float>(1 / count);
    }
    double common = 0, spread = 0, center = 0, variance = 0;
    for (int c = 0; c < 3; ++c) {
        if (!(ref.mean[c] > 0)) continue;
        double square = 0, apart = 0;
        const auto n = static_cast<double>(mean.size());
        for (std::size_t i = 0; i < mean.size(); ++i) {
            square += std::pow(static_cast<double>(mean[i][c] - ref.values[i][c]), 2) / n;
            for (const std::vector<Color>& f : fields)
                apart += std::pow(static_cast<double>(f[i][c] - mean[i][c]), 2) / n / (count - 1);
        }
        const double shared = std::max(0.0, square - ref.noise2[c] - apart / count);
        common = std::max(common, std::sqrt(shared) / ref.mean[c]);
        spread = std::max(spread, std::sqrt(apart) / ref.mean[c]);
    }
    for (const double m : means) center += m / count;
    for (const double m : means) variance += (m - center) * (m - center) / (count - 1) / count;
    std::printf("%d solutions, %d directions, solved in %.2f s each: mean %+.3f%% +- %.3f%% (of "
                "the solutions), common "
                "rms %.3f%%, spread %.3f%%\n",
        s.solutions, s.directions, seconds / count, 100 * center, 100 * std::sqrt(variance),
        100 * common, 100 * spread);
}

int run(int argc, char** argv)
{
    Settings s;
    if (!parse(argc, argv, s)) return usage(argv[0]);
    const tbb::global_control threads(
        tbb::global_control::max_allowed_parallelism, static_cast<std::size_t>(s.threads));
    auto scene = std::make_shared<Scene>(loadScene(s.scene));
    std::vector<std::string> warnings;
    if (!s.environment.empty()) scene->environment = Environment::load(s.environment, {}, warnings);
    for (Material& m : scene->materials) m.emitsFrontOnly = s.front;
    if (!s.lights) scene->lights.clear();
    if (s.sun) {
        Light sun;
        sun.type = LightType::Directional;
        sun.direction = Vec3d(-0.25, -1, -0.15).normalized();
        sun.intensity = Color(10.0f);
        scene->lights.push_back(sun);
    }
    const Tracer tracer(scene);
    const Box3d box = s.bounds.isEmpty() ? scene->bounds() : s.bounds;
    const std::vector<Vec3d> points = freePoints(tracer, box, s.points);
    const RadianceCache* solved = nullptr;
    s.cache.box = box;
    ProbeOptions cached;
    double solve = processorSeconds();
    {
        auto cache = std::make_shared<const RadianceCache>(tracer, s.cache);
        solved = cache.get();
        cached.cache = std::move(cache);
    }
    solve = processorSeconds() - solve;
    const RadianceCacheReport& r = solved->report();
    std::printf("%s: %zu points, %d threads\n", s.scene.c_str(), points.size(), s.threads);
    std::printf("cache: %.3f s, %zu patches (%zu mixed)%s, %.2f M rays, %.1f MiB, %d iterations, "
                "residual %.1e\n",
        solve, r.patches, r.mixed, r.full ? " FULL" : "", static_cast<double>(r.rays) * 1e-6,
        static_cast<double>(r.bytes) / 1048576.0, r.iterations, r.residual);
    ProbeOptions path, plain;
    path.contribution = cached.contribution = plain.contribution = s.contribution;
    path.rays = s.referenceRays;
    path.seed = 1001;
    const Field a = measure(tracer, path, points);
    path.seed = 1002;
    const Reference ref = referenceOf(a, measure(tracer, path, points));
    double noise = 0;
    for (int c = 0; c < 3; ++c) {
        if (ref.mean[c] > 0) noise = std::max(noise, std::sqrt(ref.noise2[c]) / ref.mean[c]);
    }
    std::printf("reference: 2 x %d paths, noise %.3f%%, %.3f ms a point each\n", s.referenceRays,
        100 * noise, a.seconds * 1e3 / static_cast<double>(points.size()));
    if (s.solutions > 1) {
        compareSolutions(tracer, s, cached, points, ref);
        return 0;
    }
    const std::vector<Cost> pathCosts = curve("path", tracer, plain, s, points, ref);
    compare(pathCosts, curve("cached", tracer, cached, s, points, ref), solve);
    // The bias: two independent sets of many directions, whose common part is the bias.
    cached.rays = 8192;
    cached.seed = 11;
    const Field c = measure(tracer, cached, points);
    cached.seed = 12;
    const Reference many = referenceOf(c, measure(tracer, cached, points));
    const auto [rms, mean] = errorOf(many.values, ref);
    double own = 0;
    for (int k = 0; k < 3; ++k) {
        if (ref.mean[k] > 0) own = std::max(own, std::sqrt(many.noise2[k]) / ref.mean[k]);
    }
    std::printf("bias: rms %.3f%%, mean %+.3f%% (8192 rays, noise %.3f%%)\n",
        100 * std::sqrt(std::max(0.0, rms * rms - own * own)), 100 * mean, 100 * own);
    return 0;
}

} // namespace

int main(int argc, char** argv) { return runProgram(run, argc, argv); }
