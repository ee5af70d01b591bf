// SPDX-License-Identifier: Apache-2.0
#include "mean_bound.h"

#include <cmath>
#include <cstddef>
#include <numeric>

namespace lumivdb {

double normalQuantile(double p)
{
    const double t = std::sqrt(-2 * std::log(1 - p));
    return t
        - (2.515517 + t * (0.802853 + t * 0.010328))
        / (1 + t * (1.432788 + t * (0.189269 + t * 0.001308)));
}

double upperMeanBound(
    const std::vector<double>& weighted, const std::vector<double>& weights, double confidence)
{
    const double total = std::accumulate(weights.begin(), weights.end(), 0.0);
    const double mean = std::accumulate(weighted.begin(), weighted.end(), 0.0) / total;
    double second = 0, third = 0;
    for (std::size_t i = 0; i < weighted.size(); ++i) {
        const double d = weighted[i] - weights[i] * mean;
        second += d * d;
        third += d * d * d;
    }
    if (!(second > 0)) return mean;
    const double z = normalQuantile(confidence);
    const double skewness = third / (second * std::sqrt(second)); // of the mean
    return mean + std::sqrt(second) / total * (z + skewness * (2 * z * z + 1) / 6);
}

} // namespace lumivdb
