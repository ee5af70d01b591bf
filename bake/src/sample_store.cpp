// SPDX-License-Identifier: Apache-2.0
#include "sample_store.h"

#include <lumivdb/core/random.h>
#include <lumivdb/core/volume.h>

#include <algorithm>
#include <cmath>
#include <tuple>

namespace lumivdb {

std::size_t CoordHash::operator()(const Coord& c) const
{
    return static_cast<std::size_t>(hashPoint(0, c.x, c.y, c.z));
}

SampleStore::SampleStore(const Tracer& tracer, const SampleSettings& settings)
    : mBaker(tracer, settings)
    , mStride(static_cast<std::size_t>(coefficientCount(settings.bands))
          * (settings.gradients == GradientMethod::None ? 1 : 4))
{
}

void SampleStore::keepMissing(std::vector<Coord>& points) const
{
    const auto known = [&](const Coord& p) { return mIndex.count(p) != 0; };
    points.erase(std::remove_if(points.begin(), points.end(), known), points.end());
    std::sort(points.begin(), points.end(), [](const Coord& a, const Coord& b) {
        return std::tie(a.x, a.y, a.z) < std::tie(b.x, b.y, b.z);
    });
    points.erase(std::unique(points.begin(), points.end()), points.end());
}

std::size_t SampleStore::missing(std::vector<Coord> points) const
{
    keepMissing(points);
    return points.size();
}

void SampleStore::require(std::vector<Coord> points, Outlook& outlook)
{
    keepMissing(points);
    if (points.empty()) return;
    trace(points, outlook);
}

void SampleStore::trace(const std::vector<Coord>& points, Outlook& outlook)
{
    const std::size_t first = mInfo.size();
    mInfo.resize(first + points.size());
    mRecords.resize((first + points.size()) * mStride);
    std::vector<std::uint64_t> rays(points.size()), directions(points.size());
    bakeSamples(
        mBaker, points.size(), [&](std::size_t i) { return points[i]; },
        [&](std::size_t i, const BakedSample& s) {
            mInfo[first + i]
                = {points[i], s.result.validity, s.result.distance, s.offset, s.variance};
            Color* record = mRecords.data() + (first + i) * mStride;
            record = std::copy(s.result.value.begin(), s.result.value.end(), record);
            std::copy(s.result.gradient.begin(), s.result.gradient.end(), record);
            rays[i] = s.rays;
            directions[i] = s.result.directions;
        },
        outlook);
    for (std::size_t i = 0; i < points.size(); ++i) {
        mIndex.emplace(points[i], first + i);
        mRays += rays[i];
        mDirections += directions[i];
        outlook.addSample(static_cast<double>(directions[i]));
    }
}

bool SampleStore::isValid(std::size_t i) const { return mInfo[i].validity >= kValidThreshold; }

const Color* SampleStore::gradient(std::size_t i) const
{
    const int n = coefficientCount(settings().bands);
    return settings().gradients == GradientMethod::None ? nullptr : radiance(i) + n;
}

Vec3d SampleStore::measured(std::size_t i) const
{
    return mBaker.world(mInfo[i].position) + Vec3d(mInfo[i].offset);
}

int SampleStore::meanDirections() const
{
    return static_cast<int>((mDirections + size() / 2) / std::max<std::size_t>(1, size()));
}

double SampleStore::meanRelativeStderr() const
{
    double mean = 0, error = 0;
    for (std::size_t i = 0; i < mInfo.size(); ++i) {
        // E averaged over normals is A_0 Y_0 L_00 = π · 0.282 · L_00.
        mean += kCosineLobe[0] * 0.28209479177387814 * luminance(radiance(i)[0]);
        error += std::sqrt(luminance(mInfo[i].variance));
    }
    return mean > 0 ? error / mean : 0;
}

} // namespace lumivdb
