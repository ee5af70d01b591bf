// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/viewer/picture.h>

#include "probes.h"
#include "spheres.h"
#include "view.h"

#include <lumivdb/bake/environment.h>
#include <lumivdb/core/error.h>

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <string>

namespace lumivdb {

namespace {

/// In spacings.
constexpr double kNormalBias = 0.05;

constexpr float kInvPi = 0.318309886183790672f;

void require(bool good, const std::string& field, double value, const std::string& range)
{
    if (good) return;
    throw Error(ErrorCode::Usage,
        "The picture's " + field + " is " + std::to_string(value) + "; it must be " + range + ".");
}

/// Everything a pixel needs; shared by all threads.
struct Stage {
    const Tracer& tracer;
    const VolumeSampler& sampler;
    View view;
    std::vector<Sphere> spheres;
    const Probes* probes; ///< null: none
    double offset; ///< world units off a surface of the scene at which the volume is asked

    Color reflected(const Vec3d& p, const Vec3f& n, const Color& albedo) const
    {
        const Color E = sampler.irradiance(p, n);
        Color out(0);
        for (int c = 0; c < 3; ++c)
            if (E[c] > 0) out[c] = albedo[c] * kInvPi * E[c]; // false for NaN: outside the volume
        return out;
    }

    Color background(const Vec3d& direction) const
    {
        const Environment* environment = tracer.scene().environment.get();
        return environment ? environment->radiance(direction) : Color(0);
    }

    /// What a ray through pixel (x, y) shows; @a invalid is set where it is an invalid sample.
    Color shade(const Vec3d& direction, int x, int y, bool* invalid) const
    {
        const SurfaceHit h = tracer.intersect(view.eye, direction);
        double nearest = h.hit ? h.distance : INFINITY;
        if (probes) {
            Color colour;
            if (probes->shade(view.eye, direction, x, y, nearest, &colour, invalid)) return colour;
        }
        const Sphere* sphere = nullptr;
        for (const Sphere& s : spheres) {
            const double t = s.intersect(view.eye, direction);
            if (t < 0 || t >= nearest) continue;
            nearest = t;
            sphere = &s;
        }
        if (sphere) {
            const Vec3d p = view.eye + direction * nearest;
            const Vec3d n = (p - sphere->centre).normalized();
            return reflected(p, Vec3f(float(n.x), float(n.y), float(n.z)), Color(kSphereAlbedo));
        }
        if (!h.hit) return background(direction);
        const Vec3f n = h.backFace ? -h.normal : h.normal;
        const Vec3d off = h.position + Vec3d(n.x, n.y, n.z) * offset;
        return h.emission + reflected(off, n, h.albedo);
    }
};

/// The mean of a square grid of rays, summed in a fixed order. @a red: share of invalid samples.
Color renderPixel(
    const Stage& stage, const PictureOptions& options, int x, int y, int grid, float* red)
{
    Color sum(0);
    int invalids = 0;
    for (int j = 0; j < grid; ++j) {
        for (int i = 0; i < grid; ++i) {
            const double s = (x + (i + 0.5) / grid) / options.width;
            const double t = (y + (j + 0.5) / grid) / options.height;
            bool invalid = false;
            sum += stage.shade(stage.view.direction(s, t), x, y, &invalid);
            invalids += invalid;
        }
    }
    *red = float(invalids) / float(grid * grid);
    return sum / float(grid * grid);
}

} // namespace

void PictureOptions::validate() const
{
    require(width >= 1 && width <= 16384, "width", width, "1 to 16384 pixels");
    require(height >= 1 && height <= 16384, "height", height, "1 to 16384 pixels");
    require(samplesPerPixel >= 1 && samplesPerPixel <= 4096, "number of samples per pixel",
        samplesPerPixel, "1 to 4096");
    require(yfovDegrees >= 0 && yfovDegrees <= 179, "field of view", yfovDegrees,
        "above 0 and at most 179 degrees, or 0 for the default");
    require(spheres >= 0 && spheres <= 1000, "number of spheres", spheres, "0 to 1000");
}

Image renderPicture(const Tracer& tracer, const IrradianceVolume& volume,
    const PictureOptions& options, Progress* progress)
{
    options.validate();
    // Surfaces are looked at from just before them: a wall divides what is seen on its two sides.
    const VolumeSampler sampler(
        volume, SamplerOptions{options.mode, Precision::Float, kNormalBias * volume.spacing()});
    Stage stage{tracer, sampler, chooseView(tracer, volume.worldBounds(), options), {}, nullptr,
        kQueryOffset * volume.spacing()};
    std::optional<Probes> probes;
    if (options.probes) {
        probes.emplace(volume, stage.view, options.width, options.height);
        stage.probes = &*probes;
    } else {
        stage.spheres = placeSpheres(tracer, sampler, stage.view, options.spheres);
    }

    Image image;
    image.width = options.width;
    image.height = options.height;
    image.pixels.resize(std::size_t(image.width) * image.height);
    std::vector<float> red(image.pixels.size());
    const int grid = std::max(1, int(std::lround(std::sqrt(double(options.samplesPerPixel)))));
    if (progress) progress->begin("render picture", options.height);
    tbb::parallel_for(0, options.height, [&](int y) {
        if (progress && progress->cancelled()) return;
        const std::size_t row = std::size_t(y) * image.width;
        for (int x = 0; x < image.width; ++x)
            image.pixels[row + x] = renderPixel(stage, options, x, y, grid, &red[row + x]);
        if (progress) progress->advance(1);
    });
    if (progress && progress->cancelled())
        throw Error(ErrorCode::Interrupted, "The picture was interrupted before it was complete.");
    // Red as bright as the picture is, so that it is seen in a dark one and in a bright one.
    const float bright = float(0.7 / automaticExposure(image));
    for (std::size_t i = 0; i < red.size(); ++i)
        if (red[i] > 0) image.pixels[i] += Color(bright, 0.02f * bright, 0.02f * bright) * red[i];
    return image;
}

} // namespace lumivdb
