// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "sampler_form.h"

namespace lumivdb::detail {

/// The queries, compiled for several processors; Highway takes the best one at run time.
void queryIrradiance(const SamplerForm& form, std::size_t count, const Vec3d* p, const Vec3f* n,
    Color* E, QueryInfo* info);
QueryInfo queryRadiance(const SamplerForm& form, const Vec3d& p, Color* L);

} // namespace lumivdb::detail
