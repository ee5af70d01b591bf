// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include <lumivdb/core/random.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <stdexcept>

#include <unistd.h>

namespace vdb_test {

namespace fs = std::filesystem;

TempFolder::TempFolder()
{
    std::string name = (fs::temp_directory_path() / "lumivdb-test-XXXXXX").string();
    if (!::mkdtemp(name.data())) throw std::runtime_error("no temporary folder");
    mPath = name;
}

TempFolder::~TempFolder()
{
    std::error_code ec;
    fs::remove_all(mPath, ec);
}

std::size_t TempFolder::entries() const
{
    return static_cast<std::size_t>(
        std::distance(fs::directory_iterator(mPath), fs::directory_iterator()));
}

void fillRandom(IrradianceVolume& volume, std::uint64_t seed, float magnitude)
{
    const int n = volume.coefficients();
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        const Coord& p = volume.samplePosition(s);
        CounterRng rng(hashPoint(seed, p.x, p.y, p.z));
        const auto color = [&rng, magnitude] {
            Color c;
            for (int k = 0; k < 3; ++k) c[k] = (rng.next() - 0.5f) * magnitude;
            return c;
        };
        for (int c = 0; c < n; ++c) volume.radiance(s)[c] = color();
        volume.radiance(s)[0] += Color(magnitude);
        if (volume.hasGradients())
            for (int c = 0; c < 3 * n; ++c) volume.gradient(s)[c] = color();
        volume.validity(s) = rng.next();
        volume.distance(s)
            = rng.next() < 0.1f ? std::numeric_limits<float>::infinity() : 1e5f * rng.next();
    }
    volume.radiance(0)[n - 1] = Color(-0.0f, 1e-40f, -1e-42f); // signs of zero, denormals
    VolumeMetadata& meta = volume.metadata();
    meta.contribution = "indirect";
    meta.lightGroup = "sun & lämpe";
    meta.upAxis = "z";
    meta.errorAsked = 0.02;
    meta.errorReached = 0.0173;
    meta.errorConfidence = 0.95;
    meta.seed = 0xfedcba9876543210ull;
    meta.raysPerSample = 4096;
    meta.integrator = "cached";
    meta.cacheBias = 0.0021;
    meta.cacheBiasUpper = 0.0034;
    meta.options = "bake scene.gltf -o out.vdb --rays 4096";
    meta.sceneHash = "0123456789abcdef";
}

void cutAndMove(IrradianceVolume& volume, std::uint64_t seed)
{
    CounterRng rng(seed);
    const auto number = [&rng] { return 2 * rng.next() - 1; };
    std::vector<std::pair<CellId, CellVisibility>> cuts;
    for (std::size_t i = 0; i < volume.cellCount(); ++i) {
        if (rng.next() < 0.5f && i > 0) continue;
        CellVisibility v;
        for (int k = 0; k < 3; ++k) {
            v.normal[k] = Vec3f(number(), number(), number()).normalized();
            v.offset[k] = number();
        }
        v.masks = rng.bits();
        cuts.emplace_back(static_cast<CellId>(i), v);
    }
    volume.setVisibility(cuts);
    std::vector<Vec3f> offsets(volume.sampleCount(), Vec3f(0.0f));
    for (Vec3f& o : offsets)
        if (rng.next() < 0.3f) o = Vec3f(number(), number(), number()) * 1e-3f;
    offsets[0] = Vec3f(-0.0f, 1e-40f, 0.25f);
    volume.setOffsets(std::move(offsets));
    std::vector<Vec3f> blocking(volume.cellCount(), Vec3f(0.0f));
    for (std::size_t i = 0; i < blocking.size(); ++i)
        if (rng.next() < 0.4f || i == 0) blocking[i] = Vec3f(number(), number(), number());
    volume.setBlocking(std::move(blocking));
    volume.metadata().bounds
        = LatticeBox{volume.minLattice(), volume.maxLattice() - Coord(1, 0, 0)};
}

IrradianceVolume uniformVolume(
    const Coord& lower, const Coord& upper, int bands, bool gradients, double spacing)
{
    VolumeBuilder builder(bands,
        gradients ? GradientStorage::PerCoefficient : GradientStorage::None,
        latticeTransform(spacing));
    builder.addUniform(lower, upper);
    IrradianceVolume volume = builder.build();
    fillRandom(volume, 7);
    return volume;
}

namespace {

void addOctree(VolumeBuilder& builder, const Coord& origin, int level, const Coord& target)
{
    const int size = 1 << level;
    int distance = 0;
    for (int a = 0; a < 3; ++a) {
        const int lo = origin[a] - target[a], hi = target[a] - (origin[a] + size);
        distance = std::max({distance, lo, hi});
    }
    if (level == 0 || distance >= size) {
        builder.addCell(origin, level);
        return;
    }
    const int half = size / 2;
    for (int i = 0; i < 8; ++i)
        addOctree(
            builder, origin + Coord(i & 1, (i >> 1) & 1, (i >> 2) & 1) * half, level - 1, target);
}

} // namespace

IrradianceVolume adaptiveVolume(
    const Coord& origin, int rootLevel, const Coord& target, int bands, bool gradients)
{
    VolumeBuilder builder(bands,
        gradients ? GradientStorage::PerCoefficient : GradientStorage::None,
        latticeTransform(0.25));
    addOctree(builder, origin, rootLevel, target);
    IrradianceVolume volume = builder.build();
    fillRandom(volume, 11);
    return volume;
}

namespace {

bool same(const void* a, const void* b, std::size_t bytes) { return std::memcmp(a, b, bytes) == 0; }

std::string metadataDifference(const VolumeMetadata& a, const VolumeMetadata& b)
{
    if (a.contribution != b.contribution) return "contribution";
    if (a.lightGroup != b.lightGroup) return "lightGroup";
    if (a.upAxis != b.upAxis) return "upAxis";
    if (a.errorAsked != b.errorAsked || a.errorReached != b.errorReached
        || a.errorConfidence != b.errorConfidence)
        return "error";
    if (a.seed != b.seed) return "seed";
    if (a.raysPerSample != b.raysPerSample) return "raysPerSample";
    if (a.integrator != b.integrator) return "integrator";
    if (a.cacheBias != b.cacheBias || a.cacheBiasUpper != b.cacheBiasUpper) return "cacheBias";
    if (a.options != b.options) return "options";
    if (!(a.bounds == b.bounds)) return "bounds";
    return a.sceneHash != b.sceneHash ? "sceneHash" : "";
}

} // namespace

std::string difference(const IrradianceVolume& a, const IrradianceVolume& b)
{
    if (a.bands() != b.bands() || a.hasGradients() != b.hasGradients()) return "record shape";
    if (a.sampleCount() != b.sampleCount()) return "number of samples";
    if (a.cellCount() != b.cellCount()) return "number of cells";
    if (!same(&a.indexToWorld(), &b.indexToWorld(), sizeof(Mat4d))) return "transform";
    for (std::size_t i = 0; i < a.cellCount(); ++i) {
        const Cell &x = a.cell(static_cast<CellId>(i)), &y = b.cell(static_cast<CellId>(i));
        if (!same(&x, &y, sizeof(Cell))) return "cell " + std::to_string(i);
        const CellVisibility *va = a.visibility(static_cast<CellId>(i)),
                             *vb = b.visibility(static_cast<CellId>(i));
        if (va && vb ? !same(va, vb, sizeof *va) : va != vb)
            return "visibility of cell " + std::to_string(i);
    }
    if (a.hasBlocking() != b.hasBlocking()) return "blocking";
    for (std::size_t i = 0; i < a.cellCount(); ++i) {
        const Vec3f ba = a.blocking(static_cast<CellId>(i)),
                    bb = b.blocking(static_cast<CellId>(i));
        if (!same(&ba, &bb, sizeof ba)) return "blocking of cell " + std::to_string(i);
    }
    if (a.hasOffsets() != b.hasOffsets()) return "offsets";
    const auto bytes = sizeof(Color) * static_cast<std::size_t>(a.coefficients());
    for (std::size_t i = 0; i < a.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        const std::string where = " of sample " + std::to_string(i);
        if (a.samplePosition(s) != b.samplePosition(s)) return "position" + where;
        if (!same(a.radiance(s), b.radiance(s), bytes)) return "radiance" + where;
        if (a.hasGradients() && !same(a.gradient(s), b.gradient(s), 3 * bytes))
            return "gradient" + where;
        const float va = a.validity(s), vb = b.validity(s), da = a.distance(s), db = b.distance(s);
        if (!same(&va, &vb, sizeof va)) return "validity" + where;
        if (!same(&da, &db, sizeof da)) return "distance" + where;
        const Vec3f oa = a.offset(s), ob = b.offset(s);
        if (!same(&oa, &ob, sizeof oa)) return "offset" + where;
    }
    return metadataDifference(a.metadata(), b.metadata());
}

std::vector<char> readBytes(const std::string& path)
{
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

void writeBytes(const std::string& path, const std::vector<char>& bytes)
{
    std::ofstream file(path, std::ios::binary | std::ios::trunc);
    file.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    if (!file) throw std::runtime_error("cannot write " + path);
}

} // namespace vdb_test
