// SPDX-License-Identifier: Apache-2.0
/// lumivdb project: SH coefficients of an environment image.

#include "common.h"
#include "numbers.h"
#include "output.h"

#include <lumivdb/bake/environment.h>
#include <lumivdb/core/sh.h>

#include <nlohmann/json.hpp>

namespace lumivdb::cli {

namespace {

class ProjectCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    void validate() const;
    Json report(const std::vector<Vec3d>& coefficients) const;
    std::string shaderText(const std::vector<Vec3d>& coefficients) const;

    CommonOptions mCommon;
    std::string mFile;
    EnvironmentOptions mOptions;
    double mScale = 1;
    int mBands = 3;
    bool mIrradiance = false;
    bool mShader = false;
};

void ProjectCommand::declare(Arguments& arguments)
{
    arguments.positional("ENV", mFile, "environment image: HDR, EXR or another that holds a sky");
    arguments.require();
    arguments.describe("Prints JSON: {\"bands\",\"coefficients\":[[r,g,b],...]}, real orthonormal "
                       "SH of the radiance, index l(l+1)+m.");
    arguments.integer("--bands", mBands, between(1, kMaxBands), "SH bands: N*N coefficients");
    arguments.flag(
        "--irradiance", mIrradiance, "coefficients of the irradiance E(n) instead of the radiance");
    arguments.flag("--shader", mShader,
        "the seven packed constants cAr ... cC of a three-band shader, ready to paste; they give "
        "E(n)/pi, to be multiplied by the albedo, or with --irradiance E(n)");
    arguments.real("--env-scale", mScale, between(0, 1e30), "factor on the radiance");
    arguments.real("--env-rotate", mOptions.rotateDegrees, Range(),
        "degrees to turn the light, right-handed about +Y");
    arguments.choice<EnvironmentProjection>("--env-projection", mOptions.projection,
        {{"auto", EnvironmentProjection::Auto}, {"latlong", EnvironmentProjection::LatLong},
            {"angular", EnvironmentProjection::AngularMap},
            {"cross", EnvironmentProjection::CubeCross}},
        "how the image covers the sphere; auto goes by its aspect: 2:1 latlong, 1:1 angular, 3:4 "
        "or 4:3 cross");
    mCommon.declareJson(arguments, "where the JSON goes [default: standard output]");
    mCommon.declareQuiet(arguments);
    arguments.example("lumivdb project sky.hdr --bands 3", "nine coefficients as JSON");
    arguments.example("lumivdb project sky.hdr --shader > sky.hlsl", "constants for a shader");
}

void ProjectCommand::validate() const
{
    if (mShader && mCommon.jsonToStdout()) {
        failUsage("--shader and --json - both write to standard output; give --json FILE.");
    }
}

Json ProjectCommand::report(const std::vector<Vec3d>& coefficients) const
{
    Json json;
    json["bands"] = mBands;
    json["quantity"] = mIrradiance ? "irradiance" : "radiance";
    json["coefficients"] = Json::array();
    for (std::size_t i = 0; i < coefficients.size(); ++i) {
        const auto l = static_cast<std::size_t>(degreeOf(static_cast<int>(i)));
        json["coefficients"].push_back(
            jsonOf(coefficients[i] * (mIrradiance ? kCosineLobe[l] : 1)));
    }
    json["warnings"] = mCommon.console.warnings();
    return json;
}

std::string constant(const std::string& name, const std::array<float, 4>& v)
{
    std::string line = "static const float4 " + name + " = float4(";
    for (std::size_t i = 0; i < 4; ++i) {
        if (i > 0) line += ", ";
        appendNumber(line, v[i]);
    }
    return line + ");\n";
}

std::string ProjectCommand::shaderText(const std::vector<Vec3d>& coefficients) const
{
    std::vector<Color> L;
    for (const Vec3d& c : coefficients) L.emplace_back(c);
    const ShaderConstants packed = packForShader(
        mBands, L.data(), mIrradiance ? ShaderScale::Irradiance : ShaderScale::DivideByPi);
    std::string text = mIrradiance ? "// E(n)" : "// E(n)/pi: multiply by the albedo";
    text += "; n is the unit normal, v = float4(n, 1), vB = n.xyzz * n.yzzx:\n"
            "// float3(dot(cAr,v), dot(cAg,v), dot(cAb,v))\n"
            "//     + float3(dot(cBr,vB), dot(cBg,vB), dot(cBb,vB))\n"
            "//     + cC.rgb * (n.x*n.x - n.y*n.y)\n";
    constexpr const char* kChannels[] = {"r", "g", "b"};
    for (std::size_t i = 0; i < 3; ++i) {
        text += constant(std::string("cA") + kChannels[i], packed.cA[i]);
    }
    for (std::size_t i = 0; i < 3; ++i) {
        text += constant(std::string("cB") + kChannels[i], packed.cB[i]);
    }
    return text + constant("cC", packed.cC);
}

void ProjectCommand::run(const Arguments&)
{
    validate();
    mCommon.apply();
    mOptions.scale = static_cast<float>(mScale);
    std::vector<std::string> warnings;
    requireFile(mFile);
    const auto environment = Environment::load(mFile, mOptions, warnings);
    mCommon.console.warn(warnings);
    const std::vector<Vec3d> coefficients = environment->projectDouble(mBands);
    if (mShader) writeStdout(shaderText(coefficients));
    if (!mShader || !mCommon.json.empty()) {
        const std::string text = jsonText(report(coefficients));
        writeText(mCommon.json.empty() ? "-" : mCommon.json, text);
    }
}

} // namespace

std::unique_ptr<Command> makeProjectCommand() { return std::make_unique<ProjectCommand>(); }

} // namespace lumivdb::cli
