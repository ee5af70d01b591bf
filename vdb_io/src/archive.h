// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file archive.h
/// OpenVDB's file format grid by grid, so that a file of many channels never needs them all in
/// memory, with the footer that proves a file whole. OpenVDB's own reader does not check its
/// stream.

#include "atomic_file.h"

#include <lumivdb/vdb_io/volume_file.h>

#include <openvdb/io/Archive.h>
#include <openvdb/io/GridDescriptor.h>
#include <openvdb/io/io.h>
#include <openvdb/openvdb.h>

#include <functional>
#include <memory>
#include <ostream>
#include <string>

namespace lumivdb {

/// Writes one .vdb file, grid by grid, and ends it with the footer.
class VdbWriter : private openvdb::io::Archive {
public:
    VdbWriter(const std::string& path, Codec codec, int gridCount, Progress* progress);
    ~VdbWriter() override;
    void add(const openvdb::GridBase& grid);
    /// Footer, fsync, rename.
    void finish();

private:
    void stampIdentity();
    void appendFooter();

    AtomicFile mFile;
    AtomicFileBuffer mBuffer;
    std::ostream mStream;
    openvdb::io::StreamMetadata::Ptr mMetadata; ///< the stream points to this pointer
    std::uint64_t mMarkerPosition = 0; ///< of the marker's value
};

/// Whether readVdb() hands a grid over or skips its data.
enum class GridUse { Read, Skip };

/// By the grid's name and OpenVDB's name of its type.
using WantsGrid = std::function<GridUse(const std::string& name, const std::string& type)>;
using TakeGrid = std::function<void(openvdb::GridBase::Ptr)>;

/// Checks the footer where the file says that it has one, then reads grid after grid. Whatever
/// OpenVDB reads has been checked before (layout_check.h), with a footer or without: a checksum
/// that fits says nothing about who wrote it.
/// @throws Error(Input) naming @a path for whatever is wrong with it; exceptions of type Error from
/// the callbacks pass unchanged.
void readVdb(const std::string& path, const WantsGrid& wants, const TakeGrid& take);

} // namespace lumivdb
