// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file lpv_contenders.h
/// What the leaves of a light propagation volume are held against: the same arithmetic on plain
/// arrays and through OpenVDB's accessors.

#include <lumivdb/core/types.h>

#include <array>
#include <cstddef>
#include <memory>
#include <vector>

namespace lpv_bench {

using lumivdb::Color;
using lumivdb::Coord;
/// A, B_x, B_y, B_z of a cell, as in bake/src/lpv_kernel.h.
using State = std::array<Color, 4>;

/// n³ cells in twelve arrays with a border of dark ones; clamped flux.
class DenseLpv {
public:
    explicit DenseLpv(int n);
    void add(const Coord& cell, const State& state);
    void step();
    State sum(const Coord& cell) const;

private:
    std::size_t at(const Coord& cell) const;
    float* first(std::vector<float>& array);

    int mN;
    std::ptrdiff_t mStrideY, mStrideX, mStride;
    std::vector<float> mFront, mNext, mSum;
};

/// n³ cells in float grids, one a coefficient, for front, next front and sum; each neighbour's
/// coefficient is looked up by an accessor.
class AccessorLpv {
public:
    explicit AccessorLpv(int n);
    ~AccessorLpv();
    void add(const Coord& cell, const State& state);
    void step();
    State sum(const Coord& cell) const;

private:
    struct Grids;
    int mN;
    std::unique_ptr<Grids> mGrids;
};

} // namespace lpv_bench
