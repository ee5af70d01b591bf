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

/// Equal-area octahedral map of the unit square onto the sphere (Clarberg 2008); dω = 4π du dv.
Vec3d squareToSphere(const Vec2d& uv);

/// Its inverse, to 1e-5 of the square's side: the point that looks along unit @a d.
Vec2f sphereToSquare(const Vec3f& d);

/// Stratum @a i of @a count on the Hilbert curve, jittered by a number that depends on (seed, i)
/// alone: the t of hilbertPoint().
double jitteredStratum(std::uint64_t seed, std::uint64_t i, std::uint64_t count);

/// @a count unit directions, stratified over the sphere, neighbours in order.
std::vector<Vec3f> stratifiedDirections(std::uint64_t seed, int count);

} // namespace lumivdb
