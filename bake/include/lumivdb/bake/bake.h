// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file bake.h
/// The bake: a scene in, an irradiance volume out. And its judge: evaluateVolume().

#include <lumivdb/bake/probe.h>
#include <lumivdb/bake/radiance_cache.h>
#include <lumivdb/bake/refine.h>
#include <lumivdb/core/sampler.h>
#include <lumivdb/core/volume.h>

#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace lumivdb {

class SampleJournal;

/// Asks for a volume whose error is at most @a error and proves it: samples are added until points
/// that the bake never used agree. See bakeVolume().
struct ErrorTarget {
    double error = 0; ///< relative RMS of irradiance, e.g. 0.02; 0: no target
    double confidence = 0.95; ///< one-sided
    std::size_t maxSamples = 2000000; ///< samples the bake may trace before it gives up
    bool chooseRays = true; ///< false: BakeOptions::probe.rays is kept
    bool chooseGradients = true; ///< false: BakeOptions::gradients is kept
};

/// How light on its way to a sample is found.
enum class Integrator {
    Path, ///< unbiased path tracing
    Cached ///< one ray a direction, what it meets looked up: see radiance_cache.h
};
const char* name(Integrator integrator);

/// Options of one bake. Lengths in scene units.
struct BakeOptions {
    ProbeOptions probe; ///< its cache is the bake's affair
    Integrator integrator = Integrator::Path;
    int bands = 3; ///< 1 … 6; 0: as few as the scene's light allows
    GradientMethod gradients = GradientMethod::None;
    double spacing = 0; ///< finest distance between samples; 0: chosen from the scene
    int levels = 0; ///< coarser levels: cells up to spacing · 2^levels; 0: uniform; −1: chosen
    RefineOptions refine; ///< where levels are above 0
    ErrorTarget target; ///< with one, levels = 0 means −1, and refine's error threshold is chosen
    std::optional<Box3d> bounds; ///< default: the scene's, grown by one cell
    bool visibility = true; ///< masks of what is seen from where in cells that geometry cuts
    int part = 1, parts = 1; ///< bake part number `part` of `parts`, to be joined later
    std::string lightGroup; ///< stored in the metadata; see selectLightGroup()
    std::string commandLine; ///< stored in the metadata
    int threads = 0; ///< 0: all cores
    /// File that keeps the samples traced, so that a bake that was killed can go on; "": none. It
    /// stays when the bake is done, see BakeResult::journal.
    std::string journal;
    bool resume = false; ///< take from the journal what an earlier bake left there
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

/// What verification on points that the bake never used has found.
struct AchievedError {
    double relRmse = -1; ///< of the points, the reference's own noise taken off; −1: not measured
    double upper = -1; ///< bound that holds with `confidence`
    double confidence = 0;
    std::size_t points = 0;
    bool met = true; ///< upper ≤ the target
    struct Place {
        Vec3d position;
        double error;
    };
    std::vector<Place> worst; ///< up to 10, largest first
};

struct BakeReport {
    std::uint64_t samples = 0;
    std::vector<std::uint64_t> cellsByLevel;
    std::uint64_t rays = 0; ///< shadow rays included
    std::uint64_t tracedSamples = 0; ///< tests and what was merged again included
    std::uint64_t journalSamples = 0; ///< those that were not traced but taken from the journal
    double raysPerSecond = 0;
    double secondsTrace = 0, secondsRefine = 0;
    double secondsVerify = 0; ///< of a target, and of the cache's bias
    double spacing = 0; ///< the one used
    int raysPerSample = 0; ///< the number used; a mean where each sample has its own
    double meanRelativeStderr = 0; ///< mean standard error of E over mean E
    std::size_t cutCells = 0; ///< cells with visibility masks
    AchievedError achieved;
    Integrator integrator = Integrator::Path; ///< the one used
    RadianceCacheReport cache; ///< where one was solved
    CacheBias bias; ///< where it was used
    std::vector<std::string> decisions; ///< what was chosen where nothing was given, and why
    std::vector<std::string> warnings;
};

struct BakeResult {
    IrradianceVolume volume;
    BakeReport report;
    /// Null without one. The file stays, and no other bake can have it, as long as this lives:
    /// until the volume is in its place.
    std::shared_ptr<SampleJournal> journal;
};

/// The spacing a bake uses when none is given: the longest side of the scene's box / 20, rounded
/// down to 1, 2 or 5 × 10^k, kMinSpacing at least. 0.1 for an empty box.
double defaultSpacing(const Box3d& sceneBounds);

/// Bakes a volume. Samples lie on the lattice of latticeTransform(spacing), so separate bakes of
/// one scene share theirs. A uniform volume covers the bounds, grown to whole cells; the coarse
/// cells of an adaptive one may reach beyond, latticeBounds() tells what was asked for. A sample
/// within 5e-4 spacing of a surface is moved off it, to the side that sees fewer back faces, then
/// to the one from which fewer rays escape; one inside a solid is moved out where that is nearer
/// than a spacing, else it is filled from its neighbours and stays invalid. Same inputs, same bits,
/// for any thread count, any split of the bounds of a uniform bake, and for parts joined.
///
/// With a target: pilot probes choose bands, rays and gradients; the error threshold is lowered,
/// round by round, until the error at fresh random points, with its confidence, is within the
/// target. Points are drawn half evenly, half where the bake thinks it is wrong, and weighed
/// accordingly. Those points are always traced by `path`, so the bound holds for a cached bake too;
/// where the cache's bias alone could take half of the target, `path` is used instead.
/// Where it cannot be met, the report says so and the volume is what was reached.
///
/// With a journal, a bake that was interrupted or killed at any moment goes on where it was, with
/// BakeOptions::resume, and makes the same volume, bit for bit, on any number of threads. Only
/// samples are kept: pilot probes, and points that prove a target, are traced again. A kill costs
/// about two seconds of work, a power cut about ten. A journal that cannot be written, or that
/// another running bake holds, is done without; Progress::warn() says so at once, the report too.
/// @throws Error(Usage) for bad options, more than 2³¹ samples or a journal of another bake;
/// Error(Interrupted).
BakeResult bakeVolume(
    const Tracer& tracer, const BakeOptions& options, Progress* progress = nullptr);

/// Deletes the journal of a bake whose volume is in its place, where it has one.
void removeJournal(const BakeResult& result);

/// A point that lies on a surface (within half of @a clearance, world units) has two answers, on an
/// edge four, in a corner eight. Returns a place @a clearance off all of them: the one that sees
/// fewest back faces, then the one from which fewest rays escape (inside rather than outside), then
/// the front. Other points come back as they are.
Vec3d moveOffSurfaces(const Tracer& tracer, const Vec3d& point, double clearance);

struct EvaluateOptions {
    std::size_t points = 1000;
    int rays = 4096; ///< per point, of the reference
    int normals = 32;
    std::uint64_t seed = 7001;
    Interpolation mode = Interpolation::Trilinear;
    Contribution contribution = Contribution::All; ///< must be the volume's
    int maxBounces = -1;
    std::vector<Vec3d> givenPoints; ///< used instead of random ones when not empty
    std::vector<double> weights; ///< one per given point, where they were not drawn evenly
    /// The reference is the mean of two independent ones of `rays` each, whose noise, known from
    /// their difference, does not enter EvaluateReport::upper: few rays at many points then bound
    /// the error as well as they can.
    bool twice = false;
    double confidence = 0.95; ///< of EvaluateReport::upper, one-sided
    int threads = 0;
    void validate() const;
};

struct EvaluateReport {
    double relRmse = 0; ///< sqrt(mean |E−E_ref|²)/mean(E_ref), worst channel
    /// relRmse with the reference's noise taken off; and an upper bound of relRmse at the options'
    /// confidence, from the spread over the points, noise and all unless `twice`.
    double relRmseDebiased = 0, upper = 0;
    double p50 = 0, p95 = 0, p99 = 0, max = 0; ///< of |E−E_ref|/mean(E_ref), worst channel each
    double bias = 0; ///< mean(E−E_ref)/mean(E_ref), channel of largest magnitude
    double referenceStderr = 0; ///< sqrt(mean stderr²)/mean(E_ref), worst channel
    std::size_t points = 0;
    /// Points inside geometry, or so little behind a single-sided surface that the volume counts
    /// them to its front (2⁻¹² of their cell's width); not counted.
    std::size_t rejected = 0;
    std::size_t outside = 0; ///< given points outside the volume, not counted
    int normals = 0;
    double queryNs = 0; ///< nanoseconds per irradiance query, one thread
    struct Worst {
        Vec3d position;
        double error; ///< RMS over normals and channels / mean(E_ref)
    };
    std::vector<Worst> worst; ///< up to 10, largest first
};

/// Compares a volume with an independent trace at random free-space points (not inside geometry)
/// of the volume's latticeBounds() and a uniform set of normals. The scene must be in the volume's
/// frame.
EvaluateReport evaluateVolume(const IrradianceVolume& volume, const Tracer& tracer,
    const EvaluateOptions& options, Progress* progress = nullptr);

/// Unit vectors spread evenly over the sphere (spherical Fibonacci).
std::vector<Vec3f> uniformNormals(int count);

} // namespace lumivdb
