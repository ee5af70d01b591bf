// SPDX-License-Identifier: Apache-2.0
#include "arguments.h"

#include "numbers.h"
#include "suggest.h"

#include <lumivdb/core/error.h>

#include <CLI/CLI.hpp>

#include <algorithm>
#include <array>
#include <cmath>

namespace lumivdb::cli {

namespace {

constexpr std::size_t kHelpColumn = 26;

/// Exact for the integers that options take; shortest otherwise.
std::string numberText(double value)
{
    if (std::abs(value) < 1e15 && value == std::floor(value)) {
        return std::to_string(static_cast<long long>(value));
    }
    return toText(value);
}

std::string quoted(const std::string& word)
{
    constexpr const char* kPlain
        = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-+=./,:@%";
    if (!word.empty() && word.find_first_not_of(kPlain) == std::string::npos) return word;
    std::string out = "'";
    for (const char c : word) out += c == '\'' ? std::string("'\\''") : std::string(1, c);
    return out + "'";
}

std::string withRange(const std::string& help, const Range& range, const std::string& current)
{
    std::string note = range.text();
    if (!current.empty()) note += (note.empty() ? "default" : "; default") + current;
    return note.empty() ? help : help + " [" + note + "]";
}

/// The integer in @a text. @throws Error(Usage) naming option, value and range.
std::int64_t integerOf(const std::string& names, const std::string& text, const Range& range)
{
    const auto value = parseInteger(text);
    if (!value) failValue(names, text, "not an integer; allowed: " + range.text());
    if (!range.contains(static_cast<double>(*value))) {
        failValue(names, text, "out of range; allowed: " + range.text());
    }
    return *value;
}

double realOf(const std::string& names, const std::string& text, const Range& range)
{
    const auto value = parseReal(text);
    const std::string allowed = range.text().empty() ? "" : "; allowed: " + range.text();
    if (!value) failValue(names, text, "not a finite number" + allowed);
    if (!range.contains(*value)) failValue(names, text, "out of range" + allowed);
    return *value;
}

std::vector<double> realsOf(
    const std::string& names, const std::string& text, std::size_t count, const std::string& form)
{
    const auto values = parseReals(text);
    if (!values || values->size() != count) {
        failValue(names, text,
            "not " + std::to_string(count) + " finite numbers with commas between; give " + form);
    }
    return *values;
}

} // namespace

bool Range::contains(double value) const
{
    return value <= high && (aboveLow ? value > low : value >= low);
}

std::string Range::text() const
{
    constexpr double kMax = std::numeric_limits<double>::max();
    if (low == -kMax && high == kMax) return "";
    if (high == kMax) return (aboveLow ? "greater than " : "at least ") + numberText(low);
    return (aboveLow ? "above " : "") + numberText(low) + " to " + numberText(high);
}

Range between(double low, double high) { return {low, high, false}; }
Range atLeast(double low) { return {low, std::numeric_limits<double>::max(), false}; }
Range greaterThan(double low) { return {low, std::numeric_limits<double>::max(), true}; }

void failUsage(const std::string& sentence) { throw Error(ErrorCode::Usage, sentence); }

void failValue(const std::string& names, const std::string& value, const std::string& why)
{
    const std::string name = names.substr(names.rfind(',') + 1);
    failUsage(name + " " + (value.empty() ? "''" : value) + ": " + why + ".");
}

std::string wrapped(const std::string& text, std::size_t indent, std::size_t width)
{
    std::string out;
    std::size_t column = indent;
    for (const std::string_view word : split(text, ' ')) {
        if (word.empty()) continue;
        if (column > indent && column + 1 + word.size() > width) {
            out += "\n" + std::string(indent, ' ');
            column = indent;
        } else if (column > indent) {
            out += ' ';
            ++column;
        }
        out += word;
        column += word.size();
    }
    return out;
}

std::string Arguments::Option::longName() const { return names.substr(names.rfind(',') + 1); }

Arguments::Arguments(std::string command, std::string summary)
    : mCommand(std::move(command))
    , mSummary(std::move(summary))
{
}

void Arguments::section(const std::string& title) { mSection = title; }
void Arguments::require() { mOptions.back().required = true; }
void Arguments::neutral() { mOptions.back().neutral = true; }
void Arguments::describe(const std::string& paragraph) { mParagraphs.push_back(paragraph); }

void Arguments::example(const std::string& commandLine, const std::string& what)
{
    mExamples.emplace_back(commandLine, what);
}

void Arguments::add(Option option)
{
    option.section = mSection;
    mOptions.push_back(std::move(option));
}

void Arguments::positional(const std::string& name, std::string& target, const std::string& help)
{
    Option option;
    option.names = name;
    option.help = help;
    option.positional = true;
    option.convert = [&target](const std::string& value) { target = value; };
    add(std::move(option));
}

void Arguments::positionals(
    const std::string& name, std::vector<std::string>& target, const std::string& help)
{
    Option option;
    option.names = name;
    option.help = help;
    option.positional = option.many = true;
    option.convert = [&target](const std::string& value) { target.push_back(value); };
    add(std::move(option));
}

void Arguments::flag(const std::string& names, bool& target, const std::string& help)
{
    custom(
        names, "", [&target](const std::string&) { target = true; }, help);
}

void Arguments::custom(const std::string& names, const std::string& valueName, Convert convert,
    const std::string& help)
{
    Option option;
    option.names = names;
    option.valueName = valueName;
    option.help = help;
    option.convert = std::move(convert);
    add(std::move(option));
}

void Arguments::repeated(const std::string& names, const std::string& valueName, Convert convert,
    const std::string& help)
{
    custom(names, valueName, std::move(convert), help);
    mOptions.back().many = true;
}

void Arguments::text(const std::string& names, const std::string& valueName, std::string& target,
    const std::string& help)
{
    const auto convert = [&target, names](const std::string& value) {
        if (value.empty()) failValue(names, value, "the value is empty; give one");
        target = value;
    };
    custom(names, valueName, convert, help);
}

void Arguments::integer(
    const std::string& names, int& target, const Range& range, const std::string& help)
{
    const auto convert = [&target, names, range](const std::string& value) {
        target = static_cast<int>(integerOf(names, value, range));
    };
    custom(names, "N", convert, withRange(help, range, " " + std::to_string(target)));
}

void Arguments::size(
    const std::string& names, std::size_t& target, const Range& range, const std::string& help)
{
    const auto convert = [&target, names, range](const std::string& value) {
        target = static_cast<std::size_t>(integerOf(names, value, range));
    };
    custom(names, "N", convert, withRange(help, range, " " + std::to_string(target)));
}

void Arguments::seed(const std::string& names, std::uint64_t& target, const std::string& help)
{
    const auto convert = [&target, names](const std::string& value) {
        const auto number = parseUnsigned(value);
        if (!number) failValue(names, value, "not an integer from 0 to 18446744073709551615");
        target = *number;
    };
    custom(names, "S", convert, help + " [0 to 2^64-1; default " + std::to_string(target) + "]");
}

void Arguments::real(
    const std::string& names, double& target, const Range& range, const std::string& help)
{
    const auto convert = [&target, names, range](
                             const std::string& value) { target = realOf(names, value, range); };
    custom(names, "X", convert, withRange(help, range, " " + toText(target)));
}

void Arguments::real(const std::string& names, std::optional<double>& target, const Range& range,
    const std::string& help, const std::string& whenAbsent)
{
    const auto convert = [&target, names, range](
                             const std::string& value) { target = realOf(names, value, range); };
    custom(names, "X", convert, withRange(help, range, ": " + whenAbsent));
}

void Arguments::vector(
    const std::string& names, std::optional<Vec3d>& target, const std::string& help)
{
    const auto convert = [&target, names](const std::string& value) {
        const auto v = realsOf(names, value, 3, "x,y,z");
        target = Vec3d(v[0], v[1], v[2]);
    };
    custom(names, "X,Y,Z", convert, help);
}

void Arguments::box(const std::string& names, std::optional<Box3d>& target, const std::string& help)
{
    const auto convert = [&target, names](const std::string& value) {
        const auto v = realsOf(names, value, 6, "x0,y0,z0,x1,y1,z1");
        for (std::size_t axis = 0; axis < 3; ++axis) {
            if (v[axis] < v[axis + 3]) continue;
            failValue(names, value,
                std::string("empty along ") + "xyz"[axis]
                    + "; every lower end must be below its upper end");
        }
        target = Box3d(Vec3d(v[0], v[1], v[2]), Vec3d(v[3], v[4], v[5]));
    };
    custom(names, "X0,..,Z1", convert, help);
}

void Arguments::collect(const std::vector<std::string>& words, std::vector<std::string>& unknown)
{
    CLI::App app;
    app.set_help_flag();
    app.allow_extras();
    CLI::Option* help = app.add_flag("-h,--help");
    std::vector<CLI::Option*> parsed;
    for (const Option& option : mOptions) {
        CLI::Option* o
            = option.isFlag() ? app.add_flag(option.names) : app.add_option(option.names);
        // All occurrences are kept: too many are refused below, with a sentence of our own.
        o->multi_option_policy(CLI::MultiOptionPolicy::TakeAll);
        if (option.positional && option.many) o->allow_extra_args();
        parsed.push_back(o);
    }
    try {
        app.parse(std::vector<std::string>(words.rbegin(), words.rend()));
    } catch (const CLI::ArgumentMismatch& e) {
        const std::string what = e.what();
        failUsage(what.substr(0, what.find(':')) + ": a value must follow.");
    } catch (const CLI::ParseError& e) {
        failUsage(std::string(e.what()) + ".");
    }
    mHelpAsked = help->count() > 0;
    for (std::size_t i = 0; i < mOptions.size(); ++i) mOptions[i].values = parsed[i]->results();
    unknown = app.remaining();
}

void Arguments::failUnknown(const std::string& word) const
{
    const std::string see = "see 'lumivdb " + mCommand + " --help'.";
    if (word.size() < 2 || word[0] != '-') {
        failUsage("'" + word + "' is one argument too many; " + see);
    }
    std::vector<std::string> known{"--help"};
    for (const Option& option : mOptions) {
        if (!option.positional) known.push_back(option.longName());
    }
    const std::string name = word.substr(0, word.find('='));
    const std::string meant = didYouMean(name, known);
    failUsage("unknown option " + name + (meant.empty() ? "; " + see : meant));
}

void Arguments::convertAll()
{
    for (const Option& option : mOptions) {
        const std::string name = option.longName();
        if (option.required && option.values.empty()) {
            failUsage(name + " is missing; see 'lumivdb " + mCommand + " --help'.");
        }
        if (!option.many && !option.isFlag() && option.values.size() > 1) {
            failUsage(name + " is given " + std::to_string(option.values.size())
                + " times; give it once.");
        }
        for (const std::string& value : option.values) {
            if (option.isFlag() && value != "true") failValue(name, value, "takes no value");
            option.convert(value);
        }
    }
}

bool Arguments::parse(const std::vector<std::string>& words)
{
    std::vector<std::string> unknown;
    collect(words, unknown);
    if (mHelpAsked) return false;
    const auto isOption = [](const std::string& word) { return word.size() > 1 && word[0] == '-'; };
    const auto bad = std::find_if(unknown.begin(), unknown.end(), isOption);
    if (bad != unknown.end()) failUnknown(*bad);
    if (!unknown.empty()) failUnknown(unknown.front());
    convertAll();
    return true;
}

bool Arguments::given(const std::string& name) const
{
    for (const Option& option : mOptions) {
        if (option.longName() == name) return !option.values.empty();
    }
    return false;
}

std::string Arguments::commandLine() const
{
    std::string line = "lumivdb " + mCommand;
    for (const Option& option : mOptions) {
        if (option.neutral) continue;
        for (const std::string& value : option.values) {
            if (!option.positional) line += " " + option.longName();
            if (!option.isFlag()) line += " " + quoted(value);
        }
    }
    return line;
}

std::string Arguments::usageLine() const
{
    std::string line = "Usage: lumivdb " + mCommand;
    for (const Option& option : mOptions) {
        if (!option.positional) continue;
        const std::string name = option.names + (option.many ? " ..." : "");
        line += option.required ? " " + name : " [" + name + "]";
    }
    for (const Option& option : mOptions) {
        if (option.positional || !option.required) continue;
        line += " " + option.names.substr(0, option.names.find(',')) + " " + option.valueName;
    }
    return line + " [options]\n";
}

std::string Arguments::helpOf(const Option& option) const
{
    std::string left = "  ";
    for (const std::string_view name : split(option.names, ',')) {
        if (left.size() > 2) left += ", ";
        left += name;
    }
    if (!option.valueName.empty()) left += " " + option.valueName;
    const std::string right = option.help + (option.required ? " (required)" : "");
    left += left.size() + 2 > kHelpColumn ? "\n" + std::string(kHelpColumn, ' ')
                                          : std::string(kHelpColumn - left.size(), ' ');
    return left + wrapped(right, kHelpColumn) + "\n";
}

std::string Arguments::help() const
{
    std::string out = wrapped(mSummary, 0) + "\n\n" + usageLine();
    for (const std::string& paragraph : mParagraphs) out += "\n" + wrapped(paragraph, 0) + "\n";
    std::string heading;
    for (const Option& option : mOptions) {
        const std::string wanted = option.positional ? "Arguments" : option.section;
        if (wanted != heading) out += "\n" + wanted + ":\n";
        heading = wanted;
        out += helpOf(option);
    }
    out += "  -h, --help" + std::string(kHelpColumn - 12, ' ') + "this text\n";
    if (!mExamples.empty()) out += "\nExamples:\n";
    for (const auto& [line, what] : mExamples) {
        out += "  " + line + "\n      " + wrapped(what, 6) + "\n";
    }
    return out;
}

} // namespace lumivdb::cli
