// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file volume_fill.h
/// Values for samples inside geometry.

#include <lumivdb/core/volume.h>

namespace lumivdb {

/// Gives every invalid sample a value from valid ones: the mean of the samples with which it shares
/// a cell, weighted by 1/distance², ring by ring until all that can be reached have one; others are
/// black. Gradients become 0. Validity stays as it is, so that queries never use them, but pictures
/// show no holes. A volume filled twice is the volume filled once, bit for bit.
void fillInvalid(IrradianceVolume& volume);

} // namespace lumivdb
