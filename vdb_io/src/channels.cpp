// SPDX-License-Identifier: Apache-2.0
#include "channels.h"

#include "cuts.h"

#include <lumivdb/core/error.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <cmath>
#include <locale>
#include <sstream>

namespace lumivdb {

namespace {

constexpr const char* kConvention
    = "real orthonormal SH with Condon-Shortley signs, index l(l+1)+m; see FORMAT.md";

template <typename T>
T require(const openvdb::MetaMap& map, const std::string& key, const std::string& where)
{
    const std::string name = kMetadataPrefix + key;
    const auto entry = map.getMetadata<openvdb::TypedMetadata<T>>(name);
    if (!entry) {
        throw Error(ErrorCode::Input,
            where + " lacks the metadata '" + name + "' or it has another type; bake it again.");
    }
    return entry->value();
}

} // namespace

std::vector<ColorChannel> colorChannels(int bands, bool gradients)
{
    std::vector<ColorChannel> channels;
    const int n = coefficientCount(bands);
    for (int i = 0; i < n; ++i) channels.push_back({"sh_" + std::to_string(i), false, i});
    if (!gradients) return channels;
    const char* const axis[3] = {"_dx", "_dy", "_dz"};
    for (int i = 0; i < n; ++i)
        for (int a = 0; a < 3; ++a)
            channels.push_back({"sh_" + std::to_string(i) + axis[a], true, a * n + i});
    return channels;
}

const std::vector<std::string>& cutGridNames()
{
    static const std::vector<std::string> names{
        kWallGrids[0], kWallGrids[1], kWallGrids[2], kWallOffsetGrid, kMaskGrids[0], kMaskGrids[1]};
    return names;
}

namespace {

std::string boundsText(const LatticeBox& box)
{
    std::string text;
    for (const Coord& c : {box.lower, box.upper})
        for (int a = 0; a < 3; ++a) text += (text.empty() ? "" : " ") + std::to_string(c[a]);
    return text;
}

LatticeBox parseBounds(const std::string& text, const std::string& where)
{
    LatticeBox box;
    std::istringstream in(text);
    in.imbue(std::locale::classic());
    bool good = true;
    for (Coord* c : {&box.lower, &box.upper})
        for (int a = 0; a < 3; ++a) good = static_cast<bool>(in >> (*c)[a]) && good;
    for (int a = 0; a < 3 && good; ++a) {
        good = box.lower[a] < box.upper[a] && box.lower[a] >= -kMaxLattice
            && box.upper[a] <= kMaxLattice;
    }
    std::string rest;
    if (!good || in >> rest) {
        throw Error(ErrorCode::Input,
            where + " has 'lumivdb_lattice_bounds' \"" + text
                + "\"; six whole numbers are needed, the lower corner first.");
    }
    return box;
}

/// An entry that only some volumes have.
template <typename T>
std::optional<T> optionalEntry(
    const openvdb::MetaMap& map, const std::string& key, const std::string& where)
{
    if (!map[kMetadataPrefix + key]) return std::nullopt;
    return require<T>(map, key, where);
}

std::optional<std::int64_t> optionalCount(
    const openvdb::MetaMap& map, const std::string& key, const std::string& where)
{
    const auto count = optionalEntry<std::int64_t>(map, key, where);
    if (count && *count < 0)
        throw Error(ErrorCode::Input, where + " has a negative '" + kMetadataPrefix + key + "'.");
    return count;
}

void addOptional(const IrradianceVolume& volume, openvdb::MetaMap& map)
{
    using namespace openvdb;
    const auto add = [&map](const char* key, const Metadata& value) {
        map.insertMeta(std::string(kMetadataPrefix) + key, value);
    };
    if (volume.hasVisibility()) {
        std::int64_t cut = 0;
        for (std::size_t i = 0; i < volume.cellCount(); ++i) {
            const CellVisibility* v = volume.visibility(static_cast<CellId>(i));
            cut += v && saysAnything(*v);
        }
        add("cut_cells", Int64Metadata(cut));
    }
    if (volume.hasOffsets()) {
        std::int64_t moved = 0;
        for (std::size_t s = 0; s < volume.sampleCount(); ++s)
            moved += volume.offset(static_cast<SampleId>(s)) != Vec3f(0.0f);
        add("moved_samples", Int64Metadata(moved));
    }
    const VolumeMetadata& meta = volume.metadata();
    if (meta.integrator != "path") add("integrator", StringMetadata(meta.integrator));
    if (meta.cacheBias >= 0) {
        add("cache_bias", DoubleMetadata(meta.cacheBias));
        add("cache_bias_upper", DoubleMetadata(meta.cacheBiasUpper));
    }
    if (volume.hasBlocking()) {
        std::int64_t blocked = 0;
        for (std::size_t i = 0; i < volume.cellCount(); ++i)
            blocked += volume.blocking(static_cast<CellId>(i)) != Vec3f(0.0f);
        add("blocked_cells", Int64Metadata(blocked));
    }
    if (volume.metadata().bounds)
        add("lattice_bounds", StringMetadata(boundsText(*volume.metadata().bounds)));
}

} // namespace

openvdb::MetaMap makeMetadata(const IrradianceVolume& volume)
{
    using namespace openvdb;
    const VolumeMetadata& meta = volume.metadata();
    MetaMap map;
    const auto add = [&map](const char* key, const Metadata& value) {
        map.insertMeta(std::string(kMetadataPrefix) + key, value);
    };
    add("version", Int32Metadata(kFormatVersion));
    add("convention", StringMetadata(kConvention));
    add("quantity", StringMetadata("radiance"));
    add("bands", Int32Metadata(volume.bands()));
    add("gradients", StringMetadata(volume.hasGradients() ? "per_coefficient" : "none"));
    add("contribution", StringMetadata(meta.contribution));
    add("light_group", StringMetadata(meta.lightGroup));
    add("up_axis", StringMetadata(meta.upAxis));
    add("error_asked", DoubleMetadata(meta.errorAsked));
    add("error_reached", DoubleMetadata(meta.errorReached));
    add("error_confidence", DoubleMetadata(meta.errorConfidence));
    add("seed", Int64Metadata(static_cast<std::int64_t>(meta.seed)));
    add("rays", Int64Metadata(static_cast<std::int64_t>(meta.raysPerSample)));
    add("options", StringMetadata(meta.options));
    add("scene_hash", StringMetadata(meta.sceneHash));
    addOptional(volume, map);
    return map;
}

bool hasLumivdbMetadata(const openvdb::MetaMap& map)
{
    for (auto it = map.beginMeta(); it != map.endMeta(); ++it)
        if (it->first.rfind(kMetadataPrefix, 0) == 0) return true;
    return false;
}

FileMetadata parseMetadata(const openvdb::MetaMap& map, const std::string& where)
{
    if (!hasLumivdbMetadata(map)) {
        throw Error(ErrorCode::Input,
            where + " has no LumiVDB metadata: it is not an irradiance volume that lumivdb wrote.");
    }
    FileMetadata file;
    file.version = require<std::int32_t>(map, "version", where);
    if (file.version != kFormatVersion) {
        throw Error(ErrorCode::Input,
            where + " has format version " + std::to_string(file.version)
                + " and this program reads version " + std::to_string(kFormatVersion)
                + "; use the program that wrote it.");
    }
    if (require<std::string>(map, "quantity", where) != "radiance")
        throw Error(ErrorCode::Input, where + " does not store radiance; bake it again.");
    file.bands = require<std::int32_t>(map, "bands", where);
    if (file.bands < 1 || file.bands > kMaxBands) {
        throw Error(ErrorCode::Input,
            where + " says " + std::to_string(file.bands) + " bands; 1 to 6 are possible.");
    }
    const std::string gradients = require<std::string>(map, "gradients", where);
    if (gradients != "none" && gradients != "per_coefficient") {
        throw Error(ErrorCode::Input,
            where + " has unknown gradients '" + gradients + "'; use the program that wrote it.");
    }
    file.gradients = gradients == "per_coefficient";
    VolumeMetadata& meta = file.volume;
    meta.contribution = require<std::string>(map, "contribution", where);
    meta.lightGroup = require<std::string>(map, "light_group", where);
    meta.upAxis = require<std::string>(map, "up_axis", where);
    meta.errorAsked = require<double>(map, "error_asked", where);
    meta.errorReached = require<double>(map, "error_reached", where);
    meta.errorConfidence = require<double>(map, "error_confidence", where);
    meta.seed = static_cast<std::uint64_t>(require<std::int64_t>(map, "seed", where));
    meta.raysPerSample = static_cast<std::uint64_t>(require<std::int64_t>(map, "rays", where));
    meta.options = require<std::string>(map, "options", where);
    meta.sceneHash = require<std::string>(map, "scene_hash", where);
    file.cutCells = optionalCount(map, "cut_cells", where).value_or(0);
    file.movedSamples = optionalCount(map, "moved_samples", where);
    file.blockedCells = optionalCount(map, "blocked_cells", where);
    const auto bounds = optionalEntry<std::string>(map, "lattice_bounds", where);
    if (bounds) meta.bounds = parseBounds(*bounds, where);
    meta.integrator = optionalEntry<std::string>(map, "integrator", where).value_or("path");
    meta.cacheBias = optionalEntry<double>(map, "cache_bias", where).value_or(-1.0);
    meta.cacheBiasUpper = optionalEntry<double>(map, "cache_bias_upper", where).value_or(-1.0);
    return file;
}

std::string metadataDifference(const openvdb::MetaMap& a, const openvdb::MetaMap& b)
{
    const openvdb::MetaMap* const maps[2] = {&a, &b};
    for (int side = 0; side < 2; ++side) {
        const openvdb::MetaMap& other = *maps[1 - side];
        for (auto it = maps[side]->beginMeta(); it != maps[side]->endMeta(); ++it) {
            if (it->first.rfind(kMetadataPrefix, 0) != 0) continue;
            const auto match = other[it->first];
            if (!match || !(*match == *it->second)) return it->first;
        }
    }
    return {};
}

std::string pointText(const Coord& p)
{
    return "(" + std::to_string(p.x) + ", " + std::to_string(p.y) + ", " + std::to_string(p.z)
        + ")";
}

openvdb::math::Transform::Ptr makeTransform(const Mat4d& indexToWorld)
{
    // Both libraries use row vectors: the entries are the same.
    openvdb::Mat4R m;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) m(i, j) = indexToWorld[i][j];
    // Transform's constructor turns an affine map without rotation into a scale and a translation,
    // but takes the scale as (1,1,1)·M − (0,0,0)·M, which far from the origin loses most of its
    // digits. Composed step by step they stay exact (as long as nobody calls Transform::copy()).
    using openvdb::math::AffineMap;
    using openvdb::math::Transform;
    if (!AffineMap(m).isScaleTranslate()) return Transform::createLinearTransform(m);
    const Transform::Ptr transform = Transform::createLinearTransform(1.0);
    transform->preScale(openvdb::Vec3d(m(0, 0), m(1, 1), m(2, 2)));
    transform->postTranslate(openvdb::Vec3d(m(3, 0), m(3, 1), m(3, 2)));
    return transform;
}

Mat4d matrixOf(const openvdb::math::Transform& transform)
{
    const openvdb::Mat4R m = transform.baseMap()->getAffineMap()->getMat4();
    Mat4d out;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) out[i][j] = m(i, j);
    return out;
}

} // namespace lumivdb
