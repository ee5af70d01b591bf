// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file rehearsal.h
/// An adaptive bake with few directions, to know how long the bake itself will take.

#include "bake_plan.h"
#include "outlook.h"

#include <vector>

namespace lumivdb {

/// What a rehearsal tells of a bake.
struct Forecast {
    /// Refinement down to one threshold.
    struct Pass {
        int number; ///< Outlook::Step::pass; of the first round's, the last
        double cells; ///< seconds to find what the cells see
        std::vector<Outlook::Step> steps;
    };
    std::vector<Pass> passes; ///< the first round in one; empty: nothing is known
    int places = 0; ///< of a pass, Refiner::steps()
    double look = 0, proof = 0; ///< seconds to look at the first round's volume, and to prove one
    int last = 0; ///< the pass whose volume is thought to be proven

    /// Steps up to pass @a end and the proof of its volume. Passes that were not rehearsed are
    /// thought to take longer as the last ones did.
    std::vector<Outlook::Step> plan(int end) const;

private:
    Pass pass(std::size_t i) const;
};

/// Rehearses the bake while its user is told so by @a outlook.
Forecast rehearse(const Tracer& tracer, const BakeOptions& options, const BakePlan& plan,
    const BakeReport& report, Outlook& outlook);

} // namespace lumivdb
