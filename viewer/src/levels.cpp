// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/viewer/picture.h>

#include "map.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace lumivdb {

namespace {

/// The cell at every pixel.
std::vector<CellId> cellField(const IrradianceVolume& volume, const Frame& f)
{
    std::vector<CellId> field(std::size_t(f.width) * f.height);
    const Coord last = volume.maxLattice() - Coord(1);
    tbb::parallel_for(0, f.height, [&](int y) {
        for (int x = 0; x < f.width; ++x) {
            const Vec3d t = f.at(x, y) * volume.worldToIndex();
            Coord p;
            for (int a = 0; a < 3; ++a) {
                // The upper faces belong to the last cells.
                p[a] = std::min(int(std::floor(t[a])), last[a]);
            }
            field[std::size_t(y) * f.width + x] = volume.findCell(p);
        }
    });
    return field;
}

/// Fine cells bright, coarse ones dark.
std::vector<Color> levelColours(std::size_t levels)
{
    const std::vector<Color> table = colourTable();
    std::vector<Color> colours;
    for (std::size_t k = 0; k < levels; ++k) {
        const double depth = levels > 1 ? double(k) / double(levels - 1) : 0;
        colours.push_back(lookUp(table, 0.95 - 0.8 * depth));
    }
    return colours;
}

/// A swatch for each level, with the width of its cells under it.
void drawLevelLegend(Image& image, int mapHeight, const std::vector<Color>& colours, double spacing)
{
    const int count = int(colours.size()), pitch = image.width / std::max(count, 1);
    for (int k = 0; k < count; ++k) {
        for (int y = 0; y < 16; ++y)
            for (int x = pitch / 8; x < pitch - pitch / 8; ++x)
                image.pixels[std::size_t(mapHeight + 12 + y) * image.width + k * pitch + x]
                    = colours[std::size_t(k)];
        char text[64];
        const double width = std::ldexp(spacing, k);
        if (pitch < 150)
            std::snprintf(text, sizeof text, "%.4g", width);
        else
            std::snprintf(text, sizeof text, "level %d: cells of %.4g", k, width);
        drawText(image, k * pitch + pitch / 2, mapHeight + kLegendRows - 6, text);
    }
}

} // namespace

Image renderLevels(
    const Tracer& tracer, const IrradianceVolume& volume, const SliceOptions& options)
{
    options.validate();
    const Frame frame = frameOf(volume.worldBounds(), options);
    const std::vector<CellId> cells = cellField(volume, frame);
    const std::vector<Color> colours = levelColours(volume.cellsByLevel().size());
    Image image = emptyMap(frame);
    const auto at = [&](int x, int y) { return cells[std::size_t(y) * frame.width + x]; };
    for (int y = 0; y < frame.height; ++y) {
        for (int x = 0; x < frame.width; ++x) {
            const CellId id = at(x, y);
            if (id == kNoCell) continue;
            // The first pixels of a cell, and the map's own border, are its outline.
            const bool outline = x == 0 || y == 0 || at(x - 1, y) != id || at(x, y - 1) != id;
            const Color colour = colours[std::size_t(volume.cell(id).level)];
            image.pixels[std::size_t(y) * image.width + x] = outline ? colour * 0.35f : colour;
        }
    }
    drawGeometry(image, frame, tracer, 1.0);
    drawLevelLegend(image, frame.height, colours, volume.spacing());
    return image;
}

} // namespace lumivdb
