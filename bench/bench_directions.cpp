// SPDX-License-Identifier: Apache-2.0
/// What noise looks like where points take turns with patterns of directions, as those of a bake
/// do, and where each has its own (white noise), on a horizontal slice of a scene:
/// lumivdb_bench_directions SCENE ENVIRONMENT|"" HEIGHT OUT.png [rays] [pixels] [reference rays]
///
/// Top row: irradiance of upward surfaces with patterns, with own directions, and the reference.
/// Bottom row: how far the first two are off, red above and blue below, and the difference of both.

#include "program.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/bake/environment.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/random.h>
#include <lumivdb/viewer/picture.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>

using namespace lumivdb;

namespace {

struct Slice {
    int width, height;
    std::vector<Vec3d> points;
};

/// Points of the box's horizontal section at @a y, @a pixels along its longer side.
Slice sliceAt(const Box3d& box, double y, int pixels)
{
    const Vec3d size = box.size();
    const double step = std::max(size.x, size.z) / pixels;
    Slice s{
        static_cast<int>(std::ceil(size.x / step)), static_cast<int>(std::ceil(size.z / step)), {}};
    for (int j = 0; j < s.height; ++j) {
        for (int i = 0; i < s.width; ++i)
            s.points.emplace_back(box.min.x + (i + 0.5) * step, y, box.min.z + (j + 0.5) * step);
    }
    return s;
}

/// Irradiance of upward surfaces; negative inside geometry.
using Values = std::vector<float>;

Values measure(const Tracer& tracer, const Slice& slice, int rays, std::uint64_t seed, bool shared)
{
    ProbeOptions options;
    options.rays = rays;
    options.seed = seed;
    const ProbeEstimator all(tracer, options);
    Values values(slice.points.size());
    tbb::parallel_for(std::size_t{0}, values.size(), [&](std::size_t i) {
        const std::uint64_t key = hashCombine(seed, i);
        ProbeEstimator::Workspace workspace;
        ProbeOptions own = options;
        own.seed = key;
        const ProbeResult r = shared
            ? all.irradiance(slice.points[i], {Vec3f(0, 1, 0)}, key, workspace)
            : ProbeEstimator(tracer, own)
                  .irradiance(slice.points[i], {Vec3f(0, 1, 0)}, key, workspace);
        values[i] = r.validity > 0.9f ? luminance(r.value[0]) : -1;
    });
    return values;
}

/// RMS, and the correlation of neighbours: 0 for white noise, 1 for what is smooth.
struct Noise {
    double rms = 0, correlation = 0;
};

Noise analyse(const Slice& slice, const Values& values, const Values& reference)
{
    double squares = 0, products = 0;
    int count = 0, pairs = 0;
    const auto valid = [&](std::size_t i) { return values[i] >= 0 && reference[i] >= 0; };
    const auto error = [&](std::size_t i) {
        return static_cast<double>(values[i]) - static_cast<double>(reference[i]);
    };
    for (std::size_t i = 0; i < values.size(); ++i) {
        if (!valid(i)) continue;
        squares += error(i) * error(i);
        ++count;
        if ((i + 1) % static_cast<std::size_t>(slice.width) == 0 || !valid(i + 1)) continue;
        products += error(i) * error(i + 1);
        ++pairs;
    }
    const double mean2 = squares / std::max(1, count);
    return {std::sqrt(mean2), products / std::max(1, pairs) / mean2};
}

double meanOf(const Values& values)
{
    double sum = 0;
    int count = 0;
    for (const float v : values) {
        if (v < 0) continue;
        sum += static_cast<double>(v);
        ++count;
    }
    return sum / std::max(1, count);
}

/// Red above 0, blue below.
Color signedColor(double v)
{
    const auto a = static_cast<float>(std::min(1.0, std::abs(v)));
    return v > 0 ? Color(1, 1 - a, 1 - a) : Color(1 - a, 1 - a, 1);
}

class Sheet {
public:
    Sheet(const Slice& slice, double mean)
        : mSlice(slice)
        , mMean(mean)
    {
        mImage.width = 3 * slice.width;
        mImage.height = 2 * slice.height;
        mImage.pixels.assign(static_cast<std::size_t>(mImage.width * mImage.height), Color(0.0f));
    }
    void irradiance(int column, const Values& v)
    {
        put(column, 0, [&](std::size_t i) {
            const double share = std::clamp(static_cast<double>(v[i]) / (3 * mMean), 0.0, 1.0);
            return Color(static_cast<float>(std::pow(share, 1 / 2.2)));
        });
    }
    void difference(int column, const Values& a, const Values& b, double scale)
    {
        put(column, 1, [&](std::size_t i) {
            if (a[i] < 0 || b[i] < 0) return Color(0.0f);
            return signedColor((static_cast<double>(a[i]) - static_cast<double>(b[i])) / scale);
        });
    }
    const Image& image() const { return mImage; }

private:
    template <class F> void put(int column, int row, const F& f)
    {
        for (int j = 0; j < mSlice.height; ++j) {
            for (int i = 0; i < mSlice.width; ++i) {
                const int x = column * mSlice.width + i, y = row * mSlice.height + j;
                mImage.pixels[static_cast<std::size_t>(y * mImage.width + x)]
                    = f(static_cast<std::size_t>(j * mSlice.width + i));
            }
        }
    }
    const Slice& mSlice;
    double mMean;
    Image mImage;
};

int run(int argc, char** argv)
{
    if (argc < 5) {
        std::fprintf(stderr,
            "usage: %s SCENE ENVIRONMENT|\"\" HEIGHT OUT.png [rays] [pixels] [reference rays]\n",
            argv[0]);
        return 2;
    }
    auto scene = std::make_shared<Scene>(loadScene(argv[1]));
    std::vector<std::string> warnings;
    if (argv[2][0]) scene->environment = Environment::load(argv[2], {}, warnings);
    const int rays = argc > 5 ? std::atoi(argv[5]) : 64,
              pixels = argc > 6 ? std::atoi(argv[6]) : 128,
              many = argc > 7 ? std::atoi(argv[7]) : 4096;
    const Tracer tracer(scene);
    const Slice slice = sliceAt(scene->bounds(), std::atof(argv[3]), pixels);
    const Values shared = measure(tracer, slice, rays, 1, true),
                 own = measure(tracer, slice, rays, 2, false),
                 reference = measure(tracer, slice, many, 3, false);
    const double mean = meanOf(reference);
    const Noise a = analyse(slice, shared, reference), b = analyse(slice, own, reference);
    std::printf("%s, %d rays: patterns rms %.2f%%, neighbours' correlation %.2f; own "
                "directions %.2f%%, %.2f\n",
        argv[1], rays, 100 * a.rms / mean, a.correlation, 100 * b.rms / mean, b.correlation);
    Sheet sheet(slice, mean);
    sheet.irradiance(0, shared);
    sheet.irradiance(1, own);
    sheet.irradiance(2, reference);
    sheet.difference(0, shared, reference, 3 * b.rms);
    sheet.difference(1, own, reference, 3 * b.rms);
    sheet.difference(2, shared, own, 3 * b.rms);
    writeDisplayImage(sheet.image(), argv[4]);
    return 0;
}

} // namespace

int main(int argc, char** argv) { return runProgram(run, argc, argv); }
