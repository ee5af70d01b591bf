// SPDX-License-Identifier: Apache-2.0
/// Analytic gradients against central differences: what they cost and how wrong they are.
///
/// lumivdb_bench_gradients SCENE [ENVIRONMENT] [--rays N] [--bands N] [--points N]
///     [--reference-rays N] [--spacing H] [--front] [--bounds=x0,y0,z0,x1,y1,z1]
///
/// Random points of free space, half of them near surfaces (closer than 5% of the box's shortest
/// side), half away from them (farther than 10%). The reference is a central difference with many
/// rays and a step of its own, once more with half the step: what the two differ by is its own
/// error. Errors are of all coefficients, axes and channels of a probe, over the reference's norm.

#include "program.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/bake/environment.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

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
    int rays = 1024, bands = 3, points = 12, referenceRays = 1 << 18;
    double spacing = 0;
    bool front = false;
    Box3d bounds;
};

double secondsSince(std::chrono::steady_clock::time_point start)
{
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

double norm2(const std::vector<Color>& a)
{
    double sum = 0;
    for (const Color& c : a) sum += Vec3d(c).length2();
    return sum;
}

double distance2(const std::vector<Color>& a, const std::vector<Color>& b)
{
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) sum += (Vec3d(a[i]) - Vec3d(b[i])).length2();
    return sum;
}

/// Σ A_l² |d_lm|² / 4π over channels: the mean squared irradiance of a difference.
double irradianceNorm2(int bands, const std::vector<Color>& d)
{
    double sum = 0;
    for (int i = 0; i < coefficientCount(bands); ++i) {
        const double a = kCosineLobe[static_cast<std::size_t>(degreeOf(i))];
        sum += a * a * Vec3d(d[static_cast<std::size_t>(i)]).length2() / (4 * 3.14159265358979);
    }
    return sum;
}

struct Point {
    Vec3d position;
    double nearest = 0;
};

/// Free-space points at most @a most or at least @a least from the nearest surface.
std::vector<Point> findPoints(
    const Tracer& tracer, const Box3d& box, int count, double least, double most, std::uint64_t key)
{
    ProbeOptions look;
    look.rays = 256;
    look.contribution = Contribution::Direct;
    const ProbeEstimator estimator(tracer, look);
    ProbeEstimator::Workspace workspace;
    std::vector<Point> points;
    CounterRng rng(key);
    const double far = box.size().length();
    for (int tries = 0; static_cast<int>(points.size()) < count && tries < 200000; ++tries) {
        Point p;
        for (int a = 0; a < 3; ++a) {
            p.position[a] = box.min[a] + rng.nextDouble() * (box.max[a] - box.min[a]);
        }
        p.nearest = far;
        tracer.closestSurface(p.position, far, &p.nearest, nullptr);
        if (p.nearest < least || p.nearest > most) continue;
        // Not inside geometry, and not in the dark, where nothing can be said in per cent.
        const ProbeResult seen = estimator.radianceSh(p.position, 1, 1, workspace);
        if (seen.validity > 0.9f && luminance(seen.value[0]) > 0) points.push_back(p);
    }
    return points;
}

/// Central differences once with as many rays a projection, once in the time of the analytic ones.
enum Method { kNone, kCentral, kCentralEqual, kAnalytic, kMethods };

/// Sums over the points of one class.
struct Errors {
    double reference2 = 0, disagreement2 = 0;
    double error2[kMethods] = {};
    std::vector<double> relative[kMethods];
    double truth2 = 0, moved2[2 * kMethods] = {}; // of irradiance a step away; limited ones after
};

class Comparison {
public:
    Comparison(const Tracer& tracer, const Settings& settings)
        : mTracer(tracer)
        , mSettings(settings)
        , mEstimator(tracer, options(settings.rays, 1))
        , mFew(tracer, options(std::max(2, settings.rays / 7), 1))
        , mReference(tracer, options(settings.referenceRays, 99))
    {
    }

    void add(const Point& point, std::uint64_t key, Errors& errors)
    {
        const double step = std::min(mSettings.spacing / 8, point.nearest / 4);
        const std::vector<Color> reference = richardson(point.position, step, key, errors);
        errors.reference2 += norm2(reference);
        for (const Method m : {kNone, kCentral, kCentralEqual, kAnalytic}) {
            ProbeResult r = measure(point.position, m, key);
            if (m == kNone) r.gradient.assign(reference.size(), Color(0.0f));
            const double e = distance2(r.gradient, reference);
            errors.error2[m] += e;
            errors.relative[m].push_back(std::sqrt(e / norm2(reference)));
            mResults[m] = r;
        }
        move(point, key, errors);
    }

private:
    static ProbeOptions options(int rays, std::uint64_t seed)
    {
        ProbeOptions o;
        o.rays = rays;
        o.seed = seed;
        return o;
    }

    ProbeResult measure(const Vec3d& p, Method method, std::uint64_t key)
    {
        const bool few = method == kCentralEqual;
        const ProbeEstimator& estimator = few ? mFew : mEstimator;
        ProbeEstimator::Workspace& workspace = few ? mFewWork : mWorkspace;
        ProbeResult r
            = estimator.radianceSh(p, mSettings.bands, key, workspace, method == kAnalytic);
        if (method == kCentral || method == kCentralEqual) {
            centralGradient(
                mTracer, estimator, p, mSettings.bands, mSettings.spacing, key, workspace, r);
        }
        return r;
    }

    std::vector<Color> difference(const Vec3d& p, double step, std::uint64_t key)
    {
        ProbeResult r;
        for (int a = 0; a < 3; ++a) {
            Vec3d d(0.0);
            d[a] = step;
            const auto up = mReference.radianceSh(p + d, mSettings.bands, key, mReferenceWork);
            const auto down = mReference.radianceSh(p - d, mSettings.bands, key, mReferenceWork);
            for (std::size_t k = 0; k < up.value.size(); ++k) {
                r.gradient.push_back(
                    (up.value[k] - down.value[k]) * static_cast<float>(0.5 / step));
            }
        }
        return r.gradient;
    }

    std::vector<Color> richardson(const Vec3d& p, double step, std::uint64_t key, Errors& errors)
    {
        std::vector<Color> whole = difference(p, step, key);
        const std::vector<Color> half = difference(p, 0.5 * step, key + 1);
        errors.disagreement2 += distance2(whole, half);
        for (std::size_t i = 0; i < whole.size(); ++i) whole[i] = (whole[i] + half[i]) * 0.5f;
        return whole;
    }

    /// Irradiance half a cell away, by Taylor, against a trace there with the same directions.
    void move(const Point& point, std::uint64_t key, Errors& errors)
    {
        CounterRng rng(key ^ 0x77);
        for (int i = 0; i < 8; ++i) {
            Vec3d d;
            for (int a = 0; a < 3; ++a) d[a] = (rng.nextDouble() - 0.5) * mSettings.spacing;
            if (mTracer.occluded(point.position, point.position + d)) continue;
            const ProbeResult truth
                = mEstimator.radianceSh(point.position + d, mSettings.bands, key, mWorkspace);
            errors.truth2 += irradianceNorm2(mSettings.bands, truth.value);
            for (int m = 0; m < 2 * kMethods; ++m) {
                ProbeResult r = mResults[m % kMethods];
                if (m >= kMethods) limitGradient(mSettings.spacing, r);
                errors.moved2[m] += taylorError2(r, d, truth);
            }
        }
    }

    double taylorError2(const ProbeResult& r, const Vec3d& d, const ProbeResult& truth) const
    {
        std::vector<Color> error(truth.value.size());
        for (std::size_t k = 0; k < error.size(); ++k) {
            error[k] = r.value[k] - truth.value[k];
            for (std::size_t a = 0; a < 3; ++a) {
                error[k] += r.gradient[a * error.size() + k]
                    * static_cast<float>(d[static_cast<int>(a)]);
            }
        }
        return irradianceNorm2(mSettings.bands, error);
    }

    const Tracer& mTracer;
    const Settings& mSettings;
    ProbeEstimator mEstimator, mFew, mReference;
    ProbeEstimator::Workspace mWorkspace, mFewWork, mReferenceWork;
    ProbeResult mResults[kMethods];
};

double median(std::vector<double> v)
{
    if (v.empty()) return 0;
    std::sort(v.begin(), v.end());
    return v[v.size() / 2];
}

void print(const char* where, const Errors& e, std::size_t points)
{
    if (points == 0) {
        std::printf("%-5s no such points\n", where);
        return;
    }
    const double reference = std::sqrt(e.reference2);
    std::printf("%-5s %3zu points; reference differs from itself by %.1f%%\n", where, points,
        100 * std::sqrt(e.disagreement2) / reference);
    static const char* const names[] = {"none", "central", "central at rays/7", "analytic"};
    for (int m = 0; m < kMethods; ++m) {
        std::printf("  %-17s gradient error: all %6.1f%%  median %6.1f%%   Taylor "
                    "error of E, half a cell away %6.2f%%  limited %6.2f%%\n",
            names[m], 100 * std::sqrt(e.error2[m]) / reference, 100 * median(e.relative[m]),
            100 * std::sqrt(e.moved2[m] / e.truth2),
            100 * std::sqrt(e.moved2[m + kMethods] / e.truth2));
    }
}

/// Bake-like timing, one thread: the same points without and with gradients, in turn.
void printTimes(const Tracer& tracer, const Settings& s, const std::vector<Point>& points)
{
    ProbeOptions o;
    o.rays = s.rays;
    const ProbeEstimator estimator(tracer, o);
    ProbeEstimator::Workspace workspace;
    double best[kMethods] = {1e30, 1e30, 1e30, 1e30};
    for (int round = 0; round < 5; ++round) {
        for (const Method m : {kNone, kAnalytic, kCentral}) {
            const auto start = std::chrono::steady_clock::now();
            for (std::size_t i = 0; i < points.size(); ++i) {
                ProbeResult r = estimator.radianceSh(
                    points[i].position, s.bands, i, workspace, m == kAnalytic);
                if (m != kCentral) continue;
                centralGradient(
                    tracer, estimator, points[i].position, s.bands, s.spacing, i, workspace, r);
            }
            best[m] = std::min(best[m], secondsSince(start));
        }
    }
    std::printf("time over none: analytic %.3f, central %.2f (none: %.2f ms/probe)\n",
        best[kAnalytic] / best[kNone], best[kCentral] / best[kNone],
        1e3 * best[kNone] / static_cast<double>(points.size()));
}

bool parseNumber(const std::string& name, const char* text, Settings& s)
{
    if (name == "--rays")
        s.rays = std::atoi(text);
    else if (name == "--bands")
        s.bands = std::atoi(text);
    else if (name == "--points")
        s.points = std::atoi(text);
    else if (name == "--reference-rays")
        s.referenceRays = std::atoi(text);
    else if (name == "--spacing")
        s.spacing = std::atof(text);
    else if (name == "--bounds") {
        Vec3d &a = s.bounds.min, &b = s.bounds.max;
        return std::sscanf(text, "%lf,%lf,%lf,%lf,%lf,%lf", &a.x, &a.y, &a.z, &b.x, &b.y, &b.z)
            == 6;
    } else
        return false;
    return true;
}

bool parse(int argc, char** argv, Settings& s)
{
    for (int i = 1; i < argc; ++i) {
        if (std::strncmp(argv[i], "--bounds=", 9) == 0) {
            if (!parseNumber("--bounds", argv[i] + 9, s)) return false;
        } else if (std::strcmp(argv[i], "--front") == 0) {
            s.front = true;
        } else if (argv[i][0] == '-') {
            if (i + 1 >= argc || !parseNumber(argv[i], argv[i + 1], s)) return false;
            ++i;
        } else if (s.scene.empty()) {
            s.scene = argv[i];
        } else {
            s.environment = argv[i];
        }
    }
    return !s.scene.empty();
}

int run(int argc, char** argv)
{
    Settings s;
    if (!parse(argc, argv, s)) {
        std::fprintf(stderr,
            "usage: %s SCENE [ENVIRONMENT] [--rays N] [--bands N] [--points N] [--reference-rays "
            "N] [--spacing H] [--front] [--bounds=x0,y0,z0,x1,y1,z1]\n",
            argv[0]);
        return 2;
    }
    auto scene = std::make_shared<Scene>(loadScene(s.scene));
    if (s.front) {
        for (Material& m : scene->materials) m.emitsFrontOnly = true;
    }
    std::vector<std::string> warnings;
    if (!s.environment.empty()) scene->environment = Environment::load(s.environment, {}, warnings);
    if (s.bounds.isEmpty()) s.bounds = scene->bounds();
    if (s.spacing == 0) s.spacing = defaultSpacing(s.bounds);
    const Tracer tracer(scene);
    const Vec3d size = s.bounds.size();
    const double room = std::min({size.x, size.y, size.z});
    std::printf("%s: %d rays, %d bands, spacing %g\n", s.scene.c_str(), s.rays, s.bands, s.spacing);
    const auto nearPoints = findPoints(tracer, s.bounds, s.points, 0.002 * room, 0.05 * room, 1);
    const auto farPoints = findPoints(tracer, s.bounds, s.points, 0.1 * room, 1e30, 2);
    Comparison comparison(tracer, s);
    Errors nearErrors, farErrors;
    for (std::size_t i = 0; i < nearPoints.size(); ++i)
        comparison.add(nearPoints[i], i, nearErrors);
    for (std::size_t i = 0; i < farPoints.size(); ++i) comparison.add(farPoints[i], i, farErrors);
    print("near", nearErrors, nearPoints.size());
    print("far", farErrors, farPoints.size());
    printTimes(tracer, s, farPoints.empty() ? nearPoints : farPoints);
    return 0;
}

} // namespace

int main(int argc, char** argv) { return runProgram(run, argc, argv); }
