// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file direct_light.h
/// How direct light differs over a patch of a surface, from samples of it.

#include <algorithm>
#include <cmath>

namespace lumivdb {

/// Direct light differs between a patch's quarters by this share of its mean: divided, or mixed.
constexpr double kContrast = 0.5;
/// The same as a share of the scene's mean, below which nobody will notice.
constexpr double kContrastOfScene = 0.1;

/// Direct light at places of a patch.
struct DirectLight {
    double sum[4] = {}, squares[4] = {}; ///< by quarter of the patch
    int count[4] = {};
    double lowest = 1e300, highest = 0; ///< of what has no noise: lights without size

    void add(int quarter, double value, double punctual)
    {
        sum[quarter] += value;
        squares[quarter] += value * value;
        ++count[quarter];
        lowest = std::min(lowest, punctual);
        highest = std::max(highest, punctual);
    }
    int samples() const { return count[0] + count[1] + count[2] + count[3]; }
    double mean() const
    {
        return samples() > 0 ? (sum[0] + sum[1] + sum[2] + sum[3]) / samples() : 0;
    }
    double variance() const ///< of one sample
    {
        const double n = samples(), m = mean();
        const double square = squares[0] + squares[1] + squares[2] + squares[3];
        return n > 1 ? std::max(0.0, square / n - m * m) * n / (n - 1) : 0;
    }
    /// Difference between the brightest quarter and the darkest, two standard errors taken off.
    double contrast() const
    {
        double low = 1e300, high = -1e300, lowVariance = 0, highVariance = 0;
        for (int q = 0; q < 4; ++q) {
            if (count[q] < 2) continue;
            const double n = count[q], m = sum[q] / n;
            const double variance = std::max(0.0, squares[q] / n - m * m) / (n - 1);
            if (m < low) {
                low = m;
                lowVariance = variance;
            }
            if (m > high) {
                high = m;
                highVariance = variance;
            }
        }
        return std::max(0.0, high - low - 2 * std::sqrt(lowVariance + highVariance));
    }
    bool changes(double sceneMean) const
    {
        const double least = kContrastOfScene * sceneMean;
        return contrast() > std::max(kContrast * mean(), least)
            || highest - lowest > std::max(kContrast * highest, least);
    }
};

} // namespace lumivdb
