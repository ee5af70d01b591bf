// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file bake_plan.h
/// A bake with everything decided that can be decided before the first sample.

#include "sample_baker.h"

#include <lumivdb/bake/bake.h>

#include <cmath>

namespace lumivdb {

struct BakePlan {
    SampleSettings samples;
    LatticeBox box; ///< cells with lower ≤ origin < upper are asked for
    int levels = 0;
    /// From the pilot; zero where there was no need of one.
    Vec3d meanE{0, 0, 0};
    double noisePerRay = 0, truncation = 0;
    /// The target error, or what the bands leave out where that is more: then the target is out of
    /// reach, and less noise or interpolation error would be work for nothing.
    double goal = 0;
    double secondsPerDirection = 0; ///< of a sample, as the first look at the light found
};

/// Fills in what @a options leave open and says why in @a report.
BakePlan planBake(
    const Tracer& tracer, const BakeOptions& options, BakeReport& report, Progress& progress);

/// The box that such a bake will cover (world), known before anything is traced.
/// @throws Error(Usage) as planBake().
Box3d bakeBox(const Tracer& tracer, const BakeOptions& options);

/// About how many samples it will trace; those of a uniform one exactly. @throws Error(Usage) as
/// planBake().
double foreseenSamples(const Tracer& tracer, const BakeOptions& options);

/// %g text of a number for sentences.
std::string shortText(double v);
/// A relative quantity as percent.
std::string percentText(double v);

/// A bake with levels: see bakeVolume(). Fills everything of @a report but the seconds of a whole.
IrradianceVolume bakeAdaptive(const Tracer& tracer, const BakeOptions& options,
    const BakePlan& plan, BakeReport& report, Progress& progress);

} // namespace lumivdb
