// SPDX-License-Identifier: Apache-2.0
//
// The vectorised arithmetic of paths against the same in double precision, path by path, for every
// remainder of a vector; and the same bits on every instruction set of this machine.
#include "../../bake/src/path_kernels.h"
#include "bake_makers.h"

#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/probe.h>
#include <lumivdb/bake/radiance_cache.h>

#include <catch2/catch.hpp>
#include <hwy/targets.h>

#include <functional>
#include <memory>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

Vec3f unitVector(CounterRng& rng)
{
    const double z = 2 * rng.nextDouble() - 1, phi = 2 * kPi * rng.nextDouble();
    const double r = std::sqrt(1 - z * z);
    return Vec3f(Vec3d(r * std::cos(phi), r * std::sin(phi), z));
}

Vec3f vectorIn(CounterRng& rng, float reach)
{
    return Vec3f(rng.next() - 0.5f, rng.next() - 0.5f, rng.next() - 0.5f) * (2 * reach);
}

std::unique_ptr<PathBatch> randomPaths(int count, CounterRng& rng)
{
    auto paths = std::make_unique<PathBatch>();
    paths->count = count;
    for (int i = 0; i < count; ++i) {
        paths->leaving.set(i, vectorIn(rng, 10));
        // The frame turns over at the poles.
        const float pole = i % 2 ? -1.0f : 1.0f;
        paths->normal.set(i, i % 16 < 2 ? Vec3f(0, 0, pole) : unitVector(rng));
        paths->albedo.set(i, Color(rng.next(), rng.next(), rng.next()));
        paths->throughput.set(i, Color(rng.next(), rng.next(), rng.next()));
        paths->stratum[i] = 255 - i;
    }
    return paths;
}

std::unique_ptr<EmitterBatch> randomEmitters(int count, CounterRng& rng)
{
    auto emitters = std::make_unique<EmitterBatch>();
    for (int i = 0; i < count; ++i) {
        EmitterPoint e;
        const bool infinite = i % 3 == 0;
        e.place = infinite ? unitVector(rng) : vectorIn(rng, 10);
        if (!infinite) e.normal = unitVector(rng);
        e.offset = infinite ? -1.0f : 1e-3f;
        e.twoSided = i % 2 == 0;
        e.density = i % 7 == 0 ? 0.0f : 0.1f + rng.next();
        e.radiance = Color(rng.next(), rng.next(), rng.next());
        emitters->set(i, e);
    }
    return emitters;
}

/// The way from @a p to an emitter, in double precision; pdf 0 where nothing comes.
struct ExactAim {
    Vec3d ray, direction;
    double pdf = 0;

    ExactAim(const EmitterBatch& e, int i, const Vec3d& p)
    {
        if (e.offset[i] < 0) {
            ray = direction = Vec3d(e.place[i]);
            pdf = static_cast<double>(e.density[i]);
            return;
        }
        const Vec3d n(e.normal[i]), place(e.place[i]);
        const double facing = n.dot(p - place);
        const double side = facing > 0 ? 1 : -1;
        ray = place + n * (side * static_cast<double>(e.offset[i])) - p;
        direction = ray / ray.length();
        const bool shines = facing > 0 || e.backShines[i] > 0;
        const double cosine = std::abs(n.dot(direction));
        if (shines) pdf = static_cast<double>(e.density[i]) * ray.length2() / cosine;
    }
};

bool near(const Vec3f& a, const Vec3d& b, double most = 2e-5)
{
    return (Vec3d(a) - b).length() <= most * std::max(1.0, b.length());
}

/// Calls @a work once for every instruction set there is. @return how many those are.
int onEachTarget(const std::function<void(const char*)>& work)
{
    int targets = 0;
    for (std::int64_t left = hwy::SupportedTargets(); left != 0; left &= left - 1) {
        hwy::SetSupportedTargetsForTest(left); // the best ones go first
        hwy::GetChosenTarget().Update(hwy::SupportedTargets());
        work(hwy::TargetName(left & -left));
        ++targets;
    }
    hwy::SetSupportedTargetsForTest(0);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    return targets;
}

} // namespace

TEST_CASE("Shadow rays to emitters: as in double precision, in order", "[kernels]")
{
    CounterRng rng(5);
    const auto direction = std::make_unique<VectorBatch>();
    const auto shadow = std::make_unique<ShadowBatch>();
    for (int count : {1, 7, 8, 61, kBatch}) {
        const auto paths = randomPaths(count, rng);
        const auto emitters = randomEmitters(count, rng);
        const Vec3f p = vectorIn(rng, 10);
        const double uniform = 1 / (4 * kPi);

        shadow->rays.count = 0;
        aimFrom(p, *emitters, count, *direction, *shadow);
        int next = 0, wrong = 0;
        for (int i = 0; i < count; ++i) {
            const ExactAim aim(*emitters, i, Vec3d(p));
            if (!(aim.pdf > 0)) {
                wrong += (*direction)[i] != Vec3f(0, 0, 1);
                continue;
            }
            const Vec3d value = Vec3d(emitters->radiance[i]) / (aim.pdf + uniform);
            wrong += shadow->stratum[next] != i || !near((*direction)[i], aim.direction)
                || !near(shadow->rays.direction(next), aim.ray) || !near(shadow->value[next], value)
                || (emitters->offset[i] < 0) != std::isinf(shadow->rays.tfar[next])
                || shadow->rays.ox[next] != p.x;
            ++next;
        }
        CAPTURE(count);
        CHECK(wrong == 0);
        CHECK(shadow->rays.count == next);

        shadow->rays.count = 0;
        aimFromSurfaces(*paths, *emitters, 3, *shadow);
        next = wrong = 0;
        for (int i = 0; i < count; ++i) {
            const Vec3d from(paths->leaving[i]);
            const ExactAim aim(*emitters, i, from);
            const double cosine = Vec3d(paths->normal[i]).dot(aim.direction);
            if (std::abs(cosine) < 1e-5) { // either answer is right
                if (shadow->stratum[next] == paths->stratum[i]) ++next;
                continue;
            }
            if (!(aim.pdf > 0) || cosine < 0) continue;
            const Vec3d value = Vec3d(paths->throughput[i] * paths->albedo[i])
                * Vec3d(emitters->radiance[i]) * (cosine / (3 * kPi * aim.pdf + cosine));
            wrong += shadow->stratum[next] != paths->stratum[i]
                || !near(shadow->rays.direction(next), aim.ray) || !near(shadow->value[next], value)
                || shadow->rays.oz[next] != paths->leaving.z[i];
            ++next;
        }
        CHECK(wrong == 0);
        CHECK(shadow->rays.count == next);
    }
}

TEST_CASE("Scattered paths: roulette, directions, and who is who afterwards", "[kernels]")
{
    CounterRng rng(6);
    const auto s = std::make_unique<ScatterBatch>();
    const auto rays = std::make_unique<RayBatch>();
    for (int count : {1, 5, 16, 123, kBatch}) {
        const auto before = randomPaths(count, rng);
        auto paths = std::make_unique<PathBatch>(*before);
        for (int i = 0; i < count; ++i) {
            s->survive[i] = rng.next();
            s->u[i] = i == 0 ? 0.0f : rng.next();
            s->v[i] = i < 8 ? 0.125f * static_cast<float>(i) : rng.next(); // where quarters meet
        }
        const int alive = scatterPaths(*paths, 0.9f, *s, *rays);
        int next = 0, wrong = 0;
        for (int i = 0; i < count; ++i) {
            const Vec3d carried(before->throughput[i] * before->albedo[i]);
            const double most = std::max({carried.x, carried.y, carried.z});
            const double chance = std::min({1.0, 2 * most, static_cast<double>(0.9f)});
            if (!(static_cast<double>(s->survive[i]) < chance)) continue;
            // Malley: up, and round about.
            const Vec3d n(before->normal[i]), d(rays->direction(next));
            const double u = static_cast<double>(s->u[i]);
            wrong += s->path[next] != i || !near(paths->throughput[next], carried / chance)
                || s->normal[next] != before->normal[i] || rays->ox[next] != before->leaving.x[i]
                || std::abs(d.length() - 1) > 1e-6 || std::abs(n.dot(d) - std::sqrt(1 - u)) > 2e-6
                || std::abs(static_cast<double>(s->cosine[next]) - n.dot(d)) > 1e-6
                || !std::isinf(rays->tfar[next]);
            ++next;
        }
        CAPTURE(count);
        CHECK(wrong == 0);
        CHECK(alive == next);
        CHECK(rays->count == next);
    }
}

TEST_CASE("Cosine-distributed rays turn by 2 pi v in the frame of their normal", "[kernels]")
{
    CounterRng rng(7);
    const auto paths = randomPaths(kBatch, rng);
    const auto s = std::make_unique<ScatterBatch>();
    const auto rays = std::make_unique<RayBatch>();
    const auto directionsAt = [&](float v) {
        std::fill_n(s->u, kBatch, 0.5f);
        std::fill_n(s->v, kBatch, v);
        cosineRays(*paths, *s, *rays);
        std::vector<Vec3d> d;
        for (int i = 0; i < kBatch; ++i) d.push_back(Vec3d(rays->direction(i)));
        return d;
    };
    const std::vector<Vec3d> start = directionsAt(0);
    double worst = 0;
    for (int k = 0; k < 1000; ++k) {
        const auto v = static_cast<float>(k) / 1000;
        const std::vector<Vec3d> d = directionsAt(v);
        for (int i = 0; i < kBatch; i += 17) {
            // Rodrigues: turned about the normal from where v = 0 is.
            const Vec3d n(paths->normal[i]);
            const double angle = 2 * kPi * static_cast<double>(v);
            const Vec3d turned = start[i] * std::cos(angle) + n.cross(start[i]) * std::sin(angle)
                + n * (n.dot(start[i]) * (1 - std::cos(angle)));
            worst = std::max(worst, (d[i] - turned).length());
        }
    }
    CAPTURE(worst);
    CHECK(worst < 2e-6);
}

TEST_CASE("Surfaces of rays: as the tracer finds them one by one", "[kernels]")
{
    Scene scene;
    const int white = addMaterial(scene, Color(0.5f), Color(0.0f), true);
    CounterRng rng(8);
    for (int i = 0; i < 200; ++i) {
        const double size = std::pow(10.0, 4 * rng.nextDouble() - 3);
        addQuad(scene, white, Vec3d(vectorIn(rng, 3)), Vec3d(unitVector(rng)) * size,
            Vec3d(unitVector(rng)) * size);
    }
    const auto tracer = makeTracer(std::move(scene));
    const Tracer::Impl& impl = tracer->impl();
    const auto met = std::make_unique<MetBatch>();
    const auto paths = std::make_unique<PathBatch>();
    for (std::uint32_t first = 0; first + 100 <= impl.triangleCount; first += 100) {
        met->count = 100;
        for (int k = 0; k < met->count; ++k) {
            const std::uint32_t t = first + static_cast<std::uint32_t>(k);
            const Corners c = impl.corners(t);
            met->a.set(k, c.a);
            met->b.set(k, c.b);
            met->c.set(k, c.c);
            met->direction.set(k, unitVector(rng));
            met->stretch[k] = 1;
            met->least[k] = 0;
            paths->u[k] = 0.5f * rng.next();
            paths->v[k] = 0.5f * rng.next();
        }
        findSurfaces(*met, *paths);
        int wrong = 0;
        for (int k = 0; k < met->count; ++k) {
            const SurfacePoint s = impl.surfaceAt(
                first + static_cast<std::uint32_t>(k), paths->u[k], paths->v[k], met->direction[k]);
            const float cosine = -s.normal.dot(met->direction[k]);
            wrong += (met->facing[k] > 0) != s.behind || !near(paths->normal[k], Vec3d(s.normal))
                || !near(paths->leaving[k], Vec3d(s.leaving()), 1e-6)
                || std::abs(std::abs(met->facing[k]) - cosine) > 1e-5f;
        }
        CAPTURE(first);
        CHECK(wrong == 0);
    }
    met->count = 1; // a triangle whose area single precision does not hold
    met->b.set(0, met->a[0]);
    findSurfaces(*met, *paths);
    CHECK(std::isnan(met->facing[0]));
}

TEST_CASE("Sums over strata: values and squared differences", "[kernels]")
{
    CounterRng rng(9);
    const auto uniform = std::make_unique<ColorBatch>(), emitter = std::make_unique<ColorBatch>();
    for (int count : {1, 3, 8, 77, kBatch}) {
        constexpr int kFunctions = 3;
        std::vector<float> yu(kFunctions * count), ye = yu;
        for (float& y : yu) y = rng.next() - 0.5f;
        for (float& y : ye) y = rng.next() - 0.5f;
        for (int i = 0; i < count; ++i) {
            uniform->set(i, Color(rng.next(), rng.next(), rng.next()));
            emitter->set(i, Color(rng.next(), rng.next(), rng.next()));
        }
        for (const bool hasPrevious : {false, true}) {
            std::vector<float> previous(3 * kFunctions, 0.25f);
            std::vector<double> sum(previous.size(), 1.0), squares(previous.size(), 2.0);
            sumStrata({count, kFunctions, uniform.get(), emitter.get(), yu.data(), ye.data(),
                hasPrevious, previous.data(), sum.data(), squares.data()});
            for (int j = 0; j < 3 * kFunctions; ++j) {
                double before = 0.25, exactSum = 1, exactSquares = 2;
                for (int i = 0; i < count; ++i) {
                    const int k = j / 3, c = j % 3;
                    const double f
                        = static_cast<double>(uniform->channel[c][i]) * double(yu[k * count + i])
                        + static_cast<double>(emitter->channel[c][i]) * double(ye[k * count + i]);
                    exactSum += f;
                    if (i > 0 || hasPrevious) exactSquares += (f - before) * (f - before);
                    before = f;
                }
                CAPTURE(count, hasPrevious, j);
                CHECK(sum[j] == Approx(exactSum).epsilon(1e-5).margin(1e-5));
                CHECK(squares[j] == Approx(exactSquares).epsilon(1e-5));
                CHECK(static_cast<double>(previous[j]) == Approx(before).margin(1e-6));
            }
        }
    }
}

TEST_CASE("Probes have the same bits on every instruction set", "[kernels]")
{
    std::vector<std::string> warnings;
    const std::string samples = LUMIVDB_SAMPLES;
    for (const bool outdoors : {false, true}) {
        auto scene = std::make_shared<Scene>(
            loadScene(samples + (outdoors ? "/house.glb" : "/cornell_box.glb")));
        if (outdoors) scene->environment = Environment::load(samples + "/sky.hdr", {}, warnings);
        const Vec3d p = outdoors ? Vec3d(0.3, 1.4, 0.2) : Vec3d(0.2, 0.3, 0.25);
        const Tracer tracer(scene);
        RadianceCacheOptions small;
        small.patches = 256;
        for (const bool cached : {false, true}) {
            std::vector<Color> first;
            const int targets = onEachTarget([&](const char* target) {
                ProbeOptions options;
                options.rays = 700;
                if (cached) options.cache = std::make_shared<const RadianceCache>(tracer, small);
                const ProbeEstimator estimator(tracer, options);
                ProbeEstimator::Workspace workspace;
                ProbeResult r = estimator.radianceSh(p, 6, 17, workspace, true);
                r.value.insert(r.value.end(), r.stderr_.begin(), r.stderr_.end());
                r.value.insert(r.value.end(), r.gradient.begin(), r.gradient.end());
                if (first.empty()) first = r.value;
                CAPTURE(target, outdoors, cached);
                CHECK(r.value == first);
            });
            CHECK(targets > 1);
        }
    }
}
