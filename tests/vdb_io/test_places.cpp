// SPDX-License-Identifier: Apache-2.0
// What goes beyond records: visibility of cells, offsets of samples, bounds.
#include "vdb_test.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/volume_fill.h>
#include <lumivdb/vdb_io/resample.h>
#include <lumivdb/vdb_io/statistics.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <catch2/catch.hpp>
#include <openvdb/openvdb.h>

#include <cmath>
#include <functional>
#include <limits>
#include <map>

using namespace vdb_test;

namespace {

/// Levels 0 to 5: the coarse cells are tiles.
IrradianceVolume cutVolume(int bands = 2, bool gradients = true)
{
    IrradianceVolume volume = adaptiveVolume({-32, 0, 32}, 5, {-30, 2, 33}, bands, gradients);
    cutAndMove(volume, 17);
    return volume;
}

std::string usageError(const std::function<void()>& work)
{
    try {
        work();
    } catch (const Error& e) {
        CHECK(e.code() == ErrorCode::Usage);
        return e.what();
    }
    return {};
}

std::size_t cutCells(const IrradianceVolume& v)
{
    std::size_t n = 0;
    for (std::size_t i = 0; i < v.cellCount(); ++i) n += v.visibility(CellId(i)) != nullptr;
    return n;
}

std::size_t movedSamples(const IrradianceVolume& v)
{
    std::size_t n = 0;
    for (std::size_t s = 0; s < v.sampleCount(); ++s) n += v.offset(SampleId(s)) != Vec3f(0.0f);
    return n;
}

/// Every cell of @a part has the visibility of @a whole, every sample its offset.
void checkPart(const IrradianceVolume& part, const IrradianceVolume& whole)
{
    for (std::size_t i = 0; i < part.cellCount(); ++i) {
        const CellVisibility* a = part.visibility(CellId(i));
        const CellVisibility* b = whole.visibility(whole.findCell(part.cell(CellId(i)).origin));
        REQUIRE((a != nullptr) == (b != nullptr));
        if (a) REQUIRE(*a == *b);
        REQUIRE(part.blocking(CellId(i))
            == whole.blocking(whole.findCell(part.cell(CellId(i)).origin)));
    }
    for (std::size_t s = 0; s < part.sampleCount(); ++s) {
        const auto t = whole.findSample(part.samplePosition(SampleId(s)));
        REQUIRE(part.offset(SampleId(s)) == whole.offset(SampleId(t)));
    }
}

using Grids = std::map<std::string, openvdb::GridBase::Ptr>;

Grids readGrids(const std::string& path)
{
    openvdb::io::File file(path);
    file.open(/*delayLoad=*/false);
    Grids grids;
    const openvdb::GridPtrVecPtr all = file.getGrids();
    for (const openvdb::GridBase::Ptr& grid : *all) grids[grid->getName()] = grid;
    return grids;
}

void writeGrids(const std::string& path, const Grids& grids)
{
    openvdb::GridCPtrVec list;
    for (const auto& [name, grid] : grids) list.push_back(grid);
    openvdb::io::File(path).write(list);
}

std::string refusal(const std::string& path)
{
    try {
        loadVolume(path);
    } catch (const Error& e) {
        CHECK(e.code() == ErrorCode::Input);
        CHECK_THAT(e.what(), Catch::Contains(path));
        return e.what();
    }
    return {};
}

} // namespace

TEST_CASE("visibility, offsets and bounds come back bit for bit")
{
    const TempFolder folder;
    const IrradianceVolume volume = cutVolume();
    REQUIRE(cutCells(volume) > 100);
    REQUIRE(volume.cellsByLevel().size() >= 4); // level 3: tiles
    for (const Codec codec : {Codec::Blosc, Codec::Zip, Codec::None}) {
        SaveOptions options;
        options.codec = codec;
        options.previewVoxel = 0.5;
        saveVolume(volume, folder.file("a.vdb"), options);
        const IrradianceVolume loaded = loadVolume(folder.file("a.vdb"));
        CHECK(difference(volume, loaded) == "");
        saveVolume(loaded, folder.file("b.vdb"), options);
        CHECK(readBytes(folder.file("a.vdb")) == readBytes(folder.file("b.vdb")));
    }
}

TEST_CASE("half precision leaves masks, planes and offsets as they are")
{
    const TempFolder folder;
    const IrradianceVolume volume = cutVolume(1, false);
    SaveOptions options;
    options.half = true;
    options.previewVoxel = -1;
    saveVolume(volume, folder.file("a.vdb"), options);
    const IrradianceVolume loaded = loadVolume(folder.file("a.vdb"));
    CHECK(loaded.radiance(5)[0] != volume.radiance(5)[0]); // rounded
    checkPart(loaded, volume);
    CHECK(loaded.metadata().bounds == volume.metadata().bounds);
    CHECK(readGrids(folder.file("a.vdb")).at("wall_1")->saveFloatAsHalf() == false);
}

TEST_CASE("only what a volume has is written")
{
    const TempFolder folder;
    IrradianceVolume volume = uniformVolume({0, 0, 0}, {3, 3, 3}, 1, false);
    saveVolume(volume, folder.file("plain.vdb"));
    const Grids plain = readGrids(folder.file("plain.vdb"));
    for (const char* name : {"wall_0", "wall_offset", "mask_0", "offset", "blocking"})
        CHECK(plain.count(name) == 0);
    CHECK(!(*plain.at("level"))["lumivdb_cut_cells"]);
    CHECK(!(*plain.at("level"))["lumivdb_lattice_bounds"]);
    cutAndMove(volume, 3);
    saveVolume(volume, folder.file("cut.vdb"));
    const Grids cut = readGrids(folder.file("cut.vdb"));
    for (const char* name : {"wall_0", "wall_1", "wall_2", "wall_offset", "mask_0", "mask_1"})
        CHECK(cut.count(name) == 1);
    CHECK(cut.count("offset") == 1);
    CHECK(cut.count("blocking") == 1);
    CHECK(cut.at("level")->metaValue<std::int64_t>("lumivdb_blocked_cells") > 0);
    CHECK(cut.at("level")->metaValue<std::int64_t>("lumivdb_cut_cells")
        == static_cast<std::int64_t>(cutCells(volume)));
    CHECK(cut.at("level")->metaValue<std::string>("lumivdb_lattice_bounds") == "0 0 0 2 3 3");
    const auto* mask = dynamic_cast<const openvdb::Int32Grid*>(cut.at("mask_1").get());
    REQUIRE(mask);
    const Coord o = volume.cell(0).origin;
    CHECK(static_cast<std::uint32_t>(mask->tree().getValue({o.x, o.y, o.z}))
        == static_cast<std::uint32_t>(volume.visibility(0)->masks >> 32));
}

TEST_CASE("damaged visibility and offsets are refused by name")
{
    struct Case {
        const char* name;
        const char* message;
        std::function<void(Grids&)> damage;
    };
    const auto vectors = [](Grids& g, const char* name) -> openvdb::Vec3SGrid& {
        return *openvdb::gridPtrCast<openvdb::Vec3SGrid>(g.at(name));
    };
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const auto everywhere = [](Grids& g, const char* name, const openvdb::Metadata& value) {
        for (auto& [grid, pointer] : g) pointer->insertMeta(name, value);
    };
    const Case cases[] = {
        {"missing normal", "'wall_1'", [](Grids& g) { g.erase("wall_1"); }},
        {"missing mask", "'mask_1'", [](Grids& g) { g.erase("mask_1"); }},
        {"all six missing", "'wall_0'",
            [](Grids& g) {
                for (const char* n :
                    {"wall_0", "wall_1", "wall_2", "wall_offset", "mask_0", "mask_1"})
                    g.erase(n);
            }},
        {"missing blocking", "'blocking'", [](Grids& g) { g.erase("blocking"); }},
        {"infinite blocking", "'blocking'",
            [&](Grids& g) {
                vectors(g, "blocking").tree().setValueOn({0, 1, 0}, {0, 0, 1 / 0.0f});
            }},
        {"fewer blocks than said", "'lumivdb_blocked_cells'",
            [&](Grids& g) { everywhere(g, "lumivdb_blocked_cells", openvdb::Int64Metadata(1)); }},
        {"missing offsets", "'offset'", [](Grids& g) { g.erase("offset"); }},
        {"NaN normal", "'wall_2'",
            [&](Grids& g) {
                vectors(g, "wall_2").tree().setValueOn({0, 0, 0}, {0, nan, 0});
            }},
        {"infinite wall offset", "'wall_offset'",
            [&](Grids& g) {
                vectors(g, "wall_offset").tree().setValueOn({0, 0, 0}, {0, 0, 1 / 0.0f});
            }},
        {"NaN offset", "'offset'",
            [&](Grids& g) {
                vectors(g, "offset").tree().setValueOn({1, 1, 1}, {nan, 0, 0});
            }},
        {"mask of floats", "'mask_0'",
            [](Grids& g) {
                auto grid = openvdb::FloatGrid::create();
                grid->insertMeta(*g.at("mask_0"));
                grid->setTransform(g.at("mask_0")->transformPtr());
                grid->setName("mask_0");
                g["mask_0"] = grid;
            }},
        {"other voxels", "active voxels",
            [&](Grids& g) {
                vectors(g, "wall_0").tree().setValueOn({50, 0, 0}, {1, 0, 0});
            }},
        {"other transform", "transforms",
            [](Grids& g) {
                g.at("mask_1")->transform().postTranslate({1, 0, 0});
            }},
        {"other metadata", "lumivdb_seed",
            [](Grids& g) {
                g.at("offset")->insertMeta("lumivdb_seed", openvdb::Int64Metadata(1));
            }},
        {"fewer cuts than said", "'lumivdb_cut_cells'",
            [&](Grids& g) { everywhere(g, "lumivdb_cut_cells", openvdb::Int64Metadata(1)); }},
        {"negative count", "'lumivdb_cut_cells'",
            [&](Grids& g) { everywhere(g, "lumivdb_cut_cells", openvdb::Int64Metadata(-1)); }},
        {"fewer moves than said", "'lumivdb_moved_samples'",
            [&](Grids& g) { everywhere(g, "lumivdb_moved_samples", openvdb::Int64Metadata(1)); }},
        {"bounds of five", "'lumivdb_lattice_bounds'",
            [&](Grids& g) {
                everywhere(g, "lumivdb_lattice_bounds", openvdb::StringMetadata("0 0 0 1 1"));
            }},
        {"bounds upside down", "'lumivdb_lattice_bounds'",
            [&](Grids& g) {
                everywhere(g, "lumivdb_lattice_bounds", openvdb::StringMetadata("0 0 0 1 1 0"));
            }},
        {"bounds with more", "'lumivdb_lattice_bounds'",
            [&](Grids& g) {
                everywhere(g, "lumivdb_lattice_bounds", openvdb::StringMetadata("0 0 0 1 1 1 x"));
            }},
    };
    const TempFolder folder;
    const std::string good = folder.file("good.vdb"), bad = folder.file("bad.vdb");
    IrradianceVolume volume = uniformVolume({0, 0, 0}, {4, 4, 4}, 1, false);
    cutAndMove(volume, 3);
    saveVolume(volume, good);
    for (const Case& c : cases) {
        INFO(c.name);
        Grids grids = readGrids(good);
        c.damage(grids);
        writeGrids(bad, grids);
        CHECK_THAT(refusal(bad), Catch::Contains(c.message));
    }
    // Any mask is possible, and alphabetical order is as good as ours.
    Grids grids = readGrids(good);
    auto& mask = *openvdb::gridPtrCast<openvdb::Int32Grid>(grids.at("mask_0"));
    mask.tree().setValueOn({0, 0, 0}, std::numeric_limits<std::int32_t>::min());
    writeGrids(bad, grids);
    CHECK((loadVolume(bad).visibility(0)->masks & 0xffffffffu) == 0x80000000u);
}

TEST_CASE("what cannot be read is not written")
{
    const TempFolder folder;
    IrradianceVolume volume = uniformVolume({0, 0, 0}, {2, 2, 2}, 1, false);
    const auto refused = [&] {
        try {
            saveVolume(volume, folder.file("a.vdb"));
        } catch (const Error& e) {
            return std::string(e.what());
        }
        return std::string();
    };
    CellVisibility v;
    v.offset[1] = std::numeric_limits<float>::infinity();
    volume.setVisibility({{3, v}});
    CHECK_THAT(refused(), Catch::Contains("'wall_offset'"));
    volume.setVisibility({});
    std::vector<Vec3f> offsets(volume.sampleCount(), Vec3f(0.0f));
    offsets[2].y = std::numeric_limits<float>::quiet_NaN();
    volume.setOffsets(offsets);
    CHECK_THAT(refused(), Catch::Contains("'offset'"));
    volume.setOffsets({});
    std::vector<Vec3f> blocking(volume.cellCount(), Vec3f(0.0f));
    blocking[1].z = std::numeric_limits<float>::infinity();
    volume.setBlocking(blocking);
    CHECK_THAT(refused(), Catch::Contains("'blocking'"));
    blocking.pop_back();
    CHECK_THROWS_AS(volume.setBlocking(blocking), Error);
    CHECK(folder.entries() == 0);
}

TEST_CASE("bands, gradients and crops keep visibility and offsets")
{
    const IrradianceVolume volume = cutVolume();
    for (const int bands : {1, 4}) {
        const IrradianceVolume other = withBands(volume, bands);
        CHECK(cutCells(other) == cutCells(volume));
        checkPart(other, volume);
    }
    checkPart(withoutGradients(volume), volume);
    const Box3d all = volume.worldBounds();
    const Vec3d middle = (all.min + all.max) * 0.5;
    const IrradianceVolume part = cropVolume(volume, Box3d(all.min, middle));
    REQUIRE(part.cellCount() < volume.cellCount());
    CHECK(cutCells(part) > 10);
    checkPart(part, volume);
    // The bounds' upper x face is one step inside the volume's, further than the crop.
    REQUIRE(part.metadata().bounds);
    CHECK(part.metadata().bounds->lower == part.minLattice());
    CHECK(part.metadata().bounds->upper == part.maxLattice());
}

TEST_CASE("transforms turn offsets and leave masks")
{
    const IrradianceVolume volume = cutVolume();
    Mat4d m;
    m.setAxisAngle(Vec3d(1, -2, 0.5).normalized(), 1.1);
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) m[i][j] *= 2.5;
    m[3][1] = 7;
    const IrradianceVolume turned = transformVolume(volume, m);
    double worst = 0;
    for (SampleId s = 0; s < volume.sampleCount(); ++s) {
        const Vec3d expected = volume.measuredWorld(s) * m; // a place of the scene moves with it
        worst = std::max(worst, (turned.measuredWorld(s) - expected).length());
    }
    CHECK(worst < 5e-8); // the largest offset, 0.25 · 2.5, in single precision: 0.625 · 2^-24
    CHECK(movedSamples(turned) == movedSamples(volume));
    for (std::size_t i = 0; i < volume.cellCount(); ++i) {
        const CellVisibility *a = volume.visibility(CellId(i)), *b = turned.visibility(CellId(i));
        REQUIRE((a != nullptr) == (b != nullptr));
        if (a) REQUIRE(*a == *b);
    }
    CHECK(turned.metadata().bounds == volume.metadata().bounds);
    const IrradianceVolume up = transformVolume(volume, upAxisRotation("y", "z"));
    CHECK(up.offset(1) == Vec3f(volume.offset(1).x, -volume.offset(1).z, volume.offset(1).y));
}

TEST_CASE("sums and joins want the same walls and places")
{
    const IrradianceVolume a = cutVolume();
    CHECK(difference(addVolumes({&a, &a}, {0.5, 0.5}), addVolumes({&a}, {1.0})) == "");
    IrradianceVolume b = a.clone();
    std::vector<std::pair<CellId, CellVisibility>> cuts;
    for (std::size_t i = 1; i < b.cellCount(); ++i) // not the first
        if (const CellVisibility* v = b.visibility(CellId(i))) cuts.emplace_back(CellId(i), *v);
    b.setVisibility(cuts);
    CHECK_THAT(usageError([&] { addVolumes({&a, &b}, {1, 1}); }), Catch::Contains("sees differs"));
    CHECK_THAT(usageError([&] { joinVolumes({&a, &b}); }), Catch::Contains("sees differs"));
    b = a.clone();
    b.setOffsets({});
    CHECK_THAT(usageError([&] { addVolumes({&a, &b}, {1, 1}); }), Catch::Contains("was moved"));
    CHECK_THAT(usageError([&] { joinVolumes({&a, &b}); }), Catch::Contains("shared sample"));
}

TEST_CASE("tiles join to what was cropped apart")
{
    IrradianceVolume whole = uniformVolume({0, 0, 0}, {8, 4, 4}, 2, true);
    cutAndMove(whole, 5);
    const double h = whole.spacing();
    const auto partOf = [&](double x0, double x1) {
        return cropVolume(whole, Box3d(Vec3d(x0 * h, 0, 0), Vec3d(x1 * h, 4 * h, 4 * h)));
    };
    const IrradianceVolume left = partOf(0, 4), right = partOf(4, 8);
    IrradianceVolume joined = joinVolumes({&left, &right});
    joined.metadata() = whole.metadata(); // the error is not known of parts
    CHECK(difference(joined, whole) == "");
    CHECK(joinVolumes({&right, &left}).metadata().bounds == whole.metadata().bounds);
}

TEST_CASE("filled tiles join to the filled whole")
{
    // Validity is random: about half the samples are filled, those at the border from less.
    IrradianceVolume whole = uniformVolume({0, 0, 0}, {8, 4, 4}, 2, false);
    const double h = whole.spacing();
    const auto partOf = [&](double x0, double x1) {
        IrradianceVolume part
            = cropVolume(whole, Box3d(Vec3d(x0 * h, 0, 0), Vec3d(x1 * h, 4 * h, 4 * h)));
        fillInvalid(part);
        return part;
    };
    const IrradianceVolume left = partOf(0, 4), right = partOf(4, 8);
    fillInvalid(whole);
    IrradianceVolume joined = joinVolumes({&left, &right});
    joined.metadata() = whole.metadata();
    CHECK(difference(joined, whole) == "");
}

TEST_CASE("statistics count cut cells and moved samples")
{
    const TempFolder folder;
    const IrradianceVolume volume = cutVolume();
    saveVolume(volume, folder.file("a.vdb"));
    const VolumeStatistics st = computeStatistics(folder.file("a.vdb"));
    CHECK(st.cutCells == cutCells(volume));
    CHECK(st.movedSamples == movedSamples(volume));
    const auto has = [&st](const std::string& name) {
        return std::any_of(st.channels.begin(), st.channels.end(),
            [&name](const ChannelStatistics& c) { return c.name == name; });
    };
    for (const char* name : {"wall_0", "wall_offset", "mask_1", "offset"}) CHECK(has(name));
}

TEST_CASE("uniform resampling at the old spacing keeps what the finest cells see")
{
    const IrradianceVolume volume = cutVolume(1, false);
    const IrradianceVolume fine
        = resampleUniform(volume, volume.spacing(), Interpolation::Trilinear);
    std::size_t kept = 0, expected = 0;
    for (std::size_t i = 0; i < volume.cellCount(); ++i) {
        const Cell& cell = volume.cell(CellId(i));
        const CellVisibility* old = volume.visibility(CellId(i));
        expected += old && cell.level == 0;
        const CellVisibility* now = fine.visibility(fine.findCell(cell.origin));
        if (!now) continue;
        ++kept;
        REQUIRE(old);
        CHECK(*now == *old);
    }
    CHECK(kept == expected);
    CHECK(cutCells(fine) == expected); // and none elsewhere
    CHECK(expected > 5);
    CHECK(movedSamples(fine) == movedSamples(volume));
}

TEST_CASE("uniform resampling at another spacing drops visibility and scales bounds")
{
    const IrradianceVolume volume = cutVolume(1, false);
    const IrradianceVolume fine
        = resampleUniform(volume, volume.spacing() * 2, Interpolation::Trilinear);
    CHECK_FALSE(fine.hasVisibility());
    CHECK_FALSE(fine.hasOffsets());
    // Lattice −32 … 0 less one step along x, of half the steps: −16 … ceil(−0.5) = 0.
    REQUIRE(fine.metadata().bounds);
    CHECK(fine.metadata().bounds->lower == Coord(-16, 0, 16));
    CHECK(fine.metadata().bounds->upper == Coord(0, 16, 32));
}
