// SPDX-License-Identifier: Apache-2.0
#include "gradient.h"

#include "gradient_kernel.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

/// How far a plane may change the inverse distance on its way from the ray to the border. Curved
/// surfaces seen edge-on would go anywhere.
constexpr float kLeast = 0.0f, kMost = 2.0f;
/// Sides belong to one surface where their inverse distances at the border differ by less than this
/// share and their planes by less than about 18 degrees.
constexpr float kSameSurface = 0.1f, kSameNormal2 = 0.9f;
/// A cell's ray met something in front of its light where inverse distances differ by this factor.
constexpr float kInFront = 1.05f;

float inverseAt(const InversePlane& plane, const Vec3f& direction)
{
    return std::clamp(plane.slope.dot(direction), kLeast * plane.inverse, kMost * plane.inverse);
}

bool sameSurface(const InversePlane& a, const InversePlane& b, float inverseA, float inverseB)
{
    if (!(std::abs(inverseA - inverseB) < kSameSurface * std::max(inverseA, inverseB))) {
        return false;
    }
    const float cosine = a.slope.dot(b.slope);
    return cosine > 0 && cosine * cosine > kSameNormal2 * a.slope.length2() * b.slope.length2();
}

/// One side of a border.
struct Side {
    const CellLight& cell;
    float own; ///< inverse distance of what the cell's ray met, at the border
    float emitter; ///< of its emitter samples

    Side(const CellLight& c, const Vec3f& direction, float inverse)
        : cell(c)
        , own(inverse)
        , emitter(std::max(0.0f, c.emitterSlope.dot(direction)))
    {
    }
    /// What passes the border when it moves with @a inverse, less what moves along anyway.
    Color flux(float inverse) const { return cell.interior * own + cell.edge * (inverse - own); }
    /// Emitter samples' share. An edge may pass through the cell, with the cell's ray on the near
    /// side of it and the light that arrives on the far side: then it counts for the neighbour.
    Color emitterFlux(float inverse, const Side& neighbour) const
    {
        Color f(0.0f);
        if (!(own > kInFront * emitter)) f += cell.emitter * std::max(0.0f, inverse - emitter);
        const Side& n = neighbour;
        if (n.own > kInFront * n.emitter && own < n.own) {
            f += n.cell.emitter * (inverse - n.emitter);
        }
        return f;
    }
};

} // namespace

void GradientSums::findDistances()
{
    for (std::size_t i = 0; i < mCells.size(); ++i) {
        CellLight& cell = mCells[i];
        cell.edge = cell.interior;
        if (!(cell.plane.inverse > 0)) {
            cell.edge = mTables->environment.empty() ? Color(0.0f) : mTables->environment[i];
        }
        const float weight = cell.emitter.x + cell.emitter.y + cell.emitter.z;
        if (weight > 0) cell.emitterSlope /= weight;
    }
    const StrataCells::Borders& b = mTables->cells.borders();
    mInverseA.resize(b.size());
    mInverseB.resize(b.size());
    for (std::size_t s = 0; s < b.size(); ++s) {
        const Vec3f direction(b.x[s], b.y[s], b.z[s]);
        mInverseA[s] = inverseAt(mCells[b.a[s]].plane, direction);
        mInverseB[s] = inverseAt(mCells[b.b[s]].plane, direction);
    }
}

/// One path tells little of the radiance that an edge uncovers: neighbours on the same surface tell
/// more.
void GradientSums::denoise()
{
    mDenoised.assign(mCells.size(), Color(0.0f));
    mNeighbours.assign(mCells.size(), 0);
    const StrataCells::Borders& b = mTables->cells.borders();
    for (std::size_t s = 0; s < b.size(); ++s) {
        const CellLight &ca = mCells[b.a[s]], &cb = mCells[b.b[s]];
        if (!(mInverseA[s] > 0) || !(mInverseB[s] > 0)
            || !sameSurface(ca.plane, cb.plane, mInverseA[s], mInverseB[s])) {
            continue;
        }
        mDenoised[b.a[s]] += cb.interior;
        mDenoised[b.b[s]] += ca.interior;
        ++mNeighbours[b.a[s]];
        ++mNeighbours[b.b[s]];
    }
    for (std::size_t i = 0; i < mCells.size(); ++i) {
        if (mNeighbours[i] == 0) continue;
        mCells[i].edge
            = (mCells[i].interior + mDenoised[i]) / static_cast<float>(1 + mNeighbours[i]);
    }
}

/// (L_b − L_a) q of border @a s, emitter samples' part as it should be.
Color GradientSums::changeAt(std::size_t s) const
{
    const StrataCells::Borders& b = mTables->cells.borders();
    const Vec3f direction(b.x[s], b.y[s], b.z[s]);
    const Side sa(mCells[b.a[s]], direction, mInverseA[s]);
    const Side sb(mCells[b.b[s]], direction, mInverseB[s]);
    const float inverse = std::max(sa.own, sb.own);
    Color change = sb.flux(inverse) - sa.flux(inverse);
    if (sa.emitter > 0 || sb.emitter > 0) {
        change += sb.emitterFlux(inverse, sa) - sa.emitterFlux(inverse, sb);
    }
    return change;
}

void GradientSums::addBorders(std::vector<double>& gradient) const
{
    const StrataCells::Borders& b = mTables->cells.borders();
    const int functions = coefficientCount(mBands);
    alignas(32) float y[kMaxCoefficients * kBatch];
    alignas(32) float w[3][3][kBatch]; // [channel][axis]
    std::vector<double> sums(static_cast<std::size_t>(functions) * 9, 0.0);
    for (std::size_t first = 0; first < b.size(); first += kBatch) {
        const int n = static_cast<int>(std::min<std::size_t>(kBatch, b.size() - first));
        for (int i = 0; i < n; ++i) {
            const std::size_t s = first + static_cast<std::size_t>(i);
            const Color change = changeAt(s);
            for (int c = 0; c < 3; ++c) {
                w[c][0][i] = change[c] * b.nx[s];
                w[c][1][i] = change[c] * b.ny[s];
                w[c][2][i] = change[c] * b.nz[s];
            }
        }
        evalShBasisBatch(mBands, static_cast<std::size_t>(n), b.x.data() + first,
            b.y.data() + first, b.z.data() + first, y);
        for (int c = 0; c < 3; ++c) {
            addProducts(functions, n, y, w[c][0], kBatch, sums.data() + c * 3, 9);
        }
    }
    for (int k = 0; k < functions; ++k) {
        for (int c = 0; c < 3; ++c) {
            for (int axis = 0; axis < 3; ++axis) {
                gradient[static_cast<std::size_t>((axis * functions + k) * 3 + c)]
                    += sums[static_cast<std::size_t>((k * 3 + c) * 3 + axis)];
            }
        }
    }
}

// E = I · window(d) · cone(ω) / d² with ∂d/∂p = −ω and ∂ω/∂p·t = −t⊥/d.
Vec3d punctualLogDerivative(const Light& light, const Vec3d& position, const Vec3d& p)
{
    if (light.type == LightType::Directional) return Vec3d(0.0);
    const Vec3d d = position - p;
    const double distance = d.length();
    const Vec3d direction = d / distance;
    Vec3d result = direction * (2 / distance);
    if (light.range > 0) {
        const double r = distance / light.range, window = 1 - r * r * r * r;
        if (window > 0) result += direction * (4 * r * r * r / light.range / window);
    }
    if (light.type == LightType::Spot) {
        const double cosOuter = std::cos(light.outerConeAngle);
        const double scale = 1 / std::max(0.001, std::cos(light.innerConeAngle) - cosOuter);
        const double cd = -light.direction.dot(direction);
        const double a = (cd - cosOuter) * scale;
        const Vec3d turn = (light.direction + direction * cd) / distance; // ∂cd/∂p
        if (a > 0 && a < 1) result += turn * (2 * scale / a);
    }
    return result;
}

} // namespace lumivdb
