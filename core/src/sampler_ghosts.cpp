// SPDX-License-Identifier: Apache-2.0
#include "sampler_ghosts.h"

#include <algorithm>

namespace lumivdb::detail {

namespace {

// Lattice points of a split cell: i = x + 3y + 9z, coordinates 0, 1, 2.
constexpr int kStep[3] = {1, 3, 9};
constexpr int kCentre = 13;

int coordinate(int i, int axis) { return i / kStep[axis] % 3; }
Coord coordinates(int i) { return {i % 3, i / 3 % 3, i / 9}; }
int cornerIndex(int corner)
{
    return 2 * (corner & 1) + 6 * (corner >> 1 & 1) + 18 * (corner >> 2 & 1);
}
/// 0: a corner, 1: middle of an edge, 2: of a face, 3: the centre.
int middleAxes(int i)
{
    return (coordinate(i, 0) == 1) + (coordinate(i, 1) == 1) + (coordinate(i, 2) == 1);
}

/// Corners of the edge or face that point @a i is in the middle of.
unsigned cornersRound(int i)
{
    unsigned mask = 0;
    for (int c = 0; c < 8; ++c) {
        bool touches = true;
        for (int a = 0; a < 3; ++a) {
            touches = touches && (coordinate(i, a) == 1 || coordinate(i, a) == 2 * (c >> a & 1));
        }
        if (touches) mask |= 1u << c;
    }
    return mask;
}

int hermiteBlocks(Interpolation mode)
{
    return mode == Interpolation::Tricubic ? 8 : mode == Interpolation::Gradient ? 4 : 1;
}

} // namespace

PlainNodes::PlainNodes(const IrradianceVolume& volume, const SamplerOptions& options)
    : mVolume(volume)
    , mMove(needsGradients(options.mode) && volume.hasOffsets())
    , mChannels(3 * volume.coefficients() + 2)
    , mBlocks(needsGradients(options.mode) ? 4 : 1)
{
    // Row a of the linear part is lattice axis a in world space: dI/da = row · ∇I.
    for (int a = 0; a < 3; ++a)
        for (int b = 0; b < 3; ++b) mToLattice[a][b] = volume.indexToWorld()[a][b];
}

void PlainNodes::load(SampleId s, bool raw, float* out) const
{
    std::fill(out, out + static_cast<std::size_t>(mBlocks) * mChannels, 0.0f);
    out[mChannels - 1] = mVolume.validity(s);
    if (!raw && !mVolume.isValid(s)) return;
    out[mChannels - 2] = 1.0f;
    const int n = mVolume.coefficients();
    const float* value = &mVolume.radiance(s)[0].x;
    std::copy(value, value + 3 * n, out);
    if (mBlocks == 1) return;
    const float* slope = &mVolume.gradient(s)[0].x;
    const Vec3f offset = mVolume.offset(s);
    for (int k = 0; k < 3 * n; ++k) {
        const double world[3] = {slope[k], slope[3 * n + k], slope[6 * n + k]};
        for (int a = 0; a < 3; ++a) {
            out[(a + 1) * mChannels + k] = static_cast<float>(world[0] * mToLattice[a][0]
                + world[1] * mToLattice[a][1] + world[2] * mToLattice[a][2]);
        }
        if (mMove) {
            out[k] = static_cast<float>(
                value[k] - (world[0] * offset.x + world[1] * offset.y + world[2] * offset.z));
        }
    }
}

GhostBuilder::GhostBuilder(const IrradianceVolume& volume, const SamplerOptions& options,
    const PlainNodes& plain, std::uint32_t firstNode)
    : mVolume(volume)
    , mPlain(plain)
    , mMode(options.mode)
    , mFirstNode(firstNode)
    , mBlocks(hermiteBlocks(options.mode))
    , mSize(static_cast<std::size_t>(mBlocks) * plain.channels())
    , mWork(27 * mSize)
    , mPure(options.mode == Interpolation::Tricubic ? 27 * mSize : 0)
{
}

bool GhostBuilder::touchesFiner(const IrradianceVolume& volume, const Cell& cell)
{
    if (cell.level == 0) return false;
    const int half = 1 << (cell.level - 1);
    for (int i = 0; i < 27; ++i) {
        const int middle = middleAxes(i);
        if (middle != 1 && middle != 2) continue;
        if (volume.findSample(cell.origin + coordinates(i) * half) >= 0) return true;
    }
    return false;
}

const GhostBuilder::Split& GhostBuilder::split(const Cell& cell, unsigned mask)
{
    const int half = 1 << (cell.level - 1);
    loadCorners(cell, mask);
    for (int axes = 1; axes <= 3; ++axes) {
        for (int i = 0; i < 27; ++i) {
            if (middleAxes(i) != axes) continue;
            if (!mPure.empty()) restrictHermite(i, 2 * half);
            if (axes < 3 && loadHanging(cell, mask, i)) continue;
            makeGhost(i, half);
            const LatticeKeys& keys = mVolume.impl().topology->latticeKeys;
            const std::uint64_t key = keys.key(cell.origin + coordinates(i) * half);
            const bool shared = mask == 0xff && axes < 3;
            const auto known = shared ? mShared.find(key) : mShared.end();
            if (known != mShared.end()) {
                mSplit.node[i] = known->second;
            } else {
                mSplit.node[i] = addNode(plainOf(i), mCombination[i]);
                if (shared) mShared.emplace(key, mSplit.node[i]);
            }
        }
    }
    for (int i = 0; i < 27; ++i) mSplit.weight[i] = plainOf(i)[mPlain.channels() - 2];
    return mSplit;
}

void GhostBuilder::loadCorners(const Cell& cell, unsigned mask)
{
    for (int c = 0; c < 8; ++c) {
        const int i = cornerIndex(c);
        float* record = plainOf(i);
        std::fill(record, record + mSize, 0.0f);
        mCombination[i].clear();
        if (mask >> c & 1) {
            mPlain.load(cell.corners[c], false, record);
            mSplit.node[i] = sampleNode(cell.corners[c], record);
            mCombination[i].push_back({cell.corners[c], 1.0f});
        } else {
            mSplit.node[i] = addNode(record, {});
        }
        if (!mPure.empty()) std::copy(record, record + mSize, pureOf(i));
    }
}

/// The sample at point @a i, where there is one that may be used.
bool GhostBuilder::loadHanging(const Cell& cell, unsigned mask, int i)
{
    if ((cornersRound(i) & mask) != cornersRound(i)) return false;
    const int half = 1 << (cell.level - 1);
    const std::int64_t s = mVolume.findSample(cell.origin + coordinates(i) * half);
    if (s < 0) return false;
    const auto sample = static_cast<SampleId>(s);
    std::fill(plainOf(i), plainOf(i) + mSize, 0.0f);
    mPlain.load(sample, false, plainOf(i));
    mSplit.node[i] = sampleNode(sample, plainOf(i));
    mCombination[i].assign(1, {sample, 1.0f});
    return true;
}

void GhostBuilder::makeGhost(int i, int half)
{
    if (!mPure.empty()) {
        std::copy(pureOf(i), pureOf(i) + mSize, plainOf(i));
        return;
    }
    int from[6];
    int count = 0;
    for (int a = 0; a < 3; ++a) {
        if (coordinate(i, a) != 1) continue;
        from[count++] = i - kStep[a];
        from[count++] = i + kStep[a];
    }
    meanOf(from, count, i, half);
}

/// Mean of the expansions at point @a to; without gradients, of values. Gradient goes half the way,
/// so that what it evaluates at a ghost is the mean of what it evaluates at the parents.
void GhostBuilder::meanOf(const int* from, int count, int to, int half)
{
    const int channels = mPlain.channels();
    const double way = mMode == Interpolation::Gradient ? 0.5 * half : half;
    for (int k = 0; k < channels; ++k) {
        double sum[4] = {};
        for (int f = 0; f < count; ++f) {
            const float* parent = plainOf(from[f]) + k;
            sum[0] += parent[0];
            for (int a = 0; a < mBlocks - 1; ++a) {
                const double slope = parent[(a + 1) * channels];
                sum[0] += slope * way * (coordinate(to, a) - coordinate(from[f], a));
                sum[a + 1] += slope;
            }
        }
        for (int b = 0; b < mBlocks; ++b) {
            plainOf(to)[b * channels + k] = static_cast<float>(sum[b] / count);
        }
    }
    if (mMode != Interpolation::InverseDistance) return;
    Combination& all = mCombination[to];
    all.clear();
    for (int f = 0; f < count; ++f) {
        for (const SamplerForm::Parent& p : mCombination[from[f]]) {
            const auto known = std::find_if(all.begin(), all.end(),
                [&](const SamplerForm::Parent& q) { return q.node == p.node; });
            const float share = p.share / static_cast<float>(count);
            if (known == all.end()) {
                all.push_back({p.node, share});
            } else {
                known->share += share;
            }
        }
    }
}

/// Value and derivatives of the Hermite interpolant in the middle between the two points beside
/// @a i: ½(f0+f1) + L/8 (f0'−f1') and 3/2 (f1−f0)/L − ¼(f0'+f1').
void GhostBuilder::restrictHermite(int i, int size)
{
    int axis = 0;
    while (coordinate(i, axis) != 1) ++axis;
    const float* lower = pureOf(i - kStep[axis]);
    const float* upper = pureOf(i + kStep[axis]);
    const int channels = mPlain.channels();
    for (int b = 0; b < 8; ++b) {
        if (kBlockAxes[b] >> axis & 1) continue;
        const int with = kBlockAxes[b] | 1 << axis;
        const int d = static_cast<int>(std::find(kBlockAxes, kBlockAxes + 8, with) - kBlockAxes);
        for (int k = 0; k < channels; ++k) {
            const double f0 = lower[b * channels + k], f1 = upper[b * channels + k];
            const double g0 = lower[d * channels + k], g1 = upper[d * channels + k];
            pureOf(i)[b * channels + k]
                = static_cast<float>(0.5 * (f0 + f1) + 0.125 * size * (g0 - g1));
            pureOf(i)[d * channels + k]
                = static_cast<float>(1.5 * (f1 - f0) / size - 0.25 * (g0 + g1));
        }
    }
}

/// A sample's own node, except that wide records are kept apart.
std::uint32_t GhostBuilder::sampleNode(SampleId s, const float* record)
{
    if (mBlocks != 8) return s;
    const auto known = mSamples.find(s);
    if (known != mSamples.end()) return known->second;
    const std::uint32_t node = addNode(record, {});
    mSamples.emplace(s, node);
    return node;
}

std::uint32_t GhostBuilder::addNode(const float* record, const Combination& parents)
{
    const auto node = mFirstNode + static_cast<std::uint32_t>(mRecords.size() / mSize);
    mRecords.insert(mRecords.end(), record, record + mSize);
    if (mMode == Interpolation::InverseDistance) {
        mParents.insert(mParents.end(), parents.begin(), parents.end());
        mParentBegin.push_back(static_cast<std::uint32_t>(mParents.size()));
    }
    return node;
}

} // namespace lumivdb::detail
