// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file progress.h
/// How long work reports where it is and learns that it should stop.

#include <cstdint>
#include <string>

namespace lumivdb {

/// Passed by reference to every long operation. The default does nothing and never cancels.
/// begin() is called from one thread; the others from any thread at any time.
class Progress {
public:
    virtual ~Progress() = default;
    /// A stage starts: @a stage is a short verb phrase ("trace samples"), @a total its steps.
    virtual void begin(const char* /*stage*/, std::uint64_t /*total*/) { }
    /// @a steps more steps of the current stage are done.
    virtual void advance(std::uint64_t /*steps*/) { }
    /// Stages may be parts of a larger work, of which this much is thought to be left, in seconds
    /// from now. Said again whenever more is known; infinity: it is no longer known.
    virtual void expect(double /*seconds*/) { }
    /// Whether anybody looks at expect(), so that a small part of the time is well spent on it.
    virtual bool wantsForecast() { return false; }
    /// Something that does not end the work, but that the user should hear of before it ends.
    virtual void warn(const std::string& /*sentence*/) { }
    /// True once the user wants to stop; the operation then throws Error(Interrupted) soon and
    /// leaves nothing half-written.
    virtual bool cancelled() { return false; }
};

} // namespace lumivdb
