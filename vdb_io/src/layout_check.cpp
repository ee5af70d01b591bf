// SPDX-License-Identifier: Apache-2.0
#include "layout_check.h"

#include <openvdb/io/Compression.h>
#include <openvdb/math/Maps.h>
#include <openvdb/openvdb.h>

#include <array>
#include <set>
#include <stdexcept>
#include <string>

namespace lumivdb {

namespace io = openvdb::io;

namespace {

/// Reads on from a stream's place and never past the file's end; rewinds the stream at its end.
class Scan {
public:
    Scan(std::istream& stream, std::uint64_t fileSize)
        : mStream(stream)
        , mBegin(static_cast<std::uint64_t>(std::streamoff(stream.tellg())))
        , mAt(mBegin)
        , mFileSize(fileSize)
    {
        if (mBegin > fileSize) fail("ends early");
    }
    void rewind() { mStream.seekg(static_cast<std::streamoff>(mBegin)); }
    std::uint64_t position() const { return mAt; }

    /// In the byte order of the file, which OpenVDB takes for that of the machine.
    template <typename T> T number()
    {
        T value{};
        bytes(&value, sizeof value);
        return value;
    }
    void bytes(void* to, std::size_t size)
    {
        take(size);
        mStream.read(static_cast<char*>(to), static_cast<std::streamsize>(size));
    }
    std::string string()
    {
        const auto size = number<std::uint32_t>();
        take(size);
        std::string text(size, '\0');
        mStream.read(text.data(), size);
        return text;
    }
    void skip(std::uint64_t size)
    {
        take(size);
        mStream.ignore(static_cast<std::streamsize>(size));
    }
    [[noreturn]] void fail(const std::string& what) const
    {
        throw std::runtime_error(what + " at byte " + std::to_string(mAt));
    }

private:
    void take(std::uint64_t size)
    {
        if (size > mFileSize - mAt) fail("a length goes past the end of the file");
        mAt += size;
    }

    std::istream& mStream;
    std::uint64_t mBegin, mAt, mFileSize;
};

/// OpenVDB reads as many bytes as the type has, whatever the size says, and strings by the size.
void checkMetadataValue(Scan& scan, const std::string& type)
{
    const auto size = scan.number<std::uint32_t>();
    const bool fixed = openvdb::Metadata::isRegisteredType(type)
        && type != openvdb::StringMetadata::staticTypeName();
    if (fixed && openvdb::Metadata::createMetadata(type)->size() != size)
        scan.fail("metadata of type '" + type + "' has " + std::to_string(size) + " bytes");
    if (type != openvdb::BoolMetadata::staticTypeName()) return scan.skip(size);
    if (scan.number<std::uint8_t>() > 1) scan.fail("metadata is neither true nor false");
}

/// Walks over one tree in the order in which OpenVDB reads it.
class TreeScan {
public:
    TreeScan(Scan& scan, const TreeLayout& layout)
        : mScan(scan)
        , mLayout(layout)
        , mHalf(layout.half && layout.halfBytes > 0)
    {
        const std::uint32_t known
            = io::COMPRESS_ZIP | io::COMPRESS_ACTIVE_MASK | io::COMPRESS_BLOSC;
        if (layout.compression & ~known) scan.fail("an unknown compression");
    }

    void tree()
    {
        // OpenVDB would warn on stderr.
        if (mScan.number<std::int32_t>() != 1) mScan.fail("an impossible number of buffers");
        const std::uint64_t leaves = root();
        for (std::uint64_t i = 0; i < leaves; ++i) values(512, mask(mValueMask, 512));
    }

private:
    using Mask = std::array<std::uint64_t, 512>;

    /// @return number of leaves
    std::uint64_t root()
    {
        mScan.skip(mLayout.valueBytes); // background
        const auto tiles = mScan.number<std::uint32_t>();
        const auto children = mScan.number<std::uint32_t>();
        for (std::uint32_t i = 0; i < tiles; ++i) {
            origin();
            mScan.skip(mLayout.valueBytes);
            if (mScan.number<std::uint8_t>() > 1) mScan.fail("a tile is neither on nor off");
        }
        std::uint64_t leaves = 0;
        for (std::uint32_t i = 0; i < children; ++i) {
            origin();
            leaves += upperNode();
        }
        return leaves;
    }

    /// Of a root's entry. Two at one place would be one in memory, and the leaves fewer than those
    /// in the file.
    void origin()
    {
        const auto at = mScan.number<std::array<std::int32_t, 3>>();
        for (const std::int32_t x : at)
            if (x & 4095) mScan.fail("a node lies off the lattice of its level");
        if (!mOrigins.insert(at).second) mScan.fail("a node is there twice");
    }

    std::uint64_t upperNode()
    {
        const std::uint64_t children = internalNode(32 * 32 * 32);
        std::uint64_t leaves = 0;
        for (std::uint64_t i = 0; i < children; ++i) {
            const std::uint64_t here = internalNode(16 * 16 * 16);
            mScan.skip(here * 64); // masks of leaves, which stand before their values once more
            leaves += here;
        }
        return leaves;
    }

    /// @return number of children
    std::uint64_t internalNode(std::uint32_t slots)
    {
        const std::uint64_t children = mask(mChildMask, slots);
        const std::uint64_t active = mask(mValueMask, slots);
        for (std::uint32_t i = 0; i < slots / 64; ++i)
            if (mChildMask[i] & mValueMask[i]) mScan.fail("a place holds both a node and a value");
        values(slots, active);
        return children;
    }

    /// @return number of bits that are set
    std::uint64_t mask(Mask& mask, std::uint32_t slots)
    {
        mScan.bytes(mask.data(), slots / 8);
        std::uint64_t on = 0;
        for (std::uint32_t i = 0; i < slots / 64; ++i) on += openvdb::util::CountOn(mask[i]);
        return on;
    }

    /// What io::readCompressedValues() reads.
    void values(std::uint64_t slots, std::uint64_t active)
    {
        const auto kind = mScan.number<std::uint8_t>();
        if (kind > io::NO_MASK_AND_ALL_VALS) mScan.fail("an unknown form of values");
        const bool two = kind == io::MASK_AND_TWO_INACTIVE_VALS;
        const bool one
            = kind == io::NO_MASK_AND_ONE_INACTIVE_VAL || kind == io::MASK_AND_ONE_INACTIVE_VAL;
        mScan.skip((two ? 2 : one ? 1 : 0) * std::uint64_t{mLayout.valueBytes});
        if (two || kind == io::MASK_AND_NO_INACTIVE_VALS || kind == io::MASK_AND_ONE_INACTIVE_VAL)
            mScan.skip(slots / 8);
        const bool activeOnly
            = (mLayout.compression & io::COMPRESS_ACTIVE_MASK) && kind != io::NO_MASK_AND_ALL_VALS;
        const std::uint64_t count = activeOnly ? active : slots;
        if (mHalf && count == 0) return; // io::HalfReader reads nothing, not even a size
        block(count * (mHalf ? mLayout.halfBytes : mLayout.valueBytes));
    }

    /// What io::readData() reads; @a due: bytes once it is unpacked.
    void block(std::uint64_t due)
    {
        if (!(mLayout.compression & (io::COMPRESS_BLOSC | io::COMPRESS_ZIP)))
            return mScan.skip(due);
        const auto size = mScan.number<std::int64_t>();
        if (size <= 0) {
            if (size != -static_cast<std::int64_t>(due)) wrongSize(size, due);
            return mScan.skip(due);
        }
        std::uint64_t left = static_cast<std::uint64_t>(size);
        if (mLayout.compression & io::COMPRESS_BLOSC) {
            // Blosc is not told how much there is: its own header must not say more.
            const auto header = mScan.number<std::array<std::uint32_t, 4>>();
            if (left < sizeof header || header[1] != due || header[3] != left) wrongSize(size, due);
            left -= sizeof header;
        }
        mScan.skip(left);
    }

    [[noreturn]] void wrongSize(std::int64_t size, std::uint64_t due) const
    {
        mScan.fail("values have the size " + std::to_string(size) + " where " + std::to_string(due)
            + " bytes are packed");
    }

    Scan& mScan;
    TreeLayout mLayout;
    bool mHalf;
    std::set<std::array<std::int32_t, 3>> mOrigins;
    Mask mChildMask{}, mValueMask{};
};

} // namespace

void checkStrings(std::istream& stream, std::uint64_t fileSize, int count)
{
    Scan scan(stream, fileSize);
    for (int i = 0; i < count; ++i) scan.string();
    scan.rewind();
}

void checkMetadata(std::istream& stream, std::uint64_t fileSize)
{
    Scan scan(stream, fileSize);
    for (auto left = scan.number<std::uint32_t>(); left > 0; --left) {
        scan.string();
        checkMetadataValue(scan, scan.string());
    }
    scan.rewind();
}

void checkTransform(std::istream& stream, std::uint64_t fileSize)
{
    Scan scan(stream, fileSize);
    if (scan.string() == openvdb::math::NonlinearFrustumMap::mapType()) {
        scan.skip(8 * sizeof(double)); // box, taper, depth
        if (scan.string() == openvdb::math::NonlinearFrustumMap::mapType())
            scan.fail("a perspective transform lies in another"); // and so on, to the stack's end
    }
    scan.rewind();
}

TreeLayout layoutOfType(const std::string& gridType)
{
    TreeLayout layout;
    if (gridType == openvdb::FloatGrid::gridType()) {
        layout.valueBytes = 4;
        layout.halfBytes = 2;
    } else if (gridType == openvdb::Vec3SGrid::gridType()) {
        layout.valueBytes = 12;
        layout.halfBytes = 6;
    } else if (gridType == openvdb::Int32Grid::gridType()) {
        layout.valueBytes = 4;
    }
    return layout;
}

std::uint64_t checkTree(std::istream& stream, std::uint64_t fileSize, const TreeLayout& layout)
{
    Scan scan(stream, fileSize);
    TreeScan(scan, layout).tree();
    const std::uint64_t end = scan.position();
    scan.rewind();
    return end;
}

} // namespace lumivdb
