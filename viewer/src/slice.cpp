// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/viewer/picture.h>

#include "map.h"

#include <tbb/parallel_for.h>

#include <algorithm>

namespace lumivdb {

namespace {

/// Mean irradiance (luminance) at pixel centres, or a mark.
std::vector<float> sampleField(const VolumeSampler& sampler, const Frame& f)
{
    constexpr float kMeanFactor = 0.886226925452758014f; // π Y00 = √π / 2
    std::vector<float> field(std::size_t(f.width) * f.height);
    tbb::parallel_for(0, f.height, [&](int y) {
        Color L[kMaxCoefficients];
        for (int x = 0; x < f.width; ++x) {
            const QueryInfo info = sampler.radiance(f.at(x, y), L);
            float& out = field[std::size_t(y) * f.width + x];
            if (info.level < 0)
                out = kOutside;
            else if (info.validity < kValidThreshold)
                out = kInvalid;
            else
                out = std::max(0.0f, kMeanFactor * luminance(L[0]));
        }
    });
    return field;
}

} // namespace

Image renderSlice(
    const IrradianceVolume& volume, const SliceOptions& options, double* low, double* high)
{
    options.validate();
    const VolumeSampler sampler(volume, options.mode);
    const Frame frame = frameOf(volume.worldBounds(), options);
    const std::vector<float> field = sampleField(sampler, frame);
    const Range range = chooseRange(field);
    const std::vector<Color> table = colourTable();

    Image image = emptyMap(frame);
    paintField(image, frame, field, range, table);
    drawLegend(image, frame.height, range, table, 1, "");
    if (low) *low = range.low;
    if (high) *high = range.high;
    return image;
}

} // namespace lumivdb
