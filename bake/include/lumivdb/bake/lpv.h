// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file lpv.h
/// Light propagation volumes: light that moves from cell to cell of a grid until it is spent. A
/// preview of a bake, and a live volume for engines: inject, propagate, ask, move the light, again.
///
/// Kaplanyan & Dachsbacher, "Cascaded Light Propagation Volumes for Real-Time Indirect
/// Illumination" (I3D 2010), with the corrections of A. Kirsch (2010): the solid angles of a
/// neighbour's faces are Ω_f = 4 atan(√11/33) = 0.40067 (front) and Ω_s = 2 atan(3/√11) − π/3
/// = 0.42343 (each of four sides), so that the six links of a cell cover the sphere; what arrives
/// at a face is sent on as flux/π times the cosine lobe of its normal.
///
/// @code
///   LpvOptions options;
///   options.spacing = 0.25;
///   LightPropagationVolume lpv(options, LightPropagationVolume::cellsOf(box, options.spacing));
///   lpv.setGeometry(blockers);                  // what stands in the way; once
///   for (;;) {
///       lpv.clearLight();
///       lpv.inject(surfels);                    // what the lights shine on, now
///       lpv.propagate({32, 1e-3});              // allocates nothing once it has seen the light
///       Color E = lpv.irradiance(position, normal);
///   }
///   IrradianceVolume volume = lpv.makeVolume(); // for files, samplers, pictures
/// @endcode
///
/// **Cells** are centred on the lattice that bakes use: cell (i, j, k) is round the point
/// spacing × (i, j, k), where the volume that makeVolume() gives has its sample. They live in
/// blocks of 8³, those of the leaves of an OpenVDB tree. Blocks exist where light has been, and
/// work is done where light is: the front.
///
/// **Light** enters half a cell before the surface that sends it (along its normal), in the cell
/// nearest to that place.
///
/// **Geometry** lies between the cells: geometry cell (i, j, k) spans the lattice points (i, j, k)
/// to (i+1, j+1, k+1), half a cell off, where the result has its cell. A surface of area a with
/// normal n covers the share a |n_x| / spacing² of the cell's cross section seen along x, and so on
/// along y and z, from whichever side. A link is stopped at the face between its cells by the mean
/// share of the face's four corners, limited to 1. (The paper keeps lobes of two bands of spherical
/// harmonics, a/spacing² max(0, n·w): they let a quarter of the light pass a wall that it meets at
/// right angles, all of it from behind, and stop some that goes along the wall. The five directions
/// of a link are within 27° of it and go through the same face, so that what covers the face counts
/// for all five: a closed wall is then closed, and light along it is free.)
///
/// **Result** is what has passed through each cell, in radiance. A link of a cell with isotropic
/// intensity I carries the flux (Ω_f + 4Ω_s) I = (2π/3) I, the same face under isotropic radiance L
/// carries π L spacing², hence L_0 = (2/3) I_0 / spacing². Of the first band, net flux through a
/// face: 2 (Ω_f + 4Ω_s·2/√5) I_1 = (4π/3) L_1 spacing², hence L_1 = 0.91463 I_1 / spacing². The
/// scheme itself is a kind of diffusion: see docs/ACCURACY.md for how far it is from the truth.
///
/// Same bits for any number of threads and any instruction set.

#include <lumivdb/bake/surfel.h>
#include <lumivdb/core/progress.h>
#include <lumivdb/core/volume.h>

#include <memory>
#include <optional>
#include <string>
#include <vector>

namespace lumivdb {

/// How negative lobes of a cell's two bands are treated.
enum class LpvScheme {
    Clamped, ///< max(0, I(w)), as in the paper. A cosine lobe gains 13.8% of its flux in one step
    Conservative, ///< as they are: linear, and not a bit of flux is gained or lost
};
enum class LpvOcclusion { Off, On };
enum class LpvBounces {
    One, ///< what geometry stops is gone
    Many ///< geometry sends it back, times its albedo, as a cosine lobe against the link
};

struct LpvOptions {
    double spacing = 0.25; ///< width of a cell, world units; ≥ kMinSpacing
    LpvScheme scheme = LpvScheme::Clamped;
    LpvOcclusion occlusion = LpvOcclusion::On;
    LpvBounces bounces = LpvBounces::One; ///< Many needs LpvOcclusion::On
    /// A cell whose largest coefficient falls below this share of the brightest injected one is
    /// dark: it bounds the front in an open volume. 0 … 0.1; 0 keeps all above 1e-30.
    double cutoff = 1e-12;
    int threads = 0; ///< 0: all cores

    /// @throws Error(Usage) naming field and value.
    void validate() const;
};

/// When propagate() ends.
struct LpvStop {
    int iterations = 32; ///< at most; ≥ 0
    /// Also once the front holds less than this share of the injected flux; 0: never.
    double tolerance = 0;
};

struct LpvReport {
    int iterations = 0; ///< done by this call
    /// Flux of the front, which has not been passed on, over the flux injected; all channels.
    double residual = 0;
    std::size_t activeCells = 0; ///< in blocks of the front, after the last iteration
};

/// A piece of surface that stands in the way of light.
struct Blocker {
    Vec3d position; ///< world
    Vec3f normal; ///< unit
    float area = 0; ///< world units squared
    Color albedo{0, 0, 0}; ///< reflectance of the side of the normal; for LpvBounces::Many
    Color albedoBehind{0, 0, 0}; ///< of the other side
};

/// Flux is ignored: a surfel that only stands in the way, black.
Blocker blockerOf(const Surfel& surfel);

class LightPropagationVolume {
public:
    /// @a cells: lattice points lower ≤ p < upper that have a cell; light that leaves them is lost.
    /// None: an unbounded volume.
    explicit LightPropagationVolume(
        const LpvOptions& options, const std::optional<LatticeBox>& cells = std::nullopt);
    ~LightPropagationVolume();
    LightPropagationVolume(LightPropagationVolume&&) noexcept;
    LightPropagationVolume& operator=(LightPropagationVolume&&) noexcept;

    const LpvOptions& options() const;
    const std::optional<LatticeBox>& cells() const;
    /// The smallest box of cells that makes a volume over all of @a world.
    static LatticeBox cellsOf(const Box3d& world, double spacing);
    /// Other cells; all light is cleared, memory and geometry stay.
    void setCells(const LatticeBox& cells);

    /// Replaces the geometry volume by the sum of @a blockers. Fluxes that are on their way stay.
    void setGeometry(const std::vector<Blocker>& blockers);
    /// Merges further views of the same surfaces: where two know a geometry cell, the one that
    /// blocks more counts, so that nothing is in the way twice.
    void addGeometry(const std::vector<Blocker>& blockers);

    /// Darkness; blocks stay for the next light.
    void clearLight();
    /// Adds the light of @a surfels. @return how many of them lie in cells. @throws Error(Usage)
    /// naming the first surfel that is not finite, before anything is added.
    std::size_t inject(const std::vector<Surfel>& surfels);
    /// Adds a source of radiant intensity Σ @a intensity[i] Y_i(w) in direction w (away from it),
    /// in flux per steradian, to the cell nearest to @a position. @return false outside the cells.
    bool injectSource(const Vec3d& position, const Color (&intensity)[4]);

    /// One iteration: the front moves on by a cell.
    void step();
    /// @throws Error(Interrupted) between two iterations: what has been propagated stands.
    LpvReport propagate(const LpvStop& stop, Progress* progress = nullptr);

    Vec3d frontFlux() const; ///< of the light that has not been passed on
    Vec3d injectedFlux() const; ///< since clearLight()
    std::size_t activeCells() const; ///< cells in blocks of the front
    std::size_t memoryBytes() const; ///< of blocks, fields and geometry

    /// Radiance coefficients at world position @a p, interpolated between cells → @a L[4]; two
    /// bands. False, and black, outside the cells.
    bool radiance(const Vec3d& p, Color* L) const;
    /// Irradiance at @a p for unit normal @a n; black outside the cells.
    Color irradiance(const Vec3d& p, const Vec3f& n) const;
    /// What the front holds in a cell: radiant intensity Σ @a I[i] Y_i(w), w the way it goes.
    void frontIntensity(const Coord& cell, Color (&I)[4]) const;

    /// Two bands of radiance at every cell, and the geometry volume as its blocking. Samples are
    /// valid and their distance +∞: surfels do not know solids. An unbounded volume has the blocks
    /// that light has reached; @throws Error(Usage) where there is none.
    IrradianceVolume makeVolume() const;
    /// Writes radiance again into a volume that makeVolume() made, after the light has changed.
    void updateVolume(IrradianceVolume& volume) const;
    bool hasGeometry() const;
    /// Share of the geometry cell with lower corner @a p that is covered, seen along x, y, z.
    Vec3f blocking(const Coord& p) const;

private:
    struct Impl;
    std::unique_ptr<Impl> mImpl;
};

struct LpvCascadeOptions {
    int cascades = 3; ///< 1 … 8; spacing doubles from each to the next
    /// Cells along each axis of a cascade: a multiple of 8, at least 24 where there are several.
    int cells = 32;
    /// Over how many of its cells the finer cascade fades into the coarser one, from its border
    /// inwards: 1 … cells/2 − 1.
    int blend = 4;

    /// @throws Error(Usage) naming field and value.
    void validate() const;
};

/// Nested volumes of doubling spacing around a point of interest. Each is fed and propagated for
/// itself; a finer one fades into the coarser, so that the border is continuous and at it both say
/// the same. Light from beyond a finer cascade's border is not in that cascade.
class LightPropagationCascades {
public:
    /// options.spacing is that of the finest cascade.
    LightPropagationCascades(
        const LpvOptions& options, const LpvCascadeOptions& cascades, const Vec3d& centre);

    const LpvCascadeOptions& cascadeOptions() const { return mOptions; }
    std::size_t size() const { return mVolumes.size(); }
    /// From the finest.
    const LightPropagationVolume& operator[](std::size_t i) const { return mVolumes[i]; }
    /// Moves the cascades round @a centre, by whole blocks. @return whether they moved; the light
    /// is then cleared.
    bool moveTo(const Vec3d& centre);

    /// As for one volume, in every cascade.
    void setGeometry(const std::vector<Blocker>& blockers);
    void addGeometry(const std::vector<Blocker>& blockers);
    void clearLight();
    std::size_t inject(const std::vector<Surfel>& surfels); ///< @return how many the coarsest holds
    /// Every cascade to its end; the report has the most iterations and the largest residual.
    LpvReport propagate(const LpvStop& stop, Progress* progress = nullptr);
    bool radiance(const Vec3d& p, Color* L) const;
    Color irradiance(const Vec3d& p, const Vec3f& n) const;

    /// One volume: cascade i is level i of its octree.
    IrradianceVolume makeVolume() const;
    void updateVolume(IrradianceVolume& volume) const;

private:
    /// Lattice points of cascade i, in its own lattice, that the result has: lower ≤ p ≤ upper.
    LatticeBox used(std::size_t i) const;
    /// Share of cascade i against coarser ones at @a p (world), 0 at its border.
    double weight(std::size_t i, const Vec3d& p) const;

    LpvOptions mLpv;
    LpvCascadeOptions mOptions;
    std::vector<LightPropagationVolume> mVolumes;
};

} // namespace lumivdb
