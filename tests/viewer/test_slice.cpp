// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/viewer/picture.h>

#include <lumivdb/core/error.h>

#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>
#include <catch2/catch.hpp>

#include <cmath>
#include <functional>

using namespace lumivdb;

namespace {

constexpr double kPi = 3.14159265358979323846;

/// One band; mean irradiance E(p) at the samples, grey.
void setIrradiance(IrradianceVolume& volume, const std::function<double(const Vec3d&)>& E)
{
    // E_mean = A_0 Y00 L00 = π L00 / √(4π), so L00 = 2 E / √π.
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        volume.radiance(s)[0] = Color(float(2 * E(volume.sampleWorld(s)) / std::sqrt(kPi)));
        volume.validity(s) = 1;
    }
}

IrradianceVolume box(const Coord& size)
{
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(1));
    builder.addUniform({0, 0, 0}, size);
    return builder.build();
}

/// sRGB viridis at u ∈ [0,1], from OpenImageIO's linear table.
Color viridis(double u)
{
    const OIIO::ImageSpec spec(1, 1, 1, OIIO::TypeDesc::FLOAT);
    OIIO::ImageBuf source(spec);
    const float value = float(u);
    source.setpixel(0, 0, &value, 1);
    const OIIO::ImageBuf mapped = OIIO::ImageBufAlgo::color_map(source, 0, "viridis");
    Color c;
    mapped.getpixel(0, 0, &c.x, 3);
    for (int i = 0; i < 3; ++i)
        c[i] = c[i] <= 0.0031308f ? 12.92f * c[i] : 1.055f * std::pow(c[i], 1 / 2.4f) - 0.055f;
    return c;
}

void requireColour(const Color& pixel, const Color& expected)
{
    for (int c = 0; c < 3; ++c) CHECK(pixel[c] == Approx(expected[c]).margin(0.004));
}

const Color& at(const Image& image, int x, int y)
{
    return image.pixels[std::size_t(y) * image.width + x];
}

} // namespace

TEST_CASE("a ramp of irradiance becomes a ramp of colours over its logarithm", "[slice]")
{
    // E = 1 + 9 x/8 over x ∈ [0, 8]: trilinear interpolation reproduces it exactly.
    IrradianceVolume volume = box({8, 4, 2});
    setIrradiance(volume, [](const Vec3d& p) { return 1 + 9 * p.x / 8; });
    SliceOptions options;
    options.axis = 1;
    options.position = 1.3;
    options.width = 400;
    double low = 0, high = 0;
    const Image image = renderSlice(volume, options, &low, &high);
    REQUIRE(image.width == 400);
    REQUIRE(image.height == 100 + kLegendRows); // x by z is 8 by 2
    // 1% and 99% of values uniform in 1 … 10, to a pixel (9/400).
    CHECK(low == Approx(1.09).margin(0.03));
    CHECK(high == Approx(9.91).margin(0.03));
    for (int x : {10, 57, 123, 200, 311, 390}) {
        const double E = 1 + 9 * (x + 0.5) / 400;
        const double u = std::log10(E / low) / std::log10(high / low);
        requireColour(at(image, x, 50), viridis(u));
        requireColour(at(image, x, 3), viridis(u));
    }
    // Beyond the range the ends are held.
    requireColour(at(image, 0, 50), viridis(0));
    requireColour(at(image, 399, 50), viridis(1));
}

TEST_CASE("slices are seen from their positive axis", "[slice]")
{
    // E grows along one direction: where is the picture brightest?
    struct Case {
        int axis;
        Vec3d brightTowards;
        double s, t; // picture coordinates of the bright edge
    };
    const Case cases[] = {
        {0, {0, 0, -1}, 1, 0.5}, {0, {0, 1, 0}, 0.5, 0}, // x: −z right, y up
        {1, {1, 0, 0}, 1, 0.5}, {1, {0, 0, -1}, 0.5, 0}, // y: x right, −z up
        {2, {1, 0, 0}, 1, 0.5}, {2, {0, 1, 0}, 0.5, 0}, // z: x right, y up
    };
    for (const Case& c : cases) {
        IrradianceVolume volume = box({2, 4, 6});
        const Vec3d centre(1, 2, 3);
        setIrradiance(
            volume, [&](const Vec3d& p) { return 5 + (p - centre).dot(c.brightTowards); });
        SliceOptions options;
        options.axis = c.axis;
        options.position = 1.1;
        options.width = 120;
        double low, high;
        const Image image = renderSlice(volume, options, &low, &high);
        const int mapHeight = image.height - kLegendRows;
        const int sizes[3] = {2, 4, 6};
        const int across = sizes[c.axis == 0 ? 2 : 0], down = sizes[c.axis == 1 ? 2 : 1];
        CHECK(mapHeight == 120 * down / across);
        const auto pixel
            = [&](double s, double t) { return at(image, int(s * 119), int(t * (mapHeight - 1))); };
        requireColour(pixel(c.s, c.t), viridis(1));
        requireColour(pixel(1 - c.s, 1 - c.t), viridis(0));
    }
}

TEST_CASE("outside is black and without a valid sample grey", "[slice]")
{
    // Three cells in a row: [0,1] valid, [1,2] missing, [2,3] invalid.
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(1));
    builder.addCell({0, 0, 0}, 0);
    builder.addCell({2, 0, 0}, 0);
    IrradianceVolume volume = builder.build();
    setIrradiance(volume, [](const Vec3d&) { return 3; });
    for (SampleId s = 0; s < volume.sampleCount(); ++s)
        if (volume.samplePosition(s).x >= 2) volume.validity(s) = 0;
    SliceOptions options;
    options.axis = 2;
    options.position = 0.5;
    options.width = 300;
    double low, high;
    const Image image = renderSlice(volume, options, &low, &high);
    // A constant field: the range is opened around it.
    CHECK(low == Approx(3 / 1.25));
    CHECK(high == Approx(3 * 1.25));
    requireColour(at(image, 50, 50), viridis(0.5));
    CHECK(at(image, 150, 50) == Color(0));
    CHECK(at(image, 250, 50) == Color(kInvalidGrey));
}

TEST_CASE("the legend shows the colour map from left to right", "[slice]")
{
    IrradianceVolume volume = box({4, 4, 4});
    setIrradiance(volume, [](const Vec3d& p) { return std::pow(10.0, p.x - 2); });
    SliceOptions options;
    options.width = 480;
    options.position = 2;
    const Image image = renderSlice(volume, options, nullptr, nullptr);
    const int row = image.height - kLegendRows + 20; // in the middle of the bar
    for (int x : {0, 100, 200, 399}) // 40 pixels of margin on each side
        requireColour(at(image, 40 + x, row), viridis((x + 0.5) / 400));
    // Ticks below the bar: white marks at some of 0.01 … 100.
    int marks = 0;
    for (int x = 0; x < image.width; ++x) marks += at(image, x, row + 10) == Color(1);
    CHECK(marks >= 3);
    CHECK(marks <= 12);
}

TEST_CASE("a black volume has a slice too", "[slice]")
{
    IrradianceVolume volume = box({2, 2, 2});
    setIrradiance(volume, [](const Vec3d&) { return 0; });
    SliceOptions options;
    options.width = 32;
    options.position = 1;
    double low, high;
    const Image image = renderSlice(volume, options, &low, &high);
    requireColour(at(image, 16, 16), viridis(0));
    CHECK(low < high);
}

TEST_CASE("slices refuse what they cannot show", "[slice]")
{
    IrradianceVolume volume = box({2, 2, 2});
    const auto messageOf = [&](int axis, double position, int width) -> std::string {
        SliceOptions options;
        options.axis = axis;
        options.position = position;
        options.width = width;
        try {
            renderSlice(volume, options, nullptr, nullptr);
        } catch (const Error& e) {
            CHECK(e.code() == ErrorCode::Usage);
            return e.what();
        }
        return "";
    };
    CHECK(messageOf(3, 1, 100).find("axis") != std::string::npos);
    CHECK(messageOf(-1, 1, 100).find("axis") != std::string::npos);
    CHECK(messageOf(1, 1, 15).find("width") != std::string::npos);
    CHECK(messageOf(1, 2.5, 100).find("from 0 to 2") != std::string::npos);
    CHECK(messageOf(0, std::nan(""), 100).find("misses") != std::string::npos);
    CHECK(messageOf(0, 0, 100).empty()); // the outer faces are inside
    CHECK(messageOf(2, 2, 100).empty());
}
