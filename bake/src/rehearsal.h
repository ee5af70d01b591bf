// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file rehearsal.h
/// An adaptive bake with few directions, to know how long the bake itself will take.

#include "bake_plan.h"
#include "outlook.h"

#include <vector>

namespace lumivdb {

/// Samples of a bake, and their directions.
struct SampleCount {
    double samples = 0, directions = 0;
};

/// What a rehearsal tells of a bake.
struct Forecast {
    std::vector<Outlook::Step> first; ///< of the first round; empty: nothing is known
    int pass = 0, places = 0; ///< the first round's last pass; places of one, Refiner::steps()
    /// Seconds to find what the first round's cells see, to look at its volume, and to prove one.
    double cells = 0, look = 0, proof = 0;
    double perSample = 0, perDirection = 0; ///< seconds; of a sample besides its directions
    SampleCount round, ahead; ///< of the first round, and of those that are thought to follow
    double growth = 0.65; ///< directions go as this power of the samples, 0.42 to 0.78 seen
};

/// Rehearses the bake while its user is told so by @a outlook.
Forecast rehearse(const Tracer& tracer, const BakeOptions& options, const BakePlan& plan,
    const BakeReport& report, Outlook& outlook);

} // namespace lumivdb
