// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file load.h
/// Makes a volume of the grids of a file, whatever order they come in.

#include "cuts.h"
#include "transfer.h"

#include <lumivdb/core/progress.h>

#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

namespace lumivdb {

class VolumeLoader {
public:
    VolumeLoader(const std::string& path, Progress* progress);
    /// True for names that belong to the volume; others are previews or foreign.
    static bool isChannel(const std::string& name);
    /// @throws Error(Input) naming file and grid.
    void add(const openvdb::GridBase::Ptr& grid);
    /// @throws Error(Input) when something is missing.
    IrradianceVolume finish();
    /// The metadata of the file; after the first add().
    const FileMetadata& metadata() const { return mFile; }

private:
    [[noreturn]] void fail(const std::string& sentence) const;
    std::string where(const std::string& name) const;
    void makeVolume(const openvdb::GridBase& grid);
    std::uint64_t countCells(const openvdb::Int32Tree& level) const;
    void requireMemory(std::uint64_t cells) const;
    void checkLevels(const openvdb::Int32Tree& level) const;
    void takePending();
    void take(const openvdb::GridBase::ConstPtr& pointer);
    void checkChannel(const openvdb::GridBase& grid) const;
    void takeColors(const openvdb::GridBase& grid, const ColorChannel& channel);
    void takeScalars(const openvdb::GridBase& grid);
    void takeOffsets(const openvdb::GridBase& grid);
    void takeBlocking(const openvdb::GridBase& grid);
    void takeCut(const openvdb::GridBase::ConstPtr& grid);
    void applyCuts();
    void checkMoved() const;
    void checkBlocked() const;

    std::string mPath;
    Progress* mProgress;
    std::set<std::string> mSeen;
    std::vector<openvdb::GridBase::Ptr> mPending; ///< came before the grid of levels
    FileMetadata mFile;
    openvdb::MetaMap mMetadata; ///< of the grid of levels
    Mat4d mIndexToWorld;
    std::optional<IrradianceVolume> mVolume;
    std::vector<ColorChannel> mChannels;
    openvdb::Int32Tree::Ptr mSource;
    std::unique_ptr<SampleSlots> mSlots;
    CutReader mCuts;
};

} // namespace lumivdb
