// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/sampler.h>

#include "sampler_kernels.h"

#include <lumivdb/core/error.h>

namespace lumivdb {

const char* name(Interpolation mode)
{
    switch (mode) {
    case Interpolation::Nearest:
        return "nearest";
    case Interpolation::Taylor:
        return "taylor";
    case Interpolation::Trilinear:
        return "trilinear";
    case Interpolation::Gradient:
        return "gradient";
    case Interpolation::Tricubic:
        return "tricubic";
    case Interpolation::InverseDistance:
        return "idw";
    }
    return "trilinear";
}

bool needsGradients(Interpolation mode)
{
    return mode == Interpolation::Taylor || mode == Interpolation::Gradient
        || mode == Interpolation::Tricubic;
}

Interpolation VolumeSampler::bestMode(const IrradianceVolume& volume)
{
    return volume.hasGradients() ? Interpolation::Gradient : Interpolation::Trilinear;
}

VolumeSampler::VolumeSampler(const IrradianceVolume& volume, Interpolation mode)
    : VolumeSampler(volume, SamplerOptions{mode, Precision::Float, 0})
{
}

VolumeSampler::VolumeSampler(const IrradianceVolume& volume, const SamplerOptions& options)
    : mOptions(options)
{
    if (needsGradients(options.mode) && !volume.hasGradients()) {
        throw Error(ErrorCode::Usage,
            std::string("Interpolation mode '") + name(options.mode)
                + "' needs gradients and the volume has none; bake it with gradients or take "
                  "'trilinear'.");
    }
    mForm = detail::compileSampler(volume, options);
}

VolumeSampler::~VolumeSampler() = default;

std::size_t VolumeSampler::memoryBytes() const { return mForm->memoryBytes(); }

QueryInfo VolumeSampler::radiance(const Vec3d& p, Color* L) const
{
    return detail::queryRadiance(*mForm, p, L);
}

Color VolumeSampler::irradiance(const Vec3d& p, const Vec3f& n, QueryInfo* info) const
{
    Color E;
    detail::queryIrradiance(*mForm, 1, &p, &n, &E, info);
    return E;
}

void VolumeSampler::irradiance(
    std::size_t count, const Vec3d* p, const Vec3f* n, Color* E, QueryInfo* info) const
{
    detail::queryIrradiance(*mForm, count, p, n, E, info);
}

} // namespace lumivdb
