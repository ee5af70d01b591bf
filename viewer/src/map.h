// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file map.h
/// What all maps of a plane through a volume share: where pixels lie, false colours, the legend.

#include <lumivdb/viewer/picture.h>

namespace lumivdb {

constexpr float kOutside = -2; ///< marks in a field of values that are not negative
constexpr float kInvalid = -1;

/// The plane in the world: a corner of the picture and its two edges.
struct Frame {
    Vec3d upperLeft, right, down; ///< right and down span the whole map
    int width, height; ///< pixels of the map

    /// The middle of a pixel.
    Vec3d at(int x, int y) const
    {
        return upperLeft + right * ((x + 0.5) / width) + down * ((y + 0.5) / height);
    }
};

/// @throws Error(Usage) where the plane misses @a box.
Frame frameOf(const Box3d& box, const SliceOptions& options);

/// Black, with room for the legend.
Image emptyMap(const Frame& frame);

struct Range {
    double low = 1, high = 1;
};

/// 1% and 99% of the positive values, kept apart where the field is constant.
Range chooseRange(const std::vector<float>& field);

/// 1024 display colours from low to high: a look-up costs less than OpenImageIO's per pixel.
std::vector<Color> colourTable();
Color lookUp(const std::vector<Color>& table, double unit);

/// Colours of a field of one value a pixel, over the range's logarithm; outside stays black.
void paintField(Image& image, const Frame& frame, const std::vector<float>& field, const Range& r,
    const std::vector<Color>& table);

/// The bar with its ticks in the last kLegendRows rows; numbers are multiplied by @a unit and
/// followed by @a suffix.
void drawLegend(Image& image, int mapHeight, const Range& r, const std::vector<Color>& table,
    double unit, const char* suffix);

/// Centred words in white. False where the system has no font that OpenImageIO finds.
bool drawText(Image& image, int x, int y, const std::string& text);

/// Draws a thin line where a surface of the scene is less than @a pixels pixels from the plane's
/// pixel.
void drawGeometry(Image& image, const Frame& frame, const Tracer& tracer, double pixels);

} // namespace lumivdb
