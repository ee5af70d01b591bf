// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file random.h
/// Counter-based random numbers: every number is a pure function of its key, never of the order in
/// which threads ask. That is what makes a bake independent of the number of threads.

#include <lumivdb/core/types.h>

#include <cstdint>

namespace lumivdb {

/// 64-bit finaliser with full avalanche (SplitMix64's; Steele, Lea & Flood, OOPSLA 2014).
constexpr std::uint64_t mixBits(std::uint64_t z)
{
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    return z ^ (z >> 31);
}

constexpr std::uint64_t hashCombine(std::uint64_t h, std::uint64_t v)
{
    return mixBits(h + 0x9e3779b97f4a7c15ull + v * 0xd6e8feb86659fd93ull);
}

/// Key of a lattice point: each axis whole, so far points never share one by truncation.
constexpr std::uint64_t hashPoint(std::uint64_t seed, int x, int y, int z)
{
    return hashCombine(hashCombine(hashCombine(mixBits(seed + 0x9e3779b97f4a7c15ull),
                                       static_cast<std::uint32_t>(x)),
                           static_cast<std::uint32_t>(y)),
        static_cast<std::uint32_t>(z));
}

/// A stream of uniform numbers in [0, 1) from a key: number k of a key is always the same.
class CounterRng {
public:
    explicit constexpr CounterRng(std::uint64_t key = 0)
        : mState(key)
    {
    }
    constexpr std::uint64_t bits()
    {
        mState += 0x9e3779b97f4a7c15ull;
        return mixBits(mState);
    }
    /// Uniform in [0, 1), 24 bits, never 1.
    float next() { return static_cast<float>(bits() >> 40) * 0x1p-24f; }
    /// Two of them at once, from one number's bits.
    Vec2f nextPair()
    {
        const std::uint64_t b = bits();
        return {static_cast<float>(b >> 40) * 0x1p-24f,
            static_cast<float>(b >> 16 & 0xffffff) * 0x1p-24f};
    }
    /// Uniform in [0, 1), 53 bits, never 1.
    double nextDouble() { return static_cast<double>(bits() >> 11) * 0x1p-53; }

private:
    std::uint64_t mState;
};

} // namespace lumivdb
