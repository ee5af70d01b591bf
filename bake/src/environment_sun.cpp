// SPDX-License-Identifier: Apache-2.0
#include "environment_sun.h"

#include <algorithm>
#include <cmath>

namespace lumivdb::detail {

namespace {

constexpr double kPi = 3.14159265358979323846;

/// Points are drawn this far (in texels) from a texel's border, so that rounding in the way to a
/// direction and back finds the same texel again.
constexpr double kInset = 1e-8;

const Color& pixelAt(
    const ImageProjection& projection, const std::vector<Color>& pixels, Texel texel)
{
    return pixels[static_cast<std::size_t>(texel.y) * projection.width + texel.x];
}

/// Calls visit(texel, luminance) for all texels of at least @a least that see the sphere.
template <class Visit>
void visitBright(const ImageProjection& projection, const std::vector<Color>& pixels,
    const double& least, const Visit& visit)
{
    for (int y = 0; y < projection.height; ++y) {
        for (int x = 0; x < projection.width; ++x) {
            const double luminance = luminanceOf(pixelAt(projection, pixels, {x, y}));
            if (luminance < least || !(projection.solidAngle({x, y}) > 0)) continue;
            visit(Texel{x, y}, luminance);
        }
    }
}

Vec3d middleOf(const ImageProjection& projection, Texel texel)
{
    Vec3d d(0, 1, 0);
    projection.pointIn(texel, 0.5, 0.5, d);
    return d;
}

} // namespace

int invertRunningSum(const double* cum, int n, double u, double& fraction)
{
    const double target = u * cum[n - 1];
    const double* step = std::upper_bound(cum, cum + n, target);
    if (step == cum + n) step = std::lower_bound(cum, cum + n, cum[n - 1]); // u rounded up to 1
    const double before = step == cum ? 0.0 : step[-1];
    fraction = std::clamp((target - before) / (*step - before), kInset, 1.0 - kInset);
    return static_cast<int>(step - cum);
}

SunTexels::SunTexels(
    const ImageProjection& projection, const std::vector<Color>& pixels, double power)
{
    mThreshold = kSunContrast * power / (4 * kPi);
    if (!(mThreshold > 0)) return;
    Texel middle{-1, -1};
    double brightest = mThreshold;
    visitBright(projection, pixels, brightest, [&](Texel texel, double luminance) {
        if (middle.x >= 0 && luminance <= brightest) return;
        middle = texel;
        brightest = luminance;
    });
    if (middle.x < 0) return;
    collect(projection, pixels, middle);
    // Rounding: what is all sun may seem to have some other light.
    if (this->power() < kSunShare * power || this->power() > power * (1 - 1e-9)) {
        *this = SunTexels();
        return;
    }
    bound(projection);
}

void SunTexels::collect(
    const ImageProjection& projection, const std::vector<Color>& pixels, Texel middle)
{
    const Vec3d towards = middleOf(projection, middle);
    const double near = std::cos(kSunRadius * kPi / 180);
    double row = 0, total = 0;
    visitBright(projection, pixels, mThreshold, [&](Texel texel, double luminance) {
        const bool itself = texel.x == middle.x && texel.y == middle.y;
        if (!itself && middleOf(projection, texel).dot(towards) < near) return;
        if (mRows.empty() || mRows.back().y != texel.y) {
            if (!mRows.empty()) mRowSums.push_back(total);
            mRows.push_back({texel.y, mColumns.size()});
            row = 0;
        }
        const double weight = luminance * projection.solidAngle(texel);
        row += weight;
        total += weight;
        mColumns.push_back(texel.x);
        mColumnSums.push_back(row);
    });
    mRowSums.push_back(total);
    mRows.push_back({projection.height, mColumns.size()});
}

void SunTexels::bound(const ImageProjection& projection)
{
    const auto visitTexels = [&](const auto& visit) {
        for (std::size_t r = 0; r + 1 < mRows.size(); ++r) {
            for (std::size_t i = mRows[r].first; i < mRows[r + 1].first; ++i) {
                visit(Texel{mColumns[i], mRows[r].y});
            }
        }
    };
    Vec3d sum(0.0);
    visitTexels([&](Texel texel) { sum += middleOf(projection, texel); });
    mDirection = sum.normalized();
    visitTexels([&](Texel texel) {
        for (int corner = 0; corner < 4; ++corner) {
            Vec3d d = mDirection;
            if (!projection.pointIn(texel, corner % 2, corner / 2, d)) continue;
            mRadius = std::max(mRadius, std::acos(std::clamp(mDirection.dot(d), -1.0, 1.0)));
        }
    });
}

bool SunTexels::find(Texel texel) const
{
    const auto row = std::lower_bound(
        mRows.begin(), mRows.end() - 1, texel.y, [](const Row& r, int y) { return r.y < y; });
    if (row == mRows.end() - 1 || row->y != texel.y) return false;
    const auto begin = mColumns.begin();
    return std::binary_search(begin + static_cast<std::ptrdiff_t>(row->first),
        begin + static_cast<std::ptrdiff_t>(row[1].first), texel.x);
}

Texel SunTexels::draw(double u, double v, double& s, double& t) const
{
    const int r = invertRunningSum(mRowSums.data(), static_cast<int>(mRowSums.size()), v, t);
    const Row *row = mRows.data() + r, *next = row + 1;
    const int x = invertRunningSum(
        mColumnSums.data() + row->first, static_cast<int>(next->first - row->first), u, s);
    return {mColumns[row->first + static_cast<std::size_t>(x)], row->y};
}

} // namespace lumivdb::detail
