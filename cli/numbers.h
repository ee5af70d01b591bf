// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file numbers.h
/// Strict reading and round-trip writing of numbers. Reading accepts the whole text or nothing: no
/// spaces, no "16k", no "1e3" where an integer is asked, no nan or inf.

#include <lumivdb/core/types.h>

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace lumivdb::cli {

/// The finite number that @a text is, or nothing.
std::optional<double> parseReal(std::string_view text);
/// The decimal integer that @a text is, or nothing.
std::optional<std::int64_t> parseInteger(std::string_view text);
std::optional<std::uint64_t> parseUnsigned(std::string_view text);
/// Finite numbers separated by commas, or nothing. An empty text is not a list.
std::optional<std::vector<double>> parseReals(std::string_view text);

/// Text without leading and trailing blanks.
std::string_view trimmed(std::string_view text);
/// Parts between @a separator, at least one, each trimmed.
std::vector<std::string_view> split(std::string_view text, char separator);

/// Appends the shortest decimal form that reads back as the same value; nan and inf by name.
void appendNumber(std::string& out, float value);
void appendNumber(std::string& out, double value);
std::string toText(double value);
std::string toText(const Vec3d& value); ///< "x,y,z"
/// With thousands separators: 1,234,567.
std::string grouped(std::uint64_t value);
/// @a value with @a digits significant digits, for people.
std::string rounded(double value, int digits = 4);
/// "1.5 MB" (powers of 1000).
std::string humanBytes(std::uint64_t bytes);
/// "3 ms", "0.42 s", "12 s", "3 min 20 s", "1 h 05 min".
std::string humanSeconds(double seconds);
/// The double that prints as the shortest form of @a value: what a JSON writer should be given.
double jsonNumber(float value);

} // namespace lumivdb::cli
