// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/vdb_io/statistics.h>

#include "archive.h"
#include "layout_check.h"
#include "load.h"
#include "volume_statistics.h"

#include <lumivdb/core/error.h>

#include <cmath>
#include <filesystem>
#include <limits>

namespace lumivdb {

namespace {

/// Running minimum, maximum, sum and count of finite components.
struct Range {
    double min = std::numeric_limits<double>::infinity();
    double max = -std::numeric_limits<double>::infinity();
    double sum = 0;
    std::uint64_t components = 0;
    std::uint64_t nan = 0;

    void add(double v, std::uint64_t voxels)
    {
        if (!std::isfinite(v)) return;
        min = std::min(min, v);
        max = std::max(max, v);
        sum += v * static_cast<double>(voxels);
        components += voxels;
    }
};

void addValue(Range& range, double v, std::uint64_t voxels)
{
    if (std::isnan(v)) range.nan += voxels;
    range.add(v, voxels);
}

void addValue(Range& range, const openvdb::Vec3s& v, std::uint64_t voxels)
{
    if (std::isnan(v.x()) || std::isnan(v.y()) || std::isnan(v.z())) range.nan += voxels;
    for (int k = 0; k < 3; ++k) range.add(static_cast<double>(v[k]), voxels);
}

template <typename GridType> void countValues(const GridType& grid, ChannelStatistics& st)
{
    Range range;
    for (auto it = grid.tree().cbeginValueOn(); it; ++it) {
        const auto voxels = static_cast<std::uint64_t>(it.getVoxelCount());
        addValue(range, *it, voxels);
        st.activeVoxels += voxels;
        st.tiles += it.isTileValue();
    }
    if (range.components > 0) {
        st.min = range.min;
        st.max = range.max;
        st.mean = range.sum / static_cast<double>(range.components);
    }
    st.nan = range.nan;
}

ChannelStatistics channelStatistics(const openvdb::GridBase& grid)
{
    ChannelStatistics st;
    st.name = grid.getName();
    st.type = grid.valueType();
    if (const auto* colors = dynamic_cast<const openvdb::Vec3SGrid*>(&grid)) {
        countValues(*colors, st);
    } else if (const auto* scalars = dynamic_cast<const openvdb::FloatGrid*>(&grid)) {
        countValues(*scalars, st);
    } else if (const auto* integers = dynamic_cast<const openvdb::Int32Grid*>(&grid)) {
        countValues(*integers, st);
    }
    return st;
}

void countNodes(const openvdb::GridBase& grid, VolumeStatistics& st)
{
    const auto* level = dynamic_cast<const openvdb::Int32Grid*>(&grid);
    if (!level) return;
    st.leafNodes = level->tree().leafCount();
    for (auto it = level->tree().cbeginValueOn(); it; ++it)
        if (it.isTileValue()) ++st.tilesBySize[it.getBoundingBox().dim().x()];
}

} // namespace

VolumeStatistics computeStatistics(const std::string& path)
{
    VolumeStatistics st;
    VolumeLoader loader(path, nullptr);
    readVdb(
        path,
        [](const std::string& name, const std::string& type) {
            const bool read = VolumeLoader::isChannel(name) || isKnown(layoutOfType(type));
            return read ? GridUse::Read : GridUse::Skip;
        },
        [&](const openvdb::GridBase::Ptr& grid) {
            st.channels.push_back(channelStatistics(*grid));
            const std::string name = grid->getName();
            if (name == kLevelGrid) countNodes(*grid, st);
            if (name == "sh_0") st.half = grid->saveFloatAsHalf();
            if (VolumeLoader::isChannel(name)) loader.add(grid);
        });
    const IrradianceVolume volume = loader.finish();
    st.formatVersion = loader.metadata().version;
    addVolumeStatistics(volume, st);
    std::error_code ec;
    st.fileBytes = std::filesystem::file_size(path, ec);
    if (ec) throw Error(ErrorCode::Input, "'" + path + "' vanished while it was read.");
    st.bytesPerSample = static_cast<double>(st.fileBytes) / static_cast<double>(st.samples);
    return st;
}

} // namespace lumivdb
