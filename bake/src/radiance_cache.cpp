// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/radiance_cache.h>

#include "cache_views.h"
#include "direct_light.h"
#include "directions.h"
#include "path.h"
#include "surface_patches.h"

#include <lumivdb/core/error.h>

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <cmath>

namespace lumivdb {

namespace {

constexpr float kPi = 3.14159265358979323846f;
/// Rays of a patch while it is decided which ones to divide.
constexpr int kScouts = 16, kFewScouts = 3;
/// Rays of the smallest patches when it is solved.
constexpr int kLeast = 8;
/// Times that new patches send scouts of their own.
constexpr int kRounds = 2;
/// Scouts that must come near a patch before it is divided.
constexpr std::uint32_t kEnough = 4;
/// Patches are not divided for contrast below this share of the size they began with.
constexpr float kSmallest = 1 / 8.0f;
/// As RadianceCacheOptions::nearness, of rays from the probes' box.
constexpr double kViewNearness = 1 / 8.0;
/// A patch that one of them meets sends as many rays as this share of a patch of full size.
constexpr double kViewShare = 1 / 4.0;
constexpr int kMaxIterations = 10000;
/// Pieces of surfaces that do not hang together share patches where they are more than this many
/// times as many as patches are asked for.
constexpr std::size_t kPiecesPerPatch = 8;
/// Places of a patch count by how much of their view is free for so many of its sides.
constexpr float kOpenPatches = 3;
/// Emitter samples at a place, per deviation of direct light over its mean, and at most.
constexpr double kEmitterSamples = 4;
constexpr int kMostEmitterSamples = 8;

/// A patch's light comes from @a patch, times albedo and the place's weight in 1/65535.
struct Link {
    std::uint32_t patch;
    std::uint16_t albedo[3];
};

struct Worker {
    explicit Worker(const Tracer::Impl& impl)
        : paths(std::make_unique<PathTracer>(impl, options))
        , batch(std::make_unique<PathBatchResult>())
    {
    }
    Worker(const Worker&) = delete;
    Worker& operator=(const Worker&) = delete;
    ProbeOptions options;
    std::unique_ptr<PathTracer> paths;
    std::unique_ptr<PathBatchResult> batch;
    SurfacePoint points[kBatch];
    GatherDraw draws[kBatch];
    std::uint64_t rays = 0;

    void gather(int count, int emitterSamples)
    {
        paths->gather(points, draws, count, emitterSamples, *batch);
        rays += batch->traced;
    }
};

} // namespace

struct RadianceCache::Impl {
    Impl(const Tracer::Impl& impl, double size, std::size_t most)
        : patches(impl, size, most)
    {
    }
    SurfacePatches patches;
    std::vector<Light> light; ///< by patch
};

class CacheSolver {
public:
    CacheSolver(const Tracer& tracer, RadianceCache& cache, Progress* progress)
        : mTracer(tracer.impl())
        , mOptions(cache.mOptions)
        , mReport(cache.mReport)
        , mProgress(progress)
    {
        cache.mImpl = std::make_unique<RadianceCache::Impl>(mTracer, startSize(),
            std::min(mOptions.maxPatches / 2, kPiecesPerPatch * mOptions.patches));
        mPatches = &cache.mImpl->patches;
        limitPieces(undivided().size());
        lookFromBox();
        divide();
        gather();
        iterate();
        finish(cache.mImpl->light);
    }

private:
    using Id = SurfacePatches::Id;

    double startSize()
    {
        double area = 0;
        for (std::uint32_t i = 0; i < mTracer.triangleCount; ++i) {
            const double once = static_cast<double>(mTracer.corners(i).areaVector().length()) / 2;
            area += mTracer.materialOf(i).doubleSided ? 2 * once : once;
        }
        mSize = std::sqrt(area / static_cast<double>(mOptions.patches));
        return mSize;
    }

    std::vector<Id> undivided(Id from = 0) const
    {
        std::vector<Id> ids;
        for (Id id = from; id < mPatches->size(); ++id) {
            if (!mPatches->divided(id)) ids.push_back(id);
        }
        return ids;
    }

    /// Takes rays(i) samples of every patch ids[i], by any thread. @a each(i, worker, first, seen):
    /// its samples are worker.batch's from `first` on, what they saw begins at `seen`.
    template <class Rays, class Each>
    void sample(const std::vector<Id>& ids, const Rays& rays, const Each& each)
    {
        // Blocks are the same for any number of threads, so the same rays share a packet.
        constexpr std::size_t kBlock = 64;
        const std::size_t blocks = (ids.size() + kBlock - 1) / kBlock;
        tbb::enumerable_thread_specific<std::unique_ptr<Worker>> workers;
        std::atomic<bool> stop{false};
        if (mProgress) mProgress->begin("light of the surfaces", ids.size());
        tbb::parallel_for(std::size_t{0}, blocks, [&](std::size_t block) {
            auto& worker = workers.local();
            if (!worker) worker = std::make_unique<Worker>(mTracer);
            if (stop || (mProgress && mProgress->cancelled())) {
                stop = true;
                return;
            }
            const std::size_t last = std::min(ids.size(), (block + 1) * kBlock);
            for (std::size_t i = block * kBlock; i < last;) {
                const std::size_t first = i;
                int count = 0;
                for (; i < last && count + rays(i) <= kBatch; ++i) {
                    place(ids[i], rays(i), count, *worker);
                    count += rays(i);
                }
                worker->gather(count, mEmitterSamples);
                auto seen = worker->paths->seen().begin();
                count = 0;
                for (std::size_t k = first; k < i; ++k) {
                    const int end = count + rays(k);
                    const auto begin = seen;
                    while (seen != worker->paths->seen().end() && seen->from < end) ++seen;
                    each(k, *worker, count, begin, seen);
                    count = end;
                }
            }
            if (mProgress) mProgress->advance(last - block * kBlock);
        });
        if (stop) throw Error(ErrorCode::Interrupted, "The bake was interrupted.");
        for (const auto& worker : workers) mReport.rays += worker->rays;
    }

    /// Places, and on the emitters, by a Kronecker sequence of the generalised golden ratio,
    /// directions along a Hilbert curve over the hemisphere, so that neighbouring rays are alike;
    /// all shifted at random.
    void place(Id id, int rays, int first, Worker& w) const
    {
        constexpr int kDimensions = 6;
        constexpr double kGolden = 1.1127756842787055; // x⁷ = x + 1
        const std::uint64_t key = hashCombine(
            hashCombine(mOptions.seed, static_cast<std::uint64_t>(rays)), mPatches->key(id));
        CounterRng rng(key);
        double x[kDimensions], step[kDimensions];
        for (int d = 0; d < kDimensions; ++d) {
            x[d] = rng.nextDouble();
            step[d] = d == 0 ? 1 / kGolden : step[d - 1] / kGolden;
        }
        for (int k = 0; k < rays; ++k) {
            const Vec2f square(static_cast<float>(x[0]), static_cast<float>(x[1]));
            w.points[first + k] = mPatches->sample(id, square, static_cast<float>(x[2]));
            w.draws[first + k].square = Vec2f(hilbertPoint((k + rng.nextDouble()) / rays));
            w.draws[first + k].emitter = Vec3d(x[3], x[4], x[5]);
            w.draws[first + k].around.x = rng.nextDouble();
            w.draws[first + k].around.y = rng.nextDouble();
            w.draws[first + k].reach = mReach * mPatches->extent(id);
            w.draws[first + k].key = hashCombine(key, static_cast<std::uint64_t>(k));
            for (int d = 0; d < kDimensions; ++d) {
                x[d] += step[d];
                if (x[d] >= 1) x[d] -= 1;
            }
        }
    }

    DirectLight directOf(Id id, int first, int rays, const Worker& w) const
    {
        DirectLight d;
        for (int k = first; k < first + rays; ++k) {
            d.add(mPatches->quarterOf(id, w.points[k].position),
                static_cast<double>(luminance(w.batch->uniform[k])),
                static_cast<double>(luminance(w.batch->emitter[k])));
        }
        return d;
    }

    /// Divides what the probes' box sees much of. As many rays as there are patches of full size:
    /// where the box sees all surfaces alike, each has one or so and nothing is cut.
    void lookFromBox()
    {
        const Box3d& box = mOptions.box.isEmpty() ? mTracer.bounds : mOptions.box;
        mViews = lookAround(mTracer, box, mOptions.patches, mOptions.seed);
        mReport.rays += mOptions.patches;
        std::vector<SeenPlace> near = mViews;
        divideNear(near, kViewNearness);
        countViews();
    }

    void countViews()
    {
        mViewsOf.assign(mPatches->size(), 0);
        for (const SeenPlace& view : mViews) {
            const Id id = patchOf(view);
            if (id != SurfacePatches::kNone) ++mViewsOf[id];
        }
    }

    /// How much a patch matters, in patches of full size: in proportion to its area, as what other
    /// surfaces see of it is, or to what the box sees.
    double share(Id id) const
    {
        return std::max(mPatches->area(id) / (mSize * mSize), kViewShare * mViewsOf[id]);
    }

    void divide()
    {
        std::vector<Id> fresh = undivided();
        for (int round = 0; round < kRounds && !fresh.empty() && !mReport.full; ++round) {
            std::vector<DirectLight> direct(fresh.size());
            std::vector<std::vector<SeenPlace>> near(fresh.size());
            const auto scouts = [&](std::size_t i) { return scoutsOf(fresh[i]); };
            sample(fresh, scouts, [&](std::size_t i, Worker& w, int at, auto seen, auto end) {
                direct[i] = directOf(fresh[i], at, scouts(i), w);
                for (; seen != end; ++seen) {
                    const SeenPlace n{
                        seen->triangle, seen->u, seen->v, seen->distance, seen->behind};
                    if (isNear(n, mOptions.nearness)) near[i].push_back(n);
                }
            });
            if (round == 0) learnDirect(fresh, direct);
            for (const auto& n : near) mNear.insert(mNear.end(), n.begin(), n.end());
            mMade.clear();
            const auto first = static_cast<Id>(mPatches->size());
            for (std::size_t i = 0; i < fresh.size(); ++i) {
                const bool large = mViewsOf[fresh[i]] > 0
                    || mPatches->extent(fresh[i]) > kSmallest * static_cast<float>(mSize);
                if (large && direct[i].changes(mSceneMean)) cut(fresh[i]);
            }
            divideNear(mNear, mOptions.nearness);
            countViews();
            std::vector<Id> next = mMade;
            const std::vector<Id> added = undivided(first);
            next.insert(next.end(), added.begin(), added.end());
            std::sort(next.begin(), next.end());
            next.erase(std::unique(next.begin(), next.end()), next.end());
            fresh.clear();
            for (const Id id : next) {
                if (!mPatches->divided(id)) fresh.push_back(id);
            }
        }
        mNear = std::vector<SeenPlace>();
    }

    void limitPieces(std::size_t pieces) const
    {
        if (pieces <= mOptions.maxPatches) return;
        throw Error(ErrorCode::Input,
            "The radiance cache would need " + std::to_string(pieces)
                + " patches to begin with, the limit is " + std::to_string(mOptions.maxPatches)
                + ": the scene's triangles do not hang together and are not small. Use the path "
                  "integrator.");
    }

    /// The scene's mean of direct light, and from its noise how many emitter samples a place needs.
    void learnDirect(const std::vector<Id>& ids, const std::vector<DirectLight>& direct)
    {
        double sum = 0, area = 0, variance = 0;
        for (std::size_t i = 0; i < ids.size(); ++i) {
            sum += mPatches->area(ids[i]) * direct[i].mean();
            area += mPatches->area(ids[i]);
            variance += mPatches->area(ids[i]) * direct[i].variance();
        }
        if (!(sum > 0)) return;
        mSceneMean = sum / area;
        mEmitterSamples = std::clamp(
            static_cast<int>(kEmitterSamples * std::sqrt(variance / area) / mSceneMean), 1,
            kMostEmitterSamples);
    }

    Id patchOf(const SeenPlace& n) const { return mPatches->find(n.triangle, n.u, n.v, n.behind); }
    bool isNear(const SeenPlace& n, double nearness) const
    {
        const Id id = patchOf(n);
        return id != SurfacePatches::kNone
            && mPatches->extent(id) > nearness * static_cast<double>(n.distance);
    }

    /// Divides what enough of @a rays come near, level by level; drops those that do not.
    void divideNear(std::vector<SeenPlace>& rays, double nearness)
    {
        std::vector<std::uint32_t> count;
        for (bool more = true; more && !mReport.full;) {
            // Patches only shrink: a ray that is no longer near never is again.
            rays.erase(std::remove_if(rays.begin(), rays.end(),
                           [&](const SeenPlace& n) { return !isNear(n, nearness); }),
                rays.end());
            count.assign(mPatches->size(), 0);
            for (const SeenPlace& n : rays) ++count[patchOf(n)];
            more = false;
            for (Id id = 0; id < count.size(); ++id) {
                if (count[id] >= kEnough) more = cut(id) || more;
            }
        }
    }

    bool cut(Id id)
    {
        if (mPatches->size() + 4 > mOptions.maxPatches) {
            mReport.full = true;
            return false;
        }
        if (!mPatches->divide(id)) return false;
        mMade.push_back(id); // a group keeps its number for one of its halves
        return true;
    }

    /// Rows of the system: direct light, and where the rest comes from.
    void gather()
    {
        mIds = undivided();
        mReach = kOpenPatches;
        mRow.assign(mPatches->size(), 0);
        for (std::size_t i = 0; i < mIds.size(); ++i) mRow[mIds[i]] = static_cast<std::uint32_t>(i);
        mDirect.assign(mIds.size(), Color(0.0f));
        mMixed.assign(mIds.size(), 0);
        mWeight.assign(mIds.size(), 0);
        mFirstLink.assign(mIds.size() + 1, 0);
        for (std::size_t i = 0; i < mIds.size(); ++i) {
            mFirstLink[i + 1] = mFirstLink[i] + static_cast<std::size_t>(raysOf(mIds[i]));
        }
        mLinks.assign(mFirstLink.back(), Link{0, {0, 0, 0}});
        const auto rays = [&](std::size_t i) { return raysOf(mIds[i]); };
        sample(mIds, rays, [&](std::size_t i, Worker& w, int at, auto seen, auto end) {
            const std::vector<float> weights = weightsOf(w, at, rays(i));
            Color sum(0.0f);
            for (int k = 0; k < rays(i); ++k) {
                const float weight = weights[static_cast<std::size_t>(k)];
                sum += w.batch->uniform[at + k] * weight;
                mWeight[i] += weight;
            }
            if (mWeight[i] > 0) mDirect[i] = sum * (kPi / mWeight[i]);
            mMixed[i] = directOf(mIds[i], at, rays(i), w).changes(mSceneMean);
            for (; seen != end; ++seen) {
                const Id id = mPatches->find(seen->triangle, seen->u, seen->v, seen->behind);
                const auto from = static_cast<std::size_t>(seen->from - at);
                if (id == SurfacePatches::kNone) continue;
                Link& link = mLinks[mFirstLink[i] + from];
                link.patch = mRow[id];
                for (int c = 0; c < 3; ++c) {
                    link.albedo[c] = static_cast<std::uint16_t>(
                        std::lround(seen->albedo[c] * weights[from] * 65535.0f));
                }
            }
        });
    }

    /// What the places of a patch count: nothing inside solids, elsewhere as much as they lie open.
    /// What looks at the patch from afar sees little of those that something hides, as the light
    /// goes both ways. Where all are hidden, all count alike.
    static std::vector<float> weightsOf(const Worker& w, int first, int count)
    {
        std::vector<float> open(static_cast<std::size_t>(count)), outside = open;
        float sum = 0;
        for (int k = 0; k < count; ++k) {
            const auto i = static_cast<std::size_t>(k);
            outside[i] = w.batch->backFace[first + k] ? 0.0f : 1.0f;
            open[i] = outside[i] * w.batch->open[first + k];
            sum += open[i];
        }
        return sum > 0 ? open : outside;
    }

    int scoutsOf(Id id) const
    {
        return std::clamp(
            static_cast<int>(std::ceil(std::min(1.0, share(id)) * kScouts)), kFewScouts, kScouts);
    }
    int raysOf(Id id) const
    {
        return std::clamp(static_cast<int>(std::ceil(std::min(1.0, share(id)) * mOptions.rays)),
            kLeast, mOptions.rays);
    }

    /// T E of one row.
    Color reflected(std::size_t row, const std::vector<Color>& light) const
    {
        Color sum(0.0f);
        for (std::size_t k = mFirstLink[row]; k < mFirstLink[row + 1]; ++k) {
            const Link& link = mLinks[k];
            const Color& e = light[link.patch];
            for (int c = 0; c < 3; ++c) sum[c] += static_cast<float>(link.albedo[c]) * e[c];
        }
        return mWeight[row] > 0 ? sum * (1 / (65535.0f * mWeight[row])) : Color(0.0f);
    }

    void iterate()
    {
        mLight = mDirect;
        std::vector<Color> next(mLight.size());
        const bool all = mOptions.maxBounces < 0;
        const int last = all ? kMaxIterations : std::max(0, mOptions.maxBounces - 1);
        for (int i = 0; i < last && !mLight.empty(); ++i) {
            tbb::parallel_for(tbb::blocked_range<std::size_t>(0, next.size(), 1024),
                [&](const tbb::blocked_range<std::size_t>& range) {
                    for (std::size_t r = range.begin(); r != range.end(); ++r) {
                        next[r] = reflected(r, mLight);
                    }
                });
            mReport.iterations = i + 1;
            if (advance(next, all) && all) break;
            if (mProgress && mProgress->cancelled()) {
                throw Error(ErrorCode::Interrupted, "The bake was interrupted.");
            }
        }
    }

    /// mLight becomes D + T E (@a reflected is T E). With @a scale, E is multiplied first by what
    /// makes its residual vanish over all surfaces together: nearly closed, nearly white rooms then
    /// need no more iterations than others. @return whether the solution is good enough.
    bool advance(const std::vector<Color>& reflected, bool scale)
    {
        Vec3d direct(0.0), kept(0.0);
        double worst = 0;
        for (std::size_t r = 0; r < mLight.size(); ++r) {
            const double area = mPatches->area(mIds[r]);
            for (int c = 0; c < 3; ++c) {
                const double d = static_cast<double>(mDirect[r][c]),
                             e = static_cast<double>(mLight[r][c]),
                             t = static_cast<double>(reflected[r][c]);
                direct[c] += area * d;
                kept[c] += area * (e - t);
                if (e > 0) worst = std::max(worst, std::abs(e - t - d) / e);
            }
        }
        mReport.residual = worst;
        if (mReport.residual <= mOptions.residual && scale) return true;
        Color factor(1.0f);
        for (int c = 0; c < 3 && scale; ++c) {
            if (kept[c] > 1e-6 * direct[c]) factor[c] = static_cast<float>(direct[c] / kept[c]);
        }
        for (std::size_t r = 0; r < mLight.size(); ++r) {
            mLight[r] = mDirect[r] + factor * reflected[r];
        }
        return false;
    }

    void finish(std::vector<RadianceCache::Light>& light)
    {
        light.assign(mPatches->size(), {Color(0.0f), 0, false});
        for (std::size_t r = 0; r < mIds.size(); ++r) {
            const bool mixed = mMixed[r] != 0;
            light[mIds[r]]
                = {mixed ? mLight[r] - mDirect[r] : mLight[r], mPatches->extent(mIds[r]), mixed};
            mReport.mixed += mixed ? 1 : 0;
        }
        mReport.patches = mIds.size();
        mReport.joined = mPatches->joined();
        mReport.kept = light.size() * sizeof(RadianceCache::Light) + mPatches->bytes();
        mReport.bytes
            = mLinks.size() * sizeof(Link) + mIds.size() * (3 * sizeof(Color) + 17) + mReport.kept;
    }

    const Tracer::Impl& mTracer;
    const RadianceCacheOptions& mOptions;
    RadianceCacheReport& mReport;
    Progress* mProgress;
    SurfacePatches* mPatches = nullptr;
    double mSize = 0, mSceneMean = 0;
    int mEmitterSamples = 1;
    float mReach = 0; ///< of the rays that look what hides a place, in sides of its patch
    std::vector<SeenPlace> mViews; ///< from the probes' box
    std::vector<std::uint32_t> mViewsOf; ///< their number, by patch
    std::vector<SeenPlace> mNear; ///< what scouts met near
    std::vector<Id> mMade; ///< divided in this round
    std::vector<Id> mIds; ///< by row
    std::vector<std::uint32_t> mRow; ///< by patch
    std::vector<Color> mDirect, mLight; ///< by row
    std::vector<std::uint8_t> mMixed;
    std::vector<float> mWeight; ///< of all its places, by row
    std::vector<std::size_t> mFirstLink; ///< by row; one more at the end
    std::vector<Link> mLinks;
};

std::size_t RadianceCacheOptions::patchesFor(double probes, double rays)
{
    constexpr double kShare = 1.0 / 12, kFewest = 512, kMost = 65536;
    return static_cast<std::size_t>(std::clamp(kShare * rays * std::sqrt(probes), kFewest, kMost));
}

void RadianceCacheOptions::validate() const
{
    const auto check = [](bool good, const char* field, double value, const char* range) {
        if (good) return;
        throw Error(ErrorCode::Usage,
            std::string("radiance cache: ") + field + " is " + std::to_string(value) + "; take "
                + range + ".");
    };
    constexpr std::size_t kMost = std::size_t{1} << 24;
    check(maxBounces >= -1, "maxBounces", maxBounces, "0 or more, or -1 for no limit");
    check(patches >= 64 && patches <= kMost, "patches", static_cast<double>(patches), "64 to 2^24");
    check(maxPatches >= 64 && maxPatches <= 16 * kMost, "maxPatches",
        static_cast<double>(maxPatches), "64 to 2^28");
    check(rays >= 8 && rays <= kBatch, "rays", rays, "8 to 256");
    check(nearness > 0, "nearness", nearness, "a positive number");
    check(residual > 0, "residual", residual, "a positive number");
    for (int a = 0; a < 3; ++a) {
        check(box.isEmpty() || std::isfinite(box.max[a] - box.min[a]), "box",
            box.max[a] - box.min[a], "a finite one");
    }
}

RadianceCache::RadianceCache(
    const Tracer& tracer, const RadianceCacheOptions& options, Progress* progress)
    : mOptions(options)
{
    mOptions.validate();
    const auto start = std::chrono::steady_clock::now();
    CacheSolver(tracer, *this, progress);
    mReport.seconds
        = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

RadianceCache::~RadianceCache() = default;

std::uint32_t RadianceCache::patchAt(std::uint32_t triangle, float u, float v, bool behind) const
{
    return mImpl->patches.find(triangle, u, v, behind);
}

RadianceCache::Light RadianceCache::at(std::uint32_t triangle, float u, float v, bool behind) const
{
    const SurfacePatches::Id id = patchAt(triangle, u, v, behind);
    return id == SurfacePatches::kNone ? Light{Color(0.0f), 0, false} : mImpl->light[id];
}

} // namespace lumivdb
