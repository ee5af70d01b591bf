// SPDX-License-Identifier: Apache-2.0
#include "lpv_geometry.h"

#include "lpv_kernel.h"
#include "lpv_units.h"

#include <lumivdb/core/error.h>

#include <algorithm>
#include <cmath>
#include <string>

namespace lumivdb::detail {

namespace {

int floorInt(double v) { return static_cast<int>(std::floor(v)); }

bool isFinite(const Vec3d& v)
{
    return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

void check(const Blocker& b, std::size_t i)
{
    if (isFinite(b.position) && isFinite(Vec3d(b.normal)) && std::isfinite(b.area)
        && isFinite(Vec3d(b.albedo)) && isFinite(Vec3d(b.albedoBehind))) {
        return;
    }
    throw Error(ErrorCode::Usage,
        "Blocker " + std::to_string(i) + " is NaN or infinite; leave it out or repair the scene.");
}

int numberOf(const Coord& p) { return leafCell(p.x & 7, p.y & 7, p.z & 7); }

/// Index in a window of 9³ cells.
std::size_t windowCell(const Coord& c)
{
    return static_cast<std::size_t>((c.x * 9 + c.y) * 9 + c.z);
}

} // namespace

LpvGeometry::Cell& LpvGeometry::cellAt(
    std::vector<Leaf>& leaves, LeafIndex& index, const Coord& p) const
{
    const Coord at = leafOf(p);
    int i = index.find(at);
    if (i < 0) {
        i = static_cast<int>(leaves.size());
        leaves.push_back({at, std::vector<Cell>(kLeafCells)});
        index.insert(at, i);
    }
    return leaves[static_cast<std::size_t>(i)].cells[static_cast<std::size_t>(numberOf(p))];
}

void LpvGeometry::add(const Blocker& b, Cell& cell) const
{
    const double share = static_cast<double>(b.area) / (mSpacing * mSpacing);
    for (int axis = 0; axis < 3; ++axis) {
        const auto n = static_cast<double>(b.normal[axis]);
        const auto part = static_cast<float>(share * std::abs(n));
        cell.covered[axis] += part;
        // Light that travels up the axis meets the side that looks down.
        cell.back[axis][0] += part * (n < 0 ? b.albedo : b.albedoBehind);
        cell.back[axis][1] += part * (n < 0 ? b.albedoBehind : b.albedo);
    }
}

void LpvGeometry::merge(const std::vector<Blocker>& blockers)
{
    for (std::size_t i = 0; i < blockers.size(); ++i) check(blockers[i], i);
    std::vector<Leaf> leaves;
    LeafIndex index;
    for (const Blocker& b : blockers) {
        // A surface on a border counts as further along its normal, as in inject(): its light then
        // enters in front of what it blocks.
        const Vec3d p = b.position / mSpacing + kTie * Vec3d(b.normal);
        if (!(std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) < kMaxLattice)) continue;
        add(b, cellAt(leaves, index, Coord(floorInt(p.x), floorInt(p.y), floorInt(p.z))));
    }
    for (const Leaf& leaf : leaves) {
        for (int i = 0; i < kLeafCells; ++i) {
            const Cell& mine = leaf.cells[static_cast<std::size_t>(i)];
            if (mine.all() == 0) continue;
            const Coord p = leaf.at * 8 + Coord(i >> 6, (i >> 3) & 7, i & 7);
            Cell& known = cellAt(mLeaves, mIndex, p);
            if (mine.all() > known.all()) known = mine;
        }
    }
    makeFaces();
}

void LpvGeometry::clear()
{
    mLeaves.clear();
    mIndex.clear();
    mFaces.clear();
    mFaceIndex.clear();
}

Vec3f LpvGeometry::blocking(const Coord& p) const
{
    const int i = mIndex.find(leafOf(p));
    if (i < 0) return Vec3f(0.0f);
    return mLeaves[static_cast<std::size_t>(i)]
        .cells[static_cast<std::size_t>(numberOf(p))]
        .covered;
}

/// A leaf's faces touch the geometry cells of its own leaf and of those before it.
void LpvGeometry::makeFaces()
{
    mFaces.clear();
    mFaceIndex.clear();
    for (const Leaf& geometry : mLeaves) {
        for (int i = 0; i < 8; ++i) {
            const Coord leaf = geometry.at + Coord(i & 1, (i >> 1) & 1, i >> 2);
            if (mFaceIndex.find(leaf) >= 0) continue;
            mFaceIndex.insert(leaf, static_cast<int>(mFaces.size()));
            Faces faces;
            faces.pass.assign(kPassFloats, 1.0f);
            if (mBounces == LpvBounces::Many) faces.reflect.assign(kReflectFloats, 0.0f);
            const Window window = windowOf(leaf);
            for (int axis = 0; axis < 3; ++axis) fillAxis(axis, window, faces);
            mFaces.push_back(std::move(faces));
        }
    }
}

LpvGeometry::Window LpvGeometry::windowOf(const Coord& leaf) const
{
    Window window(9 * 9 * 9);
    for (int i = 0; i < 8; ++i) { // this leaf and the seven before it
        const Coord before(i & 1, (i >> 1) & 1, i >> 2);
        const int number = mIndex.find(leaf - before);
        if (number < 0) continue;
        const auto& cells = mLeaves[static_cast<std::size_t>(number)].cells;
        const auto first = [&](int a) { return before[a] ? 0 : 1; };
        const auto last = [&](int a) { return before[a] ? 0 : 8; };
        for (int x = first(0); x <= last(0); ++x)
            for (int y = first(1); y <= last(1); ++y)
                for (int z = first(2); z <= last(2); ++z)
                    window[windowCell({x, y, z})] = cells[static_cast<std::size_t>(
                        leafCell((x + 7) & 7, (y + 7) & 7, (z + 7) & 7))];
    }
    return window;
}

/// Window cell c is the one before cell c of the leaf, so that the face below cell c lies in it.
LpvGeometry::Cell LpvGeometry::meanAtFace(int axis, const Coord& cell, const Window& window)
{
    Cell mean;
    for (int i = 0; i < 4; ++i) {
        Coord c = cell;
        c[(axis + 1) % 3] += i & 1;
        c[(axis + 2) % 3] += i >> 1;
        const Cell& corner = window[windowCell(c)];
        mean.covered += 0.25f * corner.covered;
        for (int k = 0; k < 2; ++k) mean.back[axis][k] += 0.25f * corner.back[axis][k];
    }
    return mean;
}

void LpvGeometry::fillAxis(int axis, const Window& window, Faces& faces)
{
    const auto plane = [](std::vector<float>& values, int number) {
        return values.data() + static_cast<std::ptrdiff_t>(number) * kFaceStride;
    };
    int size[3] = {8, 8, 8};
    size[axis] = 9;
    for (int i = 0; i < kFaces; ++i) {
        const int cell[3] = {i / (size[1] * size[2]), i / size[2] % size[1], i % size[2]};
        const Cell mean = meanAtFace(axis, Coord(cell[0], cell[1], cell[2]), window);
        const float covered = mean.covered[axis];
        const int face = faceOf(axis, cell);
        plane(faces.pass, axis)[face] = 1 - std::min(covered, 1.0f);
        if (faces.reflect.empty() || !(covered > 0)) continue;
        for (int k = 0; k < 2; ++k)
            for (int c = 0; c < 3; ++c)
                plane(faces.reflect, (axis * 2 + k) * 3 + c)[face]
                    = mean.back[axis][k][c] / covered;
    }
}

const float* LpvGeometry::pass(const Coord& leaf) const
{
    const int i = mFaceIndex.find(leaf);
    return i < 0 ? nullptr : mFaces[static_cast<std::size_t>(i)].pass.data();
}

const float* LpvGeometry::reflect(const Coord& leaf) const
{
    const int i = mFaceIndex.find(leaf);
    if (i < 0 || mFaces[static_cast<std::size_t>(i)].reflect.empty()) return nullptr;
    return mFaces[static_cast<std::size_t>(i)].reflect.data();
}

std::size_t LpvGeometry::memoryBytes() const
{
    std::size_t bytes = mLeaves.size() * kLeafCells * sizeof(Cell);
    for (const Faces& f : mFaces) bytes += (f.pass.size() + f.reflect.size()) * sizeof(float);
    return bytes;
}

} // namespace lumivdb::detail
