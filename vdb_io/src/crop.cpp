// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/vdb_io/resample.h>

#include "records.h"

#include <lumivdb/core/error.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

/// Overlap of an axis-aligned box with boxes of one orientation by separating axes (Gottschalk,
/// Lin & Manocha, SIGGRAPH 1996); a common face alone is no overlap.
class CellOverlap {
public:
    CellOverlap(const IrradianceVolume& volume, const Box3d& box)
        : mVolume(volume)
        , mCentre((box.min + box.max) * 0.5)
        , mHalf((box.max - box.min) * 0.5)
        , mTolerance(1e-9 * volume.spacing())
    {
        const Mat4d& m = volume.indexToWorld();
        for (int i = 0; i < 3; ++i) {
            mRows[i] = Vec3d(m[i][0], m[i][1], m[i][2]);
            Vec3d unit(0.0);
            unit[i] = 1.0;
            mAxes.push_back(unit);
            mAxes.push_back(mRows[i].normalized());
        }
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                const Vec3d axis = mAxes[static_cast<std::size_t>(2 * i)].cross(
                    mAxes[static_cast<std::size_t>(2 * j + 1)]);
                if (axis.length2() > 1e-12) mAxes.push_back(axis.normalized());
            }
        }
    }

    bool overlaps(const Cell& cell) const
    {
        const double half = 0.5 * (1 << cell.level);
        Vec3d centre;
        mVolume.indexToWorld().multVecMatrix(Vec3d(cell.origin) + Vec3d(half), centre);
        const Vec3d between = centre - mCentre;
        for (const Vec3d& axis : mAxes) {
            double reach = 0;
            for (int i = 0; i < 3; ++i)
                reach += mHalf[i] * std::abs(axis[i]) + half * std::abs(mRows[i].dot(axis));
            if (std::abs(between.dot(axis)) >= reach - mTolerance) return false;
        }
        return true;
    }

private:
    const IrradianceVolume& mVolume;
    Vec3d mCentre, mHalf;
    double mTolerance;
    Vec3d mRows[3]; ///< lattice steps in world space
    std::vector<Vec3d> mAxes;
};

/// What of @a bounds the cropped volume holds; none where it holds nothing of them.
std::optional<LatticeBox> commonBounds(
    const IrradianceVolume& out, const std::optional<LatticeBox>& bounds)
{
    if (!bounds) return std::nullopt;
    LatticeBox box;
    for (int a = 0; a < 3; ++a) {
        box.lower[a] = std::max(bounds->lower[a], out.minLattice()[a]);
        box.upper[a] = std::min(bounds->upper[a], out.maxLattice()[a]);
        if (box.lower[a] >= box.upper[a]) return std::nullopt;
    }
    return box;
}

} // namespace

IrradianceVolume cropVolume(const IrradianceVolume& volume, const Box3d& box)
{
    for (int a = 0; a < 3; ++a) {
        if (!(box.min[a] <= box.max[a])) // also NaN
            throw Error(ErrorCode::Usage, "The crop box is empty; give its lower corner first.");
    }
    const CellOverlap overlap(volume, box);
    VolumeBuilder builder(volume.bands(), gradientStorage(volume), volume.indexToWorld());
    std::size_t kept = 0;
    for (std::size_t i = 0; i < volume.cellCount(); ++i) {
        const Cell& cell = volume.cell(static_cast<CellId>(i));
        if (!overlap.overlaps(cell)) continue;
        builder.addCell(cell.origin, cell.level);
        ++kept;
    }
    if (kept == 0) {
        throw Error(ErrorCode::Usage,
            "The crop box holds no part of the volume; see its bounds with lumivdb stats.");
    }
    IrradianceVolume out = builder.build();
    for (std::size_t i = 0; i < out.sampleCount(); ++i) {
        const auto t = static_cast<SampleId>(i);
        const auto s = static_cast<SampleId>(volume.findSample(out.samplePosition(t)));
        copyRecord(volume, s, out, t);
    }
    copyPlaces({&volume}, out);
    out.metadata() = volume.metadata();
    out.metadata().bounds = commonBounds(out, volume.metadata().bounds);
    if (kept < volume.cellCount()) forgetError(out.metadata());
    return out;
}

} // namespace lumivdb
