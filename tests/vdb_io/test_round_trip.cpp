// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <catch2/catch.hpp>

#include <cmath>
#include <cstdint>

using namespace vdb_test;

namespace {

/// load → save → load must be the identity; so must the bytes of the second file be.
void checkRoundTrip(const IrradianceVolume& volume, const SaveOptions& options)
{
    const TempFolder folder;
    const std::string first = folder.file("first.vdb"), second = folder.file("second.vdb");
    saveVolume(volume, first, options);
    const IrradianceVolume loaded = loadVolume(first);
    CHECK(difference(volume, loaded) == "");
    saveVolume(loaded, second, options);
    CHECK(difference(volume, loadVolume(second)) == "");
    CHECK(readBytes(first) == readBytes(second));
    CHECK(folder.entries() == 2);
}

/// Half precision has an 11-bit significand and a smallest step of 2^-24: the nearest half lies
/// within 2^-11 of the value's magnitude, or 2^-25.
void checkHalf(float original, float stored)
{
    const float bound = std::max(std::abs(original) * 0x1p-11f, 0x1p-25f);
    if (std::abs(original - stored) > bound)
        FAIL(original << " became " << stored << " through half");
}

} // namespace

TEST_CASE("a volume comes back bit for bit for every number of bands")
{
    for (int bands = 1; bands <= 6; ++bands) {
        for (const bool gradients : {false, true}) {
            INFO(bands << " bands, gradients " << gradients);
            checkRoundTrip(uniformVolume({-3, 5, -9}, {4, 10, 2}, bands, gradients), {});
        }
    }
}

TEST_CASE("every codec is lossless")
{
    const IrradianceVolume volume = uniformVolume({0, 0, 0}, {17, 9, 8}, 3, true);
    for (const Codec codec : {Codec::Blosc, Codec::Zip, Codec::None}) {
        SaveOptions options;
        options.codec = codec;
        checkRoundTrip(volume, options);
    }
}

TEST_CASE("half precision rounds once and distances not at all")
{
    const TempFolder folder;
    const IrradianceVolume volume = uniformVolume({-12, 0, 0}, {11, 23, 23}, 3, true);
    SaveOptions options;
    options.half = true;
    saveVolume(volume, folder.file("a.vdb"), options);
    const IrradianceVolume rounded = loadVolume(folder.file("a.vdb"));
    REQUIRE(rounded.sampleCount() == volume.sampleCount());
    std::size_t different = 0;
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        for (int c = 0; c < volume.coefficients(); ++c) {
            for (int k = 0; k < 3; ++k) {
                checkHalf(volume.radiance(s)[c][k], rounded.radiance(s)[c][k]);
                checkHalf(volume.gradient(s)[c][k], rounded.gradient(s)[c][k]);
                different += volume.radiance(s)[c][k] != rounded.radiance(s)[c][k];
            }
        }
        REQUIRE(volume.distance(s) == rounded.distance(s));
        REQUIRE(volume.validity(s) == rounded.validity(s));
    }
    CHECK(different > volume.sampleCount()); // it did round
    saveVolume(rounded, folder.file("b.vdb"), options);
    CHECK(difference(rounded, loadVolume(folder.file("b.vdb"))) == "");
    saveVolume(volume, folder.file("full.vdb"));
    CHECK(std::filesystem::file_size(folder.file("a.vdb"))
        < 0.7 * static_cast<double>(std::filesystem::file_size(folder.file("full.vdb"))));
}

TEST_CASE("adaptive volumes come back bit for bit")
{
    for (const int root : {1, 3, 4, 5, 7, 8}) {
        INFO("root level " << root);
        const int size = 1 << root;
        const Coord origin(-size, size, 0);
        SaveOptions options;
        options.previewVoxel = size * 0.25 / 16; // spacing is 0.25
        checkRoundTrip(
            adaptiveVolume(origin, root, origin + Coord(size / 3 + 1), 2, true), options);
        checkRoundTrip(adaptiveVolume(origin, root, origin, 1, false), options);
        checkRoundTrip(adaptiveVolume(origin, root, origin + Coord(size), 1, false), options);
    }
}

TEST_CASE("coarse cells beside each other and lone ones come back")
{
    for (const int level : {0, 1, 2, 3, 4, 6, 7, 8, 12}) {
        INFO("level " << level);
        const int size = 1 << level;
        for (const Coord& origin : {Coord(0, 0, 0), Coord(-size, -2 * size, size)}) {
            VolumeBuilder builder(2, GradientStorage::None, latticeTransform(1.0));
            builder.addCell(origin, level);
            builder.addCell(origin + Coord(size, 0, 0), level);
            IrradianceVolume volume = builder.build();
            fillRandom(volume, 5);
            SaveOptions options;
            options.previewVoxel = size / 8.0;
            checkRoundTrip(volume, options);
        }
    }
}

TEST_CASE("random forests of cells come back bit for bit")
{
    CounterRng rng(99);
    for (int trial = 0; trial < 12; ++trial) {
        // Blocks of 32³, each uniform at level 2 or 3, which is 2:1 balanced; gaps between them.
        VolumeBuilder builder(1, GradientStorage::None, latticeTransform(0.1));
        int blocks = 0;
        for (int b = 0; b < 27; ++b) {
            if (rng.next() < 0.5f) continue;
            ++blocks;
            const Coord base = Coord(b % 3 - 1, b / 3 % 3 - 1, b / 9 - 1) * 32;
            const int size = rng.next() < 0.5f ? 8 : 4;
            for (int x = 0; x < 32; x += size)
                for (int y = 0; y < 32; y += size)
                    for (int z = 0; z < 32; z += size)
                        builder.addCell(base + Coord(x, y, z), size == 8 ? 3 : 2);
        }
        if (blocks == 0) continue;
        IrradianceVolume volume = builder.build();
        fillRandom(volume, static_cast<std::uint64_t>(trial));
        SaveOptions options;
        options.previewVoxel = 0.4;
        checkRoundTrip(volume, options);
    }
}

TEST_CASE("large coordinates and extreme spacings come back")
{
    for (const double spacing : {1e-4, 1.0, 1e4}) {
        Mat4d m = latticeTransform(spacing);
        m[3][0] = 1e6;
        m[3][1] = -1e6 + 0.1;
        VolumeBuilder builder(2, GradientStorage::None, m);
        builder.addUniform({1000000, -1000000, 524287}, {1000003, -999998, 524289});
        IrradianceVolume volume = builder.build();
        fillRandom(volume, 3);
        SaveOptions options;
        checkRoundTrip(volume, options);
        options.previewVoxel = -1;
        checkRoundTrip(volume, options);
    }
}

TEST_CASE("a rotated lattice comes back")
{
    Mat4d m;
    m.setAxisAngle(Vec3d(1, 2, 3).normalized(), 0.7);
    m = latticeTransform(0.3) * m;
    m[3][2] = -5.5;
    VolumeBuilder builder(3, GradientStorage::PerCoefficient, m);
    builder.addUniform({0, 0, 0}, {3, 3, 3});
    IrradianceVolume volume = builder.build();
    fillRandom(volume, 3);
    checkRoundTrip(volume, {});
}

TEST_CASE("file names may hold any character")
{
    const TempFolder folder;
    const IrradianceVolume volume = uniformVolume({0, 0, 0}, {1, 1, 1}, 1, false);
    for (const char* name : {"Gebäude 日本語 ☀.vdb", "a'b\"c;d.vdb", "no_extension", "-dash.vdb"}) {
        saveVolume(volume, folder.file(name));
        CHECK(difference(volume, loadVolume(folder.file(name))) == "");
    }
    CHECK(folder.entries() == 4);
}

TEST_CASE("equal volumes make equal files and different ones different identities")
{
    const TempFolder folder;
    IrradianceVolume volume = uniformVolume({0, 0, 0}, {5, 5, 5}, 2, false);
    saveVolume(volume, folder.file("a.vdb"));
    saveVolume(volume, folder.file("b.vdb"));
    CHECK(readBytes(folder.file("a.vdb")) == readBytes(folder.file("b.vdb")));
    volume.radiance(3)[1].y += 1.0f;
    saveVolume(volume, folder.file("c.vdb"));
    const std::vector<char> a = readBytes(folder.file("a.vdb")),
                            c = readBytes(folder.file("c.vdb"));
    CHECK(std::string(&a[21], 36) != std::string(&c[21], 36));
}
