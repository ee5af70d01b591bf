// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/sh.h>

#include "sh_internal.h"

#include <algorithm>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;
// Y_lm as multiples of the monomials 1; x, y, z; xy, yz, zx, 3z² − 1; x² − y².
constexpr double k0 = 0.28209479177387814347; // sqrt(1/(4 pi))
constexpr double k1 = 0.48860251190291992159; // sqrt(3/(4 pi))
constexpr double k2 = 1.09254843059207907054; // sqrt(15/(4 pi)): xy, yz, zx
constexpr double k20 = 0.31539156525252000603; // sqrt(5/(16 pi)): 3z² − 1
constexpr double k22 = 0.54627421529603953527; // sqrt(15/(16 pi)): x² − y²

float dot4(const std::array<float, 4>& a, float x, float y, float z, float w)
{
    return a[0] * x + a[1] * y + a[2] * z + a[3] * w;
}

} // namespace

ShaderConstants packForShader(int bands, const Color* L, ShaderScale scale)
{
    detail::checkBands(bands);
    const double unit = scale == ShaderScale::DivideByPi ? 1.0 / kPi : 1.0;
    const double a0 = kCosineLobe[0] * unit;
    const double a1 = kCosineLobe[1] * unit;
    const double a2 = kCosineLobe[2] * unit;
    ShaderConstants constants;
    for (int c = 0; c < 3; ++c) {
        double l[9] = {};
        for (int i = 0; i < std::min(9, coefficientCount(bands)); ++i) l[i] = L[i][c];
        // The −1 of 3z² − 1 moves to the constant term.
        constants.cA[c] = {static_cast<float>(-a1 * k1 * l[3]), static_cast<float>(-a1 * k1 * l[1]),
            static_cast<float>(a1 * k1 * l[2]),
            static_cast<float>(a0 * k0 * l[0] - a2 * k20 * l[6])};
        constants.cB[c] = {static_cast<float>(a2 * k2 * l[4]), static_cast<float>(-a2 * k2 * l[5]),
            static_cast<float>(3.0 * a2 * k20 * l[6]), static_cast<float>(-a2 * k2 * l[7])};
        constants.cC[c] = static_cast<float>(a2 * k22 * l[8]);
    }
    constants.cC[3] = 1.0f;
    return constants;
}

Color evalShader(const ShaderConstants& constants, const Vec3f& n)
{
    // vB = v.xyzz * v.yzzx
    const float xy = n.x * n.y;
    const float yz = n.y * n.z;
    const float zz = n.z * n.z;
    const float zx = n.z * n.x;
    const float vC = n.x * n.x - n.y * n.y;
    Color sum;
    for (int c = 0; c < 3; ++c)
        sum[c] = dot4(constants.cA[c], n.x, n.y, n.z, 1.0f) + dot4(constants.cB[c], xy, yz, zz, zx)
            + constants.cC[c] * vC;
    return sum;
}

} // namespace lumivdb
