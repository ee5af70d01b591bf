// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/visibility.h>

#include <lumivdb/bake/geometry_cells.h>
#include <lumivdb/core/error.h>

#include "directions.h"
#include "threads.h"
#include "visibility_cell.h"

#include <tbb/enumerable_thread_specific.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>

namespace lumivdb {

namespace {

/// Cells count as touched when geometry lies this share of the spacing beyond them: samples are
/// moved that far.
constexpr double kGrow = 1e-3;

CellFrame frameOf(const IrradianceVolume& volume, const Cell& cell, const Vec3d& origin)
{
    CellFrame frame;
    const Mat4d& m = volume.indexToWorld();
    const double width = 1 << cell.level;
    frame.base = Vec3d(cell.origin) * m - origin;
    for (int a = 0; a < 3; ++a) frame.axis[a] = Vec3d(m[a][0], m[a][1], m[a][2]) * width;
    frame.size = volume.spacing() * width;
    frame.valid = 0;
    for (int i = 0; i < 8; ++i) {
        const SampleId s = cell.corners[i];
        frame.corner[i] = Vec3f(volume.measuredWorld(s) - origin);
        if (volume.isValid(s)) frame.valid = static_cast<std::uint8_t>(frame.valid | 1 << i);
    }
    return frame;
}

Box3d worldBox(const CellFrame& frame, const Vec3d& origin, double grow)
{
    Box3d box;
    for (int i = 0; i < 8; ++i)
        box.extendBy(frame.local(Vec3d(i & 1, i >> 1 & 1, i >> 2 & 1)) + origin);
    box.min -= Vec3d(grow);
    box.max += Vec3d(grow);
    return box;
}

using Cuts = std::vector<std::pair<CellId, CellVisibility>>;

struct Worker {
    explicit Worker(const Tracer::Impl& impl)
        : cutter(impl)
    {
    }
    CellCutter cutter;
    std::vector<std::uint32_t> triangles;
    Cuts cuts;
    std::size_t touched = 0;
};

/// Share of 64 rays that meet the back of single-sided surfaces.
double backFaceShare(const Tracer::Impl& impl, const Vec3d& p)
{
    constexpr int kRays = 64;
    static const std::vector<Vec3f> directions = stratifiedDirections(0, kRays);
    const Vec3f local = impl.toLocal(p);
    RayBatch rays;
    HitBatch hits;
    for (const Vec3f& d : directions) rays.push(local, d, std::numeric_limits<float>::infinity());
    intersectCoherent(impl, rays, hits);
    int backFaces = 0;
    for (int i = 0; i < rays.count; ++i) {
        if (hits.triangle[i] == kMiss) continue;
        backFaces += impl.surfaceSeen(local, rays.direction(i), hits.triangle[i], hits.t[i],
                             hits.u[i], hits.v[i])
                         .backFace;
    }
    return static_cast<double>(backFaces) / rays.count;
}

} // namespace

VisibilityReport computeVisibility(
    IrradianceVolume& volume, const Tracer& tracer, int threads, Progress* progress)
{
    const Tracer::Impl& impl = tracer.impl();
    const GeometryCells geometry(tracer);
    const double grow = kGrow * volume.spacing();
    Progress silent;
    Progress& p = progress ? *progress : silent;
    p.begin("find what cells see", volume.cellCount());
    tbb::enumerable_thread_specific<Worker> workers([&impl] { return Worker(impl); });
    std::atomic<bool> stop{false};
    withThreads(threads, [&] {
        tbb::parallel_for(
            tbb::blocked_range<CellId>(0, static_cast<CellId>(volume.cellCount()), 64),
            [&](const tbb::blocked_range<CellId>& range) {
                Worker& w = workers.local();
                for (CellId id = range.begin(); id != range.end() && !stop; ++id) {
                    const CellFrame frame = frameOf(volume, volume.cell(id), impl.origin);
                    geometry.collect(worldBox(frame, impl.origin, grow), w.triangles);
                    if (w.triangles.empty()) continue;
                    ++w.touched;
                    if (const auto v = w.cutter.cut(frame, w.triangles))
                        w.cuts.emplace_back(id, *v);
                }
                if (p.cancelled()) stop = true;
                p.advance(range.size());
            });
    });
    if (stop) throw Error(ErrorCode::Interrupted, "Interrupted while finding what cells see.");

    VisibilityReport report;
    Cuts cuts;
    for (Worker& w : workers) {
        report.touchedCells += w.touched;
        report.rays += w.cutter.rays();
        cuts.insert(cuts.end(), w.cuts.begin(), w.cuts.end());
    }
    report.cutCells = cuts.size();
    std::sort(
        cuts.begin(), cuts.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    volume.setVisibility(cuts);
    return report;
}

std::uint8_t cornersSeen(const Tracer& tracer, const Vec3d& point, const Vec3d (&corners)[8])
{
    const Tracer::Impl& impl = tracer.impl();
    const Vec3f p = impl.toLocal(point);
    RayBatch rays;
    for (const Vec3d& corner : corners) {
        const Vec3f c = impl.toLocal(corner), d = p - c;
        rays.push(c + d * kRayEnd, d, 1 - 2 * kRayEnd);
    }
    std::uint8_t occluded[kBatch];
    occlude(impl, rays, occluded);
    std::uint8_t seen = 0;
    for (int i = 0; i < 8; ++i)
        if (!occluded[i]) seen = static_cast<std::uint8_t>(seen | 1 << i);
    return seen;
}

// The way out is through a back face: rays all around find those, and each front has a place before
// it. The nearest that is free wins.
std::optional<Vec3d> relocated(
    const Tracer& tracer, const Vec3d& p, double maxDistance, double clearance)
{
    constexpr int kRays = 256;
    static const std::vector<Vec3f> directions = stratifiedDirections(0, kRays);
    // Half the directions of a place before a front meet that front; a bake's rays are others than
    // these 64, so keep clear of the threshold.
    constexpr double kMaxBackFaces = 0.75 * (1 - kValidThreshold);
    std::vector<std::pair<double, Vec3d>> places;
    for (const Vec3f& d : directions) {
        const SurfaceHit hit = tracer.intersect(p, Vec3d(d));
        if (!hit.hit || !hit.backFace) continue;
        const Vec3d place = hit.position + Vec3d(hit.normal) * clearance;
        const double distance = (place - p).length();
        if (distance <= maxDistance) places.emplace_back(distance, place);
    }
    std::stable_sort(places.begin(), places.end(),
        [](const auto& a, const auto& b) { return a.first < b.first; });
    for (const auto& [distance, place] : places) {
        if (tracer.closestSurface(place, 0.5 * clearance, nullptr, nullptr)) continue;
        if (backFaceShare(tracer.impl(), place) <= kMaxBackFaces) return place;
    }
    return std::nullopt;
}

} // namespace lumivdb
