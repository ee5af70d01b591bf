// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/blockers.h>

#include "directions.h"
#include "tracer_impl.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <atomic>
#include <cmath>

namespace lumivdb {

namespace {

constexpr double kMost = 1 << 27;

using Polygon = std::vector<Vec3d>;

/// What of @a polygon lies on the side sign · p[axis] ≤ sign · limit (Sutherland & Hodgman 1974).
Polygon cut(const Polygon& polygon, int axis, double sign, double limit)
{
    Polygon kept;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
        const Vec3d &a = polygon[i], &b = polygon[(i + 1) % polygon.size()];
        const double da = sign * (a[axis] - limit), db = sign * (b[axis] - limit);
        if (da <= 0) kept.push_back(a);
        if ((da < 0 && db > 0) || (da > 0 && db < 0))
            kept.push_back(a + (b - a) * (da / (da - db)));
    }
    return kept;
}

/// A triangle of the scene, or one of a fan that the region has left of it.
struct Piece {
    Vec3d a, ab, ac; // local
    std::uint32_t triangle;
};

class Spreader {
public:
    Spreader(const Tracer::Impl& impl, const BlockerOptions& options)
        : mImpl(impl)
        , mOptions(options)
    {
        if (mOptions.region) {
            mOptions.region->min -= impl.origin;
            mOptions.region->max -= impl.origin;
        }
        for (std::uint32_t t = 0; t < impl.triangleCount; ++t) addTriangle(t);
    }

    std::vector<Blocker> run(Progress& progress)
    {
        const double area = mSums.empty() ? 0 : mSums.back();
        const double wanted
            = std::ceil(area * mOptions.perFace / (mOptions.spacing * mOptions.spacing));
        if (wanted > kMost) {
            throw Error(ErrorCode::Usage,
                "The scene's surfaces need more than 134 million blockers at this spacing; take a "
                "larger one or smaller bounds.");
        }
        if (!(wanted > 0)) return {};
        spread(static_cast<std::size_t>(wanted), progress);
        return joined();
    }

private:
    static constexpr std::size_t kBlock = 1024;

    void addTriangle(std::uint32_t index)
    {
        const Corners t = mImpl.corners(index);
        Polygon p = {Vec3d(t.a), Vec3d(t.b), Vec3d(t.c)};
        if (mOptions.region) {
            for (int axis = 0; axis < 3 && !p.empty(); ++axis) {
                p = cut(p, axis, -1, mOptions.region->min[axis]);
                p = cut(p, axis, 1, mOptions.region->max[axis]);
            }
        }
        for (std::size_t i = 2; i < p.size(); ++i) {
            const Piece piece{p[0], p[i - 1] - p[0], p[i] - p[0], index};
            const double area = 0.5 * piece.ab.cross(piece.ac).length();
            if (!(area > 0)) continue;
            mPieces.push_back(piece);
            mSums.push_back((mSums.empty() ? 0.0 : mSums.back()) + area);
        }
    }

    void spread(std::size_t count, Progress& progress)
    {
        progress.begin("spread blockers over the surfaces", count);
        mBlocks.resize((count + kBlock - 1) / kBlock);
        const auto share = static_cast<float>(mSums.back() / static_cast<double>(count));
        std::atomic<bool> stop{false};
        tbb::parallel_for(std::size_t{0}, mBlocks.size(), [&](std::size_t b) {
            if (stop || progress.cancelled()) {
                stop = true;
                return;
            }
            const std::size_t last = std::min(count, (b + 1) * kBlock);
            for (std::size_t i = b * kBlock; i < last; ++i) {
                add(jitteredStratum(mOptions.seed, i, count), share, mBlocks[b]);
            }
            progress.advance(last - b * kBlock);
        });
        if (stop) throw Error(ErrorCode::Interrupted, "The blockers were interrupted half-way.");
    }

    /// The blocker at share @a t of all area.
    void add(double t, float area, std::vector<Blocker>& to) const
    {
        const double x = t * mSums.back();
        const auto it = std::upper_bound(mSums.begin(), mSums.end() - 1, x);
        const double low = it == mSums.begin() ? 0 : *(it - 1);
        const double rest = std::clamp((x - low) / (*it - low), 0.0, 0x1.fffffffffffffp-1);
        const Piece& piece = mPieces[static_cast<std::size_t>(it - mSums.begin())];
        const Vec2f place = squareToTriangle(hilbertPoint(rest));
        const Vec3d p = piece.a + piece.ab * place.x + piece.ac * place.y;

        const auto& triangle = mImpl.triangle(piece.triangle);
        const Vec2f uv = barycentrics(mImpl.corners(piece.triangle), p);
        const Material& material = mImpl.materialOf(triangle);
        float alpha = 1;
        const Color albedo = mImpl.albedoAt(triangle, uv.x, uv.y, &alpha);
        if (material.alphaMask && alpha < material.alphaCutoff) return;
        Blocker blocker;
        blocker.position = p + mImpl.origin;
        blocker.normal = Vec3f(piece.ab.cross(piece.ac).normalized());
        blocker.area = area;
        blocker.albedo = albedo;
        if (material.doubleSided) blocker.albedoBehind = albedo;
        to.push_back(blocker);
    }

    static Vec2f barycentrics(const Corners& t, const Vec3d& p)
    {
        const Vec3d a(t.a), ab = Vec3d(t.b) - a, ac = Vec3d(t.c) - a;
        const Vec3d n = ab.cross(ac), ap = p - a;
        const double n2 = n.length2();
        return {static_cast<float>(ap.cross(ac).dot(n) / n2),
            static_cast<float>(ab.cross(ap).dot(n) / n2)};
    }

    std::vector<Blocker> joined()
    {
        std::vector<Blocker> all;
        for (auto& b : mBlocks) {
            all.insert(all.end(), b.begin(), b.end());
            std::vector<Blocker>().swap(b);
        }
        return all;
    }

    const Tracer::Impl& mImpl;
    BlockerOptions mOptions;
    std::vector<Piece> mPieces;
    std::vector<double> mSums; // of the pieces' areas
    std::vector<std::vector<Blocker>> mBlocks;
};

} // namespace

void BlockerOptions::validate() const
{
    if (!(spacing > 0) || !std::isfinite(spacing)) {
        throw Error(ErrorCode::Usage,
            "spacing of the blockers is " + std::to_string(spacing)
                + "; take a positive length in scene units.");
    }
    if (perFace < 1 || perFace > 4096) {
        throw Error(ErrorCode::Usage,
            "perFace is " + std::to_string(perFace)
                + "; take 1 to 4096 blockers on a cell's face.");
    }
}

std::vector<Blocker> surfaceBlockers(
    const Tracer& tracer, const BlockerOptions& options, Progress* progress)
{
    options.validate();
    Progress silent;
    return Spreader(tracer.impl(), options).run(progress ? *progress : silent);
}

} // namespace lumivdb
