// SPDX-License-Identifier: Apache-2.0
#include "cuts.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

using openvdb::Int32Grid;
using openvdb::Int32Tree;
using openvdb::Vec3SGrid;
using openvdb::Vec3STree;

namespace {

bool isFinite(const openvdb::Vec3s& v)
{
    return std::isfinite(v.x()) && std::isfinite(v.y()) && std::isfinite(v.z());
}

Vec3f fromVec3s(const openvdb::Vec3s& v) { return {v.x(), v.y(), v.z()}; }

std::int32_t word(std::uint64_t masks, int i)
{
    return static_cast<std::int32_t>(static_cast<std::uint32_t>(masks >> (32 * i)));
}

bool isMask(const std::string& name) { return name == kMaskGrids[0] || name == kMaskGrids[1]; }

} // namespace

void forCutGrids(const IrradianceVolume& volume, const Int32Tree& source,
    const std::function<void(const openvdb::GridBase::Ptr&, const std::string&)>& take)
{
    const Int32Tree::Ptr cuts = makeCutTree(volume, source);
    const auto vectors = [&](const std::string& name, const auto& value) {
        const auto grid = Vec3SGrid::create(
            makeScalarTree<Vec3STree>(*cuts, openvdb::Vec3s(0.0f), [&](std::int32_t id) {
                return id < 0 ? openvdb::Vec3s(0.0f) : value(*volume.visibility(id));
            }));
        grid->setVectorType(openvdb::VEC_INVARIANT);
        take(grid, name);
    };
    for (int k = 0; k < 3; ++k) {
        vectors(kWallGrids[k], [k](const CellVisibility& v) {
            return openvdb::Vec3s(v.normal[k].x, v.normal[k].y, v.normal[k].z);
        });
    }
    vectors(kWallOffsetGrid, [](const CellVisibility& v) {
        return openvdb::Vec3s(v.offset[0], v.offset[1], v.offset[2]);
    });
    for (int i = 0; i < 2; ++i) {
        take(Int32Grid::create(makeScalarTree<Int32Tree>(*cuts, -1,
                 [&](std::int32_t id) {
                     return id < 0 ? -1 : word(volume.visibility(id)->masks, i);
                 })),
            kMaskGrids[i]);
    }
}

bool CutReader::isGrid(const std::string& name)
{
    const auto& names = cutGridNames();
    return std::find(names.begin(), names.end(), name) != names.end();
}

std::string CutReader::add(const openvdb::GridBase::ConstPtr& grid)
{
    const bool mask = isMask(grid->getName());
    const bool fits = mask ? grid->isType<Int32Grid>() : grid->isType<Vec3SGrid>();
    if (!fits) return "has type " + grid->valueType() + " instead of " + (mask ? "int32" : "vec3s");
    mGrids[grid->getName()] = grid;
    return {};
}

std::int64_t CutReader::apply(IrradianceVolume& volume,
    const std::function<void(const std::string&, const Coord&)>& refuse) const
{
    using VectorAccess = Vec3SGrid::ConstAccessor;
    using MaskAccess = Int32Grid::ConstAccessor;
    const auto vectors = [this](const char* name) {
        return openvdb::gridConstPtrCast<Vec3SGrid>(mGrids.at(name))->getConstAccessor();
    };
    const auto masks = [this](const char* name) {
        return openvdb::gridConstPtrCast<Int32Grid>(mGrids.at(name))->getConstAccessor();
    };
    VectorAccess walls[3]
        = {vectors(kWallGrids[0]), vectors(kWallGrids[1]), vectors(kWallGrids[2])};
    VectorAccess offsets = vectors(kWallOffsetGrid);
    MaskAccess words[2] = {masks(kMaskGrids[0]), masks(kMaskGrids[1])};
    std::vector<std::pair<CellId, CellVisibility>> cuts;
    for (std::size_t i = 0; i < volume.cellCount(); ++i) {
        const auto id = static_cast<CellId>(i);
        const Coord origin = volume.cell(id).origin;
        const openvdb::Coord p = toVdb(origin);
        CellVisibility v;
        for (int k = 0; k < 3; ++k) {
            const openvdb::Vec3s n = walls[k].getValue(p);
            if (!isFinite(n)) refuse(kWallGrids[k], origin);
            v.normal[k] = fromVec3s(n);
        }
        const openvdb::Vec3s offset = offsets.getValue(p);
        if (!isFinite(offset)) refuse(kWallOffsetGrid, origin);
        for (int k = 0; k < 3; ++k) v.offset[k] = offset[k];
        v.masks = static_cast<std::uint32_t>(words[0].getValue(p))
            | std::uint64_t{static_cast<std::uint32_t>(words[1].getValue(p))} << 32;
        if (saysAnything(v)) cuts.emplace_back(id, v);
    }
    volume.setVisibility(cuts);
    return static_cast<std::int64_t>(cuts.size());
}

} // namespace lumivdb
