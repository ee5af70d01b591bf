// SPDX-License-Identifier: Apache-2.0
/// Rays per second of the probe stage over those of bare Embree loops, on the same rays in the
/// same run, on one thread and on two:
/// lumivdb_bench_rays SCENE [ENVIRONMENT] [rays per point] [points] [repeats]

#include "free_points.h"
#include "program.h"

#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/ray_benchmark.h>
#include <lumivdb/core/error.h>

#include <cstdio>
#include <cstdlib>

using namespace lumivdb;

namespace {

constexpr int kThreads = 2;

/// Shares and rays per second of processor time: other programs' share of the machine cancels.
void report(const RayBenchmark& b, int threads, const RayBenchmark::Times& t)
{
    const auto million = [&](std::uint64_t n, const RayBenchmark::Time& time) {
        return static_cast<double>(n) * 1e-6 * threads / time.processor;
    };
    std::printf("%d thread%s: %.2f Mpaths/s; Mrays/s: probe stage %.2f, rtcIntersect1 %.2f, with "
                "rtcOccluded1 %.2f; shares %.2f %.2f\n",
        threads, threads > 1 ? "s" : "", million(b.paths, t.probe), million(b.rays, t.probe),
        million(b.rays, t.intersect1), million(b.rays, t.mixed),
        t.intersect1.processor / t.probe.processor, t.mixed.processor / t.probe.processor);
}

int run(int argc, char** argv)
{
    if (argc < 2) {
        std::fprintf(
            stderr, "usage: %s SCENE [ENVIRONMENT] [rays per point] [points] [repeats]\n", argv[0]);
        return 2;
    }
    auto scene = std::make_shared<Scene>(loadScene(argv[1]));
    std::vector<std::string> warnings;
    if (argc > 2 && argv[2][0]) scene->environment = Environment::load(argv[2], {}, warnings);
    ProbeOptions options;
    if (argc > 3) options.rays = std::atoi(argv[3]);
    const Tracer tracer(scene);
    const std::size_t points = argc > 4 ? std::strtoul(argv[4], nullptr, 10) : 100;
    const int repeats = argc > 5 ? std::atoi(argv[5]) : 5;
    const RayBenchmark b = benchmarkRays(
        tracer, options, 3, freePoints(tracer, scene->bounds(), points), repeats, kThreads);
    std::printf("%s: %.0f rays, %.0f%% shadow rays, relative stderr of E %.2f%% at %d rays\n",
        argv[1], static_cast<double>(b.rays), 100 * b.shadowShare, 100 * b.relativeStderr,
        options.rays);
    report(b, 1, b.one);
    report(b, kThreads, b.several);
    const auto scaling = [&](RayBenchmark::Time RayBenchmark::Times::*what) {
        const RayBenchmark::Time &one = b.one.*what, &several = b.several.*what;
        std::printf(
            " %.2f (%.2f)", one.wall / several.wall, kThreads * one.processor / several.processor);
    };
    std::printf("%d threads over one, wall (were all threads' time used):", kThreads);
    scaling(&RayBenchmark::Times::probe);
    scaling(&RayBenchmark::Times::intersect1);
    scaling(&RayBenchmark::Times::mixed);
    std::printf("\n");
    return 0;
}

} // namespace

int main(int argc, char** argv) { return runProgram(run, argc, argv); }
