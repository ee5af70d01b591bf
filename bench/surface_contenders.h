// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file surface_contenders.h
/// What the light of surfaces may be kept in: the radiance cache's patches, a hashed grid, surfels.
/// Each is filled with the mean light of the places that fall into a record, and asked by place.

#include "tracer_impl.h"

#include <lumivdb/bake/radiance_cache.h>
#include <lumivdb/core/random.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

namespace lumivdb {

using Places = std::vector<SurfacePoint>;
using Values = std::vector<Color>;

struct Answer {
    Color value{0.0f};
    bool missed = true;
};

struct Record {
    Color sum{0.0f};
    float count = 0;

    void add(const Color& c)
    {
        sum += c;
        count += 1;
    }
    Color mean() const { return sum / std::max(count, 1.0f); }
};

/// Reflected light of a cache.
class Solved {
public:
    Solved(const Tracer& tracer, RadianceCacheOptions options, std::uint64_t seed)
    {
        options.seed = seed;
        mAll = std::make_shared<const RadianceCache>(tracer, options);
        options.maxBounces = 1; // keeps direct light alone, in the same patches
        mDirect = std::make_shared<const RadianceCache>(tracer, options);
    }
    const RadianceCache& cache() const { return *mAll; }
    Answer operator()(const SurfacePoint& s) const
    {
        const RadianceCache::Light l = mAll->at(s.triangle, s.u, s.v, s.behind);
        if (l.mixed) return {l.irradiance, false};
        return {l.irradiance - mDirect->at(s.triangle, s.u, s.v, s.behind).irradiance, false};
    }

private:
    std::shared_ptr<const RadianceCache> mAll, mDirect;
};

/// Those that no place fell into answer with what was solved.
class Patches {
public:
    Patches(const Solved& solved, const Places& places, const Values& values)
        : mSolved(solved)
    {
        for (std::size_t i = 0; i < places.size(); ++i) {
            const std::uint32_t id = patchOf(places[i]);
            if (id >= mRecords.size()) mRecords.resize(id + std::size_t{1});
            if (mRecords[id].count == 0) ++mCount;
            mRecords[id].add(values[i]);
        }
    }
    std::size_t count() const { return mCount; } ///< that a place fell into
    Answer operator()(const SurfacePoint& s) const
    {
        const std::uint32_t id = patchOf(s);
        if (id >= mRecords.size() || mRecords[id].count == 0) {
            return {mSolved(s).value, true};
        }
        return {mRecords[id].mean(), false};
    }

private:
    std::uint32_t patchOf(const SurfacePoint& s) const
    {
        return mSolved.cache().patchAt(s.triangle, s.u, s.v, s.behind);
    }
    const Solved& mSolved;
    std::vector<Record> mRecords;
    std::size_t mCount = 0;
};

inline Coord cellOf(const Vec3f& p, float side)
{
    return {static_cast<int>(std::floor(p.x / side)), static_cast<int>(std::floor(p.y / side)),
        static_cast<int>(std::floor(p.z / side))};
}

/// The normal's main axis and its sign.
inline std::uint64_t faceOf(const Vec3f& n)
{
    int axis = 0;
    for (int a = 1; a < 3; ++a) {
        if (std::abs(n[a]) > std::abs(n[axis])) axis = a;
    }
    return static_cast<std::uint64_t>(2 * axis + (n[axis] < 0 ? 1 : 0));
}

/// Cells of four sizes, each twice the one before; those above the first answer for empty ones.
class Grid {
public:
    static constexpr int kLevels = 4;

    Grid(const Places& places, const Values& values, float side, bool between)
        : mSide(side)
        , mBetween(between)
    {
        std::size_t capacity = 64, all = 0;
        for (int l = 0; l < kLevels; ++l) all += count(places, level(l));
        while (capacity < 2 * all) capacity *= 2;
        mTable.resize(capacity);
        for (std::size_t i = 0; i < places.size(); ++i) {
            for (int l = 0; l < kLevels; ++l) {
                const std::uint64_t k = keyOf(cellOf(places[i].position, level(l)), places[i], l);
                Entry& e = mTable[slot(k)];
                e.key = k;
                e.record.add(values[i]);
            }
        }
    }
    std::size_t bytes() const { return mTable.size() * sizeof(Entry); }

    static std::size_t count(const Places& places, float side)
    {
        std::vector<std::uint64_t> keys;
        for (const SurfacePoint& s : places) keys.push_back(keyOf(cellOf(s.position, side), s, 0));
        std::sort(keys.begin(), keys.end());
        return static_cast<std::size_t>(std::unique(keys.begin(), keys.end()) - keys.begin());
    }

    Answer operator()(const SurfacePoint& s) const
    {
        Answer a;
        if (mBetween && interpolate(s, a.value)) return {a.value, false};
        for (int l = 0; l < kLevels; ++l) {
            const Entry& e = mTable[slot(keyOf(cellOf(s.position, level(l)), s, l))];
            if (e.record.count > 0) return {e.record.mean(), l > 0};
        }
        return a;
    }

private:
    struct Entry {
        std::uint64_t key = 0;
        Record record;
    };
    float level(int l) const { return mSide * static_cast<float>(1 << l); }
    static std::uint64_t keyOf(const Coord& c, const SurfacePoint& s, int level)
    {
        return hashPoint(faceOf(s.normal) + 8 * static_cast<std::uint64_t>(level), c.x, c.y, c.z);
    }
    /// Of @a key, or the empty one where it would be.
    std::size_t slot(std::uint64_t key) const
    {
        std::size_t i = key & (mTable.size() - 1);
        while (mTable[i].record.count > 0 && mTable[i].key != key) {
            i = (i + 1) & (mTable.size() - 1);
        }
        return i;
    }
    /// Between the eight cells around, those that are empty left out.
    bool interpolate(const SurfacePoint& s, Color& value) const
    {
        const Vec3f p = s.position / mSide - Vec3f(0.5f);
        const Coord lower = cellOf(p, 1);
        const Vec3f t = p - Vec3f(lower);
        float sum = 0;
        for (int i = 0; i < 8; ++i) {
            const Coord step(i & 1, (i >> 1) & 1, i >> 2);
            const Entry& e = mTable[slot(keyOf(lower + step, s, 0))];
            if (e.record.count == 0) continue;
            float w = 1;
            for (int a = 0; a < 3; ++a) w *= step[a] ? t[a] : 1 - t[a];
            value += e.record.mean() * w;
            sum += w;
        }
        if (!(sum > 0)) return false;
        value /= sum;
        return true;
    }
    float mSide;
    bool mBetween;
    std::vector<Entry> mTable;
};

constexpr float kSameSide = 0.8f; ///< cosine between normals of a surfel and of what it may light

/// Places at least @a radius apart, and none further from all of them, where normals agree.
inline std::vector<std::uint32_t> spread(const Places& places, float radius)
{
    std::size_t buckets = 64;
    while (buckets < places.size()) buckets *= 2;
    std::vector<std::uint32_t> head(buckets, ~0u), next(places.size(), ~0u), kept;
    const auto bucket = [&](const Coord& c) { return hashPoint(0, c.x, c.y, c.z) & (buckets - 1); };
    for (std::uint32_t i = 0; i < places.size(); ++i) {
        const SurfacePoint& s = places[i];
        const Coord lower = cellOf(s.position - Vec3f(radius), 2 * radius);
        bool free = true;
        for (int k = 0; k < 8 && free; ++k) {
            const Coord cell = lower + Coord(k & 1, (k >> 1) & 1, k >> 2);
            for (std::uint32_t j = head[bucket(cell)]; j != ~0u && free; j = next[j]) {
                free = (places[j].position - s.position).length2() >= radius * radius
                    || places[j].normal.dot(s.normal) < kSameSide;
            }
        }
        if (!free) continue;
        std::uint32_t& first = head[bucket(cellOf(s.position, 2 * radius))];
        next[i] = first;
        first = i;
        kept.push_back(i);
    }
    return kept;
}

class Surfels {
public:
    /// @a chosen of @a places, each with the mean light of those it is nearest to; looked for
    /// within @a reach.
    Surfels(const Places& places, const Values& values, const std::vector<std::uint32_t>& chosen,
        float reach, float cosine)
        : mReach(reach)
        , mCosine(cosine)
    {
        while (mBuckets < chosen.size()) mBuckets *= 2;
        for (const std::uint32_t i : chosen) {
            const Coord c = cellOf(places[i].position, 2 * reach);
            mSurfels.push_back({places[i].position, places[i].normal, {}, hashOf(c)});
        }
        const auto bucket = [&](const Surfel& s) { return s.cell & (mBuckets - 1); };
        std::sort(mSurfels.begin(), mSurfels.end(), [&](const Surfel& a, const Surfel& b) {
            return std::make_pair(bucket(a), a.cell) < std::make_pair(bucket(b), b.cell);
        });
        mStart.assign(mBuckets + 1, 0);
        for (const Surfel& s : mSurfels) ++mStart[bucket(s) + 1];
        for (std::size_t b = 0; b < mBuckets; ++b) mStart[b + 1] += mStart[b];
        for (std::size_t i = 0; i < places.size(); ++i) {
            float nearest = reach * reach;
            Surfel* found = nullptr;
            around(places[i], [&](const Surfel& s, float d2) {
                if (d2 > nearest) return;
                nearest = d2;
                found = const_cast<Surfel*>(&s);
            });
            if (found) found->light.add(values[i]);
        }
    }
    std::size_t bytes() const
    {
        return mSurfels.size() * sizeof(Surfel) + mStart.size() * sizeof(std::uint32_t);
    }

    Answer operator()(const SurfacePoint& s) const
    {
        Color sum(0.0f);
        float weights = 0;
        around(s, [&](const Surfel& other, float d2) {
            const float t = 1 - d2 / (mReach * mReach), w = t * t + 1e-6f;
            sum += other.light.mean() * w;
            weights += w;
        });
        if (!(weights > 0)) return {};
        return {sum / weights, false};
    }

private:
    struct Surfel {
        Vec3f position, normal;
        Record light;
        std::uint32_t cell;
    };
    static std::uint32_t hashOf(const Coord& c)
    {
        return static_cast<std::uint32_t>(hashPoint(0, c.x, c.y, c.z));
    }
    /// Surfels within reach whose normals agree and that lie in about the same plane.
    template <class Each> void around(const SurfacePoint& s, const Each& each) const
    {
        const Coord lower = cellOf(s.position - Vec3f(mReach), 2 * mReach);
        for (int k = 0; k < 8; ++k) {
            const std::uint32_t cell = hashOf(lower + Coord(k & 1, (k >> 1) & 1, k >> 2));
            const std::size_t b = cell & (mBuckets - 1);
            for (std::uint32_t i = mStart[b]; i < mStart[b + 1]; ++i) {
                const Surfel& other = mSurfels[i];
                const Vec3f d = other.position - s.position;
                if (other.cell != cell || d.length2() > mReach * mReach) continue;
                if (other.normal.dot(s.normal) < mCosine) continue;
                if (std::abs(d.dot(s.normal)) <= mReach / 2) each(other, d.length2());
            }
        }
    }
    float mReach, mCosine;
    std::size_t mBuckets = 64;
    std::vector<Surfel> mSurfels; ///< by bucket
    std::vector<std::uint32_t> mStart; ///< of the buckets; one more at the end
};

} // namespace lumivdb
