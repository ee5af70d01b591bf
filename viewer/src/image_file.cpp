// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/viewer/picture.h>

#include <lumivdb/core/error.h>

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>

namespace lumivdb {

namespace {

constexpr double kExposed = 0.8; ///< where automatic exposure takes the 95th percentile
constexpr double kShoulder = 0.5; ///< where exposed values start to be compressed

enum class Format { Png, Exr };

Format formatOf(const std::string& path)
{
    std::string extension = std::filesystem::path(path).extension().string();
    for (char& c : extension)
        if (c >= 'A' && c <= 'Z') c = char(c - 'A' + 'a');
    if (extension == ".png") return Format::Png;
    if (extension == ".exr") return Format::Exr;
    throw Error(ErrorCode::Usage,
        "The picture '" + path + "' must have a name that ends in .png or .exr"
            + (extension.empty() ? std::string(".") : ", not in " + extension + "."));
}

[[noreturn]] void failOutput(const std::string& path, const std::string& reason)
{
    throw Error(ErrorCode::Output, "The picture '" + path + "' cannot be written: " + reason + ".");
}

/// IEC 61966-2-1.
double encodeSrgb(double x)
{
    return x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
}

double compressHighlights(double x)
{
    const double range = 1 - kShoulder;
    return x <= kShoulder ? x : 1 - range * std::exp(-(x - kShoulder) / range);
}

std::uint8_t toByte(double x)
{
    if (!(x > 0)) return 0; // NaN too
    return std::uint8_t(std::lround(255 * std::min(x, 1.0)));
}

void requireComplete(const Image& image)
{
    if (image.width < 1 || image.height < 1
        || image.pixels.size() != std::size_t(image.width) * image.height)
        throw Error(ErrorCode::Usage, "The picture has no pixels, or not width × height of them.");
}

/// The whole file in memory: what a full disk does to it is then seen by us, not lost in a codec.
std::vector<unsigned char> encode(
    const Image& image, Format format, const void* pixels, const std::string& path)
{
    const bool png = format == Format::Png;
    const OIIO::TypeDesc type = png ? OIIO::TypeDesc::UINT8 : OIIO::TypeDesc::FLOAT;
    OIIO::ImageSpec spec(image.width, image.height, 3, type);
    spec.attribute("oiio:ColorSpace", png ? "sRGB" : "Linear");
    // The EXR writer would put in today's date, and the same picture be another file tomorrow.
    if (!png) spec.attribute("DateTime", "1970:01:01 00:00:00");
    const char* name = png ? "picture.png" : "picture.exr";
    OIIO::Filesystem::IOVecOutput memory;
    const auto output = OIIO::ImageOutput::create(name);
    if (!output) failOutput(path, "OpenImageIO has no writer for it: " + OIIO::geterror());
    output->set_ioproxy(&memory);
    if (!output->open(name, spec) || !output->write_image(type, pixels) || !output->close())
        failOutput(path, output->geterror());
    return memory.buffer();
}

bool writeAll(int file, const std::vector<unsigned char>& bytes)
{
    std::size_t done = 0;
    while (done < bytes.size()) {
        const ssize_t n = ::write(file, bytes.data() + done, bytes.size() - done);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) return false;
        done += std::size_t(n);
    }
    return ::fsync(file) == 0 || errno == EINVAL || errno == EROFS;
}

void writeFile(const std::string& path, const std::vector<unsigned char>& bytes)
{
    const std::string temporary = path + ".tmp" + std::to_string(::getpid());
    const int file = ::open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (file < 0) failOutput(path, std::strerror(errno));
    int error = writeAll(file, bytes) ? 0 : errno;
    if (::close(file) != 0 && !error) error = errno;
    if (!error && std::rename(temporary.c_str(), path.c_str()) != 0) error = errno;
    if (!error) return;
    ::unlink(temporary.c_str());
    failOutput(path, std::strerror(error));
}

/// Writes 8-bit pixels as they are.
void writePng(const Image& image, const std::vector<std::uint8_t>& bytes, const std::string& path)
{
    writeFile(path, encode(image, Format::Png, bytes.data(), path));
}

void writeExr(const Image& image, const std::string& path)
{
    static_assert(sizeof(Color) == 3 * sizeof(float), "pixels are handed over as floats");
    writeFile(path, encode(image, Format::Exr, image.pixels.data(), path));
}

/// The file's bytes from a function of a channel's value.
template <class Curve> std::vector<std::uint8_t> quantise(const Image& image, const Curve& curve)
{
    std::vector<std::uint8_t> bytes;
    bytes.reserve(3 * image.pixels.size());
    for (const Color& pixel : image.pixels)
        for (int c = 0; c < 3; ++c) bytes.push_back(toByte(curve(double(pixel[c]))));
    return bytes;
}

} // namespace

void checkImagePath(const std::string& path) { formatOf(path); }

double automaticExposure(const Image& image)
{
    std::vector<float> values;
    values.reserve(image.pixels.size());
    for (const Color& pixel : image.pixels) {
        const float y = luminance(pixel);
        if (y > 0 && std::isfinite(y)) values.push_back(y);
    }
    if (values.empty()) return 1;
    const auto p95 = values.begin() + std::ptrdiff_t(0.95 * double(values.size() - 1));
    std::nth_element(values.begin(), p95, values.end());
    return kExposed / double(*p95);
}

void writeImage(const Image& image, const std::string& path, double exposureStops)
{
    const Format format = formatOf(path);
    requireComplete(image);
    if (format == Format::Exr) return writeExr(image, path);
    const double scale
        = std::isnan(exposureStops) ? automaticExposure(image) : std::exp2(exposureStops);
    const auto curve = [scale](double x) { return encodeSrgb(compressHighlights(scale * x)); };
    writePng(image, quantise(image, curve), path);
}

void writeDisplayImage(const Image& image, const std::string& path)
{
    const Format format = formatOf(path);
    requireComplete(image);
    if (format == Format::Exr) return writeExr(image, path);
    writePng(image, quantise(image, [](double x) { return x; }), path);
}

} // namespace lumivdb
