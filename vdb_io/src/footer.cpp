// SPDX-License-Identifier: Apache-2.0
#include "footer.h"

#include <lumivdb/core/xxhash64.h>

#include <lumivdb/core/error.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <openvdb/version.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <vector>

namespace lumivdb {

namespace {

template <typename T> T littleEndian(const unsigned char* p)
{
    T value = 0;
    for (std::size_t i = 0; i < sizeof(T); ++i) value |= static_cast<T>(T{p[i]} << (8 * i));
    return value;
}

template <typename T> void putLittleEndian(unsigned char* p, T value)
{
    for (std::size_t i = 0; i < sizeof(T); ++i)
        p[i] = static_cast<unsigned char>((value >> (8 * i)) & 0xff);
}

[[noreturn]] void fail(const std::string& path, const std::string& what)
{
    throw Error(ErrorCode::Input, "'" + path + "' " + what);
}

std::ifstream openFile(const std::string& path, std::uint64_t& size)
{
    std::error_code ec;
    const auto status = std::filesystem::status(path, ec);
    if (!std::filesystem::exists(status)) fail(path, "does not exist; check the path.");
    if (!std::filesystem::is_regular_file(status)) fail(path, "is not a file; name a .vdb file.");
    errno = 0;
    std::ifstream file(path, std::ios::binary);
    size = std::filesystem::file_size(path, ec);
    if (!file || ec)
        fail(path, std::string("cannot be read: ") + std::strerror(errno ? errno : EIO) + ".");
    return file;
}

/// Refuses what OpenVDB's reader would only warn about on stderr.
void checkHeader(const std::string& path, const std::vector<unsigned char>& head)
{
    if (head.size() < 8 || littleEndian<std::uint64_t>(head.data()) != openvdb::OPENVDB_MAGIC)
        fail(path, "is not an OpenVDB file; give a volume that lumivdb wrote.");
    if (head.size() < kIdentityOffset + kIdentityBytes) fail(path, "is truncated; bake it again.");
    const auto version = littleEndian<std::uint32_t>(head.data() + 8);
    if (version > openvdb::OPENVDB_FILE_VERSION || version < 222)
        fail(path,
            "has OpenVDB file version " + std::to_string(version) + ", which cannot be read.");
}

/// True when the marker carries the identity of the header. A program that rewrites the file gives
/// it a new identity, so a marker that it carries over does not count.
bool promisesFooter(const std::vector<unsigned char>& head)
{
    const auto identity = head.begin() + kIdentityOffset;
    const auto identityEnd = identity + kIdentityBytes;
    const std::string marker = kFooterMarker;
    const auto at = std::search(identityEnd, head.end(), marker.begin(), marker.end());
    return at != head.end() && std::search(at, head.end(), identity, identityEnd) != head.end();
}

std::uint64_t checksumOf(std::ifstream& file, std::uint64_t length, const std::string& path)
{
    XxHash64 hash;
    std::vector<char> buffer(std::size_t{1} << 20);
    file.clear();
    file.seekg(0);
    for (std::uint64_t left = length; left > 0;) {
        const auto n = static_cast<std::size_t>(std::min<std::uint64_t>(left, buffer.size()));
        if (!file.read(buffer.data(), static_cast<std::streamsize>(n)))
            fail(path, "cannot be read to its end; check the disk.");
        hash.update(buffer.data(), n);
        left -= n;
    }
    return hash.digest();
}

} // namespace

std::array<unsigned char, kFooterBytes> makeFooter(std::uint64_t length, std::uint64_t checksum)
{
    std::array<unsigned char, kFooterBytes> footer{};
    putLittleEndian<std::uint32_t>(footer.data(), kFooterMagic);
    putLittleEndian<std::uint32_t>(footer.data() + 4, kFormatVersion);
    putLittleEndian<std::uint64_t>(footer.data() + 8, length);
    putLittleEndian<std::uint64_t>(footer.data() + 16, checksum);
    return footer;
}

void verifyFile(const std::string& path)
{
    std::uint64_t size = 0;
    std::ifstream file = openFile(path, size);
    std::vector<unsigned char> head(std::min<std::uint64_t>(size, kMarkerWindow));
    file.read(reinterpret_cast<char*>(head.data()), static_cast<std::streamsize>(head.size()));
    if (!file) fail(path, "cannot be read; check the disk.");
    checkHeader(path, head);

    std::array<unsigned char, kFooterBytes> footer{};
    if (size >= kFooterBytes) {
        file.seekg(static_cast<std::streamoff>(size - kFooterBytes));
        file.read(reinterpret_cast<char*>(footer.data()), kFooterBytes);
        if (!file) fail(path, "cannot be read to its end; check the disk.");
    }
    const bool hasMagic = littleEndian<std::uint32_t>(footer.data()) == kFooterMagic;
    if (!hasMagic && !promisesFooter(head)) return;
    const auto length = littleEndian<std::uint64_t>(footer.data() + 8);
    const bool whole = hasMagic && length == size - kFooterBytes
        && littleEndian<std::uint64_t>(footer.data() + 16) == checksumOf(file, length, path);
    if (!whole) fail(path, "is truncated or damaged (its checksum does not fit); bake it again.");
    const auto version = littleEndian<std::uint32_t>(footer.data() + 4);
    if (version != kFormatVersion) {
        fail(path,
            "has format version " + std::to_string(version) + " and this program reads version "
                + std::to_string(kFormatVersion) + "; use the program that wrote it.");
    }
}

} // namespace lumivdb
