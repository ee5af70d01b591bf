// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file light_rays.h
/// A light divided into beams, each with a ray at a random place in it. Local space (see
/// tracer_impl.h).

#include "tracer_impl.h"

#include <cstdint>
#include <memory>

namespace lumivdb {

struct RsmOptions; // rsm.h

/// A beam. Its cross-section at distance d is `section + solidAngle · d²`.
struct LightRay {
    Vec3f origin{0, 0, 0};
    Vec3f direction{0, 0, 0}; ///< unit, the way the light travels
    Color flux{0, 0, 0}; ///< carried where nothing is in the way; 0: there is no beam
    float section = 0; ///< world units²
    float solidAngle = 0; ///< sr
};

/// Beams in an order that keeps neighbours together. Const and thread-safe.
class LightRays {
public:
    virtual ~LightRays() = default;
    virtual std::size_t count() const = 0;
    /// The same bits for the same @a i.
    virtual LightRay ray(std::size_t i) const = 0;
    /// KHR_lights_punctual's range, 0: infinite.
    virtual double range() const { return 0; }
};

// Each is null where there is nothing to light or no light.
std::unique_ptr<LightRays> punctualRays(
    const Tracer::Impl& tracer, const Light& light, const RsmOptions& options);
std::unique_ptr<LightRays> emissionRays(const Tracer::Impl& tracer, const RsmOptions& options);
std::unique_ptr<LightRays> environmentRays(const Tracer::Impl& tracer, const RsmOptions& options);

} // namespace lumivdb
