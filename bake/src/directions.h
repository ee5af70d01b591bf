// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file directions.h
/// Stratified directions whose order follows the sphere.

#include <lumivdb/core/types.h>

#include <cstdint>
#include <vector>

namespace lumivdb {

/// Point of the Hilbert curve over [0,1)² at parameter @a t ∈ [0,1). Measure preserving and
/// continuous: consecutive strata of t are neighbouring strata of the square.
Vec2d hilbertPoint(double t);

/// 2/π · atan @a q for q ∈ [0, 1], to 1e-5 (Abramowitz & Stegun 4.4.49).
inline float quarterTurns(float q)
{
    const float q2 = q * q;
    return q * 0.636619772f
        * (0.9998660f
            + q2 * (-0.3302995f + q2 * (0.1801410f + q2 * (-0.0851330f + q2 * 0.0208351f))));
}

/// Equal-area octahedral map of the unit square onto the sphere (Clarberg 2008); dω = 4π du dv.
Vec3d squareToSphere(const Vec2d& uv);

/// Its inverse, to 1e-5 of the square's side: the point that looks along unit @a d.
Vec2f sphereToSquare(const Vec3f& d);

/// Stratum @a i of @a count on the Hilbert curve, jittered by a number that depends on (seed, i)
/// alone: the t of hilbertPoint().
double jitteredStratum(std::uint64_t seed, std::uint64_t i, std::uint64_t count);

/// Jittered positions in [0, 1) in nested strata, ascending. Set 0 has jitteredStratum() of each of
/// @a count strata. Set k > 0 has one position in each of count·2^(k−1), in the half that the sets
/// before left empty: sets 0 … k together have one in each of count·2^k strata, as if they had been
/// drawn at once (the van der Corput order of He & Owen's extensible grids, JRSS B 78(4), 2016).
std::vector<double> nestedPositions(std::uint64_t seed, std::uint64_t count, int set);

/// Unit directions stratified over the sphere, neighbours in order: hilbertPoint() of
/// nestedPositions().
std::vector<Vec3f> stratifiedDirections(std::uint64_t seed, int count, int set = 0);

/// Points take turns with several patterns of directions, by the random numbers that are theirs
/// (interleaved sampling: Keller & Heidrich, EGWR 2001). With one for all, edges would pass from
/// stratum to stratum at the same places for all: their errors would draw bands.
struct SamplingPattern {
    int number = 0;
    std::uint64_t seed = 0; ///< of its directions and emitter samples

    /// The one of the point with random numbers @a key: of 16, fewer above 4,096 @a rays, as all
    /// are kept.
    SamplingPattern(std::uint64_t seed, std::uint64_t key, int rays);
    static int count(int rays);
};

} // namespace lumivdb
