// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include <lumivdb/core/error.h>
#include <lumivdb/vdb_io/statistics.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <catch2/catch.hpp>

#include <cmath>
#include <limits>
#include <numeric>

using namespace vdb_test;

namespace {

const ChannelStatistics& channel(const VolumeStatistics& st, const std::string& name)
{
    for (const ChannelStatistics& c : st.channels)
        if (c.name == name) return c;
    throw std::runtime_error("no channel " + name);
}

} // namespace

TEST_CASE("statistics of a volume made by hand")
{
    // 4×2×2 cells of spacing 0.5; L00 = 1 + x (world) grey, L2 (along z) = 0.5, the rest 0.
    IrradianceVolume volume = uniformVolume({0, 0, 0}, {4, 2, 2}, 2, false, 0.5);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        for (int c = 0; c < 4; ++c) volume.radiance(s)[c] = Color(0.0f);
        volume.radiance(s)[0] = Color(static_cast<float>(1 + volume.sampleWorld(s).x));
        volume.radiance(s)[2] = Color(0.5f);
        volume.validity(s) = volume.samplePosition(s).x == 4 ? 0.25f : 1.0f;
        volume.distance(s) = i == 0 ? std::numeric_limits<float>::infinity() : 3.0f;
    }
    // One valid sample whose irradiance is negative along −z:
    // π Y0 L0 − (2π/3) 0.4886 L2 = 0.886 · 1 − 1.023 · 4 < 0.
    volume.radiance(static_cast<SampleId>(volume.findSample({0, 0, 0})))[2] = Color(4.0f);

    const TempFolder folder;
    const std::string path = folder.file("a.vdb");
    saveVolume(volume, path);
    const VolumeStatistics st = computeStatistics(path);
    CHECK(st.formatVersion == 1);
    CHECK(st.bands == 2);
    CHECK_FALSE(st.gradients);
    CHECK_FALSE(st.half);
    CHECK(st.samples == 5u * 3 * 3);
    CHECK(st.cellsByLevel == std::vector<std::uint64_t>{16});
    CHECK(st.leafNodes == 1);
    CHECK(st.tilesBySize.empty());
    CHECK(st.spacing == 0.5);
    CHECK(st.bounds.max == Vec3d(2, 1, 1));
    CHECK(st.fileBytes == std::filesystem::file_size(path));
    CHECK(st.runtimeBytes == volume.memoryBytes());
    CHECK(st.bytesPerSample == Approx(static_cast<double>(st.fileBytes) / 45));
    CHECK(st.uniformEquivalentSamples == 45);
    CHECK(st.metadata.seed == volume.metadata().seed);

    CHECK(st.channels.size() == 9); // color density level validity distance sh_0 … sh_3
    CHECK(st.channels.front().name == "color");
    const ChannelStatistics& l00 = channel(st, "sh_0");
    CHECK(l00.type == "vec3s");
    CHECK(l00.min == 1.0);
    CHECK(l00.max == 3.0);
    CHECK(l00.mean == Approx(2.0)); // x from 0 to 2, evenly
    CHECK(l00.nan == 0);
    CHECK(l00.activeVoxels == 45);
    CHECK(l00.tiles == 0);
    CHECK(channel(st, "level").type == "int32");
    CHECK(channel(st, "level").min == -1);
    CHECK(channel(st, "distance").mean == 3.0); // the infinite one is left out
    CHECK(channel(st, "distance").max == 3.0);

    // Σ L00² / 45 over x = 1, 1.5, 2, 2.5, 3: (1 + 2.25 + 4 + 6.25 + 9) / 5 = 4.5.
    REQUIRE(st.bandEnergy.size() == 2);
    CHECK(st.bandEnergy[0] == Approx(4.5));
    CHECK(st.bandEnergy[1] == Approx((44 * 0.25 + 16) / 45));
    CHECK(st.invalidFraction == Approx(9.0 / 45));
    CHECK(st.negativeIrradianceFraction == Approx(1.0 / 36));
    // dE/dx = π Y0 everywhere.
    const double slope = 3.14159265358979 * 0.28209479177387814;
    CHECK(st.gradientP50 == Approx(slope).epsilon(1e-6));
    CHECK(st.gradientP95 == Approx(slope).epsilon(1e-6));
    CHECK(st.gradientMax == Approx(slope).epsilon(1e-6));
    CHECK(st.irradianceHistogram.size() == 32);
    CHECK(
        std::accumulate(st.irradianceHistogram.begin(), st.irradianceHistogram.end(), 0ull) == 45);
    CHECK(st.irradianceHistogram.front() == 9);
    CHECK(st.irradianceHistogram.back() == 9);
    CHECK(st.irradianceLog10Min == Approx(std::log10(slope)).margin(1e-6));
    CHECK(st.irradianceLog10Max == Approx(std::log10(3 * slope)).margin(1e-6));
}

TEST_CASE("statistics of adaptive, half and gradient files")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb");
    VolumeBuilder builder(1, GradientStorage::PerCoefficient, latticeTransform(1.0));
    builder.addCell({0, 0, 0}, 7);
    IrradianceVolume volume = builder.build();
    for (SampleId s = 0; s < 8; ++s) {
        volume.radiance(s)[0] = Color(1.0f);
        volume.gradient(s)[0] = Color(0.0f);
        volume.gradient(s)[1] = Color(s < 4 ? 3.0f : 4.0f);
        volume.gradient(s)[2] = Color(0.0f);
    }
    SaveOptions options;
    options.half = true;
    saveVolume(volume, path, options);
    const VolumeStatistics st = computeStatistics(path);
    CHECK(st.half);
    CHECK(st.gradients);
    CHECK(st.cellsByLevel == std::vector<std::uint64_t>{0, 0, 0, 0, 0, 0, 0, 1});
    CHECK(st.tilesBySize == std::map<int, std::uint64_t>{{128, 1}});
    CHECK(st.leafNodes == 7);
    CHECK(st.uniformEquivalentSamples == 129ull * 129 * 129);
    CHECK(channel(st, "sh_0_dy").tiles == 1);
    CHECK(channel(st, "sh_0_dy").activeVoxels == 128ull * 128 * 128 + 7);
    const double unit = 3.14159265358979 * 0.28209479177387814;
    CHECK(st.gradientMax == Approx(4 * unit).epsilon(1e-6));
    CHECK(st.gradientP50 == Approx(4 * unit).epsilon(1e-6));
    CHECK_THROWS_AS(computeStatistics(folder.file("absent.vdb")), Error);
}

TEST_CASE("a black volume has statistics too")
{
    const TempFolder folder;
    VolumeBuilder builder(3, GradientStorage::None, latticeTransform(1.0));
    builder.addCell({0, 0, 0}, 0);
    saveVolume(builder.build(), folder.file("black.vdb"));
    const VolumeStatistics st = computeStatistics(folder.file("black.vdb"));
    CHECK(st.negativeIrradianceFraction == 0);
    CHECK(st.gradientMax == 0);
    CHECK(std::accumulate(st.irradianceHistogram.begin(), st.irradianceHistogram.end(), 0ull) == 0);
}
