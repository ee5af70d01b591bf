// SPDX-License-Identifier: Apache-2.0
/// Nanoseconds a query: irradiance for a position and a normal, three bands RGB, on one thread and
/// on two: lumivdb_bench_queries [VOLUME.vdb]
///
/// All contenders take turns in one run; the median of their turns counts. Time is that of the
/// thread on a processor, of two threads the longer, so that other programs disturb less. Beside
/// the time: how many times faster than one grid a coefficient sampled with OpenVDB's BoxSampler
/// (with gradients: 36 grids), and the largest difference to a reference in double precision,
/// relative to its mean.

#include "query_contenders.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <functional>
#include <string>
#include <thread>

#include <time.h>

using namespace query_bench;

namespace {

constexpr std::size_t kPoints = 1 << 17;
constexpr std::size_t kNaivePoints = 1 << 13;
constexpr std::size_t kChecked = 2000;
constexpr int kRounds = 7;
constexpr std::size_t kLine = 256;

/// Time that this thread has spent on a processor.
double threadSeconds()
{
    timespec t{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

struct Points {
    std::vector<Vec3d> p;
    std::vector<Vec3f> n;
};

Vec3d inCell(const IrradianceVolume& v, CellId id, CounterRng& rng)
{
    const Cell& cell = v.cell(id);
    Vec3d p(cell.origin);
    for (int a = 0; a < 3; ++a) p[a] += rng.nextDouble() * (1 << cell.level);
    return p * v.indexToWorld();
}

Vec3f direction(CounterRng& rng)
{
    const float z = 2 * rng.next() - 1, phi = 6.2831853f * rng.next();
    const float r = std::sqrt(std::max(0.0f, 1 - z * z));
    return {r * std::cos(phi), r * std::sin(phi), z};
}

/// Random: every cell as likely as any other. Coherent: straight lines of kLine points, a quarter
/// of a lattice step apart.
Points makePoints(const IrradianceVolume& v, bool coherent)
{
    Points points;
    CounterRng rng(coherent ? 1 : 2);
    const Box3d box = v.worldBounds();
    while (points.p.size() < kPoints) {
        const auto id = static_cast<CellId>(rng.bits() % v.cellCount());
        Vec3d p = inCell(v, id, rng);
        const Vec3f n = direction(rng);
        const Vec3d step = Vec3d(direction(rng)) * (0.25 * v.spacing());
        for (std::size_t k = 0; k < (coherent ? kLine : 1); ++k, p += step) {
            if (!box.intersects(p)) break;
            QueryInfo info;
            points.p.push_back(p);
            points.n.push_back(coherent ? n : direction(rng));
        }
    }
    points.p.resize(kPoints);
    points.n.resize(kPoints);
    return points;
}

struct Contender {
    std::string name;
    std::size_t points;
    /// Returns the longest time of its threads, or 0 where it has none of its own.
    std::function<double(std::size_t, const Vec3d*, const Vec3f*, Color*)> run;
    std::vector<double> times{};
    double median() const
    {
        std::vector<double> t = times;
        std::nth_element(t.begin(), t.begin() + static_cast<std::ptrdiff_t>(t.size() / 2), t.end());
        return t[t.size() / 2];
    }
};

double nanoseconds(const Contender& c, const Points& points, Color* E)
{
    const double start = threadSeconds();
    double longest = c.run(c.points, points.p.data(), points.n.data(), E);
    if (longest == 0) longest = threadSeconds() - start;
    return longest * 1e9 / static_cast<double>(c.points);
}

/// Largest |E − reference| over the mean of |reference|.
double largestError(const Contender& c, const Points& points, const std::vector<Vec3d>& reference)
{
    std::vector<Color> E(kChecked);
    c.run(kChecked, points.p.data(), points.n.data(), E.data());
    double mean = 0, largest = 0;
    for (std::size_t i = 0; i < kChecked; ++i) {
        mean += reference[i].length() / kChecked;
        largest = std::max(largest, (Vec3d(E[i]) - reference[i]).length());
    }
    return largest / mean;
}

void addSamplers(std::vector<Contender>& all, const VolumeSampler& sampler, const char* precision)
{
    const std::string suffix = std::string(" ") + precision;
    all.push_back({"single" + suffix, kPoints,
        [&sampler](std::size_t count, const Vec3d* p, const Vec3f* n, Color* E) {
            for (std::size_t i = 0; i < count; ++i) E[i] = sampler.irradiance(p[i], n[i]);
            return 0.0;
        }});
    all.push_back({"batch" + suffix, kPoints,
        [&sampler](std::size_t count, const Vec3d* p, const Vec3f* n, Color* E) {
            sampler.irradiance(count, p, n, E);
            return 0.0;
        }});
    all.push_back({"batch" + suffix + ", 2 threads", kPoints,
        [&sampler](std::size_t count, const Vec3d* p, const Vec3f* n, Color* E) {
            const std::size_t half = count / 2;
            double first = 0;
            std::thread other([&] {
                const double start = threadSeconds();
                sampler.irradiance(half, p, n, E);
                first = threadSeconds() - start;
            });
            const double start = threadSeconds();
            sampler.irradiance(count - half, p + half, n + half, E + half);
            const double second = threadSeconds() - start;
            other.join();
            return std::max(first, second);
        }});
}

/// Naive grids and dense arrays are of @a uniform and asked at its points, the sampler at those of
/// @a volume.
void measure(const char* title, const IrradianceVolume& volume, const IrradianceVolume& uniform,
    bool gradients, bool coherent, bool reference)
{
    const Interpolation mode = gradients ? Interpolation::Gradient : Interpolation::Trilinear;
    const Points points = makePoints(volume, coherent), others = makePoints(uniform, coherent);
    const NaiveGrids naive(uniform, gradients);
    const DenseArray denseFloat(uniform, gradients, Precision::Float),
        denseHalf(uniform, gradients, Precision::Half);
    const VolumeSampler full(volume, mode), half(volume, {mode, Precision::Half, 0});
    std::vector<Contender> all;
    const auto of = [](const auto& contender) {
        return [&contender](std::size_t count, const Vec3d* p, const Vec3f* n, Color* E) {
            contender.irradiance(count, p, n, E);
            return 0.0;
        };
    };
    all.push_back({gradients ? "36 grids" : "9 grids, BoxSampler", kNaivePoints, of(naive)});
    all.push_back({"dense array float", kPoints, of(denseFloat)});
    all.push_back({"dense array half", kPoints, of(denseHalf)});
    const std::size_t first = all.size();
    addSamplers(all, full, "float");
    addSamplers(all, half, "half");
    std::vector<Color> E(kPoints);
    for (int round = 0; round <= kRounds; ++round)
        for (std::size_t c = 0; c < all.size(); ++c) {
            const double t = nanoseconds(all[c], c < first ? others : points, E.data());
            if (round > 0) all[c].times.push_back(t); // the first warms up
        }
    std::vector<Vec3d> expected(kChecked), expectedOthers(kChecked);
    for (std::size_t i = 0; i < kChecked && reference; ++i) {
        expected[i] = referenceIrradiance(volume, gradients, points.p[i], points.n[i]);
        expectedOthers[i] = referenceIrradiance(uniform, gradients, others.p[i], others.n[i]);
    }
    std::printf("\n%s, %s, %s\n", title, gradients ? "gradients" : "no gradients",
        coherent ? "coherent" : "random");
    const double base = all[0].median();
    for (std::size_t c = 0; c < all.size(); ++c) {
        std::printf("  %-28s %8.1f ns %7.1fx", all[c].name.c_str(), all[c].median(),
            base / all[c].median());
        if (reference) {
            std::printf("   error %.1e",
                largestError(
                    all[c], c < first ? others : points, c < first ? expectedOthers : expected));
        }
        std::printf("\n");
    }
    const double dense[2] = {all[1].median(), all[2].median()};
    std::printf("  batch over dense: float %.2f, half %.2f; two threads: float %.2fx, half %.2fx\n",
        all[first + 1].median() / dense[0], all[first + 4].median() / dense[1],
        all[first + 1].median() / all[first + 2].median(),
        all[first + 4].median() / all[first + 5].median());
}

void run(int argc, char** argv)
{
    for (const bool gradients : {false, true}) {
        const IrradianceVolume uniform = uniformVolume(gradients);
        if (argc > 1) {
            const IrradianceVolume given = lumivdb::loadVolume(argv[1]);
            if (gradients && !given.hasGradients()) continue;
            for (const bool coherent : {false, true})
                measure(argv[1], given, uniform, gradients, coherent, false);
            continue;
        }
        const IrradianceVolume adaptive = adaptiveVolume(gradients);
        if (!gradients) {
            const auto levels = adaptive.cellsByLevel();
            std::printf("uniform: %zu samples; adaptive: %zu samples, cells by level:",
                uniform.sampleCount(), adaptive.sampleCount());
            for (const std::size_t n : levels) std::printf(" %zu", n);
            const auto start = std::chrono::steady_clock::now();
            const VolumeSampler u(uniform);
            const auto middle = std::chrono::steady_clock::now();
            const VolumeSampler a(adaptive);
            const auto end = std::chrono::steady_clock::now();
            const auto ms
                = [](auto t) { return std::chrono::duration<double, std::milli>(t).count(); };
            std::printf("\ncompiling: %.1f ms, %.1f ms; %.1f MB, %.1f MB\n", ms(middle - start),
                ms(end - middle), static_cast<double>(u.memoryBytes()) * 1e-6,
                static_cast<double>(a.memoryBytes()) * 1e-6);
        }
        for (const bool coherent : {false, true}) {
            measure("uniform", uniform, uniform, gradients, coherent, true);
            measure("adaptive", adaptive, uniform, gradients, coherent, true);
        }
    }
}

} // namespace

int main(int argc, char** argv)
{
    try {
        run(argc, argv);
        return 0;
    } catch (const lumivdb::Error& e) {
        std::fprintf(stderr, "lumivdb_bench_queries: %s\n", e.what());
        return 1;
    }
}
