// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <catch2/catch.hpp>
#include <openvdb/io/Compression.h>
#include <openvdb/openvdb.h>

#include <cstring>

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/lsan_interface.h>
#endif

using namespace vdb_test;

namespace {

// OpenVDB does not free what it has read of a grid when the stream ends in its middle.
#ifdef __SANITIZE_ADDRESS__
using IgnoreLeaks = __lsan::ScopedDisabler;
#else
struct IgnoreLeaks {
    ~IgnoreLeaks() { } // so that no compiler calls it unused
};
#endif

enum class Outcome { Loaded, Refused };

/// Any other exception, and any crash, fails the test.
Outcome tryLoad(const std::string& path)
{
    try {
        loadVolume(path);
        return Outcome::Loaded;
    } catch (const Error& e) {
        if (e.code() != ErrorCode::Input) FAIL("wrong code: " << e.what());
        return Outcome::Refused;
    }
}

void saveSmall(const std::string& path)
{
    SaveOptions options;
    options.previewVoxel = -1;
    saveVolume(uniformVolume({0, 0, 0}, {1, 1, 1}, 1, false), path, options);
}

/// As a program without the footer writes it.
void rewrite(const std::string& from, const std::string& to, std::uint32_t compression)
{
    openvdb::io::File file(from);
    file.open(/*delayLoad=*/false);
    openvdb::io::File out(to);
    out.setCompression(compression);
    out.write(*file.getGrids());
}

} // namespace

TEST_CASE("every prefix of a file is refused")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb"), cut = folder.file("cut.vdb");
    saveSmall(path);
    REQUIRE(tryLoad(path) == Outcome::Loaded);
    std::filesystem::copy_file(path, cut);
    const std::uintmax_t size = std::filesystem::file_size(path);
    std::size_t loaded = 0, tried = 0;
    for (std::uintmax_t n = size; n-- > 0; ++tried) {
        std::filesystem::resize_file(cut, n);
        loaded += tryLoad(cut) == Outcome::Loaded;
    }
    CHECK(tried == size);
    CHECK(loaded == 0);
}

TEST_CASE("flipped bits are noticed")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb"), flipped = folder.file("flipped.vdb");
    saveSmall(path);
    std::vector<char> bytes = readBytes(path);
    CounterRng rng(1);
    std::size_t loaded = 0, tried = 0;
    for (std::size_t i = 0; i < bytes.size(); ++i) {
        const bool edge = i < 2000 || i + 2000 > bytes.size();
        if (!edge && rng.next() > 0.1f) continue;
        const char old = bytes[i];
        bytes[i] = static_cast<char>(old ^ (1 << (rng.bits() % 8)));
        writeBytes(flipped, bytes);
        loaded += tryLoad(flipped) == Outcome::Loaded;
        bytes[i] = old;
        ++tried;
    }
    CHECK(tried > 4000);
    CHECK(loaded == 0);
}

TEST_CASE("bytes behind the footer and a foreign footer are noticed")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb");
    saveSmall(path);
    const std::vector<char> bytes = readBytes(path);
    std::vector<char> longer = bytes;
    longer.push_back(0);
    writeBytes(path, longer);
    CHECK(tryLoad(path) == Outcome::Refused);
    std::vector<char> twice = bytes;
    twice.insert(twice.end(), bytes.begin(), bytes.end());
    writeBytes(path, twice);
    CHECK(tryLoad(path) == Outcome::Refused);
}

TEST_CASE("prefixes of a file without footer do not load")
{
    const TempFolder folder;
    const std::string ours = folder.file("a.vdb"), path = folder.file("rewritten.vdb");
    const std::string broken = folder.file("broken.vdb");
    saveSmall(ours);
    // Without a codec nothing but the stream's end can tell that values are missing.
    for (const std::uint32_t codec : {openvdb::io::COMPRESS_NONE, openvdb::io::COMPRESS_BLOSC}) {
        rewrite(ours, path, codec | openvdb::io::COMPRESS_ACTIVE_MASK);
        REQUIRE(tryLoad(path) == Outcome::Loaded);
        const std::vector<char> bytes = readBytes(path);
        const IgnoreLeaks ignore;
        std::size_t loaded = 0;
        for (std::size_t n = 0; n < bytes.size(); ++n) {
            if (n > 1500 && n + 200 < bytes.size()) n += 48;
            writeBytes(broken, {bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(n)});
            loaded += tryLoad(broken) == Outcome::Loaded;
        }
        CHECK(loaded == 0);
    }
}

TEST_CASE("damage to a file without footer never crashes")
{
#ifdef __SANITIZE_ADDRESS__
    // OpenVDB asks for as much memory as a damaged length says; here that aborts instead of
    // throwing std::bad_alloc.
    WARN("skipped: AddressSanitizer ends the program where operator new would throw");
    return;
#endif
    const TempFolder folder;
    const std::string ours = folder.file("a.vdb"), path = folder.file("rewritten.vdb");
    const std::string broken = folder.file("broken.vdb");
    saveSmall(ours);
    rewrite(ours, path, openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK);
    const std::vector<char> bytes = readBytes(path);
    std::vector<char> flipped = bytes;
    CounterRng rng(2);
    std::size_t refused = 0;
    for (std::size_t i = 0; i < bytes.size(); i += i < 1500 ? 1 : 61) {
        flipped[i] = static_cast<char>(bytes[i] ^ (1 << (rng.bits() % 8)));
        writeBytes(broken, flipped);
        refused += tryLoad(broken) == Outcome::Refused;
        flipped[i] = bytes[i];
    }
    CHECK(refused > 100); // without a checksum not every flip can be seen
}
