// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/vdb_io/resample.h>

#include "records.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/core/volume_fill.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>

namespace lumivdb {

namespace {

using Volumes = std::vector<const IrradianceVolume*>;

std::string pointText(const Coord& p)
{
    return "(" + std::to_string(p.x) + ", " + std::to_string(p.y) + ", " + std::to_string(p.z)
        + ")";
}

[[noreturn]] void refuse(std::size_t input, const std::string& what)
{
    throw Error(ErrorCode::Usage,
        "Input " + std::to_string(input) + " does not go with input 0: " + what + ".");
}

bool sameVisibility(const CellVisibility* a, const CellVisibility* b)
{
    return a && b ? *a == *b : a == b;
}

void checkShape(const Volumes& volumes)
{
    if (volumes.empty()) throw Error(ErrorCode::Usage, "There is no volume to combine; give one.");
    const IrradianceVolume& first = *volumes[0];
    for (std::size_t i = 1; i < volumes.size(); ++i) {
        const IrradianceVolume& other = *volumes[i];
        if (other.bands() != first.bands()) refuse(i, "the number of bands differs");
        if (other.hasGradients() != first.hasGradients()) refuse(i, "only one has gradients");
        if (other.indexToWorld() != first.indexToWorld()) refuse(i, "the lattices differ");
    }
}

bool sameTopology(const IrradianceVolume& a, const IrradianceVolume& b)
{
    if (a.sampleCount() != b.sampleCount() || a.cellCount() != b.cellCount()) return false;
    for (std::size_t i = 0; i < a.cellCount(); ++i) {
        const Cell& x = a.cell(static_cast<CellId>(i));
        const Cell& y = b.cell(static_cast<CellId>(i));
        if (x.origin != y.origin || x.level != y.level) return false;
    }
    return true;
}

/// Measured in the same places, cells cut by the same walls: else a sum is of two scenes.
void checkPlaces(const IrradianceVolume& first, const IrradianceVolume& other, std::size_t input)
{
    for (std::size_t i = 0; i < first.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        if (first.offset(s) != other.offset(s)) {
            refuse(input,
                "the sample at lattice point " + pointText(first.samplePosition(s))
                    + " was moved to another place");
        }
    }
    for (std::size_t i = 0; i < first.cellCount(); ++i) {
        const auto id = static_cast<CellId>(i);
        if (!sameVisibility(first.visibility(id), other.visibility(id))) {
            refuse(input,
                "what the cell at lattice point " + pointText(first.cell(id).origin)
                    + " sees differs");
        }
    }
}

/// Around the bounds of all.
LatticeBox aroundAll(const Volumes& volumes)
{
    LatticeBox box = volumes[0]->latticeBounds();
    for (const IrradianceVolume* volume : volumes) {
        const LatticeBox other = volume->latticeBounds();
        for (int a = 0; a < 3; ++a) {
            box.lower[a] = std::min(box.lower[a], other.lower[a]);
            box.upper[a] = std::max(box.upper[a], other.upper[a]);
        }
    }
    return box;
}

/// The first volume's metadata, less what the others say differently.
VolumeMetadata agreedMetadata(const Volumes& volumes)
{
    VolumeMetadata meta = volumes[0]->metadata();
    const auto agree = [&volumes](auto VolumeMetadata::*field) {
        return std::all_of(volumes.begin(), volumes.end(), [&](const IrradianceVolume* v) {
            return v->metadata().*field == volumes[0]->metadata().*field;
        });
    };
    if (!agree(&VolumeMetadata::contribution)) meta.contribution = "all";
    if (!agree(&VolumeMetadata::lightGroup)) meta.lightGroup.clear();
    if (!agree(&VolumeMetadata::options)) meta.options.clear();
    if (!agree(&VolumeMetadata::sceneHash)) meta.sceneHash.clear();
    if (!agree(&VolumeMetadata::seed)) meta.seed = 0;
    if (!agree(&VolumeMetadata::raysPerSample)) meta.raysPerSample = 0;
    if (!agree(&VolumeMetadata::integrator)) meta.integrator.clear();
    if (!agree(&VolumeMetadata::cacheBias) || !agree(&VolumeMetadata::cacheBiasUpper))
        meta.cacheBias = meta.cacheBiasUpper = -1.0;
    if (!agree(&VolumeMetadata::errorAsked)) meta.errorAsked = 0;
    if (!agree(&VolumeMetadata::bounds)) meta.bounds = aroundAll(volumes);
    if (!agree(&VolumeMetadata::errorReached) || !agree(&VolumeMetadata::errorConfidence))
        forgetError(meta);
    return meta;
}

/// Σ factor_i · record_i, in double and in the order of the inputs.
template <typename RecordOf>
void addRecords(const Volumes& volumes, const std::vector<double>& factors, int count, Color* out,
    const RecordOf& record)
{
    for (int c = 0; c < count; ++c) {
        for (int k = 0; k < 3; ++k) {
            double sum = 0;
            for (std::size_t v = 0; v < volumes.size(); ++v)
                sum += factors[v] * static_cast<double>(record(*volumes[v])[c][k]);
            out[c][k] = static_cast<float>(sum);
        }
    }
}

} // namespace

IrradianceVolume addVolumes(
    const std::vector<const IrradianceVolume*>& volumes, const std::vector<double>& factors)
{
    checkShape(volumes);
    if (factors.size() != volumes.size())
        throw Error(ErrorCode::Usage, "A sum of volumes needs one factor for each volume.");
    for (const double factor : factors)
        if (!std::isfinite(factor))
            throw Error(ErrorCode::Usage, "The factor of a volume must be a finite number.");
    for (std::size_t i = 1; i < volumes.size(); ++i) {
        if (volumes[i]->metadata().upAxis != volumes[0]->metadata().upAxis)
            refuse(i, "the up axes differ");
        if (!sameTopology(*volumes[0], *volumes[i])) refuse(i, "the cells differ");
        checkPlaces(*volumes[0], *volumes[i], i);
    }
    IrradianceVolume out = volumes[0]->clone();
    const int n = out.coefficients();
    for (std::size_t i = 0; i < out.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        addRecords(volumes, factors, n, out.radiance(s),
            [s](const IrradianceVolume& v) { return v.radiance(s); });
        if (!out.hasGradients()) continue;
        addRecords(volumes, factors, 3 * n, out.gradient(s),
            [s](const IrradianceVolume& v) { return v.gradient(s); });
    }
    out.metadata() = agreedMetadata(volumes);
    forgetError(out.metadata());
    return out;
}

namespace {

/// Whether invalid samples hold what fillInvalid() makes of the valid ones.
bool isFilled(const IrradianceVolume& volume)
{
    std::size_t invalid = 0;
    for (std::size_t i = 0; i < volume.sampleCount(); ++i)
        invalid += !volume.isValid(static_cast<SampleId>(i));
    if (invalid == 0) return true;
    IrradianceVolume filled = volume.clone();
    fillInvalid(filled);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        if (!sameRecord(volume, s, filled, s, true)) return false;
    }
    return true;
}

/// A cell that several volumes have sees the same in all.
void checkCommonCells(const Volumes& volumes, const IrradianceVolume& all)
{
    std::vector<std::pair<std::size_t, CellId>> first(all.cellCount(), {volumes.size(), kNoCell});
    for (std::size_t v = 0; v < volumes.size(); ++v) {
        for (std::size_t i = 0; i < volumes[v]->cellCount(); ++i) {
            const auto id = static_cast<CellId>(i);
            const Coord origin = volumes[v]->cell(id).origin;
            auto& known = first[static_cast<std::size_t>(all.findCell(origin))];
            if (known.second == kNoCell) {
                known = {v, id};
            } else if (!sameVisibility(volumes[known.first]->visibility(known.second),
                           volumes[v]->visibility(id))) {
                refuse(v,
                    "what the shared cell at lattice point " + pointText(origin) + " sees differs");
            }
        }
    }
}

} // namespace

/// Values of filled samples come from what is around them, which is more in the whole: they are
/// filled again then.
IrradianceVolume joinVolumes(const std::vector<const IrradianceVolume*>& volumes)
{
    checkShape(volumes);
    VolumeBuilder builder(
        volumes[0]->bands(), gradientStorage(*volumes[0]), volumes[0]->indexToWorld());
    std::set<std::array<int, 4>> seen;
    for (const IrradianceVolume* volume : volumes) {
        for (std::size_t i = 0; i < volume->cellCount(); ++i) {
            const Cell& c = volume->cell(static_cast<CellId>(i));
            if (seen.insert({c.origin.x, c.origin.y, c.origin.z, c.level}).second)
                builder.addCell(c.origin, c.level);
        }
    }
    IrradianceVolume out = builder.build();
    checkCommonCells(volumes, out);
    copyPlaces(volumes, out);
    const bool refill = std::all_of(volumes.begin(), volumes.end(),
        [](const IrradianceVolume* volume) { return isFilled(*volume); });
    std::vector<bool> filled(out.sampleCount(), false);
    for (std::size_t v = 0; v < volumes.size(); ++v) {
        const IrradianceVolume& volume = *volumes[v];
        for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
            const auto s = static_cast<SampleId>(i);
            const Coord& p = volume.samplePosition(s);
            const auto t = static_cast<SampleId>(out.findSample(p));
            if (!filled[t]) {
                copyRecord(volume, s, out, t);
                filled[t] = true;
            } else if (!sameRecord(volume, s, out, t, volume.isValid(s) || !refill)) {
                refuse(v, "the shared sample at lattice point " + pointText(p) + " differs");
            }
        }
    }
    if (refill) fillInvalid(out);
    out.metadata() = agreedMetadata(volumes);
    return out;
}

namespace {

constexpr int kNormals = 32;

/// Points of a spherical Fibonacci lattice (Swinbank & Purser 2006).
std::array<Vec3f, kNormals> uniformNormals()
{
    std::array<Vec3f, kNormals> normals;
    const double golden = 3.14159265358979323846 * (3.0 - std::sqrt(5.0));
    for (int i = 0; i < kNormals; ++i) {
        const double z = 1.0 - (2.0 * i + 1.0) / kNormals, r = std::sqrt(1.0 - z * z);
        normals[static_cast<std::size_t>(i)]
            = Vec3f(Vec3d(r * std::cos(golden * i), r * std::sin(golden * i), z));
    }
    return normals;
}

/// World box around what a volume is meant for.
Box3d boundsBox(const IrradianceVolume& volume)
{
    const LatticeBox bounds = volume.latticeBounds();
    Box3d box;
    for (int i = 0; i < 8; ++i) {
        const Vec3d corner(i & 1 ? bounds.upper.x : bounds.lower.x,
            i & 2 ? bounds.upper.y : bounds.lower.y, i & 4 ? bounds.upper.z : bounds.lower.z);
        box.extendBy(corner * volume.indexToWorld());
    }
    return box;
}

struct PointError {
    Vec3d squared{0.0}, reference{0.0}; ///< summed over normals
    bool inside = false;
};

PointError errorAt(const VolumeSampler& a, const VolumeSampler& b, const Vec3d& p,
    const std::array<Vec3f, kNormals>& normals)
{
    PointError error;
    for (const Vec3f& n : normals) {
        QueryInfo infoA, infoB;
        const Color ea = a.irradiance(p, n, &infoA), eb = b.irradiance(p, n, &infoB);
        if (infoA.level < 0 || infoB.level < 0) return {};
        const Vec3d d = Vec3d(eb) - Vec3d(ea);
        error.squared += d * d;
        error.reference += Vec3d(ea);
    }
    error.inside = true;
    return error;
}

} // namespace

double compareVolumes(
    const IrradianceVolume& a, const IrradianceVolume& b, std::size_t points, std::uint64_t seed)
{
    const Box3d boxA = boundsBox(a), boxB = boundsBox(b);
    Vec3d lower, upper;
    for (int k = 0; k < 3; ++k) {
        lower[k] = std::max(boxA.min[k], boxB.min[k]);
        upper[k] = std::min(boxA.max[k], boxB.max[k]);
        if (!(lower[k] < upper[k]))
            throw Error(ErrorCode::Usage, "The volumes have no common box; compare others.");
    }
    const VolumeSampler samplerA(a), samplerB(b);
    const auto normals = uniformNormals();
    std::vector<PointError> errors(points);
    tbb::parallel_for(std::size_t{0}, points, [&](std::size_t i) {
        CounterRng rng(hashCombine(seed, i));
        for (int attempt = 0; attempt < 256 && !errors[i].inside; ++attempt) {
            Vec3d p;
            for (int k = 0; k < 3; ++k) p[k] = lower[k] + (upper[k] - lower[k]) * rng.nextDouble();
            errors[i] = errorAt(samplerA, samplerB, p, normals);
        }
    });
    Vec3d squared(0.0), reference(0.0);
    double count = 0;
    for (const PointError& e : errors) {
        squared += e.squared;
        reference += e.reference;
        count += e.inside ? kNormals : 0;
    }
    if (count == 0) throw Error(ErrorCode::Usage, "No random point lies in both volumes.");
    double worst = 0;
    for (int k = 0; k < 3; ++k) {
        if (squared[k] == 0) continue;
        const double mean = std::abs(reference[k] / count);
        worst = std::max(worst,
            mean > 0 ? std::sqrt(squared[k] / count) / mean
                     : std::numeric_limits<double>::infinity());
    }
    return worst;
}

} // namespace lumivdb
