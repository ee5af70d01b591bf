// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/bake.h>

#include "directions.h"

namespace lumivdb {

namespace {

/// How a place looks around: shares of 64 rays that meet back faces and that escape.
struct Surroundings {
    double backFaces = 0, escapes = 0;
};

Surroundings lookAround(const Tracer& tracer, const Vec3d& p)
{
    constexpr int kRays = 64;
    static const std::vector<Vec3f> directions = stratifiedDirections(0, kRays);
    Surroundings s;
    for (const Vec3f& d : directions) {
        const SurfaceHit hit = tracer.intersect(p, Vec3d(d));
        if (!hit.hit) s.escapes += 1.0 / kRays;
        const bool doubleSided = hit.hit
            && tracer.scene()
                   .materials[static_cast<std::size_t>(
                       tracer.scene().meshes[static_cast<std::size_t>(hit.mesh)].material)]
                   .doubleSided;
        if (hit.backFace && !doubleSided) s.backFaces += 1.0 / kRays;
    }
    return s;
}

/// The places off all surfaces that moves along the normals of those nearby lead to, fronts first.
void collectPlaces(
    const Tracer& tracer, const Vec3d& p, double clearance, int moves, std::vector<Vec3d>& places)
{
    double distance = 0;
    Vec3d normal;
    if (!tracer.closestSurface(p, 0.5 * clearance, &distance, &normal)) {
        places.push_back(p);
    } else if (moves > 0) {
        collectPlaces(tracer, p + normal * clearance, clearance, moves - 1, places);
        collectPlaces(tracer, p - normal * clearance, clearance, moves - 1, places);
    }
}

/// The best of the places offered: the one that sees fewest back faces, then the one from which
/// fewest rays escape (inside rather than outside), then the first.
class BestPlace {
public:
    explicit BestPlace(const Tracer& tracer)
        : mTracer(tracer)
    {
    }
    void offer(const Vec3d& p)
    {
        const Surroundings s = lookAround(mTracer, p);
        const bool better = s.backFaces != mSeen.backFaces ? s.backFaces < mSeen.backFaces
                                                           : s.escapes < mSeen.escapes;
        if (!better) return;
        mPlace = p;
        mSeen = s;
    }
    const Vec3d& place() const { return mPlace; }
    /// Whether it looks like the wrong side: a place inside sees none or a few odd ones.
    bool isDoubtful() const { return mSeen.backFaces > 0.03; }

private:
    const Tracer& mTracer;
    Vec3d mPlace{0, 0, 0};
    Surroundings mSeen{2, 2}; // worse than any
};

} // namespace

// Places are compared once they are off *all* surfaces: rays that begin on one see either of its
// sides, by rounding.
Vec3d moveOffSurfaces(const Tracer& tracer, const Vec3d& point, double clearance)
{
    constexpr int kMoves = 4; // the three surfaces of a corner, and one more
    std::vector<Vec3d> places;
    collectPlaces(tracer, point, clearance, kMoves, places);
    if (places.size() == 1) return places[0];
    BestPlace best(tracer);
    for (const Vec3d& p : places) best.offer(p);
    if (!places.empty() && !best.isDoubtful()) return best.place();

    // In an acute edge no move along one normal stays inside: look further, all around.
    constexpr int kDirections = 256;
    static const std::vector<Vec3f> directions = stratifiedDirections(0, kDirections);
    if (places.empty()) best.offer(point);
    for (const Vec3f& d : directions) {
        const Vec3d p = point + Vec3d(d) * (4 * clearance);
        if (!tracer.closestSurface(p, 0.25 * clearance, nullptr, nullptr)) best.offer(p);
    }
    return best.place();
}

} // namespace lumivdb
