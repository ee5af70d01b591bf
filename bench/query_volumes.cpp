// SPDX-License-Identifier: Apache-2.0
#include "query_contenders.h"

#include <lumivdb/core/random.h>
#include <lumivdb/core/sh.h>

#include <cmath>

namespace query_bench {

namespace {

constexpr int kBands = 3;
constexpr double kSpacing = 0.25;
constexpr int kRootLevel = 4;
constexpr int kRoots = 8;
constexpr double kRadius = 40; // lattice steps

/// A smooth light field with some noise, brighter towards a corner, and its derivative along world
/// axis @a axis (−1: the value).
float field(const Vec3d& p, int i, int channel, int axis)
{
    const Vec3d k(0.31 + 0.02 * i, 0.23 - 0.01 * channel, 0.17 + 0.03 * channel);
    const double phase = k.dot(p) + i + 2 * channel, size = i == 0 ? 2.0 : 0.6 / (1 + i / 4);
    const double value = size * (1.5 * (i == 0) + std::sin(phase));
    return static_cast<float>(axis < 0 ? value : size * k[axis] * std::cos(phase));
}

void fill(IrradianceVolume& volume)
{
    const int n = volume.coefficients();
    for (SampleId s = 0; s < volume.sampleCount(); ++s)
        for (int i = 0; i < n; ++i)
            for (int c = 0; c < 3; ++c) {
                volume.radiance(s)[i][c] = field(volume.sampleWorld(s), i, c, -1);
                if (!volume.hasGradients()) continue;
                for (int a = 0; a < 3; ++a)
                    volume.gradient(s)[a * n + i][c] = field(volume.sampleWorld(s), i, c, a);
            }
}

Vec3d sphereCentre() { return Vec3d(kRoots << (kRootLevel - 1)); }

double fromSphere(const Vec3d& p) { return (p - sphereCentre()).length() - kRadius; }

void refine(VolumeBuilder& builder, const Coord& origin, int level)
{
    const int size = 1 << level;
    // 2:1 balance: centres of a cell of size s and one of s/2 beside it are at most √3 · ¾ s apart,
    // less than (2.7 − 1.35) s.
    if (level == 0 || std::abs(fromSphere(Vec3d(origin) + Vec3d(0.5 * size))) > 2.7 * size) {
        builder.addCell(origin, level);
        return;
    }
    for (int i = 0; i < 8; ++i)
        refine(builder, origin + Coord(i & 1, i >> 1 & 1, i >> 2) * (size / 2), level - 1);
}

/// Tangent plane of the sphere through the cell; each side sees its own corners.
void addVisibility(IrradianceVolume& volume)
{
    std::vector<std::pair<CellId, CellVisibility>> cut;
    for (CellId id = 0; id < static_cast<CellId>(volume.cellCount()); ++id) {
        const Cell& cell = volume.cell(id);
        const Vec3d centre = Vec3d(cell.origin) + Vec3d(0.5);
        if (cell.level > 0 || std::abs(fromSphere(centre)) > 0.8) continue;
        CellVisibility v;
        const Vec3d normal = (centre - sphereCentre()).normalized();
        v.normal[0] = Vec3f(normal);
        v.offset[0] = static_cast<float>(-fromSphere(centre));
        unsigned outside = 0;
        for (int i = 0; i < 8; ++i) {
            const Vec3d corner(i & 1, i >> 1 & 1, i >> 2);
            if (normal.dot(corner - Vec3d(0.5)) >= -fromSphere(centre)) outside |= 1u << i;
        }
        v.masks = 0;
        for (int r = 0; r < 8; ++r)
            v.masks |= std::uint64_t{r & 1 ? outside : ~outside & 0xff} << (8 * r);
        cut.emplace_back(id, v);
    }
    volume.setVisibility(cut);
}

// ---- Reference. Homogeneous Taylor expansions in double precision: weight, value and slopes per
// lattice step of 27 coefficients.
struct Expansion {
    double weight = 0;
    std::vector<double> value; // 27, or 4 × 27
};

struct Reference {
    const IrradianceVolume& volume;
    bool gradients;
    const Cell& cell;
    unsigned mask;

    Expansion sample(SampleId s) const
    {
        Expansion e;
        e.value.assign(gradients ? 108 : 27, 0.0);
        if (!volume.isValid(s)) return e;
        e.weight = 1;
        for (std::size_t k = 0; k < e.value.size(); ++k) {
            const int block = static_cast<int>(k) / 27, i = static_cast<int>(k) % 27 / 3;
            e.value[k] = block == 0
                ? volume.radiance(s)[i][static_cast<int>(k % 3)]
                : volume.gradient(s)[(block - 1) * 9 + i][static_cast<int>(k % 3)] * kSpacing;
        }
        return e;
    }

    /// Node at @a at / 2 of the cell.
    Expansion node(const Coord& at) const
    {
        unsigned round = 0;
        for (int c = 0; c < 8; ++c) {
            bool touches = true;
            for (int a = 0; a < 3; ++a)
                touches = touches && (at[a] == 1 || at[a] == 2 * (c >> a & 1));
            if (touches) round |= 1u << c;
        }
        const bool corner = at.x != 1 && at.y != 1 && at.z != 1;
        const int size = 1 << cell.level;
        if (corner && !(mask & round)) {
            Expansion none;
            none.value.assign(gradients ? 108 : 27, 0.0);
            return none;
        }
        if (corner || (cell.level > 0 && (mask & round) == round)) {
            const std::int64_t s = volume.findSample(
                corner ? cell.origin + at / 2 * size : cell.origin + at * (size / 2));
            if (s >= 0) return sample(static_cast<SampleId>(s));
        }
        Expansion mean;
        int count = 0;
        for (int a = 0; a < 3; ++a) {
            if (at[a] != 1) continue;
            for (int end = 0; end <= 2; end += 2) {
                Coord q = at;
                q[a] = end;
                Expansion e = node(q);
                if (gradients)
                    for (std::size_t k = 0; k < 27; ++k)
                        e.value[k] += e.value[27 * (static_cast<std::size_t>(a) + 1) + k]
                            * (1 - end) * 0.25 * size; // half of half a cell
                mean.weight += e.weight;
                mean.value.resize(e.value.size());
                for (std::size_t k = 0; k < e.value.size(); ++k) mean.value[k] += e.value[k];
                ++count;
            }
        }
        mean.weight /= count;
        for (double& v : mean.value) v /= count;
        return mean;
    }
};

/// Whether finer cells have a sample in the middle of an edge or a face.
bool touchesFiner(const IrradianceVolume& volume, const Cell& cell)
{
    for (int i = 0; i < 27 && cell.level > 0; ++i) {
        const Coord at(i % 3, i / 3 % 3, i / 9);
        const int middles = (at.x == 1) + (at.y == 1) + (at.z == 1);
        if (middles != 1 && middles != 2) continue;
        if (volume.findSample(cell.origin + at * (1 << (cell.level - 1))) >= 0) return true;
    }
    return false;
}

} // namespace

IrradianceVolume uniformVolume(bool gradients)
{
    VolumeBuilder builder(kBands,
        gradients ? GradientStorage::PerCoefficient : GradientStorage::None,
        latticeTransform(kSpacing));
    builder.addUniform({0, 0, 0}, {63, 63, 63});
    IrradianceVolume volume = builder.build();
    fill(volume);
    return volume;
}

IrradianceVolume adaptiveVolume(bool gradients)
{
    VolumeBuilder builder(kBands,
        gradients ? GradientStorage::PerCoefficient : GradientStorage::None,
        latticeTransform(kSpacing));
    for (int x = 0; x < kRoots; ++x)
        for (int y = 0; y < kRoots; ++y)
            for (int z = 0; z < kRoots; ++z)
                refine(builder, Coord(x, y, z) * (1 << kRootLevel), kRootLevel);
    IrradianceVolume volume = builder.build();
    fill(volume);
    addVisibility(volume);
    CounterRng rng(17);
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        const double d = fromSphere(Vec3d(volume.samplePosition(s)));
        if (std::abs(d) < 2 && rng.next() < 0.1f) volume.validity(s) = 0.2f;
    }
    return volume;
}

Vec3d referenceIrradiance(
    const IrradianceVolume& volume, bool gradients, const Vec3d& p, const Vec3f& n)
{
    const Vec3d q = p / kSpacing;
    const CellId id = volume.findCell(Coord(static_cast<int>(std::floor(q.x)),
        static_cast<int>(std::floor(q.y)), static_cast<int>(std::floor(q.z))));
    const Cell& cell = volume.cell(id);
    const int size = 1 << cell.level;
    Vec3d t = (q - Vec3d(cell.origin)) / size;
    Reference reference{volume, gradients, cell, 0xff};
    unsigned valid = 0;
    for (int i = 0; i < 8; ++i) valid |= volume.isValid(cell.corners[i]) ? 1u << i : 0u;
    if (const CellVisibility* v = volume.visibility(id)) {
        const unsigned seen = v->corners(Vec3f(t));
        if (seen & valid) reference.mask = seen;
    }
    // Cells that touch finer ones are taken in eight parts.
    const bool split = valid != 0 && touchesFiner(volume, cell);
    Coord lower(0, 0, 0);
    for (int a = 0; a < 3 && split; ++a) {
        lower[a] = t[a] >= 0.5;
        t[a] = 2 * t[a] - lower[a];
    }
    double weight[8], seen = 0;
    Vec3d way[8], mean(0.0); // from the corners, in lattice steps; of those that are seen
    for (int i = 0; i < 8; ++i) {
        weight[i] = 1;
        for (int a = 0; a < 3; ++a) {
            const int corner = i >> a & 1;
            weight[i] *= corner ? t[a] : 1 - t[a];
            way[i][a] = (t[a] - corner) * size / (split ? 2 : 1);
        }
        if (!(reference.mask >> i & 1)) continue;
        mean += way[i] * weight[i];
        seen += weight[i];
    }
    mean = reference.mask == 0xff || !(seen > 0) ? Vec3d(0.0) : mean / seen;
    double total = 0;
    std::vector<double> sum(27, 0.0);
    for (int i = 0; i < 8; ++i) {
        const Coord corner(i & 1, i >> 1 & 1, i >> 2);
        const Expansion e = reference.node(split ? lower + corner : corner * 2);
        total += weight[i] * e.weight;
        const Vec3d half = (way[i] + mean) * 0.5; // Interpolation::Gradient
        for (std::size_t k = 0; k < 27; ++k) {
            sum[k] += weight[i] * e.value[k];
            for (std::size_t a = 0; a < 3 && gradients; ++a)
                sum[k] += weight[i] * e.value[27 * (a + 1) + k] * half[static_cast<int>(a)];
        }
    }
    double y[9];
    evalShBasis(3, Vec3d(n), y);
    Vec3d E(0.0);
    for (int i = 0; i < 9; ++i)
        for (int c = 0; c < 3; ++c)
            E[c] += kCosineLobe[static_cast<std::size_t>(degreeOf(i))] * y[i]
                * sum[static_cast<std::size_t>(3 * i + c)] / total;
    return E;
}

} // namespace query_bench
