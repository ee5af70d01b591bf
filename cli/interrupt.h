// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file interrupt.h
/// What the system does to the program from outside: signals and missing standard streams.

namespace lumivdb::cli {

/// From now on the first SIGINT, SIGTERM or SIGHUP only sets the flag that interrupted() returns,
/// and the second ends the program at once with exit code 130. A closed pipe and a file size limit
/// become write errors instead of killing the program.
void installSignalHandlers();

/// Occupies the file descriptors 0 to 2 where the caller closed them (`>&-`), so that no file of
/// ours gets such a number; reading and writing still fail.
void occupyStandardStreams();

/// Whether the user asked to stop.
bool interrupted();

/// @throws Error(Interrupted) once the user asked to stop.
void throwIfInterrupted();

} // namespace lumivdb::cli
