// SPDX-License-Identifier: Apache-2.0
/// The program: finds the sub-command, runs it, turns errors into sentences and exit codes.

#include "common.h"
#include "interrupt.h"
#include "numbers.h"
#include "output.h"
#include "suggest.h"

#include <cstdio>
#include <exception>
#include <new>

namespace lumivdb::cli {

namespace {

constexpr CommandEntry kCommands[] = {
    {"bake", "Bakes the light of a scene into a volume.", makeBakeCommand},
    {"probe", "Traces the light at given points of a scene, without a volume.", makeProbeCommand},
    {"query", "Prints the light that a volume holds at given points.", makeQueryCommand},
    {"stats", "Prints what is in a volume file.", makeStatsCommand},
    {"evaluate", "Measures the error of a volume against an independent trace.",
        makeEvaluateCommand},
    {"project", "Prints SH coefficients or shader constants of an environment image.",
        makeProjectCommand},
    {"resample", "Makes volumes from volumes: spacing, bands, crop, axes, sums, joins.",
        makeResampleCommand},
    {"lpv", "Previews a scene's indirect light by light propagation.", makeLpvCommand},
    {"render", "Writes a picture of a scene lit by a volume, or a slice of the volume.",
        makeRenderCommand},
    {"bench", "Measures speed against error over scenes and settings.", makeBenchCommand},
};

std::string programHelp()
{
    std::string out = "LumiVDB bakes the light of a static scene into an irradiance volume: an "
                      "OpenVDB file that\n"
                      "answers what light arrives at any point, from any side.\n\n"
                      "Usage: lumivdb COMMAND [options]\n\nCommands:\n";
    for (const CommandEntry& entry : kCommands) {
        const std::string name = entry.name;
        out += "  " + name + std::string(11 - name.size(), ' ') + entry.summary + "\n";
    }
    return out
        + "\nOptions:\n"
          "  -h, --help  this text; 'lumivdb COMMAND --help' explains a command\n"
          "  --version   the program's version\n\n"
          "A first round:\n"
          "  lumivdb bake room.glb -o room.vdb               bake a scene\n"
          "  lumivdb stats room.vdb                          see what came out\n"
          "  lumivdb evaluate room.vdb --scene room.glb      measure its error\n"
          "  lumivdb render room.glb --volume room.vdb -o room.png\n"
          "  echo 0,1,0,0,1,0 | lumivdb query room.vdb --points -\n\n"
          "Data goes to standard output, talk to standard error. Exit codes: 0 done, 1 a bound "
          "was\n"
          "not met, 2 usage, 3 bad input, 4 output cannot be written, 130 interrupted.\n";
}

const CommandEntry& findCommand(const std::string& name)
{
    std::vector<std::string> names;
    for (const CommandEntry& entry : kCommands) {
        if (name == entry.name) return entry;
        names.emplace_back(entry.name);
    }
    const std::string meant = didYouMean(name, names);
    const std::string kind = name[0] == '-' ? "unknown option " : "unknown command ";
    failUsage(kind + name + (meant.empty() ? "; see 'lumivdb --help'." : meant));
}

void runCommand(const CommandEntry& entry, const std::vector<std::string>& words)
{
    Arguments arguments(entry.name, entry.summary);
    const std::unique_ptr<Command> command = entry.make();
    command->declare(arguments);
    if (arguments.parse(words)) {
        command->run(arguments);
    } else {
        writeStdout(arguments.help());
    }
}

/// @return the exit code. Errors are thrown.
int runProgram(std::vector<std::string> words)
{
    if (words.empty()) {
        std::fputs(programHelp().c_str(), stderr);
        return static_cast<int>(ErrorCode::Usage);
    }
    if (words[0] == "help" && words.size() > 1) words = {words[1], "--help"};
    if (words[0] == "--help" || words[0] == "-h" || words[0] == "help") {
        writeStdout(programHelp());
    } else if (words[0] == "--version") {
        writeStdout("lumivdb " LUMIVDB_VERSION "\n");
    } else {
        runCommand(findCommand(words[0]), {words.begin() + 1, words.end()});
    }
    return 0;
}

int fail(ErrorCode code, const std::string& sentence)
{
    // Numbers and quotes are as they were; only the line is made one.
    std::string line = sentence;
    for (char& c : line) {
        if (c == '\n' || c == '\r') c = ' ';
    }
    std::fprintf(stderr, "lumivdb: %s\n", line.c_str());
    return static_cast<int>(code);
}

int guarded(const std::vector<std::string>& words)
{
    try {
        return runProgram(words);
    } catch (const StdoutClosed&) {
        return 0; // the reader has what it wanted
    } catch (const Error& e) {
        return fail(e.code(), e.what());
    } catch (const std::bad_alloc&) {
        return fail(ErrorCode::Input,
            "out of memory; use a larger --spacing, fewer --bands or smaller --bounds.");
    } catch (const std::exception& e) {
        if (interrupted()) return fail(ErrorCode::Interrupted, "Interrupted: nothing was written.");
        return fail(ErrorCode::Input,
            std::string("failed unexpectedly (") + e.what() + "); check the input files.");
    }
}

} // namespace

} // namespace lumivdb::cli

int main(int argc, char** argv)
{
    lumivdb::cli::occupyStandardStreams();
    lumivdb::cli::installSignalHandlers();
    return lumivdb::cli::guarded(std::vector<std::string>(argv + (argc > 0 ? 1 : 0), argv + argc));
}
