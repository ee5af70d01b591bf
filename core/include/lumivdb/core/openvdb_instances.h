// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file openvdb_instances.h
/// OpenVDB with the grids of LumiVDB compiled once.
///
/// OpenVDB's packaged library does not contain its Tree and Grid templates, so every file that
/// makes a grid compiles all of their virtual functions anew: 28 s for one file of vdb_io where
/// 6 s are enough. These declarations say that lumivdb::core has them.

#include <openvdb/openvdb.h>

#define LUMIVDB_OPENVDB_INSTANCE(PREFIX, TreeType)                                                 \
    PREFIX template class openvdb::tree::Tree<openvdb::TreeType::RootNodeType>;                    \
    PREFIX template class openvdb::Grid<openvdb::TreeType>;

#ifndef LUMIVDB_OPENVDB_DEFINE // set by the files that define them
LUMIVDB_OPENVDB_INSTANCE(extern, FloatTree)
LUMIVDB_OPENVDB_INSTANCE(extern, Vec3STree)
LUMIVDB_OPENVDB_INSTANCE(extern, Int32Tree)
#endif
