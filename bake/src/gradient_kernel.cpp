// SPDX-License-Identifier: Apache-2.0
#include "gradient_kernel.h"

// Vectors of scalable length cannot be held in arrays; processors that have them have others too.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "gradient_kernel.cpp"
#include <hwy/foreach_target.h> // compiles this file once for each target

#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace lumivdb {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// No fused multiply-add: not every machine has it, and it rounds differently.
void addProducts(
    int functions, int n, const float* y, const float* w, int wStride, double* sums, int stride)
{
    const hn::CappedTag<float, kSumLanes> d;
    using V = hn::Vec<decltype(d)>;
    constexpr int kWidth = static_cast<int>(hn::MaxLanes(d)), kParts = kSumLanes / kWidth;
    for (int k = 0; k < functions; ++k, y += n, sums += stride) {
        V s[kSumRows][kParts];
        for (int r = 0; r < kSumRows; ++r) {
            for (int p = 0; p < kParts; ++p) s[r][p] = hn::Zero(d);
        }
        for (int i = 0; i < n; i += kSumLanes) {
            for (int p = 0; p < kParts; ++p) {
                const int at = i + p * kWidth;
                const V v = hn::LoadU(d, y + at);
                for (int r = 0; r < kSumRows; ++r) {
                    s[r][p] = hn::Add(s[r][p], hn::Mul(v, hn::LoadU(d, w + r * wStride + at)));
                }
            }
        }
        for (int r = 0; r < kSumRows; ++r) {
            alignas(32) float lane[kSumLanes];
            for (int p = 0; p < kParts; ++p) hn::StoreU(s[r][p], d, lane + p * kWidth);
            sums[r] += static_cast<double>(((lane[0] + lane[1]) + (lane[2] + lane[3]))
                + ((lane[4] + lane[5]) + (lane[6] + lane[7])));
        }
    }
}

} // namespace HWY_NAMESPACE
} // namespace lumivdb
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace lumivdb {

HWY_EXPORT(addProducts);

void addProducts(
    int functions, int n, const float* y, const float* w, int wStride, double* sums, int stride)
{
    HWY_DYNAMIC_DISPATCH(addProducts)(functions, n, y, w, wStride, sums, stride);
}

} // namespace lumivdb
#endif
