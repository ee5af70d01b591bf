// SPDX-License-Identifier: Apache-2.0
#pragma once

// Shared by the sh_*.cpp files; not installed.

#include <lumivdb/core/error.h>
#include <lumivdb/core/sh.h>

#include <string>

namespace lumivdb::detail {

/// @throws Error(Usage) unless 1 ≤ bands ≤ kMaxBands.
inline void checkBands(int bands)
{
    if (bands < 1 || bands > kMaxBands)
        throw Error(ErrorCode::Usage,
            "spherical harmonics have 1 to " + std::to_string(kMaxBands) + " bands, not "
                + std::to_string(bands) + "; choose a number in that range");
}

} // namespace lumivdb::detail
