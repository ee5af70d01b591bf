// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file scene_options.h
/// SCENE and the options that light it: shared by bake, probe, evaluate and render.

#include "common.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/probe.h>
#include <lumivdb/bake/scene.h>
#include <lumivdb/bake/tracer.h>

namespace lumivdb::cli {

class SceneOptions {
public:
    /// The scene as first argument (bake, probe, render).
    void declarePositional(Arguments& arguments);
    /// The scene as --scene (evaluate).
    void declareOption(Arguments& arguments);
    void declareLight(Arguments& arguments);
    /// --light-group NAME. @a help says what it defaults to.
    void declareLightGroup(Arguments& arguments, const std::string& help);
    /// What no single option can check. @throws Error(Usage).
    void validate(const Arguments& arguments) const;

    /// Reads scene and environment, adds the sun, keeps the light group. What was ignored or
    /// repaired goes to @a console.
    std::shared_ptr<const Scene> load(Console& console) const;

    std::string path;
    std::string lightGroup;

private:
    enum class EmissionSides { Material, Front };

    void addSun(Scene& scene) const;

    std::string mEnvironment;
    EnvironmentOptions mEnvironmentOptions;
    double mEnvironmentScale = 1;
    std::optional<Vec3d> mSunDirection;
    std::optional<Vec3d> mSunLux;
    EmissionSides mEmissionSides = EmissionSides::Material;
};

/// --contribution and --max-bounces.
void declareLightTransport(Arguments& arguments, Contribution& contribution, int& maxBounces);

/// @throws Error(Usage) where the two together leave no light.
void validateLightTransport(Contribution contribution, int maxBounces);

/// --integrator path|cached.
void declareIntegrator(Arguments& arguments, Integrator& integrator);

/// Warns when @a volume was baked from another scene than @a scene.
void warnIfSceneDiffers(
    const IrradianceVolume& volume, const std::string& path, const Scene& scene, Console& console);

} // namespace lumivdb::cli
