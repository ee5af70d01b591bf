// SPDX-License-Identifier: Apache-2.0
// Rays against surfaces whose intersections are known, and every way a surface can be awkward.

#include "../../bake/src/packets.h"
#include "scene_makers.h"

#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <cmath>
#include <limits>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

std::unique_ptr<Tracer> makeTracer(Scene scene)
{
    return std::make_unique<Tracer>(std::make_shared<Scene>(std::move(scene)));
}

Vec3d randomDirection(CounterRng& rng)
{
    const double z = 2 * rng.nextDouble() - 1, phi = 6.283185307179586 * rng.nextDouble();
    const double r = std::sqrt(1 - z * z);
    return {r * std::cos(phi), r * std::sin(phi), z};
}

Vec3d randomPoint(CounterRng& rng, double size)
{
    const double x = rng.nextDouble(), y = rng.nextDouble(), z = rng.nextDouble();
    return (Vec3d(x, y, z) - Vec3d(0.5)) * (2 * size);
}

void addTriangle(Scene& scene, int material, const Vec3d& a, const Vec3d& b, const Vec3d& c)
{
    Mesh mesh;
    mesh.material = material;
    mesh.positions = {a, b, c};
    mesh.triangles = {{{0, 1, 2}}};
    scene.meshes.push_back(mesh);
}

/// Floor [0,1]² at y = 0 that looks up, with uv = (x, z).
Scene texturedFloor()
{
    Scene scene;
    addMaterial(scene, Color(1.0f), Color(0.0f), false);
    addQuad(scene, 0, {0, 0, 0}, {0, 0, 1}, {1, 0, 0});
    scene.meshes[0].uv[0] = {{0, 0}, {0, 1}, {1, 1}, {1, 0}};
    return scene;
}

Texture texture(int width, int height, std::vector<float> pixels)
{
    Texture t;
    t.width = width;
    t.height = height;
    t.pixels = std::move(pixels);
    t.nearest = true;
    return t;
}

SurfaceHit down(const Tracer& tracer, double x, double z)
{
    return tracer.intersect({x, 1, z}, {0, -1, 0});
}

double pointToSegment(const Vec3d& p, const Vec3d& a, const Vec3d& b)
{
    const Vec3d ab = b - a;
    const double t = std::max(0.0, std::min(1.0, (p - a).dot(ab) / ab.length2()));
    return (p - (a + ab * t)).length();
}

/// Distance of a point to a triangle: its plane where the foot is inside, else its edges.
double pointToTriangle(const Vec3d& p, const Vec3d& a, const Vec3d& b, const Vec3d& c)
{
    const Vec3d n = (b - a).cross(c - a);
    const Vec3d foot = p - n * ((p - a).dot(n) / n.length2());
    const double s0 = (b - a).cross(foot - a).dot(n), s1 = (c - b).cross(foot - b).dot(n),
                 s2 = (a - c).cross(foot - c).dot(n);
    if (s0 >= 0 && s1 >= 0 && s2 >= 0) return (p - foot).length();
    return std::min({pointToSegment(p, a, b), pointToSegment(p, b, c), pointToSegment(p, c, a)});
}

} // namespace

TEST_CASE("a quad from both sides: distance, position, normal, side", "[tracer]")
{
    for (const bool doubleSided : {false, true}) {
        Scene scene;
        addMaterial(scene, Color(0), Color(0.0f), false);
        addMaterial(scene, Color(0.2f, 0.4f, 0.6f), Color(1, 2, 3), doubleSided);
        addQuad(scene, 0, {100, 0, 0}, {0, 0, 1}, {1, 0, 0});
        addQuad(scene, 1, {-1, 2, -1}, {0, 0, 2}, {2, 0, 0}); // looks up
        const auto tracer = makeTracer(scene);
        const Vec3d d = Vec3d(0.3, -1, 0.2).normalized();
        const SurfaceHit front = tracer->intersect({0.1, 5, -0.3}, d);
        CAPTURE(doubleSided);
        REQUIRE(front.hit);
        CHECK(front.distance == Approx(3 / -d.y).epsilon(1e-6));
        CHECK((front.position - (Vec3d(0.1, 5, -0.3) + d * (3 / -d.y))).length() < 2e-5);
        CHECK((front.normal - Vec3f(0, 1, 0)).length() < 1e-6f);
        CHECK_FALSE(front.backFace);
        CHECK(front.mesh == 1);
        CHECK((front.triangle == 0 || front.triangle == 1));
        CHECK(front.albedo == Color(0.2f, 0.4f, 0.6f));
        CHECK(front.emission == Color(1, 2, 3));

        const SurfaceHit back = tracer->intersect({0.1, 0, 0.3}, {0, 1, 0});
        REQUIRE(back.hit);
        CHECK(back.distance == Approx(2).epsilon(1e-6));
        CHECK(back.backFace);
        CHECK((back.normal - Vec3f(0, 1, 0)).length() < 1e-6f); // the front's, always
        CHECK(back.albedo == (doubleSided ? Color(0.2f, 0.4f, 0.6f) : Color(0.0f)));
        CHECK(back.emission == (doubleSided ? Color(1, 2, 3) : Color(0.0f)));

        const SurfaceHit miss = tracer->intersect({5, 5, 0}, {0, -1, 0});
        CHECK_FALSE(miss.hit);
        CHECK(miss.mesh == -1);
        CHECK(miss.triangle == -1);
        CHECK_FALSE(tracer->intersect({0, 5, 0}, {0, 1, 0}).hit);
    }
}

TEST_CASE("a scene without triangles", "[tracer][hard]")
{
    Scene scene;
    addMaterial(scene, Color(1.0f), Color(0.0f), false);
    scene.meshes.emplace_back(); // a mesh without anything
    const auto tracer = makeTracer(scene);
    double distance = 0;
    Vec3d normal;
    CHECK_FALSE(tracer->intersect({0, 0, 0}, {0, 0, 1}).hit);
    CHECK_FALSE(tracer->occluded({0, 0, 0}, {0, 0, 1e6}));
    CHECK_FALSE(tracer->closestSurface({0, 0, 0}, 1e6, &distance, &normal));
    CHECK(tracer->scene().triangleCount() == 0);
    CHECK(tracer->buildSeconds() >= 0);
}

TEST_CASE("occluded: strictly between two points", "[tracer]")
{
    Scene scene;
    addMaterial(scene, Color(1.0f), Color(0.0f), false);
    addQuad(scene, 0, {-1, 0, -1}, {0, 0, 2}, {2, 0, 0}); // y = 0
    addQuad(scene, 0, {-1, 1, -1}, {0, 0, 2}, {2, 0, 0}); // y = 1
    const auto tracer = makeTracer(scene);
    CHECK(tracer->occluded({0.3, 2, 0.1}, {0.2, 0.5, 0}));
    CHECK(tracer->occluded({0.2, 0.5, 0}, {0.3, 2, 0.1})); // back faces hide too
    CHECK(tracer->occluded({0.2, -1, 0}, {0.3, 2, 0.1}));
    CHECK_FALSE(tracer->occluded({0.2, 0.5, 0}, {0.3, 0.9, 0.1}));
    CHECK_FALSE(tracer->occluded({0.2, 2, 0}, {0.3, 3, 0.1}));
    CHECK_FALSE(tracer->occluded({0.2, 1.5, 0}, {0.3, 1.001, 0.1}));
    CHECK_FALSE(tracer->occluded({3, 2, 0}, {3, -2, 0})); // beside them
    // Points of the two surfaces see each other.
    CounterRng rng(1);
    int blocked = 0;
    for (int k = 0; k < 500; ++k) {
        const Vec3d a(rng.nextDouble() - 0.5, 0, rng.nextDouble() - 0.5);
        const Vec3d b(rng.nextDouble() - 0.5, 1, rng.nextDouble() - 0.5);
        blocked += tracer->occluded(a, b) + tracer->occluded(b, a);
    }
    CHECK(blocked == 0);
    CHECK_FALSE(
        tracer->occluded({0.5, 0.5, 0}, {0.5, 0.5, 0})); // nothing between a point and itself
}

TEST_CASE("closest surface against brute force", "[tracer]")
{
    Scene scene;
    addMaterial(scene, Color(1.0f), Color(0.0f), false);
    CounterRng rng(3);
    for (int t = 0; t < 150; ++t) {
        const Vec3d a = randomPoint(rng, 3);
        addTriangle(scene, 0, a, a + randomPoint(rng, 1), a + randomPoint(rng, 1));
    }
    const auto tracer = makeTracer(scene);
    int found = 0;
    for (int k = 0; k < 400; ++k) {
        const Vec3d p = randomPoint(rng, 5);
        double expected = kInf, second = kInf;
        Vec3d expectedNormal(0.0);
        for (const Mesh& m : scene.meshes) {
            const double d = pointToTriangle(p, m.positions[0], m.positions[1], m.positions[2]);
            if (d >= expected) {
                second = std::min(second, d);
                continue;
            }
            second = expected;
            expected = d;
            expectedNormal = (m.positions[1] - m.positions[0])
                                 .cross(m.positions[2] - m.positions[0])
                                 .normalized();
        }
        double distance = -1;
        Vec3d normal;
        CAPTURE(p, expected);
        REQUIRE_FALSE(tracer->closestSurface(p, expected * 0.999, &distance, &normal));
        REQUIRE(tracer->closestSurface(p, expected * 1.001, &distance, &normal));
        CHECK(distance == Approx(expected).margin(2e-6));
        REQUIRE(tracer->closestSurface(p, 100, &distance, nullptr));
        CHECK(distance == Approx(expected).margin(2e-6));
        if (second - expected > 1e-5) CHECK((normal - expectedNormal).length() < 1e-4);
        REQUIRE(tracer->closestSurface(p, 100, nullptr, &normal));
        ++found;
    }
    CHECK(found == 400);
    // An infinite radius is a radius.
    double distance = 0;
    CHECK(tracer->closestSurface({0, 0, 0}, kInf, &distance, nullptr));
    CHECK(std::isfinite(distance));
}

TEST_CASE("degenerate triangles are not there", "[tracer][hard]")
{
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(1.0f), false);
    const Vec3d a(0, 0.5, 0), b(0.4, 0.5, 0.1);
    addTriangle(scene, 0, a, a, a);
    addTriangle(scene, 0, a, a, b);
    addTriangle(scene, 0, a, b, a);
    addTriangle(scene, 0, b, a, a);
    addTriangle(scene, 0, a, b, (a + b) * 0.5);
    addTriangle(scene, 0, {-0.25, 0.5, 0}, {0.25, 0.5, 0}, {0, 0.5, 0}); // exactly in line
    addQuad(scene, 0, {-1, 0, -1}, {0, 0, 2}, {2, 0, 0});
    const auto tracer = makeTracer(scene);
    for (const Vec3d& p : {Vec3d(0, 0.6, 0), Vec3d(0.1, 0.51, 0.02), a, b, Vec3d(-0.5, 0.4, 0.3)}) {
        double distance = -1;
        Vec3d normal;
        CAPTURE(p);
        REQUIRE(tracer->closestSurface(p, 10, &distance, &normal));
        CHECK(distance == Approx(p.y).epsilon(1e-6));
        CHECK((normal - Vec3d(0, 1, 0)).length() < 1e-6);
    }
    const SurfaceHit hit = tracer->intersect({0, 2, 0}, {0, -1, 0});
    REQUIRE(hit.hit);
    CHECK(hit.distance == Approx(2));
    // They emit nothing: a probe that looks at nothing else is dark, and finite.
    Scene dark;
    addMaterial(dark, Color(0.5f), Color(1.0f), true);
    addTriangle(dark, 0, a, a, b);
    addTriangle(dark, 0, a, a, a);
    ProbeOptions o;
    o.rays = 64;
    Bench bench(dark, o);
    const ProbeResult r = bench.sh({0, 0, 0}, 3);
    for (const Color& c : r.value) CHECK(c == Color(0.0f));
    CHECK(r.validity == 1);
}

TEST_CASE("alpha mask: holes let rays pass, shadow rays too", "[tracer][alpha]")
{
    Scene scene = texturedFloor();
    scene.textures = {texture(2, 1, {1, 1, 1, 1.0f, 1, 1, 1, 0.3f})}; // left 1, right 0.3
    addMaterial(scene, Color(0.25f), Color(0.0f), false);
    Material& m = scene.materials[0];
    m.baseColorTexture.texture = 0;
    m.alphaMask = true;
    m.doubleSided = true;
    addQuad(scene, 1, {0, -1, 0}, {0, 0, 1}, {1, 0, 0});
    const auto at = [](const Scene& s, double x) {
        const auto tracer = makeTracer(s);
        const SurfaceHit hit = down(*tracer, x, 0.5);
        const bool dark = tracer->occluded({x, 1, 0.5}, {x, -0.5, 0.5});
        CHECK(dark == (hit.mesh == 0)); // both kinds of ray agree
        // Alpha counts from below as well.
        CHECK(tracer->occluded({x, -0.5, 0.5}, {x, 1, 0.5}) == dark);
        return hit.mesh;
    };
    CHECK(at(scene, 0.25) == 0);
    CHECK(at(scene, 0.75) == 1);
    m.alphaCutoff = 0.3f; // at the cut-off a texel is opaque (glTF 2.0, 3.9.4)
    CHECK(at(scene, 0.75) == 0);
    m.alphaCutoff = 0.31f;
    CHECK(at(scene, 0.75) == 1);
    m.alphaFactor = 0.2f;
    CHECK(at(scene, 0.25) == 1);
    m.alphaFactor = 1;
    scene.meshes[0].colors.assign(4, {1, 1, 1, 0.1f});
    CHECK(at(scene, 0.25) == 1);
    m.alphaMask = false; // an opaque material ignores alpha
    CHECK(at(scene, 0.75) == 0);
}

TEST_CASE("texture coordinates, both sets, transform, emission", "[tracer][texture]")
{
    Scene scene = texturedFloor();
    scene.textures = {texture(2, 1, {1, 0, 0, 1, 0, 1, 0, 1}), // left red, right green
        texture(1, 2, {0, 0, 1, 1, 1, 1, 0, 1})}; // above blue, below yellow
    Material& m = scene.materials[0];
    m.baseColor = Color(0.5f);
    m.baseColorTexture.texture = 0;
    m.emission = Color(10.0f);
    m.emissionTexture.texture = 1;
    const Color red(0.5f, 0, 0), green(0, 0.5f, 0), blue(0, 0, 10), yellow(10, 10, 0);
    const auto check = [&](double x, double z, const Color& albedo, const Color& emission) {
        const auto tracer = makeTracer(scene);
        const SurfaceHit hit = down(*tracer, x, z);
        CAPTURE(x, z);
        REQUIRE(hit.hit);
        CHECK(hit.albedo == albedo);
        CHECK(hit.emission == emission);
    };
    check(0.2, 0.3, red, blue);
    check(0.8, 0.3, green, blue);
    check(0.2, 0.8, red, yellow);
    check(0.8, 0.8, green, yellow);
    // The other set of coordinates turns red and green round.
    scene.meshes[0].uv[1] = {{1, 0}, {1, 1}, {0, 1}, {0, 0}};
    m.baseColorTexture.uvSet = 1;
    check(0.2, 0.3, green, blue);
    // u' = u + 1/2, repeated.
    m.baseColorTexture = TextureSlot();
    m.baseColorTexture.texture = 0;
    m.baseColorTexture.transform = {1, 0, 0.5f, 0, 1, 0};
    check(0.2, 0.3, green, blue);
    check(0.8, 0.3, red, blue);
    // A slot without coordinates is white.
    m.baseColorTexture.uvSet = 1;
    scene.meshes[0].uv[1].clear();
    check(0.2, 0.3, Color(0.5f), blue);
}

TEST_CASE("vertex colours are interpolated in float and clamped to reflectances", "[tracer]")
{
    Scene scene;
    addMaterial(scene, Color(0.5f, 1, 1), Color(0.0f), false);
    addTriangle(scene, 0, {0, 0, 0}, {0, 0, 1}, {1, 0, 0});
    scene.meshes[0].colors = {{1, 0, 0, 1}, {0, 1, 0, 1}, {0, 0, 4, 1}};
    const auto tracer = makeTracer(scene);
    const SurfaceHit hit = down(*tracer, 0.125, 0.5); // barycentrics: 0.375, 0.5, 0.125
    REQUIRE(hit.hit);
    CHECK(hit.albedo.x == Approx(0.5 * 0.375));
    CHECK(hit.albedo.y == Approx(0.5));
    CHECK(hit.albedo.z == Approx(0.5));
    CHECK(down(*tracer, 0.5, 0.25).albedo.z == 1); // 2 is no reflectance
}

TEST_CASE("closed boxes hold every ray: axes, edges, vertices, doubled points", "[tracer][hard]")
{
    // Eight vertices stored three times each, six quads of two triangles; near, far, small, large.
    struct Place {
        Vec3d lower;
        double size;
    };
    for (const Place& place : {Place{{-1, -1, -1}, 2}, Place{{1e6, -1e6, 1e6}, 2},
             Place{{-5e-5, 0, 0}, 1e-4}, Place{{0, 0, 0}, 1e5}, Place{{0.1, 0.1, 0.1}, 0.3}}) {
        Scene scene;
        addMaterial(scene, Color(0.5f), Color(0.0f), false);
        addInwardBox(scene, 0, place.lower, Vec3d(place.size));
        const auto tracer = makeTracer(scene);
        const Vec3d centre = place.lower + Vec3d(place.size / 2);
        int escaped = 0, wrong = 0, rays = 0;
        const auto shoot = [&](const Vec3d& from, const Vec3d& d) {
            const SurfaceHit hit = tracer->intersect(from, d);
            ++rays;
            escaped += !hit.hit;
            if (!hit.hit) return;
            wrong += hit.backFace;
            // Slab method, in double precision.
            double exit = kInf;
            for (int a = 0; a < 3; ++a) {
                if (d[a] == 0) continue;
                const double wall = place.lower[a] + (d[a] > 0 ? place.size : 0);
                exit = std::min(exit, (wall - from[a]) / d[a]);
            }
            wrong += std::abs(hit.distance - exit) > 2e-6 * place.size;
        };
        for (int n = 0; n < 27; ++n) {
            const Vec3d d(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
            if (n == 13) continue;
            shoot(centre, d.normalized()); // faces' diagonals, edges' middles, vertices
            for (int k = 1; k < 8; ++k) {
                // Along axes, through the quads' diagonals and off centre.
                shoot(centre + d * (place.size * 0.06 * k), Vec3d(0, 1, 0));
                shoot(centre + d * (place.size * 0.06 * k), Vec3d(-1, 0, 0));
                shoot(centre + d * (place.size * 0.06 * k), Vec3d(0, 0, -1));
            }
        }
        CounterRng rng(9);
        for (int k = 0; k < 3000; ++k) {
            const Vec3d from = centre + randomPoint(rng, 0.45 * place.size);
            shoot(from, randomDirection(rng));
        }
        CAPTURE(place.lower, place.size);
        CHECK(rays == 3000 + 26 * 22);
        CHECK(escaped == 0);
        CHECK(wrong == 0);
    }
}

namespace {

void intersectSingle(const Tracer::Impl& impl, const RayBatch& rays, HitBatch& hits)
{
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    for (int i = 0; i < rays.count; ++i) {
        RTCRayHit r{};
        r.ray = {rays.ox[i], rays.oy[i], rays.oz[i], 0, rays.dx[i], rays.dy[i], rays.dz[i], 0,
            rays.tfar[i], ~0u, 0, 0};
        r.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        rtcIntersect1(impl.embree, &context, &r);
        const bool hit = r.hit.geomID != RTC_INVALID_GEOMETRY_ID;
        hits.triangle[i] = hit ? impl.triangleOf(r.hit.geomID, r.hit.primID) : kMiss;
        hits.t[i] = r.ray.tfar;
    }
}

} // namespace

TEST_CASE("packets, single rays and shadow rays agree", "[tracer][packets]")
{
    Scene scene;
    addMaterial(scene, Color(0.5f), Color(0.0f), true);
    Material masked;
    masked.alphaMask = true;
    masked.baseColorTexture.texture = 0;
    scene.materials.push_back(masked);
    scene.textures = {texture(2, 2, {1, 1, 1, 1, 1, 1, 1, 0, 1, 1, 1, 0, 1, 1, 1, 1})};
    CounterRng rng(11);
    for (int t = 0; t < 300; ++t) {
        const Vec3d a = randomPoint(rng, 3);
        addTriangle(scene, t % 2, a, a + randomPoint(rng, 1), a + randomPoint(rng, 1));
        scene.meshes.back().uv[0] = {{0, 0}, {5, 0}, {0, 5}};
    }
    const auto tracer = makeTracer(scene);
    const Tracer::Impl& impl = tracer->impl();
    int hits = 0, misses = 0;
    // Every count from one ray to a full batch: the last packet has idle lanes.
    for (int count = 1; count <= kBatch; count += count < 40 ? 1 : 27) {
        auto rays = std::make_unique<RayBatch>();
        auto packet = std::make_unique<HitBatch>(), single = std::make_unique<HitBatch>();
        auto scattered = std::make_unique<HitBatch>();
        const Vec3d from = randomPoint(rng, 3);
        for (int i = 0; i < count; ++i)
            rays->push(impl.toLocal(from), Vec3f(randomDirection(rng)), 1e30f);
        intersectCoherent(impl, *rays, *packet);
        intersectScattered(impl, *rays, *scattered);
        intersectSingle(impl, *rays, *single);
        int different = 0;
        for (int i = 0; i < count; ++i) {
            different += packet->triangle[i] != single->triangle[i];
            different += scattered->triangle[i] != single->triangle[i];
            const bool hit = single->triangle[i] != kMiss;
            ++(hit ? hits : misses);
            if (!hit) continue;
            different += std::abs(packet->t[i] - single->t[i]) > 1e-5f * single->t[i];
            different += std::abs(scattered->t[i] - single->t[i]) > 1e-5f * single->t[i];
            rays->tfar[i] = single->t[i] * (i % 2 ? 1.001f : 0.999f); // just behind or before it
        }
        std::uint8_t occluded[kBatch], occludedScattered[kBatch];
        occlude(impl, *rays, occluded);
        occludeScattered(impl, *rays, occludedScattered);
        for (int i = 0; i < count; ++i) {
            const int expected = single->triangle[i] != kMiss && i % 2 ? 1 : 0;
            different += (occluded[i] != expected) + (occludedScattered[i] != expected);
        }
        CAPTURE(count);
        CHECK(different == 0);
    }
    CHECK(hits > 500);
    CHECK(misses > 200);
}
