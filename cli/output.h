// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file output.h
/// Where data goes: standard output, or files that are either whole or absent.

#include <string>
#include <vector>

namespace lumivdb::cli {

/// Thrown when the reader of standard output has gone (`| head`): not an error, the program ends.
struct StdoutClosed { };

/// Writes @a text to standard output. @throws StdoutClosed; Error(Output) when it cannot be
/// written.
void writeStdout(const std::string& text);

/// Writes a whole file atomically (temporary file, fsync, rename); "-" is standard output. Devices
/// and pipes are written directly. @throws Error(Output).
void writeText(const std::string& path, const std::string& text);

/// Whether a file could be written at @a path, asked before long work. @a option names it in the
/// message. @throws Error(Output) naming the folder or file and why not.
void checkWritable(const std::string& path, const std::string& option);

/// checkWritable() for files that replace what stands at @a path: "-", devices and pipes are
/// refused. @throws Error(Usage), Error(Output).
void checkReplaceable(const std::string& path, const std::string& option);

/// Keeps an output from destroying what the same command reads or writes elsewhere. @a option names
/// the output in the message. @throws Error(Usage) when @a path is one of @a files.
void checkIsNoneOf(
    const std::string& path, const std::string& option, const std::vector<std::string>& files);

/// The whole content of @a path, "-" being standard input. @throws Error(Input).
std::string readText(const std::string& path);

/// Refuses folders, devices and pipes, which image readers would wait for without end; what is
/// missing is left to the reader. @throws Error(Input).
void requireFile(const std::string& path);

/// Size of a file in bytes, 0 where there is none.
unsigned long long fileBytes(const std::string& path);

} // namespace lumivdb::cli
