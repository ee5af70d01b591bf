// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file verification.h
/// Proves the error of an adaptive volume at points that its bake never used.

#include "bake_plan.h"
#include "evaluator.h"
#include "refiner.h"

namespace lumivdb {

/// Looks at one volume, at ever more points: what earlier looks have traced counts in later ones.
class Verification {
public:
    /// Everything is kept by reference. @a rays: directions at a point, twice. Each @a number has
    /// points of its own.
    Verification(const Tracer& tracer, const BakeOptions& options, const BakePlan& plan,
        const RefinedCells& cells, const IrradianceVolume& volume, int rays, int number);

    /// Looks at points until @a points of them are traced in all; the bound of the error at all of
    /// them holds with @a confidence. @throws Error(Interrupted).
    AchievedError look(std::size_t points, double confidence, Progress& progress);

private:
    std::pair<Vec3d, double> draw(std::size_t number) const;
    double density(const Vec3d& lattice) const;
    std::vector<double> brightness(const IrradianceVolume& volume) const;

    const BakeOptions& mOptions;
    const BakePlan& mPlan;
    const RefinedCells& mCells;
    /// What the volume says it fills, in the plan's lattice: what was asked for or, where that ends
    /// inside the volume's finest cells, up to a cell more.
    LatticeBox mBox;
    EvaluateOptions mEvaluate;
    Evaluator mEvaluator;
    /// How often each cell is drawn, and sums of that; empty: points are drawn evenly.
    std::vector<double> mShares, mSums;
    std::size_t mPoints = 0;
};

} // namespace lumivdb
