// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/viewer/picture.h>

#include <lumivdb/core/error.h>

#include <OpenImageIO/imageio.h>
#include <catch2/catch.hpp>

#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

using namespace lumivdb;
namespace fs = std::filesystem;

namespace {

/// A folder of its own for every test, removed afterwards.
struct Folder {
    fs::path path = fs::temp_directory_path() / ("lumivdb_picture_" + std::to_string(::getpid()));
    Folder()
    {
        fs::remove_all(path);
        fs::create_directories(path);
    }
    ~Folder() { fs::remove_all(path); }
    std::string operator/(const std::string& name) const { return (path / name).string(); }
    std::size_t entries() const
    {
        return std::size_t(std::distance(fs::directory_iterator(path), fs::directory_iterator()));
    }
};

Image makeImage(int width, int height, std::vector<Color> pixels)
{
    Image image;
    image.width = width;
    image.height = height;
    image.pixels = std::move(pixels);
    return image;
}

template <class T> std::vector<T> readPixels(const std::string& path, OIIO::TypeDesc type)
{
    const auto input = OIIO::ImageInput::open(path);
    REQUIRE(input);
    const OIIO::ImageSpec& spec = input->spec();
    CHECK(spec.nchannels == 3);
    CHECK(spec.format == type); // stored so, not converted for us
    std::vector<T> pixels(std::size_t(spec.width) * spec.height * 3);
    REQUIRE(input->read_image(0, 0, 0, 3, type, pixels.data()));
    return pixels;
}

std::string bytesOf(const std::string& path)
{
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
}

template <class Action> Error errorOf(const Action& action)
{
    try {
        action();
    } catch (const Error& e) {
        return e;
    }
    FAIL("nothing was thrown");
    return {ErrorCode::BoundNotMet, ""};
}

} // namespace

TEST_CASE("png: exposure, highlights, sRGB", "[image]")
{
    // sRGB: 0.18 → 1.055·0.18^(1/2.4) − 0.055 = 0.46136 → 117.6; 0.5 → 0.735357 → 187.5;
    // 0.002 → 12.92·0.002 = 0.02584 → 6.6; 1 → 1 − 0.5 e^−1 = 0.816060 → 0.914363 → 233.2;
    // 100 → 1 → 255. NaN and negative → 0. Infinity → 255.
    const Folder folder;
    const Image image
        = makeImage(3, 1, {{0.18f, 0.5f, 0.002f}, {1.0f, 100.0f, -1.0f}, {NAN, INFINITY, 0.0f}});
    const std::vector<int> expected = {118, 188, 7, 233, 255, 0, 0, 255, 0};
    writeImage(image, folder / "a.png", 0);
    const auto bytes = readPixels<std::uint8_t>(folder / "a.png", OIIO::TypeDesc::UINT8);
    CHECK(std::vector<int>(bytes.begin(), bytes.end()) == expected);

    // A quarter of the light, two stops up: the same file.
    Image dark = image;
    for (Color& c : dark.pixels) c *= 0.25f;
    writeImage(dark, folder / "b.png", 2);
    CHECK(bytesOf(folder / "b.png") == bytesOf(folder / "a.png"));
    CHECK(folder.entries() == 2); // no temporary file is left
}

TEST_CASE("png: automatic exposure takes the 95th percentile to 0.8", "[image]")
{
    // Luminances 1 … 100, number 0.95·99 rounded down is 95; black and not finite ones are left
    // out.
    std::vector<Color> pixels;
    for (int i = 100; i >= 1; --i) pixels.push_back(Color(float(i)));
    pixels.push_back(Color(NAN));
    pixels.resize(120, Color(INFINITY));
    pixels.resize(200, Color(0));
    const Image image = makeImage(10, 20, pixels);
    CHECK(automaticExposure(image) == Approx(0.8 / 95).epsilon(1e-6));
    CHECK(automaticExposure(makeImage(1, 1, {Color(0)})) == 1);
    CHECK(automaticExposure(makeImage(1, 1, {Color(NAN)})) == 1);
    const Folder folder;
    writeImage(image, folder / "auto.png", NAN);
    const auto bytes = readPixels<std::uint8_t>(folder / "auto.png", OIIO::TypeDesc::UINT8);
    CHECK(int(bytes[3 * 5]) == 221); // value 95: 0.8 → 0.725594 → 0.868014
    CHECK(int(bytes[3 * 100]) == 0);
}

TEST_CASE("exr: linear floats, bit for bit", "[image]")
{
    const Folder folder;
    const Image image = makeImage(
        2, 2, {{1e-20f, 1.0f / 3, 1e30f}, {-2, 0, 65505}, {0.1f, 0.2f, 0.3f}, {7, 8, 9}});
    for (double stops : {0.0, 5.0, double(NAN)}) {
        writeImage(image, folder / "a.exr", stops); // exposure is for .png
        const auto floats = readPixels<float>(folder / "a.exr", OIIO::TypeDesc::FLOAT);
        REQUIRE(floats.size() == 12);
        for (int i = 0; i < 12; ++i) CHECK(floats[i] == image.pixels[i / 3][i % 3]);
    }
    writeDisplayImage(image, folder / "b.EXR");
    CHECK(bytesOf(folder / "b.EXR") == bytesOf(folder / "a.exr"));
    // Today's date would make the same picture another file tomorrow.
    const auto input = OIIO::ImageInput::open(folder / "a.exr");
    REQUIRE(input);
    CHECK(input->spec().get_string_attribute("DateTime") == "1970:01:01 00:00:00");
    CHECK(folder.entries() == 2);
}

TEST_CASE("display images are written as they are", "[image]")
{
    const Folder folder;
    writeDisplayImage(makeImage(1, 2, {{0, 0.5f, 1}, {2, -1, 0.25f}}), folder / "a.PNG");
    const auto bytes = readPixels<std::uint8_t>(folder / "a.PNG", OIIO::TypeDesc::UINT8);
    CHECK(
        std::vector<int>(bytes.begin(), bytes.end()) == std::vector<int>{0, 128, 255, 255, 0, 64});
}

TEST_CASE("names with spaces and other alphabets, and files that exist", "[image]")
{
    const Folder folder;
    const std::string path = folder / "Ein schönes 图.png";
    writeImage(makeImage(1, 1, {Color(0.5f)}), path, 0);
    const std::string first = bytesOf(path);
    REQUIRE(!first.empty());
    writeImage(makeImage(1, 1, {Color(0.1f)}), path, 0);
    CHECK(bytesOf(path) != first); // replaced
    CHECK(folder.entries() == 1);
}

TEST_CASE("what cannot be written is said by name", "[image]")
{
    const Folder folder;
    const Image image = makeImage(1, 1, {Color(1)});
    for (const char* name : {"a.jpg", "a", "a.png.tif", ".png"}) {
        const std::string path = folder / name;
        const Error e = errorOf([&] { writeImage(image, path, 0); });
        CHECK(e.code() == ErrorCode::Usage);
        CHECK(std::string(e.what()).find(path) != std::string::npos);
        CHECK(std::string(e.what()).find(".png or .exr") != std::string::npos);
        CHECK(errorOf([&] { checkImagePath(path); }).code() == ErrorCode::Usage);
        CHECK(errorOf([&] { writeDisplayImage(image, path); }).code() == ErrorCode::Usage);
    }
    CHECK_NOTHROW(checkImagePath("anywhere/a.png"));

    const std::string lost = folder / "missing/a.png";
    const Error missing = errorOf([&] { writeImage(image, lost, 0); });
    CHECK(missing.code() == ErrorCode::Output);
    CHECK(std::string(missing.what()).find(lost) != std::string::npos);
    CHECK(std::string(missing.what()).find("No such file") != std::string::npos);

    // A folder in the way: the temporary file goes, the folder stays.
    fs::create_directories(folder.path / "way.exr" / "inside");
    CHECK(errorOf([&] { writeImage(image, folder / "way.exr", 0); }).code() == ErrorCode::Output);
    CHECK(fs::is_directory(folder.path / "way.exr" / "inside"));
    CHECK(folder.entries() == 1);

    CHECK(errorOf([&] { writeImage(Image(), folder / "a.png", 0); }).code() == ErrorCode::Usage);
    CHECK(errorOf([&] { writeImage(makeImage(2, 2, {Color(0)}), folder / "a.png", 0); }).code()
        == ErrorCode::Usage);
    CHECK(folder.entries() == 1);
}
