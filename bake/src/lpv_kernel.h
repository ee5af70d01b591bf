// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file lpv_kernel.h
/// One step of propagation for the 8³ cells of a leaf, compiled for several instruction sets in
/// lpv_kernel.cpp with the same bits on each: no fused operations, every sum in one sequence.
///
/// **State.** A cell sends the radiant intensity I(w) = A + B·w in direction w, per colour
/// channel; A = Y_0 c_0 and B = Y_1 (c_x, c_y, c_z) are its two bands, scaled so that no step needs
/// the constants of the basis. ∫I dw = 4π A is the cell's flux.
///
/// **A step.** Light goes from a cell to its neighbour along d through the five other faces of the
/// neighbour: the front one subtends Ω_f, seen along w = d, each side face f subtends Ω_s, seen
/// along w = (2d + f)/√5. Each flux Φ = Ω I(w) is sent on as Φ/π times the cosine lobe of its face,
/// which adds Φ/4π to A and Φ/2π · f to B.

#include <cstddef>

namespace lumivdb::detail {

constexpr int kLeafWidth = 8;
constexpr int kLeafCells = 512;
/// Cell (x, y, z) of a leaf is number 64x + 8y + z, as in an OpenVDB leaf.
constexpr int leafCell(int x, int y, int z) { return 64 * x + 8 * y + z; }

/// A leaf's state: A, B_x, B_y, B_z of red, then of green, of blue; 512 floats each. The gap keeps
/// rows of different coefficients out of the same cache sets, and unaligned loads inside.
constexpr int kLpvCoefficients = 12;
constexpr int kCoefficientStride = kLeafCells + 16;
constexpr int kLeafLead = 16;
constexpr int kLeafFloats = kLeafLead + kLpvCoefficients * kCoefficientStride;

/// Faces of a leaf's cells across one axis, two neighbouring leaves' share: nine layers of 64.
/// Across x: 64i + 8y + z, across y: 72x + 8i + z, across z: 72x + 9y + i, where face i lies below
/// cell i.
constexpr int kFaces = 9 * 64;
constexpr int faceOf(int axis, const int (&cell)[3])
{
    return axis == 0 ? 64 * cell[0] + 8 * cell[1] + cell[2]
        : axis == 1  ? 72 * cell[0] + 8 * cell[1] + cell[2]
                     : 72 * cell[0] + 9 * cell[1] + cell[2];
}
constexpr int kFaceStride = kFaces + 16;
/// Share of light that passes a face, [axis][face].
constexpr int kPassFloats = 3 * kFaceStride;
/// Reflectance of what light meets at a face when it travels up or down the axis,
/// [axis][0: up, 1: down][channel][face].
constexpr int kReflectFloats = 3 * 2 * 3 * kFaceStride;

/// Weights Ω/4π of the front face and of a side face. The front's is rounded so that the six links
/// of a cell give back 1 + 1e-8 of its light.
extern const float kFrontWeight, kSideWeight;

enum class FluxLimit {
    None, ///< fluxes as they are, negative ones too: conserves light
    Positive ///< max(0, I(w)) as in the paper
};

struct LpvGather {
    FluxLimit limit = FluxLimit::Positive;
    /// First coefficients (behind the lead) of the front of the leaves at −x, +x, −y, +y, −z, +z,
    /// and of this one.
    const float* neighbours[6] = {};
    const float* self = nullptr;
    const float* inside = nullptr; ///< 1 in cells of the volume, 0 outside; null: all inside
    const float* pass = nullptr; ///< kPassFloats; null: nothing is in the way
    const float* reflect = nullptr; ///< kReflectFloats; null: nothing comes back; needs pass
    /// A cell whose largest coefficient is smaller gets none.
    float floor = 0;
    float* next = nullptr; ///< is set
    float* sum = nullptr; ///< the new front is added to it
    // Results
    double total[3] = {}; ///< ΣA of the new front per channel
    /// Largest coefficient in the cells at −x, +x, −y, +y, −z, +z, and in all cells.
    float faceMax[6] = {};
    float max = 0;
};

void gatherLeaf(LpvGather& gather);

} // namespace lumivdb::detail
