// SPDX-License-Identifier: Apache-2.0
// A mesh that is kept once and placed by transforms is the same world as the expanded one.

#include "../../bake/src/packets.h"
#include "bake_makers.h"

#include <lumivdb/bake/blockers.h>
#include <lumivdb/bake/geometry_cells.h>
#include <lumivdb/bake/rsm.h>
#include <lumivdb/bake/visibility.h>
#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <cmath>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

Vec3d randomPoint(CounterRng& rng, double size)
{
    const double x = rng.nextDouble(), y = rng.nextDouble(), z = rng.nextDouble();
    return (Vec3d(x, y, z) - Vec3d(0.5)) * (2 * size);
}

Vec3d randomDirection(CounterRng& rng)
{
    for (;;) {
        const Vec3d p = randomPoint(rng, 1);
        if (p.length() > 0.1 && p.length() < 1) return p.normalized();
    }
}

/// A random rotation after scales of 0.5 to 1.5 along the axes, every other one mirroring.
Mat4d randomPlace(CounterRng& rng, double reach, bool mirrored)
{
    const Vec3d x = randomDirection(rng), y = x.cross(randomDirection(rng)).normalized();
    const Vec3d rows[3] = {x, y, x.cross(y) * (mirrored ? -1.0 : 1.0)};
    const Vec3d shift = randomPoint(rng, reach);
    Mat4d m;
    for (int i = 0; i < 3; ++i) {
        const double scale = 0.5 + rng.nextDouble();
        for (int j = 0; j < 3; ++j) m[i][j] = rows[i][j] * scale;
        m[3][i] = shift[i];
    }
    return m;
}

/// Joins the meshes from @a first on to one of the material of the first.
Mesh& join(Scene& scene, std::size_t first)
{
    Mesh& joined = scene.meshes[first];
    for (std::size_t m = first + 1; m < scene.meshes.size(); ++m) {
        const auto base = static_cast<std::uint32_t>(joined.positions.size());
        for (const Vec3d& p : scene.meshes[m].positions) joined.positions.push_back(p);
        for (const auto& t : scene.meshes[m].triangles) {
            joined.triangles.push_back({base + t[0], base + t[1], base + t[2]});
        }
    }
    scene.meshes.resize(first + 1);
    return joined;
}

Mesh& addBox(Scene& scene, int material, const Vec3d& lower, const Vec3d& size)
{
    const std::size_t first = scene.meshes.size();
    addInwardBox(scene, material, lower, size);
    Mesh& box = join(scene, first);
    for (auto& t : box.triangles) std::swap(t[1], t[2]); // now it looks outward
    return box;
}

/// Lamps, single-sided and double-sided boxes and cards with holes, each several times, in a room.
/// The meshes come in the sequence in which both tracers number them.
Scene crowd(int uses, double reach, const Vec3d& at = Vec3d(0.0))
{
    Scene scene;
    addMaterial(scene, Color(0.6f, 0.5f, 0.4f), Color(0.0f), false);
    addMaterial(scene, Color(0.3f, 0.7f, 0.5f), Color(0.0f), true);
    addMaterial(scene, Color(0.2f), Color(3, 4, 5), false);
    addMaterial(scene, Color(0.8f), Color(0.0f), true);
    scene.materials[3].alphaMask = true;
    addInwardBox(scene, 0, Vec3d(-2 * reach), Vec3d(4 * reach));
    join(scene, 0);
    const int lamp = 2;
    addBox(scene, lamp, Vec3d(-0.1), Vec3d(0.4));
    addBox(scene, 0, Vec3d(5, 5, 5), Vec3d(0.5, 0.7, 0.9));
    addBox(scene, 1, Vec3d(-0.2, 0, 0), Vec3d(0.8, 0.1, 0.4));
    Mesh& cards = addBox(scene, 3, Vec3d(-0.3), Vec3d(0.6));
    for (std::size_t v = 0; v < cards.positions.size(); ++v) {
        cards.colors.push_back({0.5f, 1, 0.25f, v % 4 < 2 ? 1.0f : 0.0f}); // half of each is a hole
    }
    CounterRng rng(5);
    for (std::size_t m = 0; m < scene.meshes.size(); ++m) {
        Mesh& mesh = scene.meshes[m];
        if (m == 0) {
            for (Vec3d& p : mesh.positions) p += at;
            continue;
        }
        Box3d box;
        for (const Vec3d& p : mesh.positions) box.extendBy(p);
        for (int i = 0; i < uses; ++i) {
            Mat4d place = randomPlace(rng, reach, i % 2 == 1);
            const Vec3d middle = transformAffine(place, box.center());
            for (int a = 0; a < 3; ++a) place[3][a] += at[a] - middle[a] + place[3][a];
            mesh.instances.push_back(place);
        }
    }
    return scene;
}

struct Both {
    std::unique_ptr<Tracer> flat, instanced;

    explicit Both(const Scene& scene)
    {
        const auto shared = std::make_shared<Scene>(scene);
        flat = std::make_unique<Tracer>(shared);
        TracerOptions none;
        none.expandUpTo = 0;
        instanced = std::make_unique<Tracer>(shared, nullptr, none);
        REQUIRE(flat->impl().instances.empty());
        REQUIRE(!instanced->impl().instances.empty());
    }
};

} // namespace

TEST_CASE("instances: triangles are numbered as if they were expanded", "[instances]")
{
    const Scene scene = crowd(5, 3, {1000, -200, 30});
    const Both both(scene);
    const Tracer::Impl &flat = both.flat->impl(), &instanced = both.instanced->impl();
    REQUIRE(flat.triangleCount == scene.triangleCount());
    REQUIRE(instanced.triangleCount == scene.triangleCount());
    CHECK(instanced.instances.size() == 15); // lamps are expanded
    CHECK(instanced.triangles.size() == 12 + 5 * 12 + 3 * 12);
    CHECK(flat.emitters.triangleCount() == 60);
    CHECK(instanced.emitters.triangleCount() == 60);
    std::size_t wrong = 0;
    for (std::uint32_t i = 0; i < flat.triangleCount; ++i) {
        const auto &a = flat.triangle(i), &b = instanced.triangle(i);
        wrong += a.mesh != b.mesh || a.index != b.index || a.emitter != b.emitter;
        const Corners p = flat.corners(i), q = instanced.corners(i);
        const float rounding = Tracer::Impl::offsetOf(q, instanced.instanceOf(i));
        wrong += maxAbs(p.a - q.a) > rounding || maxAbs(p.b - q.b) > rounding
            || maxAbs(p.c - q.c) > rounding;
    }
    CHECK(wrong == 0);
}

TEST_CASE("instances: rays meet what they meet in the expanded world", "[instances]")
{
    const Vec3d at(100, -20, 3);
    const Both both(crowd(12, 2, at));
    CounterRng rng(7);
    int hits = 0, backs = 0, masked = 0, edges = 0, wrong = 0, hidden = 0;
    constexpr int kRays = 20000;
    for (int i = 0; i < kRays; ++i) {
        const Vec3d p = at + randomPoint(rng, 3), d = randomDirection(rng);
        const SurfaceHit a = both.flat->intersect(p, d), b = both.instanced->intersect(p, d);
        REQUIRE((a.hit && b.hit)); // the room is closed
        if (a.mesh != b.mesh || a.triangle != b.triangle) {
            ++edges; // where rounding decides which of two neighbours it is
            continue;
        }
        if (a.mesh == 0) continue;
        ++hits;
        backs += a.backFace;
        masked += a.mesh == 4;
        wrong += std::abs(a.distance - b.distance) > 2e-4
            || (a.position - b.position).length() > 2e-4 || (a.normal - b.normal).length() > 1e-4f
            || a.backFace != b.backFace || (a.albedo - b.albedo).length() > 1e-5f
            || a.emission != b.emission;
        const Vec3d before = p + d * (a.distance - 1e-3), behind = p + d * (a.distance + 1e-3);
        hidden += both.instanced->occluded(p, behind) && !both.instanced->occluded(p, before);
    }
    CHECK(hits > kRays / 10);
    CHECK(backs > 50); // of boxes that the origins are in
    CHECK(masked > kRays / 50);
    CHECK(wrong == 0);
    CHECK(edges < kRays / 1000);
    CHECK(hidden > 0.99 * hits); // all but what begins within 10⁻³ of a surface
}

TEST_CASE("instances: packets agree with single rays", "[instances]")
{
    const Both both(crowd(12, 2));
    const Tracer::Impl& impl = both.instanced->impl();
    CounterRng rng(9);
    auto rays = std::make_unique<RayBatch>();
    auto packet = std::make_unique<HitBatch>(), single = std::make_unique<HitBatch>();
    std::uint8_t occluded[kBatch];
    std::size_t different = 0, placed = 0;
    for (int round = 0; round < 20; ++round) {
        const Vec3f from(randomPoint(rng, 3));
        rays->count = 0;
        for (int i = 0; i < kBatch; ++i) rays->push(from, Vec3f(randomDirection(rng)), 1e30f);
        intersectCoherent(impl, *rays, *packet);
        intersectScattered(impl, *rays, *single);
        for (int i = 0; i < kBatch; ++i) {
            different += packet->triangle[i] != single->triangle[i];
            different += std::abs(packet->t[i] - single->t[i]) > 1e-5f * single->t[i];
            placed += single->triangle[i] >= impl.placedCount;
            rays->tfar[i] = single->t[i] * (i % 2 ? 1.001f : 0.999f); // just behind or before it
        }
        occlude(impl, *rays, occluded);
        for (int i = 0; i < kBatch; ++i) different += occluded[i] != i % 2;
    }
    CHECK(placed > 500);
    CHECK(different == 0);
}

TEST_CASE("instances: what leaves a convex body does not meet it again", "[instances]")
{
    // Two boxes, one of them near the middle of the scene and both far from the middle of their
    // mesh: there the transform rounds more than the coordinates show.
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), false);
    addBox(scene, 0, Vec3d(-0.5), Vec3d(1.0));
    addBox(scene, 0, Vec3d(999.5, -0.5, -0.5), Vec3d(1.0));
    Mesh& boxes = join(scene, 0);
    CounterRng rng(3);
    for (int i = 0; i < 200; ++i) boxes.instances.push_back(randomPlace(rng, 3, false));
    const Both both(scene);
    const Tracer::Impl& impl = both.instanced->impl();
    auto rays = std::make_unique<RayBatch>();
    auto hits = std::make_unique<HitBatch>();
    std::size_t again = 0;
    for (std::uint32_t t = 0; t < impl.triangleCount; ++t) {
        const Vec3f in = -impl.corners(t).areaVector().normalized();
        rays->count = 0;
        while (rays->count < kBatch) {
            const auto u = static_cast<float>(rng.nextDouble());
            const float v = (1 - u) * static_cast<float>(rng.nextDouble());
            const SurfacePoint s = impl.surfaceAt(t, u, v, in);
            REQUIRE(!s.backFace);
            const Vec3f d(randomDirection(rng));
            rays->push(s.leaving(), d.dot(in) > 0 ? -d : d, 3.0f);
        }
        intersectCoherent(impl, *rays, *hits);
        for (int i = 0; i < kBatch; ++i) {
            again += hits->triangle[i] != kMiss
                && impl.instanceOf(hits->triangle[i]) == impl.instanceOf(t);
        }
    }
    CHECK(again == 0);
}

TEST_CASE("instances: closest surfaces, cells, blockers and surfels", "[instances]")
{
    const Vec3d at(50, 0, -20);
    Scene scene = crowd(9, 2, at);
    scene.meshes.pop_back(); // at the border of a hole rounding decides whether there is a blocker
    const Both both(scene);
    CounterRng rng(13);
    const GeometryCells flat(*both.flat), instanced(*both.instanced);
    std::vector<std::uint32_t> more, found, less;
    std::size_t near = 0, cells = 0, wrong = 0;
    for (int i = 0; i < 3000; ++i) {
        const Vec3d p = at + randomPoint(rng, 3);
        double a = 0, b = 0;
        Vec3d na, nb;
        const bool hit = both.flat->closestSurface(p, 0.5, &a, &na);
        if (hit != both.instanced->closestSurface(p, 0.5, &b, &nb)) ++wrong;
        near += hit;
        wrong += hit && std::abs(a - b) > 1e-4;

        const Box3d box(p, p + Vec3d(0.4));
        flat.collect(Box3d(box.min - Vec3d(1e-4), box.max + Vec3d(1e-4)), more);
        flat.collect(Box3d(box.min + Vec3d(1e-4), box.max - Vec3d(1e-4)), less);
        instanced.collect(box, found);
        cells += found.size();
        wrong += !std::includes(found.begin(), found.end(), less.begin(), less.end());
        wrong += !std::includes(more.begin(), more.end(), found.begin(), found.end());
        wrong += instanced.touches(box) != !found.empty();
    }
    CHECK(near > 500);
    CHECK(cells > 1000);
    CHECK(wrong == 0);

    BlockerOptions options;
    options.spacing = 0.5;
    const auto a = surfaceBlockers(*both.flat, options),
               b = surfaceBlockers(*both.instanced, options);
    REQUIRE(a.size() > 1000);
    REQUIRE(a.size() == b.size());
    // Rounding of the running sum of areas, some 10⁻⁷ of 10³, goes along a Hilbert curve.
    double furthest = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        furthest = std::max(furthest, (a[i].position - b[i].position).length());
    }
    CHECK(furthest < 0.02);

    RsmOptions rsm;
    rsm.resolution = 32;
    const auto lightA = reflectedLight(*both.flat, rsm),
               lightB = reflectedLight(*both.instanced, rsm);
    Color fluxA(0.0f), fluxB(0.0f);
    for (const Surfel& s : lightA) fluxA += s.flux;
    for (const Surfel& s : lightB) fluxB += s.flux;
    CHECK(luminance(fluxA) > 0);
    CHECK((fluxA - fluxB).length() < 1e-2f * fluxA.length());
}

TEST_CASE("instances: a bake gives the light of the expanded world", "[instances]")
{
    const Both both(crowd(6, 1));
    BakeOptions o = bakeOptions(0.5, Vec3d(-1.0), Vec3d(1.0), 256);
    const IrradianceVolume a = bakeVolume(*both.flat, o).volume;
    const IrradianceVolume b = bakeVolume(*both.instanced, o).volume;
    REQUIRE(a.sampleCount() == b.sampleCount());
    REQUIRE(a.sampleCount() > 100);
    // The same random numbers meet the same surfaces; a few paths pass an edge on its other side.
    std::size_t same = 0, blocked = 0;
    double difference = 0, mean = 0;
    for (SampleId s = 0; s < a.sampleCount(); ++s) {
        const double l = luminance(a.radiance(s)[0]), d = l - luminance(b.radiance(s)[0]);
        same += std::abs(d) <= 1e-3 * l;
        difference += d * d;
        mean += l;
        blocked += a.validity(s) < 1;
        CHECK(std::abs(a.validity(s) - b.validity(s)) < 0.05f);
    }
    const auto n = static_cast<double>(a.sampleCount());
    CHECK(mean > 0);
    CHECK(blocked > 0);
    CHECK(same > 0.8 * n);
    CHECK(std::sqrt(difference / n) < 0.01 * mean / n);
}

TEST_CASE("instances: the smaller meshes are expanded, as many as may be", "[instances]")
{
    Scene scene = crowd(10, 2);
    scene.meshes[2].instances.resize(5); // 60 triangles beside 12 of the room, 120 of the lamps
    // Nearly flat: rounding would become too large.
    for (int j = 0; j < 3; ++j)
        scene.meshes[4].instances[0][1][j]
            = scene.meshes[4].instances[0][0][j] + 1e-4 * scene.meshes[4].instances[0][1][j];
    const auto instancesAt = [shared = std::make_shared<Scene>(scene)](std::uint64_t limit) {
        TracerOptions options;
        options.expandUpTo = limit;
        return Tracer(shared, nullptr, options).impl().instances.size();
    };
    const std::uint64_t must = 12 + 120 + 120; // room, lamps, the nearly flat
    CHECK(instancesAt(0) == 15);
    CHECK(instancesAt(must + 59) == 15);
    CHECK(instancesAt(must + 60) == 10);
    CHECK(instancesAt(must + 180) == 0);
}

TEST_CASE("tracer: a quickly built structure finds what a good one finds", "[instances]")
{
    const auto scene = std::make_shared<Scene>(crowd(20, 2));
    const auto triangles = static_cast<double>(scene->triangleCount());
    const auto traced = [&](double rays, RTCBuildQuality quality) {
        TracerOptions options;
        options.expectedRays = rays;
        auto tracer = std::make_unique<Tracer>(scene, nullptr, options);
        CHECK(tracer->impl().quality == quality);
        return tracer;
    };
    const auto good = traced(triangles, RTC_BUILD_QUALITY_HIGH);
    const auto unknown = traced(0, RTC_BUILD_QUALITY_HIGH);
    const auto quick = traced(triangles - 1, RTC_BUILD_QUALITY_LOW);
    CounterRng rng(21);
    auto rays = std::make_unique<RayBatch>();
    auto a = std::make_unique<HitBatch>(), b = std::make_unique<HitBatch>();
    std::size_t different = 0, hits = 0;
    for (int round = 0; round < 100; ++round) {
        const Vec3f from(randomPoint(rng, 3));
        rays->count = 0;
        for (int i = 0; i < kBatch; ++i) rays->push(from, Vec3f(randomDirection(rng)), 1e30f);
        intersectCoherent(good->impl(), *rays, *a);
        intersectCoherent(quick->impl(), *rays, *b);
        for (int i = 0; i < kBatch; ++i) {
            hits += a->triangle[i] != kMiss;
            different += a->triangle[i] != b->triangle[i] || a->t[i] != b->t[i]
                || a->u[i] != b->u[i] || a->v[i] != b->v[i];
        }
    }
    CHECK(hits == 100 * kBatch);
    CHECK(different == 0);
}

TEST_CASE("instances: more triangles than numbers are refused", "[instances]")
{
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), false);
    Mesh& mesh = addBox(scene, 0, Vec3d(0.0), Vec3d(1.0));
    mesh.triangles.resize(65537, mesh.triangles[0]);
    mesh.instances.resize(65535);
    CHECK(scene.triangleCount() == 0xffffffff);
    const std::string message
        = errorOf(ErrorCode::Input, [&] { Tracer(std::make_shared<Scene>(scene)); });
    CHECK_THAT(message, Catch::Contains("4294967295 triangles"));
}
