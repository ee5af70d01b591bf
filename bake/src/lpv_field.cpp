// SPDX-License-Identifier: Apache-2.0
#include "lpv_field.h"

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <new>
#include <tuple>

namespace lumivdb::detail {

namespace {

constexpr std::align_val_t kAlignment{64};
/// Below it floats lose digits, and processors time.
constexpr float kTiny = 1e-30f;

const Coord kSteps[6] = {{-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}};

int numberOf(const Coord& p) { return leafCell(p.x & 7, p.y & 7, p.z & 7); }

} // namespace

void LpvField::FreeBlock::operator()(float* p) const { ::operator delete(p, kAlignment); }

LpvField::LpvField(FluxLimit limit, double cutoff, const std::optional<LatticeBox>& cells)
    : mLimit(limit)
    , mCutoff(cutoff)
    , mCells(cells)
    , mDark(kLeafFloats, 0.0f)
{
}

float* LpvField::frontOf(const Leaf& leaf, int parity) const
{
    return leaf.block + parity * kLeafFloats + kLeafLead;
}

void LpvField::setCells(const LatticeBox& cells)
{
    clearLight();
    mCells = cells;
    mLeaves.clear();
    mIndex.clear();
    mInside.clear();
    mUsedBlocks = 0;
}

bool LpvField::contains(const Coord& p) const
{
    if (!mCells) return true;
    for (int a = 0; a < 3; ++a)
        if (p[a] < mCells->lower[a] || p[a] >= mCells->upper[a]) return false;
    return true;
}

// ---- Leaves.

bool LpvField::leafInside(const Coord& at) const
{
    if (!mCells) return true;
    for (int a = 0; a < 3; ++a)
        if (at[a] * 8 + 8 <= mCells->lower[a] || at[a] * 8 >= mCells->upper[a]) return false;
    return true;
}

/// Null where all cells of the leaf are inside.
const float* LpvField::insideOf(const Coord& at)
{
    auto mask = std::make_unique<std::array<float, kLeafCells>>();
    bool all = true;
    for (int i = 0; i < kLeafCells; ++i) {
        const bool in = contains(at * 8 + Coord(i >> 6, (i >> 3) & 7, i & 7));
        (*mask)[static_cast<std::size_t>(i)] = in ? 1.0f : 0.0f;
        all = all && in;
    }
    if (all) return nullptr;
    mInside.push_back(std::move(mask));
    return mInside.back()->data();
}

float* LpvField::takeBlock()
{
    if (mUsedBlocks == mBlocks.size()) {
        constexpr std::size_t bytes = 3 * kLeafFloats * sizeof(float);
        mBlocks.emplace_back(static_cast<float*>(::operator new(bytes, kAlignment)));
        std::memset(mBlocks.back().get(), 0, bytes); // the gaps are read, though never used
    }
    return mBlocks[mUsedBlocks++].get();
}

int LpvField::makeLeaf(const Coord& at)
{
    const int number = static_cast<int>(mLeaves.size());
    Leaf leaf;
    leaf.at = at;
    leaf.block = takeBlock();
    leaf.inside = insideOf(at);
    refreshGeometry(leaf);
    for (std::size_t f = 0; f < 6; ++f) {
        const int other = mIndex.find(at + kSteps[f]);
        leaf.neighbours[f] = other;
        if (other >= 0) mLeaves[static_cast<std::size_t>(other)].neighbours[f ^ 1] = number;
    }
    mLeaves.push_back(leaf);
    mIndex.insert(at, number);
    mActive.reserve(mLeaves.size());
    mTargets.reserve(mLeaves.size());
    return number;
}

int LpvField::leafAt(const Coord& at)
{
    const int number = mIndex.find(at);
    return number >= 0 ? number : makeLeaf(at);
}

void LpvField::refreshGeometry(Leaf& leaf) const
{
    leaf.pass = mGeometry ? mGeometry->pass(leaf.at) : nullptr;
    leaf.reflect = mGeometry ? mGeometry->reflect(leaf.at) : nullptr;
}

void LpvField::setGeometry(const LpvGeometry* geometry)
{
    mGeometry = geometry;
    for (Leaf& leaf : mLeaves) refreshGeometry(leaf);
}

// ---- Light.

void LpvField::clearLight()
{
    for (Leaf& leaf : mLeaves) leaf.lit = leaf.summed = false;
    mActive.clear();
    mPeak = 0;
}

/// Makes a leaf part of the front, dark as yet.
void LpvField::light(int number)
{
    Leaf& leaf = mLeaves[static_cast<std::size_t>(number)];
    if (!leaf.summed) std::memset(sumOf(leaf), 0, (kLeafFloats - kLeafLead) * sizeof(float));
    leaf.summed = true;
    if (leaf.lit) return;
    leaf.lit = true;
    leaf.total = Vec3d(0.0);
    std::memset(frontOf(leaf, mParity), 0, (kLeafFloats - kLeafLead) * sizeof(float));
    mActive.push_back(number);
}

void LpvField::add(const Coord& cell, const CellState& state)
{
    const int number = leafAt(leafOf(cell));
    light(number);
    Leaf& leaf = mLeaves[static_cast<std::size_t>(number)];
    // All neighbours may get light.
    for (float& m : leaf.faceMax) m = std::numeric_limits<float>::infinity();
    float* const front = frontOf(leaf, mParity) + numberOf(cell);
    float* const sum = sumOf(leaf) + numberOf(cell);
    for (int c = 0; c < 3; ++c) {
        for (int k = 0; k < 4; ++k) {
            const int at = (c * 4 + k) * kCoefficientStride;
            const float v = state[static_cast<std::size_t>(k)][c];
            front[at] += v;
            sum[at] += v;
            mPeak = std::max(mPeak, std::abs(front[at]));
        }
        leaf.total[c] += static_cast<double>(state[0][c]);
    }
}

void LpvField::addTarget(int number)
{
    Leaf& leaf = mLeaves[static_cast<std::size_t>(number)];
    if (leaf.next) return;
    leaf.next = true;
    mTargets.push_back(number);
}

/// The leaves of the front, and those that it may enter.
void LpvField::listTargets()
{
    mTargets.clear();
    for (const int number : mActive) addTarget(number);
    for (std::size_t i = 0; i < mActive.size(); ++i) { // new leaves move both lists
        for (std::size_t f = 0; f < 6; ++f) {
            const Leaf& leaf = mLeaves[static_cast<std::size_t>(mActive[i])];
            if (!(leaf.faceMax[f] > 0)) continue;
            const Coord at = leaf.at + kSteps[f];
            int other = leaf.neighbours[f];
            if (other < 0) other = leafInside(at) ? makeLeaf(at) : -1;
            if (other >= 0) addTarget(other);
        }
    }
    if (mTargets.size() == mActive.size()) return;
    // Neighbours in space should be neighbours in time.
    std::sort(mTargets.begin(), mTargets.end(), [this](int a, int b) {
        const Coord &p = mLeaves[static_cast<std::size_t>(a)].at,
                    &q = mLeaves[static_cast<std::size_t>(b)].at;
        return std::tie(p.x, p.y, p.z) < std::tie(q.x, q.y, q.z);
    });
}

void LpvField::gather(Leaf& leaf) const
{
    const float* const dark = mDark.data() + kLeafLead;
    LpvGather g;
    g.limit = mLimit;
    for (std::size_t f = 0; f < 6; ++f) {
        const int n = leaf.neighbours[f];
        const bool lit = n >= 0 && mLeaves[static_cast<std::size_t>(n)].lit;
        g.neighbours[f] = lit ? frontOf(mLeaves[static_cast<std::size_t>(n)], mParity) : dark;
    }
    g.self = leaf.lit ? frontOf(leaf, mParity) : dark;
    g.inside = leaf.inside;
    g.pass = leaf.pass;
    g.reflect = leaf.reflect;
    g.floor = std::max(static_cast<float>(mCutoff * static_cast<double>(mPeak)), kTiny);
    g.next = frontOf(leaf, 1 - mParity);
    g.sum = sumOf(leaf);
    if (!leaf.summed) std::memset(g.sum, 0, (kLeafFloats - kLeafLead) * sizeof(float));
    gatherLeaf(g);
    std::copy(g.faceMax, g.faceMax + 6, leaf.faceMax);
    leaf.max = g.max;
    leaf.total = Vec3d(g.total[0], g.total[1], g.total[2]);
    leaf.summed = true;
}

void LpvField::step()
{
    listTargets();
    tbb::parallel_for(tbb::blocked_range<std::size_t>(0, mTargets.size(), 2),
        [this](const tbb::blocked_range<std::size_t>& range) {
            for (std::size_t i = range.begin(); i < range.end(); ++i)
                gather(mLeaves[static_cast<std::size_t>(mTargets[i])]);
        });
    mParity = 1 - mParity;
    mActive.clear();
    for (const int number : mTargets) {
        Leaf& leaf = mLeaves[static_cast<std::size_t>(number)];
        leaf.next = false;
        leaf.lit = leaf.max > 0;
        if (leaf.lit) mActive.push_back(number);
    }
}

// ---- Results.

Vec3d LpvField::frontTotal() const
{
    Vec3d total(0.0);
    for (const int number : mActive) total += mLeaves[static_cast<std::size_t>(number)].total;
    return total;
}

CellState LpvField::read(const float* coefficients, const Coord& cell) const
{
    CellState state;
    const float* p = coefficients + numberOf(cell);
    for (int c = 0; c < 3; ++c)
        for (int k = 0; k < 4; ++k)
            state[static_cast<std::size_t>(k)][c] = p[(c * 4 + k) * kCoefficientStride];
    return state;
}

CellState LpvField::front(const Coord& cell) const
{
    const int number = mIndex.find(leafOf(cell));
    if (number < 0 || !mLeaves[static_cast<std::size_t>(number)].lit) return noLight();
    return read(frontOf(mLeaves[static_cast<std::size_t>(number)], mParity), cell);
}

CellState LpvField::sum(const Coord& cell) const
{
    const int number = mIndex.find(leafOf(cell));
    if (number < 0 || !mLeaves[static_cast<std::size_t>(number)].summed) return noLight();
    return read(sumOf(mLeaves[static_cast<std::size_t>(number)]), cell);
}

std::vector<Coord> LpvField::litLeaves() const
{
    std::vector<Coord> leaves;
    for (const Leaf& leaf : mLeaves)
        if (leaf.summed) leaves.push_back(leaf.at);
    return leaves;
}

std::size_t LpvField::memoryBytes() const
{
    return mBlocks.size() * 3 * kLeafFloats * sizeof(float) + mLeaves.capacity() * sizeof(Leaf)
        + mInside.size() * kLeafCells * sizeof(float);
}

} // namespace lumivdb::detail
