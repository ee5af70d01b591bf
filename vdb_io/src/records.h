// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file records.h
/// Small steps that every operation on volumes shares.

#include <lumivdb/core/volume.h>

#include <string>
#include <vector>

namespace lumivdb {

inline GradientStorage gradientStorage(const IrradianceVolume& volume)
{
    return volume.hasGradients() ? GradientStorage::PerCoefficient : GradientStorage::None;
}

/// Copies radiance, gradients (not offsets), validity and distance between volumes of one record
/// shape.
void copyRecord(const IrradianceVolume& from, SampleId s, IrradianceVolume& to, SampleId t);
/// True when all of that and the offsets are equal bit for bit.
/// Without @a colors radiance and gradients may differ.
bool sameRecord(const IrradianceVolume& a, SampleId s, const IrradianceVolume& b, SampleId t,
    bool colors = true);

/// Gives @a to the offsets of the samples and the visibility and blocking of the cells that it
/// shares with the volumes @a from (cells of the same level), the first of them that has each.
void copyPlaces(const std::vector<const IrradianceVolume*>& from, IrradianceVolume& to);

/// The measured error is of another field than this one: says so.
void forgetError(VolumeMetadata& metadata);

} // namespace lumivdb
