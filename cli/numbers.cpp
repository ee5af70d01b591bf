// SPDX-License-Identifier: Apache-2.0
#include "numbers.h"

#include <charconv>
#include <cmath>
#include <cstdio>

namespace lumivdb::cli {

namespace {

template <class T> std::optional<T> parseWhole(std::string_view text)
{
    T value{};
    const char* end = text.data() + text.size();
    const auto result = std::from_chars(text.data(), end, value);
    if (text.empty() || result.ec != std::errc() || result.ptr != end) return std::nullopt;
    return value;
}

template <class T> void appendShortest(std::string& out, T value)
{
    if (std::isnan(value)) {
        out += "nan"; // to_chars would tell the sign of a NaN
        return;
    }
    char buffer[64];
    const auto result = std::to_chars(buffer, buffer + sizeof buffer, value);
    out.append(buffer, result.ptr);
}

} // namespace

std::optional<double> parseReal(std::string_view text)
{
    const auto value = parseWhole<double>(text);
    return value && std::isfinite(*value) ? value : std::nullopt;
}

std::optional<std::int64_t> parseInteger(std::string_view text)
{
    return parseWhole<std::int64_t>(text);
}

std::optional<std::uint64_t> parseUnsigned(std::string_view text)
{
    return parseWhole<std::uint64_t>(text);
}

std::optional<std::vector<double>> parseReals(std::string_view text)
{
    std::vector<double> values;
    for (const std::string_view part : split(text, ',')) {
        const auto value = parseReal(part);
        if (!value) return std::nullopt;
        values.push_back(*value);
    }
    return values;
}

std::string_view trimmed(std::string_view text)
{
    constexpr const char* kBlanks = " \t\r\n\f\v";
    const std::size_t first = text.find_first_not_of(kBlanks);
    if (first == std::string_view::npos) return {};
    return text.substr(first, text.find_last_not_of(kBlanks) - first + 1);
}

std::vector<std::string_view> split(std::string_view text, char separator)
{
    std::vector<std::string_view> parts;
    for (;;) {
        const std::size_t at = text.find(separator);
        parts.push_back(trimmed(text.substr(0, at)));
        if (at == std::string_view::npos) return parts;
        text.remove_prefix(at + 1);
    }
}

void appendNumber(std::string& out, float value) { appendShortest(out, value); }
void appendNumber(std::string& out, double value) { appendShortest(out, value); }

std::string toText(double value)
{
    std::string text;
    appendNumber(text, value);
    return text;
}

std::string toText(const Vec3d& value)
{
    return toText(value.x) + "," + toText(value.y) + "," + toText(value.z);
}

std::string grouped(std::uint64_t value)
{
    std::string text = std::to_string(value);
    for (std::size_t at = text.size(); at > 3; at -= 3) text.insert(at - 3, ",");
    return text;
}

std::string rounded(double value, int digits)
{
    char buffer[64];
    std::snprintf(buffer, sizeof buffer, "%.*g", digits, value);
    return buffer;
}

std::string humanBytes(std::uint64_t bytes)
{
    static constexpr const char* kUnits[] = {"bytes", "kB", "MB", "GB", "TB"};
    double value = static_cast<double>(bytes);
    int unit = 0;
    for (; value >= 999.5 && unit < 4; ++unit) value /= 1000;
    return rounded(value, unit == 0 ? 4 : 3) + " " + kUnits[unit];
}

std::string humanSeconds(double seconds)
{
    char buffer[64];
    if (seconds < 0.0995) {
        std::snprintf(buffer, sizeof buffer, "%.0f ms", 1000 * seconds);
        return buffer;
    }
    if (seconds < 59.5) {
        std::snprintf(buffer, sizeof buffer, seconds < 9.95 ? "%.2g s" : "%.0f s", seconds);
        return buffer;
    }
    const auto whole = static_cast<long long>(std::llround(seconds));
    if (whole < 3600) {
        std::snprintf(buffer, sizeof buffer, "%lld min %02lld s", whole / 60, whole % 60);
    } else {
        std::snprintf(buffer, sizeof buffer, "%lld h %02lld min", whole / 3600, whole / 60 % 60);
    }
    return buffer;
}

double jsonNumber(float value)
{
    if (!std::isfinite(value)) return value;
    char buffer[64];
    const auto end = std::to_chars(buffer, buffer + sizeof buffer, value).ptr;
    double result = value;
    std::from_chars(buffer, end, result);
    return result;
}

} // namespace lumivdb::cli
