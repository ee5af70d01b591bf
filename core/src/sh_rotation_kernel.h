// SPDX-License-Identifier: Apache-2.0
#pragma once

// The arithmetic of rotation, compiled for several instruction sets in sh_rotation_kernel.cpp with
// the same bits on each: no fused operations, every sum in one sequence. Not installed. Plain data
// only, see sh_projection.h.

#include <lumivdb/core/sh.h>

namespace lumivdb::detail {

/// The block of degree l stands column by column, each column padded to whole vectors.
constexpr int blockStride(int l) { return (2 * l + 4) / 4 * 4; }
constexpr int blockOffset(int l)
{
    int offset = 0;
    for (int k = 0; k < l; ++k) offset += (2 * k + 1) * blockStride(k);
    return offset;
}

/// Three channels side by side, and a lane of padding.
using ShLanes = double[kMaxCoefficients][4];

/// Multiplies degrees 1 … bands−1, bands > 1, with their blocks. In place is not allowed.
void applyBlocks(int bands, const double* blocks, const ShLanes& in, ShLanes& out);
/// The same for one channel; @a out has room for kMaxCoefficients + 4 values.
void applyBlocksToOne(int bands, const double* blocks, const double* in, double* out);

/// A turn about z, then about y, then about z again: cos and sin of m times each angle.
struct EulerTurn {
    double cosine[3][kMaxBands], sine[3][kMaxBands];
};

/// Turns degrees 3 … bands−1 of three channels or of one: a turn about y is the swap of y and z, a
/// turn about z, and the swap. In place is not allowed.
void applyEuler(int bands, const EulerTurn& turn, const ShLanes& in, ShLanes& out);
void applyEulerToOne(int bands, const EulerTurn& turn, const double* in, double* out);

} // namespace lumivdb::detail
