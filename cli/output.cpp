// SPDX-License-Identifier: Apache-2.0
#include "output.h"

#include "interrupt.h"

#include <lumivdb/core/error.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

namespace lumivdb::cli {

namespace {

namespace fs = std::filesystem;

/// Closes a file descriptor when it goes out of scope.
class Descriptor {
public:
    explicit Descriptor(int fd)
        : mFd(fd)
    {
    }
    ~Descriptor()
    {
        if (mFd >= 0) ::close(mFd);
    }
    Descriptor(const Descriptor&) = delete;
    Descriptor& operator=(const Descriptor&) = delete;
    int get() const { return mFd; }

private:
    int mFd;
};

/// errno of the first failed write, 0 when all went out. An interrupt ends it with EINTR.
int writeAll(int fd, const std::string& text)
{
    std::size_t done = 0;
    while (done < text.size()) {
        const ssize_t n = ::write(fd, text.data() + done, text.size() - done);
        if (n >= 0) {
            done += static_cast<std::size_t>(n);
        } else if (errno != EINTR || interrupted()) {
            return errno;
        }
    }
    return 0;
}

[[noreturn]] void failOutput(const std::string& path, const std::string& why)
{
    throw Error(ErrorCode::Output,
        "Cannot write '" + path + "': " + why + "; make room or choose another place.");
}

[[noreturn]] void failInput(const std::string& path, const std::string& why)
{
    throw Error(ErrorCode::Input, "Cannot read '" + path + "': " + why + "; check the path.");
}

fs::path folderOf(const std::string& path)
{
    const fs::path folder = fs::path(path).parent_path();
    return folder.empty() ? fs::path(".") : folder;
}

bool isSpecial(const std::string& path)
{
    std::error_code ignored;
    const auto status = fs::status(path, ignored);
    return fs::exists(status) && !fs::is_regular_file(status) && !fs::is_directory(status);
}

void writeDirectly(const std::string& path, const std::string& text)
{
    const Descriptor file(::open(path.c_str(), O_WRONLY | O_CLOEXEC));
    const int failed = file.get() < 0 ? errno : writeAll(file.get(), text);
    if (failed) failOutput(path, std::strerror(failed));
}

/// The file behind a symbolic link, so that the link is kept and its target replaced.
std::string resolved(const std::string& path)
{
    std::error_code failed;
    const fs::path target
        = fs::is_symlink(path, failed) ? fs::weakly_canonical(path, failed) : fs::path(path);
    return failed ? path : target.string();
}

void writeAtomically(const std::string& path, const std::string& text)
{
    std::string temporary = path + ".XXXXXX";
    int failed = 0;
    {
        const Descriptor file(::mkstemp(temporary.data()));
        if (file.get() < 0) failOutput(path, std::strerror(errno));
        const mode_t mask = ::umask(0);
        ::umask(mask);
        ::fchmod(file.get(), 0666 & ~mask);
        failed = writeAll(file.get(), text);
        if (!failed && ::fsync(file.get()) != 0) failed = errno;
    }
    if (!failed && ::rename(temporary.c_str(), path.c_str()) != 0) failed = errno;
    if (!failed) return;
    ::unlink(temporary.c_str());
    throwIfInterrupted();
    failOutput(path, std::strerror(failed));
}

} // namespace

void writeStdout(const std::string& text)
{
    const int failed = writeAll(STDOUT_FILENO, text);
    if (failed == EPIPE) throw StdoutClosed();
    if (failed == EINTR) throwIfInterrupted();
    if (failed) failOutput("standard output", std::strerror(failed));
}

void writeText(const std::string& path, const std::string& text)
{
    if (path == "-") {
        writeStdout(text);
    } else if (isSpecial(path)) {
        writeDirectly(path, text);
    } else {
        writeAtomically(resolved(path), text);
    }
}

void checkWritable(const std::string& path, const std::string& option)
{
    if (path == "-") return;
    const auto fail = [&](const std::string& why) {
        throw Error(
            ErrorCode::Output, "Cannot write '" + path + "' (" + option + "): " + why + ".");
    };
    std::error_code failed;
    if (path.empty()) fail("the name is empty; give a file name");
    struct stat there { };
    if (::lstat(path.c_str(), &there) != 0 && errno == ENAMETOOLONG) fail(std::strerror(errno));
    if (fs::is_directory(path, failed)) fail("it is a folder; give a file name in it");
    if (isSpecial(path)) {
        if (::access(path.c_str(), W_OK) != 0) fail(std::strerror(errno));
        return;
    }
    const std::string folder = folderOf(resolved(path)).string();
    const std::string named = "the folder '" + folder + "' ";
    if (!fs::exists(folder, failed)) fail(named + "does not exist; create it first");
    if (!fs::is_directory(folder, failed)) fail("'" + folder + "' is not a folder");
    if (::access(folder.c_str(), W_OK | X_OK) != 0) {
        fail(named + "cannot be written to (" + std::strerror(errno) + "); choose another");
    }
}

void checkReplaceable(const std::string& path, const std::string& option)
{
    if (path == "-") {
        throw Error(ErrorCode::Usage, option + " -: only a file can be written; give a file name.");
    }
    if (isSpecial(path)) {
        throw Error(ErrorCode::Output,
            "Cannot write '" + path + "' (" + option
                + "): it is a device or pipe; give a file name.");
    }
    checkWritable(path, option);
}

void checkIsNoneOf(
    const std::string& path, const std::string& option, const std::vector<std::string>& files)
{
    if (path.empty() || path == "-" || isSpecial(path)) return;
    std::error_code ignored;
    for (const std::string& file : files) {
        if (file.empty() || file == "-") continue;
        const bool same = fs::weakly_canonical(path, ignored) == fs::weakly_canonical(file, ignored)
            || fs::equivalent(path, file, ignored);
        if (!same) continue;
        throw Error(ErrorCode::Usage,
            option + " '" + path + "': another file of this command has that name, and would be "
                + "overwritten; choose another name.");
    }
}

std::string readText(const std::string& path)
{
    const bool standard = path == "-";
    const std::string named = standard ? "standard input" : path;
    const Descriptor file(
        standard ? ::dup(STDIN_FILENO) : ::open(path.c_str(), O_RDONLY | O_CLOEXEC));
    if (file.get() < 0) failInput(named, std::strerror(errno));
    std::string text;
    std::string buffer(1 << 16, '\0');
    for (;;) {
        const ssize_t n = ::read(file.get(), buffer.data(), buffer.size());
        if (n == 0) return text;
        if (n > 0) {
            text.append(buffer, 0, static_cast<std::size_t>(n));
        } else if (errno == EINTR) {
            throwIfInterrupted();
        } else {
            failInput(named, std::strerror(errno));
        }
    }
}

void requireFile(const std::string& path)
{
    std::error_code ignored;
    const auto status = fs::status(path, ignored);
    if (fs::exists(status) && !fs::is_regular_file(status)) failInput(path, "it is not a file");
}

unsigned long long fileBytes(const std::string& path)
{
    std::error_code failed;
    const auto bytes = fs::file_size(path, failed);
    return failed ? 0 : bytes;
}

} // namespace lumivdb::cli
