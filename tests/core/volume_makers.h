// SPDX-License-Identifier: Apache-2.0
#pragma once

// Volumes with known topology and values, and a slow, independent look-up to compare with.

#include <lumivdb/core/random.h>
#include <lumivdb/core/volume.h>

#include <algorithm>
#include <cmath>
#include <vector>

namespace volume_test {

using lumivdb::Cell;
using lumivdb::Color;
using lumivdb::Coord;
using lumivdb::GradientStorage;
using lumivdb::IrradianceVolume;
using lumivdb::Mat4d;
using lumivdb::SampleId;
using lumivdb::Vec3d;
using lumivdb::VolumeBuilder;

inline IrradianceVolume uniformVolume(int bands, GradientStorage gradients, const Coord& lower,
    const Coord& upper, const Mat4d& indexToWorld = Mat4d())
{
    VolumeBuilder builder(bands, gradients, indexToWorld);
    builder.addUniform(lower, upper);
    return builder.build();
}

struct BoxCell {
    Coord origin;
    int level;
};

/// Distance in the maximum norm from a cell to a point.
inline int boxDistance(const BoxCell& c, const Coord& p)
{
    int distance = 0;
    for (int a = 0; a < 3; ++a) {
        distance = std::max({distance, c.origin[a] - p[a], p[a] - (c.origin[a] + (1 << c.level))});
    }
    return distance;
}

/// Splits cells nearer to @a focus than 1.5 times their size. That is 2:1 balanced: beside a cell
/// of size s that stays, distance ≥ 1.5 s, a neighbour of size s/2 has a distance of at least
/// s, above 1.5 · s/2, and stays whole too.
inline void refineTowards(const Coord& focus, const BoxCell& c, std::vector<BoxCell>& cells)
{
    const int size = 1 << c.level;
    if (c.level == 0 || 2 * boxDistance(c, focus) >= 3 * size) {
        cells.push_back(c);
        return;
    }
    const int half = size / 2;
    for (int i = 0; i < 8; ++i) {
        const Coord step((i & 1) * half, (i >> 1 & 1) * half, (i >> 2 & 1) * half);
        refineTowards(focus, {c.origin + step, c.level - 1}, cells);
    }
}

/// Levels 0 to 7 around a focus at negative coordinates, with gaps: 6³ roots of 128 steps, of which
/// every fifth far from the middle is left out.
inline std::vector<BoxCell> multiLevelCells()
{
    std::vector<BoxCell> cells;
    for (int x = -3; x < 3; ++x)
        for (int y = -3; y < 3; ++y)
            for (int z = -3; z < 3; ++z) {
                const bool outer = std::min({x, y, z}) == -3 || std::max({x, y, z}) == 2;
                if (outer && (x + 2 * y + 3 * z + 30) % 5 == 0) continue;
                refineTowards(Coord(-37, 5, 20), {Coord(x, y, z) * 128, 7}, cells);
            }
    return cells;
}

inline IrradianceVolume volumeOf(const std::vector<BoxCell>& cells, int bands = 2,
    GradientStorage gradients = GradientStorage::None, const Mat4d& indexToWorld = Mat4d())
{
    VolumeBuilder builder(bands, gradients, indexToWorld);
    for (const BoxCell& c : cells) builder.addCell(c.origin, c.level);
    return builder.build();
}

/// The cell that covers voxel @a p, found by trying them all; null where there is none.
inline const BoxCell* searchCell(const std::vector<BoxCell>& cells, const Coord& p)
{
    for (const BoxCell& c : cells) {
        bool inside = true;
        for (int a = 0; a < 3; ++a) {
            inside = inside && p[a] >= c.origin[a] && p[a] - c.origin[a] < 1 << c.level;
        }
        if (inside) return &c;
    }
    return nullptr;
}

/// Coefficient @a i of a field that is linear in world space, with a different slope for every
/// coefficient and channel.
struct LinearField {
    Vec3d origin{0, 0, 0}; ///< keeps values small where the volume lies far away
    double scale = 1; ///< slope

    Vec3d slope(int i, int channel) const
    {
        return Vec3d(1 + i, 2 - 0.5 * i, -1.5 + channel) * scale;
    }
    double value(const Vec3d& p, int i, int channel) const
    {
        return 3 + i - channel + slope(i, channel).dot(p - origin);
    }
};

inline void fill(IrradianceVolume& volume, const LinearField& field)
{
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        for (int i = 0; i < volume.coefficients(); ++i) {
            for (int c = 0; c < 3; ++c) {
                volume.radiance(s)[i][c]
                    = static_cast<float>(field.value(volume.sampleWorld(s), i, c));
                if (!volume.hasGradients()) continue;
                for (int a = 0; a < 3; ++a) {
                    volume.gradient(s)[a * volume.coefficients() + i][c]
                        = static_cast<float>(field.slope(i, c)[a]);
                }
            }
        }
    }
}

/// Different values in every coefficient of every sample, in [0, 1).
inline void fillRandom(IrradianceVolume& volume, std::uint64_t seed)
{
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        const Coord& p = volume.samplePosition(s);
        lumivdb::CounterRng rng(lumivdb::hashPoint(seed, p.x, p.y, p.z));
        const int n = volume.coefficients() * (volume.hasGradients() ? 4 : 1);
        for (int i = 0; i < n; ++i) {
            volume.radiance(s)[i] = Color(rng.next(), rng.next(), rng.next());
        }
    }
}

inline bool isNan(const Color& c) { return std::isnan(c.x) && std::isnan(c.y) && std::isnan(c.z); }

} // namespace volume_test
