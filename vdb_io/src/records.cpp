// SPDX-License-Identifier: Apache-2.0
#include "records.h"

#include <algorithm>
#include <cstring>

namespace lumivdb {

void copyRecord(const IrradianceVolume& from, SampleId s, IrradianceVolume& to, SampleId t)
{
    const int n = from.coefficients();
    std::copy_n(from.radiance(s), n, to.radiance(t));
    if (from.hasGradients()) std::copy_n(from.gradient(s), 3 * n, to.gradient(t));
    to.validity(t) = from.validity(s);
    to.distance(t) = from.distance(s);
}

bool sameRecord(
    const IrradianceVolume& a, SampleId s, const IrradianceVolume& b, SampleId t, bool colors)
{
    const auto bytes = sizeof(Color) * static_cast<std::size_t>(a.coefficients());
    const auto same = [](const auto* x, const auto* y, std::size_t size) {
        return std::memcmp(x, y, size) == 0;
    };
    const float scalarsA[2] = {a.validity(s), a.distance(s)};
    const float scalarsB[2] = {b.validity(t), b.distance(t)};
    const Vec3f offsetA = a.offset(s), offsetB = b.offset(t);
    if (!same(scalarsA, scalarsB, sizeof scalarsA) || !same(&offsetA, &offsetB, sizeof offsetA))
        return false;
    return !colors
        || (same(a.radiance(s), b.radiance(t), bytes)
            && (!a.hasGradients() || same(a.gradient(s), b.gradient(t), 3 * bytes)));
}

void copyPlaces(const std::vector<const IrradianceVolume*>& from, IrradianceVolume& to)
{
    std::vector<Vec3f> offsets;
    std::vector<std::pair<CellId, CellVisibility>> cuts;
    std::vector<bool> known(to.cellCount(), false);
    for (auto volume = from.rbegin(); volume != from.rend(); ++volume) {
        const IrradianceVolume& v = **volume;
        for (std::size_t i = 0; i < v.sampleCount() && v.hasOffsets(); ++i) {
            const auto s = static_cast<SampleId>(i);
            const std::int64_t t = to.findSample(v.samplePosition(s));
            if (t < 0) continue;
            offsets.resize(to.sampleCount(), Vec3f(0.0f));
            offsets[static_cast<std::size_t>(t)] = v.offset(s);
        }
    }
    for (const IrradianceVolume* volume : from) {
        for (std::size_t i = 0; i < volume->cellCount() && volume->hasVisibility(); ++i) {
            const auto id = static_cast<CellId>(i);
            const CellId target = to.findCell(volume->cell(id).origin);
            if (target == kNoCell || known[static_cast<std::size_t>(target)]
                || to.cell(target).level != volume->cell(id).level) {
                continue;
            }
            known[static_cast<std::size_t>(target)] = true;
            if (const CellVisibility* v = volume->visibility(id)) cuts.emplace_back(target, *v);
        }
    }
    std::vector<Vec3f> blocking;
    for (auto volume = from.rbegin(); volume != from.rend(); ++volume) {
        for (std::size_t i = 0; i < (*volume)->cellCount() && (*volume)->hasBlocking(); ++i) {
            const Cell& cell = (*volume)->cell(static_cast<CellId>(i));
            const CellId target = to.findCell(cell.origin);
            if (target == kNoCell || to.cell(target).level != cell.level) continue;
            blocking.resize(to.cellCount(), Vec3f(0.0f));
            blocking[static_cast<std::size_t>(target)]
                = (*volume)->blocking(static_cast<CellId>(i));
        }
    }
    to.setBlocking(std::move(blocking));
    to.setOffsets(std::move(offsets));
    to.setVisibility(cuts);
}

void forgetError(VolumeMetadata& metadata)
{
    metadata.errorReached = -1.0;
    metadata.errorConfidence = 0.0;
    metadata.cacheBias = metadata.cacheBiasUpper = -1.0;
}

} // namespace lumivdb
