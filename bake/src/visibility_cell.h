// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file visibility_cell.h
/// The cut of one cell: surfaces in it, places that look at its corners, planes that tell them
/// apart.

#include "packets.h"

#include <lumivdb/core/volume.h>

#include <array>
#include <bitset>
#include <cstdint>
#include <optional>
#include <vector>

namespace lumivdb {

/// A cell in the tracer's local space. A place in it is base + axis · t, t ∈ [0,1]³.
struct CellFrame {
    Vec3d base;
    Vec3d axis[3]; ///< orthogonal, of one length
    double size; ///< that length
    Vec3f corner[8]; ///< where its samples were measured
    std::uint8_t valid; ///< bit i: corner i contributes to interpolation

    Vec3d local(const Vec3d& t) const
    {
        return base + axis[0] * t.x + axis[1] * t.y + axis[2] * t.z;
    }
    Vec3d cell(const Vec3d& local) const
    {
        const Vec3d d = (local - base) / (size * size);
        return {axis[0].dot(d), axis[1].dot(d), axis[2].dot(d)};
    }
};

/// The part of a triangle that lies in the cell, in cell coordinates.
struct CellSurface {
    std::vector<Vec3d> polygon;
    Vec3d normal; ///< unit, of the front
    double area;
    bool doubleSided;
};

struct CellPlane {
    Vec3d normal; ///< unit
    double offset; ///< normal · (t − ½)
    double area = 0; ///< of the surfaces in it
    /// ±1: all its surfaces are single-sided, fronts where the normal points or opposite; 0 else.
    int front = 0;
};

/// Clips @a triangles to the cell; those without area there are left out. Largest first.
std::vector<CellSurface> clipToCell(
    const Tracer::Impl& impl, const CellFrame& frame, const std::vector<std::uint32_t>& triangles);

/// How far behind single-sided surfaces their plane lies, in cell widths.
constexpr double kBehind = 0x1p-12;

/// Planes of @a surfaces, coplanar ones as one, largest first, with their common mean at the end
/// where they differ. A plane of single-sided surfaces lies a little behind their fronts, so that
/// what is on the surface, up to rounding, is before it.
std::vector<CellPlane> planesOf(const std::vector<CellSurface>& surfaces);

/// Finds CellVisibility cell by cell; one for each thread.
class CellCutter {
public:
    explicit CellCutter(const Tracer::Impl& impl)
        : mImpl(impl)
    {
    }
    /// None where every place sees every valid corner, or where masks would not say otherwise.
    std::optional<CellVisibility> cut(
        const CellFrame& frame, const std::vector<std::uint32_t>& triangles);
    std::uint64_t rays() const { return mRays; }

private:
    static constexpr int kVolumePlaces = 64;
    static constexpr int kSurfacePairs = 32;
    static constexpr int kMaxPlaces = kVolumePlaces + 2 * kSurfacePairs;
    using Places = std::bitset<kMaxPlaces>;
    static constexpr std::size_t kAround = 12;
    struct Met { // what a ray met, kMiss: nothing
        float t, u, v;
        std::uint32_t triangle;
    };
    struct Candidate {
        CellPlane plane;
        Places above;
    };

    void placeInVolume();
    void placeOnSurfaces(const std::vector<CellSurface>& surfaces);
    void placeBeside(const Vec3d& t, const Vec3d& step);
    void look();
    std::uint8_t lookFrom(const Vec3d& t);
    void leaveOutSolid();
    void lookAround(const std::vector<Vec3f>& places);
    bool isSolid(const Vec3f& place, const std::array<Met, kAround>& around) const;
    bool allSeen() const;
    void collectCandidates(const std::vector<CellSurface>& surfaces);
    int cost(const std::vector<int>& chosen) const;
    int countOdd(const Places& region, const int* chosen, std::size_t count) const;
    int bestCandidate(std::vector<int>& chosen, std::size_t slot, int& best) const;
    std::vector<int> choosePlanes() const;
    void addMiddlePlanes(std::vector<int>& chosen) const;
    Places inRegion(const std::vector<int>& chosen, int planes, int region) const;
    CellVisibility makeMasks(const std::vector<int>& chosen, int informative);
    std::uint8_t maskOf(const Places& region) const;
    std::uint8_t maskOfEmpty(const CellVisibility& v, int region);
    std::uint8_t maskOfNearest(const CellVisibility& v, int region) const;

    const Tracer::Impl& mImpl;
    std::uint64_t mRays = 0;
    // Of the cell at hand:
    const CellFrame* mFrame = nullptr;
    std::vector<Vec3d> mPlaces; // cell coordinates
    Places mKept; // not inside solids
    Places mSeen[8]; // from which places corner i is seen
    std::vector<std::array<Met, kAround>> mAround; // per place that sees no corner
    std::vector<Candidate> mCandidates;
    RayBatch mBatch;
    HitBatch mHits;
    std::uint8_t mOccluded[kBatch];
};

/// Shadow rays leave this share of their length out at either end, where places and corners may
/// lie on surfaces.
constexpr float kRayEnd = 0x1p-16f;

} // namespace lumivdb
