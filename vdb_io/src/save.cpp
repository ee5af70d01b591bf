// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/vdb_io/volume_file.h>

#include "archive.h"
#include "cuts.h"
#include "preview.h"
#include "transfer.h"

#include <lumivdb/core/error.h>

#include <tbb/blocked_range.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <new>

namespace lumivdb {

namespace {

/// Channels built together: enough to visit a record's cache lines once, few enough to be small
/// beside the volume itself.
constexpr std::size_t kGroup = 9;

bool withinLimit(const Color* record, std::size_t colors, float limit)
{
    bool within = true;
    for (std::size_t i = 0; i < colors; ++i)
        for (int k = 0; k < 3; ++k) within &= std::abs(record[i][k]) <= limit; // false for NaN
    return within;
}

bool isFinite(const Vec3f& v)
{
    return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

bool isSavable(const IrradianceVolume& volume, SampleId s, float limit)
{
    const auto n = static_cast<std::size_t>(volume.coefficients());
    const float distance = volume.distance(s);
    return withinLimit(volume.radiance(s), n, limit)
        && (!volume.hasGradients() || withinLimit(volume.gradient(s), 3 * n, limit))
        && std::isfinite(volume.validity(s)) && distance >= 0 // +inf allowed, NaN not
        && isFinite(volume.offset(s));
}

/// The sentence for a sample that isSavable() refused.
[[noreturn]] void refuse(
    const IrradianceVolume& volume, SampleId s, float limit, const std::string& path)
{
    std::string grid = !std::isfinite(volume.validity(s)) ? kValidityGrid
        : !isFinite(volume.offset(s))                     ? kOffsetGrid
                                                          : kDistanceGrid;
    bool overflow = false;
    for (const ColorChannel& channel : colorChannels(volume.bands(), volume.hasGradients())) {
        const Color* value = (channel.gradient ? volume.gradient(s) : volume.radiance(s));
        value += channel.offset;
        if (withinLimit(value, 1, limit)) continue;
        grid = channel.name;
        overflow = withinLimit(value, 1, std::numeric_limits<float>::max());
        break;
    }
    const std::string place
        = "grid '" + grid + "' at lattice point " + pointText(volume.samplePosition(s)) + " ";
    if (overflow) {
        throw Error(ErrorCode::Output,
            "Cannot write '" + path + "' in half precision: " + place
                + "exceeds 65504; store full floats or scale the volume down.");
    }
    throw Error(ErrorCode::Output,
        "Cannot write '" + path + "': " + place
            + "is NaN or infinite or a negative distance; check the scene's lights and textures.");
}

void checkBlocking(const IrradianceVolume& volume, const std::string& path)
{
    for (std::size_t i = 0; i < volume.cellCount() && volume.hasBlocking(); ++i) {
        const auto id = static_cast<CellId>(i);
        if (isFinite(volume.blocking(id))) continue;
        throw Error(ErrorCode::Output,
            "Cannot write '" + path + "': grid '" + kBlockingGrid + "' of the cell at "
                + pointText(volume.cell(id).origin)
                + " is NaN or infinite; find the volume's geometry again.");
    }
}

void checkPlanes(const IrradianceVolume& volume, CellId id, const std::string& path)
{
    const CellVisibility* v = volume.visibility(id);
    if (!v) return;
    for (int k = 0; k < 3; ++k) {
        const bool finite = isFinite(v->normal[k]);
        if (finite && std::isfinite(v->offset[k])) continue;
        throw Error(ErrorCode::Output,
            "Cannot write '" + path + "': grid '" + (finite ? kWallOffsetGrid : kWallGrids[k])
                + "' of the cell at " + pointText(volume.cell(id).origin)
                + " is NaN or infinite; find the volume's visibility again.");
    }
}

void checkValues(const IrradianceVolume& volume, bool half, const std::string& path)
{
    const float limit = half ? kHalfMax : std::numeric_limits<float>::max();
    const std::size_t none = volume.sampleCount();
    const std::size_t first = tbb::parallel_reduce(
        tbb::blocked_range<std::size_t>(0, none, 1024), none,
        [&](const tbb::blocked_range<std::size_t>& range, std::size_t found) {
            for (std::size_t s = range.begin(); s < range.end() && s < found; ++s)
                if (!isSavable(volume, static_cast<SampleId>(s), limit)) found = s;
            return found;
        },
        [](std::size_t a, std::size_t b) { return std::min(a, b); });
    if (first != none) refuse(volume, static_cast<SampleId>(first), limit, path);
    for (std::size_t i = 0; i < volume.cellCount() && volume.hasVisibility(); ++i)
        checkPlanes(volume, static_cast<CellId>(i), path);
    checkBlocking(volume, path);
}

class VolumeSaver {
public:
    VolumeSaver(const IrradianceVolume& volume, const SaveOptions& options, VdbWriter& writer,
        Progress* progress)
        : mVolume(volume)
        , mOptions(options)
        , mWriter(writer)
        , mProgress(progress)
        , mMetadata(makeMetadata(volume))
        , mTransform(makeTransform(volume.indexToWorld()))
    {
    }

    void run()
    {
        if (mOptions.previewVoxel >= 0) writePreview();
        const openvdb::Int32Tree::Ptr source = makeSourceTree(mVolume);
        writeChannel(
            openvdb::Int32Grid::create(makeLevelTree(mVolume, *source)), kLevelGrid, Store::Full);
        // validity and distance stay full floats: rounding would move samples across the validity
        // threshold, and distances are not bounded by 65504.
        const auto scalar = [&](const char* name, const auto& value) {
            auto tree = makeScalarTree<openvdb::FloatTree>(*source, 0.0f, value);
            writeChannel(openvdb::FloatGrid::create(tree), name, Store::Full);
        };
        const IrradianceVolume& volume = mVolume;
        scalar(kValidityGrid,
            [&volume](std::int32_t s) { return volume.validity(static_cast<SampleId>(s)); });
        scalar(kDistanceGrid,
            [&volume](std::int32_t s) { return volume.distance(static_cast<SampleId>(s)); });
        writeColors(*source);
        writeOffsets(*source);
        writeBlocking(*source);
        if (!mVolume.hasVisibility()) return;
        forCutGrids(
            mVolume, *source, [this](const openvdb::GridBase::Ptr& grid, const std::string& name) {
                writeChannel(grid, name, Store::Full);
            });
    }

private:
    enum class Store { Full, AsOptions };

    void writePreview()
    {
        const PreviewGrids preview = makePreview(mVolume, mOptions.previewVoxel);
        writeGrid(*preview.color, Store::AsOptions);
        writeGrid(*preview.density, Store::AsOptions);
    }

    void writeColors(const openvdb::Int32Tree& source)
    {
        const auto channels = colorChannels(mVolume.bands(), mVolume.hasGradients());
        for (std::size_t begin = 0; begin < channels.size();) {
            std::vector<ColorChannel> group;
            for (std::size_t i = begin; i < channels.size() && group.size() < kGroup
                 && channels[i].gradient == channels[begin].gradient;
                 ++i)
                group.push_back(channels[i]);
            const auto trees = makeColorTrees(mVolume, source, group);
            for (std::size_t i = 0; i < group.size(); ++i) {
                const auto grid = openvdb::Vec3SGrid::create(trees[i]);
                grid->setVectorType(openvdb::VEC_INVARIANT);
                writeChannel(grid, group[i].name, Store::AsOptions);
            }
            begin += group.size();
        }
    }

    void writeOffsets(const openvdb::Int32Tree& source)
    {
        if (!mVolume.hasOffsets()) return;
        const IrradianceVolume& volume = mVolume;
        const auto grid = openvdb::Vec3SGrid::create(makeScalarTree<openvdb::Vec3STree>(
            source, openvdb::Vec3s(0.0f), [&volume](std::int32_t s) {
                const Vec3f o = volume.offset(static_cast<SampleId>(s));
                return openvdb::Vec3s(o.x, o.y, o.z);
            }));
        grid->setVectorType(openvdb::VEC_INVARIANT);
        writeChannel(grid, kOffsetGrid, Store::Full);
    }

    void writeBlocking(const openvdb::Int32Tree& source)
    {
        if (!mVolume.hasBlocking()) return;
        const IrradianceVolume& volume = mVolume;
        const openvdb::Int32Tree::Ptr cells = makeCellTree(volume, source);
        const auto grid = openvdb::Vec3SGrid::create(makeScalarTree<openvdb::Vec3STree>(
            *cells, openvdb::Vec3s(0.0f), [&volume](std::int32_t id) {
                const Vec3f b = id < 0 ? Vec3f(0.0f) : volume.blocking(id);
                return openvdb::Vec3s(b.x, b.y, b.z);
            }));
        grid->setVectorType(openvdb::VEC_INVARIANT);
        writeChannel(grid, kBlockingGrid, Store::Full);
    }

    void writeChannel(const openvdb::GridBase::Ptr& grid, const std::string& name, Store store)
    {
        grid->setName(name);
        grid->setTransform(mTransform);
        writeGrid(*grid, store);
    }

    void writeGrid(openvdb::GridBase& grid, Store store)
    {
        if (mProgress && mProgress->cancelled()) {
            throw Error(
                ErrorCode::Interrupted, "Interrupted while writing; the old file is untouched.");
        }
        grid.setCreator("lumivdb");
        grid.setSaveFloatAsHalf(store == Store::AsOptions && mOptions.half);
        grid.insertMeta(mMetadata);
        mWriter.add(grid);
        if (mProgress) mProgress->advance(1);
    }

    const IrradianceVolume& mVolume;
    const SaveOptions& mOptions;
    VdbWriter& mWriter;
    Progress* mProgress;
    openvdb::MetaMap mMetadata;
    openvdb::math::Transform::Ptr mTransform;
};

} // namespace

void saveVolume(const IrradianceVolume& volume, const std::string& path, const SaveOptions& options,
    Progress* progress)
{
    openvdb::initialize();
    if (std::isnan(options.previewVoxel))
        throw Error(ErrorCode::Usage, "The preview voxel size is NaN; give a length or 0.");
    checkValues(volume, options.half, path);
    const std::size_t grids = colorChannels(volume.bands(), volume.hasGradients()).size() + 3
        + (options.previewVoxel >= 0 ? 2 : 0) + (volume.hasOffsets() ? 1 : 0)
        + (volume.hasBlocking() ? 1 : 0) + (volume.hasVisibility() ? cutGridNames().size() : 0);
    if (progress) progress->begin("write volume", grids);
    try {
        VdbWriter writer(path, options.codec, static_cast<int>(grids), progress);
        VolumeSaver(volume, options, writer, progress).run();
        writer.finish();
    } catch (const Error&) {
        throw;
    } catch (const std::bad_alloc&) {
        throw Error(ErrorCode::Output,
            "Cannot write '" + path + "': out of memory; choose a coarser spacing or fewer bands.");
    } catch (const std::exception& e) {
        throw Error(ErrorCode::Output,
            "Cannot write '" + path + "': " + e.what() + "; the old file is untouched.");
    }
}

} // namespace lumivdb
