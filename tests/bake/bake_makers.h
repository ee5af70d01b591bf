// SPDX-License-Identifier: Apache-2.0
#pragma once

// Small bakes and what their tests share.

#include "scene_makers.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/core/error.h>

#include <cstring>
#include <string>

namespace lumivdb::test {

constexpr double kPi = 3.14159265358979323846;

inline std::unique_ptr<Tracer> makeTracer(Scene scene)
{
    return std::make_unique<Tracer>(std::make_shared<Scene>(std::move(scene)));
}

inline BakeOptions bakeOptions(double spacing, const Vec3d& lower, const Vec3d& upper, int rays)
{
    BakeOptions o;
    o.spacing = spacing;
    o.bounds = Box3d(lower, upper);
    o.probe.rays = rays;
    return o;
}

/// A room [0,size]³ with a coloured wall, a light panel under the ceiling and a lamp: direct light,
/// bounces, punctual light, shadows.
inline Scene litRoom(const Vec3d& lower = Vec3d(0.0), double size = 1.6, bool doubleSided = false)
{
    Scene scene;
    const int white = addMaterial(scene, Color(0.6f), Color(0.0f), doubleSided);
    const int red = addMaterial(scene, Color(0.7f, 0.1f, 0.1f), Color(0.0f), doubleSided);
    const int panel = addMaterial(scene, Color(0.0f), Color(4, 3, 2), true);
    addInwardBox(scene, white, lower, Vec3d(size));
    scene.meshes[1].material = red;
    addQuad(
        scene, panel, lower + Vec3d(0.3, 0.95, 0.3) * size, {0.4 * size, 0, 0}, {0, 0, 0.4 * size});
    Light lamp;
    lamp.position = lower + Vec3d(0.8, 0.33, 0.71) * size;
    lamp.intensity = Color(0.2f, 0.3f, 0.5f) * static_cast<float>(size * size);
    scene.lights.push_back(lamp);
    return scene;
}

/// Whether two samples' records are the same bits.
inline bool sameRecord(
    const IrradianceVolume& a, SampleId sa, const IrradianceVolume& b, SampleId sb)
{
    const auto bytes = static_cast<std::size_t>(a.coefficients()) * sizeof(Color);
    const float fa[2] = {a.validity(sa), a.distance(sa)}, fb[2] = {b.validity(sb), b.distance(sb)};
    return a.hasGradients() == b.hasGradients()
        && std::memcmp(a.radiance(sa), b.radiance(sb), bytes) == 0
        && (!a.hasGradients() || std::memcmp(a.gradient(sa), b.gradient(sb), 3 * bytes) == 0)
        && std::memcmp(fa, fb, sizeof fa) == 0;
}

inline std::size_t differentRecords(const IrradianceVolume& a, const IrradianceVolume& b)
{
    std::size_t different = a.sampleCount() == b.sampleCount() ? 0 : a.sampleCount();
    for (SampleId s = 0; s < a.sampleCount() && s < b.sampleCount(); ++s)
        different += !sameRecord(a, s, b, s);
    return different;
}

/// The message of the Error of kind @a code that @a work throws; "" where it throws none of them.
template <class Work> std::string errorOf(ErrorCode code, const Work& work)
{
    try {
        work();
    } catch (const Error& e) {
        return e.code() == code ? e.what() : "";
    }
    return "";
}

} // namespace lumivdb::test
