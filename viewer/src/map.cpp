// SPDX-License-Identifier: Apache-2.0
#include "map.h"

#include <lumivdb/core/error.h>

#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace lumivdb {

namespace {

constexpr const char* kColourMap = "viridis"; // even in lightness, and never black or grey
constexpr int kMaxSide = 16384;

float encodeSrgb(float x)
{
    return x <= 0.0031308f ? 12.92f * x : 1.055f * std::pow(x, 1 / 2.4f) - 0.055f;
}

/// Display colours of values in [0,1], one row of pixels.
std::vector<Color> falseColours(const std::vector<float>& unit)
{
    const OIIO::ImageSpec spec(int(unit.size()), 1, 1, OIIO::TypeDesc::FLOAT);
    OIIO::ImageBuf source(spec, const_cast<float*>(unit.data()));
    const OIIO::ImageBuf mapped = OIIO::ImageBufAlgo::color_map(source, 0, kColourMap);
    std::vector<Color> out(unit.size());
    for (std::size_t i = 0; i < out.size(); ++i) {
        float rgb[3];
        mapped.getpixel(int(i), 0, rgb, 3);
        out[i] = Color(encodeSrgb(rgb[0]), encodeSrgb(rgb[1]), encodeSrgb(rgb[2]));
    }
    return out;
}

/// Round values in the range: 1, 2 and 5 of every decade, thinned to at most @a most; where there
/// are fewer than two, the ends.
std::vector<double> ticks(const Range& r, std::size_t most)
{
    const int first = int(std::floor(std::log10(r.low))), last = int(std::ceil(std::log10(r.high)));
    for (const auto& steps : {std::vector<int>{1, 2, 5}, std::vector<int>{1}}) {
        std::vector<double> found;
        for (int e = first; e <= last; ++e)
            for (int s : steps) {
                const double v = s * std::pow(10.0, e);
                if (v >= r.low && v <= r.high) found.push_back(v);
            }
        if (found.size() < 2 || (found.size() > most && steps.size() > 1)) continue;
        const std::size_t stride = (found.size() + most - 1) / most;
        std::vector<double> thinned;
        for (std::size_t i = 0; i < found.size(); i += stride) thinned.push_back(found[i]);
        return thinned;
    }
    return {r.low, r.high};
}

double position(double value, const Range& r)
{
    if (!(value > 0)) return 0;
    return std::clamp(std::log10(value / r.low) / std::log10(r.high / r.low), 0.0, 1.0);
}

} // namespace

void SliceOptions::validate() const
{
    if (axis < 0 || axis > 2)
        throw Error(ErrorCode::Usage,
            "The slice's axis is " + std::to_string(axis) + "; it must be 0 (x), 1 (y) or 2 (z).");
    if (width < 16 || width > kMaxSide)
        throw Error(ErrorCode::Usage,
            "The slice's width is " + std::to_string(width) + "; it must be 16 to 16384 pixels.");
}

Frame frameOf(const Box3d& box, const SliceOptions& options)
{
    const int a = options.axis;
    if (!(options.position >= box.min[a] && options.position <= box.max[a])) {
        char text[160];
        std::snprintf(text, sizeof text,
            "The slice at %c = %g misses the volume, which reaches from %g to %g there.", "xyz"[a],
            options.position, box.min[a], box.max[a]);
        throw Error(ErrorCode::Usage, text);
    }
    const Vec3d size = box.size();
    Frame f;
    f.upperLeft = Vec3d(box.min.x, box.max.y, box.max.z);
    if (a == 0)
        f.right = Vec3d(0, 0, -size.z);
    else
        f.right = Vec3d(size.x, 0, 0);
    if (a == 1) {
        f.upperLeft.z = box.min.z;
        f.down = Vec3d(0, 0, size.z);
    } else {
        f.down = Vec3d(0, -size.y, 0);
    }
    f.upperLeft[a] = options.position;
    const double ratio = f.down.length() / f.right.length();
    // A very tall box makes the picture narrower instead of ever taller.
    f.width = std::clamp(int(kMaxSide / ratio), 1, options.width);
    f.height = std::clamp(int(std::lround(f.width * ratio)), 1, kMaxSide);
    return f;
}

Image emptyMap(const Frame& frame)
{
    Image image;
    image.width = std::max(frame.width, 16); // room for the legend
    image.height = frame.height + kLegendRows;
    image.pixels.assign(std::size_t(image.width) * image.height, Color(0));
    return image;
}

Range chooseRange(const std::vector<float>& field)
{
    std::vector<float> values;
    for (float v : field)
        if (v > 0 && std::isfinite(v)) values.push_back(v);
    if (values.empty()) return {0.1, 1};
    std::sort(values.begin(), values.end());
    const double last = double(values.size() - 1);
    Range r;
    r.low = values[std::size_t(std::lround(0.01 * last))];
    r.high = values[std::size_t(std::lround(0.99 * last))];
    if (r.high < 1.05 * r.low) {
        r.low /= 1.25;
        r.high *= 1.25;
    }
    return r;
}

std::vector<Color> colourTable()
{
    constexpr int kEntries = 1024;
    std::vector<float> unit(kEntries);
    for (int i = 0; i < kEntries; ++i) unit[i] = float(i) / (kEntries - 1);
    return falseColours(unit);
}

Color lookUp(const std::vector<Color>& table, double unit)
{
    return table[std::size_t(std::lround(unit * double(table.size() - 1)))];
}

void paintField(Image& image, const Frame& frame, const std::vector<float>& field, const Range& r,
    const std::vector<Color>& table)
{
    for (int y = 0; y < frame.height; ++y) {
        for (int x = 0; x < frame.width; ++x) {
            const float v = field[std::size_t(y) * frame.width + x];
            Color& pixel = image.pixels[std::size_t(y) * image.width + x];
            if (v == kInvalid)
                pixel = Color(kInvalidGrey);
            else if (v != kOutside)
                pixel = lookUp(table, position(v, r));
        }
    }
}

bool drawText(Image& image, int x, int y, const std::string& text)
{
    const OIIO::ImageSpec spec(image.width, image.height, 3, OIIO::TypeDesc::FLOAT);
    OIIO::ImageBuf buffer(spec, image.pixels.data());
    for (const char* font : {"DejaVuSans", "LiberationSans-Regular", "DroidSans", "FreeSans"}) {
        const float white[3] = {1, 1, 1};
        if (OIIO::ImageBufAlgo::render_text(
                buffer, x, y, text, 14, font, white, OIIO::ImageBufAlgo::TextAlignX::Center))
            return true;
        buffer.geterror(); // takes the message away: no text is not an error
    }
    return false;
}

void drawLegend(Image& image, int mapHeight, const Range& r, const std::vector<Color>& table,
    double unit, const char* suffix)
{
    const int margin = std::min(40, image.width / 8), barTop = mapHeight + 12, barRows = 16;
    const int bar = image.width - 2 * margin;
    const auto at
        = [&](int x, int y) -> Color& { return image.pixels[std::size_t(y) * image.width + x]; };
    for (int x = 0; x < bar; ++x)
        for (int y = 0; y < barRows; ++y)
            at(margin + x, barTop + y) = lookUp(table, (x + 0.5) / bar);
    for (double v : ticks(r, std::size_t(std::max(2, bar / 60)))) {
        const int x = margin + std::clamp(int(position(v, r) * bar), 0, bar - 1);
        for (int y = 0; y < 5; ++y) at(x, barTop + barRows + y) = Color(1);
        char text[32];
        std::snprintf(text, sizeof text, "%.3g%s", unit * v, suffix);
        drawText(image, x, mapHeight + kLegendRows - 6, text);
    }
}

void drawGeometry(Image& image, const Frame& frame, const Tracer& tracer, double pixels)
{
    const double reach = pixels * frame.right.length() / frame.width;
    tbb::parallel_for(0, frame.height, [&](int y) {
        for (int x = 0; x < frame.width; ++x) {
            double distance;
            Vec3d normal;
            if (tracer.closestSurface(frame.at(x, y), reach, &distance, &normal))
                image.pixels[std::size_t(y) * image.width + x] = Color(1);
        }
    });
}

} // namespace lumivdb
