// SPDX-License-Identifier: Apache-2.0
#include "volume_statistics.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

/// Luminance of E averaged over all normals: π Y00 L00.
double meanIrradiance(const Color& l00)
{
    return 3.14159265358979323846 * 0.28209479177387814 * static_cast<double>(luminance(l00));
}

void addEnergy(const IrradianceVolume& volume, VolumeStatistics& st)
{
    st.bandEnergy.assign(static_cast<std::size_t>(volume.bands()), 0.0);
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const Color* L = volume.radiance(static_cast<SampleId>(i));
        for (int c = 0; c < volume.coefficients(); ++c)
            for (int k = 0; k < 3; ++k)
                st.bandEnergy[static_cast<std::size_t>(degreeOf(c))] += double{L[c][k]} * L[c][k];
    }
    for (double& e : st.bandEnergy) e /= 3.0 * static_cast<double>(volume.sampleCount());
}

void addHealth(const IrradianceVolume& volume, VolumeStatistics& st)
{
    std::size_t valid = 0, negative = 0;
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        if (!volume.isValid(s)) continue;
        ++valid;
        negative += minIrradiance(volume.bands(), volume.radiance(s)) < 0;
    }
    const auto samples = static_cast<double>(volume.sampleCount());
    st.invalidFraction = (samples - static_cast<double>(valid)) / samples;
    st.negativeIrradianceFraction
        = valid > 0 ? static_cast<double>(negative) / static_cast<double>(valid) : 0.0;
}

void addHistogram(const IrradianceVolume& volume, VolumeStatistics& st)
{
    constexpr int kBins = 32;
    std::vector<double> logs;
    for (std::size_t i = 0; i < volume.sampleCount(); ++i) {
        const double e = meanIrradiance(volume.radiance(static_cast<SampleId>(i))[0]);
        if (e > 0) logs.push_back(std::log10(e));
    }
    st.irradianceHistogram.assign(kBins, 0);
    if (logs.empty()) return;
    const auto [low, high] = std::minmax_element(logs.begin(), logs.end());
    st.irradianceLog10Min = *low;
    st.irradianceLog10Max = *high;
    const double width = (*high - *low) / kBins;
    for (const double v : logs) {
        const int bin = width > 0 ? static_cast<int>((v - *low) / width) : 0;
        ++st.irradianceHistogram[static_cast<std::size_t>(std::min(bin, kBins - 1))];
    }
}

/// |∇E_mean| of every sample from its gradient channels.
std::vector<double> storedGradients(const IrradianceVolume& volume)
{
    std::vector<double> lengths(volume.sampleCount());
    for (std::size_t i = 0; i < lengths.size(); ++i) {
        const Color* g = volume.gradient(static_cast<SampleId>(i));
        const int n = volume.coefficients();
        lengths[i]
            = Vec3d(meanIrradiance(g[0]), meanIrradiance(g[n]), meanIrradiance(g[2 * n])).length();
    }
    return lengths;
}

/// The same from differences along cell edges, averaged over a sample's edges of each direction.
std::vector<double> edgeGradients(const IrradianceVolume& volume)
{
    struct Sums {
        Vec3d sum{0.0};
        int count[3] = {0, 0, 0};
    };
    std::vector<Sums> sums(volume.sampleCount());
    for (std::size_t id = 0; id < volume.cellCount(); ++id) {
        const Cell& cell = volume.cell(static_cast<CellId>(id));
        const double length = volume.spacing() * (1 << cell.level);
        for (int a = 0; a < 3; ++a) {
            for (int i = 0; i < 8; ++i) {
                if (i & (1 << a)) continue;
                const SampleId lower = cell.corners[i], upper = cell.corners[i | (1 << a)];
                const double slope = (meanIrradiance(volume.radiance(upper)[0])
                                         - meanIrradiance(volume.radiance(lower)[0]))
                    / length;
                for (const SampleId s : {lower, upper}) {
                    sums[s].sum[a] += slope;
                    ++sums[s].count[a];
                }
            }
        }
    }
    std::vector<double> lengths(sums.size());
    for (std::size_t i = 0; i < sums.size(); ++i) {
        Vec3d g;
        for (int a = 0; a < 3; ++a) g[a] = sums[i].sum[a] / std::max(1, sums[i].count[a]);
        lengths[i] = g.length();
    }
    return lengths;
}

void addGradient(const IrradianceVolume& volume, VolumeStatistics& st)
{
    std::vector<double> g = volume.hasGradients() ? storedGradients(volume) : edgeGradients(volume);
    std::sort(g.begin(), g.end());
    const auto quantile = [&g](double q) {
        return g[std::min(
            g.size() - 1, static_cast<std::size_t>(q * static_cast<double>(g.size())))];
    };
    st.gradientP50 = quantile(0.5);
    st.gradientP95 = quantile(0.95);
    st.gradientMax = g.back();
}

} // namespace

void addVolumeStatistics(const IrradianceVolume& volume, VolumeStatistics& st)
{
    st.bands = volume.bands();
    st.gradients = volume.hasGradients();
    st.samples = volume.sampleCount();
    const auto levels = volume.cellsByLevel();
    st.cellsByLevel.assign(levels.begin(), levels.end());
    st.spacing = volume.spacing();
    st.bounds = volume.worldBounds();
    st.runtimeBytes = volume.memoryBytes();
    st.uniformEquivalentSamples = 1;
    const Coord extent = volume.maxLattice() - volume.minLattice();
    for (int a = 0; a < 3; ++a)
        st.uniformEquivalentSamples *= static_cast<std::uint64_t>(extent[a]) + 1;
    st.metadata = volume.metadata();
    for (std::size_t i = 0; i < volume.cellCount(); ++i)
        st.cutCells += volume.visibility(static_cast<CellId>(i)) != nullptr;
    for (std::size_t i = 0; i < volume.sampleCount(); ++i)
        st.movedSamples += volume.offset(static_cast<SampleId>(i)) != Vec3f(0.0f);
    addEnergy(volume, st);
    addHealth(volume, st);
    addHistogram(volume, st);
    addGradient(volume, st);
}

} // namespace lumivdb
