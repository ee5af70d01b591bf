// SPDX-License-Identifier: Apache-2.0
#include "visibility_cell.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace lumivdb {

namespace {

/// Places on both sides of a surface lie this far from it, in cell widths, or nearer where the cell
/// ends before.
constexpr double kBeside = 0x1p-8;
/// A place is inside a solid if more than this share of rays meets back faces.
constexpr double kSolid = 1 - kValidThreshold;

double fraction(double v) { return v - std::floor(v); }

/// The additive recurrence of the plastic numbers' generalisation to three dimensions (Roberts
/// 2018): evenly spread for every length.
Vec3d spread3(int i)
{
    constexpr double g = 1.22074408460575947536; // g^4 = g + 1
    return {fraction(0.5 + (i + 1) / g), fraction(0.5 + (i + 1) / (g * g)),
        fraction(0.5 + (i + 1) / (g * g * g))};
}

/// The same in two dimensions.
Vec2d spread2(int i)
{
    constexpr double g = 1.32471795724474602596; // g^3 = g + 1
    return {fraction(0.5 + (i + 1) / g), fraction(0.5 + (i + 1) / (g * g))};
}

/// A point of triangle abc, uniform for uniform @a u.
Vec3d pointOf(const Vec3d& a, const Vec3d& b, const Vec3d& c, const Vec2d& u)
{
    const double r = std::sqrt(u.x);
    return a * (1 - r) + b * (r * (1 - u.y)) + c * (r * u.y);
}

/// Directions spread over the sphere (spherical Fibonacci), none along an axis.
const std::array<Vec3f, 12>& lookAroundDirections()
{
    static const std::array<Vec3f, 12> directions = [] {
        std::array<Vec3f, 12> d;
        for (std::size_t i = 0; i < d.size(); ++i) {
            const auto k = static_cast<double>(i);
            const double z = 1 - (2 * k + 1) / 12, phi = 2.39996322972865332 * k + 0.3;
            const double r = std::sqrt(1 - z * z);
            d[i] = Vec3f(Vec3d(r * std::cos(phi), z, r * std::sin(phi)).normalized());
        }
        return d;
    }();
    return directions;
}

} // namespace

void CellCutter::placeInVolume()
{
    static const std::array<Vec3d, kVolumePlaces> places = [] {
        std::array<Vec3d, kVolumePlaces> p;
        for (int i = 0; i < kVolumePlaces; ++i) p[static_cast<std::size_t>(i)] = spread3(i);
        return p;
    }();
    mPlaces.assign(places.begin(), places.end());
}

/// A place at t + step, or half way to where the cell ends.
void CellCutter::placeBeside(const Vec3d& t, const Vec3d& step)
{
    double share = 1;
    for (int a = 0; a < 3; ++a) {
        const double room = step[a] > 0 ? 1 - t[a] : t[a];
        if (std::abs(step[a]) > 0) share = std::min(share, 0.5 * room / std::abs(step[a]));
    }
    // Less than the rounding of what it should be told apart from: no place there.
    const Vec3f local(mFrame->local(t));
    const double rounding
        = 0x1p-20 * std::max({std::abs(local.x), std::abs(local.y), std::abs(local.z)});
    if (share * kBeside * mFrame->size > rounding && share > 0) mPlaces.push_back(t + step * share);
}

void CellCutter::placeOnSurfaces(const std::vector<CellSurface>& surfaces)
{
    double total = 0;
    for (const CellSurface& s : surfaces) total += s.area;
    std::size_t surface = 0, corner = 2;
    double before = 0; // area of the fans' triangles passed
    for (int i = 0; i < kSurfacePairs && total > 0; ++i) {
        const double target = (i + 0.5) / kSurfacePairs * total;
        while (surface < surfaces.size()) {
            const auto& p = surfaces[surface].polygon;
            const double area = 0.5 * (p[corner - 1] - p[0]).cross(p[corner] - p[0]).length();
            if (before + area > target) break;
            before += area;
            if (++corner < p.size()) continue;
            ++surface;
            corner = 2;
        }
        if (surface == surfaces.size()) return; // by rounding
        const CellSurface& s = surfaces[surface];
        const Vec3d t = pointOf(s.polygon[0], s.polygon[corner - 1], s.polygon[corner], spread2(i));
        placeBeside(t, s.normal * kBeside);
        placeBeside(t, -s.normal * kBeside);
    }
}

/// From each valid corner to all places: neighbouring rays begin together.
void CellCutter::look()
{
    constexpr int kTogether = kBatch / kMaxPlaces; // corners in one batch
    const auto n = static_cast<int>(mPlaces.size());
    std::array<Vec3f, kMaxPlaces> local;
    for (std::size_t p = 0; p < mPlaces.size(); ++p) local[p] = Vec3f(mFrame->local(mPlaces[p]));
    int corners[kTogether];
    int held = 0;
    mBatch.count = 0;
    for (int i = 0; i < 8; ++i) {
        mSeen[i].reset();
        if (mFrame->valid >> i & 1) {
            const Vec3f& c = mFrame->corner[i];
            for (std::size_t p = 0; p < mPlaces.size(); ++p) {
                const Vec3f d = local[p] - c;
                mBatch.push(c + d * kRayEnd, d, 1 - 2 * kRayEnd);
            }
            corners[held++] = i;
        }
        if (held < kTogether && i < 7) continue;
        occlude(mImpl, mBatch, mOccluded);
        mRays += static_cast<std::uint64_t>(mBatch.count);
        for (int k = 0; k < held; ++k)
            for (int p = 0; p < n; ++p)
                mSeen[corners[k]].set(static_cast<std::size_t>(p), mOccluded[k * n + p] == 0);
        mBatch.count = held = 0;
    }
}

std::uint8_t CellCutter::lookFrom(const Vec3d& t)
{
    const Vec3f p(mFrame->local(t));
    mBatch.count = 0;
    for (const Vec3f& c : mFrame->corner) {
        const Vec3f d = p - c;
        mBatch.push(c + d * kRayEnd, d, 1 - 2 * kRayEnd);
    }
    occlude(mImpl, mBatch, mOccluded);
    mRays += 8;
    std::uint8_t seen = 0;
    for (int i = 0; i < 8; ++i)
        if (!mOccluded[i]) seen = static_cast<std::uint8_t>(seen | 1 << i);
    return seen & mFrame->valid;
}

/// What all @a places meet in each of the directions around: parallel rays side by side.
void CellCutter::lookAround(const std::vector<Vec3f>& places)
{
    mAround.resize(places.size());
    for (std::size_t d = 0; d < kAround; ++d) {
        mBatch.count = 0;
        for (const Vec3f& p : places)
            mBatch.push(p, lookAroundDirections()[d], std::numeric_limits<float>::infinity());
        intersectCoherent(mImpl, mBatch, mHits);
        mRays += places.size();
        for (std::size_t p = 0; p < places.size(); ++p)
            mAround[p][d] = {mHits.t[p], mHits.u[p], mHits.v[p], mHits.triangle[p]};
    }
}

/// Whether the nearest of what a place meets, or most of it, are back faces.
bool CellCutter::isSolid(const Vec3f& place, const std::array<Met, kAround>& around) const
{
    const auto isBack = [&](std::size_t d) {
        const Met& m = around[d];
        if (m.triangle == kMiss) return false;
        if (mImpl.materialOf(m.triangle).doubleSided) return false;
        const Vec3f& direction = lookAroundDirections()[d];
        // A front may lie in the same place.
        return mImpl.corners(m.triangle).areaVector().dot(direction) > 0
            && mImpl.surfaceSeen(place, direction, m.triangle, m.t, m.u, m.v).backFace;
    };
    std::size_t nearest = 0;
    for (std::size_t d = 1; d < kAround; ++d)
        if (around[d].t < around[nearest].t) nearest = d;
    if (isBack(nearest)) return true;
    std::size_t backFaces = 0;
    for (std::size_t d = 0; d < kAround; ++d) {
        backFaces += isBack(d);
        if (backFaces > kSolid * kAround) return true;
        if (backFaces + (kAround - 1 - d) <= kSolid * kAround) return false;
    }
    return false;
}

void CellCutter::leaveOutSolid()
{
    Places sees;
    for (const Places& s : mSeen) sees |= s;
    mKept.reset();
    std::vector<Vec3f> doubtful;
    for (std::size_t p = 0; p < mPlaces.size(); ++p) {
        mKept.set(p);
        if (!sees[p]) doubtful.push_back(Vec3f(mFrame->local(mPlaces[p])));
    }
    lookAround(doubtful);
    for (std::size_t p = 0, k = 0; p < mPlaces.size(); ++p) {
        if (sees[p]) continue;
        mKept.set(p, !isSolid(doubtful[k], mAround[k]));
        ++k;
    }
}

bool CellCutter::allSeen() const
{
    for (int i = 0; i < 8; ++i)
        if ((mFrame->valid >> i & 1) && (mKept & ~mSeen[i]).any()) return false;
    return true;
}

void CellCutter::collectCandidates(const std::vector<CellSurface>& surfaces)
{
    std::vector<CellPlane> planes = planesOf(surfaces);
    for (int a = 0; a < 3; ++a) {
        Vec3d n(0.0);
        n[a] = 1;
        planes.push_back({n, 0});
    }
    mCandidates.clear();
    for (const CellPlane& plane : planes) {
        Candidate c{plane, {}};
        for (std::size_t p = 0; p < mPlaces.size(); ++p)
            c.above.set(p, plane.normal.dot(mPlaces[p] - Vec3d(0.5)) >= plane.offset);
        mCandidates.push_back(c);
    }
}

/// Places at odds with their region's majority, over the regions of the planes chosen.
int CellCutter::countOdd(const Places& region, const int* chosen, std::size_t count) const
{
    if (region.none()) return 0;
    if (count > 0) {
        const Places& above = mCandidates[static_cast<std::size_t>(*chosen)].above;
        return countOdd(region & above, chosen + 1, count - 1)
            + countOdd(region & ~above, chosen + 1, count - 1);
    }
    const auto total = static_cast<int>(region.count());
    int odd = 0;
    for (int i = 0; i < 8; ++i) {
        if (!(mFrame->valid >> i & 1)) continue;
        const auto seen = static_cast<int>((region & mSeen[i]).count());
        odd += std::min(seen, total - seen);
    }
    return odd;
}

int CellCutter::cost(const std::vector<int>& chosen) const
{
    return countOdd(mKept, chosen.data(), chosen.size());
}

/// The candidate that at @a slot leaves less than @a best, the least of all; −1: none does.
int CellCutter::bestCandidate(std::vector<int>& chosen, std::size_t slot, int& best) const
{
    const int before = chosen[slot];
    int winner = -1;
    for (int c = 0; c < static_cast<int>(mCandidates.size()); ++c) {
        chosen[slot] = -1;
        if (std::find(chosen.begin(), chosen.end(), c) != chosen.end()) continue;
        chosen[slot] = c;
        const int left = cost(chosen);
        if (left >= best) continue;
        best = left;
        winner = c;
    }
    chosen[slot] = before;
    return winner;
}

/// Up to three that help: one after the other, each the one that leaves the least; then each again,
/// given the others.
std::vector<int> CellCutter::choosePlanes() const
{
    std::vector<int> chosen;
    int best = cost(chosen);
    while (chosen.size() < 3 && best > 0) {
        chosen.push_back(-1);
        chosen.back() = bestCandidate(chosen, chosen.size() - 1, best);
        if (chosen.back() >= 0) continue;
        chosen.pop_back();
        break;
    }
    for (std::size_t slot = 0; slot + 1 < chosen.size() && best > 0; ++slot) {
        const int winner = bestCandidate(chosen, slot, best);
        if (winner >= 0) chosen[slot] = winner;
    }
    return chosen;
}

void CellCutter::addMiddlePlanes(std::vector<int>& chosen) const
{
    const int count = static_cast<int>(mCandidates.size());
    for (int c = count - 3; c < count && chosen.size() < 3; ++c)
        if (std::find(chosen.begin(), chosen.end(), c) == chosen.end()) chosen.push_back(c);
}

std::uint8_t CellCutter::maskOf(const Places& region) const
{
    const std::size_t total = region.count();
    std::uint8_t mask = 0;
    std::size_t most = 0, count[8] = {};
    for (int i = 0; i < 8; ++i) {
        if (!(mFrame->valid >> i & 1)) continue;
        count[i] = (region & mSeen[i]).count();
        most = std::max(most, count[i]);
        if (2 * count[i] > total) mask = static_cast<std::uint8_t>(mask | 1 << i);
    }
    if (mask != 0 || most == 0) return mask;
    // Seen by few is better than nothing to interpolate from.
    for (int i = 0; i < 8; ++i)
        if (count[i] == most) mask = static_cast<std::uint8_t>(mask | 1 << i);
    return mask;
}

CellCutter::Places CellCutter::inRegion(
    const std::vector<int>& chosen, int planes, int region) const
{
    Places in = mKept;
    for (int k = 0; k < planes; ++k) {
        const Places& above
            = mCandidates[static_cast<std::size_t>(chosen[static_cast<std::size_t>(k)])].above;
        in &= region >> k & 1 ? above : ~above;
    }
    return in;
}

/// The mask of the place on the right side of as many planes as can be, the first ones before all,
/// and then least on the wrong side of the others.
std::uint8_t CellCutter::maskOfNearest(const CellVisibility& v, int region) const
{
    std::pair<int, double> least{8, 0};
    std::size_t nearest = 0;
    for (std::size_t p = 0; p < mPlaces.size(); ++p) {
        if (!mKept[p]) continue;
        std::pair<int, double> wrong{0, 0};
        for (int k = 0; k < 3; ++k) {
            const double d = Vec3d(v.normal[k]).dot(mPlaces[p] - Vec3d(0.5)) - v.offset[k];
            const double beyond = region >> k & 1 ? -d : d;
            if (beyond <= 0) continue;
            wrong.first |= 4 >> k;
            wrong.second = std::max(wrong.second, beyond);
        }
        if (wrong >= least) continue;
        least = wrong;
        nearest = p;
    }
    return v.corners(Vec3f(mPlaces[nearest]));
}

/// Looks from a place in it, if the cell has one that is free.
std::uint8_t CellCutter::maskOfEmpty(const CellVisibility& v, int region)
{
    constexpr int kTries = 512;
    for (int i = 0; i < kTries; ++i) {
        const Vec3d t = spread3(i);
        if (v.region(Vec3f(t)) != region) continue;
        const std::uint8_t seen = lookFrom(t);
        if (seen != 0) return seen;
        const Vec3f place(mFrame->local(t));
        lookAround({place});
        if (!isSolid(place, mAround[0])) return 0;
        break;
    }
    return maskOfNearest(v, region);
}

/// Planes that told nothing apart, past the first @a informative, do not divide the places either.
CellVisibility CellCutter::makeMasks(const std::vector<int>& chosen, int informative)
{
    CellVisibility v;
    for (std::size_t k = 0; k < 3; ++k) {
        const CellPlane& plane = mCandidates[static_cast<std::size_t>(chosen[k])].plane;
        v.normal[k] = Vec3f(plane.normal);
        v.offset[k] = static_cast<float>(plane.offset);
    }
    v.masks = 0;
    unsigned empty = 0;
    for (int r = 0; r < 8; ++r) {
        const Places region = inRegion(chosen, informative, r);
        if (region.none())
            empty |= 1u << r;
        else
            v.masks |= std::uint64_t{maskOf(region)} << (8 * r);
    }
    const CellVisibility filled = v;
    for (int r = 0; r < 8; ++r)
        if (empty >> r & 1) v.masks |= std::uint64_t{maskOfEmpty(filled, r)} << (8 * r);
    return v;
}

std::optional<CellVisibility> CellCutter::cut(
    const CellFrame& frame, const std::vector<std::uint32_t>& triangles)
{
    mFrame = &frame;
    const std::vector<CellSurface> surfaces = clipToCell(mImpl, frame, triangles);
    if (surfaces.empty() || frame.valid == 0) return std::nullopt;
    placeInVolume();
    placeOnSurfaces(surfaces);
    look();
    leaveOutSolid();
    if (mKept.none() || allSeen()) return std::nullopt;
    collectCandidates(surfaces);
    std::vector<int> planes = choosePlanes();
    const int informative = static_cast<int>(planes.size());
    addMiddlePlanes(planes);
    const CellVisibility v = makeMasks(planes, informative);
    for (int r = 0; r < 8; ++r)
        if ((v.masks >> (8 * r) & frame.valid) != frame.valid) return v;
    return std::nullopt;
}

} // namespace lumivdb
