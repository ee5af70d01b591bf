// SPDX-License-Identifier: Apache-2.0
/// Continuity of a real volume: straight walks of a million steps in all, and where a step changes
/// irradiance, the step halved again and again: what is left of the change when the two points are
/// neighbours is a jump. lumivdb_bench_walks VOLUME.vdb [steps]
///
/// For each mode: the largest jump where no wall is (cells that geometry does not cut), by what
/// lies between, and the largest inside cells that it cuts, where planes divide what is seen and
/// jumps are meant. Places inside solids do not count. Beside them plain trilinear interpolation of
/// each cell's own corners, which pops at changes of level. Jumps are shares of the volume's mean
/// irradiance over the walks.

#include <lumivdb/bake/probe.h>
#include <lumivdb/bake/tracer.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/core/sampler.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <limits>
#include <memory>
#include <vector>

using namespace lumivdb;

namespace {

constexpr std::size_t kSteps = 1000000;
constexpr std::size_t kWalks = 2000;
/// A jump in a cut cell is at a wall where a surface is this near, in cells.
constexpr double kAtWall = 0.05;
/// Only changes that could hide a jump this large, as a share of the mean, are looked into.
constexpr double kLeast = 1e-4;

using Light = std::function<Color(const Vec3d&, const Vec3f&)>;

float largest(const Color& c) { return std::max({std::abs(c.x), std::abs(c.y), std::abs(c.z)}); }

Coord voxelAt(const IrradianceVolume& v, const Vec3d& p)
{
    const Vec3d q = p * v.worldToIndex();
    return {static_cast<int>(std::floor(q.x)), static_cast<int>(std::floor(q.y)),
        static_cast<int>(std::floor(q.z))};
}

/// Each cell's corners alone: what a volume without ghosts would answer.
Color plainTrilinear(const IrradianceVolume& v, const Vec3d& p, const Vec3f& n)
{
    const CellId id = v.findCell(voxelAt(v, p));
    if (id == kNoCell) return Color(std::numeric_limits<float>::quiet_NaN());
    const Cell& cell = v.cell(id);
    const Vec3d t = (p * v.worldToIndex() - Vec3d(cell.origin)) / (1 << cell.level);
    std::vector<Color> L(static_cast<std::size_t>(v.coefficients()), Color(0.0f));
    double weights = 0;
    for (int i = 0; i < 8; ++i) {
        double w = v.isValid(cell.corners[i]) ? 1 : 1e-9; // those alone where there is no other
        for (int a = 0; a < 3; ++a) w *= i >> a & 1 ? t[a] : 1 - t[a];
        weights += w;
        for (int k = 0; k < v.coefficients(); ++k)
            L[static_cast<std::size_t>(k)]
                += v.radiance(cell.corners[i])[k] * static_cast<float>(w);
    }
    for (Color& c : L) c *= static_cast<float>(1 / weights);
    return irradiance(v.bands(), L.data(), n);
}

struct Walk {
    Vec3d from, to;
    Vec3f normal;
};

std::vector<Walk> randomWalks(const IrradianceVolume& v)
{
    const LatticeBox box = v.latticeBounds();
    std::vector<Walk> walks(kWalks);
    for (std::size_t i = 0; i < kWalks; ++i) {
        CounterRng rng(hashCombine(1414, i));
        const auto inside = [&] {
            Vec3d p;
            for (int a = 0; a < 3; ++a)
                p[a] = box.lower[a] + rng.nextDouble() * (box.upper[a] - box.lower[a]);
            return p * v.indexToWorld();
        };
        walks[i].from = inside();
        walks[i].to = inside();
        const float z = 2 * rng.next() - 1, phi = 6.2831853f * rng.next();
        const float r = std::sqrt(std::max(0.0f, 1 - z * z));
        walks[i].normal = Vec3f(r * std::cos(phi), r * std::sin(phi), z);
    }
    return walks;
}

/// Kinds of places, by the cells on both sides of a jump; the last three are cells that geometry
/// cuts, or that have invalid corners, away from any surface.
enum Kind { Inside, SameLevel, LevelChange, AtWall, OffInside, OffSame, OffLevel, kKinds };
constexpr const char* kNames[kKinds] = {"in a cell", "same level", "level change", "wall",
    "cut: in a cell", "cut: same level", "cut: level change"};

/// Cells whose corners are not all valid count as cut: there the volume knows too little.
bool isFree(const IrradianceVolume& v, CellId id)
{
    if (v.visibility(id)) return false;
    const Cell& cell = v.cell(id);
    return std::all_of(cell.corners, cell.corners + 8, [&](SampleId s) { return v.isValid(s); });
}

Kind kindOf(const IrradianceVolume& v, const Tracer& tracer, const Vec3d& a, const Vec3d& b)
{
    const CellId ca = v.findCell(voxelAt(v, a)), cb = v.findCell(voxelAt(v, b));
    if (ca == kNoCell || cb == kNoCell || !isFree(v, ca) || !isFree(v, cb)) {
        const double cell = v.spacing() * (ca == kNoCell ? 1 : 1 << v.cell(ca).level);
        if (tracer.closestSurface(a, kAtWall * cell, nullptr, nullptr)) return AtWall;
        if (ca == cb) return OffInside;
        const bool same = ca != kNoCell && cb != kNoCell && v.cell(ca).level == v.cell(cb).level;
        return same ? OffSame : OffLevel;
    }
    if (ca == cb) return Inside;
    return v.cell(ca).level == v.cell(cb).level ? SameLevel : LevelChange;
}

/// Tells free space from the inside of solids as a bake does.
class FreeSpace {
public:
    explicit FreeSpace(const Tracer& tracer)
        : mEstimator(tracer, options())
    {
    }
    bool contains(const Vec3d& p)
    {
        return mEstimator.radianceSh(p, 1, 1, mWorkspace).validity >= kValidThreshold;
    }

private:
    static ProbeOptions options()
    {
        ProbeOptions o;
        o.rays = 64;
        o.maxBounces = 0;
        return o;
    }
    ProbeEstimator mEstimator;
    ProbeEstimator::Workspace mWorkspace;
};

struct Found {
    double jump[kKinds] = {};
    std::size_t jumps[kKinds] = {}; ///< of a hundredth of the mean and more
    double mean = 0;
    double slope = 0; ///< largest change of a step where there is no jump, per spacing
};

/// What remains of a change between a and b when they are as close as single precision tells apart.
double jumpBetween(const Light& light, Vec3d& a, Vec3d& b, const Vec3f& n, double spacing)
{
    Color ea = light(a, n), eb = light(b, n);
    while ((b - a).length() > 1e-7 * spacing) {
        const Vec3d middle = 0.5 * (a + b);
        const Color em = light(middle, n);
        if (largest(em - ea) >= largest(eb - em)) {
            b = middle;
            eb = em;
        } else {
            a = middle;
            ea = em;
        }
    }
    return largest(eb - ea);
}

Found walkAll(
    const IrradianceVolume& v, const Tracer& tracer, const Light& light, std::size_t steps)
{
    Found found;
    FreeSpace space(tracer);
    const std::size_t perWalk = std::max<std::size_t>(2, steps / kWalks);
    const std::vector<Walk> walks = randomWalks(v);
    for (const Walk& w : walks)
        found.mean += static_cast<double>(largest(light(w.from, w.normal))) / kWalks;
    for (const Walk& w : walks) {
        Vec3d before = w.from;
        Color light0 = light(before, w.normal);
        for (std::size_t k = 1; k <= perWalk; ++k) {
            const Vec3d now = w.from
                + (w.to - w.from) * (static_cast<double>(k) / static_cast<double>(perWalk));
            const Color light1 = light(now, w.normal);
            const double change = largest(light1 - light0);
            if (change > kLeast * found.mean) {
                Vec3d a = before, b = now;
                const double jump = jumpBetween(light, a, b, w.normal, v.spacing());
                if (jump < kLeast * found.mean || space.contains(a)) {
                    const Kind at = kindOf(v, tracer, a, b);
                    found.jump[at] = std::max(found.jump[at], jump / found.mean);
                    found.jumps[at] += jump > 0.01 * found.mean;
                    found.slope = std::max(found.slope,
                        (change - jump) / found.mean * v.spacing() / (now - before).length());
                }
            }
            before = now;
            light0 = light1;
        }
    }
    return found;
}

void print(const char* name, const Found& f)
{
    std::printf("  %-16s", name);
    for (int k = 0; k < kKinds; ++k) std::printf(" %9.1e (%5zu)", f.jump[k], f.jumps[k]);
    std::printf(" %9.2f\n", f.slope);
    std::fflush(stdout);
}

void run(int argc, char** argv)
{
    const IrradianceVolume volume = loadVolume(argv[1]);
    const Tracer tracer(std::make_shared<const Scene>(loadScene(argv[2])));
    const std::size_t steps = argc > 3 ? std::strtoull(argv[3], nullptr, 10) : kSteps;
    std::printf("%s: %zu samples, cells by level:", argv[1], volume.sampleCount());
    for (const std::size_t n : volume.cellsByLevel()) std::printf(" %zu", n);
    std::printf("\n%zu steps on %zu lines: largest jump / mean irradiance (jumps above 1%% of it)\n"
                "  %-16s",
        steps, kWalks, "");
    for (const char* name : kNames) std::printf(" %17s", name);
    std::printf(" %9s\n", "slope");
    const auto measure = [&](const char* title, const Light& light) {
        print(title, walkAll(volume, tracer, light, steps));
    };
    for (const Interpolation mode : {Interpolation::Trilinear, Interpolation::Gradient,
             Interpolation::Tricubic, Interpolation::InverseDistance}) {
        if (needsGradients(mode) && !volume.hasGradients()) continue;
        const VolumeSampler sampler(volume, mode);
        measure(
            name(mode), [&](const Vec3d& p, const Vec3f& n) { return sampler.irradiance(p, n); });
    }
    measure("plain trilinear",
        [&](const Vec3d& p, const Vec3f& n) { return plainTrilinear(volume, p, n); });
}

} // namespace

int main(int argc, char** argv)
{
    if (argc < 3 || argc > 4) {
        std::fprintf(stderr, "usage: lumivdb_bench_walks VOLUME.vdb SCENE [steps]\n");
        return 2;
    }
    try {
        run(argc, argv);
        return 0;
    } catch (const Error& e) {
        std::fprintf(stderr, "lumivdb_bench_walks: %s\n", e.what());
        return 1;
    }
}
