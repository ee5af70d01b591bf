// SPDX-License-Identifier: Apache-2.0
#include "surface_patches.h"

#include <lumivdb/core/random.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <tuple>

namespace lumivdb {

namespace {

/// Members of a group look the same way: cosine of their normal with the first member's.
constexpr float kGroupCosine = 0.9f;
/// First cells that groups which do not hang together are joined in, in sizes of a patch.
constexpr double kFinestCell = 1 / 32.0;

Corners cornersOf(const Tracer::Impl& impl, std::uint32_t element)
{
    return impl.corners(element / 2);
}

float longestSide(const Corners& c)
{
    return std::sqrt(
        std::max({(c.b - c.a).length2(), (c.c - c.b).length2(), (c.a - c.c).length2()}));
}

struct Bounds {
    Vec3f low{std::numeric_limits<float>::max()}, high{std::numeric_limits<float>::lowest()};
    void add(const Vec3f& p)
    {
        for (int i = 0; i < 3; ++i) {
            low[i] = std::min(low[i], p[i]);
            high[i] = std::max(high[i], p[i]);
        }
    }
    void add(const Corners& c)
    {
        add(c.a);
        add(c.b);
        add(c.c);
    }
    float size() const { return (high - low).length(); }
};

/// For every vertex a number that those at the same place share: files split vertices at the seams
/// of their textures, and between materials.
std::vector<std::uint32_t> places(const std::vector<Vec3f>& vertices)
{
    std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(vertices.size());
    for (std::uint32_t i = 0; i < vertices.size(); ++i) {
        std::uint32_t bits[3];
        const Vec3f v = vertices[i] + Vec3f(0.0f); // −0 and 0 are one place
        std::memcpy(bits, &v.x, sizeof bits);
        keys[i] = {hashCombine(hashCombine(bits[0], bits[1]), bits[2]), i};
    }
    std::sort(keys.begin(), keys.end());
    std::vector<std::uint32_t> place(vertices.size());
    for (std::size_t i = 0; i < keys.size(); ++i) {
        const bool same = i > 0 && keys[i].first == keys[i - 1].first;
        place[keys[i].second] = same ? place[keys[i - 1].second] : keys[i].second;
    }
    return place;
}

/// A group as it grows.
struct Growing {
    Bounds bounds;
    Vec3f normal;
    const Tracer::Impl::Instance* instance;
    bool behind;
};

/// The same number for groups that lie in the same cell and face the same octant from the same side
/// of their triangles; one of its own (@a index) for a group larger than a cell.
std::uint64_t cellOf(const Growing& g, std::uint64_t index, float cell)
{
    if (!(g.bounds.size() <= cell)) return mixBits(~index);
    std::uint64_t key = g.behind ? 1 : 0;
    const Vec3f middle = (g.bounds.low + g.bounds.high) * 0.5f;
    for (int a = 0; a < 3; ++a) {
        const auto place = static_cast<std::int64_t>(std::floor(middle[a] / cell));
        key = hashCombine(key, static_cast<std::uint64_t>(place));
        key = hashCombine(key, (g.behind ? -g.normal[a] : g.normal[a]) < 0 ? 1 : 0);
    }
    return key;
}

/// For each group the number of the one it joins, in the order of their first; and how many remain.
std::pair<std::vector<std::uint32_t>, std::size_t> joinByCell(
    const std::vector<Growing>& groups, float cell)
{
    std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(groups.size());
    for (std::uint32_t g = 0; g < groups.size(); ++g) keys[g] = {cellOf(groups[g], g, cell), g};
    std::sort(keys.begin(), keys.end());
    std::vector<std::uint32_t> joined(groups.size());
    for (std::size_t i = 0; i < keys.size(); ++i) {
        const bool same = i > 0 && keys[i].first == keys[i - 1].first;
        joined[keys[i].second] = same ? joined[keys[i - 1].second] : keys[i].second;
    }
    std::uint32_t count = 0;
    for (std::uint32_t g = 0; g < joined.size(); ++g) {
        joined[g] = joined[g] == g ? count++ : joined[joined[g]];
    }
    return {std::move(joined), count};
}

} // namespace

SurfacePatches::SurfacePatches(const Tracer::Impl& impl, double size, std::size_t most)
    : mImpl(impl)
{
    mRoot.assign(2 * static_cast<std::size_t>(impl.triangleCount), kNone);
    group(size, most);
    // Index 0 means "undivided", and no part ever has it: parts come after their whole.
    for (Id id = 0; id < mChild.size(); ++id) {
        if (mPatches[id].count == 1 && extent(id) > 3 * size) divide(id);
    }
}

/// Joins each small triangle to a group that holds one of its vertices, faces the same way and
/// stays small enough: one pass in the order of the file, in which neighbours follow each other.
/// Where that leaves more than @a most, those that are smaller than a cell and share one are
/// joined, in cells no larger than they must be.
void SurfacePatches::group(double size, std::size_t most)
{
    std::vector<Growing> groups;
    std::vector<std::uint32_t> groupOf(mRoot.size(), kNone);
    const std::vector<std::uint32_t> place = places(mImpl.vertices);
    std::array<std::vector<std::uint32_t>, 2> last; // group that holds a vertex, by side
    for (auto& l : last) l.assign(mImpl.vertices.size(), kNone);
    for (std::uint32_t element = 0; element < mRoot.size(); ++element) {
        const Tracer::Impl::Instance* instance = mImpl.instanceOf(element / 2);
        const auto& triangle = mImpl.stored(element / 2, instance);
        const bool behind = element % 2 != 0;
        if (behind && !mImpl.materialOf(triangle).doubleSided) continue;
        const Corners c = cornersOf(mImpl, element);
        if (!(c.areaVector().length() > 0)) continue;
        const Vec3f normal = c.areaVector().normalized();
        std::uint32_t chosen = kNone;
        const bool small = longestSide(c) <= size;
        for (int k = 0; k < 3 && small && chosen == kNone; ++k) {
            const std::uint32_t g = last[behind][place[triangle.vertex[k]]];
            if (g == kNone || groups[g].instance != instance) continue;
            if (groups[g].normal.dot(normal) < kGroupCosine) continue;
            Bounds joined = groups[g].bounds;
            joined.add(c);
            if (joined.size() <= size) chosen = g;
        }
        if (chosen == kNone) {
            chosen = static_cast<std::uint32_t>(groups.size());
            groups.push_back({{}, normal, instance, behind});
        }
        groups[chosen].bounds.add(c);
        groupOf[element] = chosen;
        for (int k = 0; k < 3 && small; ++k) last[behind][place[triangle.vertex[k]]] = chosen;
    }
    std::size_t count = groups.size();
    std::vector<std::uint32_t> joined;
    for (double cell = kFinestCell * size; count > most && cell <= size; cell *= 2) {
        std::tie(joined, count) = joinByCell(groups, static_cast<float>(cell));
    }
    for (std::uint32_t& g : groupOf) {
        if (g != kNone && !joined.empty()) g = joined[g];
    }
    mJoined = groups.size() - count;
    layOut(groupOf, count);
}

/// Makes a patch of each group.
void SurfacePatches::layOut(const std::vector<std::uint32_t>& groupOf, std::size_t groups)
{
    std::vector<std::uint32_t> start(groups + 1, 0);
    for (const std::uint32_t g : groupOf) {
        if (g != kNone) ++start[g + 1];
    }
    std::partial_sum(start.begin(), start.end(), start.begin());
    mMembers.resize(start.back());
    mAreaBefore.assign(mMembers.size() + 1, 0.0);
    std::vector<std::uint32_t> next(start.begin(), start.end() - 1);
    for (std::uint32_t element = 0; element < mRoot.size(); ++element) {
        if (groupOf[element] != kNone) mMembers[next[groupOf[element]]++] = element;
    }
    sumAreas(0, start.back());
    for (std::size_t g = 0; g < groups; ++g) {
        const std::uint32_t count = start[g + 1] - start[g];
        addPatch(start[g], count, 0, 0, count == 1 ? 1.0f : 0.0f);
    }
}

void SurfacePatches::sumAreas(std::uint32_t first, std::uint32_t count)
{
    for (std::uint32_t i = first; i < first + count; ++i) {
        mAreaBefore[i + 1] = mAreaBefore[i]
            + static_cast<double>(cornersOf(mImpl, mMembers[i]).areaVector().length() / 2);
    }
}

void SurfacePatches::addPatch(
    std::uint32_t first, std::uint32_t count, float u, float v, float scale)
{
    const auto id = static_cast<Id>(mPatches.size());
    Patch patch{first, count, u, v, scale, 0, Vec3f(0.0f), {0, 0}};
    measure(patch);
    mPatches.push_back(patch);
    mChild.push_back(0);
    if (std::abs(scale) == 1 || scale == 0) {
        for (std::uint32_t i = first; i < first + count; ++i) mRoot[mMembers[i]] = id;
    }
}

void SurfacePatches::measure(Patch& patch) const
{
    Bounds bounds;
    if (patch.scale == 0) {
        for (std::uint32_t i = 0; i < patch.count; ++i) {
            bounds.add(cornersOf(mImpl, mMembers[patch.first + i]));
        }
        patch.extent = bounds.size();
    } else {
        Corners c = cornersOf(mImpl, mMembers[patch.first]);
        const Vec3f ab = c.b - c.a, ac = c.c - c.a;
        c.a += ab * patch.u + ac * patch.v;
        c.b = c.a + ab * patch.scale;
        c.c = c.a + ac * patch.scale;
        bounds.add(c);
        patch.extent = longestSide(c);
    }
    patch.middle = (bounds.low + bounds.high) * 0.5f;
    const Vec3f side = bounds.high - bounds.low;
    std::array<std::uint8_t, 3> order{0, 1, 2};
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return side[a] > side[b]; });
    patch.axis[0] = order[0];
    patch.axis[1] = order[1];
}

double SurfacePatches::area(Id id) const
{
    const Patch& p = mPatches[id];
    const double whole = mAreaBefore[p.first + p.count] - mAreaBefore[p.first];
    return p.scale == 0 ? whole : whole * p.scale * p.scale;
}

std::size_t SurfacePatches::bytes() const
{
    return mPatches.size() * (sizeof(Patch) + sizeof(Id)) + mRoot.size() * sizeof(Id)
        + mMembers.size() * (sizeof(std::uint32_t) + sizeof(double));
}

bool SurfacePatches::divide(Id id)
{
    const Patch p = mPatches[id];
    if (p.scale == 0) return halve(id);
    if (std::abs(p.scale) < 0x1p-20f) return false;
    mChild[id] = static_cast<Id>(mPatches.size());
    const float h = p.scale / 2;
    addPatch(p.first, 1, p.u, p.v, h);
    addPatch(p.first, 1, p.u + h, p.v, h);
    addPatch(p.first, 1, p.u, p.v + h, h);
    addPatch(p.first, 1, p.u + h, p.v + h, -h);
    return true;
}

/// Cuts a group at its middle, by its members' centres; a half takes the whole's number.
bool SurfacePatches::halve(Id id)
{
    const Patch p = mPatches[id];
    const auto begin = mMembers.begin() + p.first, end = begin + p.count;
    const int axis = p.axis[0];
    const auto below = [&](std::uint32_t element) {
        const Corners c = cornersOf(mImpl, element);
        return (c.a[axis] + c.b[axis] + c.c[axis]) / 3 < p.middle[axis];
    };
    auto half = static_cast<std::uint32_t>(std::stable_partition(begin, end, below) - begin);
    if (half == 0 || half == p.count) half = p.count / 2;
    const double total = mAreaBefore[p.first + p.count];
    sumAreas(p.first, p.count);
    mAreaBefore[p.first + p.count] = total; // so that rounding stays inside the patch
    mPatches[id].count = half;
    mPatches[id].scale = half == 1 ? 1.0f : 0.0f;
    measure(mPatches[id]);
    addPatch(p.first + half, p.count - half, 0, 0, p.count - half == 1 ? 1.0f : 0.0f);
    return true;
}

SurfacePoint SurfacePatches::sample(Id id, const Vec2f& square, float choice) const
{
    const Patch& p = mPatches[id];
    std::uint32_t member = p.first;
    if (p.scale == 0) {
        const double low = mAreaBefore[p.first], high = mAreaBefore[p.first + p.count];
        const auto begin = mAreaBefore.begin() + p.first + 1;
        const auto it = std::upper_bound(begin, begin + p.count - 1, low + choice * (high - low));
        member += static_cast<std::uint32_t>(it - begin);
    }
    // Uniform over a triangle (Heitz 2019), then over the part.
    const Vec2f place = squareToTriangle({square.x, square.y});
    const float scale = p.scale == 0 ? 1.0f : p.scale;
    const float u = p.u + scale * place.x, v = p.v + scale * place.y;
    const std::uint32_t element = mMembers[member];
    const Vec3f normal = cornersOf(mImpl, element).areaVector();
    return mImpl.placeAt(element / 2, u, v, element % 2 != 0 ? normal : -normal);
}

int SurfacePatches::quarterOf(Id id, const Vec3f& position) const
{
    const Patch& p = mPatches[id];
    return (position[p.axis[0]] >= p.middle[p.axis[0]] ? 1 : 0)
        + (position[p.axis[1]] >= p.middle[p.axis[1]] ? 2 : 0);
}

std::uint64_t SurfacePatches::key(Id id) const
{
    const Patch& p = mPatches[id];
    std::uint32_t bits[3];
    const float place[3] = {p.u, p.v, p.scale};
    std::memcpy(bits, place, sizeof bits);
    std::uint64_t h = hashCombine(mMembers[p.first], p.count);
    for (const std::uint32_t b : bits) h = hashCombine(h, b);
    return h;
}

} // namespace lumivdb
