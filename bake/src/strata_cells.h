// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file strata_cells.h
/// The cells that the strata make on the sphere, and the borders between them.

#include <lumivdb/bake/environment.h>

#include <cstddef>
#include <cstdint>
#include <vector>

namespace lumivdb {

/// A grid of squares over the equal-area map, each given to the stratum that owns most of it along
/// the Hilbert curve. Every stratum owns at least one square and none is shared, so the cells tile
/// the sphere for any number of strata. Above kMaxCells strata, 2^k consecutive ones share a cell.
class StrataCells {
public:
    static constexpr std::size_t kMaxCells = std::size_t{1} << 20;

    explicit StrataCells(std::size_t strata);

    std::size_t count() const { return mSolidAngle.size(); }
    std::size_t strata() const { return mStrata; }
    std::size_t cellOf(std::size_t stratum) const { return stratum >> mShift; }
    /// Strata of the cell that @a stratum is in, which is the first of them where startsCell().
    std::size_t strataInCellOf(std::size_t stratum) const;
    bool startsCell(std::size_t stratum) const { return cellOf(stratum) << mShift == stratum; }
    std::size_t cellAt(const Vec3f& direction) const;
    float solidAngle(std::size_t cell) const { return mSolidAngle[cell]; }

    /// Straight pieces of the borders: arcs of great circles between neighbouring corners of the
    /// grid, the sphere's seam (the square's rim) included. Structure of arrays.
    struct Borders {
        std::vector<std::uint32_t> a, b; ///< cells on both sides
        std::vector<float> x, y, z; ///< unit direction of the middle
        std::vector<float> nx, ny, nz; ///< normal from a to b along the sphere × length, radians
        /// A multiple of 8: the last ones may have no length.
        std::size_t size() const { return a.size(); }
        void push(
            std::uint32_t cellA, std::uint32_t cellB, const Vec3f& direction, const Vec3f& normal);
    };
    const Borders& borders() const { return mBorders; }

private:
    void addBorder(
        int x0, int y0, int x1, int y1, std::uint32_t a, std::uint32_t b, const Vec3d& fromAToB);
    void addBordersOf(int x, int y);
    Vec3d corner(int x, int y) const;
    Vec3d middle(int x, int y) const;

    std::size_t mStrata;
    int mShift = 0;
    int mSide; // squares along each side
    std::vector<std::uint32_t> mCell; // of square [y * side + x]
    std::vector<float> mSolidAngle;
    Borders mBorders;
};

/// Mean radiance of @a environment over each cell. Sampled both evenly and by importance, combined
/// by the balance heuristic, so that neither a sun nor an even sky is noisy.
std::vector<Color> environmentMeans(const StrataCells& cells, const Environment& environment);

} // namespace lumivdb
