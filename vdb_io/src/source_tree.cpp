// SPDX-License-Identifier: Apache-2.0
#include "transfer.h"

#include <lumivdb/core/volume_grid.h>

#include <tbb/parallel_for.h>

namespace lumivdb {

using openvdb::Int32Tree;

namespace {

/// Replaces every active value v of @a tree, tiles included, by f(position, v).
template <typename F> void mapValues(Int32Tree& tree, const F& f)
{
    auto tiles = tree.beginValueOn();
    tiles.setMaxDepth(Int32Tree::ValueOnIter::LEAF_DEPTH - 1);
    for (; tiles; ++tiles) tiles.setValue(f(tiles.getCoord(), *tiles));
    const auto leaves = leavesOf(tree);
    tbb::parallel_for(std::size_t{0}, leaves.size(), [&](std::size_t i) {
        for (auto it = leaves[i]->beginValueOn(); it; ++it)
            it.setValue(f(it.getCoord(), it.getValue()));
    });
}

} // namespace

Int32Tree::Ptr makeSourceTree(const IrradianceVolume& volume)
{
    auto tree = std::make_shared<Int32Tree>(indexGrid(volume).tree());
    mapValues(*tree, [&volume](const openvdb::Coord&, CellId id) {
        return static_cast<std::int32_t>(volume.cell(id).corners[0]);
    });
    // Samples come in (x, y, z) order, so the one at a block's lower corner comes before others in
    // the block and finds its tile whole.
    openvdb::tree::ValueAccessor<Int32Tree> access(*tree);
    for (std::size_t s = 0; s < volume.sampleCount(); ++s) {
        const auto id = static_cast<std::int32_t>(s);
        const openvdb::Coord p = toVdb(volume.samplePosition(static_cast<SampleId>(s)));
        std::int32_t value = 0;
        const bool covered = access.probeValue(p, value);
        if (covered && value == id) continue;
        const bool blockCorner = ((p.x() | p.y() | p.z()) & 7) == 0;
        if (covered && blockCorner && !access.probeConstLeaf(p))
            access.addTile(1, p, id, true);
        else
            access.setValueOn(p, id);
    }
    return tree;
}

Int32Tree::Ptr makeLevelTree(const IrradianceVolume& volume, const Int32Tree& source)
{
    auto tree = std::make_shared<Int32Tree>(source);
    tree->root().setBackground(-1, /*updateChildNodes=*/true);
    mapValues(*tree, [&volume](const openvdb::Coord& p, std::int32_t) {
        const CellId id = volume.findCell(fromVdb(p));
        return id == kNoCell ? -1 : volume.cell(id).level;
    });
    return tree;
}

Int32Tree::Ptr makeCutTree(const IrradianceVolume& volume, const Int32Tree& source)
{
    auto tree = std::make_shared<Int32Tree>(source);
    mapValues(*tree, [&volume](const openvdb::Coord& p, std::int32_t) {
        const CellId id = volume.findCell(fromVdb(p));
        return id != kNoCell && volume.visibility(id) ? id : -1;
    });
    return tree;
}

Int32Tree::Ptr makeCellTree(const IrradianceVolume& volume, const Int32Tree& source)
{
    auto tree = std::make_shared<Int32Tree>(source);
    mapValues(*tree, [&volume](const openvdb::Coord& p, std::int32_t) -> std::int32_t {
        const CellId id = volume.findCell(fromVdb(p));
        return id == kNoCell ? -1 : id;
    });
    return tree;
}

} // namespace lumivdb
