// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <tbb/task_arena.h>

namespace lumivdb {

/// Runs @a work on @a threads threads (0: all cores).
template <class Work> void withThreads(int threads, const Work& work)
{
    tbb::task_arena arena(threads > 0 ? threads : tbb::task_arena::automatic);
    arena.execute(work);
}

} // namespace lumivdb
