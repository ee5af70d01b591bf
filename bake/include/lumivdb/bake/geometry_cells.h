// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file geometry_cells.h
/// Which boxes geometry touches: the cells that refinement keeps small and visibility looks into.

#include <lumivdb/bake/tracer.h>

#include <cstdint>
#include <vector>

namespace lumivdb {

/// Exact test of closed boxes against closed triangles (separating axes, Akenine-Möller 2001),
/// found through the tracer's own structure. Alpha-masked triangles count whole. Safe from many
/// threads; the tracer must outlive it.
class GeometryCells {
public:
    explicit GeometryCells(const Tracer& tracer);

    /// Whether a triangle and @a worldBox have a point in common. The tracer keeps vertices in
    /// single precision: a triangle that misses by no more than that rounding touches.
    bool touches(const Box3d& worldBox) const;
    /// The triangles that do, ascending indices into the tracer's own order.
    void collect(const Box3d& worldBox, std::vector<std::uint32_t>& triangles) const;

private:
    const Tracer* mTracer;
    Box3d mLocal; ///< around all triangles, grown by what rounding may add; empty without any
};

} // namespace lumivdb
