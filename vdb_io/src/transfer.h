// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file transfer.h
/// Values between sample records and the trees of the channel grids.

#include "channels.h"

#include <openvdb/openvdb.h>
#include <tbb/parallel_for.h>

#include <type_traits>
#include <vector>

namespace lumivdb {

/// Leaves of a tree in tree order: the same for every tree of one topology.
template <typename TreeType> auto leavesOf(TreeType& tree)
{
    using Leaf = std::conditional_t<std::is_const_v<TreeType>,
        const typename TreeType::LeafNodeType, typename TreeType::LeafNodeType>;
    std::vector<Leaf*> leaves;
    tree.getNodes(leaves);
    return leaves;
}

/// Calls f(tile of @a a, value of @a b there) for the active tiles of two trees of one topology.
template <typename TreeA, typename F>
void forTiles(TreeA& a, const openvdb::Int32Tree& b, const F& f)
{
    auto tile = a.beginValueOn();
    auto other = b.cbeginValueOn();
    tile.setMaxDepth(TreeA::ValueOnIter::LEAF_DEPTH - 1);
    other.setMaxDepth(openvdb::Int32Tree::ValueOnCIter::LEAF_DEPTH - 1);
    for (; tile && other; ++tile, ++other) f(tile, *other);
}

/// A tree of the topology of @a source whose active values are value(sample id).
template <typename TreeType, typename F>
typename TreeType::Ptr makeScalarTree(const openvdb::Int32Tree& source,
    const typename TreeType::ValueType& background, const F& value)
{
    auto tree = std::make_shared<TreeType>(source, background, openvdb::TopologyCopy());
    forTiles(*tree, source, [&](auto& tile, std::int32_t s) { tile.setValue(value(s)); });
    const auto from = leavesOf(source);
    const auto to = leavesOf(*tree);
    tbb::parallel_for(std::size_t{0}, from.size(), [&](std::size_t i) {
        auto* data = to[i]->buffer().data();
        for (auto it = from[i]->cbeginValueOn(); it; ++it) data[it.pos()] = value(*it);
    });
    return tree;
}

/// Trees of the topology of @a source for @a channels, which are all of one record (radiance or
/// gradient). A leaf's records are visited once for all of them.
std::vector<openvdb::Vec3STree::Ptr> makeColorTrees(const IrradianceVolume& volume,
    const openvdb::Int32Tree& source, const std::vector<ColorChannel>& channels);

/// Where the samples are in a tree of the topology of a source tree.
class SampleSlots {
public:
    SampleSlots(const IrradianceVolume& volume, const openvdb::Int32Tree& source);

    const openvdb::Int32Tree& source() const { return mSource; }

    /// Calls put(sample id, value) for every sample of @a tree, in parallel. @a tree covers the
    /// same voxels as the source; where its nodes differ (a host pruned it), it is slower.
    template <typename TreeType, typename F>
    void forSamples(const TreeType& tree, const F& put) const
    {
        if (!tree.hasSameTopology(mSource)) {
            openvdb::tree::ValueAccessor<const TreeType> access(tree);
            for (std::size_t s = 0; s < mVolume.sampleCount(); ++s) {
                const auto id = static_cast<SampleId>(s);
                put(id, access.getValue(toVdb(mVolume.samplePosition(id))));
            }
            return;
        }
        for (const SampleId s : mTileSamples)
            put(s, tree.getValue(toVdb(mVolume.samplePosition(s))));
        const auto leaves = leavesOf(tree);
        tbb::parallel_for(std::size_t{0}, leaves.size(), [&](std::size_t i) {
            const auto* data = leaves[i]->buffer().data();
            for (std::size_t k = mFirst[i]; k < mFirst[i + 1]; ++k)
                put(mSlots[k].sample, data[mSlots[k].offset]);
        });
    }

private:
    struct Slot {
        SampleId sample;
        std::uint32_t offset; ///< in its leaf
    };
    const IrradianceVolume& mVolume;
    const openvdb::Int32Tree& mSource;
    std::vector<SampleId> mTileSamples;
    std::vector<Slot> mSlots;
    std::vector<std::size_t> mFirst; ///< first slot of leaf i
};

/// True when the same voxels are active, whatever nodes hold them.
template <typename TreeA, typename TreeB> bool sameVoxels(const TreeA& a, const TreeB& b)
{
    if (a.hasSameTopology(b)) return true;
    openvdb::MaskTree onlyA(a, false, openvdb::TopologyCopy());
    openvdb::MaskTree onlyB(b, false, openvdb::TopologyCopy());
    openvdb::MaskTree inA(onlyA);
    onlyA.topologyDifference(onlyB);
    onlyB.topologyDifference(inA);
    return onlyA.activeVoxelCount() == 0 && onlyB.activeVoxelCount() == 0;
}

} // namespace lumivdb
