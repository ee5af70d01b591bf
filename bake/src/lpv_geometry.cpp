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
std::size_t windowCell(int x, int y, int z)
{
    return static_cast<std::size_t>((x * 9 + y) * 9 + z);
}

/// The five directions through a face across @a axis, in the order of lpv_kernel.h.
Vec3f faceDirection(int axis, int number)
{
    Vec3f w(0.0f);
    w[axis] = 1;
    if (number == 0) return w;
    w[axis] = 0.8944271909999159f;
    const int side = number <= 2 ? (axis + 1) % 3 : (axis + 2) % 3;
    w[side] = number % 2 == 1 ? 0.4472135954999579f : -0.4472135954999579f;
    return w;
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
    const auto share = static_cast<float>(static_cast<double>(b.area) / (mSpacing * mSpacing));
    const Vec3f& n = b.normal;
    cell.blocking.diagonal += share * Vec3f(n.x * n.x, n.y * n.y, n.z * n.z);
    cell.blocking.mixed += share * Vec3f(n.y * n.z, n.x * n.z, n.x * n.y);
    for (int axis = 0; axis < 3; ++axis) {
        const float part = share * n[axis] * n[axis];
        // Light that travels up the axis meets the side that looks down.
        cell.back[axis][0] += part * (n[axis] < 0 ? b.albedo : b.albedoBehind);
        cell.back[axis][1] += part * (n[axis] < 0 ? b.albedoBehind : b.albedo);
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
            if (mine.blocking.trace() == 0) continue;
            const Coord p = leaf.at * 8 + Coord(i >> 6, (i >> 3) & 7, i & 7);
            Cell& known = cellAt(mLeaves, mIndex, p);
            if (mine.blocking.trace() > known.blocking.trace()) known = mine;
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

CellBlocking LpvGeometry::blocking(const Coord& p) const
{
    const int i = mIndex.find(leafOf(p));
    if (i < 0) return {};
    return mLeaves[static_cast<std::size_t>(i)]
        .cells[static_cast<std::size_t>(numberOf(p))]
        .blocking;
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
                    window[windowCell(x, y, z)] = cells[static_cast<std::size_t>(
                        leafCell((x + 7) & 7, (y + 7) & 7, (z + 7) & 7))];
    }
    return window;
}

void LpvGeometry::fillAxis(int axis, const Window& window, Faces& faces) const
{
    const int u = (axis + 1) % 3, v = (axis + 2) % 3;
    int size[3] = {8, 8, 8};
    size[axis] = 9;
    for (int x = 0; x < size[0]; ++x) {
        for (int y = 0; y < size[1]; ++y) {
            for (int z = 0; z < size[2]; ++z) {
                // Window cell c is the one before cell c of the leaf: face c lies in it.
                CellBlocking mean;
                Color back[2] = {Color(0.0f), Color(0.0f)};
                for (int i = 0; i < 4; ++i) {
                    Coord c(x, y, z);
                    c[u] += i & 1;
                    c[v] += i >> 1;
                    const Cell& corner = window[windowCell(c.x, c.y, c.z)];
                    mean.diagonal += 0.25f * corner.blocking.diagonal;
                    mean.mixed += 0.25f * corner.blocking.mixed;
                    for (int k = 0; k < 2; ++k) back[k] += 0.25f * corner.back[axis][k];
                }
                const int cell[3] = {x, y, z};
                const auto face = static_cast<std::size_t>(faceOf(axis, cell));
                for (int k = 0; k < kFaceDirections; ++k) {
                    const float stopped
                        = std::clamp(mean.stopped(faceDirection(axis, k)), 0.0f, 1.0f);
                    faces.pass[static_cast<std::size_t>(axis * kFaceDirections + k) * kFaceStride
                        + face]
                        = 1 - stopped;
                }
                if (faces.reflect.empty() || !(mean.diagonal[axis] > 0)) continue;
                for (int k = 0; k < 2; ++k) {
                    for (int channel = 0; channel < 3; ++channel) {
                        faces.reflect[static_cast<std::size_t>((axis * 2 + k) * 3 + channel)
                                * kFaceStride
                            + face]
                            = back[k][channel] / mean.diagonal[axis];
                    }
                }
            }
        }
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
