// SPDX-License-Identifier: Apache-2.0
//
// Environment::load: files by OpenImageIO.
#include <lumivdb/bake/environment.h>

#include "environment_projection.h"

#include <lumivdb/core/error.h>

#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <cmath>
#include <new>

namespace lumivdb {

namespace {

/// Larger images (6 GB of floats) are taken for a broken header.
constexpr long long kMaxPixels = 1LL << 29;

[[noreturn]] void fail(const std::string& path, const std::string& rest)
{
    throw Error(ErrorCode::Input, "Environment '" + path + "' " + rest);
}

/// The reader's own words, on one line.
std::string reason(std::string message)
{
    std::replace(message.begin(), message.end(), '\n', ' ');
    while (!message.empty() && (message.back() == ' ' || message.back() == '.')) message.pop_back();
    return message.empty() ? "" : " (" + message + ")";
}

float fromSrgb(float v)
{
    return v <= 0.04045f ? v / 12.92f : std::pow((v + 0.055f) / 1.055f, 2.4f);
}

bool isBad(const Color& c)
{
    for (int i = 0; i < 3; ++i)
        if (!std::isfinite(c[i]) || c[i] < 0) return true;
    return false;
}

std::unique_ptr<OIIO::ImageInput> open(const std::string& path)
{
    OIIO::ImageSpec config;
    config["oiio:UnassociatedAlpha"] = 1; // alpha is ignored, so it must not darken colours either
    auto input = OIIO::ImageInput::open(path, &config);
    const std::string message = OIIO::geterror(); // also keeps OpenImageIO from printing it
    if (!input)
        fail(path,
            "cannot be read" + reason(message)
                + "; give an existing HDR, EXR or other "
                  "image file.");
    return input;
}

void checkSpec(const std::string& path, const OIIO::ImageSpec& spec)
{
    if (spec.deep || spec.depth > 1) fail(path, "is a deep or volumetric image; use a flat one.");
    const long long w = spec.full_width, h = spec.full_height;
    if (w <= 0 || h <= 0 || spec.width <= 0 || spec.height <= 0 || spec.nchannels <= 0)
        fail(path, "has no pixels; use a picture that covers the sphere.");
    if (w * h > kMaxPixels || 1LL * spec.width * spec.height > kMaxPixels)
        fail(path,
            "claims to be " + std::to_string(w) + " x " + std::to_string(h)
                + " pixels; use one of at most 2^29 pixels.");
}

/// The data window copied to where it lies in the full picture; the rest is black.
std::vector<Color> toColors(
    const OIIO::ImageSpec& spec, const std::vector<float>& data, int channels)
{
    const bool srgb = spec.format == OIIO::TypeDesc::UINT8
        || (!spec.format.is_floating_point()
            && spec.get_string_attribute("oiio:ColorSpace") == "sRGB");
    std::vector<Color> pixels(
        static_cast<std::size_t>(spec.full_width) * spec.full_height, Color(0));
    for (int y = 0; y < spec.height; ++y) {
        const long long row = 1LL * y + spec.y - spec.full_y;
        if (row < 0 || row >= spec.full_height) continue;
        for (int x = 0; x < spec.width; ++x) {
            const long long column = 1LL * x + spec.x - spec.full_x;
            if (column < 0 || column >= spec.full_width) continue;
            const float* value = &data[(static_cast<std::size_t>(y) * spec.width + x) * channels];
            Color c = channels == 3 ? Color(value[0], value[1], value[2]) : Color(value[0]);
            if (srgb)
                for (int i = 0; i < 3; ++i) c[i] = fromSrgb(c[i]);
            pixels[static_cast<std::size_t>(row) * spec.full_width + column] = c;
        }
    }
    return pixels;
}

std::vector<Color> read(
    const std::string& path, OIIO::ImageInput& input, const OIIO::ImageSpec& spec)
{
    // One channel (or grey with alpha) is grey, three or more begin with red, green, blue.
    const int channels = spec.nchannels >= 3 ? 3 : 1;
    std::vector<float> data(static_cast<std::size_t>(spec.width) * spec.height * channels);
    const bool complete = input.read_image(0, 0, 0, channels, OIIO::TypeDesc::FLOAT, data.data());
    const std::string message = input.geterror();
    if (!complete)
        fail(path, "is damaged or cut short" + reason(message) + "; fetch or export it again.");
    return toColors(spec, data, channels);
}

void warnOfBadPixels(
    const std::string& path, const std::vector<Color>& pixels, std::vector<std::string>& warnings)
{
    const auto bad = std::count_if(pixels.begin(), pixels.end(), isBad);
    if (bad > 0)
        warnings.push_back("Environment '" + path + "' has " + std::to_string(bad)
            + (bad == 1 ? " pixel" : " pixels")
            + " with NaN, infinite or negative channels; these channels count as 0.");
}

} // namespace

std::shared_ptr<const Environment> Environment::load(
    const std::string& path, const EnvironmentOptions& options, std::vector<std::string>& warnings)
{
    try {
        const auto input = open(path);
        const OIIO::ImageSpec spec = input->spec();
        checkSpec(path, spec);
        EnvironmentOptions resolved = options;
        resolved.projection = detail::resolveProjection(
            options.projection, spec.full_width, spec.full_height, "Environment '" + path + "'");
        std::vector<Color> pixels = read(path, *input, spec);
        warnOfBadPixels(path, pixels, warnings);
        return fromPixels(spec.full_width, spec.full_height, std::move(pixels), resolved);
    } catch (const std::bad_alloc&) {
        fail(path, "does not fit into memory; use a smaller one.");
    }
}

} // namespace lumivdb
