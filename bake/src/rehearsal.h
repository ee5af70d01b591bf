// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file rehearsal.h
/// An adaptive bake with few directions, to know how long the bake itself will take.

#include "bake_plan.h"
#include "outlook.h"

namespace lumivdb {

/// Rehearses the bake, and plans @a outlook by that.
void rehearse(const Tracer& tracer, const BakeOptions& options, const BakePlan& plan,
    const BakeReport& report, Outlook& outlook);

} // namespace lumivdb
