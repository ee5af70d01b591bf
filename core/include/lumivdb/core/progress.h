// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file progress.h
/// How long work reports where it is and learns that it should stop.

#include <cstdint>

namespace lumivdb {

/// Passed by reference to every long operation. The default does nothing and never cancels.
/// begin() is called from one thread; advance() and cancelled() from any thread at any time.
class Progress {
public:
    virtual ~Progress() = default;
    /// A stage starts: @a stage is a short verb phrase ("trace samples"), @a total its steps.
    virtual void begin(const char* /*stage*/, std::uint64_t /*total*/) { }
    /// @a steps more steps of the current stage are done.
    virtual void advance(std::uint64_t /*steps*/) { }
    /// True once the user wants to stop; the operation then throws Error(Interrupted) soon and
    /// leaves nothing half-written.
    virtual bool cancelled() { return false; }
};

} // namespace lumivdb
