// SPDX-License-Identifier: Apache-2.0
#include <catch2/catch.hpp>

#include <lumivdb/bake/environment.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/core/sh.h>

#include <tbb/global_control.h>

#include <cmath>
#include <functional>
#include <limits>
#include <map>

using namespace lumivdb;

namespace {

constexpr double kPi = 3.14159265358979323846;

struct Map {
    const char* label;
    EnvironmentProjection projection;
    int width, height;
};

std::vector<Map> maps(int size)
{
    return {{"lat-long", EnvironmentProjection::LatLong, 2 * size, size},
        {"angular map", EnvironmentProjection::AngularMap, 2 * size, 2 * size},
        {"vertical cross", EnvironmentProjection::CubeCross, 3 * size / 2, 2 * size},
        {"horizontal cross", EnvironmentProjection::CubeCross, 2 * size, 3 * size / 2}};
}

EnvironmentOptions optionsFor(EnvironmentProjection projection)
{
    EnvironmentOptions options;
    options.projection = projection;
    return options;
}

/// The conventions written down a second time, from the pictures in the documentation: where the
/// point (px, py), in pixels from the upper left corner, looks. Beyond an angular map's rim the
/// formula goes on; where a cross has no face the result is zero.
Vec3d lookAnywhere(const Map& map, double px, double py)
{
    if (map.projection == EnvironmentProjection::LatLong) {
        const double phi = 2 * kPi * (px / map.width - 0.5), theta = kPi * py / map.height;
        return {std::sin(theta) * std::cos(phi), std::cos(theta), std::sin(theta) * std::sin(phi)};
    }
    if (map.projection == EnvironmentProjection::AngularMap) {
        const double x = 2 * px / map.width - 1, y = 1 - 2 * py / map.height;
        const double r = std::hypot(x, y), around = std::atan2(y, x);
        return {std::sin(kPi * r) * std::cos(around), std::sin(kPi * r) * std::sin(around),
            -std::cos(kPi * r)};
    }
    // Crosses: unfold. X and Y measured in faces from the centre of the cross's centre face.
    const bool vertical = map.height > map.width;
    const double size = vertical ? map.width / 3.0 : map.width / 4.0;
    const double x = px / size - 1.5, y = 1.5 - py / size;
    Vec3d d(0);
    if (std::abs(x) <= 0.5 && std::abs(y) <= 0.5)
        d = {x, y, -0.5};
    else if (std::abs(y) <= 0.5 && x < 0 && x > -1.5)
        d = {-0.5, y, -0.5 + (-0.5 - x)};
    else if (std::abs(y) <= 0.5 && x < 1.5)
        d = {0.5, y, -0.5 + (x - 0.5)};
    else if (std::abs(y) <= 0.5)
        d = {0.5 - (x - 1.5), y, 0.5}; // horizontal: on to the right
    else if (std::abs(x) <= 0.5 && y > 0)
        d = {x, 0.5, -0.5 + (y - 0.5)};
    else if (std::abs(x) <= 0.5 && y > -1.5)
        d = {x, -0.5, -0.5 + (-0.5 - y)};
    else if (std::abs(x) <= 0.5)
        d = {x, -0.5 + (-1.5 - y), 0.5}; // vertical: on downwards
    return d.length() > 0 ? d.normalized() : d;
}

/// The same, zero where there is no light.
Vec3d look(const Map& map, double px, double py)
{
    const double r = std::hypot(2 * px / map.width - 1, 1 - 2 * py / map.height);
    const bool outside = map.projection == EnvironmentProjection::AngularMap && r > 1;
    return outside ? Vec3d(0) : lookAnywhere(map, px, py);
}

/// Solid angle around a point per pixel², from neighbouring directions alone.
double localSolidAngle(const Map& map, double px, double py)
{
    const double e = 1e-4;
    const Vec3d dx = lookAnywhere(map, px + e, py) - lookAnywhere(map, px - e, py);
    const Vec3d dy = lookAnywhere(map, px, py + e) - lookAnywhere(map, px, py - e);
    return dx.cross(dy).length() / (4 * e * e);
}

using Sky = std::function<Vec3d(const Vec3d&)>;

/// Every texel gets the mean radiance of the sky over its solid angle.
std::shared_ptr<const Environment> draw(const Map& map, const Sky& sky, int sub)
{
    std::vector<Color> pixels(static_cast<std::size_t>(map.width) * map.height, Color(0));
    for (int y = 0; y < map.height; ++y) {
        for (int x = 0; x < map.width; ++x) {
            Vec3d sum(0);
            double area = 0;
            for (int k = 0; k < sub * sub; ++k) {
                const double px = x + (k % sub + 0.5) / sub, py = y + (k / sub + 0.5) / sub;
                const Vec3d d = look(map, px, py);
                if (d.length() < 0.5) continue;
                const double w = localSolidAngle(map, px, py);
                sum += sky(d) * w;
                area += w;
            }
            if (area > 0) pixels[static_cast<std::size_t>(y) * map.width + x] = Color(sum / area);
        }
    }
    return Environment::fromPixels(
        map.width, map.height, std::move(pixels), optionsFor(map.projection));
}

/// Random texels over five decades, one in eight black.
std::shared_ptr<const Environment> noise(const Map& map, std::uint64_t seed)
{
    CounterRng random(seed);
    std::vector<Color> pixels(static_cast<std::size_t>(map.width) * map.height, Color(0));
    for (Color& c : pixels) {
        const float level = random.next() < 0.125f ? 0.0f : std::pow(10.0f, 5 * random.next() - 2);
        c = Color(random.next(), random.next(), random.next()) * level;
    }
    return Environment::fromPixels(
        map.width, map.height, std::move(pixels), optionsFor(map.projection));
}

Vec3d randomDirection(CounterRng& random)
{
    const double z = 2 * random.nextDouble() - 1, phi = 2 * kPi * random.nextDouble();
    const double s = std::sqrt(1 - z * z);
    return {s * std::cos(phi), s * std::sin(phi), z};
}

Mat3d randomRotation(CounterRng& random)
{
    const Vec3d x = randomDirection(random);
    const Vec3d y = x.cross(randomDirection(random)).normalized();
    const Vec3d z = x.cross(y);
    return Mat3d(x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z);
}

double largest(const std::vector<Vec3d>& c)
{
    double m = 0;
    for (const Vec3d& v : c)
        for (int i = 0; i < 3; ++i) m = std::max(m, std::abs(v[i]));
    return m;
}

double largestDifference(const std::vector<Vec3d>& a, const std::vector<Vec3d>& b)
{
    REQUIRE(a.size() == b.size());
    std::vector<Vec3d> difference(a.size(), Vec3d(0));
    for (std::size_t i = 0; i < a.size(); ++i) difference[i] = a[i] - b[i];
    return largest(difference);
}

} // namespace

TEST_CASE("lat-long axes, seams and poles", "[environment]")
{
    // 4 × 3 texels: columns −X…−Z, −Z…+X, +X…+Z, +Z…−X; rows up, horizon, down.
    std::vector<Color> pixels;
    for (int i = 0; i < 12; ++i) pixels.emplace_back(static_cast<float>(i + 1));
    const auto env
        = Environment::fromPixels(4, 3, pixels, optionsFor(EnvironmentProjection::LatLong));
    const double e = 1e-3;
    const auto at = [&](double x, double y, double z) {
        return env->radiance(Vec3d(x, y, z).normalized()).x;
    };
    CHECK(at(-1, 0, -e) == 5); // just right of the left edge
    CHECK(at(-1, 0, e) == 8); // just left of the right edge
    CHECK(at(-e, 0, -1) == 5);
    CHECK(at(e, 0, -1) == 6);
    CHECK(at(1, 0, -e) == 6);
    CHECK(at(1, 0, e) == 7);
    CHECK(at(e, 0, 1) == 7);
    CHECK(at(-e, 0, 1) == 8);
    CHECK(at(1, 2, 1) == 3); // 54.7° up from the horizon: the top row
    CHECK(at(1, -2, 1) == 11);
    // Exactly on seams and poles: some neighbouring texel, never outside the image.
    const double left = at(-1, 0, 0.0);
    CHECK((left == 8 || left == 5));
    CHECK(at(0, 1, 0) <= 4);
    CHECK(at(0, -1, 0) >= 9);
    CHECK(at(-0.0, -1, -0.0) >= 9);
    CHECK(std::isfinite(env->radiance(Vec3d(std::numeric_limits<double>::quiet_NaN())).x));
}

TEST_CASE("angular map axes and rim", "[environment]")
{
    const Map map{"", EnvironmentProjection::AngularMap, 8, 8};
    std::vector<Color> pixels;
    for (int i = 0; i < 64; ++i) pixels.emplace_back(static_cast<float>(i));
    const auto env = Environment::fromPixels(8, 8, pixels, optionsFor(map.projection));
    const double e = 1e-3;
    const auto at = [&](double x, double y, double z) {
        const int i = static_cast<int>(env->radiance(Vec3d(x, y, z).normalized()).x);
        return Vec2f(i % 8, i / 8);
    };
    CHECK(at(e, e, -1) == Vec2f(4, 3)); // centre: −Z, up and to the right of it
    CHECK(at(-e, -e, -1) == Vec2f(3, 4));
    CHECK(at(1, e, e) == Vec2f(6, 3)); // +X is r = ½, column 6 begins there
    CHECK(at(1, -e, -e) == Vec2f(5, 4));
    CHECK(at(-1, e, -e) == Vec2f(2, 3));
    CHECK(at(e, 1, e) == Vec2f(4, 1)); // +Y is half-way up
    CHECK(at(e, -1, e) == Vec2f(4, 6));
    CHECK(at(e, e * 0.01, 1) == Vec2f(7, 3)); // +Z is the rim
    CHECK(at(-e, -e * 0.01, 1) == Vec2f(0, 4));
    CHECK(std::isfinite(env->radiance(Vec3d(0, 0, 1)).x));
    CHECK(std::isfinite(env->pdf(Vec3d(0, 0, 1))));
    CHECK(std::isfinite(env->pdf(Vec3d(0, 0, -1))));
}

TEST_CASE("cube cross faces", "[environment]")
{
    // Faces of one colour each, counted by their cell in the picture (row · columns + column).
    const auto cross = [](int columns, int rows, int size) {
        std::vector<Color> pixels;
        for (int y = 0; y < rows * size; ++y)
            for (int x = 0; x < columns * size; ++x)
                pixels.emplace_back(static_cast<float>(y / size * columns + x / size));
        return Environment::fromPixels(columns * size, rows * size, std::move(pixels), {});
    };
    const auto vertical = cross(3, 4, 2), horizontal = cross(4, 3, 2);
    struct Face {
        Vec3d axis;
        float vertical, horizontal;
    };
    for (const Face& f : {Face{{0, 1, 0}, 1, 1}, Face{{-1, 0, 0}, 3, 4}, Face{{0, 0, -1}, 4, 5},
             Face{{1, 0, 0}, 5, 6}, Face{{0, -1, 0}, 7, 9}, Face{{0, 0, 1}, 10, 7}}) {
        CHECK(vertical->radiance(f.axis).x == f.vertical);
        CHECK(horizontal->radiance(f.axis).x == f.horizontal);
    }
    // Quarters of the +Z face: upright in the horizontal cross, by 180° in the vertical one.
    const auto numbered = [](int w, int h) {
        std::vector<Color> pixels;
        for (int i = 0; i < w * h; ++i) pixels.emplace_back(static_cast<float>(i));
        return Environment::fromPixels(w, h, std::move(pixels), {});
    };
    const Vec3d upLeft = Vec3d(0.5, 0.5, 1).normalized(); // looking along +Z, left is +X
    CHECK(numbered(8, 6)->radiance(upLeft).x == 2 * 8 + 6); // upper left of cell (3, 1)
    CHECK(numbered(6, 8)->radiance(upLeft).x == 7 * 6 + 3); // lower right of cell (1, 3)
    // Upper face: its lower edge meets the −Z face, its right edge the +X face.
    CHECK(numbered(8, 6)->radiance(Vec3d(0.5, 1, -0.5).normalized()).x == 1 * 8 + 3);
    CHECK(numbered(6, 8)->radiance(Vec3d(0.5, -1, -0.5).normalized()).x == 4 * 6 + 3);
}

TEST_CASE("look-up agrees with the written conventions everywhere", "[environment]")
{
    for (const Map& map : maps(8)) {
        std::vector<Color> pixels;
        for (int i = 0; i < map.width * map.height; ++i) pixels.emplace_back(i + 1.0f);
        const auto env
            = Environment::fromPixels(map.width, map.height, pixels, optionsFor(map.projection));
        CounterRng random(1);
        int seen = 0;
        for (int k = 0; k < 20000; ++k) {
            const double px = map.width * random.nextDouble(),
                         py = map.height * random.nextDouble();
            const Vec3d d = look(map, px, py);
            if (d.length() < 0.5) continue;
            ++seen;
            if (env->radiance(d).x != pixels[int(py) * map.width + int(px)].x) {
                FAIL(map.label << " at " << px << ", " << py);
            }
        }
        CHECK(seen > 9000);
    }
}

TEST_CASE("--env-rotate turns the light right-handed about +Y", "[environment]")
{
    // A light at +X, turned by 90° about +Y, stands at −Z (X × … : Y × X = −Z).
    std::vector<Color> pixels(8 * 4, Color(0));
    for (int i : {11, 12, 19, 20}) pixels[i] = Color(1); // around the centre, +X
    EnvironmentOptions options;
    CHECK(Environment::fromPixels(8, 4, pixels, options)->radiance(Vec3d(1, 0, 0)).x == 1);
    options.rotateDegrees = 90;
    const auto turned = Environment::fromPixels(8, 4, pixels, options);
    CHECK(turned->radiance(Vec3d(0, 0, -1)).x == 1);
    CHECK(turned->radiance(Vec3d(1, 0, 0)).x == 0);
    CHECK(turned->radiance(Vec3d(0, 0, 1)).x == 0);
    options.rotateDegrees = -270;
    CHECK(Environment::fromPixels(8, 4, pixels, options)->contentHash() == turned->contentHash());

    // rotated(R): what came from d comes from d * R, after whatever rotation there was.
    CounterRng random(5);
    const Mat3d R = randomRotation(random);
    const auto again = turned->rotated(R);
    for (int k = 0; k < 1000; ++k) {
        const Vec3d d = randomDirection(random);
        REQUIRE(again->radiance(d * R) == turned->radiance(d));
    }
    CHECK_THROWS_AS(turned->rotated(Mat3d(2, 0, 0, 0, 1, 0, 0, 0, 1)), Error);
    CHECK_THROWS_AS(turned->rotated(Mat3d(-1, 0, 0, 0, 1, 0, 0, 0, 1)), Error);
}

TEST_CASE("every projection covers 4 pi", "[environment]")
{
    double worst = 0;
    for (int size : {4, 16, 64, 128}) {
        for (const Map& map : maps(size)) {
            const std::vector<Color> white(std::size_t(map.width) * map.height, Color(1));
            const auto env
                = Environment::fromPixels(map.width, map.height, white, optionsFor(map.projection));
            const double byTexels = env->power() / (4 * kPi) - 1;
            // ∫ 1·Y0 dω = 4π Y0 = √(4π)
            const double byQuadrature = env->projectDouble(1)[0].x / std::sqrt(4 * kPi) - 1;
            INFO(map.label << " " << size << ": " << byTexels << ", " << byQuadrature);
            CHECK(std::abs(byTexels) < 1e-6);
            CHECK(std::abs(byQuadrature) < 1e-6);
            worst = std::max({worst, std::abs(byTexels), std::abs(byQuadrature)});
        }
    }
    UNSCOPED_INFO("worst deviation from 4 pi: " << worst);
    CHECK(worst > 0);
}

TEST_CASE("the density integrates to one", "[environment]")
{
    for (const Map& map : maps(8)) {
        // The density is smooth inside a texel: midpoints of 16² parts, independent solid angles.
        const auto env = noise(map, 7);
        const int sub = 16;
        double integral = 0;
        for (int y = 0; y < map.height * sub; ++y) {
            for (int x = 0; x < map.width * sub; ++x) {
                const double px = (x + 0.5) / sub, py = (y + 0.5) / sub;
                const Vec3d d = look(map, px, py);
                if (d.length() > 0.5)
                    integral += env->pdf(d) * localSolidAngle(map, px, py) / (sub * sub);
            }
        }
        // What is missing are the draws that fall outside the disc and say so.
        int drawn = 0;
        const int n = 512;
        for (int k = 0; k < n * n; ++k)
            drawn += env->sample((k % n + 0.5) / n, (k / n + 0.5) / n).pdf > 0;
        const double share = double(drawn) / (n * n);
        INFO(map.label << ": " << integral << " of " << share);
        CHECK(integral == Approx(share).margin(2e-3));
        if (map.projection != EnvironmentProjection::AngularMap) {
            CHECK(share == 1.0);
            CHECK(integral == Approx(1.0).margin(5e-4));
        } else {
            CHECK(share > 0.9);
        }
    }
}

TEST_CASE("independent draws find texels as often as the density says", "[environment]")
{
    for (const Map& map : maps(8)) {
        const auto env = noise(map, 7);
        // Expected and found, by the texel's colour.
        std::map<float, std::pair<double, int>> texels;
        const int sub = 16, draws = 400000;
        for (int y = 0; y < map.height * sub; ++y) {
            for (int x = 0; x < map.width * sub; ++x) {
                const double px = (x + 0.5) / sub, py = (y + 0.5) / sub;
                const Vec3d d = look(map, px, py);
                if (d.length() < 0.5) continue;
                texels[env->radiance(d).x].first
                    += draws * env->pdf(d) * localSolidAngle(map, px, py) / (sub * sub);
            }
        }
        CounterRng random(23);
        for (int k = 0; k < draws; ++k) {
            const double t = random.nextDouble(), u = random.nextDouble();
            const Environment::Sample s = env->draw(t, u, random.nextDouble());
            if (s.pdf > 0) ++texels[s.radiance.x].second;
        }
        double chi2 = 0;
        int cells = 0;
        for (const auto& [red, counts] : texels) {
            if (counts.first < 10) continue;
            ++cells;
            chi2 += (counts.second - counts.first) * (counts.second - counts.first) / counts.first;
        }
        INFO(map.label << ": chi squared " << chi2 << " over " << cells);
        CHECK(cells > 40);
        CHECK(chi2 < cells + 5 * std::sqrt(2.0 * cells));
    }
}

TEST_CASE("samples agree with look-up and density", "[environment]")
{
    CounterRng random(11);
    for (const Map& map : maps(32)) {
        const auto env = noise(map, 3)->rotated(randomRotation(random));
        int drawn = 0;
        double worst = 0;
        for (int k = 0; k < 100000; ++k) {
            const double u = random.nextDouble(), v = random.nextDouble();
            const Environment::Sample s
                = k % 2 ? env->sample(u, v) : env->draw(random.nextDouble(), u, v);
            CHECK_FALSE(!(s.pdf >= 0));
            if (s.pdf == 0) continue;
            ++drawn;
            if (std::abs(s.direction.length() - 1) > 1e-12) FAIL("length");
            if (env->radiance(s.direction) != s.radiance) FAIL(map.label << ": another texel");
            worst = std::max(worst, std::abs(env->pdf(s.direction) / s.pdf - 1));
        }
        INFO(map.label << " worst relative difference of pdf " << worst << ", drawn " << drawn);
        CHECK(worst < 1e-6);
        CHECK(drawn > 95000);
    }
}

TEST_CASE("Monte Carlo with sample() meets project()", "[environment]")
{
    CounterRng random(21);
    for (const Map& map : maps(16)) {
        const auto env = noise(map, 9)->rotated(randomRotation(random));
        const std::vector<Vec3d> exact = env->projectDouble(3);
        const int n = 200000;
        std::vector<Vec3d> sum(9, Vec3d(0)), squares(9, Vec3d(0));
        for (int k = 0; k < n; ++k) {
            const Environment::Sample s = env->sample(random.nextDouble(), random.nextDouble());
            if (s.pdf == 0) continue;
            double y[9];
            evalShBasis(3, s.direction, y);
            for (int i = 0; i < 9; ++i) {
                const Vec3d f = Vec3d(s.radiance) * (y[i] / s.pdf);
                sum[i] += f;
                squares[i] += f * f;
            }
        }
        for (int i = 0; i < 9; ++i) {
            for (int c = 0; c < 3; ++c) {
                const double mean = sum[i][c] / n;
                const double sigma = std::sqrt((squares[i][c] / n - mean * mean) / n);
                INFO(map.label << " coefficient " << i << " channel " << c);
                CHECK(std::abs(mean - exact[i][c]) < 4.5 * sigma); // 108 tests at 7e-6 each
                CHECK(sigma < 0.01 * largest(exact));
            }
        }
    }
}

TEST_CASE("stratified numbers stay stratified", "[environment]")
{
    // Inversion is monotone: along v rows only grow, along u columns only grow. With a lat-long
    // map of one brightness per row, equal steps of v carry equal shares of the light.
    const Map map{"", EnvironmentProjection::LatLong, 16, 8};
    const auto env = noise(map, 2);
    double before = 10;
    for (int k = 0; k < 1000; ++k) {
        const double height = env->sample(0.5, (k + 0.5) / 1000).direction.y;
        CHECK(height <= before + 1e-12);
        before = height;
    }
    double angle = -10;
    for (int k = 0; k < 1000; ++k) {
        const Vec3d d = env->sample((k + 0.5) / 1000, 0.4).direction;
        CHECK(std::atan2(d.z, d.x) >= angle - 1e-12);
        angle = std::atan2(d.z, d.x);
    }
    const auto even = Environment::constant(Color(3));
    for (int k = 0; k < 64; ++k) {
        const double v = (k + 0.5) / 64;
        CHECK(even->sample(0.3, v).direction.y == Approx(1 - 2 * v).margin(1e-7));
        CHECK(even->sample(0.3, v).pdf == Approx(1 / (4 * kPi)).epsilon(1e-12));
    }
    CHECK(std::isfinite(env->sample(0, 0).pdf));
    const double last = std::nextafter(1.0, 0.0);
    CHECK(env->sample(last, last).pdf > 0);
}

TEST_CASE("constant environment: only band 0, E = pi L", "[environment]")
{
    const Color L(0.25f, 1.0f, 3.0f);
    CounterRng random(2);
    auto white = [&](const Map& map) {
        return Environment::fromPixels(map.width, map.height,
            std::vector<Color>(std::size_t(map.width) * map.height, L), optionsFor(map.projection));
    };
    std::vector<std::shared_ptr<const Environment>> all{Environment::constant(L)};
    for (const Map& map : maps(32)) all.push_back(white(map)->rotated(randomRotation(random)));
    for (const auto& env : all) {
        const std::vector<Vec3d> c = env->projectDouble(6);
        REQUIRE(c.size() == 36);
        for (int channel = 0; channel < 3; ++channel) {
            // E = A_0 L_00 Y_00 = π · (L √(4π)) · 1/√(4π) = π L
            CHECK(
                c[0][channel] * kPi / std::sqrt(4 * kPi) == Approx(kPi * L[channel]).epsilon(1e-6));
            for (int i = 1; i < 36; ++i) CHECK(std::abs(c[i][channel]) < 1e-6 * c[0][channel]);
        }
        CHECK(env->radiance(randomDirection(random)) == L);
    }
}

TEST_CASE("rotation commutes with projection", "[environment]")
{
    CounterRng random(31);
    double worst = 0;
    for (const Map& map : maps(16)) {
        const auto env = noise(map, 4);
        const std::vector<Vec3d> before = env->projectDouble(6);
        for (int k = 0; k < 5; ++k) {
            const Mat3d R = randomRotation(random);
            const std::vector<Vec3d> after = env->rotated(R)->projectDouble(6);
            const ShRotation rotation(6, R);
            std::vector<Vec3d> expected(36, Vec3d(0));
            for (int c = 0; c < 3; ++c) {
                double in[36], out[36];
                for (int i = 0; i < 36; ++i) in[i] = before[i][c];
                rotation.apply(in, out);
                for (int i = 0; i < 36; ++i) expected[i][c] = out[i];
            }
            worst = std::max(worst, largestDifference(after, expected) / largest(before));
        }
    }
    INFO("worst relative difference " << worst);
    CHECK(worst < 1e-6);
}

TEST_CASE("all projections of one sky agree", "[environment]")
{
    // A smooth sky and a sun blob: a von Mises–Fisher lobe, σ = 1/√500 rad = 2.6°, so bright that
    // it carries as much light as the sky. Texels (at most 2/64 rad) spread it, each projection in
    // its own way, which changes degree l by l(l+1)h²/48: below 0.07% here.
    const Vec3d sun = Vec3d(0.3, 0.5, -0.7).normalized();
    const Sky sky = [&](const Vec3d& d) {
        const Vec3d smooth(1 + 0.5 * d.y + 0.3 * d.x * d.z, 1 + 0.4 * d.y * d.y, 1.5 + d.y * d.x);
        return smooth + Vec3d(1.0, 0.9, 0.7) * (800 * std::exp(500 * (d.dot(sun) - 1)));
    };
    const std::vector<Map> all = maps(128);
    std::vector<std::vector<Vec3d>> coefficients;
    for (const Map& map : all) coefficients.push_back(draw(map, sky, 4)->projectDouble(6));
    double worst = 0;
    for (std::size_t k = 1; k < all.size(); ++k) {
        const double difference
            = largestDifference(coefficients[k], coefficients[0]) / largest(coefficients[0]);
        INFO(all[k].label << " against lat-long: " << difference);
        CHECK(difference < 1e-3);
        worst = std::max(worst, difference);
    }
    // The sun's share is known in closed form: 2π·800·(1 − e^−1000)/500 · Y_lm(sun) · A_l(500).
    const double flux = 2 * kPi * 800 / 500;
    const double smoothRed = 4 * kPi; // odd and cross terms vanish
    CHECK(coefficients[0][0].x == Approx((flux + smoothRed) / std::sqrt(4 * kPi)).epsilon(1e-4));
    INFO("worst " << worst);
    CHECK(worst < 1e-3);
}

TEST_CASE("a sun of one texel", "[environment]")
{
    // c_lm → L Ω Y_lm(centre); the texel is small, so that Y varies by (5h)²/24 of itself in it.
    for (const Map& map : maps(128)) {
        const double px = map.width * 0.5 + 12.5, py = map.height * 0.375 + 0.5;
        const int x = int(px), y = int(py);
        std::vector<Color> pixels(std::size_t(map.width) * map.height, Color(0));
        pixels[std::size_t(y) * map.width + x] = Color(5e4f, 4e4f, 2e4f);
        const auto env
            = Environment::fromPixels(map.width, map.height, pixels, optionsFor(map.projection));
        const Vec3d centre = look(map, x + 0.5, y + 0.5);
        const double omega = localSolidAngle(map, x + 0.5, y + 0.5);
        double Y[36];
        evalShBasis(6, centre, Y);
        const std::vector<Vec3d> c = env->projectDouble(6);
        for (int i = 0; i < 36; ++i) {
            INFO(map.label << " coefficient " << i);
            CHECK(c[i].x == Approx(5e4 * omega * Y[i]).margin(2e-3 * 5e4 * omega));
        }
        CHECK(env->power() == Approx(omega * luminance(Color(5e4f, 4e4f, 2e4f))).epsilon(1e-3));
        for (int k = 0; k < 100; ++k) {
            const Environment::Sample s = env->sample((k % 10 + 0.5) / 10, (k / 10 + 0.5) / 10);
            CHECK(s.pdf == Approx(1 / omega).epsilon(0.05));
        }
    }
}

TEST_CASE("weak and single-channel texels keep a positive density", "[environment]")
{
    std::vector<Color> pixels(8, Color(1e6f));
    pixels[0] = Color(0, 0, 1e-30f);
    pixels[1] = Color(0, std::numeric_limits<float>::denorm_min(), 0);
    const auto env
        = Environment::fromPixels(4, 2, pixels, optionsFor(EnvironmentProjection::LatLong));
    const Map map{"", EnvironmentProjection::LatLong, 4, 2};
    CHECK(env->pdf(look(map, 0.5, 0.5)) > 0);
    CHECK(env->pdf(look(map, 1.5, 0.5)) > 0);
    const auto black = Environment::fromPixels(4, 2, std::vector<Color>(8, Color(0)), {});
    CHECK(black->sample(0.5, 0.5).pdf == 0);
    CHECK(black->pdf(Vec3d(1, 0, 0)) == 0);
    CHECK(black->power() == 0);
    CHECK(largest(black->projectDouble(6)) == 0);
}

TEST_CASE("content hash", "[environment]")
{
    std::vector<Color> pixels(4 * 4, Color(1));
    const auto hash = [&](const EnvironmentOptions& options) {
        return Environment::fromPixels(4, 4, pixels, options)->contentHash();
    };
    const std::uint64_t reference = hash({});
    CHECK(hash({}) == reference);
    EnvironmentOptions options;
    options.scale = 2;
    CHECK(hash(options) != reference);
    options = {};
    options.rotateDegrees = 1;
    CHECK(hash(options) != reference);
    options.rotateDegrees = 360;
    CHECK(hash(options) == reference);
    CHECK(hash(optionsFor(EnvironmentProjection::LatLong)) != reference);
    pixels[3].y = 1.0001f;
    CHECK(hash({}) != reference);
}

TEST_CASE("the projection has the same bits for any number of threads", "[environment]")
{
    const auto env = noise(maps(32)[1], 6);
    const std::vector<Vec3d> reference = env->projectDouble(6);
    for (std::size_t threads : {1, 2, 5}) {
        tbb::global_control limit(tbb::global_control::max_allowed_parallelism, threads);
        CHECK(env->projectDouble(6) == reference);
    }
}
