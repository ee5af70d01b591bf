// SPDX-License-Identifier: Apache-2.0
#include <lumivdb/core/volume_fill.h>

#include <algorithm>
#include <array>
#include <vector>

namespace lumivdb {

namespace {

/// Cells around the samples that want a value.
class Filler {
public:
    explicit Filler(IrradianceVolume& volume)
        : mVolume(volume)
        , mRing(volume.sampleCount(), 0)
    {
        for (std::size_t s = 0; s < mRing.size(); ++s) {
            if (volume.isValid(static_cast<SampleId>(s))) continue;
            mRing[s] = kUnreached;
            clear(static_cast<SampleId>(s));
            ++mWanting;
        }
        if (mWanting == 0) return;
        for (std::size_t c = 0; c < volume.cellCount(); ++c) {
            const Cell& cell = volume.cell(static_cast<CellId>(c));
            for (int i = 0; i < 8; ++i) {
                if (mRing[cell.corners[i]] != 0)
                    mLinks.emplace_back(cell.corners[i], static_cast<CellId>(c));
            }
        }
        std::sort(mLinks.begin(), mLinks.end());
    }

    void run()
    {
        for (int ring = 1; mWanting > 0 && fillRing(ring); ++ring) { }
    }

private:
    static constexpr int kUnreached = -1;
    using Links = std::vector<std::pair<SampleId, CellId>>;

    void clear(SampleId s)
    {
        std::fill_n(mVolume.radiance(s), mVolume.coefficients(), Color(0.0f));
        if (mVolume.hasGradients())
            std::fill_n(mVolume.gradient(s), 3 * mVolume.coefficients(), Color(0.0f));
    }

    /// Fills what touches earlier rings; false when nothing does.
    bool fillRing(int ring)
    {
        bool any = false;
        Links left;
        for (auto it = mLinks.begin(); it != mLinks.end();) {
            const SampleId s = it->first;
            const auto end
                = std::find_if(it, mLinks.end(), [s](const auto& link) { return link.first != s; });
            if (fill(s, it, end, ring)) {
                mRing[s] = ring;
                any = true;
                --mWanting;
            } else {
                left.insert(left.end(), it, end);
            }
            it = end;
        }
        mLinks.swap(left);
        return any;
    }

    bool fill(SampleId s, Links::const_iterator begin, Links::const_iterator end, int ring)
    {
        mNear.clear();
        for (auto it = begin; it != end; ++it) {
            for (const SampleId other : mVolume.cell(it->second).corners)
                if (mRing[other] >= 0 && mRing[other] < ring) mNear.push_back(other);
        }
        if (mNear.empty()) return false;
        std::sort(mNear.begin(), mNear.end());
        mNear.erase(std::unique(mNear.begin(), mNear.end()), mNear.end());
        const auto n = static_cast<std::size_t>(mVolume.coefficients());
        mSums.assign(n, Vec3d(0.0));
        double weights = 0;
        for (const SampleId other : mNear) {
            const Vec3d d = Vec3d(mVolume.samplePosition(other) - mVolume.samplePosition(s));
            const double w = 1 / d.length2();
            weights += w;
            for (std::size_t i = 0; i < n; ++i) mSums[i] += Vec3d(mVolume.radiance(other)[i]) * w;
        }
        for (std::size_t i = 0; i < n; ++i) mVolume.radiance(s)[i] = Color(mSums[i] / weights);
        return true;
    }

    IrradianceVolume& mVolume;
    std::vector<int> mRing; // 0: valid, k: filled in the k-th round
    std::size_t mWanting = 0;
    Links mLinks; // sample that wants a value, cell it is a corner of; sorted
    std::vector<SampleId> mNear;
    std::vector<Vec3d> mSums;
};

} // namespace

void fillInvalid(IrradianceVolume& volume) { Filler(volume).run(); }

} // namespace lumivdb
