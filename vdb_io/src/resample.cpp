// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/vdb_io/resample.h>

#include "nearest_cell.h"
#include "records.h"

#include <lumivdb/core/error.h>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

IrradianceVolume withBands(const IrradianceVolume& volume, int bands)
{
    IrradianceVolume out = volume.cloneTopology(bands, gradientStorage(volume));
    const int from = volume.coefficients(), to = out.coefficients(), n = std::min(from, to);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        std::copy_n(volume.radiance(s), n, out.radiance(s));
        for (int axis = 0; volume.hasGradients() && axis < 3; ++axis)
            std::copy_n(volume.gradient(s) + axis * from, n, out.gradient(s) + axis * to);
        out.validity(s) = volume.validity(s);
        out.distance(s) = volume.distance(s);
    }
    out.metadata() = volume.metadata();
    if (to < from) forgetError(out.metadata());
    return out;
}

IrradianceVolume withoutGradients(const IrradianceVolume& volume)
{
    IrradianceVolume out = volume.cloneTopology(volume.bands(), GradientStorage::None);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        std::copy_n(volume.radiance(s), volume.coefficients(), out.radiance(s));
        out.validity(s) = volume.validity(s);
        out.distance(s) = volume.distance(s);
    }
    out.metadata() = volume.metadata();
    if (volume.hasGradients()) forgetError(out.metadata());
    return out;
}

void scaleVolume(IrradianceVolume& volume, double factor)
{
    if (!std::isfinite(factor))
        throw Error(ErrorCode::Usage, "The scale of a volume must be a finite number.");
    const auto scale = [factor](Color* c, int count) {
        for (int i = 0; i < count; ++i)
            for (int k = 0; k < 3; ++k) c[i][k] = static_cast<float>(c[i][k] * factor);
    };
    const int n = volume.coefficients();
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        scale(volume.radiance(s), n);
        if (volume.hasGradients()) scale(volume.gradient(s), 3 * n);
    }
}

namespace {

class UniformResampler {
public:
    UniformResampler(const IrradianceVolume& from, Interpolation mode, double ratio)
        : mFrom(from)
        , mSampler(from, mode)
        , mNearest(from)
        , mRatio(ratio)
    {
    }

    void fill(IrradianceVolume& to, SampleId t) const
    {
        const Coord& p = to.samplePosition(t);
        const Vec3d old(p.x * mRatio, p.y * mRatio, p.z * mRatio);
        const std::int64_t s = coincidentSample(old);
        if (s >= 0) {
            const auto id = static_cast<SampleId>(s);
            std::copy_n(mFrom.radiance(id), mFrom.coefficients(), to.radiance(t));
            to.validity(t) = mFrom.validity(id);
            to.distance(t) = mFrom.distance(id);
            return;
        }
        const Cell& cell = mFrom.cell(mNearest.find(old));
        const Vec3d inside = clampInto(cell, old);
        to.validity(t) = query(cell, inside, to.radiance(t)).validity;
        to.distance(t) = distanceAt(cell, inside);
    }

private:
    std::int64_t coincidentSample(const Vec3d& p) const
    {
        Coord c;
        for (int a = 0; a < 3; ++a) {
            const double rounded = std::round(p[a]);
            if (std::abs(rounded) > 2e9 || std::abs(p[a] - rounded) > 1e-6) return -1;
            c[a] = static_cast<int>(rounded);
        }
        return mFrom.findSample(c);
    }

    static Vec3d clampInto(const Cell& cell, const Vec3d& p)
    {
        Vec3d q;
        for (int a = 0; a < 3; ++a) {
            const double lower = cell.origin[a];
            q[a] = std::clamp(p[a], lower, lower + (1 << cell.level));
        }
        return q;
    }

    QueryInfo query(const Cell& cell, const Vec3d& lattice, Color* L) const
    {
        Vec3d world;
        mFrom.indexToWorld().multVecMatrix(lattice, world);
        QueryInfo info = mSampler.radiance(world, L);
        if (info.level >= 0) return info;
        // The way to world space and back can end a rounding outside: step inwards.
        const double size = 1 << cell.level;
        const Vec3d centre = Vec3d(cell.origin) + Vec3d(size / 2);
        mFrom.indexToWorld().multVecMatrix(lattice + (centre - lattice) * 1e-6, world);
        return mSampler.radiance(world, L);
    }

    /// Harmonic, as the distances themselves are means of: 1 / Σ w_i / d_i, trilinear w.
    float distanceAt(const Cell& cell, const Vec3d& p) const
    {
        const Vec3d f = (p - Vec3d(cell.origin)) / static_cast<double>(1 << cell.level);
        double inverse = 0;
        for (int i = 0; i < 8; ++i) {
            const double w
                = ((i & 1) ? f.x : 1 - f.x) * ((i & 2) ? f.y : 1 - f.y) * ((i & 4) ? f.z : 1 - f.z);
            if (w > 0) inverse += w / mFrom.distance(cell.corners[i]);
        }
        return static_cast<float>(1.0 / inverse);
    }

    const IrradianceVolume& mFrom;
    VolumeSampler mSampler;
    NearestCell mNearest;
    double mRatio; ///< old lattice steps per new one
};

/// floor() or ceil() that does not add a cell for a rounding error.
int outward(double v, bool up)
{
    const double rounded = std::round(v);
    const double result
        = std::abs(v - rounded) < 1e-6 ? rounded : (up ? std::ceil(v) : std::floor(v));
    if (std::abs(result) > 1e9) {
        throw Error(ErrorCode::Usage,
            "This spacing makes lattice coordinates beyond 1e9; choose a larger one.");
    }
    return static_cast<int>(result);
}

IrradianceVolume emptyUniform(const IrradianceVolume& volume, double ratio)
{
    Coord lower, upper;
    double cells = 1;
    for (int a = 0; a < 3; ++a) {
        lower[a] = outward(volume.minLattice()[a] / ratio, false);
        upper[a] = std::max(outward(volume.maxLattice()[a] / ratio, true), lower[a] + 1);
        cells *= upper[a] - lower[a];
    }
    if (cells > 1e9) {
        throw Error(
            ErrorCode::Usage, "This spacing makes more than 1e9 cells; choose a larger one.");
    }
    Mat4d scale;
    scale.setScale(ratio);
    VolumeBuilder builder(volume.bands(), GradientStorage::None, scale * volume.indexToWorld());
    builder.addUniform(lower, upper);
    return builder.build();
}

/// The same region in new lattice steps, grown to whole ones.
std::optional<LatticeBox> scaledBounds(const std::optional<LatticeBox>& bounds, double ratio)
{
    if (!bounds) return std::nullopt;
    LatticeBox box;
    for (int a = 0; a < 3; ++a) {
        box.lower[a] = outward(bounds->lower[a] / ratio, false);
        box.upper[a] = std::max(outward(bounds->upper[a] / ratio, true), box.lower[a] + 1);
    }
    return box;
}

} // namespace

IrradianceVolume resampleUniform(
    const IrradianceVolume& volume, double spacing, Interpolation mode, Progress* progress)
{
    if (!(spacing > 0) || !std::isfinite(spacing))
        throw Error(ErrorCode::Usage, "The spacing must be a positive, finite length.");
    const double ratio = spacing / volume.spacing();
    IrradianceVolume out = emptyUniform(volume, ratio);
    const UniformResampler resampler(volume, mode, ratio);
    if (progress) progress->begin("resample", out.sampleCount());
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, out.sampleCount(), 4096),
        [&](const tbb::blocked_range<std::size_t>& range) {
            if (progress && progress->cancelled())
                throw Error(ErrorCode::Interrupted, "Interrupted while resampling.");
            for (std::size_t i = range.begin(); i < range.end(); ++i)
                resampler.fill(out, static_cast<SampleId>(i));
            if (progress) progress->advance(range.size());
        });
    if (ratio == 1) copyPlaces({&volume}, out); // the same samples and finest cells
    out.metadata() = volume.metadata();
    out.metadata().bounds = scaledBounds(volume.metadata().bounds, ratio);
    forgetError(out.metadata());
    return out;
}

} // namespace lumivdb
