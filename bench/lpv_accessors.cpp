// SPDX-License-Identifier: Apache-2.0
#include "lpv_contenders.h"

#include <lpv_kernel.h>

#include <lumivdb/core/openvdb_instances.h>

#include <algorithm>

namespace lpv_bench {

using openvdb::FloatGrid;
using Accessor = FloatGrid::Accessor;

struct AccessorLpv::Grids {
    /// front, next, sum
    std::array<std::vector<FloatGrid::Ptr>, 3> grids;
    std::array<std::vector<Accessor>, 3> access;
};

AccessorLpv::AccessorLpv(int n)
    : mN(n)
    , mGrids(std::make_unique<Grids>())
{
    for (std::size_t i = 0; i < 3; ++i) {
        for (int k = 0; k < 12; ++k) {
            mGrids->grids[i].push_back(FloatGrid::create(0.0f));
            mGrids->grids[i].back()->denseFill(
                openvdb::CoordBBox({0, 0, 0}, {n - 1, n - 1, n - 1}), 0.0f, true);
            mGrids->access[i].push_back(mGrids->grids[i].back()->getAccessor());
        }
    }
}

AccessorLpv::~AccessorLpv() = default;

void AccessorLpv::add(const Coord& cell, const State& state)
{
    const openvdb::Coord p(cell.x, cell.y, cell.z);
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t k = 0; k < 4; ++k) {
            for (const std::size_t i : {std::size_t{0}, std::size_t{2}}) {
                Accessor& a = mGrids->access[i][c * 4 + k];
                a.setValue(p, a.getValue(p) + state[k][static_cast<int>(c)]);
            }
        }
    }
}

namespace {

/// A cell's new state, channel by channel, in the sequence of sums of the kernels.
template <class Look> std::array<float, 4> gatherCell(const Look& look)
{
    using lumivdb::detail::kFrontWeight;
    using lumivdb::detail::kSideWeight;
    const float along = 0.8944271909999159f, across = 0.4472135954999579f;
    float front = 0, side = 0, frontAlong[3] = {}, sideAlong[3] = {};
    for (int axis = 0; axis < 3; ++axis) {
        const int u = (axis + 1) % 3, v = (axis + 2) % 3;
        for (int sign = 1; sign >= -1; sign -= 2) {
            const auto s = static_cast<float>(sign);
            const std::array<float, 4> from = look(axis, -sign);
            const auto b = [&](int k) { return from[static_cast<std::size_t>(k) + 1]; };
            const auto limited = [](float f) { return std::max(f, 0.0f); };
            const float middle = from[0] + s * (along * b(axis));
            const float f0 = limited(from[0] + s * b(axis));
            const float f1 = limited(middle + across * b(u)), f2 = limited(middle - across * b(u));
            const float f3 = limited(middle + across * b(v)), f4 = limited(middle - across * b(v));
            front += f0;
            frontAlong[axis] += s * f0;
            side += (f1 + f2) + (f3 + f4);
            sideAlong[u] += f1 - f2;
            sideAlong[v] += f3 - f4;
        }
    }
    std::array<float, 4> to = {kFrontWeight * front + kSideWeight * side, 0, 0, 0};
    for (std::size_t k = 0; k < 3; ++k)
        to[k + 1] = 2 * kFrontWeight * frontAlong[k] + 2 * kSideWeight * sideAlong[k];
    return to;
}

} // namespace

void AccessorLpv::step()
{
    auto& [front, next, sum] = mGrids->access;
    for (int x = 0; x < mN; ++x) {
        for (int y = 0; y < mN; ++y) {
            for (int z = 0; z < mN; ++z) {
                const openvdb::Coord p(x, y, z);
                for (std::size_t c = 0; c < 12; c += 4) {
                    const auto state = gatherCell([&](int axis, int step) {
                        openvdb::Coord q = p;
                        q[axis] += step;
                        return std::array<float, 4>{front[c].getValue(q), front[c + 1].getValue(q),
                            front[c + 2].getValue(q), front[c + 3].getValue(q)};
                    });
                    for (std::size_t k = 0; k < 4; ++k) {
                        next[c + k].setValue(p, state[k]);
                        sum[c + k].setValue(p, sum[c + k].getValue(p) + state[k]);
                    }
                }
            }
        }
    }
    std::swap(mGrids->grids[0], mGrids->grids[1]);
    std::swap(front, next);
}

State AccessorLpv::sum(const Coord& cell) const
{
    State s;
    for (std::size_t c = 0; c < 3; ++c)
        for (std::size_t k = 0; k < 4; ++k)
            s[k][static_cast<int>(c)]
                = mGrids->access[2][c * 4 + k].getValue({cell.x, cell.y, cell.z});
    return s;
}

} // namespace lpv_bench
