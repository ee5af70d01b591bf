// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/lpv.h>

#include "lpv_units.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/sh.h>

#include <algorithm>
#include <cmath>
#include <string>

namespace lumivdb {

namespace {

/// A cascade's cells begin at a whole block. @a centre in its lattice.
LatticeBox blocksRound(const Vec3d& centre, int cells)
{
    LatticeBox box;
    for (int a = 0; a < 3; ++a) {
        const double lower = std::round((centre[a] - 0.5 * cells) / 8) * 8;
        if (!(std::abs(lower) < kMaxLattice - 2 * cells)) {
            throw Error(ErrorCode::Usage,
                "The point of interest of light propagation cascades is beyond the lattice; take a "
                "larger spacing.");
        }
        box.lower[a] = static_cast<int>(lower);
        box.upper[a] = box.lower[a] + cells;
    }
    return box;
}

/// Nested boxes, each round the middle of the finer one: the finer then lies at least two cells
/// inside, so that levels of the result differ by one at most where they touch.
std::vector<LatticeBox> nestedBoxes(
    const LpvCascadeOptions& options, double spacing, const Vec3d& centre)
{
    std::vector<LatticeBox> boxes;
    Vec3d middle = centre / spacing;
    for (int i = 0; i < options.cascades; ++i) {
        boxes.push_back(blocksRound(middle, options.cells));
        middle = (Vec3d(boxes.back().lower) + Vec3d(0.5 * options.cells)) / 2;
    }
    return boxes;
}

[[noreturn]] void refuse(const std::string& field, int value, const std::string& range)
{
    throw Error(ErrorCode::Usage,
        "The " + field + " of light propagation cascades is " + std::to_string(value)
            + "; it must be " + range + ".");
}

} // namespace

void LpvCascadeOptions::validate() const
{
    if (cascades < 1 || cascades > 8) refuse("number", cascades, "1 to 8");
    if (cells < 8 || cells > 1024 || cells % 8 != 0)
        refuse("number of cells", cells, "a multiple of 8 up to 1024");
    if (cascades > 1 && cells < 24) refuse("number of cells", cells, "at least 24");
    if (blend < 1 || blend > cells / 2 - 1) refuse("blend width", blend, "1 to cells/2 - 1");
}

LightPropagationCascades::LightPropagationCascades(
    const LpvOptions& options, const LpvCascadeOptions& cascades, const Vec3d& centre)
    : mLpv(options)
    , mOptions(cascades)
{
    options.validate();
    cascades.validate();
    const std::vector<LatticeBox> boxes = nestedBoxes(cascades, options.spacing, centre);
    for (std::size_t i = 0; i < boxes.size(); ++i) {
        LpvOptions own = options;
        own.spacing = options.spacing * (1 << i);
        mVolumes.emplace_back(own, boxes[i]);
    }
}

bool LightPropagationCascades::moveTo(const Vec3d& centre)
{
    const std::vector<LatticeBox> boxes = nestedBoxes(mOptions, mLpv.spacing, centre);
    const auto moved = [&](std::size_t i) { return !(*mVolumes[i].cells() == boxes[i]); };
    bool any = false;
    for (std::size_t i = 0; i < size(); ++i) any = any || moved(i);
    if (!any) return false;
    clearLight();
    for (std::size_t i = 0; i < size(); ++i)
        if (moved(i)) mVolumes[i].setCells(boxes[i]);
    return true;
}

void LightPropagationCascades::setGeometry(const std::vector<Blocker>& blockers)
{
    for (LightPropagationVolume& v : mVolumes) v.setGeometry(blockers);
}

void LightPropagationCascades::addGeometry(const std::vector<Blocker>& blockers)
{
    for (LightPropagationVolume& v : mVolumes) v.addGeometry(blockers);
}

void LightPropagationCascades::clearLight()
{
    for (LightPropagationVolume& v : mVolumes) v.clearLight();
}

std::size_t LightPropagationCascades::inject(const std::vector<Surfel>& surfels)
{
    std::size_t used = 0;
    for (LightPropagationVolume& v : mVolumes) used = v.inject(surfels);
    return used;
}

LpvReport LightPropagationCascades::propagate(const LpvStop& stop, Progress* progress)
{
    LpvReport all;
    for (LightPropagationVolume& v : mVolumes) {
        const LpvReport one = v.propagate(stop, progress);
        all.iterations = std::max(all.iterations, one.iterations);
        all.residual = std::max(all.residual, one.residual);
        all.activeCells += one.activeCells;
    }
    return all;
}

// ---- Blending.

LatticeBox LightPropagationCascades::used(std::size_t i) const
{
    LatticeBox box = *mVolumes[i].cells();
    // A finer cascade ends where the coarser lattice has a point.
    const int last = i + 1 < size() ? 2 : 1;
    box.upper -= Coord(last, last, last);
    return box;
}

double LightPropagationCascades::weight(std::size_t i, const Vec3d& p) const
{
    const LatticeBox box = used(i);
    const Vec3d q = p / mVolumes[i].options().spacing;
    double inside = mOptions.blend; // cells from the border
    for (int a = 0; a < 3; ++a)
        inside = std::min({inside, q[a] - box.lower[a], box.upper[a] - q[a]});
    if (i + 1 == size()) return inside >= 0 ? 1 : 0;
    const double t = std::max(inside, 0.0) / mOptions.blend;
    return t * t * (3 - 2 * t);
}

bool LightPropagationCascades::radiance(const Vec3d& p, Color* L) const
{
    std::fill_n(L, 4, Color(0.0f));
    double rest = 1;
    for (std::size_t i = 0; i < size() && rest > 0; ++i) {
        const double share = weight(i, p) * rest;
        if (!(share > 0)) continue;
        Color own[4];
        mVolumes[i].radiance(p, own);
        for (int k = 0; k < 4; ++k) L[k] += static_cast<float>(share) * own[k];
        rest -= share;
    }
    return rest < 1;
}

Color LightPropagationCascades::irradiance(const Vec3d& p, const Vec3f& n) const
{
    Color L[4];
    radiance(p, L);
    return lumivdb::irradiance(2, L, n);
}

// ---- Volumes.

IrradianceVolume LightPropagationCascades::makeVolume() const
{
    VolumeBuilder builder(2, GradientStorage::None, latticeTransform(mLpv.spacing));
    bool geometry = false;
    for (std::size_t i = 0; i < size(); ++i) {
        const LatticeBox box = used(i);
        const auto finer = [&](const Coord& p) { // whether cell p is left to the finer cascade
            if (i == 0) return false;
            const LatticeBox hole = used(i - 1);
            for (int a = 0; a < 3; ++a)
                if (2 * p[a] < hole.lower[a] || 2 * p[a] >= hole.upper[a]) return false;
            return true;
        };
        for (int x = box.lower.x; x < box.upper.x; ++x)
            for (int y = box.lower.y; y < box.upper.y; ++y)
                for (int z = box.lower.z; z < box.upper.z; ++z)
                    if (const Coord p(x, y, z); !finer(p))
                        builder.addCell(p * (1 << i), static_cast<int>(i));
        geometry = geometry || mVolumes[i].hasGeometry();
    }
    IrradianceVolume volume = builder.build();
    const auto blocking = [this](const Cell& cell) {
        const auto level = static_cast<std::size_t>(cell.level);
        return mVolumes[level].blocking(cell.origin / (1 << level));
    };
    detail::finishVolume(volume, blocking, geometry);
    updateVolume(volume);
    return volume;
}

void LightPropagationCascades::updateVolume(IrradianceVolume& volume) const
{
    detail::forSamples(volume,
        [this, &volume](SampleId s) { radiance(volume.sampleWorld(s), volume.radiance(s)); });
}

} // namespace lumivdb
