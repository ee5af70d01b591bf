// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file lpv_geometry.h
/// The geometry volume: what stands between the cells of a light propagation volume, and what of
/// the light passes and comes back at the faces between them.

#include "lpv_leaf_index.h"

#include <lumivdb/bake/lpv.h>

#include <memory>
#include <vector>

namespace lumivdb::detail {

class LpvGeometry {
public:
    explicit LpvGeometry(const LpvOptions& options)
        : mSpacing(options.spacing)
        , mBounces(options.bounces)
    {
    }

    /// Adds up @a blockers and keeps, per geometry cell, what blocks more: this or what was there.
    void merge(const std::vector<Blocker>& blockers);
    void clear();

    CellBlocking blocking(const Coord& p) const;
    bool empty() const { return mLeaves.empty(); }
    /// For a leaf of light cells, its faces' kPassFloats and kReflectFloats; null where nothing is
    /// in the way, or where nothing comes back.
    const float* pass(const Coord& leaf) const;
    const float* reflect(const Coord& leaf) const;
    std::size_t memoryBytes() const;

private:
    /// Of a geometry cell: what it stops, and what it would send back times what it stops, of light
    /// that travels up and down each axis.
    struct Cell {
        CellBlocking blocking;
        Color back[3][2]
            = {{Color(0.0f), Color(0.0f)}, {Color(0.0f), Color(0.0f)}, {Color(0.0f), Color(0.0f)}};
    };
    struct Leaf {
        Coord at;
        std::vector<Cell> cells;
    };
    struct Faces {
        std::vector<float> pass, reflect;
    };
    using Window = std::vector<Cell>; // 9³ cells from one before a leaf's first

    Cell& cellAt(std::vector<Leaf>& leaves, LeafIndex& index, const Coord& p) const;
    void add(const Blocker& blocker, Cell& cell) const;
    void makeFaces();
    Window windowOf(const Coord& leaf) const;
    void fillAxis(int axis, const Window& window, Faces& faces) const;

    double mSpacing;
    LpvBounces mBounces;
    std::vector<Leaf> mLeaves;
    LeafIndex mIndex;
    std::vector<Faces> mFaces;
    LeafIndex mFaceIndex;
};

} // namespace lumivdb::detail
