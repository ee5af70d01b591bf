// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/probe.h>

#include "directions.h"
#include "gradient.h"
#include "path.h"

#include <lumivdb/core/error.h>

#include <tbb/blocked_range.h>
#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <mutex>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;
/// Strata a chunk: sums of chunks are added in order, so chunks may be traced by any thread.
constexpr int kChunk = 4096;
constexpr int kMaxRays = 1 << 26;
/// Sets of directions: the first, and each doubles their number.
constexpr int kMaxSets = 26;
/// Sets of more directions are made for a point and not kept.
constexpr int kMaxKept = 1 << 16;
/// Chunks in flight: bounds the memory of what they bring back.
constexpr std::size_t kWave = 256;

/// Sums over consecutive strata for all basis functions.
struct Sums {
    std::vector<double> sum, differences2; // [basis function * 3 + channel]
    std::uint64_t strata = 0, differences = 0, backFaces = 0, traced = 0;
    double inverseDistance = 0;
    float minDistance = std::numeric_limits<float>::infinity();

    void reset(std::size_t functions)
    {
        *this = Sums();
        sum.assign(functions * 3, 0.0);
        differences2.assign(functions * 3, 0.0);
    }
    void add(const Sums& o)
    {
        for (std::size_t i = 0; i < sum.size(); ++i) {
            sum[i] += o.sum[i];
            differences2[i] += o.differences2[i];
        }
        strata += o.strata;
        differences += o.differences;
        backFaces += o.backFaces;
        traced += o.traced;
        inverseDistance += o.inverseDistance;
        minDistance = std::min(minDistance, o.minDistance);
    }
};

struct ShFunctions {
    int bands;
    int count() const { return coefficientCount(bands); }
    void eval(int n, const float* x, const float* y, const float* z, float* out) const
    {
        evalShBasisBatch(bands, static_cast<std::size_t>(n), x, y, z, out);
    }
};

struct CosineFunctions {
    const std::vector<Vec3f>& normals;
    int count() const { return static_cast<int>(normals.size()); }
    void eval(int n, const float* x, const float* y, const float* z, float* out) const
    {
        for (const Vec3f& normal : normals) {
            for (int i = 0; i < n; ++i) {
                out[i] = std::max(0.0f, normal.x * x[i] + normal.y * y[i] + normal.z * z[i]);
            }
            out += n;
        }
    }
};

struct ShAndCosineFunctions {
    ShFunctions sh;
    CosineFunctions cosines;
    int count() const { return sh.count() + cosines.count(); }
    void eval(int n, const float* x, const float* y, const float* z, float* out) const
    {
        sh.eval(n, x, y, z, out);
        cosines.eval(n, x, y, z, out + sh.count() * n);
    }
};

/// Scratch of one thread. Big: lives on the heap.
struct Scratch {
    Scratch(const Tracer::Impl& impl, const ProbeOptions& options)
        : paths(impl, options)
    {
    }
    PathTracer paths;
    PathBatchResult batch;
    std::vector<float> uniformBasis, emitterBasis; // [function][stratum of the batch]
    std::vector<float> previous; // last stratum's value, as Sums::sum
    Sums sums;
};

/// Scratch for gradients.
struct GradientScratch {
    const GradientTables* tables = nullptr;
    int bands = 0;
    std::vector<GradientCollector> chunks; ///< of one wave
    GradientSums sums;
};

template <class Basis> void accumulate(const Basis& basis, int n, bool firstOfChunk, Scratch& w)
{
    PathBatchResult& b = w.batch;
    const auto functions = static_cast<std::size_t>(basis.count());
    w.uniformBasis.resize(functions * kBatch);
    w.emitterBasis.resize(functions * kBatch);
    const VectorBatch& to = b.emitterDirection;
    basis.eval(n, b.rays.dx, b.rays.dy, b.rays.dz, w.uniformBasis.data());
    basis.eval(n, to.x, to.y, to.z, w.emitterBasis.data());
    // f_i = 4π L(ω_i) y(ω_i) + L(ω'_i)/p y(ω'_i)
    for (float* const channel : b.uniform.channel) {
        for (int i = 0; i < n; ++i) channel[i] *= static_cast<float>(4 * kPi);
    }
    sumStrata(
        {n, basis.count(), &b.uniform, &b.emitter, w.uniformBasis.data(), w.emitterBasis.data(),
            !firstOfChunk, w.previous.data(), w.sums.sum.data(), w.sums.differences2.data()});
    w.sums.strata += static_cast<std::uint64_t>(n);
    w.sums.differences += static_cast<std::uint64_t>(firstOfChunk ? n - 1 : n);
    w.sums.traced += b.traced;
    for (int i = 0; i < n; ++i) { // what met nothing is infinitely far away
        w.sums.backFaces += b.backFace[i] ? 1 : 0;
        w.sums.inverseDistance += 1.0 / std::max(b.hits.t[i], 1e-30f);
        w.sums.minDistance = std::min(w.sums.minDistance, b.hits.t[i]);
    }
}

/// What all chunks of a point have in common.
struct Shot {
    const Tracer::Impl& impl;
    const ProbeOptions& options;
    const std::vector<Vec3f>& directions;
    const std::vector<ProbeStrata>& strata;
    Vec3f p;
    std::uint64_t key;
};

/// A_l² / 4π for every coefficient.
std::array<double, kMaxCoefficients> irradianceWeights()
{
    std::array<double, kMaxCoefficients> w;
    for (int i = 0; i < kMaxCoefficients; ++i) {
        const double a = kCosineLobe[static_cast<std::size_t>(degreeOf(i))];
        w[static_cast<std::size_t>(i)] = a * a / (4 * kPi);
    }
    return w;
}

template <class Basis>
void traceChunk(const Shot& shot, const Basis& basis, std::size_t first,
    GradientCollector* gradient, Scratch& w)
{
    const std::size_t last = std::min(shot.directions.size(), first + kChunk);
    w.sums.reset(static_cast<std::size_t>(basis.count()));
    w.previous.assign(w.sums.sum.size(), 0.0f);
    w.batch.wantPlanes = gradient != nullptr;
    for (std::size_t i = first; i < last; i += kBatch) {
        const int n = static_cast<int>(std::min<std::size_t>(kBatch, last - i));
        w.paths.trace(
            shot.p, shot.directions.data() + i, shot.strata[i / kBatch], i, n, shot.key, w.batch);
        if (gradient) gradient->collect(w.batch, i, n);
        accumulate(basis, n, i == first, w);
    }
}

/// All strata, in waves of chunks; within a wave any thread may trace any chunk.
template <class Basis>
Sums traceChunks(const Shot& shot, const Basis& basis, Scratch& own, GradientScratch* gradient)
{
    const std::size_t chunks = (shot.directions.size() + kChunk - 1) / kChunk;
    Sums total;
    total.reset(static_cast<std::size_t>(basis.count()));
    if (gradient) gradient->chunks.resize(std::min(chunks, kWave));
    tbb::enumerable_thread_specific<std::unique_ptr<Scratch>> scratch;
    for (std::size_t wave = 0; wave < chunks; wave += kWave) {
        const std::size_t count = std::min(kWave, chunks - wave);
        std::vector<Sums> parts(count);
        const auto trace = [&](std::size_t c, Scratch& w) {
            GradientCollector* collector = gradient ? &gradient->chunks[c] : nullptr;
            if (collector) {
                collector->reset(*gradient->tables, gradient->bands, gradient->sums.cells());
            }
            traceChunk(shot, basis, (wave + c) * kChunk, collector, w);
            parts[c] = w.sums;
        };
        if (count == 1) {
            trace(0, own);
        } else {
            tbb::parallel_for(std::size_t{0}, count, [&](std::size_t c) {
                auto& local = scratch.local();
                if (!local) local = std::make_unique<Scratch>(shot.impl, shot.options);
                trace(c, *local);
            });
        }
        for (const Sums& part : parts) total.add(part);
        for (std::size_t c = 0; gradient && c < count; ++c) gradient->sums.add(gradient->chunks[c]);
    }
    return total;
}

/// Point, spot and directional lights: one direction each, no noise.
template <class Basis>
void addPunctual(const std::vector<PunctualSample>& samples, const Tracer::Impl& impl,
    const Vec3f& p, const Basis& basis, std::vector<double>& values, GradientSums* gradient)
{
    std::vector<float> y(static_cast<std::size_t>(basis.count()));
    for (std::size_t l = 0; l < samples.size(); ++l) {
        const PunctualSample& s = samples[l];
        if (s.irradiance == Color(0.0f)) continue;
        if (gradient) {
            const Light& light = impl.scene->lights[l];
            gradient->addPunctual(light, impl.toLocal(light.position), p, s);
        }
        basis.eval(1, &s.direction.x, &s.direction.y, &s.direction.z, y.data());
        for (std::size_t k = 0; k < y.size(); ++k) {
            for (int c = 0; c < 3; ++c) {
                values[k * 3 + static_cast<std::size_t>(c)]
                    += static_cast<double>(s.irradiance[c]) * y[k];
            }
        }
    }
}

/// Adds a set of directions that all sets before, of @a all, have left room for. Noise: the new
/// ones lie as dense as all before together, so a direction's part is known from them alone.
void addSet(ProbeResult& all, const ProbeResult& added)
{
    const auto n = static_cast<double>(all.directions), m = static_cast<double>(added.directions);
    const double wn = n / (n + m), wm = m / (n + m);
    const auto mix = [&](std::vector<Color>& a, const std::vector<Color>& b) {
        for (std::size_t i = 0; i < a.size(); ++i) {
            a[i] = a[i] * static_cast<float>(wn) + b[i] * static_cast<float>(wm);
        }
    };
    mix(all.value, added.value);
    mix(all.gradient, added.gradient);
    for (std::size_t i = 0; i < all.stderr_.size(); ++i) {
        all.stderr_[i] = added.stderr_[i] * static_cast<float>(std::sqrt(wm));
    }
    all.validity = static_cast<float>(wn * all.validity + wm * added.validity);
    const double inverse
        = wn / static_cast<double>(all.distance) + wm / static_cast<double>(added.distance);
    all.distance
        = inverse > 0 ? static_cast<float>(1 / inverse) : std::numeric_limits<float>::infinity();
    all.minDistance = std::min(all.minDistance, added.minDistance);
    all.rays += added.rays;
    all.directions += added.directions;
}

/// Standard error of E, RMS over normals, worst channel: over the mean irradiance, and over that or
/// the point's own where it has more.
struct Noise {
    double ofMean = 0, ofOwn = 0;
};

Noise noiseOf(const ProbeResult& r, int bands, const StopRule& stop)
{
    const Vec3d variance = irradianceNorm2(bands, r.stderr_.data());
    const Vec3d own2 = irradianceNorm2(bands, r.value.data());
    Noise noise;
    for (int c = 0; c < 3; ++c) {
        const double mean = stop.meanE[c], deviation = std::sqrt(variance[c]);
        if (!(mean > 0)) continue;
        noise.ofMean = std::max(noise.ofMean, deviation / mean);
        noise.ofOwn = std::max(noise.ofOwn, deviation / std::max(mean, std::sqrt(own2[c])));
    }
    return noise;
}

/// Whether @a directions would be enough where noise falls as by chance from that of @a r.
bool isEnough(double directions, const ProbeResult& r, const Noise& noise, const StopRule& stop)
{
    if (2 * directions > stop.most) return true;
    const double root = std::sqrt(static_cast<double>(r.directions)); // N >= perDeviation σ
    return noise.ofOwn * root <= stop.tolerance * std::sqrt(directions)
        && directions >= stop.perDeviation * noise.ofMean * root;
}

bool isEnough(const ProbeResult& r, int bands, const StopRule& stop)
{
    return isEnough(static_cast<double>(r.directions), r, noiseOf(r, bands, stop), stop);
}

/// Values, errors and what the rays saw. The sums are means by now.
ProbeResult resultOf(const Sums& total, std::size_t strata)
{
    const auto count = static_cast<double>(strata);
    ProbeResult r;
    r.value.resize(total.sum.size() / 3);
    r.stderr_.resize(r.value.size());
    for (std::size_t k = 0; k < r.value.size(); ++k) {
        for (int c = 0; c < 3; ++c) {
            const std::size_t j = k * 3 + static_cast<std::size_t>(c);
            const double variance = total.differences2[j]
                / (2.0 * std::max<double>(1.0, static_cast<double>(total.differences)));
            r.value[k][c] = static_cast<float>(total.sum[j]);
            r.stderr_[k][c] = static_cast<float>(std::sqrt(variance / count));
        }
    }
    r.validity = static_cast<float>(1.0 - static_cast<double>(total.backFaces) / count);
    r.distance = total.inverseDistance > 0 ? static_cast<float>(count / total.inverseDistance)
                                           : std::numeric_limits<float>::infinity();
    r.minDistance = total.minDistance;
    r.rays = total.traced;
    r.directions = strata;
    return r;
}

} // namespace

const char* name(Contribution c)
{
    switch (c) {
    case Contribution::All:
        return "all";
    case Contribution::Direct:
        return "direct";
    case Contribution::Indirect:
        return "indirect";
    }
    return "all";
}

void ProbeOptions::validate() const
{
    if (rays < 2 || rays > kMaxRays) {
        throw Error(ErrorCode::Usage,
            "rays is " + std::to_string(rays) + "; take 2 to " + std::to_string(kMaxRays) + ".");
    }
    if (maxBounces < -1) {
        throw Error(ErrorCode::Usage,
            "maxBounces is " + std::to_string(maxBounces)
                + "; take 0 or more, or -1 for no limit.");
    }
}

struct ProbeEstimator::Workspace::Impl {
    std::unique_ptr<Scratch> scratch;
    std::unique_ptr<GradientScratch> gradient;
};

/// Directions, and what they have in common at all points.
struct ProbeEstimator::Set {
    std::vector<Vec3f> directions;
    std::vector<ProbeStrata> strata;

    Set(const Tracer::Impl& impl, const ProbeOptions& options, std::uint64_t seed, int number)
        : directions(stratifiedDirections(seed, options.rays, number))
        , strata(probeStrata(impl, options, seed, directions, number))
    {
    }
};

/// What points share. All is made by whichever thread asks first.
struct ProbeEstimator::Tables {
    template <class T> struct Once {
        std::once_flag flag;
        std::unique_ptr<const T> value;
        template <class Make> const T& get(const Make& make)
        {
            std::call_once(flag, [&] { value = alone(make); });
            return *value;
        }
    };
    /// Parallel work in between must not give this thread another point, which may wait for this.
    template <class Make> static auto alone(const Make& make)
    {
        return tbb::this_task_arena::isolate(make);
    }
    using Patterns = std::vector<Once<Set>>; // a set's, by pattern
    std::array<Patterns, kMaxSets> sets;
    std::array<Once<GradientTables>, kMaxSets> gradients; // by set
};

/// A point, local, and what all its sets of directions share.
struct ProbeEstimator::Place {
    Vec3f p;
    std::uint64_t key;
    SamplingPattern pattern;
    std::vector<PunctualSample> lights;
    std::uint64_t traced = 0; ///< shadow rays to the lights
};

ProbeEstimator::Workspace::Workspace()
    : mImpl(std::make_unique<Impl>())
{
}
ProbeEstimator::Workspace::~Workspace() = default;

ProbeEstimator::ProbeEstimator(const Tracer& tracer, const ProbeOptions& options)
    : mTracer(tracer)
    , mOptions(options)
{
    options.validate();
    mTables = std::make_shared<Tables>();
    const auto patterns = static_cast<std::size_t>(SamplingPattern::count(options.rays));
    for (Tables::Patterns& set : mTables->sets) set = Tables::Patterns(patterns);
}

ProbeEstimator::~ProbeEstimator() = default;

std::shared_ptr<const ProbeEstimator::Set> ProbeEstimator::set(
    const SamplingPattern& pattern, int number) const
{
    const auto make = [&] {
        return std::make_unique<const Set>(mTracer.impl(), mOptions, pattern.seed, number);
    };
    const double directions = std::ldexp(mOptions.rays, std::max(0, number - 1));
    if (number > 0 && directions > kMaxKept) return Tables::alone(make);
    Tables::Patterns& patterns = mTables->sets[static_cast<std::size_t>(number)];
    const Set& kept = patterns[static_cast<std::size_t>(pattern.number)].get(make);
    return {mTables, &kept};
}

ProbeEstimator::Place ProbeEstimator::placeAt(
    const Vec3d& world, std::uint64_t key, Workspace& workspace) const
{
    const Tracer::Impl& impl = mTracer.impl();
    Workspace::Impl& own = *workspace.mImpl;
    if (!own.scratch) own.scratch = std::make_unique<Scratch>(impl, mOptions);
    Place place{impl.toLocal(world), key, {mOptions.seed, key, mOptions.rays}, {}};
    if (mOptions.contribution == Contribution::Indirect) return place;
    place.lights.resize(impl.scene->lights.size());
    for (std::size_t first = 0; first < place.lights.size(); first += kBatch) {
        const std::size_t count = std::min<std::size_t>(kBatch, place.lights.size() - first);
        place.traced
            += own.scratch->paths.punctual(first, count, place.p, place.lights.data() + first);
    }
    return place;
}

template <class Basis>
ProbeResult ProbeEstimator::estimate(const Place& place, const Basis& basis, int number,
    Workspace& workspace, int gradientBands) const
{
    const std::shared_ptr<const Set> held = set(place.pattern, number);
    const Set& shared = *held;
    const Tracer::Impl& impl = mTracer.impl();
    Workspace::Impl& own = *workspace.mImpl;
    std::unique_ptr<GradientScratch> several;
    GradientScratch* gradient = nullptr;
    if (gradientBands > 0) {
        // While chunks are traced in parallel, this thread may be given another point with the same
        // workspace: what lives as long is not kept there.
        auto& kept = shared.directions.size() > kChunk ? several : own.gradient;
        if (!kept) kept = std::make_unique<GradientScratch>();
        gradient = kept.get();
        gradient->tables = &gradientTables(number, shared.directions.size());
        gradient->bands = gradientBands;
        gradient->sums.reset(*gradient->tables, gradientBands);
    }

    const std::uint64_t key
        = number == 0 ? place.key : hashCombine(place.key, static_cast<std::uint64_t>(number));
    const Shot shot{impl, mOptions, shared.directions, shared.strata, place.p, key};
    Sums total = traceChunks(shot, basis, *own.scratch, gradient);
    for (double& s : total.sum) s /= static_cast<double>(shared.directions.size());
    addPunctual(
        place.lights, impl, place.p, basis, total.sum, gradient ? &gradient->sums : nullptr);
    if (number == 0) total.traced += place.traced;
    ProbeResult r = resultOf(total, shared.directions.size());
    if (gradient) r.gradient = gradient->sums.finish();
    return r;
}

const GradientTables& ProbeEstimator::gradientTables(int number, std::size_t strata) const
{
    return mTables->gradients[static_cast<std::size_t>(number)].get([&] {
        const bool direct = mOptions.contribution != Contribution::Indirect;
        return std::make_unique<const GradientTables>(
            strata, direct ? mTracer.impl().scene->environment.get() : nullptr);
    });
}

ProbeResult ProbeEstimator::radianceSh(const Vec3d& p, int bands, std::uint64_t key,
    Workspace& workspace, bool analyticGradient, const StopRule& stop) const
{
    const ShFunctions basis{bands};
    const int gradientBands = analyticGradient ? bands : 0;
    const Place place = placeAt(p, key, workspace);
    ProbeResult r = estimate(place, basis, 0, workspace, gradientBands);
    for (int k = 1; k < kMaxSets && !isEnough(r, bands, stop); ++k) {
        addSet(r, estimate(place, basis, k, workspace, gradientBands));
    }
    return r;
}

std::uint64_t foreseenDirections(
    const ProbeResult& r, int bands, const StopRule& stop, std::uint64_t first)
{
    const Noise noise = noiseOf(r, bands, stop);
    std::uint64_t directions = first;
    while (!isEnough(static_cast<double>(directions), r, noise, stop)) directions *= 2;
    return directions;
}

ProbeResult ProbeEstimator::irradiance(const Vec3d& p, const std::vector<Vec3f>& normals,
    std::uint64_t key, Workspace& workspace) const
{
    return estimate(placeAt(p, key, workspace), CosineFunctions{normals}, 0, workspace, 0);
}

ProbeResult ProbeEstimator::radianceShAndIrradiance(const Vec3d& p, int bands,
    const std::vector<Vec3f>& normals, std::uint64_t key, Workspace& workspace) const
{
    const ShAndCosineFunctions basis{ShFunctions{bands}, CosineFunctions{normals}};
    return estimate(placeAt(p, key, workspace), basis, 0, workspace, 0);
}

Vec3d irradianceNorm2(int bands, const Color* d)
{
    static const std::array<double, kMaxCoefficients> weights = irradianceWeights();
    Vec3d sum(0.0);
    for (int i = 0; i < coefficientCount(bands); ++i) {
        const Vec3d v(d[i]);
        sum += v * v * weights[static_cast<std::size_t>(i)];
    }
    return sum;
}

} // namespace lumivdb
