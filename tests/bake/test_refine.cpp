// SPDX-License-Identifier: Apache-2.0
// Adaptive bakes: what each heuristic must do, that bits depend on nothing but the inputs, that an
// error target holds at points of another seed.

#include "bake_makers.h"

#include "../../bake/src/refiner.h"

#include <lumivdb/bake/geometry_cells.h>

#include <catch2/catch.hpp>

#include <algorithm>
#include <map>

using namespace lumivdb;
using namespace lumivdb::test;

namespace {

BakeOptions adaptive(double spacing, int levels, const Vec3d& lower, const Vec3d& upper, int rays)
{
    BakeOptions o = bakeOptions(spacing, lower, upper, rays);
    o.levels = levels;
    return o;
}

Scene openSky(float radiance)
{
    Scene scene;
    scene.environment = Environment::constant(Color(radiance));
    return scene;
}

Box3d worldBox(const IrradianceVolume& v, const Cell& cell)
{
    const Vec3d lower(cell.origin.x, cell.origin.y, cell.origin.z);
    return Box3d(lower * v.spacing(), (lower + Vec3d(1 << cell.level)) * v.spacing());
}

} // namespace

TEST_CASE("light that does not change needs no split; brute force merges all again", "[refine]")
{
    const auto tracer = makeTracer(openSky(0.7f));
    for (const auto heuristic : {RefineHeuristic::Error, RefineHeuristic::Gradient,
             RefineHeuristic::Geometry, RefineHeuristic::Harmonic, RefineHeuristic::Brute}) {
        BakeOptions o = adaptive(0.25, 3, Vec3d(0.0), Vec3d(4.0), 64);
        o.refine.heuristics = {heuristic};
        const BakeResult r = bakeVolume(*tracer, o);
        CAPTURE(name(heuristic));
        CHECK(r.report.cellsByLevel == std::vector<std::uint64_t>{0, 0, 0, 8});
        CHECK(r.report.samples == 27);
    }
}

TEST_CASE("geometry: cells that touch a surface go down to the level asked for", "[refine]")
{
    Scene scene = openSky(1);
    const int white = addMaterial(scene, Color(0.5f), Color(0.0f), true);
    addQuad(scene, white, {0.3, 1.1, 0.2}, {1.7, 0, 0}, {0, 0.4, 1.1});
    const auto tracer = makeTracer(std::move(scene));
    const GeometryCells geometry(*tracer);
    for (const int level : {0, 1, 2}) {
        BakeOptions o = adaptive(0.125, 4, Vec3d(0.0), Vec3d(8.0), 8);
        o.refine.heuristics = {RefineHeuristic::Geometry};
        o.refine.geometry = level;
        const IrradianceVolume v = bakeVolume(*tracer, o).volume;
        std::size_t touching = 0, coarse = 0;
        for (CellId id = 0; id < static_cast<CellId>(v.cellCount()); ++id) {
            const Cell& cell = v.cell(id);
            coarse += cell.level == 4;
            if (!geometry.touches(worldBox(v, cell))) continue;
            ++touching;
            CHECK(cell.level <= level);
        }
        CHECK(touching > 0);
        CHECK(coarse > 0);
    }
}

TEST_CASE("harmonic: no cell is wider than the mean distance at its corners allows", "[refine]")
{
    const auto tracer = makeTracer(litRoom());
    BakeOptions o = adaptive(0.05, 4, Vec3d(0.0), Vec3d(1.6), 64);
    o.refine.heuristics = {RefineHeuristic::Harmonic};
    o.refine.harmonic = 0.7;
    const IrradianceVolume v = bakeVolume(*tracer, o).volume;
    std::map<int, int> levels;
    for (CellId id = 0; id < static_cast<CellId>(v.cellCount()); ++id) {
        const Cell& cell = v.cell(id);
        ++levels[cell.level];
        for (const SampleId s : cell.corners) {
            if (cell.level > 0) CHECK(v.distance(s) >= 0.7 * (1 << cell.level) * 0.05);
        }
    }
    CHECK(levels.size() > 2);
}

TEST_CASE("gradient: cells across which irradiance changes much are the finest", "[refine]")
{
    const auto tracer = makeTracer(litRoom());
    BakeOptions o = adaptive(0.1, 3, Vec3d(0.0), Vec3d(1.6), 64);
    o.refine.heuristics = {RefineHeuristic::Gradient};
    const auto count = [&](double threshold) {
        o.refine.gradient = threshold;
        return bakeVolume(*tracer, o).report.samples;
    };
    const auto coarse = count(4), middle = count(0.5), fine = count(0.1);
    CHECK(coarse < middle);
    CHECK(middle < fine);
}

TEST_CASE("the same bits for 1, 2 and 4 threads, adaptive", "[refine][determinism]")
{
    const auto tracer = makeTracer(litRoom());
    BakeOptions o = adaptive(0.1, 3, Vec3d(-0.1), Vec3d(1.65), 64);
    o.gradients = GradientMethod::Analytic;
    o.refine.error = 0.1;
    o.threads = 1;
    const IrradianceVolume one = bakeVolume(*tracer, o).volume;
    CHECK(one.cellsByLevel().size() > 2);
    for (const int threads : {2, 4}) {
        o.threads = threads;
        const IrradianceVolume many = bakeVolume(*tracer, o).volume;
        REQUIRE(many.cellCount() == one.cellCount());
        CHECK(differentRecords(one, many) == 0);
        std::size_t otherMasks = 0;
        for (CellId id = 0; id < static_cast<CellId>(one.cellCount()); ++id) {
            const CellVisibility *a = one.visibility(id), *b = many.visibility(id);
            otherMasks += (a == nullptr) != (b == nullptr) || (a && !(*a == *b));
        }
        CHECK(otherMasks == 0);
    }
}

TEST_CASE("parts: the cells and records of the whole, none twice", "[refine][determinism]")
{
    Scene scene = litRoom();
    const auto tracer = makeTracer(std::move(scene));
    BakeOptions o = adaptive(0.1, 1, Vec3d(-0.1), Vec3d(4.1, 1.65, 1.65), 8);
    o.refine.error = 0.2;
    const IrradianceVolume whole = bakeVolume(*tracer, o).volume;
    CHECK(whole.cellsByLevel().size() == 2);
    std::size_t cells = 0, wrong = 0;
    o.parts = 3;
    for (o.part = 1; o.part <= o.parts; ++o.part) {
        const IrradianceVolume part = bakeVolume(*tracer, o).volume;
        CHECK(part.cellCount() < whole.cellCount() * 2 / 3);
        cells += part.cellCount();
        CHECK(part.latticeBounds() == whole.latticeBounds());
        for (CellId id = 0; id < static_cast<CellId>(part.cellCount()); ++id) {
            const Cell& cell = part.cell(id);
            const CellId same = whole.findCell(cell.origin);
            wrong += whole.cell(same).level != cell.level;
            const CellVisibility *a = whole.visibility(same), *b = part.visibility(id);
            wrong += (a == nullptr) != (b == nullptr) || (a && !(*a == *b));
        }
        for (SampleId s = 0; s < part.sampleCount(); ++s) {
            const auto same = static_cast<SampleId>(whole.findSample(part.samplePosition(s)));
            wrong += !sameRecord(part, s, whole, same) || part.offset(s) != whole.offset(same);
        }
    }
    CHECK(cells == whole.cellCount());
    CHECK(wrong == 0);
}

TEST_CASE("error-driven cells beat a uniform lattice of more samples", "[refine][error][heavy]")
{
    const auto tracer = makeTracer(litRoom());
    const Vec3d lower(0.0), upper(1.6);
    // Five bands: under a lamp three leave out as much as a coarse lattice does.
    BakeOptions o = adaptive(0.025, 4, lower, upper, 512), u = bakeOptions(0.1, lower, upper, 512);
    o.bands = u.bands = 5;
    o.refine.error = 0.06;
    const IrradianceVolume fine = bakeVolume(*tracer, o).volume;
    const IrradianceVolume uniform = bakeVolume(*tracer, u).volume;
    EvaluateOptions e;
    e.points = 200;
    e.rays = 512;
    e.normals = 16;
    const double adaptiveError = evaluateVolume(fine, *tracer, e).relRmseDebiased;
    const double uniformError = evaluateVolume(uniform, *tracer, e).relRmseDebiased;
    CAPTURE(fine.sampleCount(), uniform.sampleCount(), adaptiveError, uniformError);
    CHECK(fine.sampleCount() < uniform.sampleCount());
    CHECK(adaptiveError < uniformError);
}

TEST_CASE("an error target holds at points of other seeds", "[refine][target][heavy]")
{
    // A closed room with its lamp far from the region: light that changes slowly.
    Scene scene;
    const int white = addMaterial(scene, Color(0.6f), Color(0.0f), false);
    const int panel = addMaterial(scene, Color(0.2f), Color(4, 3, 2), true);
    addInwardBox(scene, white, Vec3d(0.0), Vec3d(4.0));
    addQuad(scene, panel, {1, 3.9, 1}, {2, 0, 0}, {0, 0, 2});
    const auto tracer = makeTracer(std::move(scene));
    BakeOptions o;
    o.bounds = Box3d(Vec3d(0.5), Vec3d(2.5));
    o.bands = 0;
    for (const double target : {0.15, 0.06}) {
        o.target.error = target;
        const BakeResult r = bakeVolume(*tracer, o);
        CAPTURE(target, r.report.samples, r.report.achieved.upper);
        CHECK(r.report.achieved.met);
        CHECK(r.report.achieved.upper <= target);
        CHECK(r.volume.metadata().errorAsked == target);
        CHECK(r.volume.metadata().errorReached == r.report.achieved.upper);
        CHECK_FALSE(r.report.decisions.empty());
        EvaluateOptions e;
        e.points = 200;
        e.rays = 1024;
        e.mode = VolumeSampler::bestMode(r.volume);
        e.seed = 99;
        CHECK(evaluateVolume(r.volume, *tracer, e).relRmseDebiased <= target);
    }
}

TEST_CASE("an error target holds in all of the box that the volume says it fills",
    "[refine][target][heavy]")
{
    // The bounds end just below a lamp and inside the finest cells, which reach up to it.
    Scene scene;
    const int grey = addMaterial(scene, Color(0.3f), Color(0.0f), false);
    const int lamp = addMaterial(scene, Color(0.0f), Color(20.0f), false);
    addInwardBox(scene, grey, Vec3d(0.0), Vec3d(1.0));
    addQuad(scene, lamp, {0.4, 0.999, 0.4}, {0.2, 0, 0}, {0, 0, 0.2});
    const auto tracer = makeTracer(std::move(scene));
    BakeOptions o;
    o.bounds = Box3d(Vec3d(0.0), Vec3d(1.0, 0.996, 1.0));
    o.bands = 5;
    o.target.error = 0.35;
    const BakeResult r = bakeVolume(*tracer, o);
    CHECK(r.report.achieved.met);
    const LatticeBox box = r.volume.latticeBounds();
    CHECK(box.upper.y * r.volume.spacing() > 0.998);
    // Proven beside the lamp's edges, beyond what was asked for, where it is wrong most.
    double highest = 0;
    for (const auto& w : r.report.achieved.worst) highest = std::max(highest, w.position.y);
    CHECK(highest > 0.998);
    EvaluateOptions e;
    e.points = 4000;
    e.rays = 256;
    e.mode = VolumeSampler::bestMode(r.volume);
    e.seed = 99;
    CHECK(evaluateVolume(r.volume, *tracer, e).relRmseDebiased <= o.target.error);
}

TEST_CASE("a threshold lowered for a few samples brings about a few", "[refine][target]")
{
    Scene scene = openSky(1);
    const int white = addMaterial(scene, Color(0.5f), Color(0.0f), true);
    addQuad(scene, white, {0.3, 1.1, 0.2}, {1.7, 0, 0}, {0, 0.4, 1.1});
    const auto tracer = makeTracer(std::move(scene));
    SampleSettings samples;
    samples.probe.rays = 256;
    samples.spacing = 0.125;
    samples.levels = 4;
    RefineOptions options;
    options.geometryLevel = 4; // by the error alone
    Progress quiet;
    Outlook outlook(quiet, false);
    const auto grown = [&](double wanted, double least, double& threshold) {
        SampleStore store(*tracer, samples);
        Refiner refiner(
            *tracer, store, options, {Coord(0, 0, 0), Coord(32, 32, 32)}, 4, Vec3d(kPi));
        const RefinedCells cells = refiner.run(0.01, outlook);
        const double before = static_cast<double>(store.size());
        threshold = refiner.lowerThreshold(cells, wanted, least);
        refiner.run(threshold, outlook);
        return static_cast<double>(store.size()) - before;
    };
    const double least = 0.003;
    double all = 0, few = 0, more = 0;
    const double most = grown(1e9, least, all);
    CHECK(all == least);
    REQUIRE(most > 300);
    const double little = grown(most / 10, least, few), half = grown(most / 2, least, more);
    CAPTURE(most, little, half, few, more);
    CHECK(few > more);
    CHECK(more > least);
    CHECK(few < 0.01);
    CHECK(little > 0);
    CHECK(little < most / 3);
    CHECK(half < most);
}

TEST_CASE("a target out of reach is said to be, and the volume is there", "[refine][target]")
{
    const auto tracer = makeTracer(litRoom());
    BakeOptions o;
    o.bounds = Box3d(Vec3d(0.0), Vec3d(1.6));
    o.bands = 2;
    o.target.error = 0.005;
    o.target.chooseRays = false;
    o.target.maxSamples = 1500;
    o.probe.rays = 64;
    const BakeResult r = bakeVolume(*tracer, o);
    CHECK_FALSE(r.report.achieved.met);
    CHECK(r.report.achieved.upper > 0.005);
    CHECK_FALSE(r.report.achieved.worst.empty());
    CHECK_FALSE(r.report.warnings.empty());
    CHECK(r.volume.sampleCount() > 100);
    CHECK(r.volume.bands() == 2);
}

TEST_CASE("a target says where a point light makes it meaningless", "[refine][target]")
{
    const auto warned = [](const Vec3d& position, Contribution contribution) {
        Scene scene = litRoom();
        Light lamp;
        lamp.name = "bulb";
        lamp.position = position;
        scene.lights.push_back(lamp);
        BakeOptions o;
        o.bounds = Box3d(Vec3d(0.0), Vec3d(1.0));
        o.bands = 2;
        o.target.error = 0.001;
        o.target.chooseRays = false;
        o.target.maxSamples = 1000;
        o.probe.rays = 16;
        o.probe.contribution = contribution;
        const BakeReport report = bakeVolume(*makeTracer(std::move(scene)), o).report;
        return std::any_of(report.warnings.begin(), report.warnings.end(),
            [](const std::string& w) { return w.find("'bulb'") != std::string::npos; });
    };
    CHECK(warned({0.5, 0.5, 0.5}, Contribution::All));
    CHECK_FALSE(warned({0.5, 0.5, 0.5}, Contribution::Indirect));
    CHECK_FALSE(warned({1.5, 0.5, 1.5}, Contribution::All));
}

TEST_CASE("refinement options that make no sense are refused", "[refine][error]")
{
    const auto refused = [](auto change) {
        BakeOptions o;
        change(o);
        return !errorOf(ErrorCode::Usage, [&] { o.validate(); }).empty();
    };
    CHECK(refused([](BakeOptions& o) { o.levels = 13; }));
    CHECK(refused([](BakeOptions& o) { o.levels = -2; }));
    CHECK(refused([](BakeOptions& o) { o.bands = 7; }));
    CHECK(refused([](BakeOptions& o) { o.target.error = -0.1; }));
    CHECK(refused([](BakeOptions& o) { o.target.confidence = 1; }));
    CHECK(refused([](BakeOptions& o) { o.refine.error = 0; }));
    CHECK(refused([](BakeOptions& o) { o.refine.geometry = 13; }));
    CHECK(refused([](BakeOptions& o) { o.refine.heuristics.clear(); }));
    CHECK(refused([](BakeOptions& o) { o.levels = 2, o.part = 3, o.parts = 2; }));
    CHECK(refused([](BakeOptions& o) { o.parts = 2; })); // uniform
    CHECK(refused([](BakeOptions& o) { o.levels = 2, o.part = 2, o.parts = 2; })); // no spacing
    CHECK_FALSE(
        refused([](BakeOptions& o) { o.levels = 2, o.part = 2, o.parts = 2, o.spacing = 1; }));
}
