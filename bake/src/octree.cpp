// SPDX-License-Identifier: Apache-2.0
#include "octree.h"

#include <lumivdb/core/random.h>

#include <algorithm>
#include <tuple>

namespace lumivdb {

namespace {

/// Largest multiple of 2^level that is ≤ v.
int alignDown(int v, int level) { return (v >> level) * (1 << level); }

} // namespace

CellKey CellKey::parent() const
{
    const int up = level + 1;
    return {Coord(alignDown(origin.x, up), alignDown(origin.y, up), alignDown(origin.z, up)), up};
}

bool operator<(const CellKey& a, const CellKey& b)
{
    return std::tie(a.origin.x, a.origin.y, a.origin.z, a.level)
        < std::tie(b.origin.x, b.origin.y, b.origin.z, b.level);
}

double share(const CellKey& cell, const LatticeBox& box)
{
    double inside = 1;
    for (int a = 0; a < 3; ++a) {
        const int low = std::max(cell.origin[a], box.lower[a]);
        const int high = std::min(cell.origin[a] + cell.size(), box.upper[a]);
        inside *= static_cast<double>(high - low) / (box.upper[a] - box.lower[a]);
    }
    return inside;
}

std::size_t CellKeyHash::operator()(const CellKey& key) const
{
    return static_cast<std::size_t>(
        hashPoint(static_cast<std::uint64_t>(key.level), key.origin.x, key.origin.y, key.origin.z));
}

Octree::Octree(const LatticeBox& box, int levels)
    : mBox(box)
    , mLevels(levels)
{
    const int size = 1 << levels;
    Coord o;
    for (o.x = alignDown(box.lower.x, levels); o.x < box.upper.x; o.x += size)
        for (o.y = alignDown(box.lower.y, levels); o.y < box.upper.y; o.y += size)
            for (o.z = alignDown(box.lower.z, levels); o.z < box.upper.z; o.z += size)
                mRoots.push_back({o, levels});
}

bool Octree::meetsBox(const CellKey& cell) const
{
    for (int a = 0; a < 3; ++a) {
        if (cell.origin[a] >= mBox.upper[a] || cell.origin[a] + cell.size() <= mBox.lower[a])
            return false;
    }
    return true;
}

std::vector<CellKey> Octree::roots() const { return mRoots; }

void Octree::setRoots(std::vector<CellKey> roots)
{
    std::sort(roots.begin(), roots.end());
    mAllRoots = roots.size() == mRoots.size();
    mRoots = std::move(roots);
}

bool Octree::isRoot(const CellKey& cell) const
{
    if (cell.level != mLevels || !meetsBox(cell)) return false;
    return mAllRoots || std::binary_search(mRoots.begin(), mRoots.end(), cell);
}

bool Octree::exists(const CellKey& cell) const
{
    if (cell.level == mLevels) return isRoot(cell);
    return meetsBox(cell) && isSplit(cell.parent());
}

std::vector<CellKey> Octree::children(const CellKey& cell) const
{
    std::vector<CellKey> result;
    for (int i = 0; i < 8; ++i) {
        if (meetsBox(cell.child(i))) result.push_back(cell.child(i));
    }
    return result;
}

void Octree::balance()
{
    // A split cell of level k has children of level k−1; what touches them must be of level k or
    // less, so the same-size neighbours of a split cell must exist. From fine to coarse: what is
    // split on the way is one level up and looked at next.
    std::vector<std::vector<CellKey>> pending(static_cast<std::size_t>(mLevels) + 1);
    for (const CellKey& cell : mSplit)
        pending[static_cast<std::size_t>(cell.level)].push_back(cell);
    for (int level = 0; level < mLevels; ++level) {
        auto& cells = pending[static_cast<std::size_t>(level)];
        for (std::size_t i = 0; i < cells.size(); ++i) {
            const CellKey cell = cells[i];
            for (int n = 0; n < 27; ++n) {
                const Coord step(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
                const CellKey neighbour{cell.origin + step * cell.size(), level};
                if (!meetsBox(neighbour)) continue;
                const CellKey up = neighbour.parent();
                if (isSplit(up)) continue;
                split(up);
                pending[static_cast<std::size_t>(up.level)].push_back(up);
            }
        }
    }
}

bool Octree::mayMerge(const CellKey& cell) const
{
    // Cells of the children's size all around must not be split.
    const int half = cell.size() / 2;
    for (int x = -1; x <= 2; ++x)
        for (int y = -1; y <= 2; ++y)
            for (int z = -1; z <= 2; ++z) {
                if (isSplit({cell.origin + Coord(x, y, z) * half, cell.level - 1})) return false;
            }
    return true;
}

std::vector<CellKey> Octree::mergeable(int level) const
{
    std::vector<CellKey> result;
    for (const CellKey& cell : mSplit) {
        if (cell.level != level) continue;
        bool leavesOnly = true;
        for (int i = 0; i < 8 && leavesOnly; ++i) leavesOnly = !isSplit(cell.child(i));
        if (leavesOnly) result.push_back(cell);
    }
    std::sort(result.begin(), result.end());
    return result;
}

std::vector<CellKey> Octree::leaves() const
{
    std::vector<CellKey> result, stack(mRoots);
    while (!stack.empty()) {
        const CellKey cell = stack.back();
        stack.pop_back();
        if (!isSplit(cell)) {
            result.push_back(cell);
            continue;
        }
        for (const CellKey& child : children(cell)) stack.push_back(child);
    }
    std::sort(result.begin(), result.end());
    return result;
}

std::vector<CellKey> Octree::splitCells() const
{
    std::vector<CellKey> result(mSplit.begin(), mSplit.end());
    std::sort(result.begin(), result.end());
    return result;
}

} // namespace lumivdb
