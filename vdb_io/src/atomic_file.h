// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file atomic_file.h
/// A file that appears whole or not at all.

#include <lumivdb/core/xxhash64.h>

#include <lumivdb/core/progress.h>

#include <cstdint>
#include <streambuf>
#include <string>
#include <vector>

namespace lumivdb {

/// An output file that replaces @a path only in commit(). Until then its bytes are in an unnamed
/// file of the same folder (Linux O_TMPFILE: not even SIGKILL leaves anything), or, where the file
/// system cannot do that, in a hidden temporary file that the destructor removes.
/// Symbolic links are followed: the link stays, what it points to is replaced.
class AtomicFile {
public:
    /// @throws Error(Output) when the folder is missing or not writable, or @a path is no file.
    explicit AtomicFile(const std::string& path);
    ~AtomicFile();
    AtomicFile(const AtomicFile&) = delete;
    AtomicFile& operator=(const AtomicFile&) = delete;

    /// Writes at @a offset. @throws Error(Output), e.g. when the disk is full.
    void writeAt(std::uint64_t offset, const void* data, std::size_t size);
    /// Reads back. @throws Error(Output) when that fails.
    void readAt(std::uint64_t offset, void* data, std::size_t size) const;
    /// fsync, rename over the old file, fsync of the folder. @throws Error(Output).
    void commit();

private:
    [[noreturn]] void fail(const char* what) const;
    void nameUnnamed();

    std::string mPath; ///< as the caller named it, for messages
    std::string mTarget; ///< after symbolic links
    std::string mFolder;
    std::string mTemporary; ///< empty while the file has no name
    int mFd = -1;
};

/// Buffers output into an AtomicFile. Errors and cancellation leave as exceptions, which an
/// ostream with exceptions(badbit) passes on.
class AtomicFileBuffer : public std::streambuf {
public:
    AtomicFileBuffer(AtomicFile& file, Progress* progress);
    /// From now on every byte written counts into hash().
    void startHash() { mHashing = true; }
    const XxHash64& hash() const { return mHash; }

protected:
    int_type overflow(int_type c) override;
    std::streamsize xsputn(const char* data, std::streamsize size) override;
    pos_type seekoff(
        off_type offset, std::ios_base::seekdir from, std::ios_base::openmode) override;
    pos_type seekpos(pos_type position, std::ios_base::openmode) override;
    int sync() override;

private:
    void flush();
    void write(const char* data, std::size_t size);

    AtomicFile& mFile;
    Progress* mProgress;
    std::vector<char> mBuffer;
    std::uint64_t mPosition = 0; ///< file offset of the buffer's first byte
    std::uint64_t mEnd = 0; ///< largest offset written
    bool mHashing = false;
    XxHash64 mHash;
};

} // namespace lumivdb
