// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/xxhash64.h>

#include <algorithm>
#include <cstring>

namespace lumivdb {

namespace {

constexpr std::uint64_t kPrime1 = 0x9e3779b185ebca87ull;
constexpr std::uint64_t kPrime2 = 0xc2b2ae3d27d4eb4full;
constexpr std::uint64_t kPrime3 = 0x165667b19e3779f9ull;
constexpr std::uint64_t kPrime4 = 0x85ebca77c2b2ae63ull;
constexpr std::uint64_t kPrime5 = 0x27d4eb2f165667c5ull;

constexpr std::uint64_t rotl(std::uint64_t v, int bits) { return (v << bits) | (v >> (64 - bits)); }

constexpr std::uint64_t mixLane(std::uint64_t lane, std::uint64_t word)
{
    return rotl(lane + word * kPrime2, 31) * kPrime1;
}

constexpr std::uint64_t mergeLane(std::uint64_t h, std::uint64_t lane)
{
    return (h ^ mixLane(0, lane)) * kPrime1 + kPrime4;
}

/// Little-endian number of @a bytes bytes, on any host.
std::uint64_t readWord(const unsigned char* p, int bytes)
{
    std::uint64_t word = 0;
    for (int i = 0; i < bytes; ++i) word |= std::uint64_t{p[i]} << (8 * i);
    return word;
}

} // namespace

XxHash64::XxHash64()
    : mLanes{kPrime1 + kPrime2, kPrime2, 0, 0 - kPrime1}
{
}

void XxHash64::stripe(const unsigned char* p)
{
    for (int i = 0; i < 4; ++i) mLanes[i] = mixLane(mLanes[i], readWord(p + 8 * i, 8));
}

void XxHash64::update(const void* data, std::size_t size)
{
    const auto* p = static_cast<const unsigned char*>(data);
    const std::size_t held = mLength % 32;
    mLength += size;
    if (held > 0) {
        const std::size_t n = std::min(size, 32 - held);
        std::memcpy(mTail.data() + held, p, n);
        if (held + n < 32) return;
        stripe(mTail.data());
        p += n;
        size -= n;
    }
    for (; size >= 32; p += 32, size -= 32) stripe(p);
    if (size > 0) std::memcpy(mTail.data(), p, size);
}

std::uint64_t XxHash64::digest() const
{
    std::uint64_t h = kPrime5;
    if (mLength >= 32) {
        h = rotl(mLanes[0], 1) + rotl(mLanes[1], 7) + rotl(mLanes[2], 12) + rotl(mLanes[3], 18);
        for (const std::uint64_t lane : mLanes) h = mergeLane(h, lane);
    }
    h += mLength;
    const unsigned char* p = mTail.data();
    std::size_t left = mLength % 32;
    for (; left >= 8; p += 8, left -= 8)
        h = rotl(h ^ mixLane(0, readWord(p, 8)), 27) * kPrime1 + kPrime4;
    if (left >= 4) {
        h = rotl(h ^ (readWord(p, 4) * kPrime1), 23) * kPrime2 + kPrime3;
        p += 4;
        left -= 4;
    }
    for (; left > 0; ++p, --left) h = rotl(h ^ (*p * kPrime5), 11) * kPrime1;
    h = (h ^ (h >> 33)) * kPrime2;
    h = (h ^ (h >> 29)) * kPrime3;
    return h ^ (h >> 32);
}

} // namespace lumivdb
