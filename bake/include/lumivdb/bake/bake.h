// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file bake.h
/// The bake: a scene in, an irradiance volume out. And its judge: evaluateVolume().

#include <lumivdb/bake/probe.h>
#include <lumivdb/core/sampler.h>
#include <lumivdb/core/volume.h>

#include <optional>
#include <string>
#include <vector>

namespace lumivdb {

/// Options of one bake; toCommandLine() reproduces it, and the volume stores that.
enum class GradientMethod {
    None,
    Central ///< six extra projections at ±δ under the same directions and random numbers (seed
            ///< 000); δ = spacing/8, or half the distance to the nearest surface where that is less
};

/// Options of one bake. Lengths in scene units.
struct BakeOptions {
    ProbeOptions probe;
    int bands = 3; ///< 1 … 6
    GradientMethod gradients = GradientMethod::None;
    double spacing = 0; ///< distance between samples; 0: chosen from the scene
    std::optional<Box3d> bounds; ///< default: the scene's, grown by one cell
    std::string lightGroup; ///< stored in the metadata; see selectLightGroup()
    std::string commandLine; ///< stored in the metadata
    int threads = 0; ///< 0: all cores
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

struct BakeReport {
    std::uint64_t samples = 0;
    std::vector<std::uint64_t> cellsByLevel;
    std::uint64_t rays = 0; ///< shadow rays included
    double raysPerSecond = 0;
    double secondsTrace = 0;
    double spacing = 0; ///< the one used
    double meanRelativeStderr = 0; ///< mean standard error of E over mean E
    std::vector<std::string> decisions; ///< what was chosen where nothing was given, and why
    std::vector<std::string> warnings;
};

struct BakeResult {
    IrradianceVolume volume;
    BakeReport report;
};

/// The spacing a bake uses when none is given: the longest side of the scene's box / 20, rounded
/// down to 1, 2 or 5 × 10^k, kMinSpacing at least. 0.1 for an empty box.
double defaultSpacing(const Box3d& sceneBounds);

/// Bakes a uniform volume. Samples lie on the lattice of latticeTransform(spacing), so the volume
/// covers the bounds, grown to whole cells. A sample within 5e-4 spacing of a surface is moved off
/// it, to the side that sees fewer back faces, then to the one from which fewer rays escape. Same
/// inputs, same bits, for any thread count and for any split of the bounds.
/// @throws Error(Usage) for bad options or more than 2³¹ samples; Error(Interrupted).
BakeResult bakeVolume(
    const Tracer& tracer, const BakeOptions& options, Progress* progress = nullptr);

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
    int threads = 0;
    void validate() const;
};

struct EvaluateReport {
    double relRmse = 0; ///< sqrt(mean |E−E_ref|²)/mean(E_ref), worst channel
    double p50 = 0, p95 = 0, p99 = 0, max = 0; ///< of |E−E_ref|/mean(E_ref), worst channel each
    double bias = 0; ///< mean(E−E_ref)/mean(E_ref), channel of largest magnitude
    double referenceStderr = 0; ///< sqrt(mean stderr²)/mean(E_ref), worst channel
    std::size_t points = 0;
    std::size_t rejected = 0; ///< random points inside geometry, not counted
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
/// of the volume's box and a uniform set of normals. The scene must be in the volume's frame.
EvaluateReport evaluateVolume(const IrradianceVolume& volume, const Tracer& tracer,
    const EvaluateOptions& options, Progress* progress = nullptr);

/// Unit vectors spread evenly over the sphere (spherical Fibonacci).
std::vector<Vec3f> uniformNormals(int count);

} // namespace lumivdb
