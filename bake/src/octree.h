// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file octree.h
/// The cells of a bake while they are being decided: splitting, 2:1 balance, merging.

#include <lumivdb/core/volume.h>

#include <unordered_set>
#include <vector>

namespace lumivdb {

/// A cell by its lower corner and level; origin is a multiple of 2^level.
struct CellKey {
    Coord origin;
    int level;
    int size() const { return 1 << level; }
    /// Lattice point at (x, y, z) half cell widths from the origin, 0 … 2 on each axis; the level
    /// must be above 0 for odd numbers.
    Coord node(int x, int y, int z) const
    {
        return origin + Coord(x * size() / 2, y * size() / 2, z * size() / 2);
    }
    Coord corner(int i) const { return node(2 * (i & 1), 2 * (i >> 1 & 1), 2 * (i >> 2 & 1)); }
    CellKey child(int i) const { return {node(i & 1, i >> 1 & 1, i >> 2 & 1), level - 1}; }
    CellKey parent() const;
    bool operator==(const CellKey& o) const { return origin == o.origin && level == o.level; }
};

/// Order of (x, y, z) of the origin, then of level: that of a volume's cells.
bool operator<(const CellKey& a, const CellKey& b);

/// Part of @a box that lies in @a cell.
double share(const CellKey& cell, const LatticeBox& box);

struct CellKeyHash {
    std::size_t operator()(const CellKey& key) const;
};

/// An octree of which only what meets a box exists. Roots are the cells of the coarsest level.
class Octree {
public:
    Octree(const LatticeBox& box, int levels);

    int levels() const { return mLevels; }
    const LatticeBox& box() const { return mBox; }
    bool meetsBox(const CellKey& cell) const;
    /// Sorted.
    std::vector<CellKey> roots() const;
    /// Restricts the tree to these roots.
    void setRoots(std::vector<CellKey> roots);

    bool isSplit(const CellKey& cell) const { return mSplit.count(cell) != 0; }
    /// Whether it is one of the tree's cells: a root, or a child of a split cell.
    bool exists(const CellKey& cell) const;
    void split(const CellKey& cell) { mSplit.insert(cell); }
    void merge(const CellKey& cell) { mSplit.erase(cell); }
    /// The children that meet the box.
    std::vector<CellKey> children(const CellKey& cell) const;

    /// Splits cells until no leaf touches another that is more than twice its size.
    void balance();
    /// Whether @a cell, all of whose children are leaves, may become a leaf without touching a cell
    /// of less than half its size.
    bool mayMerge(const CellKey& cell) const;
    /// Split cells of @a level all of whose children are leaves. Sorted.
    std::vector<CellKey> mergeable(int level) const;
    /// Sorted.
    std::vector<CellKey> leaves() const;
    std::vector<CellKey> splitCells() const;

private:
    bool isRoot(const CellKey& cell) const;
    LatticeBox mBox;
    int mLevels;
    std::vector<CellKey> mRoots; // sorted
    bool mAllRoots = true;
    std::unordered_set<CellKey, CellKeyHash> mSplit;
};

} // namespace lumivdb
