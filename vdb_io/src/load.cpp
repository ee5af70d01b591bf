// SPDX-License-Identifier: Apache-2.0
#include "load.h"

#include "archive.h"

#include <lumivdb/core/error.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>

#include <unistd.h>

namespace lumivdb {

using openvdb::Int32Tree;

namespace {

constexpr std::uint64_t kMaxCells = std::uint64_t{1} << 31;

/// The cells of one level whose origin lies in a box: one every 2^level steps from @a first on.
struct CellsInBox {
    openvdb::Coord first;
    std::uint64_t count = 0;
};

CellsInBox cellsIn(const openvdb::CoordBBox& box, int level)
{
    const int size = 1 << level;
    CellsInBox cells;
    std::uint64_t count = 1;
    for (int a = 0; a < 3; ++a) {
        const std::int64_t aligned = (std::int64_t{box.min()[a]} + size - 1) & -std::int64_t{size};
        if (aligned > box.max()[a]) return cells;
        cells.first[a] = static_cast<int>(aligned);
        count *= static_cast<std::uint64_t>((box.max()[a] - aligned) / size + 1);
    }
    cells.count = count;
    return cells;
}

void addCells(VolumeBuilder& builder, const openvdb::CoordBBox& box, int level)
{
    const CellsInBox cells = cellsIn(box, level);
    if (cells.count == 0) return;
    const openvdb::Coord& first = cells.first;
    const int size = 1 << level;
    // 64-bit counters: the last step may pass the largest lattice point.
    for (std::int64_t x = first.x(); x <= box.max().x(); x += size)
        for (std::int64_t y = first.y(); y <= box.max().y(); y += size)
            for (std::int64_t z = first.z(); z <= box.max().z(); z += size)
                builder.addCell(
                    Coord(static_cast<int>(x), static_cast<int>(y), static_cast<int>(z)), level);
}

/// Of this machine, in bytes; without end where the system does not say.
std::uint64_t physicalMemory()
{
    const long pages = ::sysconf(_SC_PHYS_PAGES), pageBytes = ::sysconf(_SC_PAGESIZE);
    if (pages <= 0 || pageBytes <= 0) return std::numeric_limits<std::uint64_t>::max();
    return static_cast<std::uint64_t>(pages) * static_cast<std::uint64_t>(pageBytes);
}

std::string withoutStop(std::string text)
{
    while (!text.empty() && text.back() == '.') text.pop_back();
    return text;
}

} // namespace

VolumeLoader::VolumeLoader(const std::string& path, Progress* progress)
    : mPath(path)
    , mProgress(progress)
{
}

bool VolumeLoader::isChannel(const std::string& name)
{
    return name == kLevelGrid || name == kValidityGrid || name == kDistanceGrid
        || name == kOffsetGrid || name == kBlockingGrid || CutReader::isGrid(name)
        || name.rfind("sh_", 0) == 0;
}

void VolumeLoader::fail(const std::string& sentence) const
{
    throw Error(ErrorCode::Input, sentence);
}

std::string VolumeLoader::where(const std::string& name) const
{
    return "Grid '" + name + "' of '" + mPath + "'";
}

void VolumeLoader::add(const openvdb::GridBase::Ptr& grid)
{
    const std::string name = grid->getName();
    if (mProgress && mProgress->cancelled())
        throw Error(ErrorCode::Interrupted, "Interrupted while reading '" + mPath + "'.");
    const FileMetadata metadata = parseMetadata(*grid, where(name));
    if (!mSeen.insert(name).second)
        fail(where(name) + " is there twice; keep one grid of each name.");
    if (name == kLevelGrid) {
        mFile = metadata;
        makeVolume(*grid);
        takePending();
    } else if (mVolume) {
        take(grid);
    } else {
        mPending.push_back(grid);
    }
}

void VolumeLoader::makeVolume(const openvdb::GridBase& grid)
{
    const auto* level = dynamic_cast<const openvdb::Int32Grid*>(&grid);
    if (!level) fail(where(kLevelGrid) + " has type " + grid.valueType() + " instead of int32.");
    if (!grid.transform().isLinear())
        fail(where(kLevelGrid) + " has a perspective transform; a linear one is needed.");
    mMetadata = grid;
    mIndexToWorld = matrixOf(grid.transform());
    try {
        VolumeBuilder builder(mFile.bands,
            mFile.gradients ? GradientStorage::PerCoefficient : GradientStorage::None,
            mIndexToWorld);
        requireMemory(countCells(level->tree()));
        for (auto it = level->tree().cbeginValueOn(); it; ++it)
            if (*it >= 0) addCells(builder, it.getBoundingBox(), *it);
        mVolume.emplace(builder.build());
    } catch (const Error& e) {
        if (e.code() == ErrorCode::Input) throw;
        fail(where(kLevelGrid) + " does not form a valid volume: " + withoutStop(e.what()) + ".");
    }
    mVolume->metadata() = mFile.volume;
    mSource = makeSourceTree(*mVolume);
    checkLevels(level->tree());
    mSlots = std::make_unique<SampleSlots>(*mVolume, *mSource);
    mChannels = colorChannels(mFile.bands, mFile.gradients);
    if (mProgress) {
        mProgress->begin("read volume",
            mChannels.size() + 3 + (mFile.movedSamples ? 1 : 0) + (mFile.blockedCells ? 1 : 0)
                + (mFile.cutCells > 0 ? cutGridNames().size() : 0));
    }
    if (mProgress) mProgress->advance(1);
}

std::uint64_t VolumeLoader::countCells(const Int32Tree& level) const
{
    std::uint64_t cells = 0;
    for (auto it = level.cbeginValueOn(); it; ++it) {
        const int k = *it;
        if (k < -1 || k > kMaxLevel) {
            fail(where(kLevelGrid) + " holds the level " + std::to_string(k) + " at lattice point "
                + pointText(fromVdb(it.getCoord())) + "; −1 to 12 are possible.");
        }
        if (k >= 0) cells += cellsIn(it.getBoundingBox(), k).count;
        if (cells > kMaxCells) fail(where(kLevelGrid) + " has more than 2^31 cells.");
    }
    return cells;
}

/// A few bytes of tiles can stand for any number of cells. Their origins are so many samples.
void VolumeLoader::requireMemory(std::uint64_t cells) const
{
    const int colors = mFile.bands * mFile.bands * (mFile.gradients ? 4 : 1);
    const std::uint64_t sampleBytes
        = static_cast<std::uint64_t>(colors) * sizeof(Color) + 2 * sizeof(float) + sizeof(Coord);
    const std::uint64_t bytes = cells * (sizeof(Cell) + sampleBytes);
    if (bytes > physicalMemory()) {
        fail(where(kLevelGrid) + " has " + std::to_string(cells) + " cells, which take "
            + std::to_string(bytes >> 30) + " GiB or more: this machine has less.");
    }
}

void VolumeLoader::checkLevels(const Int32Tree& level) const
{
    const auto refuse = [this](const openvdb::Coord& p) {
        fail(where(kLevelGrid) + " does not form a valid volume: the voxel " + pointText(fromVdb(p))
            + " does not fit the cells around it.");
    };
    if (!sameVoxels(level, *mSource))
        fail(where(kLevelGrid)
            + " does not form a valid volume: its active voxels are not its cells and their"
              " samples.");
    // Nodes of the two trees nest, so comparing at the lower corner of every value of both finds
    // every difference.
    const Int32Tree::Ptr expected = makeLevelTree(*mVolume, *mSource);
    const Int32Tree* const trees[2] = {&level, expected.get()};
    for (int side = 0; side < 2; ++side) {
        openvdb::tree::ValueAccessor<const Int32Tree> other(*trees[1 - side]);
        for (auto it = trees[side]->cbeginValueOn(); it; ++it)
            if (other.getValue(it.getCoord()) != *it) refuse(it.getCoord());
    }
}

void VolumeLoader::takePending()
{
    for (const openvdb::GridBase::Ptr& grid : mPending) take(grid);
    mPending.clear();
}

void VolumeLoader::take(const openvdb::GridBase::ConstPtr& pointer)
{
    const openvdb::GridBase& grid = *pointer;
    const std::string name = grid.getName();
    const auto channel = std::find_if(mChannels.begin(), mChannels.end(),
        [&name](const ColorChannel& c) { return c.name == name; });
    if (channel != mChannels.end()) {
        takeColors(grid, *channel);
    } else if (name == kValidityGrid || name == kDistanceGrid) {
        takeScalars(grid);
    } else if (name == kOffsetGrid) {
        takeOffsets(grid);
    } else if (name == kBlockingGrid) {
        takeBlocking(grid);
    } else if (CutReader::isGrid(name)) {
        takeCut(pointer);
    }
    if (mProgress) mProgress->advance(1);
}

void VolumeLoader::checkChannel(const openvdb::GridBase& grid) const
{
    const std::string name = grid.getName();
    const std::string different = metadataDifference(grid, mMetadata);
    if (!different.empty()) {
        fail(where(name) + " and grid 'level' differ in '" + different
            + "': they come from different volumes.");
    }
    if (!grid.transform().isLinear() || matrixOf(grid.transform()) != mIndexToWorld)
        fail(where(name) + " and grid 'level' have different transforms; keep them the same.");
}

void VolumeLoader::takeColors(const openvdb::GridBase& grid, const ColorChannel& channel)
{
    checkChannel(grid);
    const auto* colors = dynamic_cast<const openvdb::Vec3SGrid*>(&grid);
    if (!colors) fail(where(channel.name) + " has type " + grid.valueType() + " instead of vec3s.");
    if (!sameVoxels(colors->tree(), *mSource))
        fail(where(channel.name) + " and grid 'level' have different active voxels.");
    std::atomic<std::uint64_t> bad{std::numeric_limits<std::uint64_t>::max()};
    IrradianceVolume& volume = *mVolume;
    mSlots->forSamples(colors->tree(), [&](SampleId s, const openvdb::Vec3s& v) {
        if (!std::isfinite(v.x()) || !std::isfinite(v.y()) || !std::isfinite(v.z())) {
            std::uint64_t seen = bad;
            while (s < seen && !bad.compare_exchange_weak(seen, s)) { }
        }
        Color* record = channel.gradient ? volume.gradient(s) : volume.radiance(s);
        record[channel.offset] = Color(v.x(), v.y(), v.z());
    });
    if (bad < volume.sampleCount()) {
        const auto s = static_cast<SampleId>(bad);
        fail(where(channel.name) + " is NaN or infinite at lattice point "
            + pointText(volume.samplePosition(s)) + "; bake it again.");
    }
}

void VolumeLoader::takeScalars(const openvdb::GridBase& grid)
{
    checkChannel(grid);
    const std::string name = grid.getName();
    const auto* scalars = dynamic_cast<const openvdb::FloatGrid*>(&grid);
    if (!scalars) fail(where(name) + " has type " + grid.valueType() + " instead of float.");
    if (!sameVoxels(scalars->tree(), *mSource))
        fail(where(name) + " and grid 'level' have different active voxels.");
    std::atomic<bool> bad{false};
    IrradianceVolume& volume = *mVolume;
    const bool isValidity = name == kValidityGrid;
    mSlots->forSamples(scalars->tree(), [&](SampleId s, float v) {
        if (isValidity ? !std::isfinite(v) : !(v >= 0)) bad = true;
        (isValidity ? volume.validity(s) : volume.distance(s)) = v;
    });
    if (bad) fail(where(name) + " holds NaN or an impossible value; bake it again.");
}

void VolumeLoader::takeOffsets(const openvdb::GridBase& grid)
{
    checkChannel(grid);
    const auto* vectors = dynamic_cast<const openvdb::Vec3SGrid*>(&grid);
    if (!vectors) fail(where(kOffsetGrid) + " has type " + grid.valueType() + " instead of vec3s.");
    if (!sameVoxels(vectors->tree(), *mSource))
        fail(where(kOffsetGrid) + " and grid 'level' have different active voxels.");
    std::vector<Vec3f> offsets(mVolume->sampleCount());
    std::atomic<bool> bad{false};
    mSlots->forSamples(vectors->tree(), [&](SampleId s, const openvdb::Vec3s& v) {
        offsets[s] = Vec3f(v.x(), v.y(), v.z());
        if (!std::isfinite(v.x()) || !std::isfinite(v.y()) || !std::isfinite(v.z())) bad = true;
    });
    if (bad) fail(where(kOffsetGrid) + " is NaN or infinite somewhere; bake it again.");
    mVolume->setOffsets(std::move(offsets));
}

void VolumeLoader::takeBlocking(const openvdb::GridBase& grid)
{
    checkChannel(grid);
    const auto* vectors = dynamic_cast<const openvdb::Vec3SGrid*>(&grid);
    if (!vectors)
        fail(where(kBlockingGrid) + " has type " + grid.valueType() + " instead of vec3s.");
    if (!sameVoxels(vectors->tree(), *mSource))
        fail(where(kBlockingGrid) + " and grid 'level' have different active voxels.");
    std::vector<Vec3f> blocking(mVolume->cellCount());
    openvdb::tree::ValueAccessor<const openvdb::Vec3STree> access(vectors->tree());
    for (std::size_t i = 0; i < blocking.size(); ++i) {
        const Coord origin = mVolume->cell(static_cast<CellId>(i)).origin;
        const openvdb::Vec3s v = access.getValue(toVdb(origin));
        if (!std::isfinite(v.x()) || !std::isfinite(v.y()) || !std::isfinite(v.z())) {
            fail(where(kBlockingGrid) + " is NaN or infinite at lattice point " + pointText(origin)
                + "; bake it again.");
        }
        blocking[i] = Vec3f(v.x(), v.y(), v.z());
    }
    mVolume->setBlocking(std::move(blocking));
}

void VolumeLoader::takeCut(const openvdb::GridBase::ConstPtr& grid)
{
    const std::string name = grid->getName();
    checkChannel(*grid);
    const std::string wrong = mCuts.add(grid);
    if (!wrong.empty()) fail(where(name) + " " + wrong + ".");
    const auto* masks = dynamic_cast<const openvdb::Int32Grid*>(grid.get());
    const auto* vectors = dynamic_cast<const openvdb::Vec3SGrid*>(grid.get());
    if (masks ? !sameVoxels(masks->tree(), *mSource) : !sameVoxels(vectors->tree(), *mSource))
        fail(where(name) + " and grid 'level' have different active voxels.");
}

/// Without these grids a volume would leak, so that a file that says it has them must.
void VolumeLoader::applyCuts()
{
    if (!mCuts.any() && mFile.cutCells == 0) return;
    for (const std::string& name : cutGridNames())
        if (!mCuts.has(name)) fail(where(name) + " is missing; bake it again.");
    const std::int64_t cut
        = mCuts.apply(*mVolume, [this](const std::string& name, const Coord& origin) {
              fail(where(name) + " is NaN or infinite at lattice point " + pointText(origin)
                  + "; bake it again.");
          });
    if (cut != mFile.cutCells) {
        fail(where(kMaskGrids[0]) + " and its neighbours divide " + std::to_string(cut)
            + " cells where 'lumivdb_cut_cells' says " + std::to_string(mFile.cutCells)
            + "; bake it again.");
    }
}

void VolumeLoader::checkMoved() const
{
    if (mFile.movedSamples.has_value() != mVolume->hasOffsets()) {
        fail(mFile.movedSamples ? where(kOffsetGrid) + " is missing; bake it again."
                                : where(kOffsetGrid)
                    + " is there without the metadata 'lumivdb_moved_samples'; bake it again.");
    }
    std::int64_t moved = 0;
    for (std::size_t s = 0; s < mVolume->sampleCount() && mFile.movedSamples; ++s)
        moved += mVolume->offset(static_cast<SampleId>(s)) != Vec3f(0.0f);
    if (moved != mFile.movedSamples.value_or(0)) {
        fail(where(kOffsetGrid) + " moves " + std::to_string(moved)
            + " samples where 'lumivdb_moved_samples' says " + std::to_string(*mFile.movedSamples)
            + "; bake it again.");
    }
}

void VolumeLoader::checkBlocked() const
{
    if (mFile.blockedCells.has_value() != mVolume->hasBlocking()) {
        fail(mFile.blockedCells ? where(kBlockingGrid) + " is missing; bake it again."
                                : where(kBlockingGrid)
                    + " is there without the metadata 'lumivdb_blocked_cells'; bake it again.");
    }
    std::int64_t blocked = 0;
    for (std::size_t i = 0; i < mVolume->cellCount(); ++i)
        blocked += mVolume->blocking(static_cast<CellId>(i)) != Vec3f(0.0f);
    if (blocked != mFile.blockedCells.value_or(0)) {
        fail(where(kBlockingGrid) + " blocks " + std::to_string(blocked)
            + " cells where 'lumivdb_blocked_cells' says " + std::to_string(*mFile.blockedCells)
            + "; bake it again.");
    }
}

IrradianceVolume VolumeLoader::finish()
{
    if (mSeen.empty()) {
        fail("'" + mPath
            + "' has no LumiVDB metadata: it is not an irradiance volume that lumivdb wrote.");
    }
    const auto require = [this](const std::string& name) {
        if (mSeen.count(name) == 0) fail(where(name) + " is missing; bake it again.");
    };
    require(kLevelGrid);
    require(kValidityGrid);
    require(kDistanceGrid);
    for (const ColorChannel& channel : mChannels) require(channel.name);
    applyCuts();
    checkMoved();
    checkBlocked();
    mSlots.reset();
    return std::move(*mVolume);
}

IrradianceVolume loadVolume(const std::string& path, Progress* progress)
{
    VolumeLoader loader(path, progress);
    readVdb(
        path,
        [](const std::string& name, const std::string&) {
            return VolumeLoader::isChannel(name) ? GridUse::Read : GridUse::Skip;
        },
        [&loader](const openvdb::GridBase::Ptr& grid) { loader.add(grid); });
    return loader.finish();
}

} // namespace lumivdb
