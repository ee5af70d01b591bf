// SPDX-License-Identifier: Apache-2.0
#include "verification.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <algorithm>
#include <cmath>
#include <numeric>

namespace lumivdb {

namespace {

/// Of the points that are not drawn evenly, so many are by brightness.
constexpr double kBright = 0.25;
constexpr std::uint64_t kVerifyStream = 0x3b97f1c5d8e2a604ull;

EvaluateOptions evaluateOptions(
    const BakeOptions& options, const IrradianceVolume& volume, int rays, int number)
{
    EvaluateOptions evaluate;
    evaluate.mode = VolumeSampler::bestMode(volume);
    evaluate.contribution = options.probe.contribution;
    evaluate.maxBounces = options.probe.maxBounces;
    evaluate.rays = rays;
    evaluate.twice = true;
    evaluate.seed = hashCombine(
        mixBits(options.probe.seed ^ kVerifyStream), static_cast<std::uint64_t>(number));
    return evaluate;
}

LatticeBox boxOf(const IrradianceVolume& volume, double spacing)
{
    const auto step = static_cast<int>(std::lround(volume.spacing() / spacing));
    const LatticeBox box = volume.latticeBounds();
    return {box.lower * step, box.upper * step};
}

} // namespace

Verification::Verification(const Tracer& tracer, const BakeOptions& options, const BakePlan& plan,
    const RefinedCells& cells, const IrradianceVolume& volume, int rays, int number)
    : mOptions(options)
    , mPlan(plan)
    , mCells(cells)
    , mBox(boxOf(volume, plan.samples.spacing))
    , mEvaluate(evaluateOptions(options, volume, rays, number))
    , mEvaluator(volume, tracer, mEvaluate, plan.meanE)
{
    const std::vector<double> bright = brightness(volume);
    const double wrong = std::accumulate(cells.contribution.begin(), cells.contribution.end(), 0.0);
    const double light = std::accumulate(bright.begin(), bright.end(), 0.0);
    if (!(wrong > 0 && std::isfinite(wrong) && light > 0 && std::isfinite(light))) return;
    double sum = 0;
    for (std::size_t i = 0; i < bright.size(); ++i) {
        mShares.push_back(
            (1 - kBright) * cells.contribution[i] / wrong + kBright * bright[i] / light);
        mSums.push_back(sum += mShares.back());
    }
}

/// Per cell: its volume times the square of its light, as an error that the bake does not know of
/// may be larger where there is more.
std::vector<double> Verification::brightness(const IrradianceVolume& volume) const
{
    const VolumeSampler sampler(volume);
    std::vector<double> result;
    for (const CellKey& cell : mCells.cells) {
        const Coord middle = cell.node(1, 1, 1);
        Color L[kMaxCoefficients];
        sampler.radiance(Vec3d(middle.x, middle.y, middle.z) * mPlan.samples.spacing, L);
        double most = 0;
        for (int c = 0; c < 3; ++c) {
            const double relative = mPlan.meanE[c] > 0 ? L[0][c] / mPlan.meanE[c] : 0;
            if (std::isfinite(relative)) most = std::max(most, relative);
        }
        result.push_back(share(cell, mBox) * most * most);
    }
    return result;
}

/// Half of the points evenly, half by the cells' shares; the weight undoes that.
std::pair<Vec3d, double> Verification::draw(std::size_t number) const
{
    CounterRng rng(hashCombine(mEvaluate.seed, number));
    Vec3d lower(mBox.lower.x, mBox.lower.y, mBox.lower.z),
        upper(mBox.upper.x, mBox.upper.y, mBox.upper.z);
    if (!mSums.empty() && number % 2 == 1) {
        const auto it
            = std::upper_bound(mSums.begin(), mSums.end(), rng.nextDouble() * mSums.back());
        const auto chosen
            = std::min(static_cast<std::size_t>(it - mSums.begin()), mSums.size() - 1);
        const CellKey& cell = mCells.cells[chosen];
        for (int a = 0; a < 3; ++a) {
            lower[a] = std::max(cell.origin[a], mBox.lower[a]);
            upper[a] = std::min(cell.origin[a] + cell.size(), mBox.upper[a]);
        }
    }
    Vec3d p;
    for (int a = 0; a < 3; ++a) p[a] = lower[a] + rng.nextDouble() * (upper[a] - lower[a]);
    return {p * mPlan.samples.spacing, mSums.empty() ? 1 : 1 / density(p)};
}

/// Of points at @a p over the even one: that of the mixture, whichever half a point came from.
double Verification::density(const Vec3d& p) const
{
    double density = 1;
    const Coord voxel(static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
        static_cast<int>(std::floor(p.z)));
    CellKey cell{voxel, 0};
    for (int level = 0; level <= mPlan.levels; ++level, cell = cell.parent()) {
        const auto found = std::lower_bound(mCells.cells.begin(), mCells.cells.end(), cell);
        if (found == mCells.cells.end() || !(*found == cell)) continue;
        const auto index = static_cast<std::size_t>(found - mCells.cells.begin());
        density = 0.5 + 0.5 * mShares[index] / mSums.back() / share(cell, mBox);
    }
    return density;
}

AchievedError Verification::look(std::size_t points, double confidence, Progress& progress)
{
    std::vector<Vec3d> places;
    std::vector<double> weights;
    for (; mPoints < points; ++mPoints) {
        const auto [place, weight] = draw(mPoints);
        places.push_back(place);
        weights.push_back(weight);
    }
    try {
        mEvaluator.add(places, weights, progress);
    } catch (const Error& e) {
        if (e.code() != ErrorCode::Interrupted) throw;
        throw Error(e.code(), "The bake was interrupted; nothing was written.");
    }
    const EvaluateReport r = mEvaluator.report(confidence);
    AchievedError achieved;
    achieved.relRmse = r.relRmseDebiased;
    achieved.upper = r.upper;
    achieved.confidence = mOptions.target.confidence;
    achieved.points = r.points;
    achieved.met = r.upper <= mOptions.target.error;
    for (const auto& w : r.worst) achieved.worst.push_back({w.position, w.error});
    return achieved;
}

} // namespace lumivdb
