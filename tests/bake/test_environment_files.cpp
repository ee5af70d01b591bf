// SPDX-License-Identifier: Apache-2.0
// Environment::load and what it refuses.
#include <catch2/catch.hpp>

#include <lumivdb/bake/environment.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <limits>

using namespace lumivdb;

namespace {

constexpr double kPi = 3.14159265358979323846;

/// Direction of a point of a lat-long image, in pixels.
Vec3d look(int width, int height, double px, double py)
{
    const double phi = 2 * kPi * (px / width - 0.5), theta = kPi * py / height;
    return {std::sin(theta) * std::cos(phi), std::cos(theta), std::sin(theta) * std::sin(phi)};
}

EnvironmentOptions optionsFor(EnvironmentProjection projection)
{
    EnvironmentOptions options;
    options.projection = projection;
    return options;
}

double largest(const std::vector<Vec3d>& c)
{
    double m = 0;
    for (const Vec3d& v : c)
        for (int i = 0; i < 3; ++i) m = std::max(m, std::abs(v[i]));
    return m;
}

class TemporaryFolder {
public:
    TemporaryFolder()
    {
        static int counter = 0;
        const std::uint64_t unique = reinterpret_cast<std::uintptr_t>(this);
        mPath = std::filesystem::temp_directory_path()
            / ("lumivdb_environment_" + std::to_string(unique) + "_" + std::to_string(++counter));
        std::filesystem::create_directories(mPath);
    }
    ~TemporaryFolder()
    {
        std::error_code ignored;
        std::filesystem::remove_all(mPath, ignored);
    }
    std::string file(const std::string& name) const { return (mPath / name).string(); }

private:
    std::filesystem::path mPath;
};

void writeImage(const std::string& path, int w, int h, int channels, OIIO::TypeDesc type,
    const std::vector<float>& data)
{
    auto out = OIIO::ImageOutput::create(path);
    REQUIRE(out);
    REQUIRE(out->open(path, OIIO::ImageSpec(w, h, channels, type)));
    REQUIRE(out->write_image(OIIO::TypeDesc::FLOAT, data.data()));
    REQUIRE(out->close());
}

std::string inputErrorOf(const std::function<void()>& action)
{
    try {
        action();
    } catch (const Error& e) {
        CHECK(e.code() == ErrorCode::Input);
        return e.what();
    }
    FAIL("no error");
    return {};
}

std::shared_ptr<const Environment> loadQuietly(const std::string& path)
{
    std::vector<std::string> warnings;
    auto environment = Environment::load(path, {}, warnings);
    CHECK(warnings.empty());
    return environment;
}

} // namespace

TEST_CASE("sizes that fit no projection", "[environment]")
{
    const auto make = [](int w, int h, EnvironmentProjection projection) {
        return inputErrorOf([&] {
            Environment::fromPixels(
                w, h, std::vector<Color>(std::size_t(w * h), Color(0)), optionsFor(projection));
        });
    };
    const std::string message = make(5, 3, EnvironmentProjection::Auto);
    for (const char* word : {"5 x 3", "2:1", "1:1", "3:4", "4:3"})
        CHECK(message.find(word) != std::string::npos);
    CHECK(make(0, 0, EnvironmentProjection::Auto).find("pixels") != std::string::npos);
    CHECK_FALSE(make(4, 3, EnvironmentProjection::AngularMap).empty());
    CHECK_FALSE(make(6, 6, EnvironmentProjection::CubeCross).empty());
    CHECK_NOTHROW(Environment::fromPixels(
        5, 3, std::vector<Color>(15, Color(0)), optionsFor(EnvironmentProjection::LatLong)));
    CHECK_THROWS_AS(Environment::fromPixels(4, 2, std::vector<Color>(7, Color(0)), {}), Error);
    CHECK_THROWS_AS(Environment::constant(Color(1))->projectDouble(7), Error);
    CHECK_THROWS_AS(Environment::constant(Color(1))->projectDouble(0), Error);
    EnvironmentOptions options;
    options.scale = std::numeric_limits<float>::infinity();
    CHECK_THROWS_AS(Environment::fromPixels(4, 2, std::vector<Color>(8, Color(0)), options), Error);
    options.scale = 1e10f;
    CHECK_THROWS_AS(
        Environment::fromPixels(4, 2, std::vector<Color>(8, Color(1e35f)), options), Error);
}

TEST_CASE("files: channels, sRGB, alpha, names", "[environment]")
{
    TemporaryFolder folder;
    const auto first
        = [](const std::string& path) { return loadQuietly(path)->radiance(Vec3d(0, 1, 0)).x; };
    // 2 × 1 lat-longs of one colour.
    writeImage(folder.file("rgb.exr"), 2, 1, 3, OIIO::TypeDesc::FLOAT, {.5f, 2, 3, .5f, 2, 3});
    CHECK(loadQuietly(folder.file("rgb.exr"))->radiance(Vec3d(0, 1, 0)) == Color(.5f, 2, 3));
    writeImage(folder.file("grey.exr"), 2, 1, 1, OIIO::TypeDesc::HALF, {.5f, .5f});
    CHECK(loadQuietly(folder.file("grey.exr"))->radiance(Vec3d(0, 1, 0)) == Color(.5f));
    writeImage(
        folder.file("alpha.exr"), 2, 1, 4, OIIO::TypeDesc::FLOAT, {1, 2, 3, .25f, 1, 2, 3, .25f});
    CHECK(loadQuietly(folder.file("alpha.exr"))->radiance(Vec3d(0, 1, 0)) == Color(1, 2, 3));
    // sRGB 188/255 decodes to ((0.737255 + 0.055)/1.055)^2.4 = 0.502886.
    const float s = 188 / 255.0f;
    writeImage(folder.file("srgb.png"), 2, 1, 3, OIIO::TypeDesc::UINT8, {s, s, s, s, s, s});
    CHECK(first(folder.file("srgb.png")) == Approx(0.502886).epsilon(1e-4));
    // Transparent, with colours that are not multiplied by alpha, as PNG stores them.
    OIIO::ImageSpec spec(2, 1, 4, OIIO::TypeDesc::UINT8);
    spec["oiio:UnassociatedAlpha"] = 1;
    auto png = OIIO::ImageOutput::create(folder.file("alpha.png"));
    REQUIRE(png->open(folder.file("alpha.png"), spec));
    const std::vector<float> clear{s, s, s, 0.25f, s, s, s, 0.25f};
    REQUIRE(png->write_image(OIIO::TypeDesc::FLOAT, clear.data()));
    REQUIRE(png->close());
    CHECK(first(folder.file("alpha.png")) == Approx(0.502886).epsilon(1e-4));
    const std::string umlaut = folder.file("h\xc3\xbcgel \xe7\xa9\xba.hdr");
    writeImage(umlaut, 2, 1, 3, OIIO::TypeDesc::FLOAT, {1, 1, 1, 1, 1, 1});
    CHECK(first(umlaut) == Approx(1).epsilon(0.01));
    EnvironmentOptions options;
    options.scale = 4;
    std::vector<std::string> warnings;
    CHECK(Environment::load(folder.file("rgb.exr"), options, warnings)->radiance(Vec3d(0, 1, 0))
        == Color(2, 8, 12));
}

TEST_CASE("an EXR whose data window is smaller than its picture", "[environment]")
{
    // 8 × 4 picture, data in columns 6–8 of rows 1–2: column 8 lies outside and is dropped, what
    // is not stored is black.
    TemporaryFolder folder;
    OIIO::ImageSpec spec(3, 2, 3, OIIO::TypeDesc::FLOAT);
    spec.x = 6;
    spec.y = 1;
    spec.full_width = 8;
    spec.full_height = 4;
    const std::string path = folder.file("window.exr");
    auto out = OIIO::ImageOutput::create(path);
    REQUIRE(out->open(path, spec));
    REQUIRE(out->write_image(OIIO::TypeDesc::FLOAT, std::vector<float>(18, 2.0f).data()));
    REQUIRE(out->close());
    const auto env = loadQuietly(path);
    for (int y = 0; y < 4; ++y) {
        for (int x = 0; x < 8; ++x) {
            const bool stored = x >= 6 && (y == 1 || y == 2);
            CHECK(env->radiance(look(8, 4, x + 0.5, y + 0.5)) == Color(stored ? 2.0f : 0.0f));
        }
    }
}

TEST_CASE("bad pixels count as black, with one warning", "[environment]")
{
    TemporaryFolder folder;
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const float inf = std::numeric_limits<float>::infinity();
    std::vector<float> data(8 * 4 * 3, 1.0f);
    data[0] = nan;
    data[3 * 5 + 1] = inf;
    data[3 * 9 + 2] = -1;
    data[3 * 9 + 0] = -inf;
    writeImage(folder.file("bad.exr"), 8, 4, 3, OIIO::TypeDesc::FLOAT, data);
    std::vector<std::string> warnings;
    const auto env = Environment::load(folder.file("bad.exr"), {}, warnings);
    REQUIRE(warnings.size() == 1);
    CHECK(warnings[0].find("bad.exr") != std::string::npos);
    CHECK(warnings[0].find("3 pixels") != std::string::npos);
    CHECK(env->radiance(look(8, 4, 0.5, 0.5)) == Color(0, 1, 1));
    CHECK(env->radiance(look(8, 4, 5.5, 0.5)) == Color(1, 0, 1));
    CHECK(env->radiance(look(8, 4, 1.5, 1.5)) == Color(0, 1, 0));
    CHECK(std::isfinite(largest(env->projectDouble(3))));
    CHECK(std::isfinite(env->power()));
}

TEST_CASE("broken files are refused with their name", "[environment]")
{
    TemporaryFolder folder;
    std::vector<std::string> warnings;
    const auto messageOf = [&](const std::string& name) {
        return inputErrorOf([&] { Environment::load(folder.file(name), {}, warnings); });
    };
    CHECK(messageOf("missing.hdr").find("missing.hdr") != std::string::npos);
    std::ofstream(folder.file("text.hdr")) << "this is no picture";
    CHECK(messageOf("text.hdr").find("text.hdr") != std::string::npos);
    std::ofstream(folder.file("empty.exr")).flush();
    CHECK(messageOf("empty.exr").find("empty.exr") != std::string::npos);
    writeImage(folder.file("odd.exr"), 5, 2, 1, OIIO::TypeDesc::FLOAT, std::vector<float>(10, 1));
    CHECK(messageOf("odd.exr").find("2:1") != std::string::npos);
    std::ofstream(folder.file("huge.hdr"))
        << "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1000000000 +X 2000000000\n";
    CHECK(messageOf("huge.hdr").find("huge.hdr") != std::string::npos);
}

TEST_CASE("no prefix of a file crashes", "[environment]")
{
    TemporaryFolder folder;
    std::vector<float> data;
    CounterRng random(8);
    for (int i = 0; i < 32 * 16 * 3; ++i) data.push_back(10 * random.next());
    for (const char* name : {"whole.hdr", "whole.exr"}) {
        writeImage(folder.file(name), 32, 16, 3, OIIO::TypeDesc::FLOAT, data);
        std::ifstream in(folder.file(name), std::ios::binary);
        const std::string bytes((std::istreambuf_iterator<char>(in)), {});
        REQUIRE(bytes.size() > 500);
        const std::string part = folder.file(std::string("part") + (name + 5));
        int refused = 0, tried = 0;
        for (std::size_t n = 0; n < bytes.size(); n += n < 300 ? 1 : 17) {
            std::ofstream(part, std::ios::binary).write(bytes.data(), std::streamsize(n));
            ++tried;
            try {
                std::vector<std::string> warnings;
                Environment::load(part, {}, warnings);
            } catch (const Error& e) {
                CHECK(e.code() == ErrorCode::Input);
                ++refused;
            }
        }
        INFO(name << ": refused " << refused << " of " << tried);
        CHECK(refused >= tried - 2);
    }
}

TEST_CASE("a real sky: rooitou_park", "[environment]")
{
    const std::string path = std::string(LUMIVDB_ASSETS) + "/hdri-polyhaven/rooitou_park_1k.hdr";
    if (!std::filesystem::exists(path)) {
        WARN("skipped: " << path << " is not there");
        return;
    }
    const auto env = loadQuietly(path);
    // The file's documented facts. The sun's pixel (614, 226) of 1024 × 512 has its centre at
    // θ = π·226.5/512, so its elevation is 90° − 79.63° = 10.37°.
    const Vec3d sun = look(1024, 512, 614.5, 226.5);
    CHECK(std::asin(sun.y) * 180 / kPi == Approx(10.4).margin(0.1));
    const Color peak = env->radiance(sun);
    CHECK(std::max({peak.x, peak.y, peak.z}) == 69120.0f);

    double mean = 0; // over pixels
    std::vector<std::pair<double, double>> texels; // luminance, solid angle
    for (int y = 0; y < 512; ++y) {
        const double omega
            = 2 * kPi / 1024 * (std::cos(kPi * y / 512) - std::cos(kPi * (y + 1) / 512));
        for (int x = 0; x < 1024; ++x) {
            texels.emplace_back(luminance(env->radiance(look(1024, 512, x + 0.5, y + 0.5))), omega);
            mean += texels.back().first * omega / (4 * kPi);
        }
    }
    CHECK(env->power() == Approx(mean * 4 * kPi).epsilon(1e-6));
    CHECK(mean == Approx(0.756).epsilon(0.01));
    std::sort(texels.rbegin(), texels.rend());
    double flux = 0, omega = 0;
    for (std::size_t k = 0; omega < 1e-3; ++k) {
        flux += texels[k].first * texels[k].second;
        omega += texels[k].second;
    }
    CHECK(flux / env->power() == Approx(0.65).margin(0.02));

    // Sampling goes where the light is, and every draw is consistent.
    CounterRng random(3);
    int nearSun = 0;
    const int n = 20000;
    for (int k = 0; k < n; ++k) {
        const Environment::Sample s = env->sample(random.nextDouble(), random.nextDouble());
        nearSun += s.direction.dot(sun) > std::cos(0.03);
        REQUIRE(env->radiance(s.direction) == s.radiance);
    }
    CHECK(double(nearSun) / n > 0.6);
}
