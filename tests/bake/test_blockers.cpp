// SPDX-License-Identifier: Apache-2.0
// Pieces of surface that stand in the way: how much of it, where, of which colour.

#include "bake_makers.h"

#include <lumivdb/bake/blockers.h>

#include <tbb/global_control.h>

#include <catch2/catch.hpp>

#include <array>
#include <cmath>
#include <cstring>
#include <limits>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

constexpr double kBoxArea = 2 * (2 * 3 + 3 * 4 + 2 * 4);

Scene boxScene(const Color& albedo)
{
    Scene scene;
    addMaterial(scene, albedo, Color(0.0f), false);
    addInwardBox(scene, 0, {0, 0, 0}, {2, 3, 4});
    return scene;
}

double areaOf(const std::vector<Blocker>& blockers)
{
    double area = 0;
    for (const Blocker& b : blockers) area += b.area;
    return area;
}

} // namespace

TEST_CASE("blockers have the surfaces' area and albedo, evenly", "[blockers]")
{
    Scene scene = boxScene(Color(0.25f, 0.5f, 1));
    const int both = addMaterial(scene, Color(0.5f), Color(0.0f), true);
    addQuad(scene, both, {0.5, 1, 1}, {1, 0, 0}, {0, 0, 2});
    const auto tracer = makeTracer(std::move(scene));
    BlockerOptions options;
    options.spacing = 0.5;
    options.perFace = 16;
    const std::vector<Blocker> blockers = surfaceBlockers(*tracer, options);
    CHECK(areaOf(blockers) == Approx(kBoxArea + 2).epsilon(1e-5));
    CHECK(blockers.size() == std::ceil((kBoxArea + 2) * 16 / 0.25));
    std::array<int, 4 * 6> floor{};
    int quad = 0;
    for (const Blocker& b : blockers) {
        const bool ofQuad = std::abs(b.position.y - 1) < 1e-6 && std::abs(b.normal.y) > 0.5f;
        quad += ofQuad;
        REQUIRE(b.albedo == (ofQuad ? Color(0.5f) : Color(0.25f, 0.5f, 1)));
        REQUIRE(b.albedoBehind == (ofQuad ? Color(0.5f) : Color(0.0f)));
        if (b.position.y > 1e-6 || b.normal.y < 0.5f) continue;
        const auto x = std::min(3u, static_cast<unsigned>(b.position.x * 2));
        const auto z = std::min(5u, static_cast<unsigned>(b.position.z * 1.5));
        ++floor[x + 4 * z];
    }
    CHECK(std::abs(quad - 2 * 16 / 0.25) <= 2);
    // Every ½ × ⅔ of the floor has its 16 · 4/3, a few more or less at the edges.
    for (const int n : floor) CHECK(std::abs(n - 16 * 4 / 3.0) <= 8);
}

TEST_CASE("blockers keep to their region and leave out what masks cut", "[blockers]")
{
    Scene scene;
    addMaterial(scene, Color(1.0f), Color(0.0f), false);
    addQuad(scene, 0, {0, 0, 0}, {0, 0, 2}, {2, 0, 0});
    scene.meshes[0].uv[0] = {{0, 0}, {0, 1}, {1, 1}, {1, 0}};
    Texture half; // red and whole on the left, cut away on the right
    half.width = 2;
    half.height = 1;
    half.nearest = true;
    half.pixels = {1, 0, 0, 1, 0, 1, 0, 0};
    scene.textures.push_back(half);
    scene.materials[0].baseColorTexture.texture = 0;
    scene.materials[0].alphaMask = true;
    const auto tracer = makeTracer(std::move(scene));
    BlockerOptions options;
    options.spacing = 0.1;
    CHECK(areaOf(surfaceBlockers(*tracer, options)) == Approx(2).epsilon(0.01));
    // A box that the floor's diagonal and the mask's edge cut: of [¾,1½] × [½,1¾] the mask leaves
    // x below 1.
    options.region = Box3d({0.75, -1, 0.5}, {1.5, 1, 1.75});
    const std::vector<Blocker> inside = surfaceBlockers(*tracer, options);
    CHECK(areaOf(inside) == Approx(0.25 * 1.25).epsilon(0.02));
    REQUIRE(inside.size() > 400);
    for (const Blocker& b : inside) {
        REQUIRE(b.position.x >= 0.75 - 1e-9);
        REQUIRE(b.position.x <= 1 + 1e-6);
        REQUIRE(b.position.z >= 0.5 - 1e-9);
        REQUIRE(b.position.z <= 1.75 + 1e-9);
        REQUIRE(b.albedo == Color(1, 0, 0));
    }
    options.region = Box3d({0, 1, 0}, {2, 2, 2});
    CHECK(surfaceBlockers(*tracer, options).empty());
}

TEST_CASE("blockers are the same bits for any number of threads", "[blockers]")
{
    const auto tracer = makeTracer(litRoom());
    BlockerOptions options;
    options.spacing = 0.1;
    options.seed = 3;
    const std::vector<Blocker> one = surfaceBlockers(*tracer, options);
    REQUIRE(one.size() > 20000);
    for (const std::size_t threads : {1u, 2u, 4u}) {
        tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
        const std::vector<Blocker> other = surfaceBlockers(*tracer, options);
        REQUIRE(other.size() == one.size());
        for (std::size_t i = 0; i < one.size(); ++i) {
            REQUIRE(one[i].position == other[i].position);
            REQUIRE(one[i].normal == other[i].normal);
            REQUIRE(one[i].area == other[i].area);
        }
    }
}

TEST_CASE("hard cases of blockers", "[blockers]")
{
    const auto tracer = makeTracer(boxScene(Color(0.5f)));
    BlockerOptions options;
    SECTION("options out of range")
    {
        options.spacing = 1e-4;
        CHECK_THAT(errorOf(ErrorCode::Usage, [&] { surfaceBlockers(*tracer, options); }),
            Catch::Contains("blockers"));
        for (const double bad : {0.0, -1.0, std::numeric_limits<double>::infinity()}) {
            options.spacing = bad;
            CHECK_THAT(errorOf(ErrorCode::Usage, [&] { surfaceBlockers(*tracer, options); }),
                Catch::Contains("spacing"));
        }
        options.spacing = 1;
        for (const int bad : {0, 4097}) {
            options.perFace = bad;
            CHECK_THAT(errorOf(ErrorCode::Usage, [&] { surfaceBlockers(*tracer, options); }),
                Catch::Contains("perFace"));
        }
    }
    SECTION("no geometry")
    {
        const auto empty = makeTracer(Scene{{}, {Material{}}, {}, {}, {}, nullptr, {}, {}});
        CHECK(surfaceBlockers(*empty, options).empty());
    }
    SECTION("cancelled")
    {
        struct Stopped : Progress {
            bool cancelled() override { return true; }
        } stopped;
        CHECK(errorOf(ErrorCode::Interrupted, [&] { surfaceBlockers(*tracer, options, &stopped); })
            != "");
    }
}
