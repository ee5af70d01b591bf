// SPDX-License-Identifier: Apache-2.0
#include "lpv_contenders.h"

#include <lpv_kernel.h>

#include <algorithm>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "lpv_dense.cpp"
#include <hwy/foreach_target.h> // compiles what follows once per instruction set
#include <hwy/highway.h>

#include <lpv_link_inl.h>

HWY_BEFORE_NAMESPACE();
namespace lumivdb::detail {
namespace HWY_NAMESPACE {

/// A row of @a width cells, a multiple of 8, of red, green and blue.
void gatherDenseRow(const float* front, float* next, float* sum, std::ptrdiff_t stride,
    std::ptrdiff_t strideX, std::ptrdiff_t strideY, int width)
{
    const Row d;
    const std::ptrdiff_t lanes = static_cast<std::ptrdiff_t>(hn::Lanes(d));
    for (std::ptrdiff_t z = 0; z < width; z += lanes) {
        for (std::ptrdiff_t c = 0; c < 3; ++c) {
            const std::ptrdiff_t at = c * 4 * stride + z;
            const float* p = front + at;
            const auto load = [stride](const float* q) {
                const Row row;
                return State{hn::LoadU(row, q),
                    {hn::LoadU(row, q + stride), hn::LoadU(row, q + 2 * stride),
                        hn::LoadU(row, q + 3 * stride)}};
            };
            Sums sums = noSums();
            receive<0, true>(send<0, true, true>(load(p - strideX)), sums);
            receive<0, false>(send<0, false, true>(load(p + strideX)), sums);
            receive<1, true>(send<1, true, true>(load(p - strideY)), sums);
            receive<1, false>(send<1, false, true>(load(p + strideY)), sums);
            receive<2, true>(send<2, true, true>(load(p - 1)), sums);
            receive<2, false>(send<2, false, true>(load(p + 1)), sums);
            const State s = fromSums(sums);
            const Vec values[4] = {s.a, s.b[0], s.b[1], s.b[2]};
            for (std::ptrdiff_t k = 0; k < 4; ++k) {
                const std::ptrdiff_t i = at + k * stride;
                hn::StoreU(values[k], d, next + i);
                hn::StoreU(hn::Add(hn::LoadU(d, sum + i), values[k]), d, sum + i);
            }
        }
    }
}

} // namespace HWY_NAMESPACE
} // namespace lumivdb::detail
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lumivdb::detail {
HWY_EXPORT(gatherDenseRow);
} // namespace lumivdb::detail

namespace lpv_bench {

namespace {
constexpr int kLead = 8; // before and after each row: vectors stay aligned, neighbours inside
}

DenseLpv::DenseLpv(int n)
    : mN(n)
    , mStrideY(n + 2 * kLead)
    , mStrideX(mStrideY * (n + 2))
    , mStride(mStrideX * (n + 2) + 16) // rows of different coefficients in different cache sets
{
    for (std::vector<float>* v : {&mFront, &mNext, &mSum})
        v->assign(static_cast<std::size_t>(12 * mStride), 0.0f);
}

std::size_t DenseLpv::at(const Coord& c) const
{
    return static_cast<std::size_t>((c.x + 1) * mStrideX + (c.y + 1) * mStrideY + c.z + kLead);
}

void DenseLpv::add(const Coord& cell, const State& state)
{
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t k = 0; k < 4; ++k) {
            const std::size_t i = (c * 4 + k) * static_cast<std::size_t>(mStride) + at(cell);
            mFront[i] += state[k][static_cast<int>(c)];
            mSum[i] += state[k][static_cast<int>(c)];
        }
    }
}

void DenseLpv::step()
{
    for (int x = 0; x < mN; ++x) {
        for (int y = 0; y < mN; ++y) {
            const std::size_t i = at({x, y, 0});
            HWY_DYNAMIC_DISPATCH(lumivdb::detail::gatherDenseRow)
            (mFront.data() + i, mNext.data() + i, mSum.data() + i, mStride, mStrideX, mStrideY, mN);
        }
    }
    mFront.swap(mNext);
}

State DenseLpv::sum(const Coord& cell) const
{
    State s;
    for (std::size_t c = 0; c < 3; ++c)
        for (std::size_t k = 0; k < 4; ++k)
            s[k][static_cast<int>(c)]
                = mSum[(c * 4 + k) * static_cast<std::size_t>(mStride) + at(cell)];
    return s;
}

} // namespace lpv_bench
#endif
