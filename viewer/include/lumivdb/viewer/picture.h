// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file picture.h
/// Headless pictures: a scene shaded by a volume, and slices as false-colour images.

#include <lumivdb/bake/probe.h>
#include <lumivdb/bake/tracer.h>
#include <lumivdb/core/progress.h>
#include <lumivdb/core/sampler.h>

#include <optional>
#include <string>
#include <vector>

namespace lumivdb {

struct Image {
    int width = 0, height = 0;
    std::vector<Color> pixels; ///< scene-linear, row 0 on top
};

struct PictureOptions {
    int width = 960, height = 540; ///< pixels, 1 … 16384 each
    int samplesPerPixel = 9; ///< 1 … 4096; rays on a square grid inside each pixel (rounded to one)
    std::optional<Vec3d> eye,
        target; ///< default: the scene's first camera, else a view of its bounds
    double yfovDegrees = 0; ///< vertical, 0 … 179; 0: the scene camera's where it is used, else 50
    int spheres = 5; ///< white test spheres in a row across the view, 0 … 1000; 0: none
    bool probes = false; ///< the volume's samples in place of the test spheres
    Interpolation mode = Interpolation::Trilinear;
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

/// The scene seen by a camera; every surface shows emission + albedo/π · max(0, E(volume)), the
/// background the environment. Points outside the volume are drawn with no reflected light.
///
/// The volume is asked kQueryOffset spacings off the surface, on the side that is seen (a "normal
/// bias"): a wall may lie exactly in a lattice plane, where two cells, one on each side of it,
/// would answer, and samples behind a wall would shade it from the dark inside of a box or from
/// outdoors. The price is light that is blurred over that distance. The spheres have albedo 0.8,
/// their radius is 4% of the width of the view where they are, less where only a part of the view
/// has room; those that would touch geometry, hide behind it or leave the volume are left out. They
/// receive light from the volume and cast none back.
///
/// With probes, every sample is a white sphere where it was measured, kProbeRadius of the finest
/// cell at it wide, lit by its own coefficients; invalid samples are red. Those about the eye are
/// left out. Same inputs, same bits, for any number of
/// threads.
/// @throws Error(Usage) for bad options or a scene and volume that give nothing to look at;
/// Error(Interrupted).
Image renderPicture(const Tracer& tracer, const IrradianceVolume& volume,
    const PictureOptions& options, Progress* progress = nullptr);

/// Distance off a surface at which renderPicture() asks the volume, in units of its spacing.
constexpr double kQueryOffset = 0.5;
/// Radius of a sample's sphere, in widths of the finest cell at it.
constexpr double kProbeRadius = 0.08;
/// Reflectance of the test spheres.
constexpr float kSphereAlbedo = 0.8f;

struct SliceOptions {
    int axis = 1; ///< 0 x, 1 y, 2 z
    double position = 0; ///< world units along the axis
    int width = 960; ///< pixels, 16 … 16384; the height follows from the box
    Interpolation mode = Interpolation::Trilinear;
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

/// Rows of a slice's legend below the map: a bar of the colours and numbers under it.
constexpr int kLegendRows = 56;

/// Irradiance averaged over normals (luminance), ∫E(n) dn / 4π = π Y00 L00, on a plane through the
/// volume, as a false-colour image (viridis) over log10 from @a low to @a high, which are chosen
/// from the data (1% and 99%) and returned in the volume's units of irradiance; they may be null.
/// Places outside the volume are black, those of a validity below kValidThreshold grey.
///
/// The plane is seen from its positive axis: x: −z to the right, +y up; y: +x to the right, −z up;
/// z: +x to the right, +y up. The map covers the volume's box; the last kLegendRows rows are the
/// legend (without numbers where the system has no font). Pixels are display colours (sRGB): write
/// them with writeDisplayImage().
/// @throws Error(Usage) when @a position misses the volume, naming the range.
Image renderSlice(
    const IrradianceVolume& volume, const SliceOptions& options, double* low, double* high);

/// The octree on a plane through the volume: every cell filled with the colour of its level (fine
/// ones bright, coarse ones dark), its outline dark, surfaces of the scene white lines. The legend
/// names the width of the cells of each level. Frame and legend as in renderSlice(); the mode is
/// not used. @a tracer's scene must be in the volume's frame.
/// @throws Error(Usage) like renderSlice().
Image renderLevels(
    const Tracer& tracer, const IrradianceVolume& volume, const SliceOptions& options);

struct ErrorMapOptions {
    SliceOptions slice;
    ProbeOptions reference; ///< the trace that the volume is compared with
    int blocks = 96; ///< blocks of pixels across the map, 1 … 4096
    /// @throws Error(Usage) naming the field, its value and the range.
    void validate() const;
};

/// Shares of the slice's mean irradiance.
struct ErrorMapReport {
    double meanReference = 0; ///< that mean itself, over places and normals
    double meanError = 0;
    double meanNoise = 0; ///< standard error of the reference, which the map cannot see below
    double low = 0, high = 0; ///< what the colours span
    std::size_t points = 0; ///< in free space
};

/// Where a slice is wrong: |E − E_ref| (luminance, mean over 16 normals) over the mean of E_ref in
/// the slice, for a block of pixels each, as false colours over the logarithm; the legend is in
/// percent. E_ref is traced at the middle of each block. Grey: inside geometry; white lines:
/// surfaces. @a tracer's scene must be in the volume's frame. Same inputs, same bits.
/// @throws Error(Usage) like renderSlice(); Error(Interrupted).
Image renderError(const Tracer& tracer, const IrradianceVolume& volume,
    const ErrorMapOptions& options, ErrorMapReport* report, Progress* progress = nullptr);

/// Colour of places of low validity in a slice, sRGB.
constexpr float kInvalidGrey = 0.5f;

/// Refuses what writeImage() could not write by its name, so that nobody waits for a picture in
/// vain. @throws Error(Usage) listing the extensions .png and .exr.
void checkImagePath(const std::string& path);

/// Writes .png (8-bit sRGB, exposed so that the 95th percentile of luminance is 0.8 unless
/// @a exposureStops are given, which multiply by 2^stops; NaN there means automatic) or .exr
/// (32-bit float, linear, as is), atomically: a temporary file in the same folder, fsync, rename.
/// In .png, exposed values up to 0.5 are shown exactly; brighter ones approach 1 smoothly, so that
/// lamps and sunlit places keep their shape: 1 − 0.5 exp(−(x − 0.5)/0.5) per channel. NaN is black.
/// Same image, same bytes.
/// @throws Error(Output) naming file and reason; Error(Usage) for another extension.
void writeImage(const Image& image, const std::string& path, double exposureStops);
/// The same without exposure or conversion, for images that are display colours already.
void writeDisplayImage(const Image& image, const std::string& path);

/// The factor writeImage() uses for @a exposureStops of NaN: 0.8 over the 95th percentile of the
/// luminance of pixels that are neither black (an empty background) nor infinite nor NaN; 1 where
/// there are none.
double automaticExposure(const Image& image);

} // namespace lumivdb
