// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>

namespace lumivdb {

/// Adds the seconds of its life to a sum.
class Seconds {
public:
    explicit Seconds(double& sum)
        : mSum(sum)
    {
    }
    ~Seconds()
    {
        mSum += std::chrono::duration<double>(std::chrono::steady_clock::now() - mStart).count();
    }
    Seconds(const Seconds&) = delete;
    Seconds& operator=(const Seconds&) = delete;

private:
    double& mSum;
    std::chrono::steady_clock::time_point mStart = std::chrono::steady_clock::now();
};

} // namespace lumivdb
