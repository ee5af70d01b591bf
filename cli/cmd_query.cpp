// SPDX-License-Identifier: Apache-2.0
/// lumivdb query: what light arrives at given points, from a volume.

#include "common.h"
#include "interrupt.h"
#include "numbers.h"
#include "points.h"

#include <lumivdb/vdb_io/volume_file.h>

#include <nlohmann/json.hpp>

namespace lumivdb::cli {

namespace {

class QueryCommand : public Command {
public:
    void declare(Arguments& arguments) override;
    void run(const Arguments& arguments) override;

private:
    std::vector<std::string> columns(const PointList& points, int coefficients) const;
    std::vector<double> row(const VolumeSampler& sampler, const PointList& points, std::size_t i,
        std::vector<Color>& sh, std::size_t& outside) const;

    CommonOptions mCommon;
    std::string mVolume;
    std::string mPoints;
    std::optional<Interpolation> mMode;
    double mNormalBias = 0;
    bool mSh = false;
};

void QueryCommand::declare(Arguments& arguments)
{
    arguments.positional("VOLUME.vdb", mVolume, "the volume");
    arguments.require();
    arguments.describe("Prints CSV: x,y,z,nx,ny,nz,Er,Eg,Eb,level,validity; E is the irradiance on "
                       "a surface of that normal, in the volume's units. Without normals the "
                       "columns n and E are left out. Outside the volume level is -1 and E nan.");
    arguments.text("--points", "FILE|-", mPoints,
        "CSV of x,y,z or x,y,z,nx,ny,nz a line, scene units, column names optional; - is standard "
        "input");
    arguments.require();
    declareMode(arguments, mMode);
    arguments.real("--normal-bias", mNormalBias, atLeast(0),
        "looks this far along the normal from each point, scene units: off the surface it is on");
    arguments.flag("--sh", mSh, "also the radiance coefficients: sh_0_r,sh_0_g,sh_0_b,sh_1_r,...");
    mCommon.declareJson(arguments,
        "the same rows as an array of objects; with - they replace the CSV, with FILE they come "
        "besides it");
    mCommon.declareQuiet(arguments);
    arguments.example("echo 0,1,0,0,1,0 | lumivdb query room.vdb --points -",
        "irradiance on a floor-like surface one metre up");
    arguments.example("lumivdb query room.vdb --points probes.csv --sh > light.csv",
        "radiance coefficients at the points of a file");
}

std::vector<std::string> QueryCommand::columns(const PointList& points, int coefficients) const
{
    std::vector<std::string> names{"x", "y", "z"};
    if (!points.normals.empty()) {
        names.insert(names.end(), {"nx", "ny", "nz", "Er", "Eg", "Eb"});
    }
    names.insert(names.end(), {"level", "validity"});
    if (mSh) appendShColumns(names, coefficients);
    return names;
}

std::vector<double> QueryCommand::row(const VolumeSampler& sampler, const PointList& points,
    std::size_t i, std::vector<Color>& sh, std::size_t& outside) const
{
    const Vec3d& p = points.positions[i];
    std::vector<double> values{p.x, p.y, p.z};
    QueryInfo info;
    const bool hasNormal = !points.normals.empty();
    if (hasNormal) {
        const Vec3f& n = points.normals[i];
        const Color E = sampler.irradiance(p, n, &info);
        for (const Vec3f& v : {n, E}) {
            for (int axis = 0; axis < 3; ++axis) values.push_back(jsonNumber(v[axis]));
        }
    }
    if (!hasNormal || mSh) info = sampler.radiance(p, sh.data());
    if (info.level < 0) ++outside;
    values.push_back(info.level);
    values.push_back(jsonNumber(info.validity));
    if (mSh) appendShValues(values, sh.data(), static_cast<int>(sh.size()));
    return values;
}

void QueryCommand::run(const Arguments&)
{
    mCommon.apply({mVolume});
    const PointList points = readPoints(mPoints);
    const IrradianceVolume volume = loadVolume(mVolume);
    throwIfInterrupted();
    const VolumeSampler sampler(
        volume, SamplerOptions{modeFor(mMode, volume, mVolume), Precision::Float, mNormalBias});

    std::vector<Color> sh(static_cast<std::size_t>(volume.coefficients()));
    std::size_t outside = 0;
    RowWriter rows(
        columns(points, volume.coefficients()), !mCommon.jsonToStdout(), !mCommon.json.empty());
    for (std::size_t i = 0; i < points.positions.size(); ++i) {
        if (i % 4096 == 0) throwIfInterrupted();
        rows.add(row(sampler, points, i, sh, outside));
    }
    rows.finish(mCommon.json);
    if (points.positions.empty()) mCommon.console.note("There are no points in '" + mPoints + "'.");
    if (outside > 0) {
        mCommon.console.note(grouped(outside) + " of " + grouped(points.positions.size())
            + " points are outside the volume: level -1, E nan.");
    }
}

} // namespace

std::unique_ptr<Command> makeQueryCommand() { return std::make_unique<QueryCommand>(); }

} // namespace lumivdb::cli
