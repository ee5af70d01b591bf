// SPDX-License-Identifier: Apache-2.0
//
// Light and chance on top of environment_projection.h: radiance per texel, the distribution over
// texels (marginal over rows, conditional over columns), the rotation, the SH projection.
#include <lumivdb/bake/environment.h>

#include "environment_sun.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/core/sh.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstring>

namespace lumivdb {

using detail::ImageProjection;
using detail::invertRunningSum;
using detail::luminanceOf;
using detail::SphereNode;
using detail::SunTexels;
using detail::Texel;

namespace {

constexpr double kPi = 3.14159265358979323846;

/// Points are drawn this far (in texels) from a texel's border, so that rounding in the way to a
/// direction and back finds the same texel again.
constexpr double kInset = 1e-8;

/// A cell of Walker's alias method (ACM TOMS 3(3), 1977): @a keep of it is the cell's own texel.
struct AliasCell {
    float keep = 1;
    std::uint32_t other = 0;
};

/// Vose's way to make the table (IEEE TSE 17(9), 1991), without his two lists: what gives until it
/// is too little itself takes at once where the scan has passed it. @a mass sums to its size.
std::vector<AliasCell> aliasCells(std::vector<double> mass)
{
    const std::size_t n = mass.size();
    std::vector<AliasCell> cells(n);
    std::size_t little = 0, much = 0;
    const auto skip = [&] {
        while (little < n && mass[little] >= 1) ++little;
        while (much < n && mass[much] < 1) ++much;
    };
    skip();
    for (std::size_t cell = little; cell < n && much < n;) {
        cells[cell] = {static_cast<float>(mass[cell]), static_cast<std::uint32_t>(much)};
        mass[much] -= 1 - mass[cell];
        const std::size_t giver = much;
        const bool takes = mass[giver] < 1 && giver < little;
        if (!takes) ++little;
        skip();
        cell = takes ? giver : little;
    }
    return cells;
}

/// The pixels and their distribution; shared by all rotations of one map.
struct Light {
    std::unique_ptr<const ImageProjection> projection;
    std::vector<Color> pixels;
    SunTexels sun;
    // Of the sky, which is all texels but the sun's:
    std::vector<double> columnSums; ///< per row: running sums of luminance × solid angle
    std::vector<double> rowSums; ///< running sums of the rows' totals
    std::vector<AliasCell> alias; ///< over all texels, for numbers without strata
    double total = 0.0; ///< ∫ luminance dω, the sun's included
    double perTotal = 0.0; ///< its inverse
    double sunShare = 0.0; ///< of the total
    std::uint64_t hash = 0;

    const Color& at(Texel texel) const
    {
        return pixels[static_cast<std::size_t>(texel.y) * projection->width + texel.x];
    }
    std::size_t cellOf(double t) const
    {
        const auto n = alias.size();
        const auto cell = static_cast<std::int64_t>(t * static_cast<double>(n));
        return std::min(static_cast<std::size_t>(cell), n - 1);
    }
    /// Number of the texel of the sky that t ∈ [0,1) draws.
    std::uint32_t draw(double t) const
    {
        const std::size_t cell = cellOf(t);
        const double rest = t * static_cast<double>(alias.size()) - static_cast<double>(cell);
        return rest < alias[cell].keep ? static_cast<std::uint32_t>(cell) : alias[cell].other;
    }
    double weight(Texel texel) const
    {
        return luminanceOf(at(texel)) * projection->solidAngle(texel);
    }
    bool inSun(Texel texel) const { return sun.contains(texel, luminanceOf(at(texel))); }
    double skyWeight(Texel texel) const { return inSun(texel) ? 0.0 : weight(texel); }
    double pdf(Texel texel, const Vec3d& d) const
    {
        const double w = weight(texel);
        return w > 0 ? w * perTotal * projection->pointDensity(texel, d) : 0.0;
    }
};

void buildAlias(Light& light)
{
    const int w = light.projection->width, h = light.projection->height;
    std::vector<double> mass(light.pixels.size());
    const double scale = static_cast<double>(mass.size()) / light.rowSums[h - 1];
    tbb::parallel_for(0, h, [&](int y) {
        for (int x = 0; x < w; ++x) {
            mass[static_cast<std::size_t>(y) * w + x] = scale * light.skyWeight({x, y});
        }
    });
    light.alias = aliasCells(std::move(mass));
}

/// Running sums of the sky; their end is its power.
double sumSky(Light& light)
{
    const int w = light.projection->width, h = light.projection->height;
    tbb::parallel_for(0, h, [&](int y) {
        double sum = 0;
        for (int x = 0; x < w; ++x) {
            sum += light.skyWeight({x, y});
            light.columnSums[static_cast<std::size_t>(y) * w + x] = sum;
        }
        light.rowSums[y] = sum;
    });
    for (int y = 1; y < h; ++y) light.rowSums[y] += light.rowSums[y - 1];
    return light.rowSums[h - 1];
}

void buildDistribution(Light& light)
{
    light.columnSums.resize(light.pixels.size());
    light.rowSums.resize(light.projection->height);
    light.total = sumSky(light);
    if (!(light.total > 0)) return;
    light.perTotal = 1 / light.total;
    light.sun = SunTexels(*light.projection, light.pixels, light.total);
    if (!light.sun.empty()) {
        light.sunShare = light.sun.power() * light.perTotal;
        sumSky(light);
    }
    buildAlias(light);
}

template <typename T> std::uint64_t bitsOf(const T& value)
{
    std::uint64_t bits = 0;
    std::memcpy(&bits, &value, sizeof(value));
    return bits;
}

std::uint64_t hashLight(EnvironmentProjection projection, const Light& light)
{
    std::uint64_t h = hashCombine(0x656e7669726f6eull, static_cast<std::uint64_t>(projection));
    h = hashCombine(h, static_cast<std::uint64_t>(light.projection->width));
    h = hashCombine(h, static_cast<std::uint64_t>(light.projection->height));
    for (const Color& c : light.pixels) {
        h = hashCombine(h, bitsOf(c.x) << 32 | bitsOf(c.y));
        h = hashCombine(h, bitsOf(c.z));
    }
    return h;
}

/// Right-handed about +Y, for row vectors: +X goes to −Z at 90°. Exact at quarter turns.
Mat3d rotationAboutY(double degrees)
{
    const double turn = std::remainder(degrees, 360.0);
    double c = std::cos(turn * kPi / 180.0), s = std::sin(turn * kPi / 180.0);
    if (std::remainder(turn, 90.0) == 0.0) {
        c = std::round(c);
        s = std::round(s);
    }
    return Mat3d(c, 0, -s, 0, 1, 0, s, 0, c);
}

Vec3d row(const Mat3d& m, int i) { return Vec3d(m[i][0], m[i][1], m[i][2]); }

/// @a R made orthonormal to rounding, so that its transpose is its inverse.
Mat3d checkedRotation(const Mat3d& R)
{
    const Mat3d shouldBeOne = R * R.transposed();
    if (!shouldBeOne.equalWithAbsError(Mat3d(), 1e-6) || !(R.determinant() > 0))
        throw Error(ErrorCode::Usage,
            "The matrix that turns the environment is no rotation; use an orthonormal matrix "
            "with determinant +1.");
    const Vec3d x = row(R, 0).normalized();
    const Vec3d y = (row(R, 1) - x * x.dot(row(R, 1))).normalized();
    const Vec3d z = x.cross(y);
    return Mat3d(x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z);
}

void checkOptions(const EnvironmentOptions& options)
{
    if (!std::isfinite(options.scale) || options.scale < 0)
        throw Error(ErrorCode::Usage,
            "The environment's scale is " + std::to_string(options.scale)
                + "; use a finite number that is not negative.");
    if (!std::isfinite(options.rotateDegrees))
        throw Error(
            ErrorCode::Usage, "The environment's rotation is not finite; use a number of degrees.");
}

/// Black for what is no light, then scaled; −0 becomes 0 so that equal light hashes equally.
float cleaned(float value, float scale)
{
    if (!std::isfinite(value) || value <= 0) return 0.0f;
    const float scaled = value * scale;
    if (!std::isfinite(scaled))
        throw Error(ErrorCode::Usage,
            "The environment's scale of " + std::to_string(scale)
                + " overflows its brightest pixel; use a smaller one.");
    return scaled;
}

} // namespace

struct Environment::Impl {
    std::shared_ptr<const Light> light;
    Mat3d toWorld; ///< d_world = d_image * toWorld

    Vec3d toImage(const Vec3d& d) const
    {
        return Vec3d(row(toWorld, 0).dot(d), row(toWorld, 1).dot(d), row(toWorld, 2).dot(d));
    }
    /// The point (s, t) of a texel, as a sample.
    Sample sampleIn(Texel texel, double s, double t, bool sun) const
    {
        Vec3d d(0, 0, 1);
        const bool onSphere = light->projection->pointIn(texel, s, t, d);
        if (!onSphere) return {d.normalized() * toWorld, Color(0), 0.0, sun};
        return {d * toWorld, light->at(texel), light->pdf(texel, d), sun};
    }
};

Environment::Environment() = default;
Environment::~Environment() = default;

std::shared_ptr<const Environment> Environment::fromPixels(
    int width, int height, std::vector<Color> pixels, const EnvironmentOptions& options)
{
    checkOptions(options);
    const EnvironmentProjection projection
        = detail::resolveProjection(options.projection, width, height, "The environment image");
    if (pixels.size() != static_cast<std::size_t>(width) * height)
        throw Error(ErrorCode::Usage,
            "The environment image has " + std::to_string(pixels.size()) + " pixels; give width x "
                + "height of them.");
    auto light = std::make_shared<Light>();
    light->projection = detail::makeProjection(projection, width, height);
    for (Color& c : pixels)
        for (int channel = 0; channel < 3; ++channel)
            c[channel] = cleaned(c[channel], options.scale);
    light->pixels = std::move(pixels);
    buildDistribution(*light);
    light->hash = hashLight(projection, *light);

    auto impl = std::make_shared<Impl>();
    impl->light = std::move(light);
    impl->toWorld = rotationAboutY(options.rotateDegrees);
    std::shared_ptr<Environment> result(new Environment);
    result->mImpl = std::move(impl);
    return result;
}

std::shared_ptr<const Environment> Environment::constant(const Color& L)
{
    EnvironmentOptions options;
    options.projection = EnvironmentProjection::LatLong;
    return fromPixels(2, 1, {L, L}, options);
}

std::shared_ptr<const Environment> Environment::rotated(const Mat3d& R) const
{
    auto impl = std::make_shared<Impl>(*mImpl);
    impl->toWorld = mImpl->toWorld * checkedRotation(R);
    std::shared_ptr<Environment> result(new Environment);
    result->mImpl = std::move(impl);
    return result;
}

Color Environment::radiance(const Vec3d& d) const
{
    const Light& light = *mImpl->light;
    return light.at(light.projection->texelAt(mImpl->toImage(d)));
}

Environment::Sample Environment::sample(double u, double v) const
{
    const double sun = mImpl->light->sunShare;
    return u < sun ? sampleSun(u / sun, v) : sampleSky((u - sun) / (1 - sun), v);
}

Environment::Sample Environment::sampleSun(double u, double v) const
{
    double s, t;
    const Texel texel = mImpl->light->sun.draw(u, v, s, t);
    return mImpl->sampleIn(texel, s, t, true);
}

Environment::Sample Environment::sampleSky(double u, double v) const
{
    const Light& light = *mImpl->light;
    const int w = light.projection->width, h = light.projection->height;
    if (!(light.total > 0)) return {Vec3d(0, 1, 0), Color(0), 0.0};
    Texel texel;
    double s, t;
    texel.y = invertRunningSum(light.rowSums.data(), h, v, t);
    texel.x = invertRunningSum(
        light.columnSums.data() + static_cast<std::size_t>(texel.y) * w, w, u, s);
    return mImpl->sampleIn(texel, s, t, false);
}

void Environment::prefetchDraw(double t) const
{
    const Light& light = *mImpl->light;
    __builtin_prefetch(&light.alias[light.cellOf(t)]);
}

std::uint32_t Environment::drawTexel(double t) const
{
    const Light& light = *mImpl->light;
    const std::uint32_t texel = light.draw(t);
    __builtin_prefetch(&light.pixels[texel]);
    return texel;
}

Environment::Sample Environment::sampleTexel(std::uint32_t texel, double u, double v) const
{
    const auto w = static_cast<std::uint32_t>(mImpl->light->projection->width);
    const auto inset = [](double x) { return std::clamp(x, kInset, 1.0 - kInset); };
    return mImpl->sampleIn(
        {static_cast<int>(texel % w), static_cast<int>(texel / w)}, inset(u), inset(v), false);
}

Environment::Sample Environment::draw(double t, double u, double v) const
{
    const double sun = mImpl->light->sunShare;
    return t < sun ? sampleSun(u, v) : sampleTexel(drawTexel((t - sun) / (1 - sun)), u, v);
}

Environment::Arrival Environment::arrival(const Vec3d& d) const
{
    const Light& light = *mImpl->light;
    const Vec3d local = mImpl->toImage(d);
    const Texel texel = light.projection->texelAt(local);
    return {light.at(texel), light.pdf(texel, local), light.inSun(texel)};
}

Environment::Sun Environment::sun() const
{
    const Light& light = *mImpl->light;
    if (light.sun.empty()) return {};
    return {light.sunShare, light.sun.direction() * mImpl->toWorld, light.sun.radius()};
}

double Environment::pdf(const Vec3d& d) const { return arrival(d).pdf; }

double Environment::power() const { return mImpl->light->total; }

std::vector<Vec3d> Environment::projectDouble(int bands) const
{
    if (bands < 1 || bands > kMaxBands)
        throw Error(ErrorCode::Usage,
            std::to_string(bands) + " bands cannot be projected; use 1 to "
                + std::to_string(kMaxBands) + ".");
    const Light& light = *mImpl->light;
    const int w = light.projection->width, h = light.projection->height;
    const std::size_t n = coefficientCount(bands);
    // One sum per row, added up in the rows' sequence: the same bits for any number of threads.
    std::vector<Vec3d> rows(n * h, Vec3d(0));
    tbb::parallel_for(0, h, [&](int y) {
        std::vector<SphereNode> nodes;
        double basis[kMaxCoefficients], texelSum[kMaxCoefficients];
        for (int x = 0; x < w; ++x) {
            const Vec3d L(light.at({x, y}));
            if (L == Vec3d(0)) continue;
            light.projection->quadrature({x, y}, nodes);
            std::fill(texelSum, texelSum + n, 0.0);
            for (const SphereNode& node : nodes) {
                evalShBasis(bands, node.direction * mImpl->toWorld, basis);
                for (std::size_t i = 0; i < n; ++i) texelSum[i] += node.weight * basis[i];
            }
            for (std::size_t i = 0; i < n; ++i) rows[y * n + i] += L * texelSum[i];
        }
    });
    std::vector<Vec3d> result(n, Vec3d(0));
    for (int y = 0; y < h; ++y)
        for (std::size_t i = 0; i < n; ++i) result[i] += rows[y * n + i];
    return result;
}

std::vector<Color> Environment::project(int bands) const
{
    const std::vector<Vec3d> exact = projectDouble(bands);
    return std::vector<Color>(exact.begin(), exact.end());
}

std::uint64_t Environment::contentHash() const
{
    std::uint64_t h = mImpl->light->hash;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) // adding 0 makes −0 and 0 one
            h = hashCombine(h, bitsOf(mImpl->toWorld[i][j] + 0.0));
    return h;
}

} // namespace lumivdb
