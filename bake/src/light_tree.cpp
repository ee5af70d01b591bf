// SPDX-License-Identifier: Apache-2.0
#include "light_tree.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

namespace lumivdb {

namespace {

constexpr float kPi = 3.14159265358979323846f;
/// Cosines this much beyond a bound still count, so that rounding makes no light unreachable.
constexpr float kSlack = 1e-4f;
constexpr double kAlmostOne = 0x1.fffffffffffffp-1;
constexpr int kBins = 12;
/// Below this depth nodes are halved by number, so that a trail has at most 64 turns.
constexpr int kHalvingDepth = 32;
/// Between lights near and infinitely far away this much of the choice is even: which of them a
/// wall hides is anyone's guess, and their intensities are often far apart.
constexpr double kEvenShare = 0.5;

/// cos(max(0, a − b)) of two angles in 0 … π.
float cosineOfDifference(float cosA, float sinA, float cosB, float sinB)
{
    return cosA >= cosB ? 1.0f : cosA * cosB + sinA * sinB;
}

float sineOf(float cosine) { return std::sqrt(std::max(0.0f, 1 - cosine * cosine)); }

/// Unit vector turned from unit @a from towards unit @a to by @a angle.
Vec3f turned(const Vec3f& from, const Vec3f& to, float angle)
{
    const Vec3f across = to - from * from.dot(to);
    const float length = across.length();
    if (!(length > 0)) return from;
    return (from * std::cos(angle) + across * (std::sin(angle) / length)).normalized();
}

/// Sets the cone of @a a to hold that of @a b as well.
void uniteCones(LightBound& a, const LightBound& b)
{
    const float reach = std::max(a.reach, b.reach);
    Vec3f axis = b.axis;
    if ((a.twoSided || b.twoSided) && a.axis.dot(axis) < 0) axis = -axis;
    const float apart = std::acos(std::clamp(a.axis.dot(axis), -1.0f, 1.0f));
    if (std::min(apart + b.spread, kPi) > a.spread) {
        if (std::min(apart + a.spread, kPi) <= b.spread) {
            a.axis = axis;
            a.spread = b.spread;
        } else {
            const float spread = 0.5f * (a.spread + apart + b.spread);
            if (spread < kPi) a.axis = turned(a.axis, axis, spread - a.spread);
            a.spread = std::min(spread, kPi);
        }
    }
    a.reach = reach;
    a.twoSided = a.twoSided || b.twoSided;
}

/// Solid angle that the cone shines to, its falloff weighed by the cosine (the paper's M_Ω).
double orientationMeasure(const LightBound& b)
{
    const double o = b.spread, w = std::min<double>(o + b.reach, kPi);
    return 2 * kPi * (1 - std::cos(o))
        + 0.5 * kPi
        * (2 * w * std::sin(o) - std::cos(o - 2 * w) - 2 * o * std::sin(o) + std::cos(o));
}

/// What a node costs: the more light from the larger a place to more directions, the less is known.
/// The square of the diagonal instead of the surface, which is 0 for lights in a row.
double costOf(const LightBound& b)
{
    return b.intensity * orientationMeasure(b) * Vec3d(b.upper - b.lower).length2();
}

Vec3f centerOf(const LightBound& b) { return (b.lower + b.upper) * 0.5f; }

struct Bin {
    LightBound bound;
    std::size_t count = 0;
    void add(const LightBound& light, std::size_t lights = 1)
    {
        if (lights == 0) return;
        bound = count == 0 ? light : bound.united(light);
        count += lights;
    }
};

} // namespace

LightBound LightBound::united(const LightBound& o) const
{
    LightBound b = *this;
    for (int a = 0; a < 3; ++a) {
        b.lower[a] = std::min(lower[a], o.lower[a]);
        b.upper[a] = std::max(upper[a], o.upper[a]);
    }
    uniteCones(b, o);
    b.range = std::max(range, o.range);
    b.intensity = intensity + o.intensity;
    return b;
}

/// Top down; lights stay in the order given where nothing tells them apart.
class LightTree::Builder {
public:
    Builder(const std::vector<LightBound>& lights, LightTree& tree)
        : mLights(lights)
        , mTree(tree)
        , mOrder(lights.size())
    {
        std::iota(mOrder.begin(), mOrder.end(), 0u);
        mTree.mNodes.reserve(2 * lights.size());
        mTree.mNodes.resize(1);
        mTree.mTrail.resize(lights.size());
        const auto infinite = std::stable_partition(
            mOrder.begin(), mOrder.end(), [&](std::uint32_t i) { return !mLights[i].infinite; });
        const auto finite = static_cast<std::size_t>(infinite - mOrder.begin());
        if (finite == 0 || finite == mOrder.size()) {
            build(0, 0, mOrder.size(), 0, 0);
        } else {
            join(0, 0, finite, mOrder.size(), 0, 0);
        }
    }

private:
    using Trail = std::uint64_t;

    /// Fills @a self and what is below it.
    LightBound build(std::size_t self, std::size_t first, std::size_t last, Trail trail, int depth)
    {
        if (last - first > 1) {
            return join(self, first, split(first, last, depth), last, trail, depth);
        }
        const std::uint32_t light = mOrder[first];
        mTree.mTrail[light] = trail;
        return setNode(self, mLights[light], light, true);
    }

    LightBound join(std::size_t self, std::size_t first, std::size_t middle, std::size_t last,
        Trail trail, int depth)
    {
        const std::size_t left = mTree.mNodes.size();
        mTree.mNodes.resize(left + 2);
        const LightBound a = build(left, first, middle, trail, depth + 1);
        const LightBound b = build(left + 1, middle, last, trail | Trail{1} << depth, depth + 1);
        return setNode(self, a.united(b), static_cast<std::uint32_t>(left), false);
    }

    LightBound setNode(std::size_t self, const LightBound& bound, std::uint32_t next, bool leaf)
    {
        Node node = nodeOf(bound);
        node.next = next;
        node.leaf = leaf;
        mTree.mNodes[self] = node;
        return bound;
    }

    /// Where infinitely far lights are, for splitting: the way they go.
    Vec3f placeOf(std::uint32_t light) const
    {
        const LightBound& b = mLights[light];
        return b.infinite ? b.axis : centerOf(b);
    }

    std::size_t split(std::size_t first, std::size_t last, int depth)
    {
        Vec3f lower = placeOf(mOrder[first]), upper = lower;
        for (std::size_t i = first + 1; i < last; ++i) {
            const Vec3f p = placeOf(mOrder[i]);
            for (int a = 0; a < 3; ++a) {
                lower[a] = std::min(lower[a], p[a]);
                upper[a] = std::max(upper[a], p[a]);
            }
        }
        const Vec3f extent = upper - lower;
        const float longest = std::max({extent.x, extent.y, extent.z});
        const std::size_t half = first + (last - first) / 2;
        if (depth >= kHalvingDepth || !(longest > 0) || !std::isfinite(longest)) return half;

        int bestAxis = -1, bestBin = 0;
        double best = std::numeric_limits<double>::infinity();
        for (int a = 0; a < 3; ++a) {
            if (!(extent[a] > 0)) continue;
            int bin = 0;
            // Long thin nodes are to be split across.
            const double cost
                = cheapestBin(first, last, a, lower[a], extent[a], bin) * (longest / extent[a]);
            if (cost < best) {
                best = cost;
                bestAxis = a;
                bestBin = bin;
            }
        }
        if (bestAxis < 0) return half;
        const auto middle
            = std::stable_partition(mOrder.begin() + static_cast<std::ptrdiff_t>(first),
                mOrder.begin() + static_cast<std::ptrdiff_t>(last), [&](std::uint32_t i) {
                    return binOf(i, bestAxis, lower[bestAxis], extent[bestAxis]) <= bestBin;
                });
        return static_cast<std::size_t>(middle - mOrder.begin());
    }

    int binOf(std::uint32_t light, int axis, float lower, float extent) const
    {
        const float x = (placeOf(light)[axis] - lower) / extent * kBins;
        return std::clamp(static_cast<int>(x), 0, kBins - 1);
    }

    /// Least sum of costs of both sides; @a bin becomes the last one on the left.
    double cheapestBin(
        std::size_t first, std::size_t last, int axis, float lower, float extent, int& bin) const
    {
        std::array<Bin, kBins> bins;
        for (std::size_t i = first; i < last; ++i) {
            bins[static_cast<std::size_t>(binOf(mOrder[i], axis, lower, extent))].add(
                mLights[mOrder[i]]);
        }
        std::array<double, kBins> right{}; // cost of the bins from here on
        Bin sum;
        for (std::size_t b = kBins; b-- > 1;) {
            sum.add(bins[b].bound, bins[b].count);
            right[b] = sum.count > 0 ? costOf(sum.bound) : 0.0;
        }
        double best = std::numeric_limits<double>::infinity();
        sum = Bin();
        for (std::size_t b = 0; b + 1 < kBins; ++b) {
            sum.add(bins[b].bound, bins[b].count);
            if (sum.count == 0 || sum.count == last - first) continue;
            const double cost = costOf(sum.bound) + right[b + 1];
            if (cost < best) {
                best = cost;
                bin = static_cast<int>(b);
            }
        }
        return best;
    }

    const std::vector<LightBound>& mLights;
    LightTree& mTree;
    std::vector<std::uint32_t> mOrder;
};

LightTree::LightTree(const std::vector<LightBound>& lights)
{
    if (!lights.empty()) Builder(lights, *this);
}

LightTree::Node LightTree::nodeOf(const LightBound& b)
{
    Node n{};
    n.center = centerOf(b);
    n.radius = 0.5f * (b.upper - b.lower).length();
    n.axis = b.axis;
    n.cosSpread = std::cos(b.spread);
    n.sinSpread = b.spread < kPi ? std::sin(b.spread) : 0.0f;
    if (b.spread >= kPi) n.cosSpread = -1;
    n.cosReach = std::max(0.0f, std::cos(b.reach));
    n.range = b.range;
    n.intensity = static_cast<float>(b.intensity);
    n.twoSided = b.twoSided;
    n.infinite = b.infinite;
    return n;
}

double LightTree::importance(const Node& node, const Receiver& receiver)
{
    if (!(node.intensity > 0)) return 0;
    Vec3f towards = -node.axis; // unit, to the middle of the lights
    float cosSize = node.cosSpread, sinSize = node.sinSpread; // angular radius of the lights
    float cosine = 1; // of the angle to the nearest way they may shine
    double distance2 = 1;
    if (!node.infinite) {
        const Vec3f d = node.center - receiver.position;
        const float length2 = d.length2(), radius2 = node.radius * node.radius;
        if (!(length2 > 0) && !(radius2 > 0)) return 0; // on the light there is no direction
        distance2 = std::max(length2, radius2);
        const float length = std::sqrt(length2);
        if (length - node.radius > node.range * (1 + kSlack)) return 0;
        if (length2 > radius2) {
            towards = d / length;
            sinSize = node.radius / length;
            cosSize = std::sqrt(1 - sinSize * sinSize);
            float cosAxis = -node.axis.dot(towards);
            if (node.twoSided) cosAxis = std::abs(cosAxis);
            const float c
                = cosineOfDifference(cosAxis, sineOf(cosAxis), node.cosSpread, node.sinSpread);
            cosine = cosineOfDifference(c, sineOf(c), cosSize, sinSize);
            if (cosine < node.cosReach - kSlack) return 0;
        } else {
            cosSize = -1; // from within, light may come from everywhere
            sinSize = 0;
        }
    }
    double arriving = node.intensity / distance2 * std::max(cosine, kSlack);
    if (receiver.oneSided()) {
        const float c = receiver.normal.dot(towards);
        const float facing = cosineOfDifference(c, sineOf(c), cosSize, sinSize);
        if (facing < -kSlack) return 0;
        arriving *= std::max(facing, kSlack);
    }
    return arriving;
}

/// A lone light has no sibling to compare it with.
double LightTree::rootChance(const Receiver& receiver) const
{
    return !mNodes[0].leaf || importance(mNodes[0], receiver) > 0 ? 1 : 0;
}

/// Chance of the left child; below 0 where nothing arrives from either.
double LightTree::leftChance(std::uint32_t node, const Receiver& receiver) const
{
    const Node &left = mNodes[mNodes[node].next], &right = mNodes[mNodes[node].next + 1];
    const double l = importance(left, receiver), r = importance(right, receiver);
    if (!(l + r > 0)) return -1;
    const double share = l / (l + r);
    if (left.infinite == right.infinite || !(l > 0) || !(r > 0)) return share;
    return kEvenShare * 0.5 + (1 - kEvenShare) * share;
}

LightTree::Choice LightTree::choose(const Receiver& receiver, double& t) const
{
    std::uint32_t node = 0;
    double probability = rootChance(receiver);
    while (probability > 0 && !mNodes[node].leaf) {
        const double left = leftChance(node, receiver);
        if (left < 0) return {};
        if (t < left) {
            t /= left;
            probability *= left;
            node = mNodes[node].next;
        } else {
            t = (t - left) / (1 - left);
            probability *= 1 - left;
            node = mNodes[node].next + 1;
        }
        t = std::min(t, kAlmostOne);
    }
    return {mNodes[node].next, probability};
}

double LightTree::probability(const Receiver& receiver, std::uint32_t light) const
{
    std::uint32_t node = 0;
    double probability = rootChance(receiver);
    for (std::uint64_t trail = mTrail[light]; probability > 0 && !mNodes[node].leaf; trail >>= 1) {
        const double left = leftChance(node, receiver);
        if (left < 0) return 0;
        const bool toRight = (trail & 1) != 0;
        probability *= toRight ? 1 - left : left;
        node = mNodes[node].next + (toRight ? 1 : 0);
    }
    return probability;
}

} // namespace lumivdb
