// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file cuts.h
/// CellVisibility between volumes and the grids that hold it.

#include "transfer.h"

#include <functional>
#include <map>
#include <string>

namespace lumivdb {

/// False for what the grids say of cells without visibility: no plane and everything seen.
inline bool saysAnything(const CellVisibility& v)
{
    for (const Vec3f& n : v.normal)
        if (n != Vec3f(0.0f)) return true;
    return v.masks != ~std::uint64_t{0};
}

/// Makes the six grids of a volume that has visibility one by one, of the topology of @a source,
/// and hands them over with their names. A cell without visibility has normals and offsets 0 and
/// masks −1: all is seen.
void forCutGrids(const IrradianceVolume& volume, const openvdb::Int32Tree& source,
    const std::function<void(const openvdb::GridBase::Ptr&, const std::string&)>& take);

/// Collects those grids of a file, in any order, and gives the volume its visibility.
class CutReader {
public:
    static bool isGrid(const std::string& name);
    /// Keeps @a grid. @return what is wrong with its type, or empty.
    std::string add(const openvdb::GridBase::ConstPtr& grid);
    bool any() const { return !mGrids.empty(); }
    bool has(const std::string& name) const { return mGrids.count(name) > 0; }
    /// All six are there. @return number of cut cells. @throws what @a refuse throws, given the
    /// grid's name and the cell's origin, where a plane is not finite.
    std::int64_t apply(IrradianceVolume& volume,
        const std::function<void(const std::string&, const Coord&)>& refuse) const;

private:
    std::map<std::string, openvdb::GridBase::ConstPtr> mGrids;
};

} // namespace lumivdb
