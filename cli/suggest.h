// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file suggest.h
/// "Did you mean …?"

#include <string>
#include <vector>

namespace lumivdb::cli {

/// Number of single-letter insertions, deletions, substitutions and swaps of neighbours that turn
/// @a a into @a b (optimal string alignment distance).
int editDistance(const std::string& a, const std::string& b);

/// The candidate nearest to @a word, one it is the beginning of first; empty when none is near
/// enough to be meant.
std::string nearest(const std::string& word, const std::vector<std::string>& candidates);

/// ", did you mean WORD?" or an empty text.
std::string didYouMean(const std::string& word, const std::vector<std::string>& candidates);

} // namespace lumivdb::cli
