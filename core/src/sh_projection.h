// SPDX-License-Identifier: Apache-2.0
#pragma once

// What sh_projection.cpp hands to the kernel in sh_cube_moments.cpp; not installed. Plain data
// only: the kernel is compiled for several instruction sets, and inline functions of library
// classes must not be.

#include <lumivdb/core/sh.h>

#include <array>
#include <cstddef>

namespace lumivdb::detail {

/// The highest degrees of either parity that @a bands bands have; −1 where there is none.
constexpr int highestDegree(int bands, int parity)
{
    return parity == 0 ? (bands - 1) / 2 * 2 : bands / 2 * 2 - 1;
}

/// [parity of D][i][j][channel]: Σ L ∫ xⁱ yʲ z^(D−i−j) dω over the sphere, D = highestDegree().
using CubeMoments = double[2][kMaxBands][kMaxBands][3];

struct CubeJob {
    int bands, size;
    int half; ///< columns of half a face, the middle one included
    std::size_t padded; ///< `half` rounded up to whole vectors
    std::size_t flatLength; ///< floats of a row rounded up likewise
    bool centres; ///< CubeTexels::Centres
    const float* faces[6];
    /// Quadrature over the width of a texel: nodes in [−½, ½].
    const double *node, *nodeWeight;
    std::size_t nodes;
    /// Scratch, zeroed and aligned: kWeightRows and kFoldedRows of `padded`, 4 of `flatLength`.
    double *weight, *folded, *flat;
    CubeMoments moments; ///< the result; zeroed

    static constexpr std::size_t kWeightRows = 2 * kMaxBands; ///< [parity of D][i]
    static constexpr std::size_t kFoldedRows = 3 * 8 * 3; ///< [axis][class][channel]
};

/// Fills job.moments, with the same bits on every machine.
void sumCubeMoments(CubeJob& job);

} // namespace lumivdb::detail
