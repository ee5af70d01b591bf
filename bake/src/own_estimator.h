// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <lumivdb/bake/probe.h>

#include <tbb/enumerable_thread_specific.h>

namespace lumivdb {

/// An estimator with scratch of its own, by thread: a Workspace belongs to one estimator and
/// thread.
class OwnEstimator {
public:
    OwnEstimator(const Tracer& tracer, const ProbeOptions& options)
        : mEstimator(tracer, options)
    {
    }
    ProbeResult irradiance(const Vec3d& p, const std::vector<Vec3f>& normals, std::uint64_t key)
    {
        return mEstimator.irradiance(p, normals, key, mWorkspaces.local());
    }

private:
    ProbeEstimator mEstimator;
    tbb::enumerable_thread_specific<ProbeEstimator::Workspace> mWorkspaces;
};

} // namespace lumivdb
