// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/task_arena.h>

#include <algorithm>

namespace lumivdb {

/// Runs @a work on @a threads threads (0: all cores).
template <class Work> void withThreads(int threads, const Work& work)
{
    // Without it TBB prints a warning where there are fewer cores than threads, and ignores some.
    const int workers = std::max(threads, tbb::info::default_concurrency());
    tbb::global_control limit(
        tbb::global_control::max_allowed_parallelism, static_cast<std::size_t>(workers));
    tbb::task_arena arena(threads > 0 ? threads : tbb::task_arena::automatic);
    arena.execute(work);
}

} // namespace lumivdb
