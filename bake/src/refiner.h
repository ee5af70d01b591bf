// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file refiner.h
/// Decides the cells of an adaptive volume; see refine.h for what each heuristic asks.

#include "octree.h"
#include "outlook.h"
#include "sample_store.h"
#include "visibility_cell.h"

#include <lumivdb/bake/geometry_cells.h>
#include <lumivdb/bake/refine.h>

#include <tbb/enumerable_thread_specific.h>

#include <unordered_map>

namespace lumivdb {

/// Cells, and how wrong each is thought to be.
struct RefinedCells {
    std::vector<CellKey> cells; ///< sorted
    /// Per cell: its part of the volume's mean squared error relative to the mean irradiance.
    std::vector<double> contribution;
};

class Refiner {
public:
    /// @a meanE: mean irradiance of the volume, per channel, what errors are related to.
    Refiner(const Tracer& tracer, SampleStore& store, const RefineOptions& options,
        const LatticeBox& box, int levels, const Vec3d& meanE);

    /// Restricts the work to these roots.
    void setRoots(std::vector<CellKey> roots);

    /// Cells are no longer split once the store holds this many samples.
    void limitSamples(std::size_t samples) { mMaxSamples = samples; }
    /// Whether the last run() would have split more.
    bool isLimited() const { return mLimited; }
    /// RMS of the surplus over all cells measured so far, with and without the samples' gradients.
    double rmsSurplus(bool gradients) const;

    /// Part of the volume's box that lies in @a cell.
    double share(const CellKey& cell) const;

    /// Decides with the error threshold @a threshold (the other thresholds are the options') and
    /// sees to it that the corners of all cells are in the store. May be called again with a lower
    /// one: nothing is traced or measured twice. Its steps in @a outlook are below steps().
    RefinedCells run(double threshold, Outlook& outlook);
    /// The highest threshold that brings about @a samples more than @a now, the last run()'s cells,
    /// but not below @a least. What the children of split cells want is not foreseen.
    double lowerThreshold(const RefinedCells& now, double samples, double least) const;
    int steps() const { return 3 * mTree.levels() + 1; }

private:
    struct Measure {
        double error2 = 0; ///< worst channel of ‖Δ‖² / mean(E)², over free space
        double plain2 = 0; ///< the same without gradients
    };
    void refineLevel(std::vector<CellKey>& cells, Outlook& outlook);
    void measure(const std::vector<CellKey>& cells, Outlook& outlook);
    bool wantsSplit(const CellKey& cell) const;
    bool followsNeighbours(const Octree& tree, const CellKey& cell) const;
    void cull(Outlook& outlook);
    RefinedCells result(Outlook& outlook);

    std::vector<Coord> testPoints(const CellKey& cell) const;
    Measure measureAt(const CellKey& cell, const std::vector<Coord>& points) const;
    struct Difference {
        Vec3d error2{0, 0, 0}, plain2{0, 0, 0}; ///< relative to mean(E)², noise taken off
    };
    Difference differenceAt(
        const CellKey& cell, const CellVisibility* cut, const Coord& point) const;
    std::optional<CellVisibility> cutOf(const CellKey& cell) const;
    Vec3d placeIn(const CellKey& cell, const Vec3d& world) const;
    double change(const CellKey& cell) const;
    double harmonicDistance(const CellKey& cell) const;
    bool touchesGeometry(const CellKey& cell) const;
    Box3d worldBox(const CellKey& cell) const;
    bool mayGrow(std::size_t points);
    /// Error of a cell in units of the threshold's: √(error2) · 2^1.5(level − levels).
    double weighted(const CellKey& cell, double error2) const;

    const Tracer& mTracer;
    SampleStore& mStore;
    const RefineOptions& mOptions;
    Vec3d mMeanE;
    Octree mTree;
    GeometryCells mGeometry;
    double mThreshold = 0;
    std::size_t mMaxSamples = ~std::size_t{0};
    bool mLimited = false;
    std::unordered_map<CellKey, Measure, CellKeyHash> mMeasured;
    std::unordered_map<CellKey, bool, CellKeyHash> mTouched;
    /// Of measured cells; those that are not here see all their corners.
    std::unordered_map<CellKey, CellVisibility, CellKeyHash> mCuts;
    struct Cutter {
        CellCutter cutter;
        std::vector<std::uint32_t> triangles;
    };
    mutable tbb::enumerable_thread_specific<Cutter> mCutters;
};

} // namespace lumivdb
