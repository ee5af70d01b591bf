// SPDX-License-Identifier: Apache-2.0
#include "lpv_units.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <limits>
#include <vector>

namespace lumivdb::detail {

namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kY0 = 0.28209479177387814347, kY1 = 0.48860251190291992159;

} // namespace

CellState cosineLobe(const Vec3d& flux, const Vec3d& n)
{
    CellState s = noLight();
    s[0] = Color(flux / (4 * kPi));
    for (int k = 0; k < 3; ++k) s[static_cast<std::size_t>(k) + 1] = Color(flux * n[k] / (2 * kPi));
    return s;
}

// The basis: Y_1 = −k10 y, Y_2 = k10 z, Y_3 = −k10 x.

CellState fromIntensity(const Color (&I)[4])
{
    const auto y0 = static_cast<float>(kY0), y1 = static_cast<float>(kY1);
    return {y0 * I[0], -y1 * I[3], -y1 * I[1], y1 * I[2]};
}

void toIntensity(const CellState& s, Color (&I)[4])
{
    const auto y0 = static_cast<float>(1 / kY0), y1 = static_cast<float>(1 / kY1);
    I[0] = y0 * s[0];
    I[1] = -y1 * s[2];
    I[2] = y1 * s[3];
    I[3] = -y1 * s[1];
}

LpvToRadiance::LpvToRadiance(double spacing)
{
    // Ω/4π as in lpv_kernel.h; 2 (Ω_f + 4 Ω_s 2/√5) / (4π/3).
    const double front = 0.03188428042925993, side = 0.0336955965593516898;
    const double along = 0.89442719099991587856;
    const double area = spacing * spacing;
    const double band0 = 2.0 / 3 / area;
    const double band1 = 2 * 4 * kPi * (front + 4 * side * along) / (4 * kPi / 3) / area;
    mBand0 = static_cast<float>(band0 / kY0);
    mBand1 = static_cast<float>(band1 / kY1);
}

void LpvToRadiance::operator()(const CellState& s, Color* L) const
{
    L[0] = mBand0 * s[0];
    L[1] = mBand1 * s[2];
    L[2] = -mBand1 * s[3];
    L[3] = mBand1 * s[1];
}

void forSamples(const IrradianceVolume& volume, const std::function<void(SampleId)>& f)
{
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, volume.sampleCount(), 1024),
        [&f](const tbb::blocked_range<std::size_t>& range) {
            for (std::size_t s = range.begin(); s < range.end(); ++s) f(static_cast<SampleId>(s));
        });
}

void finishVolume(
    IrradianceVolume& volume, const std::function<Vec3f(const Cell&)>& blocking, bool geometry)
{
    volume.metadata().contribution = "indirect";
    forSamples(volume,
        [&volume](SampleId s) { volume.distance(s) = std::numeric_limits<float>::infinity(); });
    if (!geometry) return;
    std::vector<Vec3f> all(volume.cellCount());
    for (std::size_t i = 0; i < all.size(); ++i)
        all[i] = blocking(volume.cell(static_cast<CellId>(i)));
    volume.setBlocking(std::move(all));
}

} // namespace lumivdb::detail
