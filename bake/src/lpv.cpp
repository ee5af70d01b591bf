// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/bake/lpv.h>

#include "lpv_field.h"
#include "lpv_geometry.h"
#include "lpv_units.h"
#include "threads.h"

#include <lumivdb/core/error.h>
#include <lumivdb/core/sh.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

using detail::CellState;
using detail::FluxLimit;

namespace {

[[noreturn]] void refuse(const std::string& field, double value, const std::string& range)
{
    throw Error(
        ErrorCode::Usage, field + " is " + std::to_string(value) + "; it must be " + range + ".");
}

bool isFinite(const Vec3d& v)
{
    return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

void check(const Surfel& s, std::size_t i)
{
    if (isFinite(s.position) && isFinite(Vec3d(s.normal)) && isFinite(Vec3d(s.flux))) return;
    throw Error(ErrorCode::Usage,
        "Surfel " + std::to_string(i) + " is NaN or infinite; leave it out or repair the scene.");
}

const LpvOptions& checked(const LpvOptions& options)
{
    options.validate();
    return options;
}

Coord floorOf(const Vec3d& p)
{
    return {static_cast<int>(std::floor(p.x)), static_cast<int>(std::floor(p.y)),
        static_cast<int>(std::floor(p.z))};
}

bool onLattice(const Vec3d& p)
{
    return std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)}) < kMaxLattice - 16;
}

} // namespace

void LpvOptions::validate() const
{
    if (!(spacing >= kMinSpacing) || !std::isfinite(spacing))
        refuse("The spacing of a light propagation volume", spacing, "at least 2e-5");
    if (!(cutoff >= 0 && cutoff <= 0.1))
        refuse("The cutoff of a light propagation volume", cutoff, "0 to 0.1");
    if (threads < 0) refuse("The number of threads", threads, "0 or more");
    if (bounces == LpvBounces::Many && occlusion == LpvOcclusion::Off) {
        throw Error(ErrorCode::Usage,
            "Light bounces off geometry that stops it; turn occlusion on or bounces off.");
    }
}

Blocker blockerOf(const Surfel& surfel)
{
    Blocker b;
    b.position = surfel.position;
    b.normal = surfel.normal;
    b.area = surfel.area;
    return b;
}

struct LightPropagationVolume::Impl {
    Impl(const LpvOptions& o, const std::optional<LatticeBox>& cells)
        : options(checked(o))
        , field(o.scheme == LpvScheme::Clamped ? FluxLimit::Positive : FluxLimit::None, o.cutoff,
              cells)
        , geometry(o)
        , toRadiance(o.spacing)
    {
    }

    void geometryChanged()
    {
        const bool counts = options.occlusion == LpvOcclusion::On && !geometry.empty();
        field.setGeometry(counts ? &geometry : nullptr);
    }

    /// In the caller's arena, or in one of as many threads as the options say.
    template <class Work> void onThreads(const Work& work) const
    {
        if (options.threads == 0) return work();
        withThreads(options.threads, work);
    }

    /// Cell nearest to lattice place @a p, or none.
    std::optional<Coord> cellAt(const Vec3d& p) const
    {
        if (!onLattice(p)) return std::nullopt;
        const Coord cell = floorOf(p + Vec3d(0.5));
        if (!field.contains(cell)) return std::nullopt;
        return cell;
    }

    void add(const Coord& cell, const CellState& state, const Vec3d& flux)
    {
        field.add(cell, state);
        injected += flux;
    }

    double residual() const
    {
        const Vec3d front = field.frontTotal() * detail::kFluxOfA;
        const double all = std::abs(injected.x) + std::abs(injected.y) + std::abs(injected.z);
        return all > 0 ? (std::abs(front.x) + std::abs(front.y) + std::abs(front.z)) / all : 0;
    }

    /// Interpolated Σ of fronts at lattice place @a p.
    bool interpolate(const Vec3d& p, CellState& out) const;

    LpvOptions options;
    detail::LpvField field;
    detail::LpvGeometry geometry;
    detail::LpvToRadiance toRadiance;
    Vec3d injected{0.0};
};

LightPropagationVolume::LightPropagationVolume(
    const LpvOptions& options, const std::optional<LatticeBox>& cells)
    : mImpl(std::make_unique<Impl>(options, cells))
{
    if (cells) setCells(*cells);
}
LightPropagationVolume::~LightPropagationVolume() = default;
LightPropagationVolume::LightPropagationVolume(LightPropagationVolume&&) noexcept = default;
LightPropagationVolume& LightPropagationVolume::operator=(
    LightPropagationVolume&&) noexcept = default;

const LpvOptions& LightPropagationVolume::options() const { return mImpl->options; }
const std::optional<LatticeBox>& LightPropagationVolume::cells() const
{
    return mImpl->field.cells();
}

LatticeBox LightPropagationVolume::cellsOf(const Box3d& world, double spacing)
{
    LatticeBox box;
    for (int a = 0; a < 3; ++a) {
        const double lower = std::floor(world.min[a] / spacing + 1e-9);
        const double upper = std::ceil(world.max[a] / spacing - 1e-9);
        if (!(lower > -kMaxLattice && upper < kMaxLattice && lower <= upper)) {
            throw Error(ErrorCode::Usage,
                "The box of a light propagation volume is empty or has more cells than there can "
                "be; choose bounds that fit the spacing.");
        }
        box.lower[a] = static_cast<int>(lower);
        box.upper[a] = static_cast<int>(std::max(upper, lower + 1)) + 1;
    }
    return box;
}

void LightPropagationVolume::setCells(const LatticeBox& cells)
{
    for (int a = 0; a < 3; ++a) {
        if (cells.lower[a] < cells.upper[a] && cells.lower[a] > -kMaxLattice
            && cells.upper[a] < kMaxLattice) {
            continue;
        }
        throw Error(ErrorCode::Usage,
            "The cells of a light propagation volume are an empty box or beyond the lattice; give "
            "the lower corner first.");
    }
    clearLight();
    mImpl->field.setCells(cells);
}

void LightPropagationVolume::setGeometry(const std::vector<Blocker>& blockers)
{
    mImpl->geometry.clear();
    addGeometry(blockers);
}

void LightPropagationVolume::addGeometry(const std::vector<Blocker>& blockers)
{
    mImpl->field.setGeometry(nullptr);
    mImpl->geometry.merge(blockers);
    mImpl->geometryChanged();
}

void LightPropagationVolume::clearLight()
{
    mImpl->field.clearLight();
    mImpl->injected = Vec3d(0.0);
}

std::size_t LightPropagationVolume::inject(const std::vector<Surfel>& surfels)
{
    for (std::size_t i = 0; i < surfels.size(); ++i) check(surfels[i], i);
    std::size_t used = 0;
    for (const Surfel& s : surfels) {
        const Vec3d n(s.normal);
        const auto cell
            = mImpl->cellAt(s.position / mImpl->options.spacing + (0.5 + detail::kTie) * n);
        if (!cell) continue;
        ++used;
        const Vec3d flux(s.flux);
        if (flux != Vec3d(0.0)) mImpl->add(*cell, detail::cosineLobe(flux, n), flux);
    }
    return used;
}

bool LightPropagationVolume::injectSource(const Vec3d& position, const Color (&intensity)[4])
{
    for (const Color& c : intensity) {
        if (isFinite(Vec3d(c)) && isFinite(position)) continue;
        throw Error(ErrorCode::Usage, "A light source is NaN or infinite; leave it out.");
    }
    const auto cell = mImpl->cellAt(position / mImpl->options.spacing);
    if (!cell) return false;
    const CellState state = detail::fromIntensity(intensity);
    if (state != detail::noLight()) mImpl->add(*cell, state, Vec3d(state[0]) * detail::kFluxOfA);
    return true;
}

void LightPropagationVolume::step()
{
    mImpl->onThreads([this] { mImpl->field.step(); });
}

LpvReport LightPropagationVolume::propagate(const LpvStop& stop, Progress* progress)
{
    if (stop.iterations < 0) refuse("The number of iterations", stop.iterations, "0 or more");
    if (!(stop.tolerance >= 0)) refuse("The tolerance", stop.tolerance, "0 or more");
    if (progress) progress->begin("propagate light", static_cast<std::uint64_t>(stop.iterations));
    LpvReport report;
    const auto finished = [&] {
        return mImpl->field.dark() || (stop.tolerance > 0 && mImpl->residual() < stop.tolerance);
    };
    const auto loop = [&] {
        for (; report.iterations < stop.iterations && !finished(); ++report.iterations) {
            if (progress && progress->cancelled())
                throw Error(ErrorCode::Interrupted, "Interrupted while propagating light.");
            mImpl->field.step();
            if (progress) progress->advance(1);
        }
    };
    mImpl->onThreads(loop);
    report.residual = mImpl->residual();
    report.activeCells = activeCells();
    return report;
}

Vec3d LightPropagationVolume::frontFlux() const
{
    return mImpl->field.frontTotal() * detail::kFluxOfA;
}
Vec3d LightPropagationVolume::injectedFlux() const { return mImpl->injected; }
std::size_t LightPropagationVolume::activeCells() const
{
    return mImpl->field.activeLeaves() * detail::kLeafCells;
}
std::size_t LightPropagationVolume::memoryBytes() const
{
    return mImpl->field.memoryBytes() + mImpl->geometry.memoryBytes();
}

// ---- Queries.

bool LightPropagationVolume::Impl::interpolate(const Vec3d& p, CellState& out) const
{
    out = detail::noLight();
    if (!onLattice(p)) return false;
    Coord base = floorOf(p);
    if (const auto& box = field.cells()) {
        for (int a = 0; a < 3; ++a) {
            if (!(p[a] >= box->lower[a] && p[a] <= box->upper[a] - 1)) return false;
            base[a] = std::max(std::min(base[a], box->upper[a] - 2), box->lower[a]);
        }
    }
    const Vec3f t(p - Vec3d(base));
    for (int i = 0; i < 8; ++i) {
        const float w = (i & 1 ? t.x : 1 - t.x) * (i & 2 ? t.y : 1 - t.y) * (i & 4 ? t.z : 1 - t.z);
        if (w == 0) continue;
        const CellState s = field.sum(base + Coord(i & 1, (i >> 1) & 1, i >> 2));
        for (std::size_t k = 0; k < 4; ++k) out[k] += w * s[k];
    }
    return true;
}

bool LightPropagationVolume::radiance(const Vec3d& p, Color* L) const
{
    CellState state;
    const bool inside = mImpl->interpolate(p / mImpl->options.spacing, state);
    mImpl->toRadiance(state, L);
    return inside;
}

Color LightPropagationVolume::irradiance(const Vec3d& p, const Vec3f& n) const
{
    Color L[4];
    radiance(p, L);
    return lumivdb::irradiance(2, L, n);
}

void LightPropagationVolume::frontIntensity(const Coord& cell, Color (&I)[4]) const
{
    detail::toIntensity(mImpl->field.front(cell), I);
}

bool LightPropagationVolume::hasGeometry() const { return !mImpl->geometry.empty(); }
Vec3f LightPropagationVolume::blocking(const Coord& p) const { return mImpl->geometry.blocking(p); }

// ---- Volumes.

IrradianceVolume LightPropagationVolume::makeVolume() const
{
    VolumeBuilder builder(2, GradientStorage::None, latticeTransform(mImpl->options.spacing));
    if (const auto& box = cells()) {
        Coord upper = box->upper - Coord(1, 1, 1);
        for (int a = 0; a < 3; ++a) upper[a] = std::max(upper[a], box->lower[a] + 1);
        builder.addUniform(box->lower, upper);
    } else {
        const std::vector<Coord> leaves = mImpl->field.litLeaves();
        if (leaves.empty()) {
            throw Error(ErrorCode::Usage,
                "An unbounded light propagation volume without light has no extent; inject light "
                "or give it bounds.");
        }
        for (const Coord& at : leaves) builder.addUniform(at * 8, at * 8 + Coord(8, 8, 8));
    }
    IrradianceVolume volume = builder.build();
    detail::finishVolume(
        volume, [this](const Cell& cell) { return blocking(cell.origin); }, hasGeometry());
    updateVolume(volume);
    return volume;
}

void LightPropagationVolume::updateVolume(IrradianceVolume& volume) const
{
    detail::forSamples(volume, [this, &volume](SampleId s) {
        Coord cell = volume.samplePosition(s);
        // A volume of a single cell has samples beyond it.
        if (const auto& box = cells()) {
            for (int a = 0; a < 3; ++a)
                cell[a] = std::max(box->lower[a], std::min(cell[a], box->upper[a] - 1));
        }
        mImpl->toRadiance(mImpl->field.sum(cell), volume.radiance(s));
    });
}

} // namespace lumivdb
