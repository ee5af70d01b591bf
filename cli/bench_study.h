// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file bench_study.h
/// What `lumivdb bench` measures: which configurations, on which scene, against which reference.

#include <lumivdb/bake/bake.h>
#include <lumivdb/bake/lpv_bake.h>

#include <string>
#include <vector>

namespace lumivdb::cli {

/// How a volume is made.
enum class BenchMethod {
    Path, ///< paths traced from every sample
    Cached, ///< one ray a direction, what it meets looked up in the radiance cache
    Lpv, ///< light propagation: geometry in the way, one reflection
    LpvMany, ///< and many
    LpvOpen ///< one reflection, nothing in the way
};

/// A bake, and the ways in which its volume is then queried.
struct BenchConfiguration {
    BenchMethod method = BenchMethod::Path;
    double spacing = 0;
    int levels = 0; ///< 0: uniform
    double threshold = 0; ///< of error-driven refinement, where there are levels
    int bands = 3;
    GradientMethod gradients = GradientMethod::None;
    std::vector<Interpolation> modes;
    double expectedCost = 0; ///< in any unit, for the estimate of the time left
};

const char* name(GradientMethod gradients);
/// "path", "cached" or "lpv".
const char* integrator(const BenchConfiguration& c);
/// "uniform", "adaptive", "lpv", "lpv-many" or "lpv-open".
const char* representation(const BenchConfiguration& c);

/// The configurations of a scene of this size; @a finest is the smallest spacing of all.
/// @a quick leaves out all but the telling ones; direct light alone, what propagates.
std::vector<BenchConfiguration> benchConfigurations(
    const Box3d& bounds, double finest, bool quick, Contribution contribution);

/// Where a bake's seconds went.
struct BenchStages {
    double solve = 0; ///< of the radiance cache
    double trace = 0; ///< and all that is none of the others
    double refine = 0;
    double verify = 0; ///< the measured bias of a cache
};

/// One configuration and one interpolation.
struct BenchRow {
    std::string scene;
    BenchConfiguration configuration;
    Interpolation mode = Interpolation::Trilinear;
    double bakeSeconds = 0;
    BenchStages stages; ///< their sum is bakeSeconds
    std::uint64_t rays = 0, samples = 0, bytes = 0; ///< bytes of the sampler
    double queryNs = 0;
    double relRmse = 0, p50 = 0, p95 = 0, p99 = 0, referenceStderr = 0;
    /// No other row of the scene has less error for the same seconds (bytes) or fewer of them for
    /// the same error.
    bool bestForSeconds = false, bestForBytes = false;
};

/// Sets the last two of all rows.
void markPareto(std::vector<BenchRow>& rows);

/// Irradiance at random free points of a scene's box, traced once for all of its volumes.
class BenchReference {
public:
    /// @throws Error(Input) where the box has no free points, Error(Interrupted).
    BenchReference(const Tracer& tracer, std::size_t points, int rays, Contribution contribution,
        std::uint64_t seed, Progress& progress);

    /// Fills the row's query time, bytes and errors, as EvaluateReport defines them.
    void measure(const IrradianceVolume& volume, BenchRow& row) const;

private:
    struct Point {
        Vec3d position;
        std::vector<Color> irradiance, error; // per normal
    };
    void tracePoints(
        const ProbeEstimator& estimator, std::size_t begin, std::size_t count, Progress& progress);
    double queryNs(const VolumeSampler& sampler) const;

    Box3d mBounds;
    std::uint64_t mSeed;
    std::vector<Vec3f> mNormals;
    std::vector<Point> mPoints;
};

} // namespace lumivdb::cli
