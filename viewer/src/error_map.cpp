// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/viewer/picture.h>

#include "map.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>

namespace lumivdb {

namespace {

constexpr int kNormals = 16;

/// What one block of the map has found, in units of irradiance (luminance), means over normals.
struct Block {
    bool outside = true, invalid = false;
    double error = 0, reference = 0, noise = 0;
};

Block compare(const ProbeEstimator& estimator, const VolumeSampler& sampler,
    const std::vector<Vec3f>& normals, const Vec3d& p, std::uint64_t key,
    ProbeEstimator::Workspace& workspace)
{
    Block block;
    QueryInfo info;
    sampler.irradiance(p, normals.front(), &info);
    block.outside = info.level < 0;
    if (block.outside) return block;
    const ProbeResult truth = estimator.irradiance(p, normals, key, workspace);
    // Inside geometry there is no light to be wrong about.
    block.invalid = truth.validity < kValidThreshold;
    if (block.invalid) return block;
    for (std::size_t i = 0; i < normals.size(); ++i) {
        const double E = luminance(sampler.irradiance(p, normals[i]));
        const double reference = luminance(truth.value[i]);
        block.error += std::abs(E - reference) / double(normals.size());
        block.reference += reference / double(normals.size());
        block.noise += luminance(truth.stderr_[i]) / double(normals.size());
    }
    return block;
}

struct Blocks {
    int columns, rows;
    std::vector<Block> block;
};

Blocks traceBlocks(const Tracer& tracer, const VolumeSampler& sampler, const Frame& f,
    const ErrorMapOptions& options, Progress* progress)
{
    const ProbeEstimator estimator(tracer, options.reference);
    const std::vector<Vec3f> normals = uniformNormals(kNormals);
    Blocks out;
    out.columns = std::min(options.blocks, f.width);
    out.rows = std::clamp(int(std::lround(double(out.columns) * f.height / f.width)), 1, f.height);
    out.block.resize(std::size_t(out.columns) * out.rows);
    if (progress) progress->begin("trace the reference", out.rows);
    tbb::parallel_for(0, out.rows, [&](int j) {
        if (progress && progress->cancelled()) return;
        ProbeEstimator::Workspace workspace;
        for (int i = 0; i < out.columns; ++i) {
            const Vec3d p = f.upperLeft + f.right * ((i + 0.5) / out.columns)
                + f.down * ((j + 0.5) / out.rows);
            out.block[std::size_t(j) * out.columns + i] = compare(estimator, sampler, normals, p,
                hashPoint(options.reference.seed, i, j, options.slice.axis), workspace);
        }
        if (progress) progress->advance(1);
    });
    if (progress && progress->cancelled())
        throw Error(ErrorCode::Interrupted, "The map was interrupted before it was complete.");
    return out;
}

ErrorMapReport summarize(const Blocks& blocks)
{
    ErrorMapReport r;
    double error = 0, reference = 0, noise = 0;
    for (const Block& b : blocks.block) {
        if (b.outside || b.invalid) continue;
        ++r.points;
        error += b.error;
        reference += b.reference;
        noise += b.noise;
    }
    if (r.points > 0) r.meanReference = reference / double(r.points);
    if (reference > 0) {
        r.meanError = error / reference;
        r.meanNoise = noise / reference;
    }
    return r;
}

/// One value a pixel, errors over the mean irradiance of the whole slice.
std::vector<float> errorField(const Blocks& blocks, const Frame& f, double mean)
{
    std::vector<float> field(std::size_t(f.width) * f.height);
    for (int y = 0; y < f.height; ++y) {
        for (int x = 0; x < f.width; ++x) {
            const int i = int(std::int64_t(x) * blocks.columns / f.width);
            const int j = int(std::int64_t(y) * blocks.rows / f.height);
            const Block& b = blocks.block[std::size_t(j) * blocks.columns + i];
            float& out = field[std::size_t(y) * f.width + x];
            out = b.outside ? kOutside
                : b.invalid ? kInvalid
                : mean > 0  ? float(b.error / mean)
                            : 0;
        }
    }
    return field;
}

} // namespace

void ErrorMapOptions::validate() const
{
    slice.validate();
    reference.validate();
    if (blocks < 1 || blocks > 4096)
        throw Error(ErrorCode::Usage,
            "The number of blocks is " + std::to_string(blocks) + "; it must be 1 to 4096.");
}

Image renderError(const Tracer& tracer, const IrradianceVolume& volume,
    const ErrorMapOptions& options, ErrorMapReport* report, Progress* progress)
{
    options.validate();
    const VolumeSampler sampler(volume, options.slice.mode);
    const Frame frame = frameOf(volume.worldBounds(), options.slice);
    const Blocks blocks = traceBlocks(tracer, sampler, frame, options, progress);
    ErrorMapReport found = summarize(blocks);
    const std::vector<float> field = errorField(blocks, frame, found.meanReference);
    const Range range = chooseRange(field);
    found.low = range.low;
    found.high = range.high;
    const std::vector<Color> table = colourTable();
    Image image = emptyMap(frame);
    paintField(image, frame, field, range, table);
    drawGeometry(image, frame, tracer, 1.0);
    drawLegend(image, frame.height, range, table, 100, "%");
    if (report) *report = found;
    return image;
}

} // namespace lumivdb
