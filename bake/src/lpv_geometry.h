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

    Vec3f blocking(const Coord& p) const;
    bool empty() const { return mLeaves.empty(); }
    /// For a leaf of light cells, its faces' kPassFloats and kReflectFloats; null where nothing is
    /// in the way, or where nothing comes back.
    const float* pass(const Coord& leaf) const;
    const float* reflect(const Coord& leaf) const;
    std::size_t memoryBytes() const;

private:
    /// Of a geometry cell, per axis: the share that is covered, and that times albedo for light
    /// that travels up and down the axis.
    struct Cell {
        Vec3f covered{0, 0, 0};
        float all() const { return covered.x + covered.y + covered.z; }
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
    static Cell meanAtFace(int axis, const Coord& cell, const Window& window);
    static void fillAxis(int axis, const Window& window, Faces& faces);

    double mSpacing;
    LpvBounces mBounces;
    std::vector<Leaf> mLeaves;
    LeafIndex mIndex;
    std::vector<Faces> mFaces;
    LeafIndex mFaceIndex;
};

} // namespace lumivdb::detail
