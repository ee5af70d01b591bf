// SPDX-License-Identifier: Apache-2.0
#include "lpv_leaf_index.h"

#include <lumivdb/core/openvdb_instances.h>

namespace lumivdb::detail {

struct LeafIndex::Tree {
    openvdb::Int32Tree tree{-1};
};

LeafIndex::LeafIndex()
    : mTree(std::make_unique<Tree>())
{
}
LeafIndex::~LeafIndex() = default;
LeafIndex::LeafIndex(LeafIndex&&) noexcept = default;
LeafIndex& LeafIndex::operator=(LeafIndex&&) noexcept = default;

int LeafIndex::find(const Coord& leaf) const
{
    return mTree->tree.getValue(openvdb::Coord(leaf.x, leaf.y, leaf.z));
}

void LeafIndex::insert(const Coord& leaf, int number)
{
    mTree->tree.setValue(openvdb::Coord(leaf.x, leaf.y, leaf.z), number);
}

void LeafIndex::clear() { mTree->tree.clear(); }

} // namespace lumivdb::detail
