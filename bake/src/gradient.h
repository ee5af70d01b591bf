// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file gradient.h
/// Derivatives of radiance SH coefficients with respect to the probe's position, from the rays that
/// found the coefficients.
///
/// A Lambertian scene sends the same radiance to every place, so that moving the probe by t moves
/// what it sees: a point at distance r, by −t⊥/r on the sphere of directions. Radiance taken as
/// constant in each cell changes at borders alone. With n from cell a to cell b along the sphere,
///
///     ∂L_lm/∂t = Σ over borders  Y_lm · length · (n·t) · (L_b − L_a) · q,   q = max(q_a, q_b),
///
/// q being inverse distances at the border: the nearer surface owns the edge (Ward & Heckbert 1992;
/// Annen et al., EGSR 2004; Křivánek et al., TVCG 2005). q_a is taken on the tangent plane of what
/// the cell's ray met, which makes it exact between rays that met the same plane; infinity has 0.
///
/// Small lights are found by emitter samples, at points fixed on the light. Their part of the
/// light, L_e times its weight of the balance heuristic, both frozen to the surface point, has the
/// derivative of Y(ω)·cosθ'/r² while it is visible, plus what edges uncover. Points fixed on the
/// light already move with q_e, edges with q, so a border adds (q − q_e) of it: nothing at the
/// light's own outline, where q = q_e (the split of interior and boundary of Reynolds' theorem).
/// The same split lets the surface behind an edge be denoised where the edge uncovers it.

#include "emitters.h"
#include "path.h"
#include "strata_cells.h"

#include <lumivdb/core/sh.h>

#include <memory>
#include <vector>

namespace lumivdb {

/// What a cell's rays brought, as borders need it.
struct CellLight {
    Color interior{0, 0, 0}; ///< radiance along the rays, emitter samples' share apart
    Color edge{0, 0, 0}; ///< the same, denoised; mean of the environment where nothing was met
    InversePlane plane; ///< of the nearest surface met
    Color emitter{0, 0, 0}; ///< mean radiance by emitter samples
    Vec3f emitterSlope{0, 0, 0}; ///< their mean InversePlane::slope
};

/// An emitter sample that arrived, in its cell.
struct EmitterArrival {
    std::uint32_t cell;
    Color value; ///< radiance / density
    Vec3f slope; ///< see InversePlane
};

/// Sums Σ v·∂(Y g)/∂p over points fixed in space that give v·Y(ω)·g, with ∂g/∂p = g·(3qω − s): for
/// a surface g = cosθ'/r² and s its plane's slope.
class FixedPointSums {
public:
    void reset(int bands);
    struct Point {
        Vec3f direction;
        float inverse; ///< q = 1/r
        Vec3f slope; ///< s
        Color value; ///< v
    };
    /// Takes whole batches or less; @a points are consumed in order.
    void add(const Point* points, int count);
    void add(const FixedPointSums& o);
    /// Adds scale × the derivatives, as ProbeResult::gradient in double, [·][channel].
    void addTo(double scale, std::vector<double>& gradient) const;

private:
    int mBands = 0;
    std::vector<double> mMoment; // Σ v q Y, [coefficient][channel]
    std::vector<double> mShift; // Σ v Y ((l+3) q ω − s), [coefficient][channel][axis]
};

/// What all points of one estimator share.
struct GradientTables {
    GradientTables(std::size_t strata, const Environment* environment);
    StrataCells cells;
    std::vector<Color> environment; ///< mean radiance of each cell; empty where there is none
};

/// The part of a gradient that consecutive strata give: filled by one thread.
class GradientCollector {
public:
    void reset(const GradientTables& tables, int bands, CellLight* cells);
    /// Strata [first, first + n) of the batch; a cell's strata must come in order.
    void collect(const PathBatchResult& batch, std::size_t first, int n);
    const FixedPointSums& emitters() const { return mEmitters; }
    const std::vector<EmitterArrival>& arrivals() const { return mArrivals; }

private:
    void collectEmitters(const PathBatchResult& batch, int n);
    const GradientTables* mTables = nullptr;
    CellLight* mCells = nullptr;
    FixedPointSums mEmitters;
    std::vector<EmitterArrival> mArrivals;
    FixedPointSums::Point mPoints[kBatch];
};

/// Gradient of one probe: collectors' parts in order, then the borders.
class GradientSums {
public:
    void reset(const GradientTables& tables, int bands);
    CellLight* cells() { return mCells.data(); }
    void add(const GradientCollector& part);
    void addPunctual(const Light& light, const Vec3f& localPosition, const Vec3f& p,
        const PunctualSample& sample);
    /// Derivatives per world unit, [axis · coefficients + coefficient].
    std::vector<Color> finish();

private:
    void findDistances();
    void denoise();
    Color changeAt(std::size_t border) const;
    void addBorders(std::vector<double>& gradient) const;
    const GradientTables* mTables = nullptr;
    int mBands = 0;
    std::vector<CellLight> mCells;
    std::vector<float> mInverseA, mInverseB; // of both sides of each border
    std::vector<Color> mDenoised;
    std::vector<int> mNeighbours;
    FixedPointSums mEmitters, mPunctual;
};

/// Relative derivative of a punctual light's irradiance at @a p, ∇E/E, where E > 0.
Vec3d punctualLogDerivative(const Light& light, const Vec3d& position, const Vec3d& p);

/// ∂S_lm/∂axis = Σ of solidDerivative(axis)[lm · kMaxCoefficients + j] · Y_j on the unit sphere, S
/// being the solid harmonic |x|^l Y_lm(x/|x|); j runs over degree l − 1.
const double* solidDerivative(int axis);

} // namespace lumivdb
