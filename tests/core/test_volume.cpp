// SPDX-License-Identifier: Apache-2.0
// The volume's topology, records and transform.

#include "volume_makers.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/volume_grid.h>

#include <catch2/catch.hpp>

#include <limits>
#include <set>
#include <tuple>

using namespace lumivdb;
using namespace volume_test;

namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// The message of the Error(Usage) that @a work throws; "" where it throws none.
template <class Work> std::string usageError(const Work& work)
{
    try {
        work();
    } catch (const Error& e) {
        CHECK(e.code() == ErrorCode::Usage);
        return e.what();
    }
    return "";
}

bool less(const Coord& a, const Coord& b)
{
    return std::tie(a.x, a.y, a.z) < std::tie(b.x, b.y, b.z);
}

Coord corner(const Cell& c, int i)
{
    const int size = 1 << c.level;
    return c.origin + Coord((i & 1) * size, (i >> 1 & 1) * size, (i >> 2 & 1) * size);
}

/// Everything the header promises about samples and cells.
void checkTopology(const IrradianceVolume& v, const std::vector<BoxCell>& cells)
{
    REQUIRE(v.cellCount() == cells.size());
    std::set<std::tuple<int, int, int>> corners;
    std::size_t wrongCorners = 0, wrongLookups = 0;
    for (CellId id = 0; id < static_cast<CellId>(v.cellCount()); ++id) {
        const Cell& c = v.cell(id);
        for (int i = 0; i < 8; ++i) {
            const Coord p = corner(c, i);
            corners.insert({p.x, p.y, p.z});
            wrongCorners += v.samplePosition(c.corners[i]) != p;
        }
        const Coord last = corner(c, 7) - Coord(1);
        wrongLookups += v.findCell(c.origin) != id;
        wrongLookups += v.findCell(last) != id;
    }
    CHECK(wrongCorners == 0);
    CHECK(wrongLookups == 0);
    REQUIRE(v.sampleCount() == corners.size());
    std::size_t unsorted = 0, lost = 0;
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        if (s > 0) unsorted += !less(v.samplePosition(s - 1), v.samplePosition(s));
        lost += v.findSample(v.samplePosition(s)) != s;
    }
    CHECK(unsorted == 0);
    CHECK(lost == 0);
}

} // namespace

TEST_CASE("a uniform volume of nx x ny x nz cells has (nx+1)(ny+1)(nz+1) samples", "[volume]")
{
    const Coord lower(-3, 2, -1), upper(2, 5, 6);
    const IrradianceVolume v = uniformVolume(3, GradientStorage::None, lower, upper);
    CHECK(v.cellCount() == 5 * 3 * 7);
    CHECK(v.sampleCount() == 6 * 4 * 8);
    CHECK(v.cellsByLevel() == std::vector<std::size_t>{105});
    CHECK(v.minLattice() == lower);
    CHECK(v.maxLattice() == upper);
    CHECK(v.bands() == 3);
    CHECK(v.coefficients() == 9);
    CHECK_FALSE(v.hasGradients());
    CHECK(v.gradient(0) == nullptr);
    std::vector<BoxCell> cells;
    for (int x = lower.x; x < upper.x; ++x)
        for (int y = lower.y; y < upper.y; ++y)
            for (int z = lower.z; z < upper.z; ++z) cells.push_back({Coord(x, y, z), 0});
    checkTopology(v, cells);
    // Sample order is (x, y, z), z fastest.
    SampleId s = 0;
    for (int x = lower.x; x <= upper.x; ++x)
        for (int y = lower.y; y <= upper.y; ++y)
            for (int z = lower.z; z <= upper.z; ++z, ++s) {
                REQUIRE(v.samplePosition(s) == Coord(x, y, z));
            }
}

TEST_CASE("what is not in the volume is not found", "[volume]")
{
    const IrradianceVolume v = uniformVolume(1, GradientStorage::None, {-2, -2, -2}, {2, 2, 2});
    const int huge = std::numeric_limits<int>::max(), lowest = std::numeric_limits<int>::min();
    for (const Coord& p : {Coord(3, 0, 0), Coord(0, -3, 0), Coord(0, 0, 3), Coord(huge, 0, 0),
             Coord(0, lowest, 0), Coord(lowest, huge, lowest), Coord(-2, -2, 3 + (1 << 21)),
             Coord(-2, -2 + (1 << 21), -2)}) {
        CAPTURE(p);
        CHECK(v.findSample(p) == -1);
        CHECK(v.findCell(p) == kNoCell);
    }
    CHECK(v.findSample({2, 2, 2}) == 124);
    CHECK(v.findCell({2, 0, 0}) == kNoCell); // the last cell begins one step before
}

TEST_CASE("records start at zero and valid; distinct samples are distinct memory", "[volume]")
{
    IrradianceVolume v = uniformVolume(2, GradientStorage::PerCoefficient, {0, 0, 0}, {2, 2, 2});
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        for (int i = 0; i < 16; ++i) REQUIRE(v.radiance(s)[i] == Color(0.0f));
        REQUIRE(v.validity(s) == 1.0f);
        REQUIRE(v.isValid(s));
        REQUIRE(v.gradient(s) == v.radiance(s) + 4);
    }
    fillRandom(v, 1);
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        v.validity(s) = static_cast<float>(s);
        v.distance(s) = static_cast<float>(s) * 2;
    }
    IrradianceVolume expected
        = uniformVolume(2, GradientStorage::PerCoefficient, {0, 0, 0}, {2, 2, 2});
    fillRandom(expected, 1);
    for (SampleId s = 0; s < v.sampleCount(); ++s) {
        REQUIRE(std::equal(v.radiance(s), v.radiance(s) + 16, expected.radiance(s)));
        REQUIRE(v.validity(s) == static_cast<float>(s));
        REQUIRE(v.distance(s) == static_cast<float>(s) * 2);
    }
    v.validity(0) = std::nextafter(kValidThreshold, 0.0f);
    v.validity(1) = kValidThreshold;
    CHECK_FALSE(v.isValid(0));
    CHECK(v.isValid(1));
    v.validity(2) = static_cast<float>(kNan);
    CHECK_FALSE(v.isValid(2));
}

TEST_CASE("levels 0 to 7, 2:1 balanced, negative coordinates, gaps", "[volume][levels]")
{
    const std::vector<BoxCell> cells = multiLevelCells();
    const IrradianceVolume v = volumeOf(cells);
    checkTopology(v, cells);
    std::vector<std::size_t> byLevel(8, 0);
    for (const BoxCell& c : cells) ++byLevel[static_cast<std::size_t>(c.level)];
    for (std::size_t n : byLevel) CHECK(n > 0);
    CHECK(v.cellsByLevel() == byLevel);
    CHECK(v.minLattice() == Coord(-384));
    CHECK(v.maxLattice() == Coord(384));
    CHECK(v.minLattice().x < 0);

    CounterRng rng(5);
    int found = 0, missing = 0, wrong = 0;
    for (int k = 0; k < 3000; ++k) {
        Coord p;
        for (int a = 0; a < 3; ++a) {
            p[a] = static_cast<int>(std::floor((rng.nextDouble() - 0.5) * 800));
            if (k % 2) p[a] /= 8; // more of them near the fine cells
        }
        const BoxCell* reference = searchCell(cells, p);
        const CellId id = v.findCell(p);
        ++(reference ? found : missing);
        wrong += (id == kNoCell) != (reference == nullptr)
            || (reference
                && (v.cell(id).origin != reference->origin
                    || v.cell(id).level != reference->level));
    }
    CHECK(wrong == 0);
    CHECK(found > 500);
    CHECK(missing > 100);
}

TEST_CASE("cells of 8 steps and more are tiles of the index tree", "[volume][levels]")
{
    const std::vector<BoxCell> cells = multiLevelCells();
    const IrradianceVolume v = volumeOf(cells);
    const openvdb::Int32Grid& grid = indexGrid(v);
    CHECK(grid.background() == kNoCell);
    std::uint64_t voxels = 0;
    int wrong = 0;
    for (CellId id = 0; id < static_cast<CellId>(v.cellCount()); ++id) {
        const Cell& c = v.cell(id);
        voxels += std::uint64_t{1} << (3 * c.level);
        const openvdb::Coord p(c.origin.x, c.origin.y, c.origin.z);
        // Depth of the value: 3 a leaf's voxel, 2 a tile of 8³ in a node of 128³, 1 a tile of 128³.
        const int expected = c.level < 3 ? 3 : c.level < 7 ? 2 : 1;
        wrong += grid.tree().getValueDepth(p) != expected;
        wrong += !grid.tree().isValueOn(p);
        wrong += grid.tree().getValue(p) != id;
    }
    CHECK(wrong == 0);
    CHECK(grid.activeVoxelCount() == voxels);
    const Vec3d world = v.sampleWorld(0);
    const auto mapped = grid.transform().indexToWorld(
        openvdb::Vec3d(v.samplePosition(0).x, v.samplePosition(0).y, v.samplePosition(0).z));
    CHECK((world - Vec3d(mapped.x(), mapped.y(), mapped.z())).length() == 0);
}

TEST_CASE("the coarsest cell is one tile of the tree's root", "[volume][levels]")
{
    const IrradianceVolume v = volumeOf({{Coord(-4096, 0, 4096), kMaxLevel}});
    CHECK(v.sampleCount() == 8);
    CHECK(v.cellsByLevel().size() == 13);
    CHECK(indexGrid(v).tree().getValueDepth(openvdb::Coord(-1, 4095, 8191)) == 0);
    CHECK(v.findCell({-1, 4095, 8191}) == 0);
    CHECK(v.findCell({0, 4095, 8191}) == kNoCell);
    CHECK(v.memoryBytes() < 1 << 20);
}

TEST_CASE("cells that cannot be are refused when they are added", "[volume][error]")
{
    VolumeBuilder builder(3, GradientStorage::None, Mat4d());
    CHECK(usageError([&] {
        builder.addCell({1, 0, 0}, 1);
    }).find("(1, 0, 0)")
        != std::string::npos);
    CHECK(usageError([&] { builder.addCell({0, -4, 0}, 3); }).find("2^level") != std::string::npos);
    CHECK(usageError([&] { builder.addCell({0, 0, 0}, -1); }) != "");
    CHECK(usageError([&] { builder.addCell({0, 0, 0}, kMaxLevel + 1); }) != "");
    CHECK(usageError([&] { builder.addCell({0, 0, 0}, 31); }) != "");
    CHECK(usageError([&] { builder.addCell({0, 0, 0}, 64); }) != "");
    // A corner beyond int would wrap around.
    CHECK(usageError([&] { builder.addCell({std::numeric_limits<int>::max(), 0, 0}, 0); }) != "");
    CHECK(usageError([&] {
        builder.addUniform(
            {std::numeric_limits<int>::max() - 1, 0, 0}, {std::numeric_limits<int>::max(), 1, 1});
    }) != "");
    CHECK(usageError([&] { builder.addCell({0, std::numeric_limits<int>::min(), 0}, 0); }) != "");
    // None of them is left behind.
    builder.addCell({-8, 0, 0}, 3);
    CHECK(builder.build().cellCount() == 1);
}

TEST_CASE(
    "an empty volume, overlaps, jumps of level and too long axes are refused", "[volume][error]")
{
    const auto build
        = [](const std::vector<BoxCell>& cells) { return usageError([&] { volumeOf(cells); }); };
    CHECK(build({}).find("no cell") != std::string::npos);
    CHECK(usageError([] {
        uniformVolume(3, GradientStorage::None, {0, 0, 0}, {4, 0, 4});
    }).find("no cell")
        != std::string::npos);
    CHECK(usageError([] {
        uniformVolume(3, GradientStorage::None, {4, 4, 4}, {0, 0, 0});
    }).find("no cell")
        != std::string::npos);
    CHECK(build({{{0, 0, 0}, 0}, {{0, 0, 0}, 0}}).find("overlap") != std::string::npos);
    CHECK(build({{{0, 0, 0}, 2}, {{3, 3, 3}, 0}}).find("overlap") != std::string::npos);
    CHECK(build({{{0, 0, 0}, 7}, {{120, 120, 120}, 3}}).find("overlap") != std::string::npos);
    CHECK(build({{{-8, -8, -8}, 3}, {{-8, -8, -8}, 2}}).find("overlap") != std::string::npos);
    // Level 0 beside level 2, across a face, an edge and a corner, on the low and the high side.
    for (const Coord& p : {Coord(4, 0, 0), Coord(4, 4, 0), Coord(4, 4, 4), Coord(-1, 3, 3),
             Coord(-1, -1, 2), Coord(-1, -1, -1), Coord(0, 4, -1)}) {
        CAPTURE(p);
        const std::string message = build({{{0, 0, 0}, 2}, {p, 0}});
        CHECK(message.find("level only") != std::string::npos);
        CHECK(message.find("level 2") != std::string::npos);
    }
    CHECK(build({{{0, 0, 0}, 2}, {{5, 0, 0}, 0}}) == ""); // they do not touch
    CHECK(build({{{0, 0, 0}, 2}, {{4, 0, 0}, 1}}) == "");
    CHECK(build({{{0, 0, 0}, 0}, {{0, 0, 1 << 21}, 0}}).find("2^21") != std::string::npos);
    CHECK(build({{{0, 0, 0}, 0}, {{0, 0, (1 << 21) - 2}, 0}}) == "");
    CHECK(usageError([] { uniformVolume(0, GradientStorage::None, {0, 0, 0}, {1, 1, 1}); }) != "");
    CHECK(usageError([] {
        uniformVolume(kMaxBands + 1, GradientStorage::None, {0, 0, 0}, {1, 1, 1});
    }) != "");
}

TEST_CASE("the widest volume: both ends of the lattice and of the keys", "[volume][hard]")
{
    const int far = 1000000000;
    const IrradianceVolume a = volumeOf({{{far - 1, -far, far - 1}, 0}});
    CHECK(a.sampleCount() == 8);
    CHECK(a.findSample({far, -far, far}) == 5);
    const int last = (1 << 21) - 2;
    const IrradianceVolume b = volumeOf({{{0, 0, 0}, 0}, {{last, last, last}, 0}});
    CHECK(b.sampleCount() == 16);
    CHECK(b.findSample({last + 1, last + 1, last + 1}) == 15);
    CHECK(b.samplePosition(15) == Coord(last + 1));
}

TEST_CASE("clone is deep, cloneTopology keeps all but the records", "[volume]")
{
    IrradianceVolume v = uniformVolume(
        3, GradientStorage::PerCoefficient, {0, 0, 0}, {3, 3, 3}, latticeTransform(0.25));
    fillRandom(v, 9);
    v.validity(3) = 0.25f;
    v.distance(3) = 7;
    v.metadata().sceneHash = "abc";
    IrradianceVolume copy = v.clone();
    v.radiance(5)[2] = Color(-1.0f);
    v.validity(3) = 1;
    v.metadata().sceneHash = "changed";
    v.setIndexToWorld(latticeTransform(2));
    CHECK(copy.radiance(5)[2] != Color(-1.0f));
    CHECK(copy.validity(3) == 0.25f);
    CHECK(copy.distance(3) == 7);
    CHECK(copy.metadata().sceneHash == "abc");
    CHECK(copy.spacing() == 0.25);
    CHECK(indexGrid(copy).voxelSize().x() == 0.25);
    CHECK(indexGrid(v).voxelSize().x() == 2);
    CHECK(copy.hasGradients());
    CHECK(copy.cellCount() == v.cellCount());

    copy.setOffsets(std::vector<Vec3f>(copy.sampleCount(), Vec3f(0.125f)));
    CellVisibility cut;
    cut.masks = 0x0f;
    copy.setVisibility({{4, cut}});
    const IrradianceVolume shape = copy.cloneTopology(5, GradientStorage::None);
    CHECK(shape.offset(7) == Vec3f(0.125f));
    REQUIRE(shape.visibility(4));
    CHECK(*shape.visibility(4) == cut);
    CHECK(shape.visibility(5) == nullptr);
    CHECK(shape.bands() == 5);
    CHECK_FALSE(shape.hasGradients());
    CHECK(shape.sampleCount() == copy.sampleCount());
    CHECK(shape.spacing() == 0.25);
    for (SampleId s = 0; s < shape.sampleCount(); ++s) {
        REQUIRE(shape.validity(s) == 1);
        REQUIRE(shape.samplePosition(s) == copy.samplePosition(s));
        for (int i = 0; i < 25; ++i) REQUIRE(shape.radiance(s)[i] == Color(0.0f));
    }
    CHECK(usageError([&] { copy.cloneTopology(7, GradientStorage::None); }) != "");
}

TEST_CASE("the transform: rotation, uniform scale and translation, nothing else", "[volume]")
{
    IrradianceVolume v = uniformVolume(1, GradientStorage::None, {0, 0, 0}, {2, 2, 2});
    Mat4d good;
    good.setEulerAngles(Vec3d(0.3, -1.2, 2.5));
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) good[i][j] *= 0.125;
    good[3][0] = 1e6;
    good[3][1] = -5;
    v.setIndexToWorld(good);
    CHECK(v.spacing() == Approx(0.125).epsilon(1e-14));
    const SampleId s = static_cast<SampleId>(v.findSample({1, 2, 0}));
    // Row vectors: p' = p M.
    for (int a = 0; a < 3; ++a) {
        CHECK(v.sampleWorld(s)[a] == Approx(good[0][a] + 2 * good[1][a] + good[3][a]));
    }
    const Vec3d back = v.sampleWorld(s) * v.worldToIndex();
    CHECK((back - Vec3d(1, 2, 0)).length() < 1e-8);
    for (SampleId k = 0; k < v.sampleCount(); ++k) {
        Box3d box = v.worldBounds();
        box.min -= Vec3d(1e-9);
        box.max += Vec3d(1e-9);
        REQUIRE(box.intersects(v.sampleWorld(k)));
    }

    const auto broken = [&](int i, int j, double value) {
        Mat4d m;
        m[i][j] = value;
        return m;
    };
    Mat4d turned; // a mirror in disguise: two axes swapped
    turned[0][0] = turned[1][1] = 0;
    turned[0][1] = turned[1][0] = 1;
    const Mat4d bad[] = {broken(0, 1, 0.01), broken(0, 0, -1), broken(1, 1, 1.01), turned,
        broken(0, 0, kNan), broken(2, 1, kNan), broken(3, 0, kNan), broken(3, 2, 1 / 0.0 * 1),
        broken(0, 3, 0.5), broken(1, 3, kNan), broken(3, 3, 2), broken(3, 3, kNan),
        latticeTransform(0), latticeTransform(-1), latticeTransform(kNan),
        latticeTransform(std::numeric_limits<double>::infinity()), broken(0, 0, 0)};
    for (const Mat4d& m : bad) {
        CAPTURE(m);
        CHECK(usageError([&] { v.setIndexToWorld(m); }).find("transform") != std::string::npos);
        CHECK(usageError([&] {
            uniformVolume(1, GradientStorage::None, {0, 0, 0}, {1, 1, 1}, m);
        }) != "");
        REQUIRE(v.indexToWorld() == good); // a refused matrix changes nothing
    }
}

TEST_CASE("spacings from the smallest that a .vdb can hold to 1e8", "[volume][hard]")
{
    for (const double h : {kMinSpacing, 1e-4, 1e5, 1e8}) {
        IrradianceVolume v
            = uniformVolume(1, GradientStorage::None, {-1, -1, -1}, {1, 1, 1}, latticeTransform(h));
        CHECK(v.spacing() == h);
        CHECK(indexGrid(v).voxelSize().x() == Approx(h));
        CHECK((v.sampleWorld(0) - Vec3d(-h)).length() == 0);
        CHECK((v.sampleWorld(0) * v.worldToIndex() - Vec3d(-1.0)).length() < 1e-12);
    }
    // OpenVDB takes smaller voxels for a singular matrix: that must be a sentence, not its
    // exception, and must leave the volume as it was.
    IrradianceVolume v = uniformVolume(1, GradientStorage::None, {0, 0, 0}, {1, 1, 1});
    for (const double h : {1.9e-5, 1e-5, 1e-8, 1e-30}) {
        CAPTURE(h);
        CHECK(usageError([&] { v.setIndexToWorld(latticeTransform(h)); }).find("scale")
            != std::string::npos);
        CHECK(v.spacing() == 1);
        CHECK(indexGrid(v).voxelSize().x() == 1);
    }
}

TEST_CASE("memory: the seed's 17^3 samples, records and topology apart", "[volume][memory]")
{
    // The seed's table counts 3 bands and 6 bands with gradients: 4913 samples × 4 × bands² colours
    // of 12 bytes = 2,122,416 and 8,489,664 bytes.
    for (const int bands : {3, 6}) {
        const IrradianceVolume v
            = uniformVolume(bands, GradientStorage::PerCoefficient, {0, 0, 0}, {16, 16, 16});
        REQUIRE(v.sampleCount() == 4913);
        const std::size_t records = 4913u * 4 * static_cast<std::size_t>(bands * bands) * 12;
        CHECK(v.memoryBytes() > records);
        // 28 bytes of position, key, validity and distance a sample, 48 a cell, 8 leaves of 4 bytes
        // a voxel in internal nodes of 16³ and 32³ entries (8 bytes each).
        const std::size_t shape = 4913u * 28 + 4096u * 48 + 4096u * 4 + (4096u + 32768u) * 9;
        CHECK(v.memoryBytes() < records + shape + 4096);
    }
    // What a volume is made of does not depend on how it was built: capacity is not memory lost.
    CHECK(uniformVolume(1, GradientStorage::None, {0, 0, 0}, {1, 1, 1}).memoryBytes() < 400000);
}

TEST_CASE("the same cells in any sequence give the same volume", "[volume]")
{
    std::vector<BoxCell> cells = multiLevelCells();
    const IrradianceVolume a = volumeOf(cells);
    std::reverse(cells.begin(), cells.end());
    std::rotate(cells.begin(), cells.begin() + 777, cells.end());
    const IrradianceVolume b = volumeOf(cells);
    REQUIRE(a.cellCount() == b.cellCount());
    for (CellId id = 0; id < static_cast<CellId>(a.cellCount()); ++id) {
        REQUIRE(a.cell(id).origin == b.cell(id).origin);
        REQUIRE(a.cell(id).level == b.cell(id).level);
        REQUIRE(std::equal(a.cell(id).corners, a.cell(id).corners + 8, b.cell(id).corners));
    }
}
