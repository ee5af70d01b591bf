// SPDX-License-Identifier: Apache-2.0
/// Rays per second of the probe stage over Embree's own rtcIntersect1, on the same rays in the
/// same run: lumivdb_bench_rays SCENE [ENVIRONMENT] [rays per point]

#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/ray_benchmark.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <cstdio>
#include <cstdlib>

using namespace lumivdb;

namespace {

/// Free-space points of the scene's box.
std::vector<Vec3d> freePoints(const Tracer& tracer, std::size_t count)
{
    const Box3d box = tracer.scene().bounds();
    ProbeOptions look;
    look.rays = 64;
    look.contribution = Contribution::Direct;
    const ProbeEstimator estimator(tracer, look);
    ProbeEstimator::Workspace workspace;
    std::vector<Vec3d> points;
    CounterRng rng(1);
    for (std::size_t tries = 0; points.size() < count && tries < 100 * count; ++tries) {
        Vec3d p;
        for (int a = 0; a < 3; ++a) {
            p[a] = box.min[a] + rng.nextDouble() * (box.max[a] - box.min[a]);
        }
        if (estimator.radianceSh(p, 1, tries, workspace).validity > 0.9f) points.push_back(p);
    }
    return points;
}

int run(int argc, char** argv)
{
    if (argc < 2) {
        std::fprintf(stderr, "usage: %s SCENE [ENVIRONMENT] [rays per point]\n", argv[0]);
        return 2;
    }
    auto scene = std::make_shared<Scene>(loadScene(argv[1]));
    std::vector<std::string> warnings;
    if (argc > 2 && argv[2][0]) scene->environment = Environment::load(argv[2], {}, warnings);
    ProbeOptions options;
    if (argc > 3) options.rays = std::atoi(argv[3]);
    const Tracer tracer(scene);
    const RayBenchmark b = benchmarkRays(tracer, options, 3, freePoints(tracer, 100), 5);
    const double rays = static_cast<double>(b.rays);
    std::printf("scene                          %s\n", argv[1]);
    std::printf("rays, shadow share             %.0f, %.0f%%\n", rays, 100 * b.shadowShare);
    std::printf(
        "probe stage, Mrays/s           %.2f (relative stderr of E %.2f%% at %d rays a point)\n",
        rays / b.probeSeconds * 1e-6, 100 * b.relativeStderr, options.rays);
    std::printf("rtcIntersect1 alone, Mrays/s   %.2f\n", rays / b.intersect1Seconds * 1e-6);
    std::printf("  shadow rays by rtcOccluded1  %.2f\n", rays / b.mixedSeconds * 1e-6);
    std::printf("probe stage / rtcIntersect1    %.2f\n", b.intersect1Seconds / b.probeSeconds);
    std::printf("probe stage / with rtcOccluded1 %.2f\n", b.mixedSeconds / b.probeSeconds);
    return 0;
}

} // namespace

int main(int argc, char** argv)
{
    try {
        return run(argc, argv);
    } catch (const std::exception& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 3;
    }
}
