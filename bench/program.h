// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file program.h
/// What the benchmarks' programs have in common.

#include <lumivdb/core/types.h>

#include <cstdio>
#include <exception>

namespace lumivdb {

/// @a run's exit code; 3 and the message on stderr where it throws.
inline int runProgram(int (*run)(int, char**), int argc, char** argv)
{
    try {
        return run(argc, argv);
    } catch (const std::exception& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 3;
    }
}

/// "x,y,z,x,y,z"; what is missing is 0.
inline Box3d parseBounds(const char* text)
{
    double v[6] = {};
    std::sscanf(text, "%lf,%lf,%lf,%lf,%lf,%lf", v, v + 1, v + 2, v + 3, v + 4, v + 5);
    return {Vec3d(v[0], v[1], v[2]), Vec3d(v[3], v[4], v[5])};
}

} // namespace lumivdb
