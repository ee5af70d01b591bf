// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file statistics.h
/// What is in a volume file: sizes, topology, channels, health.

#include <lumivdb/core/volume.h>

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace lumivdb {

struct ChannelStatistics {
    std::string name;
    std::string type; ///< OpenVDB value type: vec3s, float, int32
    double min = 0, max = 0, mean = 0; ///< over active values, all components; finite ones only
    std::uint64_t nan = 0; ///< active values with a NaN component
    std::uint64_t activeVoxels = 0; ///< tiles counted by the voxels they cover
    std::uint64_t tiles = 0; ///< active tiles
};

struct VolumeStatistics {
    int formatVersion = 0;
    int bands = 0;
    bool gradients = false;
    bool half = false;
    std::uint64_t samples = 0;
    std::vector<std::uint64_t> cellsByLevel;
    std::uint64_t leafNodes = 0; ///< of the `level` grid
    std::map<int, std::uint64_t>
        tilesBySize; ///< active tiles of the `level` grid by edge length in voxels
    double spacing = 0;
    Box3d bounds;
    std::uint64_t fileBytes = 0;
    std::uint64_t runtimeBytes = 0; ///< IrradianceVolume::memoryBytes
    double bytesPerSample = 0; ///< file bytes / samples
    std::uint64_t uniformEquivalentSamples
        = 0; ///< samples of a uniform grid of the finest spacing over the bounds
    std::vector<ChannelStatistics> channels; ///< and foreign grids of the same types of value
    /// Mean over samples and channels of Σ_m L_lm² per degree l.
    std::vector<double> bandEnergy;
    std::uint64_t cutCells = 0; ///< with CellVisibility
    std::uint64_t movedSamples = 0; ///< measured elsewhere than at their lattice point
    double invalidFraction = 0; ///< samples below kValidThreshold
    double negativeIrradianceFraction = 0; ///< valid samples with a normal of negative irradiance
    /// |∇E_mean| over samples, from gradient channels or else finite differences between corners.
    double gradientP50 = 0, gradientP95 = 0, gradientMax = 0;
    /// Histograms for the readable table: 32 bins of log10(mean irradiance) over samples.
    std::vector<std::uint64_t> irradianceHistogram;
    double irradianceLog10Min = 0, irradianceLog10Max = 0;
    VolumeMetadata metadata;
};

/// Reads @a path and counts. @throws Error(Input) as loadVolume().
VolumeStatistics computeStatistics(const std::string& path);

} // namespace lumivdb
