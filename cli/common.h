// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file common.h
/// What all sub-commands share: the talk to the user, the options every one has, names of
/// enumerations, small pieces of JSON.

#include "arguments.h"
#include "progress_bar.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/sampler.h>
#include <lumivdb/core/volume.h>

#include <nlohmann/json_fwd.hpp>
#include <tbb/global_control.h>

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace lumivdb::cli {

using Json = nlohmann::ordered_json;

/// A sub-command: declare() is called once, then run() if no help was asked for. Errors are thrown.
class Command {
public:
    virtual ~Command() = default;
    virtual void declare(Arguments& arguments) = 0;
    virtual void run(const Arguments& arguments) = 0;
};

/// A row of the table of commands in main.cpp.
struct CommandEntry {
    const char* name;
    const char* summary;
    std::unique_ptr<Command> (*make)();
};

/// Talk to stderr. Warnings are said once each and kept for the report.
class Console {
public:
    void setQuiet(bool quiet) { mQuiet = quiet; }
    void note(const std::string& sentence) const;
    void warn(const std::string& sentence);
    void warn(const std::vector<std::string>& sentences);
    const std::vector<std::string>& warnings() const { return mWarnings; }
    ProgressStyle progressStyle() const;

private:
    bool mQuiet = false;
    std::vector<std::string> mWarnings;
};

/// --threads, --json, --quiet.
class CommonOptions {
public:
    void declareThreads(Arguments& arguments);
    void declareJson(Arguments& arguments, const std::string& help);
    void declareQuiet(Arguments& arguments);
    /// Applies them: limits TBB to --threads, checks that --json can be written and is none of
    /// @a files, which the command reads or writes.
    void apply(const std::vector<std::string>& files = {});
    bool jsonToStdout() const { return json == "-"; }
    /// Writes @a report to --json, if it was given. NaN and infinity become null.
    void writeJson(const Json& report) const;

    Console console;
    std::string json;
    int threads = 0; ///< 0: all cores

private:
    bool mQuiet = false;
    std::unique_ptr<tbb::global_control> mLimit;
};

/// Seconds since construction or the last restart().
class Stopwatch {
public:
    double seconds() const;
    double restart(); ///< seconds(), then from zero

private:
    std::chrono::steady_clock::time_point mStart = std::chrono::steady_clock::now();
};

/// "--mode": nearest, taylor, …; nothing stands for what @a whenAbsent says.
void declareMode(Arguments& arguments, std::optional<Interpolation>& mode,
    const std::string& whenAbsent = "gradient where the volume has gradients, else trilinear");
/// The mode asked for, or the best one. @throws Error(Usage) when it needs gradients that
/// @a volume (named @a path) has not.
Interpolation modeFor(const std::optional<Interpolation>& mode, const IrradianceVolume& volume,
    const std::string& path);

Json jsonOf(const Vec3d& v);
Json jsonOf(const Box3d& box); ///< [x0,y0,z0,x1,y1,z1], null when empty
Json jsonOf(const Color& c); ///< shortest decimals
/// Indented text with a line break at the end.
std::string jsonText(const Json& json);

/// A table of two columns, name and value, for stdout.
std::string table(const std::vector<std::pair<std::string, std::string>>& rows);

/// A copy of @a volume in the Y-up frame of scenes, if it is not; nothing otherwise.
std::optional<IrradianceVolume> broughtYUp(const IrradianceVolume& volume);

std::unique_ptr<Command> makeBakeCommand();
std::unique_ptr<Command> makeProbeCommand();
std::unique_ptr<Command> makeQueryCommand();
std::unique_ptr<Command> makeStatsCommand();
std::unique_ptr<Command> makeEvaluateCommand();
std::unique_ptr<Command> makeProjectCommand();
std::unique_ptr<Command> makeResampleCommand();
std::unique_ptr<Command> makeLpvCommand();
std::unique_ptr<Command> makeRenderCommand();
std::unique_ptr<Command> makeBenchCommand();

} // namespace lumivdb::cli
