// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <catch2/catch.hpp>
#include <openvdb/io/Compression.h>
#include <openvdb/openvdb.h>

#include <algorithm>
#include <cstring>
#include <limits>

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

namespace {

/// A file of every codec, as another program writes it: Blosc, zip and none, with and without
/// masks, full and half floats.
struct Foreign {
    const char* name;
    std::uint32_t compression;
    bool half;
};

const Foreign kForeign[] = {
    {"blosc", openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK, false},
    {"blosc, half", openvdb::io::COMPRESS_BLOSC | openvdb::io::COMPRESS_ACTIVE_MASK, true},
    {"blosc, all values", openvdb::io::COMPRESS_BLOSC, false},
    {"zip", openvdb::io::COMPRESS_ZIP | openvdb::io::COMPRESS_ACTIVE_MASK, false},
    {"zip, half, all values", openvdb::io::COMPRESS_ZIP, true},
    {"none", openvdb::io::COMPRESS_ACTIVE_MASK, false},
    {"none, half, all values", openvdb::io::COMPRESS_NONE, true},
};

std::vector<char> foreignBytes(const TempFolder& folder, const Foreign& kind)
{
    SaveOptions options;
    options.previewVoxel = -1;
    options.half = kind.half;
    const std::string ours = folder.file("ours.vdb"), path = folder.file("rewritten.vdb");
    saveVolume(uniformVolume({0, 0, 0}, {4, 3, 2}, 1, false), ours, options);
    rewrite(ours, path, kind.compression);
    REQUIRE(tryLoad(path) == Outcome::Loaded);
    return readBytes(path);
}

template <typename T> void put(std::vector<char>& bytes, std::size_t at, T value)
{
    if (at + sizeof value <= bytes.size()) std::memcpy(&bytes[at], &value, sizeof value);
}

/// A bit flipped, or a number that no size can be, at @a at.
void damage(std::vector<char>& bytes, std::size_t at, CounterRng& rng)
{
    const auto bits = rng.bits();
    const std::int64_t wide[] = {-1, -(std::int64_t{1} << 20), std::int64_t{1} << 40,
        std::numeric_limits<std::int64_t>::min(), std::numeric_limits<std::int64_t>::max()};
    const std::uint32_t narrow[] = {0xffffffff, 0x80000000, 0x7fffffff, 0x01000000, 0};
    switch (bits % 4) {
    case 0:
        return put(bytes, at, wide[(bits >> 8) % 5]);
    case 1:
        return put(bytes, at, narrow[(bits >> 8) % 5]);
    default:
        bytes[at] = static_cast<char>(bytes[at] ^ (1 << ((bits >> 8) % 8)));
    }
}

/// Masks and unused values repeat themselves: there a few places stand for all.
std::vector<std::size_t> placesToDamage(const std::vector<char>& bytes)
{
    std::vector<std::size_t> places;
    std::size_t lastNew = 0;
    for (std::size_t i = 0; i < bytes.size(); ++i) {
        if (i < 12 || bytes[i] != bytes[i - 12]) lastNew = i; // 12: of a vec3s
        if (i < lastNew + 8 || i % 4099 == 0) places.push_back(i);
    }
    return places;
}

} // namespace

TEST_CASE("damage to a file without footer never crashes")
{
    constexpr std::size_t kTries = 400; // with each kind of file
    const TempFolder folder;
    const std::string broken = folder.file("broken.vdb");
    const IgnoreLeaks ignore;
    CounterRng rng(2);
    for (const Foreign& kind : kForeign) {
        INFO(kind.name);
        const std::vector<char> bytes = foreignBytes(folder, kind);
        const std::vector<std::size_t> places = placesToDamage(bytes);
        std::size_t refused = 0;
        for (std::size_t i = 0; i < kTries; ++i) {
            std::vector<char> damaged = bytes;
            damage(damaged, places[rng.bits() % places.size()], rng);
            writeBytes(broken, damaged);
            refused += tryLoad(broken) == Outcome::Refused;
        }
        CHECK(refused > kTries / 2); // without a checksum not every change can be seen
    }
}

namespace {

/// Behind the descriptor of the first grid of a type: positions of the grid, of the values of its
/// leaves, and of its end.
struct Offsets {
    std::size_t at; ///< of the numbers themselves
    std::int64_t grid, blocks, end;
};

std::size_t find(const std::vector<char>& bytes, const std::string& text, std::size_t from = 0)
{
    const auto at = std::search(
        bytes.begin() + static_cast<std::ptrdiff_t>(from), bytes.end(), text.begin(), text.end());
    REQUIRE(at != bytes.end());
    return static_cast<std::size_t>(at - bytes.begin());
}

template <typename T> T get(const std::vector<char>& bytes, std::size_t at)
{
    T value{};
    REQUIRE(at + sizeof value <= bytes.size());
    std::memcpy(&value, &bytes[at], sizeof value);
    return value;
}

Offsets offsetsOf(const std::vector<char>& bytes, const std::string& type)
{
    const std::size_t at = find(bytes, type) + type.size() + 4; // no parent
    return {at, get<std::int64_t>(bytes, at), get<std::int64_t>(bytes, at + 8),
        get<std::int64_t>(bytes, at + 16)};
}

/// Refused with a sentence that holds @a part.
void checkRefused(const TempFolder& folder, const std::vector<char>& bytes, const char* part)
{
    const std::string path = folder.file("hostile.vdb");
    writeBytes(path, bytes);
    CHECK_THROWS_WITH(loadVolume(path), Catch::Contains(part));
}

} // namespace

TEST_CASE("blocks of values with sizes that are not due are refused before they are read")
{
    const TempFolder folder;
    const IgnoreLeaks ignore;
    for (const std::size_t kind : {0, 1, 2, 3, 4}) { // those with blocks
        INFO(kForeign[kind].name);
        const std::vector<char> whole = foreignBytes(folder, kForeign[kind]);
        const Offsets offsets = offsetsOf(whole, "Tree_float_5_4_3");
        const auto size = static_cast<std::size_t>(offsets.blocks) + 64 + 1; // mask, kind
        const auto due = get<std::int64_t>(whole, size);
        for (const std::int64_t wrong : {-(std::int64_t{1} << 24), due - 1, -due, due + 1,
                 std::numeric_limits<std::int64_t>::min()}) {
            std::vector<char> bytes = whole;
            put(bytes, size, wrong);
            INFO(due << " " << wrong);
            const bool blosc = kForeign[kind].compression & openvdb::io::COMPRESS_BLOSC;
            // zlib's sizes are any; what they lead to is found later
            if (blosc || wrong <= 0)
                checkRefused(folder, bytes, "values have the size");
            else
                checkRefused(folder, bytes, "hostile.vdb");
        }
        std::vector<char> bytes = whole;
        put(bytes, size, std::int64_t{1} << 40);
        checkRefused(folder, bytes, kind < 3 ? "values have the size" : "past the end");
        if (kind > 2) continue;
        put(bytes, size, due);
        for (const std::size_t field : {4, 12}) { // Blosc's own sizes
            std::vector<char> more = bytes;
            put(more, size + 8 + field, get<std::int32_t>(bytes, size + 8 + field) + 4096);
            checkRefused(folder, more, "values have the size");
        }
    }
}

TEST_CASE("trees that no program writes are refused")
{
    const TempFolder folder;
    const std::vector<char> whole = foreignBytes(folder, kForeign[0]);
    const Offsets offsets = offsetsOf(whole, "Tree_float_5_4_3");
    // Values of leaves stand behind the masks of leaves: one leaf of 64 bytes, one node of 16³ with
    // an empty block of values, one of 32³ with the same, both without any active tile.
    const std::string empty(std::size_t{1} + 8 + 16, '\0');
    const auto lower = static_cast<std::size_t>(offsets.blocks) - 64 - empty.size() - 2 * 512;
    const auto upper = lower - empty.size() - 2 * 4096;
    REQUIRE((whole[lower] & 1) == 1);
    REQUIRE((whole[upper] & 1) == 1);
    const auto origin = upper - 12;
    const auto broken = [&](std::size_t at, auto value, const char* part) {
        std::vector<char> bytes = whole;
        put(bytes, at, value);
        checkRefused(folder, bytes, part);
    };
    broken(lower + 512, char{1}, "both a node and a value");
    broken(upper + 4096, char{1}, "both a node and a value");
    broken(origin, std::int32_t{7}, "off the lattice");
    broken(origin - 4, std::uint32_t{0xffffffff}, "at byte"); // children
    broken(origin - 8, std::uint32_t{0xffffffff}, "at byte"); // tiles
    broken(origin - 16, std::int32_t{2}, "number of buffers");
    broken(lower + 1024, char{7}, "unknown form");
    broken(static_cast<std::size_t>(offsets.grid), std::uint32_t{15}, "unknown compression");
    std::vector<char> twice = whole;
    twice.insert(twice.begin() + offsets.blocks,
        whole.begin() + static_cast<std::ptrdiff_t>(origin), whole.begin() + offsets.blocks);
    put(twice, origin - 4, std::uint32_t{2});
    checkRefused(folder, twice, "there twice");
}

TEST_CASE("metadata, offsets and transforms that no program writes are refused")
{
    const TempFolder folder;
    const std::vector<char> whole = foreignBytes(folder, kForeign[1]);
    const auto broken = [&](std::size_t at, auto value, const char* part) {
        std::vector<char> bytes = whole;
        put(bytes, at, value);
        checkRefused(folder, bytes, part);
    };
    const std::size_t size = find(whole, "double", find(whole, "lumivdb_error_asked")) + 6;
    for (const std::uint32_t wrong : {0u, 4u, 12u, 0xffffffffu})
        broken(size, wrong, "metadata of type 'double'");
    broken(find(whole, "bool") + 4 + 4, char{2}, "neither true nor false");
    broken(find(whole, "lumivdb_options") - 4, std::uint32_t{0xfffffff0}, "past the end");

    const Offsets offsets = offsetsOf(whole, "Tree_float_5_4_3");
    for (const std::int64_t wrong :
        {std::int64_t{-1}, std::int64_t{0}, offsets.grid - 1, std::int64_t{1} << 60}) {
        broken(offsets.at, wrong, "grid offset");
        broken(offsets.at + 16, wrong, "grid offset");
    }
    broken(offsets.at + 16, offsets.end - 1, "grid offset");
}

TEST_CASE("perspective transforms in each other do not exhaust the stack")
{
    const TempFolder folder;
    const std::string ours = folder.file("ours.vdb"), path = folder.file("frustum.vdb");
    saveSmall(ours);
    openvdb::io::File file(ours);
    file.open(/*delayLoad=*/false);
    const openvdb::GridPtrVecPtr grids = file.getGrids();
    for (const openvdb::GridBase::Ptr& grid : *grids) {
        grid->setTransform(openvdb::math::Transform::createFrustumTransform(
            openvdb::BBoxd({0, 0, 0}, {8, 8, 8}), 0.5, 1.0));
    }
    openvdb::io::File(path).write(*grids);
    std::vector<char> bytes = readBytes(path);
    checkRefused(folder, bytes, "a linear one is needed");

    const std::string frustum = "NonlinearFrustumMap";
    const std::size_t begin = find(bytes, frustum) - 4;
    const std::vector<char> one(bytes.begin() + static_cast<std::ptrdiff_t>(begin),
        bytes.begin() + static_cast<std::ptrdiff_t>(begin + 4 + frustum.size() + 64));
    std::vector<char> nested;
    for (int i = 0; i < 200000; ++i) nested.insert(nested.end(), one.begin(), one.end());
    bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(begin), nested.begin(), nested.end());
    bytes[20] = 0; // no offsets
    checkRefused(folder, bytes, "lies in another");
}

TEST_CASE("tiles that stand for more cells than there is memory for are refused")
{
    const TempFolder folder;
    const std::string ours = folder.file("ours.vdb"), path = folder.file("tiles.vdb");
    saveSmall(ours);
    openvdb::io::File file(ours);
    file.open(/*delayLoad=*/false);
    const openvdb::GridPtrVecPtr grids = file.getGrids();
    for (const openvdb::GridBase::Ptr& grid : *grids) {
        const auto level = openvdb::gridPtrCast<openvdb::Int32Grid>(grid);
        if (!level) continue;
        level->insertMeta("lumivdb_bands", openvdb::Int32Metadata(6));
        level->insertMeta("lumivdb_gradients", openvdb::StringMetadata("per_coefficient"));
        level->fill(openvdb::CoordBBox({0, 0, 0}, {2047, 1023, 895}), 0); // 1.9 billion, 3 TB
    }
    openvdb::io::File(path).write(*grids);
    checkRefused(folder, readBytes(path), "this machine has less");
    for (const openvdb::GridBase::Ptr& grid : *grids)
        if (const auto level = openvdb::gridPtrCast<openvdb::Int32Grid>(grid))
            level->fill(openvdb::CoordBBox({0, 0, 0}, {4095, 4095, 4095}), 0);
    openvdb::io::File(path).write(*grids);
    checkRefused(folder, readBytes(path), "more than 2^31 cells");
}
