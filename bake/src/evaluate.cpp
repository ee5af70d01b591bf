// SPDX-License-Identifier: Apache-2.0
#include "evaluator.h"
#include "threads.h"

#include <lumivdb/core/error.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

void EvaluateOptions::validate() const
{
    if (givenPoints.empty() && (points < 1 || points > 100000000)) {
        throw Error(
            ErrorCode::Usage, "points is " + std::to_string(points) + "; take 1 to 100000000.");
    }
    if (normals < 1 || normals > 4096) {
        throw Error(
            ErrorCode::Usage, "normals is " + std::to_string(normals) + "; take 1 to 4096.");
    }
    if (!weights.empty() && weights.size() != givenPoints.size()) {
        throw Error(ErrorCode::Usage,
            std::to_string(weights.size()) + " weights were given for "
                + std::to_string(givenPoints.size()) + " points; give one for each, or none.");
    }
    if (!(confidence >= 0.5 && confidence < 1)) {
        throw Error(ErrorCode::Usage,
            "confidence is " + std::to_string(confidence) + "; take 0.5 to below 1.");
    }
}

std::vector<Vec3f> uniformNormals(int count)
{
    constexpr double kGoldenAngle = 2.39996322972865332223; // π(3 − √5)
    std::vector<Vec3f> normals(static_cast<std::size_t>(count));
    for (int i = 0; i < count; ++i) {
        const double z = 1 - (2 * i + 1.0) / count, r = std::sqrt(std::max(0.0, 1 - z * z));
        normals[static_cast<std::size_t>(i)]
            = Vec3f(Vec3d(r * std::cos(kGoldenAngle * i), r * std::sin(kGoldenAngle * i), z));
    }
    return normals;
}

EvaluateReport evaluateVolume(const IrradianceVolume& volume, const Tracer& tracer,
    const EvaluateOptions& options, Progress* progress)
{
    options.validate();
    Progress silent;
    Progress& tell = progress ? *progress : silent;
    EvaluateReport report;
    withThreads(options.threads, [&] {
        Evaluator evaluator(volume, tracer, options);
        if (options.givenPoints.empty()) {
            evaluator.addRandom(tell);
        } else {
            evaluator.add(options.givenPoints, options.weights, tell);
        }
        report = evaluator.report(options.confidence);
    });
    return report;
}

} // namespace lumivdb
