// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file arguments.h
/// What a sub-command takes: declared once, and from that come parsing (by CLI11), strict
/// conversion with ranges, "did you mean", the help text and the command line that reproduces a
/// run.
///
/// Every member that declares an option takes its names ("-o,--output"), the variable to fill,
/// which holds the default, and its help. A variable is changed only if its option is given.

#include <lumivdb/core/types.h>

#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace lumivdb::cli {

/// Values that a number may take. Both ends are allowed unless @a aboveLow.
struct Range {
    double low = -std::numeric_limits<double>::max();
    double high = std::numeric_limits<double>::max();
    bool aboveLow = false; ///< low itself is not allowed
    bool contains(double value) const;
    std::string text() const; ///< "1 to 6", "greater than 0"
};
Range between(double low, double high);
Range atLeast(double low);
Range greaterThan(double low);

class Arguments {
public:
    using Convert = std::function<void(const std::string&)>;

    Arguments(std::string command, std::string summary);

    /// Options declared from now on stand below this heading in the help.
    void section(const std::string& title);

    void positional(const std::string& name, std::string& target, const std::string& help);
    void positionals(
        const std::string& name, std::vector<std::string>& target, const std::string& help);
    void flag(const std::string& names, bool& target, const std::string& help);
    void text(const std::string& names, const std::string& valueName, std::string& target,
        const std::string& help);
    void integer(
        const std::string& names, int& target, const Range& range, const std::string& help);
    void size(
        const std::string& names, std::size_t& target, const Range& range, const std::string& help);
    /// Any 64-bit number.
    void seed(const std::string& names, std::uint64_t& target, const std::string& help);
    void real(
        const std::string& names, double& target, const Range& range, const std::string& help);
    /// @a whenAbsent says what happens when it is not given.
    void real(const std::string& names, std::optional<double>& target, const Range& range,
        const std::string& help, const std::string& whenAbsent);
    void vector(const std::string& names, std::optional<Vec3d>& target, const std::string& help);
    /// "x0,y0,z0,x1,y1,z1" with every lower end below its upper end.
    void box(const std::string& names, std::optional<Box3d>& target, const std::string& help);
    /// One of a few words. The help lists them; the default is the one that @a target holds.
    template <class T>
    void choice(const std::string& names, T& target,
        const std::vector<std::pair<std::string, T>>& words, const std::string& help);
    /// Anything else: @a convert throws Error(Usage), usually by failValue().
    void custom(const std::string& names, const std::string& valueName, Convert convert,
        const std::string& help);
    /// The same for options that may be given more than once.
    void repeated(const std::string& names, const std::string& valueName, Convert convert,
        const std::string& help);

    /// The option declared last has to be given.
    void require();
    /// The option declared last does not influence what is computed: not in commandLine().
    void neutral();
    /// A line of the examples that close the help.
    void example(const std::string& commandLine, const std::string& what);
    /// A paragraph between summary and options.
    void describe(const std::string& paragraph);

    /// Reads the words after the command's name and fills the targets.
    /// @return false when help was asked for: nothing was filled.
    /// @throws Error(Usage).
    bool parse(const std::vector<std::string>& words);

    bool given(const std::string& name) const;
    const std::string& command() const { return mCommand; }
    std::string help() const;
    /// "lumivdb COMMAND …" with what was given, in the order of declaration, quoted for a shell.
    std::string commandLine() const;

private:
    struct Option {
        std::string names; // "-o,--output", or the name of a positional
        std::string valueName; // empty: flag
        std::string help;
        std::string section;
        Convert convert;
        bool positional = false;
        bool many = false;
        bool required = false;
        bool neutral = false;
        std::vector<std::string> values; // as given
        bool isFlag() const { return valueName.empty() && !positional; }
        std::string longName() const;
    };
    void add(Option option);
    void collect(const std::vector<std::string>& words, std::vector<std::string>& unknown);
    [[noreturn]] void failUnknown(const std::string& word) const;
    void convertAll();
    std::string usageLine() const;
    std::string helpOf(const Option& option) const;

    std::string mCommand;
    std::string mSummary;
    std::string mSection = "Options";
    std::vector<std::string> mParagraphs;
    std::vector<Option> mOptions;
    std::vector<std::pair<std::string, std::string>> mExamples;
    bool mHelpAsked = false;
};

/// @throws Error(Usage): "NAME VALUE: WHY."
[[noreturn]] void failValue(
    const std::string& names, const std::string& value, const std::string& why);
/// @throws Error(Usage).
[[noreturn]] void failUsage(const std::string& sentence);
/// @a text broken into lines of at most @a width characters, each beginning with @a indent blanks
/// (the first one without).
std::string wrapped(const std::string& text, std::size_t indent, std::size_t width = 80);

template <class T>
void Arguments::choice(const std::string& names, T& target,
    const std::vector<std::pair<std::string, T>>& words, const std::string& help)
{
    std::string list, current;
    for (const auto& [word, value] : words) {
        list += (list.empty() ? "" : "|") + word;
        if (value == target) current = word;
    }
    const auto convert = [&target, words, list, names](const std::string& given) {
        for (const auto& [word, value] : words) {
            if (word == given) {
                target = value;
                return;
            }
        }
        failValue(names, given, "not one of " + list);
    };
    custom(names, list, convert, help + (current.empty() ? "" : " [default " + current + "]"));
}

} // namespace lumivdb::cli
