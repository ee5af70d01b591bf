// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file nearest_cell.h
/// The cell nearest to any point, also outside the volume.

#include <lumivdb/core/volume.h>

#include <vector>

namespace lumivdb {

/// Answers from an implicit bounding-box tree over the cells: O(log n) a query, O(n log n) to make.
class NearestCell {
public:
    explicit NearestCell(const IrradianceVolume& volume);
    /// The cell whose closed box is nearest to @a p (lattice units); the smallest id of several.
    CellId find(const Vec3d& p) const;

private:
    struct Node {
        Vec3d lower, upper;
        std::size_t begin, end; ///< its cells in mOrder
    };
    void build(std::size_t node, std::size_t begin, std::size_t end);
    void search(std::size_t node, const Vec3d& p, double& best, CellId& found) const;

    const IrradianceVolume& mVolume;
    std::vector<CellId> mOrder;
    std::vector<Node> mNodes; ///< a binary heap: children of i are 2i + 1 and 2i + 2
};

} // namespace lumivdb
