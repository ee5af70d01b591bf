// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include <lumivdb/core/xxhash64.h>

#include <lumivdb/core/sampler.h>
#include <lumivdb/core/volume_grid.h>
#include <lumivdb/vdb_io/resample.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <catch2/catch.hpp>
#include <openvdb/openvdb.h>
#include <openvdb/tools/Interpolation.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <map>

using namespace vdb_test;

namespace {

std::map<std::string, openvdb::GridBase::Ptr> gridsOf(const std::string& path)
{
    openvdb::io::File file(path);
    file.open(); // with delayed loading, as hosts do
    std::map<std::string, openvdb::GridBase::Ptr> grids;
    const openvdb::GridPtrVecPtr all = file.getGrids();
    for (const openvdb::GridBase::Ptr& grid : *all) {
        grid->readNonresidentBuffers();
        grids[grid->getName()] = grid;
    }
    return grids;
}

/// Expected value of a channel at every voxel: the sample there, else that of the origin of the
/// covering cell; in cells beyond 8³ a sample on the corner of
/// an 8³ block stands for the block.
Color expectedAt(const IrradianceVolume& volume, const Coord& p, int coefficient)
{
    std::int64_t s = volume.findSample(p);
    const CellId cell = volume.findCell(p);
    if (s < 0 && cell != kNoCell) {
        s = volume.cell(cell).corners[0];
        const Coord block(p.x & ~7, p.y & ~7, p.z & ~7);
        if (volume.cell(cell).level > 3 && volume.findSample(block) >= 0)
            s = volume.findSample(block);
    }
    return s < 0 ? Color(0.0f) : volume.radiance(static_cast<SampleId>(s))[coefficient];
}

void checkVoxels(const IrradianceVolume& volume, const std::string& path)
{
    auto grids = gridsOf(path);
    const auto channel = openvdb::gridPtrCast<openvdb::Vec3SGrid>(grids.at("sh_1"));
    const auto level = openvdb::gridPtrCast<openvdb::Int32Grid>(grids.at("level"));
    CHECK(level->tree().hasSameTopology(channel->tree()));
    const Coord lower = volume.minLattice() - Coord(9), upper = volume.maxLattice() + Coord(9);
    std::size_t wrong = 0, active = 0;
    auto values = channel->getConstAccessor();
    auto levels = level->getConstAccessor();
    for (int x = lower.x; x <= upper.x; ++x) {
        for (int y = lower.y; y <= upper.y; ++y) {
            for (int z = lower.z; z <= upper.z; ++z) {
                const openvdb::Coord p(x, y, z);
                const CellId cell = volume.findCell({x, y, z});
                const Color want = expectedAt(volume, {x, y, z}, 1);
                const openvdb::Vec3s got = values.getValue(p);
                const bool on = cell != kNoCell || volume.findSample({x, y, z}) >= 0;
                wrong += got != openvdb::Vec3s(want.x, want.y, want.z);
                wrong += values.isValueOn(p) != on || levels.isValueOn(p) != on;
                wrong += levels.getValue(p) != (cell == kNoCell ? -1 : volume.cell(cell).level);
                active += on;
            }
        }
    }
    CHECK(wrong == 0);
    CHECK(active > volume.cellCount());
}

} // namespace

TEST_CASE("the checksum is XXH64")
{
    // Test vectors of the specification's reference, seed 0.
    const auto digest = [](const std::string& text) {
        XxHash64 hash;
        for (const char c : text) hash.update(&c, 1); // byte by byte through the tail buffer
        XxHash64 whole;
        whole.update(text.data(), text.size());
        CHECK(hash.digest() == whole.digest());
        return whole.digest();
    };
    CHECK(digest("") == 0xef46db3751d8e999ull);
    CHECK(digest("a") == 0xd24ec4f1a98c6e5bull);
    CHECK(digest("abc") == 0x44bc2cf5ad770999ull);
    CHECK(digest("Nobody inspects the spammish repetition") == 0xfbcea83c8a378bf1ull);
}

TEST_CASE("grids are named, ordered and typed as documented")
{
    const TempFolder folder;
    saveVolume(uniformVolume({0, 0, 0}, {3, 3, 3}, 2, true), folder.file("a.vdb"));
    openvdb::io::File file(folder.file("a.vdb"));
    file.open();
    std::vector<std::string> names;
    const openvdb::GridPtrVecPtr all = file.readAllGridMetadata();
    for (const openvdb::GridBase::Ptr& grid : *all) {
        names.push_back(grid->getName());
        const std::string name = grid->getName();
        const char* type = name == "level"                                  ? "int32"
            : name == "validity" || name == "distance" || name == "density" ? "float"
                                                                            : "vec3s";
        CHECK(grid->valueType() == type);
        CHECK(grid->getVectorType() == openvdb::VEC_INVARIANT);
        CHECK(grid->metaValue<std::int32_t>("lumivdb_version") == 1);
        CHECK(grid->metaValue<std::int32_t>("lumivdb_bands") == 2);
        CHECK(grid->metaValue<std::string>("lumivdb_gradients") == "per_coefficient");
        CHECK(grid->metaValue<std::string>("lumivdb_light_group") == "sun & lämpe");
        CHECK(grid->metaValue<double>("lumivdb_error_reached") == 0.0173);
    }
    const std::vector<std::string> expected = {"color", "density", "level", "validity", "distance",
        "sh_0", "sh_1", "sh_2", "sh_3", "sh_0_dx", "sh_0_dy", "sh_0_dz", "sh_1_dx", "sh_1_dy",
        "sh_1_dz", "sh_2_dx", "sh_2_dy", "sh_2_dz", "sh_3_dx", "sh_3_dy", "sh_3_dz"};
    std::sort(names.begin(), names.end());
    std::vector<std::string> sorted = expected;
    std::sort(sorted.begin(), sorted.end());
    CHECK(names == sorted);
    // The order on disk: each name's first place in the bytes.
    const std::vector<char> bytes = readBytes(folder.file("a.vdb"));
    std::size_t at = 0;
    for (const std::string& name : expected) {
        std::string key(4, '\0'); // a string on disk: 32-bit length, characters
        key[0] = static_cast<char>(name.size());
        key += name;
        const auto found = std::search(
            bytes.begin() + static_cast<std::ptrdiff_t>(at), bytes.end(), key.begin(), key.end());
        REQUIRE(found != bytes.end());
        at = static_cast<std::size_t>(found - bytes.begin()) + key.size();
    }
}

TEST_CASE("every voxel holds what the layout says")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb");
    const auto check = [&path](const IrradianceVolume& volume) {
        saveVolume(volume, path);
        checkVoxels(volume, path);
    };
    check(uniformVolume({-5, 0, 3}, {7, 9, 12}, 2, false));
    check(adaptiveVolume({0, 0, 0}, 5, {31, 0, 9}, 2, false));
    check(adaptiveVolume({-64, 64, 0}, 6, {-64, 64, 0}, 2, false));
    check(adaptiveVolume({-64, 64, 0}, 6, {0, 128, 64}, 2, false));
}

TEST_CASE("coarse cells are tiles")
{
    const TempFolder folder;
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(1.0));
    builder.addCell({0, 0, 0}, 7);
    builder.addCell({128, 0, 0}, 7);
    IrradianceVolume volume = builder.build();
    SaveOptions options;
    options.previewVoxel = 8;
    saveVolume(volume, folder.file("a.vdb"), options);
    auto grids = gridsOf(folder.file("a.vdb"));
    const auto level = openvdb::gridPtrCast<openvdb::Int32Grid>(grids.at("level"));
    // Two tiles of 128³; of the 12 samples two are their corners, and the tile's far ones lie in
    // single voxels outside: the leaves of 10 points at x = 0, 128 or 256, y, z = 0 or 128.
    CHECK(level->tree().activeTileCount() == 2);
    CHECK(level->tree().leafCount() == 10);
    CHECK(level->tree().activeVoxelCount() == 2ull * 128 * 128 * 128 + 10);
}

TEST_CASE("a uniform volume is what OpenVDB's BoxSampler interpolates")
{
    const TempFolder folder;
    Mat4d m = latticeTransform(0.37);
    m[3][1] = 4.5;
    VolumeBuilder builder(2, GradientStorage::None, m);
    builder.addUniform({-4, 0, 0}, {4, 8, 5});
    IrradianceVolume volume = builder.build();
    fillRandom(volume, 21);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) volume.validity(SampleId(i)) = 1.0f;
    saveVolume(volume, folder.file("a.vdb"));
    auto grids = gridsOf(folder.file("a.vdb"));
    const VolumeSampler sampler(volume, Interpolation::Trilinear);
    std::size_t checked = 0;
    double worst = 0;
    for (int c = 0; c < 4; ++c) {
        const auto grid
            = openvdb::gridPtrCast<openvdb::Vec3SGrid>(grids.at("sh_" + std::to_string(c)));
        const openvdb::tools::GridSampler<openvdb::Vec3SGrid, openvdb::tools::BoxSampler> box(
            *grid);
        std::srand(4);
        for (int i = 0; i < 500; ++i) {
            const Vec3d lattice(-4 + 8 * (std::rand() / (RAND_MAX + 1.0)),
                8 * (std::rand() / (RAND_MAX + 1.0)), 5 * (std::rand() / (RAND_MAX + 1.0)));
            Vec3d p;
            volume.indexToWorld().multVecMatrix(lattice, p);
            Color L[4];
            sampler.radiance(p, L);
            const openvdb::Vec3s v = box.wsSample(openvdb::Vec3d(p.x, p.y, p.z));
            for (int k = 0; k < 3; ++k)
                worst = std::max(worst, std::abs(double{L[c][k]} - double{v[k]}));
            ++checked;
        }
    }
    CHECK(checked == 2000);
    CHECK(worst < 2e-6); // values up to 1.5, some roundings of single precision
}

TEST_CASE("previews show the mean irradiance over π")
{
    const TempFolder folder;
    // L00 linear in x: trilinear interpolation is exact, E averaged over normals = π L00 Y00.
    IrradianceVolume volume = uniformVolume({0, 0, 0}, {10, 4, 4}, 3, false, 0.5);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        const auto x = static_cast<float>(volume.sampleWorld(s).x);
        volume.radiance(s)[0] = Color(x, 2 * x, 0);
        volume.validity(s) = 1.0f;
    }
    SaveOptions options;
    for (const double voxel : {0.0, 0.25, 1.0}) {
        options.previewVoxel = voxel;
        saveVolume(volume, folder.file("a.vdb"), options);
        auto grids = gridsOf(folder.file("a.vdb"));
        const auto color = openvdb::gridPtrCast<openvdb::Vec3SGrid>(grids.at("color"));
        const auto density = openvdb::gridPtrCast<openvdb::FloatGrid>(grids.at("density"));
        const double size = voxel > 0 ? voxel : 0.5;
        CHECK(static_cast<double>(color->activeVoxelCount()) == 5.0 * 2 * 2 / std::pow(size, 3));
        CHECK(color->tree().activeTileCount() == 0);
        CHECK(density->tree().hasSameTopology(color->tree()));
        double worst = 0;
        for (auto it = color->cbeginValueOn(); it; ++it) {
            const double x = color->indexToWorld(it.getCoord()).x();
            const double want = x * 0.28209479177387814;
            worst = std::max({worst, std::abs(double{(*it)[0]} - want),
                std::abs(double{(*it)[1]} - 2 * want), std::abs(double{(*it)[2]})});
            const float lum = density->tree().getValue(it.getCoord());
            worst = std::max(worst, std::abs(double{lum} - want * (0.2126 + 2 * 0.7152)));
        }
        CHECK(worst < 1e-6);
    }
    options.previewVoxel = -1;
    saveVolume(volume, folder.file("a.vdb"), options);
    CHECK(gridsOf(folder.file("a.vdb")).count("color") == 0);
}

TEST_CASE("preview voxels of a large volume become coarser")
{
    const TempFolder folder;
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(1.0));
    builder.addCell({0, 0, 0}, 9); // 512³ lattice voxels, 8 samples: 2^27, so 2^18 of 8 steps
    saveVolume(builder.build(), folder.file("a.vdb"));
    auto grids = gridsOf(folder.file("a.vdb"));
    CHECK(grids.at("color")->voxelSize().x() == 8.0);
    CHECK(grids.at("color")->activeVoxelCount() == 1u << 18);
}

namespace {

/// L00 at lattice point (x, y, z) is (1 + x, 2 + y, 3 + z), every other coefficient i (i, 0, 0);
/// spacing 0.5; the sample at (2, 3, 4) is invalid, all rays of the one at (0, 0, 0) escaped.
IrradianceVolume sampleForReaders()
{
    IrradianceVolume volume = uniformVolume({0, 0, 0}, {12, 10, 9}, 3, false, 0.5);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        const Coord& p = volume.samplePosition(s);
        volume.radiance(s)[0] = Vec3f(1, 2, 3)
            + Vec3f(static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z));
        for (int c = 1; c < 9; ++c) volume.radiance(s)[c] = Color(static_cast<float>(c), 0, 0);
        volume.validity(s) = p == Coord(2, 3, 4) ? 0.0f : 1.0f;
        volume.distance(s) = p == Coord(0, 0, 0) ? std::numeric_limits<float>::infinity() : 2.5f;
    }
    CellVisibility wall;
    wall.normal[0] = Vec3f(0, 0.6f, 0.8f);
    wall.offset[2] = -0.25f;
    wall.masks = 0x8877665544332211ull;
    volume.setVisibility({{volume.findCell({7, 2, 5}), wall}});
    std::vector<Vec3f> offsets(volume.sampleCount(), Vec3f(0.0f));
    offsets[static_cast<std::size_t>(volume.findSample({1, 2, 3}))] = Vec3f(0, 0.125f, -0.5f);
    volume.setOffsets(offsets);
    return volume;
}

} // namespace

// Run by read_pyopenvdb.py and read_blender.py.
TEST_CASE("write a file for other readers", "[.write-sample]")
{
    const char* path = std::getenv("LUMIVDB_TEST_FILE");
    REQUIRE(path);
    saveVolume(sampleForReaders(), path);
}

// The next three are for blender_traps.py.
TEST_CASE("write one coarse cell", "[.write-coarse]")
{
    const char* path = std::getenv("LUMIVDB_TEST_FILE");
    REQUIRE(path);
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(1.0));
    builder.addCell({0, 0, 0}, 4);
    IrradianceVolume volume = builder.build();
    for (SampleId s = 0; s < 8; ++s) volume.radiance(s)[0] = Color(1.0f);
    saveVolume(volume, path);
}

namespace {

/// White light in a Y-up tower: 2 wide, 6 high, 2 deep.
IrradianceVolume tower()
{
    VolumeBuilder builder(2, GradientStorage::None, latticeTransform(0.5));
    builder.addUniform({0, 0, 0}, {4, 12, 4});
    IrradianceVolume volume = builder.build();
    for (std::size_t i = 0; i < volume.sampleCount(); ++i)
        volume.radiance(static_cast<SampleId>(i))[0] = Color(1.0f);
    return volume;
}

} // namespace

TEST_CASE("write a tower, Y up", "[.write-up-y]")
{
    const char* path = std::getenv("LUMIVDB_TEST_FILE");
    REQUIRE(path);
    saveVolume(tower(), path);
}

TEST_CASE("write a tower, Z up", "[.write-up-z]")
{
    const char* path = std::getenv("LUMIVDB_TEST_FILE");
    REQUIRE(path);
    saveVolume(transformVolume(tower(), upAxisRotation("y", "z")), path);
}
