// SPDX-License-Identifier: Apache-2.0
#include "strata_cells.h"

#include "directions.h"

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

constexpr double kPi = 3.14159265358979323846;
/// Fewer squares a side would make their sides too long for arcs of great circles.
constexpr int kMinSide = 32;

} // namespace

StrataCells::StrataCells(std::size_t strata)
    : mStrata(strata)
    , mSide(kMinSide)
{
    while ((strata - 1) >> mShift >= kMaxCells) ++mShift;
    const std::size_t count = cellOf(strata - 1) + 1;
    while (static_cast<std::size_t>(mSide) * static_cast<std::size_t>(mSide) < count) mSide *= 2;

    const std::size_t squares = static_cast<std::size_t>(mSide) * static_cast<std::size_t>(mSide);
    mCell.resize(squares);
    mSolidAngle.assign(count, 0);
    std::vector<std::uint32_t> alongCurve(squares);
    for (std::size_t j = 0; j < squares; ++j) {
        const double t = (static_cast<double>(j) + 0.5) / static_cast<double>(squares);
        const Vec2d p = hilbertPoint(t) * mSide;
        const auto square
            = static_cast<std::uint32_t>(static_cast<int>(p.y) * mSide + static_cast<int>(p.x));
        const std::size_t cell = cellOf(static_cast<std::size_t>(t * static_cast<double>(strata)));
        alongCurve[j] = square;
        mCell[square] = static_cast<std::uint32_t>(cell);
        mSolidAngle[cell] += static_cast<float>(4 * kPi / static_cast<double>(squares));
    }
    // In the order of the curve, so that borders of neighbours read the same cells.
    for (const std::uint32_t square : alongCurve) {
        addBordersOf(static_cast<int>(square) % mSide, static_cast<int>(square) / mSide);
    }
    while (mBorders.size() % 8 != 0) mBorders.push(0, 0, {0, 0, 1}, {0, 0, 0});
}

std::size_t StrataCells::strataInCellOf(std::size_t stratum) const
{
    const std::size_t first = cellOf(stratum) << mShift;
    return std::min(mStrata - first, std::size_t{1} << mShift);
}

std::size_t StrataCells::cellAt(const Vec3f& direction) const
{
    const Vec2f p = sphereToSquare(direction) * static_cast<float>(mSide);
    const int x = std::clamp(static_cast<int>(p.x), 0, mSide - 1);
    const int y = std::clamp(static_cast<int>(p.y), 0, mSide - 1);
    return mCell[static_cast<std::size_t>(y * mSide + x)];
}

Vec3d StrataCells::corner(int x, int y) const
{
    return squareToSphere(Vec2d(x, y) / mSide).normalized();
}

Vec3d StrataCells::middle(int x, int y) const
{
    return squareToSphere(Vec2d(x + 0.5, y + 0.5) / mSide);
}

void StrataCells::addBorder(
    int x0, int y0, int x1, int y1, std::uint32_t a, std::uint32_t b, const Vec3d& fromAToB)
{
    const Vec3d p = corner(x0, y0), q = corner(x1, y1);
    const Vec3d cross = p.cross(q);
    const double sine = cross.length();
    if (a == b || !(sine > 0)) return;
    const double length = std::atan2(sine, p.dot(q));
    const Vec3d normal = cross * ((cross.dot(fromAToB) > 0 ? length : -length) / sine);
    const Vec3d direction = (p + q).normalized();
    mBorders.push(a, b, Vec3f(direction), Vec3f(normal));
}

void StrataCells::Borders::push(
    std::uint32_t cellA, std::uint32_t cellB, const Vec3f& direction, const Vec3f& normal)
{
    a.push_back(cellA);
    b.push_back(cellB);
    x.push_back(direction.x);
    y.push_back(direction.y);
    z.push_back(direction.z);
    nx.push_back(normal.x);
    ny.push_back(normal.y);
    nz.push_back(normal.z);
}

void StrataCells::addBordersOf(int x, int y)
{
    const auto cell = [&](int i, int j) { return mCell[static_cast<std::size_t>(j * mSide + i)]; };
    const int last = mSide - 1, mirrorX = last - x, mirrorY = last - y;
    const Vec3d here = middle(x, y);
    if (x < last) {
        addBorder(x + 1, y, x + 1, y + 1, cell(x, y), cell(x + 1, y), middle(x + 1, y) - here);
    }
    if (y < last) {
        addBorder(x, y + 1, x + 1, y + 1, cell(x, y), cell(x, y + 1), middle(x, y + 1) - here);
    }
    // The map folds each side of the square about its middle.
    if ((x == 0 || x == last) && y < mirrorY) {
        const int side = x == 0 ? 0 : mSide;
        addBorder(side, y, side, y + 1, cell(x, y), cell(x, mirrorY), middle(x, mirrorY) - here);
    }
    if ((y == 0 || y == last) && x < mirrorX) {
        const int side = y == 0 ? 0 : mSide;
        addBorder(x, side, x + 1, side, cell(x, y), cell(mirrorX, y), middle(mirrorX, y) - here);
    }
}

std::vector<Color> environmentMeans(const StrataCells& cells, const Environment& environment)
{
    constexpr std::size_t kSamples = std::size_t{1} << 16;
    const std::size_t n = std::max(4 * cells.count(), kSamples);
    std::vector<Vec3d> sum(cells.count(), Vec3d(0.0));
    // Balance heuristic over n even and n important directions.
    const auto add = [&](const Vec3d& d, const Color& radiance, double pdf) {
        const std::size_t cell = cells.cellAt(Vec3f(d));
        const double density = static_cast<double>(n) * (pdf + 1 / (4 * kPi));
        sum[cell] += Vec3d(radiance) / (density * cells.solidAngle(cell));
    };
    for (std::size_t i = 0; i < n; ++i) {
        const Vec2d point = hilbertPoint((static_cast<double>(i) + 0.5) / static_cast<double>(n));
        const Vec3d d = squareToSphere(point);
        add(d, environment.radiance(d), environment.pdf(d));
        const Environment::Sample s = environment.sample(point.x, point.y);
        if (s.pdf > 0) add(s.direction, s.radiance, s.pdf);
    }
    return std::vector<Color>(sum.begin(), sum.end());
}

} // namespace lumivdb
