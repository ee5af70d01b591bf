// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file error.h
/// The one exception type of the library. The library never prints and never exits: it throws an
/// Error whose message is one sentence naming the file (or option), the thing, and what to do.

#include <stdexcept>
#include <string>

namespace lumivdb {

/// What went wrong. The command line maps the value to its exit code of the same number.
enum class ErrorCode {
    BoundNotMet = 1, ///< a comparison or an error bound did not hold
    Usage = 2, ///< an argument is out of range or contradicts another
    Input = 3, ///< an input file is missing, unreadable or unusable
    Output = 4, ///< an output cannot be written
    Interrupted = 130 ///< the caller asked to stop through Progress::cancelled()
};

class Error : public std::runtime_error {
public:
    Error(ErrorCode code, const std::string& sentence)
        : std::runtime_error(sentence)
        , mCode(code)
    {
    }
    ErrorCode code() const { return mCode; }

private:
    ErrorCode mCode;
};

} // namespace lumivdb
