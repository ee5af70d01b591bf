// SPDX-License-Identifier: Apache-2.0
#include "probes.h"

#include <lumivdb/core/sh.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

constexpr int kTile = 16; // pixels
constexpr float kInvPi = 0.318309886183790672f;

/// Level of the finest cell at each sample.
std::vector<int> finestLevels(const IrradianceVolume& volume)
{
    std::vector<int> level(volume.sampleCount(), kMaxLevel);
    for (std::size_t c = 0; c < volume.cellCount(); ++c) {
        const Cell& cell = volume.cell(CellId(c));
        for (const SampleId s : cell.corners) level[s] = std::min(level[s], int(cell.level));
    }
    return level;
}

/// Lowest and highest of x/z over the box [x ± r] × [z ± r], z > r.
void slopes(double x, double z, double r, double* low, double* high)
{
    *low = std::min((x - r) / (z - r), (x - r) / (z + r));
    *high = std::max((x + r) / (z - r), (x + r) / (z + r));
}

} // namespace

Probes::Probes(const IrradianceVolume& volume, const View& view, int width, int height)
    : mVolume(volume)
    , mColumns((width + kTile - 1) / kTile)
    , mRows((height + kTile - 1) / kTile)
    , mTiles(std::size_t(mColumns) * mRows)
{
    const std::vector<int> level = finestLevels(volume);
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        const double radius = kProbeRadius * std::ldexp(volume.spacing(), level[s]);
        const Sphere sphere{volume.measuredWorld(s), radius};
        // One before the eye would hide what lies behind it.
        if ((sphere.centre - view.eye).dot(view.forward) < 14 * radius) continue;
        mProbes.push_back({sphere, s});
        addToTiles(view, width, height, std::uint32_t(mProbes.size() - 1));
    }
}

void Probes::addToTiles(const View& view, int width, int height, std::uint32_t index)
{
    const Sphere& s = mProbes[index].sphere;
    const Vec3d d = s.centre - view.eye;
    const double z = d.dot(view.forward);
    double left, right, bottom, top;
    slopes(d.dot(view.right), z, s.radius, &left, &right);
    slopes(d.dot(view.up), z, s.radius, &bottom, &top);
    const auto tile = [](double slope, double tangent, int pixels, int tiles) {
        const double at = (0.5 + 0.5 * slope / tangent) * pixels / kTile;
        return int(std::floor(std::clamp(at, -1.0, double(tiles))));
    };
    const int x0 = tile(left, view.tanX, width, mColumns);
    const int x1 = tile(right, view.tanX, width, mColumns);
    const int y0 = tile(-top, view.tanY, height, mRows);
    const int y1 = tile(-bottom, view.tanY, height, mRows);
    for (int y = std::max(y0, 0); y <= std::min(y1, mRows - 1); ++y)
        for (int x = std::max(x0, 0); x <= std::min(x1, mColumns - 1); ++x)
            mTiles[std::size_t(y) * mColumns + x].push_back(index);
}

bool Probes::shade(const Vec3d& eye, const Vec3d& direction, int x, int y, double nearest,
    Color* colour, bool* invalid) const
{
    const Probe* found = nullptr;
    for (const std::uint32_t i : mTiles[std::size_t(y / kTile) * mColumns + x / kTile]) {
        const double t = mProbes[i].sphere.intersect(eye, direction);
        if (t < 0 || t >= nearest) continue;
        nearest = t;
        found = &mProbes[i];
    }
    if (!found) return false;
    *invalid = !mVolume.isValid(found->sample);
    *colour = Color(0);
    if (*invalid) return true;
    const Vec3d n = (eye + direction * nearest - found->sphere.centre).normalized();
    const Color E = irradiance(mVolume.bands(), mVolume.radiance(found->sample), Vec3f(n));
    for (int c = 0; c < 3; ++c) (*colour)[c] = kSphereAlbedo * kInvPi * std::max(E[c], 0.0f);
    return true;
}

} // namespace lumivdb
