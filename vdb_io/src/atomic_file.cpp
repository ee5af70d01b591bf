// SPDX-License-Identifier: Apache-2.0
#include "atomic_file.h"

#include <lumivdb/core/error.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <random>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

namespace lumivdb {

namespace fs = std::filesystem;

namespace {

/// Where @a path leads after following symbolic links, also one whose target does not exist yet.
fs::path followLinks(const std::string& name)
{
    fs::path path = name;
    std::error_code ec;
    for (int hops = 0; hops < 40; ++hops) {
        if (!fs::is_symlink(fs::symlink_status(path, ec))) return path;
        const fs::path to = fs::read_symlink(path, ec);
        path = to.is_absolute() ? to : path.parent_path() / to;
    }
    throw Error(ErrorCode::Output,
        "Cannot write '" + name + "': its symbolic links go in circles; name a file instead.");
}

std::string temporaryName(const std::string& folder)
{
    std::random_device random;
    char suffix[24];
    std::snprintf(suffix, sizeof suffix, "%08x%08x", random(), random());
    return folder + "/.lumivdb-" + suffix + ".tmp";
}

void syncFolder(const std::string& folder)
{
    const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) return;
    ::fsync(fd); // some file systems refuse this for folders: the rename is done all the same
    ::close(fd);
}

} // namespace

AtomicFile::AtomicFile(const std::string& path)
    : mPath(path)
{
    if (path.empty()) throw Error(ErrorCode::Output, "Output file has an empty name: give a path.");
    const fs::path target = followLinks(path);
    mTarget = target.string();
    mFolder = target.has_parent_path() ? target.parent_path().string() : std::string(".");
    struct stat old { };
    const bool exists = ::stat(mTarget.c_str(), &old) == 0;
    if (exists && !S_ISREG(old.st_mode)) {
        throw Error(ErrorCode::Output,
            "Cannot write '" + path + "': it is a folder or a device; name a file instead.");
    }
    // An unnamed file gets its name through /proc, which a bare chroot may lack.
    if (::access("/proc/self/fd", X_OK) == 0)
        mFd = ::open(mFolder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0666);
    if (mFd < 0) {
        mTemporary = temporaryName(mFolder);
        mFd = ::open(mTemporary.c_str(), O_CREAT | O_EXCL | O_RDWR | O_CLOEXEC, 0666);
        if (mFd < 0) {
            mTemporary.clear();
            fail("check that its folder exists and can be written");
        }
    }
    if (exists) static_cast<void>(::fchmod(mFd, old.st_mode & 0777));
}

AtomicFile::~AtomicFile()
{
    if (mFd >= 0) ::close(mFd);
    if (!mTemporary.empty()) ::unlink(mTemporary.c_str());
}

void AtomicFile::fail(const char* what) const
{
    const int error = errno;
    throw Error(ErrorCode::Output,
        "Cannot write '" + mPath + "': " + std::strerror(error) + "; " + what + ".");
}

void AtomicFile::writeAt(std::uint64_t offset, const void* data, std::size_t size)
{
    const auto* p = static_cast<const char*>(data);
    while (size > 0) {
        const ssize_t n = ::pwrite(mFd, p, size, static_cast<off_t>(offset));
        if (n < 0 && errno == EINTR) continue;
        if (n == 0) errno = ENOSPC;
        if (n <= 0) fail("free space there or choose another place; nothing was changed");
        p += n;
        offset += static_cast<std::uint64_t>(n);
        size -= static_cast<std::size_t>(n);
    }
}

void AtomicFile::readAt(std::uint64_t offset, void* data, std::size_t size) const
{
    auto* p = static_cast<char*>(data);
    while (size > 0) {
        const ssize_t n = ::pread(mFd, p, size, static_cast<off_t>(offset));
        if (n < 0 && errno == EINTR) continue;
        if (n == 0) errno = EIO;
        if (n <= 0) fail("reading back what was written failed, check the disk");
        p += n;
        offset += static_cast<std::uint64_t>(n);
        size -= static_cast<std::size_t>(n);
    }
}

void AtomicFile::nameUnnamed()
{
    // linkat() cannot replace a file, so the name is a temporary one for the moment until rename().
    const std::string name = temporaryName(mFolder);
    const std::string self = "/proc/self/fd/" + std::to_string(mFd);
    if (::linkat(AT_FDCWD, self.c_str(), AT_FDCWD, name.c_str(), AT_SYMLINK_FOLLOW) != 0)
        fail("the folder refused the finished file");
    mTemporary = name;
}

void AtomicFile::commit()
{
    if (::fsync(mFd) != 0) fail("flushing it to the disk failed; nothing was changed");
    if (mTemporary.empty()) nameUnnamed();
    if (::rename(mTemporary.c_str(), mTarget.c_str()) != 0)
        fail("the finished file could not take its name; nothing was changed");
    mTemporary.clear();
    const int fd = mFd;
    mFd = -1;
    ::close(fd);
    syncFolder(mFolder);
}

AtomicFileBuffer::AtomicFileBuffer(AtomicFile& file, Progress* progress)
    : mFile(file)
    , mProgress(progress)
    , mBuffer(std::size_t{1} << 20)
{
    setp(mBuffer.data(), mBuffer.data() + mBuffer.size());
}

void AtomicFileBuffer::write(const char* data, std::size_t size)
{
    if (size == 0) return;
    if (mProgress && mProgress->cancelled())
        throw Error(
            ErrorCode::Interrupted, "Interrupted while writing; the old file is untouched.");
    mFile.writeAt(mPosition, data, size);
    if (mHashing) mHash.update(data, size);
    mPosition += size;
    mEnd = std::max(mEnd, mPosition);
}

void AtomicFileBuffer::flush()
{
    const auto size = static_cast<std::size_t>(pptr() - pbase());
    setp(mBuffer.data(), mBuffer.data() + mBuffer.size());
    write(mBuffer.data(), size);
}

AtomicFileBuffer::int_type AtomicFileBuffer::overflow(int_type c)
{
    flush();
    if (!traits_type::eq_int_type(c, traits_type::eof())) {
        *pptr() = traits_type::to_char_type(c);
        pbump(1);
    }
    return traits_type::not_eof(c);
}

std::streamsize AtomicFileBuffer::xsputn(const char* data, std::streamsize size)
{
    const auto bytes = static_cast<std::size_t>(size);
    if (bytes > static_cast<std::size_t>(epptr() - pptr())) flush();
    if (bytes >= mBuffer.size()) {
        write(data, bytes);
    } else {
        std::memcpy(pptr(), data, bytes);
        pbump(static_cast<int>(bytes));
    }
    return size;
}

AtomicFileBuffer::pos_type AtomicFileBuffer::seekoff(
    off_type offset, std::ios_base::seekdir from, std::ios_base::openmode)
{
    const auto here = mPosition + static_cast<std::uint64_t>(pptr() - pbase());
    if (from == std::ios_base::cur && offset == 0) return static_cast<off_type>(here); // tellp()
    flush();
    const std::uint64_t base = from == std::ios_base::beg ? 0
        : from == std::ios_base::cur                      ? here
                                                          : mEnd;
    mPosition = base + static_cast<std::uint64_t>(offset);
    return static_cast<off_type>(mPosition);
}

AtomicFileBuffer::pos_type AtomicFileBuffer::seekpos(
    pos_type position, std::ios_base::openmode which)
{
    return seekoff(off_type(position), std::ios_base::beg, which);
}

int AtomicFileBuffer::sync()
{
    flush();
    return 0;
}

} // namespace lumivdb
