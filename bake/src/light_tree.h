// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file light_tree.h
/// Many lights as a binary tree, to draw one of them by about what it gives to a place.
///
/// After Conty Estevez & Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting",
/// HPG 2018: a node bounds where its lights are (a sphere), and by a cone the ways they shine. From
/// these follows about what arrives at a receiver, the light's falloff and the receiver's cosine
/// bounded from above. A descent takes the two children's shares as chances, so it costs O(log n).
/// One number t is used for all of it, the lights being in an order that keeps neighbours together:
/// stratified t give stratified lights. Local space (see tracer_impl.h), or any other.

#include <lumivdb/core/types.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace lumivdb {

/// Where light arrives.
struct Receiver {
    Vec3f position{0, 0, 0};
    Vec3f normal{0, 0, 0}; ///< unit: what is behind does not count; 0: light from all sides does
    bool oneSided() const { return normal != Vec3f(0.0f); }
};

/// What the tree knows of a light or of several: intensity falls off as the cosine of the angle to
/// the nearest of the ways within `spread` of the axis, and is 0 beyond `reach` of it.
struct LightBound {
    Vec3f lower{0, 0, 0}, upper{0, 0, 0}; ///< where; not used where infinite
    Vec3f axis{0, 0, 1}; ///< unit, the way the light goes
    float spread = 0; ///< radians, 0 … π; π: all ways
    float reach = 1.57079633f; ///< radians, 0 … π/2
    bool twoSided = false; ///< shines along −axis too
    bool infinite = false; ///< from infinitely far away
    float range = std::numeric_limits<float>::infinity(); ///< nothing arrives from further away
    double intensity = 0; ///< luminance at its strongest: cd, or where infinite lux; ≥ 0

    /// Bounds of both. Either both are infinite or none is.
    LightBound united(const LightBound& o) const;
};

/// Const and thread-safe once built. The same lights give the same tree.
class LightTree {
public:
    LightTree() = default;
    explicit LightTree(const std::vector<LightBound>& lights);

    bool empty() const { return mNodes.empty(); }

    struct Choice {
        std::uint32_t light = 0; ///< index into the lights given
        double probability = 0; ///< 0: none, no light arrives at the receiver
    };
    /// Draws a light from @a t ∈ [0,1), which becomes the place in what that light owns of [0,1).
    Choice choose(const Receiver& receiver, double& t) const;
    /// Chance of choose() to draw @a light, 0 where none of it arrives. The very same bits.
    double probability(const Receiver& receiver, std::uint32_t light) const;

private:
    /// One cache line; siblings are neighbours, so that a level of a descent is one place.
    struct alignas(64) Node {
        Vec3f center; ///< of the bounding sphere
        float radius;
        Vec3f axis;
        float cosSpread, sinSpread, cosReach;
        float range;
        float intensity;
        std::uint32_t next; ///< leaf: the light; else the left child, the right one being behind it
        bool leaf, twoSided, infinite;
    };
    class Builder;
    static Node nodeOf(const LightBound& bound);
    static double importance(const Node& node, const Receiver& receiver);
    double rootChance(const Receiver& receiver) const;
    double leftChance(std::uint32_t node, const Receiver& receiver) const;

    std::vector<Node> mNodes; // the root first, then pairs of siblings, depth first
    std::vector<std::uint64_t> mTrail; // per light: right turns on the way to it, from bit 0 on
};

} // namespace lumivdb
