// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file lpv_leaf_index.h
/// Where the block of a leaf is: a sparse map from leaf coordinates (lattice point / 8, rounded
/// down) to numbers, kept in an OpenVDB tree of which each voxel stands for a leaf.

#include <lumivdb/core/types.h>

#include <memory>

namespace lumivdb::detail {

inline Coord leafOf(const Coord& p) { return {p.x >> 3, p.y >> 3, p.z >> 3}; }

class LeafIndex {
public:
    LeafIndex();
    ~LeafIndex();
    LeafIndex(LeafIndex&&) noexcept;
    LeafIndex& operator=(LeafIndex&&) noexcept;

    /// −1 where there is none. Safe from many threads.
    int find(const Coord& leaf) const;
    void insert(const Coord& leaf, int number);
    void clear();

private:
    struct Tree;
    std::unique_ptr<Tree> mTree;
};

} // namespace lumivdb::detail
