// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/vdb_io/resample.h>

#include "records.h"

#include <lumivdb/core/error.h>

#include <algorithm>
#include <cmath>
#include <tuple>
#include <unordered_map>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;
/// Interpolation rounds: an exact copy may differ by this share of the light around.
constexpr double kRounding = 0x1p-20;

struct CoordHash {
    std::size_t operator()(const Coord& c) const
    {
        const auto part = [](int v, std::uint64_t factor) {
            return static_cast<std::uint64_t>(static_cast<std::uint32_t>(v)) * factor;
        };
        const std::uint64_t h = part(c.x, 0x9e3779b97f4a7c15ull) ^ part(c.y, 0xc2b2ae3d27d4eb4full)
            ^ part(c.z, 0x165667b19e3779f9ull);
        return static_cast<std::size_t>(h ^ (h >> 29));
    }
};

Coord childOffset(int i, int size) { return Coord(i & 1, i >> 1 & 1, i >> 2 & 1) * size; }

/// Merges sibling cells, level by level.
class Coarsener {
public:
    Coarsener(const IrradianceVolume& volume, double tolerance)
        : mVolume(volume)
        , mCells(kMaxLevel + 1)
    {
        for (std::size_t i = 0; i < volume.cellCount(); ++i) {
            const auto id = static_cast<CellId>(i);
            const Cell& cell = volume.cell(id);
            mCells[static_cast<std::size_t>(cell.level)][cell.origin] = {id};
        }
        for (int l = 0; l < volume.bands(); ++l) mWeights.push_back(weightOf(l));
        mLimit = tolerance * meanIrradiance();
    }

    /// One level more, the finest first. False when nothing could be merged.
    bool pass()
    {
        bool merged = false;
        // From the coarsest: what one merge makes must not be merged again in the same pass.
        for (int level = kMaxLevel - 1; level >= 0; --level) {
            for (const Coord& parent : parentsAt(level)) {
                if (!mayMerge(parent, level)) continue;
                merge(parent, level);
                merged = true;
            }
        }
        return merged;
    }

    IrradianceVolume build() const
    {
        VolumeBuilder builder(mVolume.bands(), gradientStorage(mVolume), mVolume.indexToWorld());
        for (int level = 0; level <= kMaxLevel; ++level)
            for (const auto& [origin, ids] : at(level)) builder.addCell(origin, level);
        return builder.build();
    }

private:
    /// Cells of one level by origin, each with the volume's cells it is made of.
    using Level = std::unordered_map<Coord, std::vector<CellId>, CoordHash>;

    Level& at(int level) { return mCells[static_cast<std::size_t>(level)]; }
    const Level& at(int level) const { return mCells[static_cast<std::size_t>(level)]; }

    /// A_l² / 4π: the norm is the RMS of irradiance over normals.
    static double weightOf(int l)
    {
        const double a = kCosineLobe[static_cast<std::size_t>(l)];
        return a * a / (4 * kPi);
    }

    /// Over valid samples, of the brightest channel.
    double meanIrradiance() const
    {
        Vec3d sum(0.0);
        std::size_t valid = 0;
        for (std::size_t i = 0; i < mVolume.sampleCount(); ++i) {
            const auto s = static_cast<SampleId>(i);
            if (!mVolume.isValid(s)) continue;
            sum += Vec3d(mVolume.radiance(s)[0]);
            ++valid;
        }
        if (valid == 0) return 0;
        const double mean = std::max({sum.x, sum.y, sum.z}) / static_cast<double>(valid);
        return std::max(0.0, mean) * kPi * 0.28209479177387814;
    }

    /// Origins of the parents of which the first child exists, in order.
    std::vector<Coord> parentsAt(int level) const
    {
        std::vector<Coord> parents;
        const int size = 2 << level;
        for (const auto& [origin, ids] : at(level))
            if (((origin.x | origin.y | origin.z) & (size - 1)) == 0) parents.push_back(origin);
        std::sort(parents.begin(), parents.end(), [](const Coord& a, const Coord& b) {
            return std::tie(a.x, a.y, a.z) < std::tie(b.x, b.y, b.z);
        });
        return parents;
    }

    bool mayMerge(const Coord& parent, int level) const
    {
        const int size = 1 << level;
        SampleId corners[8];
        for (int i = 0; i < 8; ++i) {
            const auto child = at(level).find(parent + childOffset(i, size));
            if (child == at(level).end()) return false;
            for (const CellId id : child->second)
                if (mVolume.visibility(id)) return false;
            const std::int64_t s = mVolume.findSample(parent + childOffset(i, 2 * size));
            if (s < 0) return false;
            corners[i] = static_cast<SampleId>(s);
        }
        if (touchesFiner(parent, level)) return false;
        for (int i = 0; i < 8; ++i)
            for (const CellId id : at(level).at(parent + childOffset(i, size)))
                for (const SampleId s : mVolume.cell(id).corners)
                    if (!isReproduced(s, parent, 2 * size, corners)) return false;
        return true;
    }

    /// Whether a cell of the level below touches the parent: merging would make a jump of two.
    bool touchesFiner(const Coord& parent, int level) const
    {
        if (level == 0) return false;
        const Level& finer = at(level - 1);
        const int size = 1 << (level - 1);
        for (int x = -1; x <= 4; ++x)
            for (int y = -1; y <= 4; ++y)
                for (int z = -1; z <= 4; ++z) {
                    const bool inside = std::min({x, y, z}) >= 0 && std::max({x, y, z}) < 4;
                    if (!inside && finer.count(parent + Coord(x, y, z) * size)) return true;
                }
        return false;
    }

    bool isReproduced(SampleId s, const Coord& parent, int size, const SampleId (&corners)[8]) const
    {
        if (mVolume.offset(s) != Vec3f(0.0f)) return false;
        const Vec3d t = Vec3d(mVolume.samplePosition(s) - parent) / static_cast<double>(size);
        double weights[8];
        for (int i = 0; i < 8; ++i) {
            if (mVolume.isValid(corners[i]) != mVolume.isValid(s)) return false;
            weights[i]
                = (i & 1 ? t.x : 1 - t.x) * (i & 2 ? t.y : 1 - t.y) * (i & 4 ? t.z : 1 - t.z);
        }
        if (!mVolume.isValid(s)) return true; // its value is never used
        Vec3d squared(0.0), around(0.0);
        for (int c = 0; c < mVolume.coefficients(); ++c) {
            Vec3d sum(0.0), largest(0.0);
            for (int i = 0; i < 8; ++i) {
                const Vec3d L(mVolume.radiance(corners[i])[c]);
                sum += L * weights[i];
                for (int k = 0; k < 3; ++k) largest[k] = std::max(largest[k], std::abs(L[k]));
            }
            const Vec3d d = sum - Vec3d(mVolume.radiance(s)[c]);
            const double w = mWeights[static_cast<std::size_t>(degreeOf(c))];
            squared += d * d * w;
            around += largest * largest * w;
        }
        for (int k = 0; k < 3; ++k)
            if (std::sqrt(squared[k]) > mLimit + kRounding * std::sqrt(around[k])) return false;
        return true;
    }

    void merge(const Coord& parent, int level)
    {
        std::vector<CellId> all;
        for (int i = 0; i < 8; ++i) {
            const auto child = at(level).find(parent + childOffset(i, 1 << level));
            all.insert(all.end(), child->second.begin(), child->second.end());
            at(level).erase(child);
        }
        at(level + 1)[parent] = std::move(all);
    }

    const IrradianceVolume& mVolume;
    std::vector<Level> mCells;
    std::vector<double> mWeights; // by degree
    double mLimit = 0; // of the irradiance norm
};

} // namespace

IrradianceVolume coarsenVolume(const IrradianceVolume& volume, int levels, double tolerance)
{
    if (levels < 0 || levels > kMaxLevel) {
        throw Error(ErrorCode::Usage,
            "A volume can be coarsened by 0 to 12 levels, not " + std::to_string(levels) + ".");
    }
    if (!(tolerance >= 0) || !std::isfinite(tolerance))
        throw Error(ErrorCode::Usage, "The tolerance must be 0 or a positive number.");
    Coarsener coarsener(volume, tolerance);
    for (int pass = 0; pass < levels && coarsener.pass(); ++pass) { }
    IrradianceVolume out = coarsener.build();
    for (std::size_t i = 0; i < out.sampleCount(); ++i) {
        const auto t = static_cast<SampleId>(i);
        const auto s = static_cast<SampleId>(volume.findSample(out.samplePosition(t)));
        copyRecord(volume, s, out, t);
    }
    copyPlaces({&volume}, out);
    out.metadata() = volume.metadata();
    if (out.cellCount() < volume.cellCount()) forgetError(out.metadata());
    return out;
}

} // namespace lumivdb
