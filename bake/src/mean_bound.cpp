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

double upperRelativeSquare(const std::vector<double>& squares, const std::vector<double>& values,
    const std::vector<double>& weights, double confidence)
{
    const auto sum
        = [](const std::vector<double>& v) { return std::accumulate(v.begin(), v.end(), 0.0); };
    const double total = sum(weights);
    const double square = sum(squares) / total, mean = sum(values) / total;
    const double ratio = square / (mean * mean);
    double second = 0, third = 0; // of each draw's influence on the ratio
    for (std::size_t i = 0; i < squares.size(); ++i) {
        const double d = (squares[i] - weights[i] * square) / (mean * mean)
            - 2 * ratio * (values[i] - weights[i] * mean) / mean;
        second += d * d;
        third += d * d * d;
    }
    if (!(second > 0)) return ratio;
    const double z = normalQuantile(confidence);
    const double skewness = third / (second * std::sqrt(second)); // of the ratio
    return ratio + std::sqrt(second) / total * (z + skewness * (2 * z * z + 1) / 6);
}

} // namespace lumivdb
