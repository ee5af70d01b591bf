// SPDX-License-Identifier: Apache-2.0
#include "nearest_cell.h"

#include <algorithm>
#include <limits>
#include <numeric>

namespace lumivdb {

namespace {

constexpr std::size_t kLeafCells = 8;

double squaredDistance(const Vec3d& p, const Vec3d& lower, const Vec3d& upper)
{
    double sum = 0;
    for (int a = 0; a < 3; ++a) {
        const double d = std::max({lower[a] - p[a], p[a] - upper[a], 0.0});
        sum += d * d;
    }
    return sum;
}

Vec3d lowerOf(const Cell& cell) { return Vec3d(cell.origin); }
Vec3d upperOf(const Cell& cell) { return Vec3d(cell.origin) + Vec3d(double(1 << cell.level)); }

} // namespace

NearestCell::NearestCell(const IrradianceVolume& volume)
    : mVolume(volume)
    , mOrder(volume.cellCount())
{
    std::iota(mOrder.begin(), mOrder.end(), 0);
    build(0, 0, mOrder.size());
}

void NearestCell::build(std::size_t node, std::size_t begin, std::size_t end)
{
    Box3d box;
    for (std::size_t i = begin; i < end; ++i) {
        box.extendBy(lowerOf(mVolume.cell(mOrder[i])));
        box.extendBy(upperOf(mVolume.cell(mOrder[i])));
    }
    if (mNodes.size() <= node) mNodes.resize(node + 1);
    mNodes[node] = {box.min, box.max, begin, end};
    if (end - begin <= kLeafCells) return;
    const auto axis = static_cast<int>(box.majorAxis());
    const std::size_t middle = (begin + end) / 2;
    const auto at
        = [this](std::size_t i) { return mOrder.begin() + static_cast<std::ptrdiff_t>(i); };
    std::nth_element(at(begin), at(middle), at(end), [this, axis](CellId a, CellId b) {
        const int pa = mVolume.cell(a).origin[axis], pb = mVolume.cell(b).origin[axis];
        return pa != pb ? pa < pb : a < b;
    });
    build(2 * node + 1, begin, middle);
    build(2 * node + 2, middle, end);
}

void NearestCell::search(std::size_t node, const Vec3d& p, double& best, CellId& found) const
{
    const Node& n = mNodes[node];
    if (squaredDistance(p, n.lower, n.upper) > best) return;
    if (n.end - n.begin <= kLeafCells) {
        for (std::size_t i = n.begin; i < n.end; ++i) {
            const CellId id = mOrder[i];
            const Cell& cell = mVolume.cell(id);
            const double d = squaredDistance(p, lowerOf(cell), upperOf(cell));
            if (d < best || (d == best && id < found)) {
                best = d;
                found = id;
            }
        }
        return;
    }
    // The nearer child first: the other one is then mostly skipped.
    const Node &left = mNodes[2 * node + 1], &right = mNodes[2 * node + 2];
    const bool rightFirst
        = squaredDistance(p, right.lower, right.upper) < squaredDistance(p, left.lower, left.upper);
    search(2 * node + (rightFirst ? 2 : 1), p, best, found);
    search(2 * node + (rightFirst ? 1 : 2), p, best, found);
}

CellId NearestCell::find(const Vec3d& p) const
{
    double best = std::numeric_limits<double>::infinity();
    CellId found = std::numeric_limits<CellId>::max();
    search(0, p, best, found);
    return found;
}

} // namespace lumivdb
