// SPDX-License-Identifier: Apache-2.0
// Traces light at a point of a small scene, with the installed library only.
#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/probe.h>

#include <cmath>
#include <cstdio>

int main()
{
    using namespace lumivdb;
    auto scene = std::make_shared<Scene>();
    scene->materials.resize(1);
    Mesh ground;
    ground.positions = {{-1, 0, -1}, {-1, 0, 1}, {1, 0, 1}};
    ground.triangles = {{0, 1, 2}};
    scene->meshes.push_back(ground);
    scene->environment = Environment::constant(Color(1));
    const Tracer tracer(scene);
    const ProbeEstimator estimator(tracer, ProbeOptions());
    ProbeEstimator::Workspace workspace;
    // Nothing is above y = 1: a surface facing up receives E = π L.
    const ProbeResult result = estimator.irradiance({0, 1, 0}, {{0, 1, 0}}, 1, workspace);
    std::printf("E = %.5f, expected pi\n", result.value[0].x);
    return std::abs(result.value[0].x - 3.14159265f) < 0.03f ? 0 : 1;
}
