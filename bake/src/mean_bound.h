// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file mean_bound.h
/// An upper confidence bound of a relative mean square that a few large values make.

#include <vector>

namespace lumivdb {

/// x with P(normal < x) = p, for ½ ≤ p < 1, to 4.5e-4 (Abramowitz & Stegun 26.2.23).
double normalQuantile(double p);

/// Upper bound, at one-sided @a confidence, of the relative mean square v̄ / Ē², where v̄ = Σ w v / Σ
/// w and Ē = Σ w E / Σ w are means over the same independent draws, both uncertain: @a squares
/// holds w·v, @a values w·E, @a weights w. With s the ratio's standard error by linearisation and g
/// its skewness, the bound is v̄/Ē² + s (z + g (2z² + 1)/6): the one-sided interval of Student's
/// statistic with its first Edgeworth term (Hall, Annals of Statistics 11, 1983, "Inverting an
/// Edgeworth expansion"). Squared errors are skew: mean and s rise and fall together, and mean + z
/// s is too low far more often than it says. The vectors are of one size, not empty; Ē > 0.
double upperRelativeSquare(const std::vector<double>& squares, const std::vector<double>& values,
    const std::vector<double>& weights, double confidence);

} // namespace lumivdb
