// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file evaluator.h
/// What evaluateVolume() does, point by point.

#include "own_estimator.h"

#include <lumivdb/bake/bake.h>

#include <memory>
#include <vector>

namespace lumivdb {

/// Compares a volume with independent references. Points come in portions, and every report is
/// about all so far: whoever wants to be surer adds some.
class Evaluator {
public:
    /// Of @a options, givenPoints and weights are the caller's affair: see add(). Where @a means
    /// has the mean irradiance, by channel, EvaluateOptions::rays are those of a point as bright as
    /// that and of weight 1, and others have them by what their noise makes of the result's.
    Evaluator(const IrradianceVolume& volume, const Tracer& tracer, const EvaluateOptions& options,
        const Vec3d& means = Vec3d(0.0));

    /// EvaluateOptions::points random ones in free space. @throws as evaluateVolume().
    void addRandom(Progress& progress);
    /// These; @a weights has one for each, or is empty: all 1.
    void add(
        const std::vector<Vec3d>& points, const std::vector<double>& weights, Progress& progress);

    /// With EvaluateReport::upper at @a confidence. @throws Error(Input) if no point counts.
    EvaluateReport report(double confidence) const;

private:
    /// One point that counts: the volume's answer and the reference, per normal.
    struct Comparison {
        Vec3d position;
        double weight = 1;
        std::vector<Color> volume, reference, error;
    };
    enum class Fate { Compared, InsideGeometry, OutsideVolume, NotFinite };

    std::vector<Vec3d> randomPoints(std::size_t count, int round) const;
    /// Compares at @a points, in parallel, and keeps @a most at most. @return outside the volume.
    std::size_t compare(const std::vector<Vec3d>& points, const std::vector<double>& weights,
        std::size_t most, Progress& progress);
    Fate compare(const Vec3d& p, Comparison& c);
    bool isOnBack(const Vec3d& p, int level) const;
    using References = std::vector<std::unique_ptr<OwnEstimator>>;
    References references(const Tracer& tracer, int rays) const;
    const References& referencesFor(const Comparison& c) const;
    static void join(const ProbeResult& second, Comparison& c);
    double summariseChannel(int c, double confidence, EvaluateReport& report) const;
    void listWorst(const Vec3d& means, EvaluateReport& report) const;
    double timeQueries() const;

    const IrradianceVolume& mVolume;
    const Tracer& mTracer;
    const EvaluateOptions mOptions;
    VolumeSampler mSampler;
    std::vector<Vec3f> mNormals;
    const Vec3d mMeans;
    std::vector<References> mReferences; // each of more rays than the one before
    std::vector<Comparison> mComparisons;
    std::size_t mRejected = 0, mOutside = 0;
};

} // namespace lumivdb
