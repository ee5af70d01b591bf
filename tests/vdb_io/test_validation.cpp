// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include <lumivdb/core/error.h>
#include <lumivdb/vdb_io/statistics.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <catch2/catch.hpp>
#include <openvdb/io/Stream.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/Prune.h>

#include <cmath>
#include <fstream>
#include <functional>
#include <limits>
#include <map>

using namespace vdb_test;

namespace {

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

/// What loadVolume() says about @a path; empty when it loads.
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

openvdb::Vec3SGrid& colors(Grids& g, const char* name)
{
    return *openvdb::gridPtrCast<openvdb::Vec3SGrid>(g.at(name));
}
openvdb::FloatGrid& scalars(Grids& g, const char* name)
{
    return *openvdb::gridPtrCast<openvdb::FloatGrid>(g.at(name));
}
openvdb::Int32Grid& levels(Grids& g)
{
    return *openvdb::gridPtrCast<openvdb::Int32Grid>(g.at("level"));
}

template <typename GridType> void mistype(Grids& g, const char* name)
{
    auto grid = GridType::create();
    grid->setName(name);
    grid->setTransform(g.at(name)->transform().copy());
    grid->insertMeta(*g.at(name));
    g[name] = grid;
}

struct Case {
    const char* name;
    const char* message; ///< part of the sentence
    std::function<void(Grids&)> damage;
};

const float kNan = std::numeric_limits<float>::quiet_NaN();
const float kInfinity = std::numeric_limits<float>::infinity();

std::vector<Case> channelCases()
{
    return {
        {"missing coefficient", "'sh_2'", [](Grids& g) { g.erase("sh_2"); }},
        {"missing gradient", "'sh_3_dy'", [](Grids& g) { g.erase("sh_3_dy"); }},
        {"missing validity", "'validity'", [](Grids& g) { g.erase("validity"); }},
        {"missing distance", "'distance'", [](Grids& g) { g.erase("distance"); }},
        {"missing level", "'level'", [](Grids& g) { g.erase("level"); }},
        {"float coefficient", "'sh_1'", [](Grids& g) { mistype<openvdb::FloatGrid>(g, "sh_1"); }},
        {"float level", "'level'", [](Grids& g) { mistype<openvdb::FloatGrid>(g, "level"); }},
        {"integer validity", "'validity'",
            [](Grids& g) { mistype<openvdb::Int32Grid>(g, "validity"); }},
        {"extra voxel", "active voxels",
            [](Grids& g) {
                colors(g, "sh_1").tree().setValueOn({40, 0, 0});
            }},
        {"lacking voxel", "active voxels",
            [](Grids& g) {
                colors(g, "sh_1").tree().setValueOff({1, 1, 1});
            }},
        {"lacking validity voxel", "active voxels",
            [](Grids& g) {
                scalars(g, "validity").tree().setValueOff({1, 1, 1});
            }},
        {"another transform", "transform",
            [](Grids& g) {
                g.at("sh_1")->transform().postTranslate({0.5, 0, 0});
            }},
        {"perspective", "perspective",
            [](Grids& g) {
                g.at("level")->setTransform(openvdb::math::Transform::createFrustumTransform(
                    openvdb::BBoxd({0, 0, 0}, {8, 8, 8}), 0.5, 1.0));
            }},
        {"NaN coefficient", "(2, 1, 0)",
            [](Grids& g) {
                colors(g, "sh_2").tree().setValueOn({2, 1, 0}, openvdb::Vec3s(0, kNan, 0));
            }},
        {"infinite gradient", "'sh_0_dz'",
            [](Grids& g) {
                colors(g, "sh_0_dz").tree().setValueOn({0, 0, 0}, openvdb::Vec3s(0, 0, kInfinity));
            }},
        {"NaN validity", "'validity'",
            [](Grids& g) {
                scalars(g, "validity").tree().setValueOn({0, 0, 0}, kNan);
            }},
        {"negative distance", "'distance'",
            [](Grids& g) {
                scalars(g, "distance").tree().setValueOn({0, 0, 0}, -1.0f);
            }},
    };
}

std::vector<Case> metadataCases()
{
    return {
        {"no metadata on a channel", "no LumiVDB metadata",
            [](Grids& g) { g.at("sh_0")->clearMetadata(), g.at("sh_0")->setName("sh_0"); }},
        {"unknown version", "version 7",
            [](Grids& g) {
                for (auto& [name, grid] : g)
                    grid->insertMeta("lumivdb_version", openvdb::Int32Metadata(7));
            }},
        {"version of another type", "lumivdb_version",
            [](Grids& g) {
                g.at("level")->removeMeta("lumivdb_version");
                g.at("level")->insertMeta("lumivdb_version", openvdb::StringMetadata("1"));
            }},
        {"impossible bands", "bands",
            [](Grids& g) {
                g.at("level")->insertMeta("lumivdb_bands", openvdb::Int32Metadata(9));
            }},
        {"zero bands", "bands",
            [](Grids& g) {
                g.at("level")->insertMeta("lumivdb_bands", openvdb::Int32Metadata(0));
            }},
        {"other gradients", "gradients",
            [](Grids& g) {
                g.at("level")->insertMeta("lumivdb_gradients", openvdb::StringMetadata("some"));
            }},
        {"other quantity", "radiance",
            [](Grids& g) {
                g.at("level")->insertMeta("lumivdb_quantity", openvdb::StringMetadata("flux"));
            }},
        {"channel of another volume", "lumivdb_seed",
            [](Grids& g) { g.at("sh_3")->insertMeta("lumivdb_seed", openvdb::Int64Metadata(5)); }},
    };
}

std::vector<Case> levelCases()
{
    const auto everywhere = [](Grids& g, const std::function<void(openvdb::GridBase&)>& f) {
        for (auto& [name, grid] : g) f(*grid);
    };
    return {
        {"impossible level", "level 13",
            [](Grids& g) {
                levels(g).tree().setValueOn({0, 0, 0}, 13);
            }},
        {"negative level", "level -2",
            [](Grids& g) {
                levels(g).tree().setValueOn({0, 0, 0}, -2);
            }},
        {"two levels in one cell", "valid volume",
            [](Grids& g) {
                levels(g).tree().setValueOn({0, 0, 0}, 1);
            }},
        {"level without its cell", "valid volume",
            [](Grids& g) {
                levels(g).tree().setValueOn({1, 1, 1}, 1);
            }},
        {"cell where a sample was", "valid volume",
            [](Grids& g) {
                levels(g).tree().setValueOn({4, 4, 4}, 0);
            }},
        {"isolated lone sample", "valid volume",
            [](Grids& g) {
                levels(g).tree().setValueOn({100, 100, 100}, -1);
            }},
        {"enormous tile", "2^31 cells",
            [](Grids& g) {
                levels(g).tree().addTile(3, {4096, 0, 0}, 0, true);
            }},
        {"no cells", "valid volume",
            [everywhere](Grids& g) { everywhere(g, [](openvdb::GridBase& b) { b.clear(); }); }},
        {"shear", "transform",
            [everywhere](Grids& g) {
                openvdb::Mat4R m = openvdb::Mat4R::identity();
                m(1, 0) = 0.5;
                everywhere(g, [&m](openvdb::GridBase& b) {
                    b.setTransform(openvdb::math::Transform::createLinearTransform(m));
                });
            }},
    };
}

} // namespace

TEST_CASE("broken channels, metadata and levels are refused by name")
{
    const TempFolder folder;
    const std::string good = folder.file("good.vdb"), bad = folder.file("bad.vdb");
    SaveOptions options;
    options.previewVoxel = -1;
    saveVolume(uniformVolume({0, 0, 0}, {4, 4, 4}, 2, true), good, options);
    std::size_t cases = 0;
    for (const auto& list : {channelCases(), metadataCases(), levelCases()}) {
        for (const Case& c : list) {
            INFO(c.name);
            Grids grids = readGrids(good);
            c.damage(grids);
            writeGrids(bad, grids);
            CHECK_THAT(refusal(bad), Catch::Contains(c.message));
            CHECK_THROWS_AS(computeStatistics(bad), Error);
            ++cases;
        }
    }
    CHECK(cases == 34);
}

TEST_CASE("a level jump of two is refused")
{
    const TempFolder folder;
    const std::string path = folder.file("jump.vdb");
    VolumeBuilder builder(1, GradientStorage::None, latticeTransform(1.0));
    builder.addCell({0, 0, 0}, 2);
    builder.addCell({4, 0, 0}, 1);
    saveVolume(builder.build(), path);
    Grids grids = readGrids(path);
    // The level-1 cell becomes eight of level 0 beside the level-2 one.
    levels(grids).tree().fill(openvdb::CoordBBox({4, 0, 0}, {5, 1, 1}), 0);
    writeGrids(path, grids);
    CHECK_THAT(refusal(path), Catch::Contains("valid volume"));
}

TEST_CASE("files of other kinds are refused")
{
    const TempFolder folder;
    CHECK_THAT(refusal(folder.file("absent.vdb")), Catch::Contains("does not exist"));
    CHECK_THAT(refusal(folder.path().string()), Catch::Contains("not a file"));
    writeBytes(folder.file("empty.vdb"), {});
    CHECK_THAT(refusal(folder.file("empty.vdb")), Catch::Contains("not an OpenVDB file"));
    writeBytes(folder.file("text.vdb"), std::vector<char>(5000, 'x'));
    CHECK_THAT(refusal(folder.file("text.vdb")), Catch::Contains("not an OpenVDB file"));
    auto density = openvdb::FloatGrid::create();
    density->setName("density");
    writeGrids(folder.file("smoke.vdb"), {{"density", density}});
    CHECK_THAT(refusal(folder.file("smoke.vdb")), Catch::Contains("no LumiVDB metadata"));
    writeGrids(folder.file("none.vdb"), {});
    CHECK_THAT(refusal(folder.file("none.vdb")), Catch::Contains("no LumiVDB metadata"));
}

TEST_CASE("two grids of one name and shared trees are refused")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb");
    saveVolume(uniformVolume({0, 0, 0}, {2, 2, 2}, 1, false), path);
    Grids grids = readGrids(path);
    openvdb::GridCPtrVec list;
    for (const auto& [name, grid] : grids) list.push_back(grid);
    list.push_back(grids.at("sh_0")->deepCopyGrid());
    openvdb::io::File(path).write(list);
    CHECK_THAT(refusal(path), Catch::Contains("twice"));
    scalars(grids, "distance").setTree(scalars(grids, "validity").treePtr());
    writeGrids(path, grids);
    CHECK_THAT(refusal(path), Catch::Contains("shares the tree"));
}

namespace {

/// A grid whose leaves mix active values with those of @a inactive: none but the background, its
/// negative, one other, two or more each have their own form in the file.
template <typename GridType>
typename GridType::Ptr foreignGrid(
    const char* name, const std::vector<float>& inactive, typename GridType::ValueType background)
{
    using Value = typename GridType::ValueType;
    auto grid = GridType::create(background);
    grid->setName(name);
    auto& tree = grid->tree();
    int n = 0;
    for (const openvdb::Coord& p : openvdb::CoordBBox({0, 0, 0}, {47, 7, 7})) { // whole leaves
        if (++n % 5 == 0)
            tree.setValueOn(p, Value(0.5f));
        else
            tree.setValueOff(p, Value(inactive[static_cast<std::size_t>(n) % inactive.size()]));
    }
    tree.fill(openvdb::CoordBBox({0, 0, 128}, {127, 127, 255}), Value(2.0f)); // 4,096 tiles of 8³
    tree.fill(openvdb::CoordBBox({4096, 0, 0}, {8191, 4095, 4095}), Value(3.0f)); // the root's tile
    return grid;
}

Grids foreignGrids()
{
    const openvdb::Vec3s up(0, 0, 1);
    Grids grids;
    grids["f0"] = foreignGrid<openvdb::FloatGrid>("f0", {1}, 1);
    grids["f1"] = foreignGrid<openvdb::FloatGrid>("f1", {-1}, 1);
    grids["f2"] = foreignGrid<openvdb::FloatGrid>("f2", {1, -1}, 1);
    grids["f3"] = foreignGrid<openvdb::FloatGrid>("f3", {2, 3}, 1);
    grids["v0"] = foreignGrid<openvdb::Vec3SGrid>("v0", {7}, up);
    grids["v1"] = foreignGrid<openvdb::Vec3SGrid>("v1", {7, 8}, up);
    grids["v2"] = foreignGrid<openvdb::Vec3SGrid>("v2", {7, 8, 9}, up);
    grids["i0"] = foreignGrid<openvdb::Int32Grid>("i0", {0, 5}, 0);
    grids["empty"] = openvdb::FloatGrid::create();
    grids["empty"]->setName("empty");
    return grids;
}

/// Statistics of all grids in the file agree with the grids.
void checkStatistics(const std::string& path, const Grids& grids)
{
    std::size_t found = 0;
    for (const ChannelStatistics& channel : computeStatistics(path).channels) {
        const auto grid = grids.find(channel.name);
        if (grid == grids.end()) continue;
        CHECK(channel.activeVoxels == grid->second->activeVoxelCount());
        ++found;
    }
    CHECK(found == grids.size());
}

} // namespace

TEST_CASE("foreign grids are read whatever form their values have")
{
    const TempFolder folder;
    const std::string ours = folder.file("ours.vdb"), theirs = folder.file("theirs.vdb");
    saveVolume(uniformVolume({0, 0, 0}, {2, 2, 2}, 1, false), ours);
    Grids grids = readGrids(ours);
    const Grids foreign = foreignGrids();
    grids.insert(foreign.begin(), foreign.end());
    openvdb::GridCPtrVec list;
    for (const auto& [name, grid] : grids) list.push_back(grid);
    for (const std::uint32_t codec : {0, 1, 4}) { // none, zip, Blosc
        for (const std::uint32_t mask : {0u, std::uint32_t{openvdb::io::COMPRESS_ACTIVE_MASK}}) {
            for (const bool asHalf : {false, true}) {
                INFO(codec << " " << mask << " " << asHalf);
                for (const auto& [name, grid] : foreign) grid->setSaveFloatAsHalf(asHalf);
                openvdb::io::File file(theirs);
                file.setCompression(codec | mask);
                file.write(list);
                checkStatistics(theirs, foreign);
                std::ofstream out(theirs, std::ios::binary);
                openvdb::io::Stream stream(out);
                stream.setCompression(codec | mask);
                stream.write(list);
                out.close();
                checkStatistics(theirs, foreign);
            }
        }
    }
}

TEST_CASE("files that another program rewrote are read")
{
    const TempFolder folder;
    const std::string ours = folder.file("ours.vdb"), theirs = folder.file("theirs.vdb");
    IrradianceVolume volume = adaptiveVolume({0, 0, 0}, 5, {1, 2, 3}, 2, true);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) volume.validity(SampleId(i)) = 1.0f;
    saveVolume(volume, ours);

    SECTION("in another order")
    {
        writeGrids(theirs, readGrids(ours)); // alphabetical: distance and validity around the level
        CHECK(difference(volume, loadVolume(theirs)) == "");
    }
    SECTION("with other nodes of the same voxels")
    {
        Grids grids = readGrids(ours);
        openvdb::tools::prune(scalars(grids, "validity").tree());
        openvdb::tools::prune(levels(grids).tree());
        colors(grids, "sh_1").tree().voxelizeActiveTiles();
        writeGrids(theirs, grids);
        CHECK(difference(volume, loadVolume(theirs)) == "");
    }
    SECTION("with the file metadata, as a stream without offsets")
    {
        openvdb::io::File file(ours);
        file.open(false);
        const openvdb::MetaMap::Ptr metadata = file.getMetadata();
        CHECK((*metadata)["lumivdb_footer"]);
        std::ofstream stream(theirs, std::ios::binary);
        openvdb::io::Stream(stream).write(*file.getGrids(), *metadata);
        stream.close();
        CHECK(difference(volume, loadVolume(theirs)) == "");
    }
    SECTION("with grids of its own beside ours")
    {
        Grids grids = readGrids(ours);
        auto extra = openvdb::BoolGrid::create();
        extra->setName("mask");
        grids["mask"] = extra;
        writeGrids(theirs, grids);
        CHECK(difference(volume, loadVolume(theirs)) == "");
    }
}
