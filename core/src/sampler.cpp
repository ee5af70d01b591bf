// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/sampler.h>

#include <lumivdb/core/error.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace lumivdb {

namespace {

constexpr int kBlockLog2 = 3;
constexpr int kBlockSize = 1 << kBlockLog2;
constexpr int kBlockVoxels = kBlockSize * kBlockSize * kBlockSize;
constexpr std::int32_t kEmptyBlock = -1;
/// The flat table may have this many 8³ blocks, or kBlocksPerCell for each cell where that is
/// more. Beyond, it would outgrow the volume's records; the index tree answers then.
constexpr std::int64_t kMinBlocks = std::int64_t{1} << 20;
constexpr std::int64_t kBlocksPerCell = 32;
/// Points this close to an outer face, in lattice steps, count as on it.
constexpr double kFaceTolerance = 1e-6;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

Coord blockOf(const Coord& voxel)
{
    return {voxel.x >> kBlockLog2, voxel.y >> kBlockLog2, voxel.z >> kBlockLog2};
}

int voxelInBlock(const Coord& v)
{
    constexpr int mask = kBlockSize - 1;
    return ((v.x & mask) << (2 * kBlockLog2)) | ((v.y & mask) << kBlockLog2) | (v.z & mask);
}

} // namespace

const char* name(Interpolation mode)
{
    switch (mode) {
    case Interpolation::Nearest:
        return "nearest";
    case Interpolation::Taylor:
        return "taylor";
    case Interpolation::Trilinear:
        return "trilinear";
    case Interpolation::Gradient:
        return "gradient";
    case Interpolation::InverseDistance:
        return "idw";
    }
    return "trilinear";
}

bool needsGradients(Interpolation mode)
{
    return mode == Interpolation::Taylor || mode == Interpolation::Gradient;
}

struct VolumeSampler::Corners {
    int count = 0;
    SampleId sample[8];
    float weight[8];
};

Interpolation VolumeSampler::bestMode(const IrradianceVolume& volume)
{
    return volume.hasGradients() ? Interpolation::Gradient : Interpolation::Trilinear;
}

VolumeSampler::VolumeSampler(const IrradianceVolume& volume, Interpolation mode)
    : mVolume(volume)
    , mMode(mode)
{
    if (needsGradients(mode) && !volume.hasGradients()) {
        throw Error(ErrorCode::Usage,
            std::string("Interpolation mode '") + name(mode)
                + "' needs gradients and the volume has none; bake it with gradients or take "
                  "'trilinear'.");
    }
    // maxLattice is the last sample; the last cell begins one step before it.
    mBlockMin = blockOf(volume.minLattice());
    mBlockDim = blockOf(volume.maxLattice() - Coord(1)) - mBlockMin + Coord(1);
    const std::int64_t blocks = std::int64_t{mBlockDim.x} * mBlockDim.y * mBlockDim.z;
    if (blocks
        > std::max(kMinBlocks, kBlocksPerCell * static_cast<std::int64_t>(volume.cellCount()))) {
        return;
    }
    mBlocks.assign(static_cast<std::size_t>(blocks), kEmptyBlock);
    const auto blockAt = [&](const Coord& b) -> std::int32_t& {
        const Coord r = b - mBlockMin;
        return mBlocks[(static_cast<std::size_t>(r.x) * mBlockDim.y + r.y) * mBlockDim.z + r.z];
    };
    const auto cells = static_cast<CellId>(volume.cellCount());
    for (CellId id = 0; id < cells; ++id) {
        const Cell& cell = volume.cell(id);
        const Coord lower = blockOf(cell.origin);
        if (cell.level >= kBlockLog2) {
            const int n = 1 << (cell.level - kBlockLog2);
            for (int x = 0; x < n; ++x)
                for (int y = 0; y < n; ++y)
                    for (int z = 0; z < n; ++z) blockAt(lower + Coord(x, y, z)) = -2 - id;
            continue;
        }
        std::int32_t& block = blockAt(lower);
        if (block == kEmptyBlock) {
            block = static_cast<std::int32_t>(mCells.size() / kBlockVoxels);
            mCells.resize(mCells.size() + kBlockVoxels, kNoCell);
        }
        CellId* ids = mCells.data() + static_cast<std::size_t>(block) * kBlockVoxels;
        const int n = 1 << cell.level;
        for (int x = 0; x < n; ++x)
            for (int y = 0; y < n; ++y)
                for (int z = 0; z < n; ++z) ids[voxelInBlock(cell.origin + Coord(x, y, z))] = id;
    }
}

VolumeSampler::~VolumeSampler() = default;

std::size_t VolumeSampler::memoryBytes() const
{
    return mBlocks.size() * sizeof(std::int32_t) + mCells.size() * sizeof(CellId);
}

CellId VolumeSampler::findCell(const Coord& voxel) const
{
    if (mBlocks.empty()) return mVolume.findCell(voxel);
    const Coord r = blockOf(voxel) - mBlockMin;
    if (r.x < 0 || r.y < 0 || r.z < 0 || r.x >= mBlockDim.x || r.y >= mBlockDim.y
        || r.z >= mBlockDim.z) {
        return kNoCell;
    }
    const std::int32_t block
        = mBlocks[(static_cast<std::size_t>(r.x) * mBlockDim.y + r.y) * mBlockDim.z + r.z];
    if (block >= 0) {
        return mCells[static_cast<std::size_t>(block) * kBlockVoxels + voxelInBlock(voxel)];
    }
    return block == kEmptyBlock ? kNoCell : -2 - block;
}

namespace {

/// The voxels a point belongs to where it lies on a face: itself first, then the neighbours.
template <class Find> CellId findOnFaces(const Vec3d& p, const Find& find)
{
    int candidates[3][2];
    int count[3];
    for (int a = 0; a < 3; ++a) {
        const double nearest = std::round(p[a]);
        candidates[a][0] = static_cast<int>(std::floor(p[a]));
        count[a] = 1;
        if (std::abs(p[a] - nearest) < kFaceTolerance) {
            const int below = static_cast<int>(nearest) - 1;
            candidates[a][1] = candidates[a][0] == below ? below + 1 : below;
            count[a] = 2;
        }
    }
    for (int x = 0; x < count[0]; ++x)
        for (int y = 0; y < count[1]; ++y)
            for (int z = 0; z < count[2]; ++z) {
                const CellId id = find(Coord(candidates[0][x], candidates[1][y], candidates[2][z]));
                if (id != kNoCell) return id;
            }
    return kNoCell;
}

/// Weights of the eight corners at t ∈ [0,1]³, before validity is considered.
void cornerWeights(Interpolation mode, const Vec3d& t, float* weight)
{
    const double u[3][2] = {{1 - t.x, t.x}, {1 - t.y, t.y}, {1 - t.z, t.z}};
    for (int i = 0; i < 8; ++i) {
        if (mode == Interpolation::InverseDistance) {
            const double dx = i & 1 ? u[0][0] : u[0][1], dy = i & 2 ? u[1][0] : u[1][1],
                         dz = i & 4 ? u[2][0] : u[2][1];
            // 1e-12 in cell widths: at a corner its own sample takes all the weight.
            weight[i] = static_cast<float>(1.0 / (std::sqrt(dx * dx + dy * dy + dz * dz) + 1e-12));
        } else {
            weight[i] = static_cast<float>(u[0][i & 1] * u[1][i >> 1 & 1] * u[2][i >> 2 & 1]);
        }
    }
}

/// The corner nearest to t among those of @a mask.
int nearestCorner(const Vec3d& t, unsigned mask)
{
    int best = 0;
    double bestDistance = std::numeric_limits<double>::infinity();
    for (int i = 0; i < 8; ++i) {
        if (!(mask >> i & 1)) continue;
        const Vec3d d = t - Vec3d(i & 1, i >> 1 & 1, i >> 2 & 1);
        if (d.length2() < bestDistance) {
            bestDistance = d.length2();
            best = i;
        }
    }
    return best;
}

} // namespace

QueryInfo VolumeSampler::locate(const Vec3d& world, Corners& corners) const
{
    QueryInfo info;
    corners.count = 0;
    const Vec3d p = world * mVolume.worldToIndex();
    // Beyond any lattice (or NaN): outside, before a cast could overflow.
    constexpr double kLimit = 2147483000.0;
    if (!(std::abs(p.x) < kLimit && std::abs(p.y) < kLimit && std::abs(p.z) < kLimit)) return info;
    const Coord voxel(static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
        static_cast<int>(std::floor(p.z)));
    CellId id = findCell(voxel);
    if (id == kNoCell) id = findOnFaces(p, [&](const Coord& v) { return findCell(v); });
    if (id == kNoCell) return info;

    const Cell& cell = mVolume.cell(id);
    const double inverse = 1.0 / static_cast<double>(1 << cell.level);
    Vec3d t = (p - Vec3d(cell.origin.x, cell.origin.y, cell.origin.z)) * inverse;
    for (int a = 0; a < 3; ++a) t[a] = std::clamp(t[a], 0.0, 1.0);

    float linear[8];
    cornerWeights(Interpolation::Trilinear, t, linear);
    unsigned valid = 0;
    info.level = cell.level;
    for (int i = 0; i < 8; ++i) {
        info.validity += linear[i] * mVolume.validity(cell.corners[i]);
        if (mVolume.isValid(cell.corners[i])) valid |= 1u << i;
    }
    if (valid == 0) valid = 0xff; // nothing better here; info.validity says so

    float weight[8];
    cornerWeights(mMode, t, weight);
    float sum = 0;
    for (int i = 0; i < 8; ++i) {
        if (valid >> i & 1) sum += weight[i];
    }
    const bool single
        = mMode == Interpolation::Nearest || mMode == Interpolation::Taylor || !(sum > 1e-6f);
    if (single) {
        corners.count = 1;
        corners.sample[0] = cell.corners[nearestCorner(t, valid)];
        corners.weight[0] = 1.0f;
        return info;
    }
    const float scale = 1.0f / sum;
    for (int i = 0; i < 8; ++i) {
        if (!(valid >> i & 1) || weight[i] == 0) continue;
        corners.sample[corners.count] = cell.corners[i];
        corners.weight[corners.count++] = weight[i] * scale;
    }
    return info;
}

QueryInfo VolumeSampler::radiance(const Vec3d& p, Color* L) const
{
    Corners corners;
    const QueryInfo info = locate(p, corners);
    const int n = mVolume.coefficients();
    if (info.level < 0) {
        std::fill(L, L + n, Color(kNan));
        return info;
    }
    std::fill(L, L + n, Color(0.0f));
    for (int c = 0; c < corners.count; ++c) {
        const Color* value = mVolume.radiance(corners.sample[c]);
        const float w = corners.weight[c];
        for (int i = 0; i < n; ++i) L[i] += value[i] * w;
        if (!needsGradients(mMode)) continue;
        const Vec3d d = p - mVolume.sampleWorld(corners.sample[c]);
        const Color* gradient = mVolume.gradient(corners.sample[c]);
        for (int a = 0; a < 3; ++a) {
            const float wd = w * static_cast<float>(d[a]);
            for (int i = 0; i < n; ++i) L[i] += gradient[a * n + i] * wd;
        }
    }
    return info;
}

Color VolumeSampler::irradiance(const Vec3d& p, const Vec3f& n, QueryInfo* info) const
{
    Color L[kMaxCoefficients];
    const QueryInfo found = radiance(p, L);
    if (info) *info = found;
    return found.level < 0 ? Color(kNan) : lumivdb::irradiance(mVolume.bands(), L, n);
}

void VolumeSampler::irradiance(
    std::size_t count, const Vec3d* p, const Vec3f* n, Color* E, QueryInfo* info) const
{
    for (std::size_t i = 0; i < count; ++i)
        E[i] = irradiance(p[i], n[i], info ? info + i : nullptr);
}

} // namespace lumivdb
