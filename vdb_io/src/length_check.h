// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file length_check.h
/// OpenVDB's reader allocates what a length field says before it reads: a damaged one costs
/// gigabytes. These checks run over the same bytes first and return to where they began.

#include <cstdint>
#include <istream>

namespace lumivdb {

/// The next @a count strings. @throws std::runtime_error when one is longer than the file.
void checkStrings(std::istream& stream, std::uint64_t fileSize, int count);
/// The next map of metadata.
void checkMetadata(std::istream& stream, std::uint64_t fileSize);
/// The next tree must have the one buffer that OpenVDB supports (it would warn on stderr).
void checkBufferCount(std::istream& stream);

} // namespace lumivdb
