// SPDX-License-Identifier: Apache-2.0
#include "directions.h"

#include <lumivdb/core/random.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

constexpr double kBelowOne = 0x1.fffffffffffffp-1;
/// Separates the numbers of later sets from those of the first.
constexpr std::uint64_t kSetStream = 0x7be5149f0d3c62a9ull;
/// Separates the choice of a pattern from other uses of a point's key.
constexpr std::uint64_t kPatternStream = 0x2f8a6c1d94e7b053ull;
constexpr int kPatterns = 16;
/// All patterns together have at most so many directions, or one has more.
constexpr int kPatternDirections = 1 << 16;

/// The even bits of @a v, together.
constexpr std::uint64_t evenBits(std::uint64_t v)
{
    v &= 0x5555555555555555ull;
    v = (v | v >> 1) & 0x3333333333333333ull;
    v = (v | v >> 2) & 0x0f0f0f0f0f0f0f0full;
    v = (v | v >> 4) & 0x00ff00ff00ff00ffull;
    v = (v | v >> 8) & 0x0000ffff0000ffffull;
    return (v | v >> 16) & 0x00000000ffffffffull;
}

/// Bit k becomes the parity of the bits above it; below 32 bits.
constexpr std::uint64_t parityAbove(std::uint64_t v)
{
    v >>= 1;
    v ^= v >> 1;
    v ^= v >> 2;
    v ^= v >> 4;
    v ^= v >> 8;
    return v ^ v >> 16;
}

} // namespace

Vec2d hilbertPoint(double t)
{
    // Two bits of t a level choose the quadrant. The first and the last quadrant hold the curve
    // transposed, the last turned half round too; both commute, so how a level lies is the parity
    // of such quadrants above it, and all levels are found at once.
    constexpr int kLevels = 20;
    constexpr std::uint64_t kMask = (std::uint64_t{1} << kLevels) - 1;
    constexpr double kScale = static_cast<double>(std::uint64_t{1} << (2 * kLevels));
    const auto d = static_cast<std::uint64_t>(t * kScale);
    const std::uint64_t high = evenBits(d >> 1), low = evenBits(d);
    const std::uint64_t turned = parityAbove(high & low);
    const std::uint64_t swapped = parityAbove(~(high ^ low) & kMask) & low;
    const std::uint64_t x = high ^ turned ^ swapped, y = high ^ low ^ turned ^ swapped;
    constexpr double kStep = 1.0 / static_cast<double>(std::uint64_t{1} << kLevels);
    return {(static_cast<double>(static_cast<std::int64_t>(x)) + 0.5) * kStep,
        (static_cast<double>(static_cast<std::int64_t>(y)) + 0.5) * kStep};
}

Vec3d squareToSphere(const Vec2d& uv)
{
    const double u = 2 * uv.x - 1, v = 2 * uv.y - 1;
    const double au = std::abs(u), av = std::abs(v);
    const double signedDistance = 1 - (au + av);
    const double r = 1 - std::abs(signedDistance);
    const double phi = (r == 0 ? 1 : (av - au) / r + 1) * (3.14159265358979323846 / 4);
    const double z = std::copysign(1 - r * r, signedDistance);
    const double s = r * std::sqrt(std::max(0.0, 2 - r * r));
    return {std::copysign(std::cos(phi) * s, u), std::copysign(std::sin(phi) * s, v), z};
}

Vec2f sphereToSquare(const Vec3f& d)
{
    const float r = std::sqrt(std::max(0.0f, 1 - std::abs(d.z)));
    const float ax = std::abs(d.x), ay = std::abs(d.y), most = std::max(ax, ay);
    const float angle = most > 0 ? quarterTurns(std::min(ax, ay) / most) : 0.0f;
    float v = r * (ay > ax ? 1 - angle : angle);
    float u = r - v;
    if (d.z < 0) {
        const float folded = 1 - v;
        v = 1 - u;
        u = folded;
    }
    return {0.5f + 0.5f * std::copysign(u, d.x), 0.5f + 0.5f * std::copysign(v, d.y)};
}

double jitteredStratum(std::uint64_t seed, std::uint64_t i, std::uint64_t count)
{
    CounterRng rng(hashCombine(mixBits(seed), i));
    const double t = (static_cast<double>(i) + rng.nextDouble()) / static_cast<double>(count);
    return std::min(t, kBelowOne);
}

std::vector<double> nestedPositions(std::uint64_t seed, std::uint64_t count, int set)
{
    std::vector<double> all(count);
    for (std::uint64_t i = 0; i < count; ++i) all[i] = jitteredStratum(seed, i, count);
    std::vector<double> added = all;
    for (int k = 1; k <= set; ++k) {
        const std::uint64_t stream = hashCombine(mixBits(seed ^ kSetStream), std::uint64_t(k));
        const auto halves = static_cast<double>(2 * all.size());
        std::vector<double> both;
        both.reserve(2 * all.size());
        added.resize(all.size());
        for (std::size_t i = 0; i < all.size(); ++i) {
            const auto first = static_cast<double>(2 * i);
            const bool upper = all[i] * halves >= first + 1;
            CounterRng rng(hashCombine(stream, i));
            const double half = upper ? first : first + 1;
            added[i] = std::min((half + rng.nextDouble()) / halves, kBelowOne);
            both.push_back(upper ? added[i] : all[i]);
            both.push_back(upper ? all[i] : added[i]);
        }
        all = std::move(both);
    }
    return added;
}

int SamplingPattern::count(int rays) { return std::clamp(kPatternDirections / rays, 1, kPatterns); }

SamplingPattern::SamplingPattern(std::uint64_t base, std::uint64_t key, int rays)
    : number(
        static_cast<int>(mixBits(key ^ kPatternStream) % static_cast<std::uint64_t>(count(rays))))
    , seed(hashCombine(mixBits(base), static_cast<std::uint64_t>(number)))
{
}

std::vector<Vec3f> stratifiedDirections(std::uint64_t seed, int count, int set)
{
    const auto positions = nestedPositions(seed, static_cast<std::uint64_t>(count), set);
    std::vector<Vec3f> directions;
    directions.reserve(positions.size());
    for (const double t : positions) directions.emplace_back(squareToSphere(hilbertPoint(t)));
    return directions;
}

} // namespace lumivdb
