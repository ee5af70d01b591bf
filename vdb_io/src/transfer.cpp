// SPDX-License-Identifier: Apache-2.0
#include "transfer.h"

namespace lumivdb {

using openvdb::Int32Tree;
using openvdb::Vec3STree;

namespace {

openvdb::Vec3s toVec3s(const Color& c) { return {c.x, c.y, c.z}; }

const Color* recordOf(const IrradianceVolume& volume, bool gradient, std::int32_t sample)
{
    const auto id = static_cast<SampleId>(sample);
    return gradient ? volume.gradient(id) : volume.radiance(id);
}

} // namespace

std::vector<Vec3STree::Ptr> makeColorTrees(const IrradianceVolume& volume, const Int32Tree& source,
    const std::vector<ColorChannel>& channels)
{
    constexpr auto kVoxels = Int32Tree::LeafNodeType::SIZE;
    const bool gradient = channels.front().gradient;
    std::vector<Vec3STree::Ptr> trees(channels.size());
    std::vector<std::vector<Vec3STree::LeafNodeType*>> leaves(channels.size());
    tbb::parallel_for(std::size_t{0}, channels.size(), [&](std::size_t c) {
        trees[c]
            = std::make_shared<Vec3STree>(source, openvdb::Vec3s(0.0f), openvdb::TopologyCopy());
        leaves[c] = leavesOf(*trees[c]);
        forTiles(*trees[c], source, [&](auto& tile, std::int32_t s) {
            tile.setValue(toVec3s(recordOf(volume, gradient, s)[channels[c].offset]));
        });
    });
    const auto from = leavesOf(source);
    tbb::parallel_for(std::size_t{0}, from.size(), [&](std::size_t i) {
        const Color* records[kVoxels];
        openvdb::Index offsets[kVoxels];
        int count = 0;
        for (auto it = from[i]->cbeginValueOn(); it; ++it) {
            offsets[count] = it.pos();
            records[count++] = recordOf(volume, gradient, *it);
        }
        for (std::size_t c = 0; c < channels.size(); ++c) {
            openvdb::Vec3s* data = leaves[c][i]->buffer().data();
            for (int k = 0; k < count; ++k)
                data[offsets[k]] = toVec3s(records[k][channels[c].offset]);
        }
    });
    return trees;
}

SampleSlots::SampleSlots(const IrradianceVolume& volume, const Int32Tree& source)
    : mVolume(volume)
    , mSource(source)
{
    const auto isOwn = [&volume](const openvdb::Coord& p, std::int32_t s) {
        return volume.samplePosition(static_cast<SampleId>(s)) == fromVdb(p);
    };
    auto tile = source.cbeginValueOn();
    tile.setMaxDepth(Int32Tree::ValueOnCIter::LEAF_DEPTH - 1);
    for (; tile; ++tile)
        if (isOwn(tile.getCoord(), *tile)) mTileSamples.push_back(static_cast<SampleId>(*tile));

    const auto leaves = leavesOf(source);
    mFirst.push_back(0);
    for (const auto* leaf : leaves) {
        for (auto it = leaf->cbeginValueOn(); it; ++it)
            if (isOwn(it.getCoord(), *it)) mSlots.push_back({static_cast<SampleId>(*it), it.pos()});
        mFirst.push_back(mSlots.size());
    }
}

} // namespace lumivdb
