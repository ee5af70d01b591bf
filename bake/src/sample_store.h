// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file sample_store.h
/// The samples of a bake whose topology is not yet known: traced when they are first asked for.

#include "outlook.h"
#include "sample_baker.h"

#include <unordered_map>
#include <vector>

namespace lumivdb {

struct CoordHash {
    std::size_t operator()(const Coord& c) const;
};

class SampleStore {
public:
    /// What is kept of a sample besides its coefficients.
    struct Info {
        Coord position;
        float validity, distance;
        Vec3f offset;
        Color variance;
    };

    SampleStore(const Tracer& tracer, const SampleSettings& settings);

    /// Traces those of @a points that are not yet there, in parallel. Their order, and the order of
    /// calls, does not change any sample. @a outlook is in a step of samples. @throws
    /// Error(Interrupted).
    void require(std::vector<Coord> points, Outlook& outlook);

    /// How many of @a points, which may repeat, are not yet there.
    std::size_t missing(std::vector<Coord> points) const;

    /// Number of the sample at @a p, which must be there.
    std::size_t find(const Coord& p) const { return mIndex.at(p); }
    const Info& info(std::size_t i) const { return mInfo[i]; }
    bool isValid(std::size_t i) const;
    const Color* radiance(std::size_t i) const { return mRecords.data() + i * mStride; }
    /// Null without gradients.
    const Color* gradient(std::size_t i) const;
    /// Where sample @a i was measured, world units.
    Vec3d measured(std::size_t i) const;

    const SampleSettings& settings() const { return mBaker.settings(); }
    std::size_t size() const { return mInfo.size(); }
    std::uint64_t rays() const { return mRays; }
    /// Directions of all samples; in a rehearsal, of the bake's as foreseen.
    double directions() const { return static_cast<double>(mDirections); }
    /// Directions of a sample, rounded mean over all.
    int meanDirections() const;
    /// Mean standard error of E over all samples / mean E.
    double meanRelativeStderr() const;

private:
    /// Leaves those that are missing, sorted, once each.
    void keepMissing(std::vector<Coord>& points) const;
    void trace(const std::vector<Coord>& points, Outlook& outlook);
    SampleBaker mBaker;
    std::size_t mStride;
    std::unordered_map<Coord, std::size_t, CoordHash> mIndex;
    std::vector<Color> mRecords;
    std::vector<Info> mInfo;
    std::uint64_t mRays = 0, mDirections = 0;
};

} // namespace lumivdb
