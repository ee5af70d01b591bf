// SPDX-License-Identifier: Apache-2.0
/// What the light of surfaces is best kept in: the radiance cache's patches, a hashed grid of world
/// space or surfels, equally many and filled with the same light:
/// lumivdb_bench_surfaces SCENE [key=value ...], see usage().
///
/// Reflected irradiance, at places that rays from random points of the box meet. One set of them,
/// lit by the cached integrator with directions of their own, fills all three; another, lit by
/// paths, tests them. "As solved" is the cache as bakes use it, with the noise of its own rays.

#include "program.h"

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

using Places = std::vector<SurfacePoint>;
using Values = std::vector<Color>;

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
    for (int i = 2; i < argc; ++i) {
        const char* equals = std::strchr(argv[i], '=');
        if (!equals) return false;
        const std::string key(argv[i], static_cast<std::size_t>(equals - argv[i]));
        const char* value = equals + 1;
        if (key == "env")
            s.environment = value;
        else if (key == "bounds")
            s.bounds = parseBounds(value);
        else if (key == "points")
            s.points = static_cast<std::size_t>(std::atoll(value));
        else if (key == "places")
            s.places = static_cast<std::size_t>(std::atoll(value));
        else if (key == "reference")
            s.reference = std::atoi(value);
        else if (key == "directions")
            s.directions = std::atoi(value);
        else if (key == "threads")
            s.threads = std::atoi(value);
        else if (key == "patches")
            s.cache.patches = static_cast<std::size_t>(std::atoll(value));
        else
            return false;
    }
    return true;
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

struct Answer {
    Color value{0.0f};
    bool missed = true;
};

struct Record {
    Color sum{0.0f};
    float count = 0;

    void add(const Color& c)
    {
        sum += c;
        count += 1;
    }
    Color mean() const { return sum / std::max(count, 1.0f); }
};

/// Reflected light of a cache.
class Solved {
public:
    Solved(const Tracer& tracer, RadianceCacheOptions options, std::uint64_t seed)
    {
        options.seed = seed;
        mAll = std::make_shared<const RadianceCache>(tracer, options);
        options.maxBounces = 1; // keeps direct light alone, in the same patches
        mDirect = std::make_shared<const RadianceCache>(tracer, options);
    }
    const RadianceCache& cache() const { return *mAll; }
    Answer operator()(const SurfacePoint& s) const
    {
        const RadianceCache::Light l = mAll->at(s.triangle, s.u, s.v, s.behind);
        if (l.mixed) return {l.irradiance, false};
        return {l.irradiance - mDirect->at(s.triangle, s.u, s.v, s.behind).irradiance, false};
    }

private:
    std::shared_ptr<const RadianceCache> mAll, mDirect;
};

/// Those that no place fell into answer with what was solved.
class Patches {
public:
    Patches(const Solved& solved, const Places& places, const Values& values)
        : mSolved(solved)
    {
        for (std::size_t i = 0; i < places.size(); ++i) {
            const std::uint32_t id = patchOf(places[i]);
            if (id >= mRecords.size()) mRecords.resize(id + std::size_t{1});
            if (mRecords[id].count == 0) ++mCount;
            mRecords[id].add(values[i]);
        }
    }
    std::size_t count() const { return mCount; } ///< that a place fell into
    Answer operator()(const SurfacePoint& s) const
    {
        const std::uint32_t id = patchOf(s);
        if (id >= mRecords.size() || mRecords[id].count == 0) {
            return {mSolved(s).value, true};
        }
        return {mRecords[id].mean(), false};
    }

private:
    std::uint32_t patchOf(const SurfacePoint& s) const
    {
        return mSolved.cache().patchAt(s.triangle, s.u, s.v, s.behind);
    }
    const Solved& mSolved;
    std::vector<Record> mRecords;
    std::size_t mCount = 0;
};

Coord cellOf(const Vec3f& p, float side)
{
    return {static_cast<int>(std::floor(p.x / side)), static_cast<int>(std::floor(p.y / side)),
        static_cast<int>(std::floor(p.z / side))};
}

/// The normal's main axis and its sign.
std::uint64_t faceOf(const Vec3f& n)
{
    int axis = 0;
    for (int a = 1; a < 3; ++a) {
        if (std::abs(n[a]) > std::abs(n[axis])) axis = a;
    }
    return static_cast<std::uint64_t>(2 * axis + (n[axis] < 0 ? 1 : 0));
}

/// Cells of four sizes, each twice the one before; those above the first answer for empty ones.
class Grid {
public:
    static constexpr int kLevels = 4;

    Grid(const Places& places, const Values& values, float side, bool between)
        : mSide(side)
        , mBetween(between)
    {
        std::size_t capacity = 64, all = 0;
        for (int l = 0; l < kLevels; ++l) all += count(places, level(l));
        while (capacity < 2 * all) capacity *= 2;
        mTable.resize(capacity);
        for (std::size_t i = 0; i < places.size(); ++i) {
            for (int l = 0; l < kLevels; ++l) {
                const std::uint64_t k = keyOf(cellOf(places[i].position, level(l)), places[i], l);
                Entry& e = mTable[slot(k)];
                e.key = k;
                e.record.add(values[i]);
            }
        }
    }
    std::size_t bytes() const { return mTable.size() * sizeof(Entry); }

    static std::size_t count(const Places& places, float side)
    {
        std::vector<std::uint64_t> keys;
        for (const SurfacePoint& s : places) keys.push_back(keyOf(cellOf(s.position, side), s, 0));
        std::sort(keys.begin(), keys.end());
        return static_cast<std::size_t>(std::unique(keys.begin(), keys.end()) - keys.begin());
    }

    Answer operator()(const SurfacePoint& s) const
    {
        Answer a;
        if (mBetween && interpolate(s, a.value)) return {a.value, false};
        for (int l = 0; l < kLevels; ++l) {
            const Entry& e = mTable[slot(keyOf(cellOf(s.position, level(l)), s, l))];
            if (e.record.count > 0) return {e.record.mean(), l > 0};
        }
        return a;
    }

private:
    struct Entry {
        std::uint64_t key = 0;
        Record record;
    };
    float level(int l) const { return mSide * static_cast<float>(1 << l); }
    static std::uint64_t keyOf(const Coord& c, const SurfacePoint& s, int level)
    {
        return hashPoint(faceOf(s.normal) + 8 * static_cast<std::uint64_t>(level), c.x, c.y, c.z);
    }
    /// Of @a key, or the empty one where it would be.
    std::size_t slot(std::uint64_t key) const
    {
        std::size_t i = key & (mTable.size() - 1);
        while (mTable[i].record.count > 0 && mTable[i].key != key) {
            i = (i + 1) & (mTable.size() - 1);
        }
        return i;
    }
    /// Between the eight cells around, those that are empty left out.
    bool interpolate(const SurfacePoint& s, Color& value) const
    {
        const Vec3f p = s.position / mSide - Vec3f(0.5f);
        const Coord lower = cellOf(p, 1);
        const Vec3f t = p - Vec3f(lower);
        float sum = 0;
        for (int i = 0; i < 8; ++i) {
            const Coord step(i & 1, (i >> 1) & 1, i >> 2);
            const Entry& e = mTable[slot(keyOf(lower + step, s, 0))];
            if (e.record.count == 0) continue;
            float w = 1;
            for (int a = 0; a < 3; ++a) w *= step[a] ? t[a] : 1 - t[a];
            value += e.record.mean() * w;
            sum += w;
        }
        if (!(sum > 0)) return false;
        value /= sum;
        return true;
    }
    float mSide;
    bool mBetween;
    std::vector<Entry> mTable;
};

constexpr float kSameSide = 0.8f; ///< cosine between normals of a surfel and of what it may light

/// Places at least @a radius apart, and none further from all of them, where normals agree.
std::vector<std::uint32_t> spread(const Places& places, float radius)
{
    std::size_t buckets = 64;
    while (buckets < places.size()) buckets *= 2;
    std::vector<std::uint32_t> head(buckets, ~0u), next(places.size(), ~0u), kept;
    const auto bucket = [&](const Coord& c) { return hashPoint(0, c.x, c.y, c.z) & (buckets - 1); };
    for (std::uint32_t i = 0; i < places.size(); ++i) {
        const SurfacePoint& s = places[i];
        const Coord lower = cellOf(s.position - Vec3f(radius), 2 * radius);
        bool free = true;
        for (int k = 0; k < 8 && free; ++k) {
            const Coord cell = lower + Coord(k & 1, (k >> 1) & 1, k >> 2);
            for (std::uint32_t j = head[bucket(cell)]; j != ~0u && free; j = next[j]) {
                free = (places[j].position - s.position).length2() >= radius * radius
                    || places[j].normal.dot(s.normal) < kSameSide;
            }
        }
        if (!free) continue;
        std::uint32_t& first = head[bucket(cellOf(s.position, 2 * radius))];
        next[i] = first;
        first = i;
        kept.push_back(i);
    }
    return kept;
}

class Surfels {
public:
    /// @a chosen of @a places, each with the mean light of those it is nearest to; looked for
    /// within @a reach.
    Surfels(const Places& places, const Values& values, const std::vector<std::uint32_t>& chosen,
        float reach, float cosine)
        : mReach(reach)
        , mCosine(cosine)
    {
        while (mBuckets < chosen.size()) mBuckets *= 2;
        for (const std::uint32_t i : chosen) {
            const Coord c = cellOf(places[i].position, 2 * reach);
            mSurfels.push_back({places[i].position, places[i].normal, {}, hashOf(c)});
        }
        const auto bucket = [&](const Surfel& s) { return s.cell & (mBuckets - 1); };
        std::sort(mSurfels.begin(), mSurfels.end(), [&](const Surfel& a, const Surfel& b) {
            return std::make_pair(bucket(a), a.cell) < std::make_pair(bucket(b), b.cell);
        });
        mStart.assign(mBuckets + 1, 0);
        for (const Surfel& s : mSurfels) ++mStart[bucket(s) + 1];
        for (std::size_t b = 0; b < mBuckets; ++b) mStart[b + 1] += mStart[b];
        for (std::size_t i = 0; i < places.size(); ++i) {
            float nearest = reach * reach;
            Surfel* found = nullptr;
            around(places[i], [&](const Surfel& s, float d2) {
                if (d2 > nearest) return;
                nearest = d2;
                found = const_cast<Surfel*>(&s);
            });
            if (found) found->light.add(values[i]);
        }
    }
    std::size_t bytes() const
    {
        return mSurfels.size() * sizeof(Surfel) + mStart.size() * sizeof(std::uint32_t);
    }

    Answer operator()(const SurfacePoint& s) const
    {
        Color sum(0.0f);
        float weights = 0;
        around(s, [&](const Surfel& other, float d2) {
            const float t = 1 - d2 / (mReach * mReach), w = t * t + 1e-6f;
            sum += other.light.mean() * w;
            weights += w;
        });
        if (!(weights > 0)) return {};
        return {sum / weights, false};
    }

private:
    struct Surfel {
        Vec3f position, normal;
        Record light;
        std::uint32_t cell;
    };
    static std::uint32_t hashOf(const Coord& c)
    {
        return static_cast<std::uint32_t>(hashPoint(0, c.x, c.y, c.z));
    }
    /// Surfels within reach whose normals agree and that lie in about the same plane.
    template <class Each> void around(const SurfacePoint& s, const Each& each) const
    {
        const Coord lower = cellOf(s.position - Vec3f(mReach), 2 * mReach);
        for (int k = 0; k < 8; ++k) {
            const std::uint32_t cell = hashOf(lower + Coord(k & 1, (k >> 1) & 1, k >> 2));
            const std::size_t b = cell & (mBuckets - 1);
            for (std::uint32_t i = mStart[b]; i < mStart[b + 1]; ++i) {
                const Surfel& other = mSurfels[i];
                const Vec3f d = other.position - s.position;
                if (other.cell != cell || d.length2() > mReach * mReach) continue;
                if (other.normal.dot(s.normal) < mCosine) continue;
                if (std::abs(d.dot(s.normal)) <= mReach / 2) each(other, d.length2());
            }
        }
    }
    float mReach, mCosine;
    std::size_t mBuckets = 64;
    std::vector<Surfel> mSurfels; ///< by bucket
    std::vector<std::uint32_t> mStart; ///< of the buckets; one more at the end
};

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
