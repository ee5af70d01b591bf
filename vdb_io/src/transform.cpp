// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/vdb_io/resample.h>

#include "records.h"

#include <lumivdb/core/error.h>

#include <cmath>

namespace lumivdb {

namespace {

struct Similarity {
    Mat3d rotation;
    double scale;
};

[[noreturn]] void refuse(const char* what)
{
    throw Error(ErrorCode::Usage,
        std::string("The transform ") + what
            + "; give a rotation, a uniform scale and a translation (row vectors).");
}

Similarity decompose(const Mat4d& m)
{
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j)
            if (!std::isfinite(m[i][j])) refuse("has an entry that is not finite");
    if (m[0][3] != 0 || m[1][3] != 0 || m[2][3] != 0 || m[3][3] != 1) refuse("is not affine");
    const Vec3d rows[3]
        = {{m[0][0], m[0][1], m[0][2]}, {m[1][0], m[1][1], m[1][2]}, {m[2][0], m[2][1], m[2][2]}};
    const double scale = std::cbrt(std::abs(rows[0].cross(rows[1]).dot(rows[2])));
    if (!(scale > 0)) refuse("is singular");
    Similarity s{Mat3d(), scale};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            s.rotation[i][j] = rows[i][j] / scale;
            const double expected = i == j ? 1.0 : 0.0;
            if (std::abs(rows[i].dot(rows[j]) / (scale * scale) - expected) > 1e-6)
                refuse(i == j ? "has a non-uniform scale" : "has shear");
        }
    }
    if (rows[0].cross(rows[1]).dot(rows[2]) < 0) refuse("mirrors");
    return s;
}

/// Turns the three derivatives of each coefficient as a vector: ∇' = ∇ R / scale.
void turnGradient(const Similarity& s, int coefficients, Color* gradient)
{
    for (int c = 0; c < coefficients; ++c) {
        for (int k = 0; k < 3; ++k) {
            Vec3d g;
            for (int a = 0; a < 3; ++a) g[a] = gradient[a * coefficients + c][k];
            for (int a = 0; a < 3; ++a) {
                const double turned
                    = g.x * s.rotation[0][a] + g.y * s.rotation[1][a] + g.z * s.rotation[2][a];
                gradient[a * coefficients + c][k] = static_cast<float>(turned / s.scale);
            }
        }
    }
}

/// Offsets are displacements in world space.
void turnOffsets(const Similarity& s, IrradianceVolume& volume)
{
    if (!volume.hasOffsets()) return;
    std::vector<Vec3f> offsets(volume.sampleCount());
    for (std::size_t i = 0; i < offsets.size(); ++i) {
        const Vec3d o(volume.offset(static_cast<SampleId>(i)));
        offsets[i] = Vec3f(o * s.rotation * s.scale);
    }
    volume.setOffsets(std::move(offsets));
}

} // namespace

IrradianceVolume transformVolume(const IrradianceVolume& volume, const Mat4d& m)
{
    const Similarity similarity = decompose(m);
    const ShRotation rotation(volume.bands(), similarity.rotation);
    IrradianceVolume out = volume.clone();
    out.setIndexToWorld(volume.indexToWorld() * m);
    const int n = volume.coefficients();
    for (std::size_t i = 0; i < out.sampleCount(); ++i) {
        const auto s = static_cast<SampleId>(i);
        rotation.apply(out.radiance(s), out.radiance(s));
        for (int axis = 0; out.hasGradients() && axis < 3; ++axis)
            rotation.apply(out.gradient(s) + axis * n, out.gradient(s) + axis * n);
        if (out.hasGradients()) turnGradient(similarity, n, out.gradient(s));
        out.distance(s) = static_cast<float>(out.distance(s) * similarity.scale);
    }
    turnOffsets(similarity, out);
    return out;
}

Mat4d upAxisRotation(const std::string& from, const std::string& to)
{
    const auto isAxis = [](const std::string& axis) { return axis == "y" || axis == "z"; };
    if (!isAxis(from) || !isAxis(to)) {
        throw Error(ErrorCode::Usage,
            "The up axis must be y or z, not '" + (isAxis(from) ? to : from) + "'.");
    }
    if (from == to) return Mat4d();
    const Mat4d yToZ(1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1);
    return from == "y" ? yToZ : yToZ.transposed();
}

} // namespace lumivdb
