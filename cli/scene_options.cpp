// SPDX-License-Identifier: Apache-2.0
#include "scene_options.h"

#include "interrupt.h"
#include "numbers.h"
#include "output.h"

namespace lumivdb::cli {

void SceneOptions::declarePositional(Arguments& arguments)
{
    arguments.positional("SCENE", path,
        "the scene: glTF 2.0 (.gltf, .glb), or what Assimp reads (.obj, ...); metres, Y up");
    arguments.require();
}

void SceneOptions::declareOption(Arguments& arguments)
{
    arguments.text("--scene", "FILE", path, "the scene that the volume was baked from");
    arguments.require();
}

void SceneOptions::declareLight(Arguments& arguments)
{
    arguments.section("Light");
    arguments.text("--env", "FILE", mEnvironment,
        "environment image (HDR, EXR, ...) that lights the scene from outside [default: none]");
    arguments.real("--env-scale", mEnvironmentScale, between(0, 1e30), "factor on its radiance");
    arguments.real("--env-rotate", mEnvironmentOptions.rotateDegrees, Range(),
        "degrees to turn it, right-handed about +Y");
    arguments.choice<EnvironmentProjection>("--env-projection", mEnvironmentOptions.projection,
        {{"auto", EnvironmentProjection::Auto}, {"latlong", EnvironmentProjection::LatLong},
            {"angular", EnvironmentProjection::AngularMap},
            {"cross", EnvironmentProjection::CubeCross}},
        "how the image covers the sphere; auto goes by its aspect: 2:1 latlong, 1:1 angular, 3:4 "
        "or 4:3 cross");
    arguments.vector("--sun-direction", mSunDirection,
        "adds a sun: a directional light, this is the direction TO it [default: none]");
    const auto lux = [this](const std::string& value) {
        const auto v = parseReals(value);
        const bool good = v && (v->size() == 1 || v->size() == 3);
        if (!good) failValue("--sun-lux", value, "not one number, or three with commas between");
        for (const double x : *v) {
            if (x < 0 || x > 1e30)
                failValue("--sun-lux", value, "out of range; allowed: 0 to 1e30");
        }
        mSunLux = v->size() == 1 ? Vec3d((*v)[0]) : Vec3d((*v)[0], (*v)[1], (*v)[2]);
    };
    arguments.custom("--sun-lux", "E|R,G,B", lux,
        "irradiance of the sun on a surface that faces it, in the scene's units, grey or RGB "
        "[0 to 1e+30; goes with --sun-direction]");
    arguments.choice<EmissionSides>("--emission-sides", mEmissionSides,
        {{"material", EmissionSides::Material}, {"front", EmissionSides::Front}},
        "which sides of emissive double-sided surfaces give light: both, as the material says, or "
        "the front alone, as area lights do in many renderers");
}

void SceneOptions::declareLightGroup(Arguments& arguments, const std::string& help)
{
    arguments.text("--light-group", "NAME", lightGroup,
        "only the light of this group: a light's, node's or emissive material's name, or "
        "'environment' "
            + help);
}

void SceneOptions::validate(const Arguments& arguments) const
{
    for (const char* name : {"--env-scale", "--env-rotate", "--env-projection"}) {
        if (arguments.given(name) && mEnvironment.empty()) {
            failUsage(std::string(name) + " has no effect without --env; give both or none.");
        }
    }
    if (mSunDirection.has_value() != mSunLux.has_value()) {
        failUsage("--sun-direction and --sun-lux make one sun; give both or none.");
    }
    if (mSunDirection && !(mSunDirection->length() > 0)) {
        failUsage("--sun-direction 0,0,0: has no direction; give a vector to the sun.");
    }
}

void SceneOptions::addSun(Scene& scene) const
{
    if (!mSunDirection) return;
    Light sun;
    sun.name = "sun";
    sun.type = LightType::Directional;
    sun.intensity = Color(*mSunLux);
    sun.direction = -mSunDirection->normalized();
    scene.lights.push_back(sun);
}

std::shared_ptr<const Scene> SceneOptions::load(Console& console) const
{
    auto scene = std::make_shared<Scene>(loadScene(path));
    throwIfInterrupted();
    for (const std::string& warning : scene->warnings) {
        // The importer cannot know of the light that these options add.
        const bool isDark = warning.rfind("Nothing emits light", 0) == 0;
        if (!isDark || (mEnvironment.empty() && !mSunDirection)) console.warn(warning);
    }
    if (!mEnvironment.empty()) {
        EnvironmentOptions options = mEnvironmentOptions;
        options.scale = static_cast<float>(mEnvironmentScale);
        std::vector<std::string> warnings;
        requireFile(mEnvironment);
        scene->environment = Environment::load(mEnvironment, options, warnings);
        console.warn(warnings);
        throwIfInterrupted();
    }
    addSun(*scene);
    if (mEmissionSides == EmissionSides::Front) {
        for (Material& material : scene->materials) material.emitsFrontOnly = true;
    }
    if (!lightGroup.empty()) selectLightGroup(*scene, lightGroup);
    updateContentHash(*scene);
    return scene;
}

void declareLightTransport(Arguments& arguments, Contribution& contribution, int& maxBounces)
{
    arguments.integer("--max-bounces", maxBounces, between(-1, 1000000),
        "reflections along a path; 0: direct light only; -1: no limit, ended by Russian roulette");
    arguments.choice<Contribution>("--contribution", contribution,
        {{"all", Contribution::All}, {"direct", Contribution::Direct},
            {"indirect", Contribution::Indirect}},
        "which light to keep: all, direct (straight from emitters, lights and the environment) or "
        "indirect (reflected at least once)");
}

void validateLightTransport(Contribution contribution, int maxBounces)
{
    if (contribution == Contribution::Indirect && maxBounces == 0) {
        failUsage("--contribution indirect with --max-bounces 0 leaves no light; allow a bounce.");
    }
}

void declareIntegrator(Arguments& arguments, Integrator& integrator)
{
    arguments.choice<Integrator>("--integrator", integrator,
        {{"path", Integrator::Path}, {"cached", Integrator::Cached}},
        "how light is traced; path: unbiased path tracing, without limit in accuracy; cached: the "
        "light of all surfaces is solved first, then one ray a direction looks it up: many times "
        "faster inside rooms with many samples, with a small bias that is measured and reported");
}

void warnIfSceneDiffers(
    const IrradianceVolume& volume, const std::string& path, const Scene& scene, Console& console)
{
    const std::string& baked = volume.metadata().sceneHash;
    if (baked.empty() || baked == scene.contentHash) return;
    console.warn("'" + path + "' was baked from another scene or light (content hash " + baked
        + ") than the one given (" + scene.contentHash
        + "): give the same scene and light options as for the bake.");
}

} // namespace lumivdb::cli
