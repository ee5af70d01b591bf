// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file lpv_units.h
/// Between the state of lpv_kernel.h, intensity, and radiance; and volumes of it.

#include "lpv_field.h"

#include <lumivdb/core/volume.h>

#include <functional>

namespace lumivdb::detail {

/// Share of the spacing that decides where a surface on a border between cells belongs.
constexpr double kTie = 1e-3;

/// ∫ (A + B·w) dw = 4π A.
constexpr double kFluxOfA = 12.56637061435917295385;

/// State of a surface with unit normal @a n that sends @a flux diffusely: flux/π times two bands of
/// max(0, n·w), ¼ + ½ n·w.
CellState cosineLobe(const Vec3d& flux, const Vec3d& n);

/// State of the intensity Σ I[i] Y_i(w), and back.
CellState fromIntensity(const Color (&I)[4]);
void toIntensity(const CellState& state, Color (&I)[4]);

/// From the sum of a cell's fronts to coefficients of the radiance that arrives there; see lpv.h
/// for the derivation. Light that goes along w comes from −w, so that odd bands change sign.
class LpvToRadiance {
public:
    explicit LpvToRadiance(double spacing);
    void operator()(const CellState& state, Color* L) const;

private:
    float mBand0, mBand1;
};

/// Calls f(s) for all samples, in parallel.
void forSamples(const IrradianceVolume& volume, const std::function<void(SampleId)>& f);

/// What every volume of propagated light has besides radiance: metadata, distances, blocking.
void finishVolume(
    IrradianceVolume& volume, const std::function<Vec3f(const Cell&)>& blocking, bool geometry);

} // namespace lumivdb::detail
