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

/// Copies radiance, gradients, validity and distance between volumes of one record shape.
void copyRecord(const IrradianceVolume& from, SampleId s, IrradianceVolume& to, SampleId t);
/// True when all of that is equal bit for bit.
bool sameRecord(const IrradianceVolume& a, SampleId s, const IrradianceVolume& b, SampleId t);

/// The measured error is of another field than this one: says so.
void forgetError(VolumeMetadata& metadata);

} // namespace lumivdb
