// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/viewer/picture.h>

#include <lumivdb/core/error.h>

#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace lumivdb {

namespace {

constexpr const char* kColourMap = "viridis"; // even in lightness, and never black or grey
constexpr int kMaxSide = 16384;
constexpr float kOutside = -2; ///< marks in a field of irradiance
constexpr float kInvalid = -1;

/// The plane in the world: a corner of the picture and its two edges.
struct Frame {
    Vec3d upperLeft, right, down; ///< right and down span the whole map
    int width, height; ///< pixels of the map
};

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

/// Mean irradiance (luminance) at pixel centres, or a mark.
std::vector<float> sampleField(const VolumeSampler& sampler, const Frame& f)
{
    constexpr float kMeanFactor = 0.886226925452758014f; // π Y00 = √π / 2
    std::vector<float> field(std::size_t(f.width) * f.height);
    tbb::parallel_for(0, f.height, [&](int y) {
        Color L[kMaxCoefficients];
        for (int x = 0; x < f.width; ++x) {
            const Vec3d p
                = f.upperLeft + f.right * ((x + 0.5) / f.width) + f.down * ((y + 0.5) / f.height);
            const QueryInfo info = sampler.radiance(p, L);
            float& out = field[std::size_t(y) * f.width + x];
            if (info.level < 0)
                out = kOutside;
            else if (info.validity < kValidThreshold)
                out = kInvalid;
            else
                out = std::max(0.0f, kMeanFactor * luminance(L[0]));
        }
    });
    return field;
}

struct Range {
    double low = 1, high = 1;
};

/// 1% and 99% of the positive values, kept apart where the field is constant.
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

/// 1024 display colours from low to high: a look-up costs less than OpenImageIO's per pixel.
std::vector<Color> colourTable()
{
    constexpr int kEntries = 1024;
    std::vector<float> unit(kEntries);
    for (int i = 0; i < kEntries; ++i) unit[i] = float(i) / (kEntries - 1);
    return falseColours(unit);
}

double position(double value, const Range& r)
{
    if (!(value > 0)) return 0;
    return std::clamp(std::log10(value / r.low) / std::log10(r.high / r.low), 0.0, 1.0);
}

Color lookUp(const std::vector<Color>& table, double unit)
{
    return table[std::size_t(std::lround(unit * double(table.size() - 1)))];
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

/// False where the system has no font that OpenImageIO finds.
bool drawText(OIIO::ImageBuf& image, int x, int y, const std::string& text)
{
    for (const char* font : {"DejaVuSans", "LiberationSans-Regular", "DroidSans", "FreeSans"}) {
        const float white[3] = {1, 1, 1};
        if (OIIO::ImageBufAlgo::render_text(
                image, x, y, text, 14, font, white, OIIO::ImageBufAlgo::TextAlignX::Center))
            return true;
        image.geterror(); // takes the message away: no text is not an error
    }
    return false;
}

/// The bar with its ticks in the last kLegendRows rows.
void drawLegend(Image& image, int mapHeight, const Range& r, const std::vector<Color>& table)
{
    const int margin = std::min(40, image.width / 8), barTop = mapHeight + 12, barRows = 16;
    const int bar = image.width - 2 * margin;
    const auto at
        = [&](int x, int y) -> Color& { return image.pixels[std::size_t(y) * image.width + x]; };
    for (int x = 0; x < bar; ++x)
        for (int y = 0; y < barRows; ++y)
            at(margin + x, barTop + y) = lookUp(table, (x + 0.5) / bar);
    const OIIO::ImageSpec spec(image.width, image.height, 3, OIIO::TypeDesc::FLOAT);
    OIIO::ImageBuf buffer(spec, image.pixels.data());
    for (double v : ticks(r, std::size_t(std::max(2, bar / 60)))) {
        const int x = margin + std::clamp(int(position(v, r) * bar), 0, bar - 1);
        for (int y = 0; y < 5; ++y) at(x, barTop + barRows + y) = Color(1);
        char text[32];
        std::snprintf(text, sizeof text, "%.3g", v);
        drawText(buffer, x, mapHeight + kLegendRows - 6, text);
    }
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

Image renderSlice(
    const IrradianceVolume& volume, const SliceOptions& options, double* low, double* high)
{
    options.validate();
    const VolumeSampler sampler(volume, options.mode);
    const Frame frame = frameOf(volume.worldBounds(), options);
    const std::vector<float> field = sampleField(sampler, frame);
    const Range range = chooseRange(field);
    const std::vector<Color> table = colourTable();

    Image image;
    image.width = std::max(frame.width, 16); // room for the legend
    image.height = frame.height + kLegendRows;
    image.pixels.assign(std::size_t(image.width) * image.height, Color(0));
    for (int y = 0; y < frame.height; ++y) {
        for (int x = 0; x < frame.width; ++x) {
            const float v = field[std::size_t(y) * frame.width + x];
            Color& pixel = image.pixels[std::size_t(y) * image.width + x];
            if (v == kInvalid)
                pixel = Color(kInvalidGrey);
            else if (v != kOutside)
                pixel = lookUp(table, position(v, range));
        }
    }
    drawLegend(image, frame.height, range, table);
    if (low) *low = range.low;
    if (high) *high = range.high;
    return image;
}

} // namespace lumivdb
