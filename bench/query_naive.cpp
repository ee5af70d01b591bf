// SPDX-License-Identifier: Apache-2.0
#include "query_contenders.h"

#include <lumivdb/core/openvdb_instances.h>
#include <lumivdb/core/sh.h>

#include <openvdb/tools/Interpolation.h>

namespace query_bench {

namespace {

using Grid = openvdb::Vec3SGrid;

Grid::Ptr makeGrid(const IrradianceVolume& volume, int coefficient, int axis)
{
    auto grid = Grid::create(openvdb::Vec3s(0));
    auto accessor = grid->getAccessor();
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        const Coord& p = volume.samplePosition(s);
        const Color& c = axis < 0 ? volume.radiance(s)[coefficient]
                                  : volume.gradient(s)[axis * volume.coefficients() + coefficient];
        accessor.setValue({p.x, p.y, p.z}, {c.x, c.y, c.z});
    }
    return grid;
}

} // namespace

struct NaiveGrids::Impl {
    int bands, coefficients;
    bool gradients;
    Mat4d worldToIndex, indexToWorld;
    std::vector<Grid::Ptr> grids; // values, then derivatives axis by axis

    /// Gradient interpolation needs the eight corners of each grid.
    void expand(std::vector<Grid::ConstAccessor>& accessors, const Vec3d& q, Color* L) const
    {
        const openvdb::Coord base(static_cast<int>(std::floor(q.x)),
            static_cast<int>(std::floor(q.y)), static_cast<int>(std::floor(q.z)));
        const Vec3d t = q - Vec3d(base.x(), base.y(), base.z());
        for (int i = 0; i < coefficients; ++i) {
            Color sum(0.0f);
            for (int corner = 0; corner < 8; ++corner) {
                const Vec3d at(corner & 1, corner >> 1 & 1, corner >> 2 & 1);
                double w = 1;
                for (int a = 0; a < 3; ++a) w *= at[a] != 0 ? t[a] : 1 - t[a];
                const openvdb::Coord ijk = base.offsetBy(corner & 1, corner >> 1 & 1, corner >> 2);
                Vec3d d;
                indexToWorld.multDirMatrix((t - at) * 0.5, d); // Interpolation::Gradient
                openvdb::Vec3s v = accessors[static_cast<std::size_t>(i)].getValue(ijk);
                for (int a = 0; a < 3; ++a) {
                    v += accessors[static_cast<std::size_t>((a + 1) * coefficients + i)].getValue(
                             ijk)
                        * static_cast<float>(d[a]);
                }
                sum += Color(v.x(), v.y(), v.z()) * static_cast<float>(w);
            }
            L[i] = sum;
        }
    }
};

NaiveGrids::NaiveGrids(const IrradianceVolume& volume, bool gradients)
    : mImpl(std::make_unique<Impl>(Impl{volume.bands(), volume.coefficients(), gradients,
        volume.worldToIndex(), volume.indexToWorld(), {}}))
{
    for (int axis = -1; axis < (gradients ? 3 : 0); ++axis)
        for (int i = 0; i < volume.coefficients(); ++i)
            mImpl->grids.push_back(makeGrid(volume, i, axis));
}

NaiveGrids::~NaiveGrids() = default;

void NaiveGrids::irradiance(std::size_t count, const Vec3d* p, const Vec3f* n, Color* E) const
{
    std::vector<Grid::ConstAccessor> accessors;
    for (const Grid::Ptr& grid : mImpl->grids) accessors.push_back(grid->getConstAccessor());
    Color L[kMaxCoefficients];
    for (std::size_t k = 0; k < count; ++k) {
        const Vec3d q = p[k] * mImpl->worldToIndex;
        if (mImpl->gradients) {
            mImpl->expand(accessors, q, L);
        } else {
            for (int i = 0; i < mImpl->coefficients; ++i) {
                const openvdb::Vec3s v = openvdb::tools::BoxSampler::sample(
                    accessors[static_cast<std::size_t>(i)], openvdb::Vec3R(q.x, q.y, q.z));
                L[i] = Color(v.x(), v.y(), v.z());
            }
        }
        E[k] = lumivdb::irradiance(mImpl->bands, L, n[k]);
    }
}

} // namespace query_bench
