// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file layout_check.h
/// OpenVDB's reader believes what it finds: it allocates what a length says, and reads a block of
/// values whose size is negative to wherever that leads before it compares the size. These checks
/// walk over the same bytes first, for file versions from 222 on. They read no more than is there,
/// take memory for strings and root tiles that are there only, and leave the stream where it was.
/// All throw std::runtime_error with the first thing that is wrong.

#include <cstdint>
#include <istream>
#include <string>

namespace lumivdb {

/// The next @a count strings lie in the file.
void checkStrings(std::istream& stream, std::uint64_t fileSize, int count);
/// The next map of metadata: names, types, and the sizes that OpenVDB takes for granted.
void checkMetadata(std::istream& stream, std::uint64_t fileSize);
/// The names of the next transform's map and, of a perspective one, of the map inside it.
void checkTransform(std::istream& stream, std::uint64_t fileSize);

/// How a grid's tree of 32³, 16³ and 8³ nodes keeps its values.
struct TreeLayout {
    std::uint32_t valueBytes = 0; ///< of a value in memory; 0: this type of tree is not known here
    std::uint32_t halfBytes = 0; ///< of a value stored as half; 0: the type has no such form
    bool half = false; ///< blocks of values hold halfs, where the type has them
    std::uint32_t compression = 0; ///< OpenVDB's flags
};

/// By OpenVDB's name of the grid's type, without its suffix for half. Not compressed, not half.
TreeLayout layoutOfType(const std::string& gridType);

inline bool isKnown(const TreeLayout& layout) { return layout.valueBytes > 0; }

/// The next tree, topology and values: counts of nodes, masks, and every block of values has the
/// size that is due. What Blosc or zlib make of a block's content is theirs to check.
/// @return the position behind it
std::uint64_t checkTree(std::istream& stream, std::uint64_t fileSize, const TreeLayout& layout);

} // namespace lumivdb
