// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/volume.h>

#include "volume_impl.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/volume_grid.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

/// Length of the rows of a similarity's linear part, or 0 where @a m is not one.
double similarityScale(const Mat4d& m)
{
    const Vec3d rows[3]
        = {{m[0][0], m[0][1], m[0][2]}, {m[1][0], m[1][1], m[1][2]}, {m[2][0], m[2][1], m[2][2]}};
    const double s2 = rows[0].length2();
    if (!(s2 > 0) || !std::isfinite(s2)) return 0;
    for (int i = 0; i < 3; ++i) {
        for (int j = i; j < 3; ++j) {
            const double expected = i == j ? s2 : 0.0;
            if (!(std::abs(rows[i].dot(rows[j]) - expected) <= 1e-6 * s2)) return 0;
        }
        if (!std::isfinite(m[3][i]) || m[i][3] != 0) return 0;
    }
    if (rows[0].cross(rows[1]).dot(rows[2]) <= 0 || m[3][3] != 1) return 0;
    return std::sqrt(s2);
}

} // namespace

Mat4d latticeTransform(double spacing)
{
    Mat4d m;
    m.setScale(spacing);
    return m;
}

std::unique_ptr<IrradianceVolume::Impl> IrradianceVolume::Impl::create(
    std::shared_ptr<const Topology> topology, int bands, bool gradients, const Mat4d& m)
{
    if (bands < 1 || bands > kMaxBands) {
        throw Error(ErrorCode::Usage,
            "A volume has 1 to " + std::to_string(kMaxBands) + " bands, not "
                + std::to_string(bands) + ".");
    }
    auto impl = std::make_unique<Impl>();
    impl->topology = std::move(topology);
    impl->bands = bands;
    impl->gradients = gradients;
    impl->setTransform(m);
    const std::size_t samples = impl->topology->positions.size();
    impl->records.assign(samples * impl->stride(), Color(0.0f));
    impl->validity.assign(samples, 1.0f);
    impl->distance.assign(samples, 0.0f);
    return impl;
}

void IrradianceVolume::Impl::setTransform(const Mat4d& m)
{
    const double scale = similarityScale(m);
    if (scale == 0) {
        throw Error(ErrorCode::Usage,
            "The lattice transform must be a rotation, a uniform scale and a translation without "
            "mirroring; give such a matrix.");
    }
    // A similarity's rows are all of the same length up to 1e-6 or so.
    if (scale < kMinSpacing * (1 - 1e-6)) {
        throw Error(ErrorCode::Usage,
            "The lattice transform has scale " + std::to_string(scale * 1e6)
                + "e-6, below the 2e-5 that a .vdb can hold; take a larger spacing or scale the "
                  "scene up.");
    }
    auto g = openvdb::Int32Grid::create(topology->index);
    const openvdb::Mat4d rows(m[0][0], m[0][1], m[0][2], m[0][3], m[1][0], m[1][1], m[1][2],
        m[1][3], m[2][0], m[2][1], m[2][2], m[2][3], m[3][0], m[3][1], m[3][2], m[3][3]);
    g->setTransform(openvdb::math::Transform::createLinearTransform(rows));
    indexToWorld = m;
    worldToIndex = m.inverse();
    spacing = scale;
    grid = g;
}

IrradianceVolume::IrradianceVolume(std::unique_ptr<Impl> impl)
    : mImpl(std::move(impl))
{
}
IrradianceVolume::IrradianceVolume(IrradianceVolume&&) noexcept = default;
IrradianceVolume& IrradianceVolume::operator=(IrradianceVolume&&) noexcept = default;
IrradianceVolume::~IrradianceVolume() = default;

IrradianceVolume IrradianceVolume::clone() const
{
    return IrradianceVolume(std::make_unique<Impl>(*mImpl));
}

IrradianceVolume IrradianceVolume::cloneTopology(int bands, GradientStorage gradients) const
{
    auto impl = Impl::create(
        mImpl->topology, bands, gradients == GradientStorage::PerCoefficient, mImpl->indexToWorld);
    impl->metadata = mImpl->metadata;
    impl->offsets = mImpl->offsets;
    impl->cutOf = mImpl->cutOf;
    impl->cuts = mImpl->cuts;
    impl->blocking = mImpl->blocking;
    return IrradianceVolume(std::move(impl));
}

int IrradianceVolume::bands() const { return mImpl->bands; }
bool IrradianceVolume::hasGradients() const { return mImpl->gradients; }
const Mat4d& IrradianceVolume::indexToWorld() const { return mImpl->indexToWorld; }
const Mat4d& IrradianceVolume::worldToIndex() const { return mImpl->worldToIndex; }
double IrradianceVolume::spacing() const { return mImpl->spacing; }
void IrradianceVolume::setIndexToWorld(const Mat4d& m) { mImpl->setTransform(m); }

std::size_t IrradianceVolume::sampleCount() const { return mImpl->topology->positions.size(); }
std::size_t IrradianceVolume::cellCount() const { return mImpl->topology->cells.size(); }
std::vector<std::size_t> IrradianceVolume::cellsByLevel() const
{
    return mImpl->topology->cellsByLevel;
}
const Cell& IrradianceVolume::cell(CellId id) const
{
    return mImpl->topology->cells[static_cast<std::size_t>(id)];
}

const Coord& IrradianceVolume::samplePosition(SampleId s) const
{
    return mImpl->topology->positions[s];
}

Vec3d IrradianceVolume::sampleWorld(SampleId s) const
{
    const Coord& p = samplePosition(s);
    return Vec3d(p.x, p.y, p.z) * mImpl->indexToWorld;
}

std::int64_t IrradianceVolume::findSample(const Coord& p) const
{
    const Topology& t = *mImpl->topology;
    if (!t.latticeKeys.contains(p)) return -1;
    const std::uint64_t key = t.latticeKeys.key(p);
    const auto it = std::lower_bound(t.keys.begin(), t.keys.end(), key);
    return it != t.keys.end() && *it == key ? it - t.keys.begin() : -1;
}

CellId IrradianceVolume::findCell(const Coord& p) const
{
    return mImpl->topology->index->getValue(openvdb::Coord(p.x, p.y, p.z));
}

Coord IrradianceVolume::minLattice() const { return mImpl->topology->minLattice; }
Coord IrradianceVolume::maxLattice() const { return mImpl->topology->maxLattice; }

Box3d IrradianceVolume::worldBounds() const
{
    const Coord lower = minLattice(), upper = maxLattice();
    Box3d box;
    for (int i = 0; i < 8; ++i) {
        const Vec3d corner(
            i & 1 ? upper.x : lower.x, i & 2 ? upper.y : lower.y, i & 4 ? upper.z : lower.z);
        box.extendBy(corner * mImpl->indexToWorld);
    }
    return box;
}

Color* IrradianceVolume::radiance(SampleId s)
{
    return mImpl->records.data() + s * mImpl->stride();
}
const Color* IrradianceVolume::radiance(SampleId s) const
{
    return mImpl->records.data() + s * mImpl->stride();
}
Color* IrradianceVolume::gradient(SampleId s)
{
    return hasGradients() ? radiance(s) + coefficients() : nullptr;
}
const Color* IrradianceVolume::gradient(SampleId s) const
{
    return hasGradients() ? radiance(s) + coefficients() : nullptr;
}
float& IrradianceVolume::validity(SampleId s) { return mImpl->validity[s]; }
float IrradianceVolume::validity(SampleId s) const { return mImpl->validity[s]; }
float& IrradianceVolume::distance(SampleId s) { return mImpl->distance[s]; }
float IrradianceVolume::distance(SampleId s) const { return mImpl->distance[s]; }
LatticeBox IrradianceVolume::latticeBounds() const
{
    return mImpl->metadata.bounds.value_or(LatticeBox{minLattice(), maxLattice()});
}

bool IrradianceVolume::hasOffsets() const { return !mImpl->offsets.empty(); }
Vec3f IrradianceVolume::offset(SampleId s) const
{
    return mImpl->offsets.empty() ? Vec3f(0.0f) : mImpl->offsets[s];
}
void IrradianceVolume::setOffsets(std::vector<Vec3f> offsets)
{
    if (!offsets.empty() && offsets.size() != sampleCount()) {
        throw Error(ErrorCode::Usage,
            "A volume of " + std::to_string(sampleCount()) + " samples was given "
                + std::to_string(offsets.size()) + " offsets; give one for each, or none.");
    }
    mImpl->offsets = std::move(offsets);
}

bool IrradianceVolume::hasVisibility() const { return !mImpl->cuts.empty(); }
const CellVisibility* IrradianceVolume::visibility(CellId id) const
{
    if (mImpl->cutOf.empty()) return nullptr;
    const std::int32_t i = mImpl->cutOf[static_cast<std::size_t>(id)];
    return i < 0 ? nullptr : &mImpl->cuts[static_cast<std::size_t>(i)];
}
void IrradianceVolume::setVisibility(const std::vector<std::pair<CellId, CellVisibility>>& cut)
{
    mImpl->cuts.clear();
    mImpl->cutOf.clear();
    if (cut.empty()) return;
    mImpl->cutOf.assign(cellCount(), -1);
    for (const auto& [id, visibility] : cut) {
        mImpl->cutOf[static_cast<std::size_t>(id)] = static_cast<std::int32_t>(mImpl->cuts.size());
        mImpl->cuts.push_back(visibility);
    }
}

bool IrradianceVolume::hasBlocking() const { return !mImpl->blocking.empty(); }
Vec3f IrradianceVolume::blocking(CellId id) const
{
    return hasBlocking() ? mImpl->blocking[static_cast<std::size_t>(id)] : Vec3f(0.0f);
}
void IrradianceVolume::setBlocking(std::vector<Vec3f> blocking)
{
    if (!blocking.empty() && blocking.size() != cellCount()) {
        throw Error(ErrorCode::Usage,
            "A volume of " + std::to_string(cellCount()) + " cells was given "
                + std::to_string(blocking.size()) + " of blocking; give one for each, or none.");
    }
    mImpl->blocking = std::move(blocking);
}

VolumeMetadata& IrradianceVolume::metadata() { return mImpl->metadata; }
const VolumeMetadata& IrradianceVolume::metadata() const { return mImpl->metadata; }

std::size_t IrradianceVolume::memoryBytes() const
{
    const Topology& t = *mImpl->topology;
    return mImpl->records.size() * sizeof(Color) + mImpl->offsets.size() * sizeof(Vec3f)
        + mImpl->cutOf.size() * sizeof(std::int32_t) + mImpl->cuts.size() * sizeof(CellVisibility)
        + mImpl->blocking.size() * sizeof(Vec3f)
        + (mImpl->validity.size() + mImpl->distance.size()) * sizeof(float)
        + t.cells.size() * sizeof(Cell) + t.positions.size() * sizeof(Coord)
        + t.keys.size() * sizeof(std::uint64_t) + t.index->memUsage();
}

const openvdb::Int32Grid& indexGrid(const IrradianceVolume& volume) { return *volume.impl().grid; }

} // namespace lumivdb
