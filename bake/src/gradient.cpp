// SPDX-License-Identifier: Apache-2.0
#include "gradient.h"

#include "gradient_kernel.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace lumivdb {

namespace {

float maxComponent(const Color& c) { return std::max({c.x, c.y, c.z}); }

using DerivativeTable = std::array<double, 3 * kMaxCoefficients * kMaxCoefficients>;

/// x_a S_l = S_{l+1} + r²/(2l+1) ∂S_l/∂x_a splits x_a S_l into harmonics of degree l ± 1, so the
/// derivative is (2l+1) times the part of degree l − 1 of the product x_a Y_lm.
DerivativeTable makeDerivativeTable()
{
    constexpr double kY1 = 0.48860251190291992159;
    constexpr int kFunction[3] = {3, 1, 2};
    constexpr double kSign[3] = {-1, -1, 1};
    DerivativeTable table{};
    for (int axis = 0; axis < 3; ++axis) {
        double coordinate[kMaxCoefficients] = {};
        coordinate[kFunction[axis]] = kSign[axis] / kY1;
        for (int k = 1; k < kMaxCoefficients; ++k) {
            double y[kMaxCoefficients] = {}, product[kMaxCoefficients] = {};
            y[k] = 1;
            productSh(kMaxBands, coordinate, y, product);
            const int l = degreeOf(k);
            for (int j = (l - 1) * (l - 1); j < l * l; ++j) {
                table[static_cast<std::size_t>(
                    (axis * kMaxCoefficients + k) * kMaxCoefficients + j)]
                    = (2 * l + 1) * product[j];
            }
        }
    }
    return table;
}

} // namespace

const double* solidDerivative(int axis)
{
    static const DerivativeTable table = makeDerivativeTable();
    return table.data() + axis * kMaxCoefficients * kMaxCoefficients;
}

void FixedPointSums::reset(int bands)
{
    mBands = bands;
    const auto n = static_cast<std::size_t>(coefficientCount(bands));
    mMoment.assign(n * 3, 0.0);
    mShift.assign(n * 9, 0.0);
}

void FixedPointSums::add(const Point* points, int count)
{
    alignas(32) float x[3][kBatch] = {}, y[kMaxCoefficients * kBatch];
    alignas(32) float moment[3][kBatch] = {}, shift[3][kBatch] = {};
    const int n = (count + kSumLanes - 1) / kSumLanes * kSumLanes;
    for (int i = 0; i < count; ++i) {
        for (int a = 0; a < 3; ++a) {
            x[a][i] = points[i].direction[a];
            moment[a][i] = points[i].value[a] * points[i].inverse;
        }
    }
    evalShBasisBatch(mBands, static_cast<std::size_t>(n), x[0], x[1], x[2], y);
    addProducts(coefficientCount(mBands), n, y, moment[0], kBatch, mMoment.data(), 3);
    for (int l = 0; l < mBands; ++l) {
        const int first = coefficientCount(l);
        for (int c = 0; c < 3; ++c) {
            for (int i = 0; i < count; ++i) {
                const Point& p = points[i];
                for (int a = 0; a < 3; ++a) {
                    shift[a][i] = p.value[c]
                        * (static_cast<float>(l + 3) * p.inverse * p.direction[a] - p.slope[a]);
                }
            }
            addProducts(2 * l + 1, n, y + first * n, shift[0], kBatch,
                mShift.data() + first * 9 + c * 3, 9);
        }
    }
}

void FixedPointSums::add(const FixedPointSums& o)
{
    for (std::size_t i = 0; i < mMoment.size(); ++i) mMoment[i] += o.mMoment[i];
    for (std::size_t i = 0; i < mShift.size(); ++i) mShift[i] += o.mShift[i];
}

// Moving by t turns ω by −q t⊥, so ∂Y/∂t = −q (∂S/∂t − l (ω·t) Y) with the solid harmonic S.
void FixedPointSums::addTo(double scale, std::vector<double>& gradient) const
{
    const int n = coefficientCount(mBands);
    for (int axis = 0; axis < 3; ++axis) {
        const double* derivative = solidDerivative(axis);
        for (int k = 0; k < n; ++k) {
            for (int c = 0; c < 3; ++c) {
                double v = mShift[static_cast<std::size_t>((k * 3 + c) * 3 + axis)];
                const int l = degreeOf(k);
                for (int j = (l - 1) * (l - 1); l > 0 && j < l * l; ++j) {
                    v -= derivative[k * kMaxCoefficients + j]
                        * mMoment[static_cast<std::size_t>(j * 3 + c)];
                }
                gradient[static_cast<std::size_t>((axis * n + k) * 3 + c)] += scale * v;
            }
        }
    }
}

GradientTables::GradientTables(std::size_t strata, const Environment* lit)
    : cells(strata)
{
    if (lit) environment = environmentMeans(cells, *lit);
}

void GradientCollector::reset(const GradientTables& tables, int bands, CellLight* cells)
{
    mTables = &tables;
    mCells = cells;
    mEmitters.reset(bands);
    mArrivals.clear();
}

void GradientCollector::collect(const PathBatchResult& batch, std::size_t first, int n)
{
    const StrataCells& cells = mTables->cells;
    for (int i = 0; i < n; ++i) {
        const std::size_t stratum = first + static_cast<std::size_t>(i);
        CellLight& cell = mCells[cells.cellOf(stratum)];
        if (cells.startsCell(stratum)) cell = CellLight();
        cell.interior += batch.uniform[i] / static_cast<float>(cells.strataInCellOf(stratum));
        if (batch.plane[i].inverse > cell.plane.inverse) cell.plane = batch.plane[i];
    }
    collectEmitters(batch, n);
}

void GradientCollector::collectEmitters(const PathBatchResult& batch, int n)
{
    int count = 0;
    for (int i = 0; i < n; ++i) {
        const InversePlane& plane = batch.emitterPlane[i];
        if (!(plane.inverse > 0) || !(maxComponent(batch.emitter[i]) > 0)) continue;
        const Vec3f d = batch.emitterDirection[i];
        mPoints[count++] = {d, plane.inverse, plane.slope, batch.emitter[i]};
        mArrivals.push_back(
            {static_cast<std::uint32_t>(mTables->cells.cellAt(d)), batch.emitter[i], plane.slope});
    }
    if (count > 0) mEmitters.add(mPoints, count);
}

void GradientSums::reset(const GradientTables& tables, int bands)
{
    mTables = &tables;
    mBands = bands;
    mCells.resize(tables.cells.count());
    mEmitters.reset(bands);
    mPunctual.reset(bands);
}

void GradientSums::add(const GradientCollector& part)
{
    mEmitters.add(part.emitters());
    const StrataCells& cells = mTables->cells;
    for (const EmitterArrival& e : part.arrivals()) {
        CellLight& cell = mCells[e.cell];
        const Color radiance
            = e.value / (static_cast<float>(cells.strata()) * cells.solidAngle(e.cell));
        cell.emitter += radiance;
        // A weighted mean, divided by its weight once all have arrived.
        cell.emitterSlope += e.slope * (radiance.x + radiance.y + radiance.z);
    }
}

void GradientSums::addPunctual(
    const Light& light, const Vec3f& localPosition, const Vec3f& p, const PunctualSample& sample)
{
    if (sample.infinite) return;
    const auto inverse = static_cast<float>(1 / (Vec3d(localPosition) - Vec3d(p)).length());
    const Vec3f change(punctualLogDerivative(light, Vec3d(localPosition), Vec3d(p)));
    const FixedPointSums::Point point{
        sample.direction, inverse, sample.direction * (3 * inverse) - change, sample.irradiance};
    mPunctual.add(&point, 1);
}

std::vector<Color> GradientSums::finish()
{
    findDistances();
    denoise();
    const auto n = static_cast<std::size_t>(coefficientCount(mBands));
    std::vector<double> sum(n * 9, 0.0);
    addBorders(sum);
    mEmitters.addTo(1 / static_cast<double>(mTables->cells.strata()), sum);
    mPunctual.addTo(1, sum);
    std::vector<Color> gradient(n * 3);
    for (std::size_t i = 0; i < gradient.size(); ++i) {
        gradient[i] = Color(Vec3d(sum[3 * i], sum[3 * i + 1], sum[3 * i + 2]));
    }
    return gradient;
}

} // namespace lumivdb
