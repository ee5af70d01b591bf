// SPDX-License-Identifier: Apache-2.0
/// What the light of surfaces is best kept in: the radiance cache's patches, a hashed grid of world
/// space or surfels, equally many and filled with the same light:
/// lumivdb_bench_surfaces SCENE [key=value ...], see usage().
///
/// Reflected irradiance, at places that rays from random points of the box meet. One set of them,
/// lit by the cached integrator with directions of their own, fills all three; another, lit by
/// paths, tests them. "As solved" is the cache as bakes use it, with the noise of its own rays.

#include "program.h"
#include "surface_contenders.h"

#include "cache_views.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/radiance_cache.h>
#include <lumivdb/core/random.h>

#include <tbb/enumerable_thread_specific.h>
#include <tbb/global_control.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

using namespace lumivdb;

namespace {

struct Settings {
    std::string scene, environment;
    Box3d bounds;
    std::size_t points = 4000, places = 8;
    int reference = 1024, directions = 64, threads = 1;
    RadianceCacheOptions cache;
};

int usage(const char* program)
{
    std::fprintf(stderr,
        "usage: %s SCENE [env=FILE] [bounds=x,y,z,x,y,z] [patches=16384, and a quarter of it]\n"
        "  [points=4000 to test at] [reference=1024 paths a point, twice] [threads=1]\n"
        "  [places=8 a patch to fill from] [directions=64 a place]\n",
        program);
    return 2;
}

bool parse(int argc, char** argv, Settings& s)
{
    if (argc < 2) return false;
    s.scene = argv[1];
    return readSettings(argc, argv,
        {{"env", setting(s.environment)}, {"bounds", setting(s.bounds)},
            {"points", setting(s.points)}, {"places", setting(s.places)},
            {"reference", setting(s.reference)}, {"directions", setting(s.directions)},
            {"threads", setting(s.threads)}, {"patches", setting(s.cache.patches)}});
}

/// What rays from random points of @a box meet.
Places seenPlaces(const Tracer& tracer, const Box3d& box, std::size_t count, std::uint64_t seed)
{
    const Tracer::Impl& impl = tracer.impl();
    Places places;
    for (std::uint64_t tries = 0; places.size() < count && tries < 100; ++tries) {
        for (const SeenPlace& p : lookAround(impl, box, count, hashCombine(seed, tries))) {
            const Vec3f front = impl.corners(p.triangle).areaVector();
            places.push_back(impl.surfaceAt(p.triangle, p.u, p.v, p.behind ? front : -front));
        }
    }
    places.resize(std::min(places.size(), count));
    return places;
}

/// Irradiance of all @a places; @a sets of directions, so that neighbours have others.
Values light(const Tracer& tracer, ProbeOptions options, const Places& places, std::size_t sets)
{
    options.contribution = Contribution::Indirect;
    const std::uint64_t seed = options.seed;
    std::vector<ProbeEstimator> estimators;
    estimators.reserve(sets);
    for (std::size_t i = 0; i < sets; ++i) {
        options.seed = hashCombine(seed, i);
        estimators.emplace_back(tracer, options);
    }
    tbb::enumerable_thread_specific<std::vector<ProbeEstimator::Workspace>> workspaces(
        [&] { return std::vector<ProbeEstimator::Workspace>(sets); });
    Values values(places.size());
    tbb::parallel_for(std::size_t{0}, places.size(), [&](std::size_t i) {
        const Vec3d p = Vec3d(places[i].leaving()) + tracer.impl().origin;
        values[i] = estimators[i % sets]
                        .irradiance(p, {places[i].normal}, hashCombine(seed, i),
                            workspaces.local()[i % sets])
                        .value[0];
    });
    return values;
}

/// Where @a count falls below @a wanted, as it does with the size.
template <class Count> float sizeFor(std::size_t wanted, float most, const Count& count)
{
    float low = most * 1e-5f, high = most;
    for (int i = 0; i < 16; ++i) {
        const float middle = std::sqrt(low * high);
        (count(middle) > wanted ? low : high) = middle;
    }
    return high;
}

/// The places to test at, what they receive twice over, and those whose light fills the records.
struct Test {
    Places places, fill;
    Values a, b, values[2];
    double mean = 0;
};

/// Against both halves of the reference, so that their noise is neither an error nor a leak.
struct Score {
    double square = 0, noisy = 0, wrong = 0, dark = 0, lit = 0, missed = 0;

    /// @a other: the same, filled with light of its own.
    template <class Lookup> Score(const Test& t, const Lookup& lookup, const Lookup& other)
    {
        const double each = 1 / static_cast<double>(t.places.size());
        for (std::size_t i = 0; i < t.places.size(); ++i) {
            const Answer answer = lookup(t.places[i]);
            const double v = static_cast<double>(luminance(answer.value)) / t.mean,
                         a = static_cast<double>(luminance(t.a[i])) / t.mean,
                         b = static_cast<double>(luminance(t.b[i])) / t.mean;
            const double w = static_cast<double>(luminance(other(t.places[i]).value)) / t.mean;
            square += each * ((v - a) * (w - b) + (v - b) * (w - a)) / 2;
            noisy += each * (v - a) * (v - b);
            wrong += std::min(v - a, v - b) > 0.5 || std::max(v - a, v - b) < -0.5 ? each : 0;
            missed += answer.missed ? each : 0;
            if (std::max(a, b) >= 0.01) continue;
            dark += each;
            lit += v > 0.05 ? each : 0;
        }
    }
};

/// Nanoseconds a lookup at places in no order, fastest of five.
template <class Lookup> double nanoseconds(const Places& places, const Lookup& lookup)
{
    using Clock = std::chrono::steady_clock;
    double best = 1e300;
    volatile float sink = 0;
    for (int again = 0; again < 5; ++again) {
        const auto start = Clock::now();
        Color sum(0.0f);
        for (const SurfacePoint& s : places) sum += lookup(s).value;
        sink = sum.x;
        best = std::min(best, std::chrono::duration<double>(Clock::now() - start).count());
    }
    static_cast<void>(sink);
    return best * 1e9 / static_cast<double>(places.size());
}

template <class Lookup>
void row(const char* name, const Test& t, std::size_t records, std::size_t bytes, const Lookup& f,
    const Lookup& other)
{
    const Score s(t, f, other);
    std::printf("| %s | %zu | %.0f | %.2f%% | %.2f%% | %.2f%% | ", name, records,
        static_cast<double>(bytes) / 1024, 100 * std::sqrt(std::max(0.0, s.square)),
        100 * std::sqrt(std::max(0.0, s.noisy)), 100 * s.wrong);
    // A share of fewer places says nothing.
    if (s.dark * static_cast<double>(t.places.size()) >= 20)
        std::printf("%.1f%%", 100 * s.lit / s.dark);
    else
        std::printf("–");
    std::printf(" | %.2f%% | %.0f |\n", 100 * s.missed, nanoseconds(t.fill, f));
    std::fflush(stdout);
}

void gridRow(const Test& t, std::size_t wanted, float most, bool between)
{
    const float side = sizeFor(wanted, most, [&](float h) { return Grid::count(t.fill, h); });
    const Grid grid(t.fill, t.values[0], side, between), other(t.fill, t.values[1], side, between);
    row(between ? "grid, interpolated" : "grid", t, Grid::count(t.fill, side), grid.bytes(), grid,
        other);
}

void surfelRow(const Test& t, std::size_t wanted, float most)
{
    const float radius = sizeFor(wanted, most, [&](float r) { return spread(t.fill, r).size(); });
    const std::vector<std::uint32_t> chosen = spread(t.fill, radius);
    const auto make = [&](int values, float reach, float cosine) {
        return Surfels(t.fill, t.values[values], chosen, reach * radius, cosine);
    };
    double best = 1e300;
    float reach = 1, cosine = kSameSide;
    for (const float r : {1.0f, 1.5f, 2.5f}) {
        for (const float c : {kSameSide, 0.95f}) {
            const Score s(t, make(0, r, c), make(1, r, c));
            if (s.square >= best) continue;
            best = s.square;
            reach = r;
            cosine = c;
        }
    }
    char name[64];
    std::snprintf(name, sizeof name, "surfels, reach %.1f, cos %.2f", static_cast<double>(reach),
        static_cast<double>(cosine));
    const Surfels surfels = make(0, reach, cosine);
    row(name, t, chosen.size(), surfels.bytes(), surfels, make(1, reach, cosine));
}

void compare(const Tracer& tracer, const Test& t, const RadianceCacheOptions& options)
{
    const Solved solved(tracer, options, 1), other(tracer, options, 2);
    const RadianceCacheReport& r = solved.cache().report();
    row("patches, as solved", t, r.patches, r.kept, solved, other);
    const Patches patches(solved, t.fill, t.values[0]), again(solved, t.fill, t.values[1]);
    row("patches", t, patches.count(), r.kept, patches, again);
    const auto most = static_cast<float>(tracer.impl().bounds.size().length());
    gridRow(t, patches.count(), most, false);
    gridRow(t, patches.count(), most, true);
    surfelRow(t, patches.count(), most);
}

Test makeTest(const Tracer& tracer, const Settings& s)
{
    Test t;
    t.places = seenPlaces(tracer, s.cache.box, s.points, 101);
    ProbeOptions path, cached;
    path.rays = s.reference;
    path.seed = 1001;
    t.a = light(tracer, path, t.places, 1);
    path.seed = 1002;
    t.b = light(tracer, path, t.places, 1);
    double noise = 0;
    const auto n = static_cast<double>(t.places.size());
    for (std::size_t i = 0; i < t.places.size(); ++i) {
        const auto a = static_cast<double>(luminance(t.a[i])),
                   b = static_cast<double>(luminance(t.b[i]));
        t.mean += (a + b) / (2 * n);
        noise += (a - b) * (a - b) / (2 * n);
    }
    cached.cache = std::make_shared<const RadianceCache>(tracer, s.cache);
    cached.rays = s.directions;
    t.fill = seenPlaces(tracer, s.cache.box, s.places * cached.cache->report().patches, 102);
    for (Values& values : t.values) {
        ++cached.seed;
        values = light(tracer, cached, t.fill, 256);
    }
    std::printf("%s: %zu places, noise of 2 x %d paths %.1f%% each; filled from %zu places\n\n",
        s.scene.c_str(), t.places.size(), s.reference, 100 * std::sqrt(noise) / t.mean,
        t.fill.size());
    return t;
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
    const Tracer tracer(scene);
    s.cache.box = s.bounds.isEmpty() ? scene->bounds() : s.bounds;
    const Test test = makeTest(tracer, s);
    std::printf("| representation | records | KiB | RMS error | with noise | off by half the mean "
                "| dark places "
                "lit | missed | ns |\n|---|---|---|---|---|---|---|---|---|\n");
    compare(tracer, test, s.cache);
    s.cache.patches /= 4;
    compare(tracer, test, s.cache);
    return 0;
}

} // namespace

int main(int argc, char** argv) { return runProgram(run, argc, argv); }
