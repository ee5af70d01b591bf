// SPDX-License-Identifier: Apache-2.0
// A Cornell box against the numbers of an independent brute-force tracer (double precision, all
// bounces, standard errors up to 5e-4), which agree with a published render.

#include "scene_makers.h"

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include <cmath>
#include <filesystem>
#include <fstream>

using namespace lumivdb;
using nlohmann::json;

namespace {

Vec3d toVec(const json& j) { return {j[0].get<double>(), j[1].get<double>(), j[2].get<double>()}; }

/// Differences as shares of the largest value of their group, and the worst of all.
struct Worst {
    double share = 0, z = 0;
    std::string where;

    void add(double value, double error, double expected, double expectedError, double largest,
        const std::string& what)
    {
        const double difference = std::abs(value - expected);
        // The reference is printed with five decimals.
        const double sigma = std::hypot(error, expectedError) + 0.5e-5;
        z = std::max(z, difference / sigma);
        if (difference / largest > share) {
            share = difference / largest;
            where = what;
        }
        CAPTURE(what, value, expected, error, expectedError);
        CHECK(difference <= 0.01 * largest);
        CHECK(difference <= 4.5 * sigma); // 153 comparisons: 4.5 keeps a false alarm below 0.1%
    }
};

double largestOf(const json& values)
{
    double largest = 0;
    for (const json& v : values.flatten()) largest = std::max(largest, std::abs(v.get<double>()));
    return largest;
}

} // namespace

TEST_CASE("Cornell box against an independent tracer", "[assets][reference][heavy]")
{
    const std::filesystem::path folder = std::filesystem::path(LUMIVDB_ASSETS) / "cornell-bitterli";
    if (!std::filesystem::exists(folder)) {
        WARN("skipped: " << folder << " is absent");
        return;
    }
    json reference;
    std::ifstream(folder / "reference_irradiance.json") >> reference;
    ProbeOptions options;
    options.rays = 1 << 18;
    Scene scene = loadScene((folder / "cornell-bitterli.glb").string());
    // The reference's light is one-sided; the file calls every material double-sided.
    for (Material& m : scene.materials) m.emitsFrontOnly = true;
    test::Bench bench(std::move(scene), options);

    Worst sh;
    std::uint64_t key = 0;
    for (const json& probe : reference["sh_probes"]) {
        const ProbeResult r = bench.sh(toVec(probe["p"]), 3, ++key);
        const double largest = largestOf(probe["L"]);
        REQUIRE(probe["L"].size() == 9);
        for (std::size_t i = 0; i < 9; ++i) {
            for (int c = 0; c < 3; ++c) {
                const auto channel = static_cast<std::size_t>(c);
                // The reference's basis lacks the Condon–Shortley sign of odd m.
                const int l = degreeOf(static_cast<int>(i)), m = static_cast<int>(i) - l * (l + 1);
                const double sign = m % 2 == 0 ? 1 : -1;
                sh.add(sign * r.value[i][c], r.stderr_[i][c], probe["L"][i][channel],
                    probe["stderr"][i][channel], largest,
                    probe["p"].dump() + " coefficient " + std::to_string(i) + " " + "rgb"[c]);
            }
        }
    }
    WARN("SH: worst difference " << 100 * sh.share << "% of the probe's largest coefficient ("
                                 << sh.where << "), worst z " << sh.z);

    Worst irradiance;
    for (const json& point : reference["irradiance_points"]) {
        const Vec3d n = toVec(point["n"]);
        const ProbeResult r = bench.irradiance(toVec(point["p"]) + n * 1e-5, {Vec3f(n)}, ++key);
        const double largest = largestOf(point["E"]);
        for (int c = 0; c < 3; ++c) {
            const auto channel = static_cast<std::size_t>(c);
            irradiance.add(r.value[0][c], r.stderr_[0][c], point["E"][channel],
                point["stderr"][channel], largest, point["p"].dump() + " E " + "rgb"[c]);
        }
    }
    WARN("irradiance: worst difference " << 100 * irradiance.share << "% of the largest channel ("
                                         << irradiance.where << "), worst z " << irradiance.z);
    CHECK(key == reference["sh_probes"].size() + reference["irradiance_points"].size());
}
