// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file environment.h
/// Light from infinitely far away, as an image over the sphere.
///
/// The image stays in the projection it came in; texels are areas of constant radiance, not points,
/// so there is no half-pixel bias and no filtering that would smear a sun. Look-up, sampling and
/// pdf agree exactly: sampling draws a texel by luminance × solid angle, then a point in it.

#include <lumivdb/core/types.h>

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace lumivdb {

enum class EnvironmentProjection {
    Auto, ///< aspect 2:1 lat-long; 1:1 angular map; 3:4 or 4:3 cube cross
    LatLong, ///< d = (sin πv·cos 2π(u−½), cos πv, sin πv·sin 2π(u−½)), row 0 on top
    AngularMap, ///< Debevec's light probe: centre −Z forward, rim +Z; see docs/CONVENTIONS.md
    CubeCross ///< vertical (3:4) or horizontal (4:3) cross
};

struct EnvironmentOptions {
    EnvironmentProjection projection = EnvironmentProjection::Auto;
    float scale = 1.0f; ///< multiplies radiance
    double rotateDegrees = 0.0; ///< turns the light right-handed about +Y
};

class Environment {
public:
    /// Reads any HDR, EXR or other image OpenImageIO reads (8-bit images are decoded from sRGB).
    /// NaN, infinite and negative pixels are replaced by 0 and counted in @a warnings.
    /// @throws Error(Input): missing, unreadable, aspect that fits no projection, no pixels.
    static std::shared_ptr<const Environment> load(const std::string& path,
        const EnvironmentOptions& options, std::vector<std::string>& warnings);

    /// From pixels in memory: row 0 on top, width × height colours. For Auto see above.
    static std::shared_ptr<const Environment> fromPixels(
        int width, int height, std::vector<Color> pixels, const EnvironmentOptions& options);

    /// The same radiance @a L from everywhere.
    static std::shared_ptr<const Environment> constant(const Color& L);

    /// The same light, turned further: light from d then comes from d * R (row vectors).
    std::shared_ptr<const Environment> rotated(const Mat3d& R) const;

    ~Environment();

    /// Radiance arriving from unit direction @a d (pointing away from the viewer).
    Color radiance(const Vec3d& d) const;

    struct Sample {
        Vec3d direction;
        Color radiance;
        double pdf; ///< per steradian; 0: no sample (black map, or outside the image disc)
        bool sun = false; ///< of the sun, else of the sky
    };
    /// Draws a direction from u, v ∈ [0,1). Continuous in (u, v) almost everywhere, so that
    /// stratified (u, v) give stratified directions.
    Sample sample(double u, double v) const;

    /// The part of the image that is a sun: a few texels much brighter than the others, beside
    /// each other, that hold a good part of the flux (environment_sun.h). The rest is the sky.
    struct Sun {
        double share = 0; ///< of power(); 0: there is none, else below 1
        Vec3d direction{0, 1, 0}; ///< of its middle
        double radius = 0; ///< radians, of the cone about it that it lies in
    };
    Sun sun() const;
    /// sample() of one part alone. The pdf given is still that of sample(): within the sun the
    /// density is that over share, within the sky that over 1 − share.
    /// @pre of sampleSun(): sun().share > 0
    Sample sampleSun(double u, double v) const;
    Sample sampleSky(double u, double v) const;
    /// sampleSky() from independent numbers, in three steps, so that many draws can wait for
    /// memory together: for all prefetchDraw(t), for all drawTexel(t), for all sampleTexel() of
    /// what that gave. t draws the texel, (u, v) the point in it. @pre power() > 0
    void prefetchDraw(double t) const;
    std::uint32_t drawTexel(double t) const;
    Sample sampleTexel(std::uint32_t texel, double u, double v) const;
    /// sample() from independent numbers. @pre power() > 0
    Sample draw(double t, double u, double v) const;
    /// Density of sample() and of draw() at @a d, per steradian.
    double pdf(const Vec3d& d) const;
    struct Arrival {
        Color radiance;
        double pdf;
        bool sun = false; ///< whether d is in the sun
    };
    /// radiance() and pdf() at once.
    Arrival arrival(const Vec3d& d) const;

    /// ∫ luminance dω, for choosing between lights.
    double power() const;

    /// Radiance SH coefficients, bands² colours, by quadrature inside every texel.
    std::vector<Color> project(int bands) const;
    /// The same in double precision, [coefficient][channel].
    std::vector<Vec3d> projectDouble(int bands) const;

    std::uint64_t contentHash() const;

private:
    Environment();
    struct Impl;
    std::shared_ptr<const Impl> mImpl;
};

} // namespace lumivdb
