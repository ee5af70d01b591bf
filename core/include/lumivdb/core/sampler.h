// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file sampler.h
/// Answers from a volume: what light arrives at any point, for any normal.
///
/// @code
///   VolumeSampler sampler(volume);                     // compiles a flat look-up form, O(cells)
///   Color E = sampler.irradiance(position, normal);    // irradiance on a surface there
/// @endcode
///
/// The compiled form holds what it needs, as the volume was when the sampler was made: the volume
/// may change or end afterwards. It is read-only, allocation-free when queried, and shared by all
/// threads; copies of a sampler share it.
///
/// **No popping.** Trilinear, Gradient, Tricubic and InverseDistance are continuous inside a
/// volume, across changes of level too: a cell that touches finer ones is split once more, with
/// the fine samples where there are some on its border and interpolated nodes elsewhere, chosen so
/// that all cells round a face or an edge agree on it. Nearest and Taylor jump by nature. What
/// remains: an invalid sample has no value, so that interpolants may turn fast beside it, and jump
/// across a face or an edge of which no corner is valid; inside a cell with visibility they jump
/// where a wall divides what is seen.
///
/// Queries of a Float sampler give the same bits on every processor and by every call, one at a
/// time or many; of a Half one too.

#include <lumivdb/core/volume.h>

#include <cstdint>
#include <memory>

namespace lumivdb {

/// How samples are combined.
enum class Interpolation {
    Nearest, ///< the nearest valid corner of the cell
    Taylor, ///< the nearest valid corner, moved by its gradient: I + ∇I·d (seed 000)
    Trilinear, ///< the eight corners, weights renormalised over valid ones
    /// Expansions at each corner first, then trilinear (seed 000), with half of each gradient:
    /// I + ½∇I·d. The whole Taylor expansion overshoots a curved function by just what trilinear
    /// interpolation misses; half is exact for quadratic ones. Linear ones stay exact, also where
    /// only some corners are seen.
    Gradient,
    Tricubic, ///< Hermite, from values and gradients at the corners
    /// Weights 1/distance (seed 000), times the trilinear ones, without which they would jump at
    /// every face. Exact at a corner.
    InverseDistance,
};

const char* name(Interpolation mode);
bool needsGradients(Interpolation mode);

/// How the compiled form holds coefficients.
enum class Precision {
    Float, ///< as the volume does
    /// Half the memory, faster where memory is the limit: relative error 5e-4 (of a value at least
    /// 1e-9 of the volume's largest).
    Half,
};

struct SamplerOptions {
    Interpolation mode = Interpolation::Trilinear;
    Precision precision = Precision::Float;
    /// World units; irradiance() looks at the position moved this far along the normal, off the
    /// surface that it is on.
    double normalBias = 0;
};

/// What a query found besides its value.
struct QueryInfo {
    int level = -1; ///< level of the volume's cell that answered; −1: outside the volume
    float validity = 0; ///< interpolated validity of the corners, 0 … 1
};

namespace detail {
struct SamplerForm;
}

class VolumeSampler {
public:
    /// @throws Error(Usage) when the mode needs gradients and @a volume has none.
    explicit VolumeSampler(
        const IrradianceVolume& volume, Interpolation mode = Interpolation::Trilinear);
    VolumeSampler(const IrradianceVolume& volume, const SamplerOptions& options);
    ~VolumeSampler();

    Interpolation mode() const { return mOptions.mode; }
    const SamplerOptions& options() const { return mOptions; }
    /// The best mode the volume supports: Gradient with gradients, else Trilinear.
    static Interpolation bestMode(const IrradianceVolume& volume);

    /// Radiance coefficients at world position @a p → @a L[bands²].
    /// Outside the volume (info.level = −1) L is NaN. Points on the outer faces are inside.
    /// Where no corner is valid, all corners are used and info.validity tells.
    QueryInfo radiance(const Vec3d& p, Color* L) const;

    /// Irradiance at @a p for unit normal @a n, in the volume's units times steradian.
    /// NaN outside the volume.
    Color irradiance(const Vec3d& p, const Vec3f& n, QueryInfo* info = nullptr) const;

    /// @a count queries at once: E[i] for p[i], n[i]; @a info may be null. Same values as the
    /// single calls, bit for bit.
    void irradiance(std::size_t count, const Vec3d* p, const Vec3f* n, Color* E,
        QueryInfo* info = nullptr) const;

    /// Bytes of the compiled form.
    std::size_t memoryBytes() const;

private:
    SamplerOptions mOptions;
    std::shared_ptr<const detail::SamplerForm> mForm;
};

} // namespace lumivdb
