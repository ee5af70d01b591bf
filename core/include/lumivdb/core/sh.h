// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file sh.h
/// Real spherical harmonics of 1 to 6 bands.
///
/// Basis: real, orthonormal over the sphere, index i = l(l+1)+m, with the Condon–Shortley signs of
/// DirectX: Y0 = 0.282094792, Y1 = −0.488602512 y, Y2 = +0.488602512 z, Y3 = −0.488602512 x,
/// Y4 = 1.092548431 xy, … "Bands" counts the values of the degree l: 3 bands = l ≤ 2 = 9
/// coefficients. Directions are unit vectors; they are not normalised here.
///
/// A *coefficient array* is `coefficientCount(bands)` consecutive values, each one scalar or one
/// Color. Coefficients stored by LumiVDB are those of **radiance** (W·sr⁻¹·m⁻² or nits); see
/// irradiance() for what a surface receives.
///
/// Sources: Sloan, "Stupid Spherical Harmonics Tricks" (GDC 2008); Sloan, "Efficient Spherical
/// Harmonic Evaluation" (JCGT 2(2), 2013); Ramamoorthi & Hanrahan, "An Efficient Representation
/// for Irradiance Environment Maps" (SIGGRAPH 2001); Ivanic & Ruedenberg, J. Phys. Chem. 100
/// (1996) 6342 with the errata of 102 (1998) 9099.

#include <lumivdb/core/types.h>

#include <array>
#include <cstddef>
#include <vector>

namespace lumivdb {

constexpr int kMaxBands = 6;
constexpr int kMaxCoefficients = kMaxBands * kMaxBands;

/// Number of coefficients of @a bands bands: bands².
constexpr int coefficientCount(int bands) { return bands * bands; }

/// Degree l of coefficient @a index.
constexpr int degreeOf(int index)
{
    int l = 0;
    while ((l + 1) * (l + 1) <= index) ++l;
    return l;
}

/// A_l: the clamped cosine max(0, cosθ) in zonal form, so that E_lm = A_l L_lm
/// (Ramamoorthi & Hanrahan 2001, eq. 8): π, 2π/3, π/4, 0, −π/24, 0.
constexpr std::array<double, kMaxBands> kCosineLobe = {3.14159265358979323846,
    2.09439510239319549231, 0.78539816339744830962, 0.0, -0.13089969389957471827, 0.0};

/// Writes Y_0 … Y_{bands²−1} at unit direction @a dir to @a y[bands²]. 1 ≤ bands ≤ 6.
void evalShBasis(int bands, const Vec3d& dir, double* y);
void evalShBasis(int bands, const Vec3f& dir, float* y);

/// The same in structure-of-arrays form for @a count directions: y[i * count + k] = Y_i(dir k).
/// Bitwise equal to the float overload above.
void evalShBasisBatch(
    int bands, std::size_t count, const float* x, const float* yy, const float* z, float* y);

/// What the texels of a cube map stand for.
enum class CubeTexels {
    Areas, ///< radiance that is constant over each texel: the integral of that function
    /// radiance at each texel's centre: Σ L Y(centre) ΔΩ with the texels' exact solid angles
    Centres
};
constexpr int kMaxCubeMapSize = 32768;

/// Projects a cube map: @a out[bands²] = ∫ L Y_i dω.
///
/// @a faces are those along +X, −X, +Y, −Y, +Z, −Z, each @a size × @a size texels of linear RGB,
/// row by row from the top. Texel centre (u, v), u to the right and v downwards in [−1, 1], looks
/// along (1, −v, −u), (−1, −v, u), (u, 1, v), (u, −1, −v), (u, −v, 1), (−u, −v, −1): the directions
/// that OpenGL, Vulkan and Direct3D look a cube map up with. Texels are used as they are, negative
/// and non-finite ones too. Sums in double; the same bits on every machine.
/// @throws Error(Usage) for bands outside 1 … 6, sizes outside 1 … kMaxCubeMapSize, null faces.
void projectCubeMap(int bands, int size, const std::array<const Color*, 6>& faces, Vec3d* out,
    CubeTexels texels = CubeTexels::Areas);
void projectCubeMap(int bands, int size, const std::array<const Color*, 6>& faces, Color* out,
    CubeTexels texels = CubeTexels::Areas);

/// Value of the expanded function at @a dir: Σ c_i Y_i(dir).
Color evalSh(int bands, const Color* c, const Vec3f& dir);
double evalSh(int bands, const double* c, const Vec3d& dir);

/// Irradiance on a surface with unit normal @a n from *radiance* coefficients @a L[bands²]:
/// E(n) = Σ A_l L_lm Y_lm(n), in the units of L times steradian (W·m⁻² or lux). May be slightly
/// negative where the expansion rings; see windowSh().
Color irradiance(int bands, const Color* L, const Vec3f& n);

/// Convolves with a zonal kernel given by its @a bands factors: out_lm = kernel[l] · in_lm.
/// (kCosineLobe turns radiance into irradiance coefficients.) In place is allowed.
void convolveSh(int bands, const double* kernel, const Color* in, Color* out);

/// Σ a_i b_i = ∫ a(ω) b(ω) dω of two band-limited functions.
double dotSh(int bands, const double* a, const double* b);
Color dotSh(int bands, const Color* a, const float* b);

/// Coefficients of the product a(ω)·b(ω), truncated to @a bands bands: exact triple product
/// (Gaunt) integrals. @a out must not alias the inputs.
void productSh(int bands, const double* a, const double* b, double* out);

/// A window over the degrees that trades sharpness for less ringing (negative lobes).
enum class ShWindow {
    None,
    Hanning, ///< ½(1 + cos(π l / w)), w in degrees, here w = bands
    Lanczos, ///< sinc(π l / w)
    /// 1/(1 + λ l²(l+1)²) with the λ that is just enough to keep the *irradiance* of this function
    /// non-negative over the sphere (Sloan 2008, "windowing"; λ found by bisection per function).
    Laplacian
};

/// Per-degree factors of a fixed window: factor[0 … bands−1]; factor[0] = 1.
/// ShWindow::Laplacian takes @a lambda ≥ 0, the others ignore it.
void windowFactors(ShWindow window, int bands, double* factor, double lambda = 0.0);

/// Applies the window to radiance coefficients in place. For ShWindow::Laplacian the smallest λ is
/// found per colour channel and 0 is used where the irradiance is non-negative already.
/// @return the largest λ used (0 for the fixed windows).
double windowSh(ShWindow window, int bands, Color* L);

/// Smallest irradiance over a fixed, uniform set of normals, the lowest of the three channels.
float minIrradiance(int bands, const Color* L);

/// Rotation of SH coefficients, exact to rounding for every band count.
///
/// If f has coefficients c, apply() gives those of f' with f'(d·R) = f(d): the light turns with
/// its directions. R is a 3×3 rotation for row vectors (d' = d * R, see types.h), det R = +1.
/// Block-diagonal matrices per degree by the recurrence of Ivanic & Ruedenberg (1996, errata 1998)
/// in double precision. Cost of construction O(bands³), of apply Σ(2l+1)².
class ShRotation {
public:
    /// @throws Error(Usage) when R is not a rotation to within 1e-6.
    ShRotation(int bands, const Mat3d& R);
    int bands() const { return mBands; }
    /// In place is allowed.
    void apply(const double* in, double* out) const;
    void apply(const Color* in, Color* out) const;
    /// Entry (m, n) of the block of degree l, m, n ∈ [−l, l]: out_{l,m} = Σ_n entry(l,m,n)
    /// in_{l,n}.
    double entry(int l, int m, int n) const;

private:
    int mBands;
    std::vector<double> mBlocks; // blocks of (2l+1)², l = 0 … bands−1, column by column
};

/// ShRotation(bands, R).apply(in, out) to rounding, without building the matrices: faster for a
/// rotation that is used once. In place is allowed. @throws Error(Usage) like ShRotation.
void rotateSh(int bands, const Mat3d& R, const double* in, double* out);
void rotateSh(int bands, const Mat3d& R, const Color* in, Color* out);

/// The seven float4 constants of the DirectX/seed "cAr…cC" irradiance shader.
///
/// With x1 = (dot(cAr,v), …), v = (n, 1); x2 = (dot(cBr,vB), …), vB = n.xyzz * n.yzzx;
/// x3 = cC.rgb * (n.x² − n.y²), the shader's x1 + x2 + x3 is **E(n)/π** when packed with
/// Scale::DivideByPi (what a shader multiplies by albedo) and E(n) with Scale::Irradiance.
/// Exact for 3 bands; fewer bands are padded with zero, more are truncated.
/// cA and cB hold r, g, b in this order; cC.w is 1.
struct ShaderConstants {
    std::array<std::array<float, 4>, 3> cA;
    std::array<std::array<float, 4>, 3> cB;
    std::array<float, 4> cC;
};
enum class ShaderScale { Irradiance, DivideByPi };
ShaderConstants packForShader(int bands, const Color* L, ShaderScale scale);
/// What the shader computes from the constants at unit normal @a n (the reference for ports).
Color evalShader(const ShaderConstants& constants, const Vec3f& n);

} // namespace lumivdb
