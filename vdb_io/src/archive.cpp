// SPDX-License-Identifier: Apache-2.0
#include "archive.h"

#include "footer.h"
#include "layout_check.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <openvdb/io/Compression.h>
#include <openvdb/io/DelayedLoadMetadata.h>

#include <filesystem>
#include <fstream>
#include <new>

namespace lumivdb {

namespace io = openvdb::io;

namespace {

std::uint32_t compressionFlags(Codec codec)
{
    switch (codec) {
    case Codec::Blosc:
        return io::COMPRESS_BLOSC | io::COMPRESS_ACTIVE_MASK;
    case Codec::Zip:
        return io::COMPRESS_ZIP | io::COMPRESS_ACTIVE_MASK;
    case Codec::None:
        return io::COMPRESS_ACTIVE_MASK;
    }
    return io::COMPRESS_ACTIVE_MASK;
}

/// 64 bits as the text form of a version-8 (free content) UUID.
std::string identityText(std::uint64_t hash)
{
    const std::uint64_t words[2] = {hash, mixBits(hash)};
    std::string digits;
    for (const std::uint64_t word : words)
        for (int shift = 60; shift >= 0; shift -= 4)
            digits += "0123456789abcdef"[(word >> shift) & 15];
    digits[12] = '8';
    digits[16] = "89ab"[words[1] >> 62];
    for (const std::size_t hyphen : {8, 13, 18, 23}) digits.insert(hyphen, 1, '-');
    return digits;
}

} // namespace

VdbWriter::VdbWriter(const std::string& path, Codec codec, int gridCount, Progress* progress)
    : mFile(path)
    , mBuffer(mFile, progress)
    , mStream(&mBuffer)
    , mMetadata(std::make_shared<io::StreamMetadata>())
{
    mStream.exceptions(std::ios::badbit | std::ios::failbit);
    setCompression(compressionFlags(codec));
    io::setStreamMetadataPtr(mStream, mMetadata, /*transfer=*/false);
    io::setDataCompression(mStream, compression());
    io::setWriteGridStatsMetadata(mStream, isGridStatsMetadataEnabled());

    writeHeader(mStream, /*seekable=*/true);
    mStream.flush();
    mBuffer.startHash(); // behind OpenVDB's random identity

    openvdb::MetaMap fileMetadata;
    fileMetadata.insertMeta(
        kFooterMarker, openvdb::StringMetadata(std::string(kIdentityBytes, '0')));
    fileMetadata.writeMeta(mStream);
    mMarkerPosition = static_cast<std::uint64_t>(mStream.tellp()) - kIdentityBytes;
    const auto count = static_cast<std::int32_t>(gridCount);
    mStream.write(reinterpret_cast<const char*>(&count), sizeof count);
}

VdbWriter::~VdbWriter() { io::clearStreamMetadataPtr(mStream); }

void VdbWriter::add(const openvdb::GridBase& grid)
{
    io::GridDescriptor descriptor(grid.getName(), grid.type(), grid.saveFloatAsHalf());
    const openvdb::GridBase::ConstPtr borrowed(openvdb::GridBase::ConstPtr(), &grid);
    writeGrid(descriptor, borrowed, mStream, /*seekable=*/true);
    io::setDataCompression(mStream, compression()); // writeGrid() narrows it to the grid's
}

void VdbWriter::stampIdentity()
{
    // OpenVDB draws the identity at random; made of the content instead, equal volumes make equal
    // files.
    const std::string identity = identityText(mBuffer.hash().digest());
    mFile.writeAt(kIdentityOffset, identity.data(), identity.size());
    mFile.writeAt(mMarkerPosition, identity.data(), identity.size());
}

void VdbWriter::appendFooter()
{
    const auto length = static_cast<std::uint64_t>(mStream.tellp());
    XxHash64 hash;
    std::vector<char> buffer(std::size_t{1} << 20);
    for (std::uint64_t at = 0; at < length; at += buffer.size()) {
        const auto n
            = static_cast<std::size_t>(std::min<std::uint64_t>(buffer.size(), length - at));
        mFile.readAt(at, buffer.data(), n);
        hash.update(buffer.data(), n);
    }
    const auto footer = makeFooter(length, hash.digest());
    mFile.writeAt(length, footer.data(), footer.size());
}

void VdbWriter::finish()
{
    mStream.flush();
    stampIdentity();
    appendFooter();
    mFile.commit();
}

namespace {

class VdbReader : private io::Archive {
public:
    VdbReader(std::istream& stream, std::uint64_t fileSize);
    ~VdbReader() override { io::clearStreamMetadataPtr(mStream); }
    int gridCount() const { return mGridCount; }
    void next(const std::string& path, const WantsGrid& wants, const TakeGrid& take);

private:
    void readGrid(openvdb::GridBase& grid, const io::GridDescriptor& descriptor, GridUse use);
    void readTree(openvdb::GridBase& grid, GridUse use);
    void checkOffsets(const io::GridDescriptor& descriptor);
    std::int64_t position() { return std::streamoff(mStream.tellg()); }

    std::istream& mStream;
    std::uint64_t mFileSize;
    io::StreamMetadata::Ptr mMetadata; // the stream points to this pointer
    int mGridCount = 0;
};

VdbReader::VdbReader(std::istream& stream, std::uint64_t fileSize)
    : mStream(stream)
    , mFileSize(fileSize)
    , mMetadata(std::make_shared<io::StreamMetadata>())
{
    readHeader(mStream);
    io::setStreamMetadataPtr(mStream, mMetadata, /*transfer=*/false);
    io::setVersion(mStream, libraryVersion(), fileVersion());
    io::setDataCompression(mStream, compression());
    openvdb::MetaMap fileMetadata;
    checkMetadata(mStream, mFileSize);
    fileMetadata.readMeta(mStream);
    mGridCount = readGridCount(mStream);
    if (mGridCount < 0 || mGridCount > 100000)
        throw std::runtime_error("impossible number of grids");
}

void VdbReader::checkOffsets(const io::GridDescriptor& descriptor)
{
    const bool ascending = descriptor.getGridPos() == position()
        && descriptor.getBlockPos() <= descriptor.getEndPos()
        && descriptor.getEndPos() >= descriptor.getGridPos()
        && static_cast<std::uint64_t>(descriptor.getEndPos()) <= mFileSize;
    if (!ascending) throw std::runtime_error("impossible grid offset");
}

/// What Archive::readGrid() does, with a look ahead at everything that has a size.
void VdbReader::readGrid(openvdb::GridBase& grid, const io::GridDescriptor& descriptor, GridUse use)
{
    readGridCompression(mStream);
    mMetadata->setHalfFloat(grid.saveFloatAsHalf());
    io::setGridClass(mStream, openvdb::GRID_UNKNOWN);
    io::setGridBackgroundValuePtr(mStream, nullptr);
    checkMetadata(mStream, mFileSize);
    grid.readMeta(mStream);
    mMetadata->gridMetadata() = static_cast<const openvdb::MetaMap&>(grid);
    io::setGridClass(mStream, grid.getGridClass());
    mMetadata->setLeaf(0);
    grid.removeMeta(openvdb::GridBase::META_FILE_DELAYED_LOAD);
    checkTransform(mStream, mFileSize);
    grid.readTransform(mStream);
    if (!descriptor.isInstance()) readTree(grid, use);
    if (inputHasGridOffsets() && position() != descriptor.getEndPos())
        throw std::runtime_error("impossible grid offset");
}

void VdbReader::readTree(openvdb::GridBase& grid, GridUse use)
{
    TreeLayout layout = layoutOfType(grid.type());
    layout.half = grid.saveFloatAsHalf();
    layout.compression = io::getDataCompression(mStream);
    const auto end = static_cast<std::streamoff>(checkTree(mStream, mFileSize, layout));
    if (use == GridUse::Skip) {
        mStream.seekg(end);
        return;
    }
    grid.readTopology(mStream);
    grid.readBuffers(mStream);
    if (mStream.tellg() != std::streampos(end))
        throw std::runtime_error("its tree does not end where it should");
}

void VdbReader::next(const std::string& path, const WantsGrid& wants, const TakeGrid& take)
{
    io::GridDescriptor descriptor;
    checkStrings(mStream, mFileSize, 3);
    const openvdb::GridBase::Ptr grid = descriptor.read(mStream);
    const std::string name = descriptor.gridName();
    const GridUse use = wants(name, descriptor.gridType());
    if (inputHasGridOffsets()) {
        checkOffsets(descriptor);
        if (use == GridUse::Skip) return descriptor.seekToEnd(mStream);
    }
    if (descriptor.isInstance() && use == GridUse::Read) {
        throw Error(ErrorCode::Input,
            "Grid '" + name + "' of '" + path
                + "' shares the tree of another grid; save every channel with its own tree.");
    }
    if (!isKnown(layoutOfType(descriptor.gridType())) && !descriptor.isInstance()) {
        throw Error(ErrorCode::Input,
            "Grid '" + name + "' of '" + path + "' has the type " + descriptor.gridType()
                + ", which is not read; float, vec3s and int32 are.");
    }
    try {
        readGrid(*grid, descriptor, use);
    } catch (const std::bad_alloc&) {
        throw;
    } catch (const std::exception& e) {
        throw std::runtime_error("grid '" + name + "': " + e.what());
    }
    if (use == GridUse::Skip) return;
    grid->setName(name);
    take(grid);
}

} // namespace

void readVdb(const std::string& path, const WantsGrid& wants, const TakeGrid& take)
{
    openvdb::initialize();
    // Its reader trusts the sizes it finds and writes past its memory where they are damaged. It
    // serves delayed loading alone, which is not used here: read as data of an unknown type.
    openvdb::io::DelayedLoadMetadata::unregisterType();
    try {
        verifyFile(path);
        std::vector<char> buffer(std::size_t{1} << 16); // outlives the stream that uses it
        std::ifstream stream;
        stream.rdbuf()->pubsetbuf(buffer.data(), static_cast<std::streamsize>(buffer.size()));
        stream.exceptions(std::ios::badbit | std::ios::failbit);
        stream.open(path, std::ios::binary);
        VdbReader reader(stream, std::filesystem::file_size(path));
        for (int i = 0; i < reader.gridCount(); ++i) reader.next(path, wants, take);
    } catch (const Error&) {
        throw;
    } catch (const std::bad_alloc&) {
        throw Error(ErrorCode::Input,
            "'" + path + "' needs more memory than there is, or is damaged; bake it again.");
    } catch (const std::exception& e) {
        throw Error(ErrorCode::Input,
            "'" + path + "' is truncated or damaged (" + e.what() + "); bake it again.");
    }
}

} // namespace lumivdb
