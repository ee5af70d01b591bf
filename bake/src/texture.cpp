// SPDX-License-Identifier: Apache-2.0
#include "texture.h"

#include "scene_import.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>

namespace lumivdb {

namespace {

/// 16384²: 4 GiB once decoded to floats. Larger claims are more likely an attack than a texture.
constexpr std::int64_t kMaxPixels = std::int64_t(1) << 28;

/// Position on one axis: the two texels around u and the weight of the second.
struct Tap {
    int first;
    int second;
    float weight;
};

/// std::floor without a call into a library.
float floorOf(float x)
{
    if (!(std::abs(x) < 0x1p22f)) return std::floor(x);
    const auto whole = static_cast<float>(static_cast<int>(x));
    return whole > x ? whole - 1 : whole;
}

/// Brings u into [0, 1], which keeps texel numbers small whatever the file says.
float foldCoordinate(float u, WrapMode mode)
{
    if (!std::isfinite(u)) return 0.0f;
    if (mode == WrapMode::ClampToEdge) return std::clamp(u, 0.0f, 1.0f);
    if (mode == WrapMode::Repeat) return u - floorOf(u);
    const float period = u - 2.0f * floorOf(u * 0.5f);
    return period > 1.0f ? 2.0f - period : period;
}

/// Texel number of i ∈ {−1 … n}: beyond a border only Repeat continues on the other side (mirrored
/// and clamped images continue with the border texel itself).
int wrapTexel(int i, int n, WrapMode mode)
{
    if (i < 0) return mode == WrapMode::Repeat ? n - 1 : 0;
    if (i >= n) return mode == WrapMode::Repeat ? 0 : n - 1;
    return i;
}

Tap linearTap(float u, int n, WrapMode mode)
{
    const float x = foldCoordinate(u, mode) * static_cast<float>(n) - 0.5f;
    const float base = floorOf(x);
    const int i = static_cast<int>(base);
    return {wrapTexel(i, n, mode), wrapTexel(i + 1, n, mode), x - base};
}

int nearestTexel(float u, int n, WrapMode mode)
{
    const int i = static_cast<int>(floorOf(foldCoordinate(u, mode) * static_cast<float>(n)));
    return std::clamp(i, 0, n - 1);
}

bool isPng(const unsigned char* b, std::size_t n)
{
    return n >= 4 && std::memcmp(b, "\x89PNG", 4) == 0;
}

/// The format plugin is chosen by extension, so bytes without a name need one.
const char* nameForBytes(const unsigned char* b, std::size_t n)
{
    const auto starts = [&](const char* magic, std::size_t length) {
        return n >= length && std::memcmp(b, magic, length) == 0;
    };
    if (isPng(b, n)) return "memory.png";
    if (starts("\xff\xd8\xff", 3)) return "memory.jpg";
    if (starts("RIFF", 4)) return "memory.webp";
    if (starts("\x76\x2f\x31\x01", 4)) return "memory.exr";
    if (starts("#?", 2)) return "memory.hdr";
    if (starts("II*\0", 4) || starts("MM\0*", 4)) return "memory.tif";
    if (starts("DDS ", 4)) return "memory.dds";
    if (starts("BM", 2)) return "memory.bmp";
    return nullptr;
}

/// CRC-32 of the PNG specification, annex D.
std::uint32_t crc32(const unsigned char* bytes, std::size_t size)
{
    std::uint32_t crc = 0xffffffffu;
    for (std::size_t i = 0; i < size; ++i) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ (crc & 1 ? 0xedb88320u : 0u);
    }
    return ~crc;
}

/// Whether all chunks of a PNG are there and undamaged. libpng would find out too, but it writes to
/// stderr, and OpenImageIO's reader leaks memory where the data ends early.
bool isPngIntact(const unsigned char* b, std::size_t n)
{
    const auto word = [&](std::size_t at) {
        return std::uint32_t(b[at]) << 24 | std::uint32_t(b[at + 1]) << 16
            | std::uint32_t(b[at + 2]) << 8 | std::uint32_t(b[at + 3]);
    };
    for (std::size_t at = 8; n >= 12 && at <= n - 12;) {
        const std::size_t length = word(at);
        if (length > n - 12 - at) return false;
        if (word(at + 8 + length) != crc32(b + at + 4, length + 4)) return false;
        if (std::memcmp(b + at + 4, "IEND", 4) == 0) return true;
        at += 12 + length;
    }
    return false;
}

struct RawImage {
    int width = 0, height = 0, channels = 0;
    int alpha = -1; ///< channel number
    bool encoded = false; ///< integer pixels: sRGB
    bool eightBit = false;
    std::vector<float> values;
};

std::string readRaw(OIIO::ImageInput& input, RawImage& raw)
{
    const OIIO::ImageSpec& spec = input.spec();
    if (spec.width < 1 || spec.height < 1 || spec.nchannels < 1) return "it has no pixels";
    if (spec.depth > 1 || spec.nchannels > 64) return "it is not a flat colour image";
    if (std::int64_t(spec.width) * spec.height > kMaxPixels) return "it is larger than 16384²";
    raw.width = spec.width;
    raw.height = spec.height;
    raw.channels = std::min(spec.nchannels, 4);
    raw.encoded = !spec.format.is_floating_point();
    raw.eightBit = spec.format == OIIO::TypeDesc::UINT8;
    raw.alpha = spec.alpha_channel;
    // Greyscale with alpha is told apart from two colours by the name of the channel.
    if (raw.channels == 4 && raw.alpha < 0 && raw.encoded) raw.alpha = 3;
    if (raw.channels == 2) raw.alpha = 1;
    raw.values.resize(std::size_t(raw.width) * raw.height * raw.channels);
    if (!input.read_image(0, 0, 0, raw.channels, OIIO::TypeDesc::FLOAT, raw.values.data())) {
        const std::string why = input.geterror();
        return why.empty() ? "its pixels cannot be read" : why;
    }
    return {};
}

/// One pixel to linear RGBA; true where a value had to be replaced.
bool convertPixel(
    const RawImage& raw, const std::array<float, 256>& decodeTable, const float* in, float* out)
{
    const int colours
        = raw.alpha >= 0 && raw.alpha < raw.channels ? raw.channels - 1 : raw.channels;
    bool repaired = false;
    for (int c = 0; c < 3; ++c) {
        float v = in[colours >= 3 ? c : 0];
        if (!(v >= 0.0f) || std::isinf(v)) { // NaN too
            v = 0.0f;
            repaired = true;
        }
        if (raw.eightBit) {
            out[c] = decodeTable[static_cast<std::size_t>(v * 255.0f + 0.5f) & 255];
        } else {
            out[c] = raw.encoded ? decodeSrgb(v) : v;
        }
    }
    const float a = colours < raw.channels ? in[raw.alpha] : 1.0f;
    out[3] = a >= 0.0f ? std::min(a, 1.0f) : 0.0f;
    return repaired;
}

TextureDecode decode(std::unique_ptr<OIIO::ImageInput> input, Texture& texture)
{
    TextureDecode result;
    RawImage raw;
    result.reason = input ? readRaw(*input, raw) : OIIO::geterror();
    if (!input && result.reason.empty()) result.reason = "its format is not known";
    if (!result.reason.empty()) {
        // The reader's own words may span lines; a warning is one sentence.
        std::replace(result.reason.begin(), result.reason.end(), '\n', ' ');
        return result;
    }
    texture.width = raw.width;
    texture.height = raw.height;
    const std::size_t pixels = std::size_t(raw.width) * raw.height;
    texture.pixels.resize(pixels * 4);
    std::array<float, 256> table;
    for (std::size_t i = 0; i < 256; ++i) table[i] = decodeSrgb(static_cast<float>(i) / 255.0f);
    for (std::size_t i = 0; i < pixels; ++i) {
        if (convertPixel(raw, table, &raw.values[i * raw.channels], &texture.pixels[i * 4])) {
            result.repaired = true;
        }
    }
    result.ok = true;
    return result;
}

/// Straight alpha: a reader that premultiplied would darken the colours under a mask.
OIIO::ImageSpec readerConfig()
{
    OIIO::ImageSpec config;
    config["oiio:UnassociatedAlpha"] = 1;
    return config;
}

} // namespace

float decodeSrgb(float encoded)
{
    if (encoded <= 0.04045f) return encoded / 12.92f;
    return static_cast<float>(std::pow((static_cast<double>(encoded) + 0.055) / 1.055, 2.4));
}

TextureDecode decodeTexture(const unsigned char* bytes, std::size_t size, Texture& texture)
{
    TextureDecode failed;
    const char* name = nameForBytes(bytes, size);
    if (!name) {
        failed.reason = "its format is not known";
        return failed;
    }
    if (isPng(bytes, size) && !isPngIntact(bytes, size)) {
        failed.reason = "the PNG is damaged";
        return failed;
    }
    OIIO::Filesystem::IOMemReader memory(bytes, size);
    OIIO::ImageSpec config = readerConfig();
    // As an attribute, because open() with a proxy argument still looks for a file of that name.
    OIIO::Filesystem::IOProxy* proxy = &memory;
    config.attribute("oiio:ioproxy", OIIO::TypeDesc::PTR, &proxy);
    try {
        return decode(OIIO::ImageInput::open(name, &config), texture);
    } catch (const std::exception& e) {
        failed.reason = e.what();
        return failed;
    }
}

TextureDecode decodeTextureFile(const std::string& path, Texture& texture)
{
    const OIIO::ImageSpec config = readerConfig();
    try {
        const std::vector<unsigned char> bytes = readFileBytes(path);
        if (isPng(bytes.data(), bytes.size())) {
            return decodeTexture(bytes.data(), bytes.size(), texture);
        }
        return decode(OIIO::ImageInput::open(path, &config), texture);
    } catch (const std::exception& e) {
        TextureDecode failed;
        failed.reason = e.what();
        return failed;
    }
}

namespace {

/// What the codes of a channel of eight bits stand for, increasing from 0 to 1.
class CodeTable {
public:
    template <class Value> explicit CodeTable(const Value& value)
    {
        for (std::size_t i = 0; i < 256; ++i) mValues[i] = value(static_cast<float>(i));
        for (std::size_t i = 0, code = 0; i < kSteps; ++i) {
            while (code < 255 && mValues[code + 1] * kSteps <= static_cast<float>(i)) ++code;
            mFirst[i] = static_cast<std::uint8_t>(code);
        }
    }
    float operator[](std::uint32_t code) const { return mValues[code & 255]; }
    /// The code of exactly @a value, or −1.
    int find(float value) const
    {
        if (!(value >= 0 && value <= 1)) return -1;
        int code = mFirst[std::min(static_cast<std::size_t>(value * kSteps), kSteps - 1)];
        while (mValues[static_cast<std::size_t>(code)] < value) ++code;
        return mValues[static_cast<std::size_t>(code)] == value ? code : -1;
    }

private:
    static constexpr std::size_t kSteps = 4096;
    std::array<float, 256> mValues;
    std::array<std::uint8_t, kSteps> mFirst; ///< code to search from, by the value
};

const CodeTable kColourCodes([](float i) { return decodeSrgb(i / 255.0f); });
const CodeTable kAlphaCodes([](float i) { return i * (1.0f / 255.0f); }); // as OpenImageIO does

/// Four codes, or false where one of the values has none.
bool encode(const float* rgba, std::uint32_t& codes)
{
    codes = 0;
    for (int c = 0; c < 4; ++c) {
        const int code = (c < 3 ? kColourCodes : kAlphaCodes).find(rgba[c]);
        if (code < 0) return false;
        codes |= static_cast<std::uint32_t>(code) << (8 * c);
    }
    return true;
}

std::array<float, 4> decode(std::uint32_t codes)
{
    return {kColourCodes[codes], kColourCodes[codes >> 8], kColourCodes[codes >> 16],
        kAlphaCodes[codes >> 24]};
}

/// Of four texels, row by row.
std::array<float, 4> interpolate(const std::array<float, 4> (&t)[4], float right, float down)
{
    std::array<float, 4> result;
    for (std::size_t c = 0; c < 4; ++c) {
        const float top = t[0][c] + (t[1][c] - t[0][c]) * right;
        const float bottom = t[2][c] + (t[3][c] - t[2][c]) * right;
        result[c] = top + (bottom - top) * down;
    }
    return result;
}

/// Texel numbers are those of @a place(x, y).
template <class Place>
Texels::Footprint footprint(const Texture& t, float u, float v, const Place& place)
{
    Tap x, y;
    if (t.nearest) {
        x.first = x.second = nearestTexel(u, t.width, t.wrapU);
        y.first = y.second = nearestTexel(v, t.height, t.wrapV);
        x.weight = y.weight = 0;
    } else {
        x = linearTap(u, t.width, t.wrapU);
        y = linearTap(v, t.height, t.wrapV);
    }
    const auto at = [&](int i, int j) { return static_cast<std::uint32_t>(place(i, j)); };
    return {{at(x.first, y.first), at(x.second, y.first), at(x.first, y.second),
                at(x.second, y.second)},
        x.weight, y.weight};
}

std::array<float, 4> pixel(const Texture& t, std::uint32_t number)
{
    const float* p = &t.pixels[std::size_t{number} * 4];
    return {p[0], p[1], p[2], p[3]};
}

} // namespace

std::array<float, 4> Texture::sample(float u, float v) const
{
    if (width < 1 || height < 1) return {1, 1, 1, 1};
    const Texels::Footprint at = footprint(*this, u, v, [&](int x, int y) {
        return static_cast<std::size_t>(y) * static_cast<std::size_t>(width)
            + static_cast<std::size_t>(x);
    });
    const auto texel = [&](int i) { return pixel(*this, at.texel[i]); };
    return interpolate({texel(0), texel(1), texel(2), texel(3)}, at.right, at.down);
}

Texels::Texels(const Texture& texture)
    : mTexture(&texture)
    , mTilesAcross((static_cast<std::size_t>(texture.width) + 3) / 4)
{
    const int w = texture.width, h = texture.height;
    if (w < 1 || h < 1) return;
    const auto tilesDown = (static_cast<std::size_t>(h) + 3) / 4;
    mCodes.resize(mTilesAcross * tilesDown * 16);
    std::atomic<bool> exact{true};
    tbb::parallel_for(0, h, [&](int y) {
        const float* row = &texture.pixels[static_cast<std::size_t>(y) * w * 4];
        for (int x = 0; x < w && exact; ++x) {
            if (!encode(row + 4 * x, mCodes[place(x, y)])) exact = false;
        }
    });
    if (!exact) mCodes = {};
}

Texels::Footprint Texels::find(float u, float v) const
{
    if (mTexture->width < 1 || mTexture->height < 1) return {};
    return footprint(*mTexture, u, v, [&](int x, int y) { return place(x, y); });
}

std::array<float, 4> Texels::sample(const Footprint& at) const
{
    if (mTexture->width < 1 || mTexture->height < 1) return {1, 1, 1, 1};
    std::array<float, 4> t[4];
    for (int i = 0; i < 4; ++i) {
        t[i] = mCodes.empty() ? pixel(*mTexture, at.texel[i]) : decode(mCodes[at.texel[i]]);
    }
    return interpolate(t, at.right, at.down);
}

} // namespace lumivdb
