// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sampler_form.h"

#include <unordered_map>

namespace lumivdb::detail {

/// A node's record before it is packed: blocks × channels numbers, channels being all coefficients'
/// RGB, the weight, the validity.
class PlainNodes {
public:
    PlainNodes(const IrradianceVolume& volume, const SamplerOptions& options);

    int channels() const { return mChannels; }
    int blocks() const { return mBlocks; } ///< of a sample
    /// Homogeneous record of sample @a s; @a raw: as if it were valid.
    void load(SampleId s, bool raw, float* out) const;

private:
    const IrradianceVolume& mVolume;
    bool mMove; ///< offsets are undone by the gradient
    int mChannels, mBlocks;
    double mToLattice[3][3]; ///< world derivatives → per lattice step
};

/// Splits cells into eight and makes the nodes that are missing.
///
/// Rules use the data of the edge, face or cell that a ghost is in the middle of and nothing else,
/// so that all cells round it make the same: an edge's is the mean of its two ends, a face's that
/// of the four nodes in the middle of its edges, the centre that of the six faces'. The mean of
/// Taylor expansions (Gradient) is one as well. For Tricubic it is the restriction of the Hermite
/// interpolant of the corners with all mixed derivatives, so that a split face without any fine
/// sample is still the unsplit one.
class GhostBuilder {
public:
    GhostBuilder(const IrradianceVolume& volume, const SamplerOptions& options,
        const PlainNodes& plain, std::uint32_t firstNode);

    /// Whether finer cells have samples on the border of @a cell.
    static bool touchesFiner(const IrradianceVolume& volume, const Cell& cell);

    /// Nodes of the 3×3×3 lattice points of @a cell, x fastest. @a mask: corners that count.
    struct Split {
        std::array<std::uint32_t, 27> node;
        std::array<float, 27> weight;
    };
    const Split& split(const Cell& cell, unsigned mask);

    /// Records of the nodes made, in order; blockCount() each.
    const std::vector<float>& records() const { return mRecords; }
    std::uint32_t firstNode() const { return mFirstNode; }
    int blockCount() const { return mBlocks; }
    /// InverseDistance only: what the nodes made are sums of.
    const std::vector<std::uint32_t>& parentBegin() const { return mParentBegin; }
    const std::vector<SamplerForm::Parent>& parents() const { return mParents; }

private:
    using Combination = std::vector<SamplerForm::Parent>;
    float* plainOf(int i) { return mWork.data() + static_cast<std::size_t>(i) * mSize; }
    float* pureOf(int i) { return mPure.data() + static_cast<std::size_t>(i) * mSize; }
    void loadCorners(const Cell& cell, unsigned mask);
    bool loadHanging(const Cell& cell, unsigned mask, int i);
    void makeGhost(int i, int half);
    void meanOf(const int* from, int count, int to, int half);
    void restrictHermite(int i, int size);
    std::uint32_t sampleNode(SampleId s, const float* record);
    std::uint32_t addNode(const float* record, const Combination& parents);

    const IrradianceVolume& mVolume;
    const PlainNodes& mPlain;
    Interpolation mMode;
    std::uint32_t mFirstNode;
    int mBlocks;
    std::size_t mSize;
    std::vector<float> mWork, mPure; // 27 records each
    std::array<Combination, 27> mCombination;
    Split mSplit;
    std::unordered_map<std::uint64_t, std::uint32_t> mShared; // lattice key → ghost
    std::unordered_map<SampleId, std::uint32_t> mSamples; // wide records of samples
    std::vector<float> mRecords;
    std::vector<std::uint32_t> mParentBegin{0};
    Combination mParents;
};

} // namespace lumivdb::detail
