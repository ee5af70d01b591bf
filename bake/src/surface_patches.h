// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file surface_patches.h
/// The surfaces of a scene cut into patches, each with one value of light.
///
/// A patch is one *side* of a part of a triangle, or of some small triangles that hang together and
/// look the same way: never both sides of a sheet, never two sheets that do not touch, so light
/// cannot leak through a wall however thin. Only where a scene falls into more pieces than there
/// may be patches (leaves, gravel, surfaces that bend at every edge) do pieces that do not touch
/// join: small ones in the same cell of a grid that face the same octant, whose sheets may then lie
/// up to a cell apart, one behind the other, but never back to back. Large triangles are cut into
/// four over and over (by their edges' midpoints); groups of small ones into two along their
/// longest side.

#include "tracer_impl.h"

#include <cstdint>
#include <vector>

namespace lumivdb {

class SurfacePatches {
public:
    using Id = std::uint32_t;
    static constexpr Id kNone = 0xffffffffu;

    /// Patches of about @a size (local units) and below, of about @a most groups and large
    /// triangles if they can be had with cells up to that size.
    SurfacePatches(const Tracer::Impl& impl, double size, std::size_t most);

    /// The undivided patch at barycentrics (u, v) of a triangle's side; kNone where it has none
    /// (the black back of a single-sided triangle, one without area).
    Id find(std::uint32_t triangle, float u, float v, bool behind) const
    {
        Id id = mRoot[2 * static_cast<std::size_t>(triangle) + (behind ? 1 : 0)];
        if (id == kNone) return id;
        while (const Id child = mChild[id]) id = child + quarter(u, v);
        return id;
    }

    std::size_t size() const { return mChild.size(); } ///< divided ones included
    std::size_t joined() const { return mJoined; } ///< pieces that lost a patch of their own
    bool divided(Id id) const { return mChild[id] != 0; }
    /// Longest side: of its triangle, or of its members' box.
    float extent(Id id) const { return mPatches[id].extent; }
    double area(Id id) const;
    std::size_t bytes() const;

    /// Cuts a patch; its value is then that of the parts. @return whether it could be cut.
    bool divide(Id id);

    /// A point of the patch, uniform over its area for uniform @a square and @a choice ∈ [0, 1);
    /// without albedo and emission.
    SurfacePoint sample(Id id, const Vec2f& square, float choice) const;
    /// Which quarter of the patch a place lies in, 0 … 3, by two of the coordinates.
    int quarterOf(Id id, const Vec3f& position) const;
    /// The same for the same part of the same surface, whatever else was divided.
    std::uint64_t key(Id id) const;

private:
    /// Elements are triangle sides: 2 · triangle + (behind ? 1 : 0).
    struct Patch {
        std::uint32_t first, count; ///< into mMembers
        float u, v, scale; ///< corner and (signed) size of a part of a triangle; scale 0: group
        float extent;
        Vec3f middle; ///< of its box
        std::uint8_t axis[2]; ///< the box's two longest sides
    };

    /// Descends one level: rewrites (u, v) to those of the part they lie in.
    static std::uint32_t quarter(float& u, float& v)
    {
        u *= 2;
        v *= 2;
        if (u >= 1) return u -= 1, 1;
        if (v >= 1) return v -= 1, 2;
        if (u + v <= 1) return 0;
        u = 1 - u;
        v = 1 - v;
        return 3;
    }
    void group(double size, std::size_t most);
    void layOut(const std::vector<std::uint32_t>& groupOf, std::size_t groups);
    void addPatch(std::uint32_t first, std::uint32_t count, float u, float v, float scale);
    void measure(Patch& patch) const;
    void sumAreas(std::uint32_t first, std::uint32_t count);
    bool halve(Id id);

    const Tracer::Impl& mImpl;
    std::size_t mJoined = 0;
    std::vector<Patch> mPatches;
    std::vector<Id> mChild; ///< first of the parts, 0: undivided
    std::vector<Id> mRoot; ///< by element
    std::vector<std::uint32_t> mMembers; ///< elements, those of a patch together
    std::vector<double>
        mAreaBefore; ///< by member: the areas of those before it; one more at the end
};

} // namespace lumivdb
