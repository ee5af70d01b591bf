// SPDX-License-Identifier: Apache-2.0
#include "gnuplot.h"

#include "arguments.h"
#include "interrupt.h"
#include "numbers.h"
#include "output.h"

#include <lumivdb/core/error.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

extern char** environ;

namespace lumivdb::cli {

namespace {

namespace fs = std::filesystem;

/// A folder for the files that gnuplot reads and writes, gone afterwards.
class TemporaryFolder {
public:
    TemporaryFolder()
    {
        std::error_code failed;
        mPath = (fs::temp_directory_path(failed) / "lumivdb_plot_XXXXXX").string();
        if (failed || !::mkdtemp(mPath.data()))
            throw Error(ErrorCode::Output,
                "Cannot make a temporary folder for the plot ('" + mPath
                    + "'); set TMPDIR to a folder that can be written.");
    }
    ~TemporaryFolder()
    {
        std::error_code ignored;
        fs::remove_all(mPath, ignored);
    }
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;
    std::string file(const char* name) const { return (fs::path(mPath) / name).string(); }

private:
    std::string mPath;
};

std::string extensionOf(const std::string& path)
{
    std::string extension = fs::path(path).extension().string();
    for (char& c : extension)
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    return extension;
}

bool hasGnuplot()
{
    const char* path = std::getenv("PATH");
    for (const std::string_view folder : split(path ? path : "", ':')) {
        const std::string program = (folder.empty() ? "." : std::string(folder)) + "/gnuplot";
        if (::access(program.c_str(), X_OK) == 0) return true;
    }
    return false;
}

[[noreturn]] void failGnuplot(const std::string& path, const std::string& why)
{
    throw Error(ErrorCode::Output, "Cannot plot '" + path + "': " + why + ".");
}

/// @return gnuplot's exit code, −1 if a signal ended it.
int runGnuplot(const std::string& in, const std::string& out, const std::string& errors)
{
    posix_spawn_file_actions_t files;
    posix_spawn_file_actions_init(&files);
    posix_spawn_file_actions_addopen(&files, STDIN_FILENO, in.c_str(), O_RDONLY, 0);
    const int create = O_WRONLY | O_CREAT | O_TRUNC;
    posix_spawn_file_actions_addopen(&files, STDOUT_FILENO, out.c_str(), create, 0600);
    posix_spawn_file_actions_addopen(&files, STDERR_FILENO, errors.c_str(), create, 0600);
    char name[] = "gnuplot";
    char* arguments[] = {name, nullptr};
    pid_t child = 0;
    const int failed = ::posix_spawnp(&child, name, &files, nullptr, arguments, environ);
    posix_spawn_file_actions_destroy(&files);
    if (failed) failGnuplot(out, std::string("gnuplot does not start: ") + std::strerror(failed));
    int status = 0;
    while (::waitpid(child, &status, 0) < 0 && errno == EINTR) { }
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

} // namespace

void checkPlot(const std::string& path, const std::string& option)
{
    const std::string extension = extensionOf(path);
    if (extension != ".png" && extension != ".svg")
        failValue(option, path, "not a name that ends in .png or .svg");
    checkReplaceable(path, option);
    if (!hasGnuplot())
        throw Error(ErrorCode::Output,
            "Cannot plot '" + path + "' (" + option
                + "): the program gnuplot is not there; install it (Debian: gnuplot-nox), or leave "
                  "the plot out.");
}

void plot(const std::string& path, const std::string& script, int width, int height)
{
    const TemporaryFolder folder;
    const bool png = extensionOf(path) == ".png";
    const std::string size = std::to_string(width) + "," + std::to_string(height);
    const std::string terminal = png ? "set terminal pngcairo noenhanced font 'sans,10' size "
                                     : "set terminal svg noenhanced font 'sans,10' size ";
    const std::string in = folder.file("script"), out = folder.file("picture"),
                      errors = folder.file("errors");
    writeText(in, "set encoding utf8\n" + terminal + size + "\n" + script);
    const int code = runGnuplot(in, out, errors);
    throwIfInterrupted();
    if (code != 0 || fileBytes(out) == 0) {
        std::string said(trimmed(readText(errors)));
        if (said.size() > 300) said.resize(300);
        failGnuplot(path, "gnuplot ended with code " + std::to_string(code) + ": " + said);
    }
    writeText(path, readText(out));
}

std::string plotText(const std::string& text)
{
    // In single quotes nothing is replaced but '' by '.
    std::string result = "'";
    for (const char c : text) {
        const auto byte = static_cast<unsigned char>(c);
        result += byte < 0x20 || byte == 0x7f ? "?" : c == '\'' ? "''" : std::string(1, c);
    }
    return result + "'";
}

} // namespace lumivdb::cli
