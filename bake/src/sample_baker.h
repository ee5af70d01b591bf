// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file sample_baker.h
/// One sample of a volume: a lattice point in, its record out.

#include "sample_journal.h"

#include <lumivdb/bake/probe.h>
#include <lumivdb/core/volume.h>

#include <functional>

namespace lumivdb {

struct SampleSettings {
    ProbeOptions probe;
    /// Of a point of the coarsest lattice. Finer ones stand for less space and may have more noise
    /// within the tolerance, see SampleBaker.
    StopRule stop;
    int levels = 0; ///< the coarsest lattice has every 2^levels-th point
    int bands = 3;
    GradientMethod gradients = GradientMethod::None;
    double spacing = 1; ///< of the lattice
    /// How far gradients will be used, see gradientFactor(); 0: not yet known, they stay whole.
    double gradientReach = 0;
    /// In a rehearsal, the directions that the bake's samples begin with; its own have no more than
    /// they begin with.
    int rehearsedRays = 0;
    SampleJournal* journal = nullptr; ///< where samples are kept and taken from; null: nowhere
};

struct BakedSample {
    ProbeResult result; ///< in a rehearsal, with as many directions as are foreseen
    Vec3f offset{0, 0, 0}; ///< from the lattice point to where it was measured, world units
    Color variance; ///< of E, averaged over normals: Σ A_l² var(L_lm) / 4π
    std::uint64_t rays = 0;
};

/// A sample's number of directions is the settings' StopRule's. A point that is on the lattice of
/// every 2^l-th point but of no coarser one is the corner of cells of 8^l voxels: with volume as
/// weight, the best number of directions goes as the deviation times the square root of that.
class SampleBaker {
public:
    SampleBaker(const Tracer& tracer, const SampleSettings& settings);
    /// The record of lattice point @a c. The same point, settings and scene give the same bits. A
    /// point on a surface is moved off it, one inside geometry out of it where that is near.
    BakedSample bake(const Coord& c, ProbeEstimator::Workspace& workspace) const;
    /// Whether bake() will find it in the journal.
    bool isKept(const Coord& c) const
    {
        return mSettings.journal && mSettings.journal->holds(mKind, c);
    }
    Vec3d world(const Coord& c) const { return Vec3d(c.x, c.y, c.z) * mSettings.spacing; }
    const SampleSettings& settings() const { return mSettings; }

private:
    StopRule stopRule(const Coord& c) const;
    BakedSample trace(const Coord& c, ProbeEstimator::Workspace& workspace) const;
    void addGradient(const Vec3d& p, std::uint64_t key, ProbeEstimator::Workspace& workspace,
        BakedSample& sample) const;
    const Tracer& mTracer;
    SampleSettings mSettings;
    double mClearance; // distance kept from surfaces, world units
    ProbeEstimator mEstimator;
    SampleJournal::Kind mKind;
};

/// Stage of the samples that a journal had.
inline constexpr const char* kJournalStage = "read the journal";

/// Bakes @a count samples in parallel: number i, which lies at @a at(i), goes to @a store(i, …), on
/// any thread. In an order in which cheap and dear places mix, so that @a progress tells the time
/// that is left. @throws Error(Interrupted).
void bakeSamples(const SampleBaker& baker, std::size_t count,
    const std::function<Coord(std::size_t)>& at,
    const std::function<void(std::size_t, const BakedSample&)>& store, Progress& progress);

/// Bakes every sample of @a volume's topology and hands each to @a store, which any thread calls,
/// once a sample. @return where samples were moved to, empty if none was.
/// @throws Error(Interrupted).
std::vector<Vec3f> bakeSamples(const SampleBaker& baker, const IrradianceVolume& volume,
    const std::function<void(SampleId, const BakedSample&)>& store, Progress& progress);

} // namespace lumivdb
