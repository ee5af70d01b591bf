// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file program.h
/// What the benchmarks' programs have in common.

#include <lumivdb/core/types.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <exception>
#include <functional>
#include <map>
#include <string>
#include <type_traits>

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

/// Of all threads: what else the machine does shows little in it.
inline double processorSeconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

/// What sets @a to from text: a flag (0 or not), a number, a string or bounds.
template <class T> std::function<void(const char*)> setting(T& to)
{
    return [&to](const char* text) {
        if constexpr (std::is_same_v<T, bool>)
            to = std::atoi(text) != 0;
        else if constexpr (std::is_integral_v<T>)
            to = static_cast<T>(std::atoll(text));
        else if constexpr (std::is_floating_point_v<T>)
            to = std::atof(text);
        else if constexpr (std::is_same_v<T, std::string>)
            to = text;
        else
            to = parseBounds(text);
    };
}

/// Reads the arguments from the second on, key=value each. @return whether all keys are known.
inline bool readSettings(
    int argc, char** argv, const std::map<std::string, std::function<void(const char*)>>& settings)
{
    for (int i = 2; i < argc; ++i) {
        const char* const equals = std::strchr(argv[i], '=');
        const auto found = settings.find(std::string(argv[i], equals ? equals - argv[i] : 0));
        if (found == settings.end()) return false;
        found->second(equals + 1);
    }
    return true;
}

} // namespace lumivdb
