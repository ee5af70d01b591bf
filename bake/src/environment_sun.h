// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file environment_sun.h
/// The sun that an environment's image holds, as a part of its own.
///
/// A sun is small, so that one look at it says nearly all, and a wall hides all of it or nothing:
/// drawn together with the sky by luminance, it takes most of the rays wherever it is hidden.
/// Sun are the texels of at least kSunContrast times the image's mean luminance whose middle lies
/// within kSunRadius of the brightest one's, if they hold kSunShare of its flux or more. The radius
/// is wider than the sun's 0.27° for the glare that cameras and coarse texels put around it; of a
/// sun that the image clips below the contrast nothing need be told apart. Which texels count is a
/// matter of noise alone: sun and rest together are the image.

#include "environment_projection.h"

#include <cstddef>
#include <vector>

namespace lumivdb::detail {

constexpr double kSunContrast = 64;
constexpr double kSunRadius = 3.2; ///< degrees
constexpr double kSunShare = 0.1;

/// In double so that every texel with any positive channel keeps a positive weight.
inline double luminanceOf(const Color& c) { return 0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z; }

/// Index k of the step of the running sums @a cum that u · cum[n−1] falls in, and where in it (not
/// quite 0, not quite 1). Steps of no height are never chosen. Monotone in u.
int invertRunningSum(const double* cum, int n, double u, double& fraction);

/// The texels of a sun and their distribution, by luminance × solid angle.
class SunTexels {
public:
    SunTexels() = default;
    /// @a power: of all @a pixels, ∫ luminance dω. No sun where nothing else gives light.
    SunTexels(const ImageProjection& projection, const std::vector<Color>& pixels, double power);

    bool empty() const { return mColumns.empty(); }
    /// Whether @a texel, of @a luminance, is one of them.
    bool contains(Texel texel, double luminance) const
    {
        return !empty() && luminance >= mThreshold && find(texel);
    }
    double power() const { return mRowSums.empty() ? 0.0 : mRowSums.back(); }

    /// Texel and place in it: rows of the image along v, columns along u. @pre !empty()
    Texel draw(double u, double v, double& s, double& t) const;

    /// Unit, and radians: a cone with (to a texel's size) all of it. In the image's frame.
    const Vec3d& direction() const { return mDirection; }
    double radius() const { return mRadius; }

private:
    struct Row {
        int y;
        std::size_t first; ///< into mColumns; ends where the next one begins
    };
    bool find(Texel texel) const;
    void collect(const ImageProjection& projection, const std::vector<Color>& pixels, Texel middle);
    void bound(const ImageProjection& projection);

    double mThreshold = 0; // luminance
    std::vector<Row> mRows; // and one behind them
    std::vector<int> mColumns; // x of each texel, row by row
    std::vector<double> mColumnSums; // per row: running sums of luminance × solid angle
    std::vector<double> mRowSums; // running sums of the rows' totals
    Vec3d mDirection{0, 1, 0};
    double mRadius = 0;
};

} // namespace lumivdb::detail
