// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file resample.h
/// Making volumes from volumes: spacing, bands, crop, transform, sums, joins. None changes its
/// input.

#include <lumivdb/core/progress.h>
#include <lumivdb/core/sampler.h>
#include <lumivdb/core/volume.h>

#include <optional>
#include <string>
#include <vector>

namespace lumivdb {

/// The first @a bands bands of every sample (more bands than there are: padded with zeros).
IrradianceVolume withBands(const IrradianceVolume& volume, int bands);

/// The same volume without gradient channels.
IrradianceVolume withoutGradients(const IrradianceVolume& volume);

/// A uniform volume of @a spacing (world units) over the same box, interpolated from @a volume in
/// @a mode; lattice points that coincide with a sample take its record unchanged.
/// Keeps the lattice's rotation and origin; the box is grown to whole cells of the new spacing,
/// points outside the old volume take the nearest point of it. Queries honour visibility; the
/// result has it, and offsets, only at the old spacing, where old samples and finest cells stay.
/// Gradients are not resampled.
IrradianceVolume resampleUniform(const IrradianceVolume& volume, double spacing, Interpolation mode,
    Progress* progress = nullptr);

/// Fewer cells for nearly the same light: eight sibling cells become one where trilinear
/// interpolation between the corners that remain gives back every sample that goes, within
/// @a tolerance (RMS of irradiance over normals, relative to the volume's mean irradiance) and
/// rounding. Up to @a levels levels coarser; neighbours stay 2:1 balanced; cells with visibility or
/// with moved samples are left, and so are those of which some corners are valid and some are not.
/// Lattice and spacing stay. @throws Error(Usage) for levels outside 0 … 12 or a bad tolerance.
IrradianceVolume coarsenVolume(const IrradianceVolume& volume, int levels, double tolerance);

/// The cells that touch the world box @a box with more than a face, with their visibility.
/// @throws Error(Usage) when none does.
IrradianceVolume cropVolume(const IrradianceVolume& volume, const Box3d& box);

/// Moves the volume by the similarity @a m (row vectors: p' = p * m): lattice transform, radiance
/// coefficients (rotated exactly), gradients (rotated and divided by the scale), distances
/// (scaled), offsets (rotated and scaled). Visibility is in the lattice's axes and stays.
/// @throws Error(Usage) for shear, mirror, non-uniform scale or a non-finite entry.
IrradianceVolume transformVolume(const IrradianceVolume& volume, const Mat4d& m);

/// The rotation that takes +Y up to +Z up: (x, y, z) → (x, −z, y), or back.
Mat4d upAxisRotation(const std::string& from, const std::string& to);

/// Multiplies radiance and gradients by @a factor.
void scaleVolume(IrradianceVolume& volume, double factor);

/// Σ factor_i · volume_i: scenarios and light groups as linear sums. Same topology, lattice, bands
/// gradients, offsets and visibility required (@throws Error(Usage) naming what differs and the
/// input's index).
/// Validity and distance are the first volume's.
IrradianceVolume addVolumes(
    const std::vector<const IrradianceVolume*>& volumes, const std::vector<double>& factors);

/// The union of volumes baked apart over one lattice: cells of all, shared samples once.
/// @throws Error(Usage) when lattices, bands or gradients differ, cells overlap with different
/// levels, a shared sample's record or a shared cell's visibility differs (naming its position).
/// Where the invalid samples of all have been filled (fillInvalid()), those of the union are too.
IrradianceVolume joinVolumes(const std::vector<const IrradianceVolume*>& volumes);

/// How far @a b is from @a a: relative RMS of irradiance over random points of their common bounds
/// and a fixed set of normals, both with trilinear interpolation, worst channel.
double compareVolumes(
    const IrradianceVolume& a, const IrradianceVolume& b, std::size_t points, std::uint64_t seed);

} // namespace lumivdb
