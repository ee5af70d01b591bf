// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <lumivdb/core/volume.h>

#include <filesystem>
#include <string>
#include <vector>

namespace vdb_test {

using namespace lumivdb;

/// A fresh folder, removed with all in it at the end.
class TempFolder {
public:
    TempFolder();
    ~TempFolder();
    std::string file(const std::string& name) const { return (mPath / name).string(); }
    const std::filesystem::path& path() const { return mPath; }
    std::size_t entries() const;

private:
    std::filesystem::path mPath;
};

/// Fills every record with numbers that depend on the sample alone (all signs and magnitudes).
void fillRandom(IrradianceVolume& volume, std::uint64_t seed, float magnitude = 1.0f);

/// Random visibility and blocking for about half the cells, random offsets for some samples, and
/// bounds.
void cutAndMove(IrradianceVolume& volume, std::uint64_t seed);

IrradianceVolume uniformVolume(
    const Coord& lower, const Coord& upper, int bands, bool gradients, double spacing = 0.5);

/// Levels 0 … @a rootLevel around lattice point @a target: a cell of level k > 0 whose Chebyshev
/// distance to the target is below 2^k is split. Neighbours then differ by one level at most: a
/// cell of level j touching an unsplit one of level k has a parent with distance < 2^(j+1), so the
/// unsplit one is nearer than 2^(j+2) and, unsplit, at least 2^k away: j + 2 > k.
IrradianceVolume adaptiveVolume(
    const Coord& origin, int rootLevel, const Coord& target, int bands, bool gradients);

/// Same lattice, cells, visibility, blocking, records, offsets and metadata, bit for bit. Reports
/// the first difference.
std::string difference(const IrradianceVolume& a, const IrradianceVolume& b);

std::vector<char> readBytes(const std::string& path);
void writeBytes(const std::string& path, const std::vector<char>& bytes);

} // namespace vdb_test
