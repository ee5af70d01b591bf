// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file xxhash64.h
/// The 64-bit checksum of files: XXH64 with seed 0, so that `xxhsum -H1` and the xxhash
/// modules of other languages can verify it (specification: Collet, "xxHash fast digest
/// algorithm").

#include <array>
#include <cstddef>
#include <cstdint>

namespace lumivdb {

/// XXH64 of a stream of bytes in pieces of any size.
class XxHash64 {
public:
    XxHash64();
    void update(const void* data, std::size_t size);
    std::uint64_t digest() const;

private:
    void stripe(const unsigned char* p);

    std::array<std::uint64_t, 4> mLanes;
    std::array<unsigned char, 32> mTail{};
    std::uint64_t mLength = 0;
};

} // namespace lumivdb
