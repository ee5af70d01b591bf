// SPDX-License-Identifier: Apache-2.0
#include "preview.h"

#include "channels.h"
#include "transfer.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/sampler.h>
#include <lumivdb/core/volume_grid.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

constexpr double kMaxVoxels = 16777216.0; // 2^24
/// An adaptive volume's finest spacing would make a preview far larger than the volume itself.
constexpr double kFewVoxels = 262144.0; // 2^18
constexpr double kVoxelsPerSample = 8;
constexpr float kMeanFactor = 0.28209479177387814f; // Y0

/// The first band alone: E averaged over normals / π = π L00 Y00 / π = L00 Y00 needs no more.
IrradianceVolume meanVolume(const IrradianceVolume& volume)
{
    IrradianceVolume mean = volume.cloneTopology(1, GradientStorage::None);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        mean.radiance(s)[0] = volume.radiance(s)[0] * kMeanFactor;
        mean.validity(s) = volume.validity(s);
    }
    return mean;
}

/// Touches the leaves of preview voxels whose centres lie in the lattice box [@a box.min(), @a
/// box.max() + 1]: a preview voxel spans @a step lattice steps, voxel i is centred at step · (i +
/// ½).
void touchLeaves(openvdb::MaskTree& leaves, const openvdb::CoordBBox& box, double step)
{
    openvdb::Coord lo, hi;
    for (int a = 0; a < 3; ++a) {
        lo[a] = static_cast<int>(std::ceil(box.min()[a] / step - 0.5)) & ~7;
        hi[a] = static_cast<int>(std::floor((box.max()[a] + 1.0) / step - 0.5)) | 7;
    }
    for (int x = lo.x(); x < hi.x(); x += 8)
        for (int y = lo.y(); y < hi.y(); y += 8)
            for (int z = lo.z(); z < hi.z(); z += 8) leaves.touchLeaf({x, y, z});
}

openvdb::MaskTree coveredLeaves(const IrradianceVolume& volume, double step)
{
    openvdb::MaskTree leaves;
    const openvdb::Int32Tree& index = indexGrid(volume).tree();
    auto tile = index.cbeginValueOn();
    tile.setMaxDepth(openvdb::Int32Tree::ValueOnCIter::LEAF_DEPTH - 1);
    for (; tile; ++tile) touchLeaves(leaves, tile.getBoundingBox(), step);
    for (const auto* leaf : leavesOf(index)) {
        openvdb::CoordBBox box;
        leaf->evalActiveBoundingBox(box);
        touchLeaves(leaves, box, step);
    }
    return leaves;
}

double latticeVoxels(const IrradianceVolume& volume)
{
    double voxels = 0;
    const auto levels = volume.cellsByLevel();
    for (std::size_t k = 0; k < levels.size(); ++k)
        voxels += static_cast<double>(levels[k]) * std::pow(8.0, static_cast<double>(k));
    return voxels;
}

/// Preview voxel size in lattice steps.
double chooseStep(const IrradianceVolume& volume, double voxel)
{
    const double voxels = latticeVoxels(volume);
    if (voxel > 0) {
        const double step = voxel / volume.spacing();
        if (voxels / (step * step * step) > 2147483648.0) {
            throw Error(ErrorCode::Usage,
                "A preview voxel of " + std::to_string(voxel)
                    + " world units makes more than 2^31 voxels; choose a larger one.");
        }
        return step;
    }
    double step = 1;
    const double limit = std::min(kMaxVoxels,
        std::max(kFewVoxels, kVoxelsPerSample * static_cast<double>(volume.sampleCount())));
    while (voxels / (step * step * step) > limit) step *= 2;
    return step;
}

Mat4d previewTransform(const IrradianceVolume& volume, double step)
{
    Mat4d toLattice;
    toLattice.setScale(Vec3d(step));
    toLattice[3][0] = toLattice[3][1] = toLattice[3][2] = 0.5 * step;
    return toLattice * volume.indexToWorld();
}

void fillLeaf(const VolumeSampler& sampler, const Mat4d& toWorld,
    openvdb::Vec3STree::LeafNodeType& color, openvdb::FloatTree::LeafNodeType& density)
{
    for (openvdb::Index n = 0; n < openvdb::FloatTree::LeafNodeType::SIZE; ++n) {
        const openvdb::Coord p = density.offsetToGlobalCoord(n);
        Vec3d world;
        toWorld.multVecMatrix(Vec3d(p.x(), p.y(), p.z()), world);
        Color value;
        if (sampler.radiance(world, &value).level < 0) continue;
        color.setValueOn(n, openvdb::Vec3s(value.x, value.y, value.z));
        density.setValueOn(n, std::max(0.0f, luminance(value)));
    }
}

} // namespace

PreviewGrids makePreview(const IrradianceVolume& volume, double voxel)
{
    const double step = chooseStep(volume, voxel);
    const Mat4d toWorld = previewTransform(volume, step);
    const IrradianceVolume mean = meanVolume(volume);
    const VolumeSampler sampler(mean);
    const openvdb::MaskTree leaves = coveredLeaves(volume, step);

    PreviewGrids grids;
    grids.color = openvdb::Vec3SGrid::create(std::make_shared<openvdb::Vec3STree>(
        leaves, openvdb::Vec3s(0.0f), openvdb::TopologyCopy()));
    grids.density = openvdb::FloatGrid::create(
        std::make_shared<openvdb::FloatTree>(leaves, 0.0f, openvdb::TopologyCopy()));
    const auto colorLeaves = leavesOf(grids.color->tree());
    const auto densityLeaves = leavesOf(grids.density->tree());
    tbb::parallel_for(std::size_t{0}, densityLeaves.size(),
        [&](std::size_t i) { fillLeaf(sampler, toWorld, *colorLeaves[i], *densityLeaves[i]); });
    grids.color->setName(kColorGrid);
    grids.color->setVectorType(openvdb::VEC_INVARIANT);
    grids.color->setTransform(makeTransform(toWorld));
    grids.density->setName(kDensityGrid);
    grids.density->setGridClass(openvdb::GRID_FOG_VOLUME);
    grids.density->setTransform(makeTransform(toWorld));
    return grids;
}

} // namespace lumivdb
