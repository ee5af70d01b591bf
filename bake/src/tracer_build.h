// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file tracer_build.h
/// How a tracer comes to its triangles, emitters and Embree's structure (internal to bake).

#include <lumivdb/bake/tracer.h>

namespace lumivdb {

/// Fills @a impl, whose scene is set. @throws Error(Input), see Tracer.
void buildTracer(Tracer::Impl& impl, const TracerOptions& options);

} // namespace lumivdb
