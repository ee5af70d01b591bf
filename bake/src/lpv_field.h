// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file lpv_field.h
/// The cells of a light propagation volume: blocks, their neighbours, the front. Lattice units and
/// the state of lpv_kernel.h; the world and the basis are the callers'.

#include "lpv_geometry.h"
#include "lpv_kernel.h"
#include "lpv_leaf_index.h"

#include <lumivdb/core/types.h>

#include <array>
#include <memory>
#include <optional>
#include <vector>

namespace lumivdb::detail {

/// A, B_x, B_y, B_z of one cell.
using CellState = std::array<Color, 4>;
inline CellState noLight() { return {Color(0.0f), Color(0.0f), Color(0.0f), Color(0.0f)}; }

class LpvField {
public:
    LpvField(FluxLimit limit, double cutoff, const std::optional<LatticeBox>& cells);

    const std::optional<LatticeBox>& cells() const { return mCells; }
    void setCells(const LatticeBox& cells);
    bool contains(const Coord& p) const;

    /// Fetches what stands in the way anew. @a geometry outlives the field or the next call.
    void setGeometry(const LpvGeometry* geometry);

    void clearLight();
    /// Adds to the front and to the sum of a cell inside.
    void add(const Coord& cell, const CellState& state);
    void step();

    bool dark() const { return mActive.empty(); }
    std::size_t activeLeaves() const { return mActive.size(); }
    /// ΣA of the front.
    Vec3d frontTotal() const;
    CellState front(const Coord& cell) const;
    /// All that has been in a cell: Σ over steps of its front.
    CellState sum(const Coord& cell) const;
    /// Leaves with a sum.
    std::vector<Coord> litLeaves() const;
    std::size_t memoryBytes() const;

private:
    struct Leaf {
        Coord at; ///< leaf coordinates
        float* block = nullptr; ///< two fronts and the sum, kLeafFloats each
        const float* inside = nullptr;
        const float* pass = nullptr;
        const float* reflect = nullptr;
        std::array<int, 6> neighbours{-1, -1, -1, -1, -1, -1};
        bool lit = false; ///< the front is here
        bool summed = false; ///< the sum is of this light
        bool next = false; ///< among the leaves of this step
        float faceMax[6] = {};
        float max = 0;
        Vec3d total{0.0};
    };
    struct FreeBlock {
        void operator()(float* p) const;
    };
    /// Which part of a leaf's buffers.
    float* frontOf(const Leaf& leaf, int parity) const;
    float* sumOf(const Leaf& leaf) const { return frontOf(leaf, 2); }

    int leafAt(const Coord& at); ///< made where there is none
    int makeLeaf(const Coord& at);
    bool leafInside(const Coord& at) const;
    const float* insideOf(const Coord& at);
    void refreshGeometry(Leaf& leaf) const;
    float* takeBlock();
    void light(int number);
    void listTargets();
    void addTarget(int number);
    void gather(Leaf& leaf) const;
    CellState read(const float* coefficients, const Coord& cell) const;

    FluxLimit mLimit;
    double mCutoff;
    std::optional<LatticeBox> mCells;
    const LpvGeometry* mGeometry = nullptr;
    std::vector<Leaf> mLeaves;
    LeafIndex mIndex;
    std::vector<int> mActive, mTargets;
    std::vector<std::unique_ptr<float, FreeBlock>> mBlocks; ///< all, in use first
    std::size_t mUsedBlocks = 0;
    std::vector<std::unique_ptr<std::array<float, kLeafCells>>> mInside;
    std::vector<float> mDark; ///< a front without light
    int mParity = 0;
    float mPeak = 0; ///< largest coefficient that was ever added
};

} // namespace lumivdb::detail
