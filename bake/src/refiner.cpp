// SPDX-License-Identifier: Apache-2.0
#include "refiner.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/volume.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

namespace lumivdb {

namespace {

/// Geometry this close to a cell, in spacings, counts as inside: samples on a surface are moved.
constexpr double kGeometryMargin = 2e-3;
/// What neighbours' samples show on a cell's faces is repaired there by them; a cell follows its
/// neighbours only where it is this much more wrong than a cell may be.
constexpr double kFollow = 2.0;
/// Share of cells that a lower threshold splits at least, and how far it falls at least.
constexpr double kLeastSplit = 0.005, kLeastFall = 0.99;
/// Cells of this many of the coarsest levels are tested on their faces too: the coarser the cell,
/// the more it can hide.
constexpr int kWellTestedLevels = 2;

double worst(const Vec3d& v) { return std::max({v.x, v.y, v.z}); }

void appendCorners(const CellKey& cell, std::vector<Coord>& points)
{
    for (int i = 0; i < 8; ++i) points.push_back(cell.corner(i));
}

/// The corners of a cell's children: up to 27 points, some more than once.
void appendNodes(const Octree& tree, const CellKey& cell, std::vector<Coord>& points)
{
    for (const CellKey& child : tree.children(cell)) appendCorners(child, points);
}

/// Whether a child of split cell @a cell has its corner at @a point.
bool hasNode(const Octree& tree, const CellKey& cell, const Coord& point)
{
    for (const CellKey& child : tree.children(cell)) {
        for (int i = 0; i < 8; ++i) {
            if (child.corner(i) == point) return true;
        }
    }
    return false;
}

std::vector<Coord> faceNodes(const CellKey& cell)
{
    return {cell.node(0, 1, 1), cell.node(2, 1, 1), cell.node(1, 0, 1), cell.node(1, 2, 1),
        cell.node(1, 1, 0), cell.node(1, 1, 2)};
}

} // namespace

const char* name(RefineHeuristic heuristic)
{
    switch (heuristic) {
    case RefineHeuristic::Error:
        return "error";
    case RefineHeuristic::Gradient:
        return "gradient";
    case RefineHeuristic::Geometry:
        return "geometry";
    case RefineHeuristic::Harmonic:
        return "harmonic";
    case RefineHeuristic::Brute:
        return "brute";
    }
    return "error";
}

bool RefineOptions::uses(RefineHeuristic heuristic) const
{
    return std::find(heuristics.begin(), heuristics.end(), heuristic) != heuristics.end();
}

double RefineOptions::cullThreshold() const
{
    if (cull >= 0) return cull;
    if (uses(RefineHeuristic::Error)) return error / 4;
    return uses(RefineHeuristic::Brute) ? brute : 0;
}

void RefineOptions::validate() const
{
    const auto require = [](const char* field, double value) {
        if (std::isfinite(value) && value > 0) return;
        throw Error(ErrorCode::Usage,
            std::string("refine threshold ") + field + " is " + std::to_string(value)
                + "; take a positive number.");
    };
    require("error", error);
    require("gradient", gradient);
    require("harmonic", harmonic);
    require("brute", brute);
    if (heuristics.empty()) throw Error(ErrorCode::Usage, "No refinement heuristic is chosen.");
    if (geometry < 0 || geometry > kMaxLevel) {
        throw Error(ErrorCode::Usage,
            "refine threshold geometry is " + std::to_string(geometry) + "; take a level from 0 to "
                + std::to_string(kMaxLevel) + ".");
    }
}

Refiner::Refiner(const Tracer& tracer, SampleStore& store, const RefineOptions& options,
    const LatticeBox& box, int levels, const Vec3d& meanE)
    : mTracer(tracer)
    , mStore(store)
    , mOptions(options)
    , mMeanE(meanE)
    , mTree(box, levels)
    , mGeometry(tracer)
    , mCutters([&tracer] {
        return Cutter{CellCutter(tracer.impl()), {}};
    })
{
}

void Refiner::setRoots(std::vector<CellKey> roots) { mTree.setRoots(std::move(roots)); }

Box3d Refiner::worldBox(const CellKey& cell) const
{
    const double h = mStore.settings().spacing;
    const Coord upper = cell.corner(7);
    const Vec3d margin(kGeometryMargin * h);
    return Box3d(Vec3d(cell.origin.x, cell.origin.y, cell.origin.z) * h - margin,
        Vec3d(upper.x, upper.y, upper.z) * h + margin);
}

bool Refiner::touchesGeometry(const CellKey& cell) const
{
    const auto known = mTouched.find(cell);
    return known != mTouched.end() ? known->second : mGeometry.touches(worldBox(cell));
}

double Refiner::share(const CellKey& cell) const { return lumivdb::share(cell, mTree.box()); }

double Refiner::weighted(const CellKey& cell, double error2) const
{
    return std::sqrt(std::max(0.0, error2) * std::pow(8.0, cell.level - mTree.levels()));
}

namespace {

/// A corner's part in an interpolated value: weight of its value and of its derivatives times the
/// cell width.
struct CornerWeight {
    std::size_t sample;
    double value;
    Vec3d slope;
};

/// Cubic Hermite basis at t of an end point: value and slope.
void hermite(double t, bool upper, double& value, double& slope)
{
    const double s = upper ? t : 1 - t;
    value = s * s * (3 - 2 * s);
    slope = (upper ? -1 : 1) * s * s * (1 - s);
}

} // namespace

/// In cell coordinates.
Vec3d Refiner::placeIn(const CellKey& cell, const Vec3d& world) const
{
    const double h = mStore.settings().spacing;
    const Vec3d corner = Vec3d(cell.origin.x, cell.origin.y, cell.origin.z) * h;
    return (world - corner) / (cell.size() * h);
}

/// What the places in a cell that geometry touches, its corners in the store, will see of them once
/// it is in the volume; none: all.
std::optional<CellVisibility> Refiner::cutOf(const CellKey& cell) const
{
    const double h = mStore.settings().spacing;
    const Vec3d& local = mTracer.impl().origin;
    CellFrame frame;
    frame.base = Vec3d(cell.origin.x, cell.origin.y, cell.origin.z) * h - local;
    frame.size = cell.size() * h;
    for (int a = 0; a < 3; ++a) frame.axis[a] = Vec3d(a == 0, a == 1, a == 2) * frame.size;
    frame.valid = 0;
    for (int i = 0; i < 8; ++i) {
        const std::size_t corner = mStore.find(cell.corner(i));
        frame.corner[i] = Vec3f(mStore.measured(corner) - local);
        if (mStore.isValid(corner)) frame.valid = static_cast<std::uint8_t>(frame.valid | 1 << i);
    }
    Cutter& c = mCutters.local();
    mGeometry.collect(worldBox(cell), c.triangles);
    std::optional<CellVisibility> cut = c.cutter.cut(frame, c.triangles);
    // What sees no valid corner has them all for an answer.
    for (int k = 0; cut && k < 8; ++k) {
        if (!(cut->masks >> (8 * k) & frame.valid)) cut->masks |= std::uint64_t{0xff} << (8 * k);
    }
    return cut;
}

/// What the sample at @a point has over what the corners that are seen there, by @a cut,
/// interpolate: tricubic Hermite where there are gradients and all corners count (at a cell's
/// nodes, Interpolation::Gradient gives the same), else Interpolation::Gradient from those that do;
/// trilinear without.
Refiner::Difference Refiner::differenceAt(
    const CellKey& cell, const CellVisibility* cut, const Coord& point) const
{
    const int bands = mStore.settings().bands, n = coefficientCount(bands);
    const std::size_t sample = mStore.find(point);
    const Vec3d at = mStore.measured(sample);
    const double width = cell.size() * mStore.settings().spacing;
    unsigned seen = 0xff;
    if (cut) {
        // What was moved off a surface may lie beyond the cell, but not behind a surface in its
        // face.
        const Vec3d moved = placeIn(cell, at);
        Vec3d t = moved;
        for (int a = 0; a < 3; ++a) t[a] = std::clamp(t[a], 0.0, 1.0);
        const Vec3d into = (t - moved) * (2 * width);
        if (into != Vec3d(0.0) && mTracer.occluded(at, at + into)) return {};
        seen = cut->corners(Vec3f(t));
    }
    CornerWeight corners[8];
    double linear[8];
    int count = 0, used = 0;
    double sum = 0;
    const Coord d = point - cell.origin;
    for (int i = 0; i < 8; ++i) {
        double w = 1, cubic = 1, value[3], slope[3];
        for (int a = 0; a < 3; ++a) {
            const double t = static_cast<double>(d[a]) / cell.size();
            w *= (i >> a & 1) ? t : 1 - t;
            hermite(t, i >> a & 1, value[a], slope[a]);
            cubic *= value[a];
        }
        if (w == 0) continue;
        ++used;
        const std::size_t corner = mStore.find(cell.corner(i));
        if (!mStore.isValid(corner) || !(seen >> i & 1)) continue;
        const Vec3d slopes(slope[0] * value[1] * value[2], value[0] * slope[1] * value[2],
            value[0] * value[1] * slope[2]);
        linear[count] = w;
        corners[count++] = {corner, cubic, slopes * width};
        sum += w;
    }
    Vec3d mean(0.0); // way from the corners that count; see Interpolation::Gradient
    for (int c = 0; c < count; ++c)
        mean += (at - mStore.measured(corners[c].sample)) * (linear[c] / sum);
    Color plain[kMaxCoefficients], full[kMaxCoefficients];
    std::copy(mStore.radiance(sample), mStore.radiance(sample) + n, plain);
    std::copy(plain, plain + n, full);
    Vec3d noise(mStore.info(sample).variance);
    for (int c = 0; c < count; ++c) {
        const double w = linear[c] / sum;
        const std::size_t s = corners[c].sample;
        noise += Vec3d(mStore.info(s).variance) * (w * w);
        const Color* value = mStore.radiance(s);
        for (int k = 0; k < n; ++k) plain[k] -= value[k] * static_cast<float>(w);
        const Color* gradient = mStore.gradient(s);
        if (!gradient) continue;
        const bool whole = count == used;
        const float valid = gradientFactor(mStore.info(s).distance, width);
        const Vec3d slope = whole ? corners[c].slope : (at - mStore.measured(s) + mean) * (0.5 * w);
        const auto v = static_cast<float>(whole ? corners[c].value : w);
        for (int k = 0; k < n; ++k) full[k] -= value[k] * v;
        for (int a = 0; a < 3; ++a) {
            const float along = static_cast<float>(slope[a]) * valid;
            for (int k = 0; k < n; ++k) full[k] -= gradient[a * n + k] * along;
        }
    }
    const auto relative = [&](const Color* difference) {
        Vec3d e = irradianceNorm2(bands, difference) - noise;
        for (int c = 0; c < 3; ++c) e[c] = mMeanE[c] > 0 ? e[c] / (mMeanE[c] * mMeanE[c]) : 0;
        return e;
    };
    const bool gradients = mStore.settings().gradients != GradientMethod::None;
    Difference result;
    result.plain2 = relative(plain);
    result.error2 = gradients ? relative(full) : result.plain2;
    return result;
}

Refiner::Measure Refiner::measureAt(const CellKey& cell, const std::vector<Coord>& points) const
{
    Vec3d error(0.0), plain(0.0);
    const auto known = mCuts.find(cell);
    const CellVisibility* cut = known != mCuts.end() ? &known->second : nullptr;
    for (const Coord& p : points) {
        // What lies inside geometry does not count.
        if (!mStore.isValid(mStore.find(p))) continue;
        const Difference d = differenceAt(cell, cut, p);
        error += d.error2;
        plain += d.plain2;
    }
    const double count = std::max<double>(1, static_cast<double>(points.size()));
    return {std::max(0.0, worst(error) / count), std::max(0.0, worst(plain) / count)};
}

double Refiner::rmsSurplus(bool gradients) const
{
    // Summed in sorted order: the map's own differs between libraries.
    std::vector<CellKey> cells;
    for (const auto& [cell, measure] : mMeasured) cells.push_back(cell);
    std::sort(cells.begin(), cells.end());
    double sum = 0;
    for (const CellKey& cell : cells) {
        const Measure& m = mMeasured.at(cell);
        sum += gradients ? m.error2 : m.plain2;
    }
    return cells.empty() ? 0 : std::sqrt(sum / static_cast<double>(cells.size()));
}

/// Whether @a points more samples are allowed.
bool Refiner::mayGrow(std::size_t points)
{
    if (points == 0 || mStore.size() + points <= mMaxSamples) return true;
    mLimited = true;
    return false;
}

std::vector<Coord> Refiner::testPoints(const CellKey& cell) const
{
    std::vector<Coord> points = {cell.node(1, 1, 1)};
    if (touchesGeometry(cell) || cell.level > mTree.levels() - kWellTestedLevels) {
        const std::vector<Coord> faces = faceNodes(cell);
        points.insert(points.end(), faces.begin(), faces.end());
    }
    // What lies beyond the box does not count.
    const LatticeBox& box = mTree.box();
    for (Coord& p : points) {
        for (int a = 0; a < 3; ++a) p[a] = std::clamp(p[a], box.lower[a], box.upper[a]);
    }
    return points;
}

void Refiner::measure(const std::vector<CellKey>& cells, Outlook& outlook)
{
    std::vector<CellKey> fresh;
    for (const CellKey& cell : cells) {
        if (mTouched.count(cell) == 0) fresh.push_back(cell);
    }
    std::vector<char> touched(fresh.size());
    tbb::parallel_for(std::size_t{0}, fresh.size(),
        [&](std::size_t i) { touched[i] = mGeometry.touches(worldBox(fresh[i])); });
    for (std::size_t i = 0; i < fresh.size(); ++i) mTouched.emplace(fresh[i], touched[i] != 0);

    const bool tests = mOptions.uses(RefineHeuristic::Error);
    std::vector<Coord> points;
    for (const CellKey& cell : fresh) {
        appendCorners(cell, points);
        if (!tests || cell.level == 0) continue;
        for (const Coord& p : testPoints(cell)) points.push_back(p);
    }
    mStore.require(std::move(points), outlook);
    if (!tests) return;
    std::vector<std::optional<CellVisibility>> cuts(fresh.size());
    tbb::parallel_for(std::size_t{0}, fresh.size(), [&](std::size_t i) {
        if (fresh[i].level > 0 && touched[i]) cuts[i] = cutOf(fresh[i]);
    });
    for (std::size_t i = 0; i < fresh.size(); ++i) {
        if (cuts[i]) mCuts.emplace(fresh[i], *cuts[i]);
    }
    std::vector<Measure> measures(fresh.size());
    tbb::parallel_for(std::size_t{0}, fresh.size(), [&](std::size_t i) {
        if (fresh[i].level > 0) measures[i] = measureAt(fresh[i], testPoints(fresh[i]));
    });
    for (std::size_t i = 0; i < fresh.size(); ++i) {
        if (fresh[i].level > 0) mMeasured.emplace(fresh[i], measures[i]);
    }
}

double Refiner::change(const CellKey& cell) const
{
    const int bands = mStore.settings().bands, n = coefficientCount(bands);
    double largest = 0;
    for (int i = 0; i < 8; ++i) {
        const std::size_t a = mStore.find(cell.corner(i));
        for (int axis = 0; axis < 3; ++axis) {
            if (i >> axis & 1) continue;
            const std::size_t b = mStore.find(cell.corner(i | 1 << axis));
            if (!mStore.isValid(a) || !mStore.isValid(b)) continue;
            Color difference[kMaxCoefficients];
            for (int k = 0; k < n; ++k)
                difference[k] = mStore.radiance(b)[k] - mStore.radiance(a)[k];
            const Vec3d norm2 = irradianceNorm2(bands, difference);
            for (int c = 0; c < 3; ++c) {
                if (mMeanE[c] > 0) largest = std::max(largest, std::sqrt(norm2[c]) / mMeanE[c]);
            }
        }
    }
    return largest;
}

double Refiner::harmonicDistance(const CellKey& cell) const
{
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i < 8; ++i) {
        const SampleStore::Info& info = mStore.info(mStore.find(cell.corner(i)));
        least = std::min(least, static_cast<double>(info.distance));
    }
    return least;
}

bool Refiner::wantsSplit(const CellKey& cell) const
{
    const int geometryLevel
        = mOptions.geometryLevel < 0 ? mTree.levels() - 1 : mOptions.geometryLevel;
    for (const RefineHeuristic heuristic : mOptions.heuristics) {
        switch (heuristic) {
        case RefineHeuristic::Error:
            if (touchesGeometry(cell) && cell.level > geometryLevel) return true;
            if (weighted(cell, mMeasured.at(cell).error2) > mThreshold) return true;
            break;
        case RefineHeuristic::Gradient:
            if (change(cell) > mOptions.gradient) return true;
            break;
        case RefineHeuristic::Geometry:
            if (cell.level > mOptions.geometry && touchesGeometry(cell)) return true;
            break;
        case RefineHeuristic::Harmonic:
            if (harmonicDistance(cell)
                < mOptions.harmonic * cell.size() * mStore.settings().spacing)
                return true;
            break;
        case RefineHeuristic::Brute:
            return true;
        }
    }
    return false;
}

/// Whether what split neighbours of the same size know on the shared faces and edges tells that
/// this cell is wrong there.
bool Refiner::followsNeighbours(const Octree& tree, const CellKey& cell) const
{
    std::vector<Coord> shared;
    for (int n = 0; n < 27; ++n) {
        const Coord at(n % 3, n / 3 % 3, n / 9);
        const int middles = (at.x == 1) + (at.y == 1) + (at.z == 1);
        if (middles != 1 && middles != 2) continue;
        bool known = false;
        for (int m = 1; m < 8 && !known; ++m) {
            Coord step(0, 0, 0);
            bool outward = true;
            for (int a = 0; a < 3; ++a) {
                if (!(m >> a & 1)) continue;
                if (at[a] == 1) outward = false;
                step[a] = at[a] - 1;
            }
            const CellKey neighbour{cell.origin + step * cell.size(), cell.level};
            known = outward && tree.isSplit(neighbour)
                && hasNode(tree, neighbour, cell.node(at.x, at.y, at.z));
        }
        if (known) shared.push_back(cell.node(at.x, at.y, at.z));
    }
    if (shared.empty()) return false;
    return weighted(cell, measureAt(cell, shared).error2) > kFollow * mThreshold;
}

void Refiner::refineLevel(std::vector<CellKey>& cells, Outlook& outlook)
{
    const int place = 2 * (mTree.levels() - cells.front().level);
    outlook.enter(place, Outlook::Work::Samples);
    measure(cells, outlook);
    std::vector<char> split(cells.size());
    tbb::parallel_for(
        std::size_t{0}, cells.size(), [&](std::size_t i) { split[i] = wantsSplit(cells[i]); });
    std::vector<Coord> wanted;
    for (std::size_t i = 0; i < cells.size(); ++i) {
        if (split[i]) appendNodes(mTree, cells[i], wanted);
    }
    if (!mayGrow(mStore.missing(std::move(wanted)))) std::fill(split.begin(), split.end(), 0);
    std::vector<CellKey> next;
    std::vector<Coord> points;
    const auto apply = [&](std::size_t i) {
        mTree.split(cells[i]);
        appendNodes(mTree, cells[i], points);
        const std::vector<CellKey> children = mTree.children(cells[i]);
        next.insert(next.end(), children.begin(), children.end());
    };
    for (std::size_t i = 0; i < cells.size(); ++i) {
        if (split[i]) apply(i);
    }
    if (mOptions.uses(RefineHeuristic::Error)) {
        // What has been split will be sampled; its neighbours may look at it, once.
        outlook.enter(place + 1, Outlook::Work::Samples);
        mStore.require(points, outlook);
        std::vector<char> follows(cells.size());
        tbb::parallel_for(std::size_t{0}, cells.size(),
            [&](std::size_t i) { follows[i] = !split[i] && followsNeighbours(mTree, cells[i]); });
        for (std::size_t i = 0; i < cells.size(); ++i) {
            if (follows[i]) apply(i);
        }
    }
    cells = std::move(next);
}

void Refiner::cull(Outlook& outlook)
{
    const double ratio = mOptions.cullThreshold() / mOptions.error;
    const double threshold
        = mOptions.uses(RefineHeuristic::Error) ? ratio * mThreshold : mOptions.cullThreshold();
    if (!(threshold > 0)) return;
    for (int level = 1; level <= mTree.levels(); ++level) {
        outlook.enter(2 * mTree.levels() + level - 1, Outlook::Work::Samples);
        std::vector<CellKey> candidates = mTree.mergeable(level);
        std::vector<Coord> points;
        for (const CellKey& cell : candidates) {
            appendNodes(mTree, cell, points);
            appendCorners(cell, points); // those outside the box, where it was split for balance
        }
        mStore.require(std::move(points), outlook);
        std::vector<char> redundant(candidates.size());
        tbb::parallel_for(std::size_t{0}, candidates.size(), [&](std::size_t i) {
            const CellKey& cell = candidates[i];
            if (!mTree.mayMerge(cell)) return;
            std::vector<Coord> nodes;
            for (int n = 0; n < 27; ++n) {
                const Coord at(n % 3, n / 3 % 3, n / 9), node = cell.node(at.x, at.y, at.z);
                if (at.x != 1 && at.y != 1 && at.z != 1) continue;
                if (hasNode(mTree, cell, node)) nodes.push_back(node);
            }
            redundant[i] = weighted(cell, measureAt(cell, nodes).error2) <= threshold;
        });
        for (std::size_t i = 0; i < candidates.size(); ++i) {
            if (redundant[i]) mTree.merge(candidates[i]);
        }
    }
}

RefinedCells Refiner::result(Outlook& outlook)
{
    outlook.enter(steps() - 1, Outlook::Work::Samples);
    RefinedCells r;
    r.cells = mTree.leaves();
    std::vector<Coord> points;
    for (const CellKey& cell : r.cells) appendCorners(cell, points);
    mStore.require(std::move(points), outlook);
    for (const CellKey& cell : r.cells) {
        // A finest cell was not tested itself: it is thought to be as wrong as its parent.
        CellKey tested = cell;
        auto found = mMeasured.find(tested);
        while (found == mMeasured.end() && tested.level < mTree.levels()) {
            tested = tested.parent();
            found = mMeasured.find(tested);
        }
        const double error2 = found == mMeasured.end() ? 0 : found->second.error2;
        r.contribution.push_back(error2 * share(cell));
    }
    return r;
}

double Refiner::lowerThreshold(const RefinedCells& now, double samples, double least) const
{
    std::vector<double> errors; // of what would be split at the least
    for (const CellKey& cell : now.cells) {
        const auto found = mMeasured.find(cell);
        if (found == mMeasured.end()) continue;
        const double error = weighted(cell, found->second.error2);
        if (error > least) errors.push_back(error);
    }
    const double cells = static_cast<double>(now.cells.size());
    const double each = 7 * static_cast<double>(mStore.size()) / cells; // a cell becomes eight
    const auto most = static_cast<std::size_t>(std::max(samples / each, kLeastSplit * cells));
    if (errors.size() <= most) return least;
    std::nth_element(errors.begin(), errors.begin() + static_cast<std::ptrdiff_t>(most),
        errors.end(), std::greater<>());
    return std::clamp(errors[most], least, kLeastFall * mThreshold);
}

RefinedCells Refiner::run(double threshold, Outlook& outlook)
{
    mThreshold = threshold;
    mLimited = false;
    for (const CellKey& cell : mTree.splitCells()) mTree.merge(cell);
    std::vector<CellKey> cells = mTree.roots();
    for (int level = mTree.levels(); level > 0 && !cells.empty(); --level) {
        refineLevel(cells, outlook);
    }
    mTree.balance();
    cull(outlook);
    return result(outlook);
}

} // namespace lumivdb
