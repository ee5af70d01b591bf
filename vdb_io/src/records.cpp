// SPDX-License-Identifier: Apache-2.0
#include "records.h"

#include <algorithm>
#include <cstring>

namespace lumivdb {

void copyRecord(const IrradianceVolume& from, SampleId s, IrradianceVolume& to, SampleId t)
{
    const int n = from.coefficients();
    std::copy_n(from.radiance(s), n, to.radiance(t));
    if (from.hasGradients()) std::copy_n(from.gradient(s), 3 * n, to.gradient(t));
    to.validity(t) = from.validity(s);
    to.distance(t) = from.distance(s);
}

bool sameRecord(const IrradianceVolume& a, SampleId s, const IrradianceVolume& b, SampleId t)
{
    const auto bytes = sizeof(Color) * static_cast<std::size_t>(a.coefficients());
    const auto same = [](const auto* x, const auto* y, std::size_t size) {
        return std::memcmp(x, y, size) == 0;
    };
    const float scalarsA[2] = {a.validity(s), a.distance(s)};
    const float scalarsB[2] = {b.validity(t), b.distance(t)};
    return same(a.radiance(s), b.radiance(t), bytes)
        && (!a.hasGradients() || same(a.gradient(s), b.gradient(t), 3 * bytes))
        && same(scalarsA, scalarsB, sizeof scalarsA);
}

void forgetError(VolumeMetadata& metadata)
{
    metadata.errorReached = -1.0;
    metadata.errorConfidence = 0.0;
}

} // namespace lumivdb
