// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file gradient_kernel.h
/// The sums that gradients spend their time on, compiled for several instruction sets.

namespace lumivdb {

/// Products are summed in this many lanes on every machine, so that all give the same bits.
constexpr int kSumLanes = 8;
/// Rows of weights that are summed together.
constexpr int kSumRows = 3;

/// sums[k · stride + r] += Σ_i y[k · n + i] · w[r · wStride + i] for k < functions and
/// r < kSumRows; n is a multiple of kSumLanes, all arrays are aligned to 32 bytes.
void addProducts(
    int functions, int n, const float* y, const float* w, int wStride, double* sums, int stride);

} // namespace lumivdb
