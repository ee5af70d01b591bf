// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file mean_bound.h
/// An upper confidence bound of a mean that a few large values make.

#include <vector>

namespace lumivdb {

/// x with P(normal < x) = p, for ½ ≤ p < 1, to 4.5e-4 (Abramowitz & Stegun 26.2.23).
double normalQuantile(double p);

/// Upper bound, at one-sided @a confidence, of the weighted mean Σ w v / Σ w of independent draws:
/// @a weighted holds w·v, @a weights w. With s the mean's standard error by linearisation of the
/// ratio, and g its skewness, the bound is mean + s (z + g (2z² + 1)/6): the one-sided interval of
/// Student's statistic with its first Edgeworth term (Hall, Annals of Statistics 11, 1983,
/// "Inverting an Edgeworth expansion"). Squared errors are skew: mean and s rise and fall together,
/// and mean + z s is too low far more often than it says. The two vectors are of one size, not
/// empty.
double upperMeanBound(
    const std::vector<double>& weighted, const std::vector<double>& weights, double confidence);

} // namespace lumivdb
