// SPDX-License-Identifier: Apache-2.0
#include "sampler_ghosts.h"

#include <Imath/half.h>
#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <tbb/parallel_reduce.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <new>

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace lumivdb::detail {

namespace {

/// The table may have this many 8³ blocks, or kBlocksPerCell for each cell where that is more.
/// Beyond, it would outgrow the records; the index tree answers then.
constexpr std::int64_t kMinBlocks = std::int64_t{1} << 20;
constexpr std::int64_t kBlocksPerCell = 32;
constexpr std::size_t kHugePage = std::size_t{2} << 20;
/// Halves end at 65504; below 2^-14 they lose digits. Largest value of packed records.
constexpr int kLargestHalfExponent = 14;

/// Corners of @a cell that are valid.
unsigned validCorners(const IrradianceVolume& volume, const Cell& cell)
{
    unsigned mask = 0;
    for (int i = 0; i < 8; ++i) mask |= volume.isValid(cell.corners[i]) ? 1u << i : 0u;
    return mask;
}

/// Rows along z of a block's samples.
struct Row {
    std::uint32_t first = 0; ///< node of the first one
    std::uint32_t present = 0; ///< bit z: there is one at z
};
/// At 9x + y, x, y = 0 … 8.
using Rows = std::array<Row, 81>;

/// The cell that a voxel of a block lies in.
struct Inside {
    CellId cell = kNoCell;
    bool plain = false; ///< isPlain()
    bool rows = false; ///< usesRows()
};

/// Whether all rows lie at equal distances.
bool isLattice(const Rows& rows, FormLattice& lattice)
{
    const std::uint32_t first = rows[0].first, stepX = rows[9].first - first,
                        stepY = rows[1].first - first;
    lattice = {first, stepX, stepY};
    for (std::uint32_t x = 0; x < 9; ++x)
        for (std::uint32_t y = 0; y < 9; ++y)
            if (rows[9 * x + y].first != first + x * stepX + y * stepY) return false;
    return true;
}

class Compiler {
public:
    Compiler(const IrradianceVolume& volume, const SamplerOptions& options);
    std::shared_ptr<const SamplerForm> run();

private:
    bool splits() const
    {
        return mOptions.mode != Interpolation::Nearest && mOptions.mode != Interpolation::Taylor;
    }
    void setUp();
    void makeTable();
    std::int32_t addBlock(const std::vector<CellId>& cells);
    Rows rowsOf(const Coord& lower) const;
    bool usesRows(CellId id);
    void fillColumn(const Inside* inside, const Rows& rows, const Coord& voxel, FormColumn& out);
    bool isPlain(CellId id) const;
    std::int32_t partAt(std::int32_t target, const Cell& cell, const Coord& voxel) const;
    std::int32_t compiled(CellId id);
    void compileCell(CellId id, FormCell& out);
    void setCorners(const Cell& cell, unsigned usable, FormCell& out);
    std::int32_t addSplit(const Cell& cell, unsigned mask, const FormCell& whole);
    void compileCut(const Cell& cell, unsigned valid, const CellVisibility& visibility, bool split,
        FormCell& out);
    std::uint32_t rawNode(SampleId s);
    void pack();
    float scaleFor(const std::vector<float>& ghosts) const;

    const IrradianceVolume& mVolume;
    const SamplerOptions mOptions;
    std::shared_ptr<SamplerForm> mForm;
    PlainNodes mPlain;
    std::vector<SampleId> mRaw; // samples with a second, valid node
    std::vector<std::uint32_t> mRawOf; // sample → its second node, 0: none
    std::vector<std::int32_t> mCompiled; // volume's cell → form's, −1: not yet
    std::unique_ptr<GhostBuilder> mGhosts;
};

Compiler::Compiler(const IrradianceVolume& volume, const SamplerOptions& options)
    : mVolume(volume)
    , mOptions(options)
    , mForm(std::make_shared<SamplerForm>())
    , mPlain(volume, options)
{
}

void Compiler::setUp()
{
    SamplerForm& f = *mForm;
    f.options = mOptions;
    f.bands = mVolume.bands();
    const Mat4d& m = mVolume.worldToIndex();
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 3; ++j) f.toIndex[i][j] = m[i][j];
    f.topology = mVolume.impl().topology;
    f.layout = RecordLayout(f.bands, mPlain.blocks(), mOptions.precision);
    f.stride = f.layout.stride();
    f.wideLayout = RecordLayout(f.bands, 8, mOptions.precision);
    f.wideStride = f.wideLayout.stride();
}

std::shared_ptr<const SamplerForm> Compiler::run()
{
    setUp();
    // Second nodes first, so that ghosts follow all nodes that have a place.
    const auto cells = static_cast<CellId>(mVolume.cellCount());
    const auto samples = static_cast<std::uint32_t>(mVolume.sampleCount());
    for (CellId id = 0; id < cells; ++id) {
        const Cell& cell = mVolume.cell(id);
        if (validCorners(mVolume, cell) != 0) continue;
        for (const SampleId s : cell.corners) rawNode(s);
    }
    mForm->firstGhost = samples + static_cast<std::uint32_t>(mRaw.size());
    const bool wide = mOptions.mode == Interpolation::Tricubic;
    mGhosts
        = std::make_unique<GhostBuilder>(mVolume, mOptions, mPlain, wide ? 0 : mForm->firstGhost);
    mCompiled.assign(mVolume.cellCount(), -1);
    makeTable();
    if (mForm->useTree) {
        mForm->cells.resize(mVolume.cellCount());
        for (CellId id = 0; id < cells; ++id) {
            FormCell cell{};
            compileCell(id, cell);
            mForm->cells[static_cast<std::size_t>(id)] = cell;
        }
    }
    pack();
    return mForm;
}

/// A node of invalid sample @a s for cells that have nothing better.
std::uint32_t Compiler::rawNode(SampleId s)
{
    if (mRawOf.empty()) mRawOf.assign(mVolume.sampleCount(), 0);
    if (mRawOf[s] == 0) {
        mRawOf[s] = static_cast<std::uint32_t>(mVolume.sampleCount() + mRaw.size());
        mRaw.push_back(s);
    }
    return mRawOf[s];
}

void Compiler::makeTable()
{
    SamplerForm& f = *mForm;
    // maxLattice is the last sample; the last cell begins one step before it.
    f.blockMin = blockOf(mVolume.minLattice());
    f.blockDim = blockOf(mVolume.maxLattice() - Coord(1)) - f.blockMin + Coord(1);
    const std::int64_t count = std::int64_t{f.blockDim.x} * f.blockDim.y * f.blockDim.z;
    const auto cells = static_cast<CellId>(mVolume.cellCount());
    f.useTree = count > std::max(kMinBlocks, kBlocksPerCell * std::int64_t{cells});
    if (f.useTree) return;
    f.table.assign(static_cast<std::size_t>(count), SamplerForm::kEmptyBlock);
    const auto entryAt = [&f](const Coord& b) -> std::int32_t& {
        const Coord r = b - f.blockMin;
        return f.table[(static_cast<std::size_t>(r.x) * f.blockDim.y + r.y) * f.blockDim.z + r.z];
    };
    std::vector<std::vector<CellId>> small; // cells of each block that no single one fills
    for (CellId id = 0; id < cells; ++id) {
        const Cell& cell = mVolume.cell(id);
        const Coord lower = blockOf(cell.origin);
        if (cell.level >= SamplerForm::kBlockLog2) {
            const std::int32_t entry = -2 - compiled(id);
            const int n = 1 << (cell.level - SamplerForm::kBlockLog2);
            for (int x = 0; x < n; ++x)
                for (int y = 0; y < n; ++y)
                    for (int z = 0; z < n; ++z) entryAt(lower + Coord(x, y, z)) = entry;
            continue;
        }
        std::int32_t& entry = entryAt(lower);
        if (entry == SamplerForm::kEmptyBlock) {
            entry = static_cast<std::int32_t>(small.size());
            small.emplace_back();
        }
        small[static_cast<std::size_t>(entry)].push_back(id);
    }
    for (std::int32_t& entry : f.table) {
        if (entry >= 0) entry = addBlock(small[static_cast<std::size_t>(entry)]);
    }
}

/// Returns the block's entry in the table.
std::int32_t Compiler::addBlock(const std::vector<CellId>& cells)
{
    SamplerForm& f = *mForm;
    const Coord lower = blockOf(mVolume.cell(cells[0]).origin) * SamplerForm::kBlockSize;
    const Rows rows = rowsOf(lower);
    std::array<Inside, SamplerForm::kBlockVoxels> inside;
    bool plain = cells.size() == SamplerForm::kBlockVoxels;
    for (const CellId id : cells) {
        const Cell& cell = mVolume.cell(id);
        const int n = 1 << cell.level;
        Inside in{id, isPlain(id), false};
        in.rows = in.plain || usesRows(id);
        plain = plain && in.plain;
        for (int x = 0; x < n; ++x)
            for (int y = 0; y < n; ++y)
                std::fill_n(inside.begin() + voxelInBlock(cell.origin + Coord(x, y, 0)), n, in);
    }
    FormLattice lattice{};
    if (plain && isLattice(rows, lattice)) {
        f.lattices.push_back(lattice);
        return static_cast<std::int32_t>(2 * f.lattices.size() - 1);
    }
    const std::size_t block = f.columns.size() / SamplerForm::kColumns;
    for (int c = 0; c < SamplerForm::kColumns; ++c) {
        FormColumn column{};
        fillColumn(inside.data() + SamplerForm::kBlockSize * c, rows,
            lower + Coord(c / SamplerForm::kBlockSize, c % SamplerForm::kBlockSize, 0), column);
        f.columns.push_back(column);
    }
    return static_cast<std::int32_t>(2 * block);
}

/// Column of eight voxels from @a voxel on.
void Compiler::fillColumn(
    const Inside* inside, const Rows& rows, const Coord& voxel, FormColumn& out)
{
    // Rows are those of the level that most of it can use.
    std::array<int, SamplerForm::kBlockLog2> users{};
    for (int z = 0; z < SamplerForm::kBlockSize; ++z)
        if (inside[z].rows) ++users[static_cast<std::size_t>(mVolume.cell(inside[z].cell).level)];
    const auto level
        = static_cast<int>(std::max_element(users.begin(), users.end()) - users.begin());
    const int size = 1 << level, within = 7 & -size;
    for (int i = 0; i < 4; ++i) {
        const int x = (voxel.x & within) + (i & 1) * size, y = (voxel.y & within) + (i >> 1) * size;
        out.first[i] = rows[static_cast<std::size_t>(9 * x + y)].first;
        out.present[i]
            = static_cast<std::uint16_t>(rows[static_cast<std::size_t>(9 * x + y)].present);
    }
    for (int z = 0; z < SamplerForm::kBlockSize; ++z) {
        out.code[z] = kEmptyCode;
        const Inside& in = inside[z];
        if (in.cell == kNoCell) continue;
        const Cell& cell = mVolume.cell(in.cell);
        if (cell.level == level && in.rows) {
            out.code[z] = static_cast<std::uint8_t>(level + (in.plain ? 0 : kCutCode));
            if (!in.plain)
                out.id[z] = mForm->cells[static_cast<std::size_t>(compiled(in.cell))].next;
        } else {
            out.code[z] = kCellCode;
            out.id[z] = partAt(compiled(in.cell), cell, voxel + Coord(0, 0, z));
        }
    }
}

/// Whether the nodes of a cell that is not plain are its corners in every region, which rows have.
bool Compiler::usesRows(CellId id)
{
    const FormCell& made = mForm->cells[static_cast<std::size_t>(compiled(id))];
    return made.kind == FormCell::Cut && made.node[0] == mVolume.cell(id).corners[0]
        && mForm->cutsMore[static_cast<std::size_t>(made.next)].split[0] < 0;
}

/// The part of a split cell that @a voxel lies in; else the cell.
std::int32_t Compiler::partAt(std::int32_t target, const Cell& cell, const Coord& voxel) const
{
    const FormCell& whole = mForm->cells[static_cast<std::size_t>(target)];
    if (whole.kind != FormCell::Split) return target;
    const int half = (1 << cell.level) / 2;
    const Coord at = voxel - cell.origin;
    return whole.next + (at.x >= half) + 2 * (at.y >= half) + 4 * (at.z >= half);
}

/// Nothing but eight corners: no wall, no finer neighbour, not without any valid corner.
bool Compiler::isPlain(CellId id) const
{
    const Cell& cell = mVolume.cell(id);
    return !mVolume.visibility(id) && validCorners(mVolume, cell) != 0
        && !(splits() && GhostBuilder::touchesFiner(mVolume, cell));
}

/// Samples are sorted by (x, y, z): those of a row follow each other.
Rows Compiler::rowsOf(const Coord& lower) const
{
    Rows rows;
    const Topology& topology = *mForm->topology;
    for (int x = 0; x < 9; ++x) {
        for (int y = 0; y < 9; ++y) {
            const Coord begin = lower + Coord(x, y, 0);
            Row& row = rows[static_cast<std::size_t>(9 * x + y)];
            if (begin.x > topology.maxLattice.x || begin.y > topology.maxLattice.y) continue;
            // The row may begin before the volume does; keys do not go below its corner.
            const Coord from(begin.x, begin.y, std::max(begin.z, topology.minLattice.z));
            if (begin.x < topology.minLattice.x || begin.y < topology.minLattice.y) continue;
            const auto it = std::lower_bound(
                topology.keys.begin(), topology.keys.end(), topology.latticeKeys.key(from));
            auto s = static_cast<std::size_t>(it - topology.keys.begin());
            row.first = static_cast<std::uint32_t>(s);
            for (; s < topology.positions.size(); ++s) {
                const Coord at = topology.positions[s] - begin;
                if (at.x != 0 || at.y != 0 || at.z > 8) break;
                row.present |= 1u << at.z;
            }
        }
    }
    return rows;
}

std::int32_t Compiler::compiled(CellId id)
{
    std::int32_t& at = mCompiled[static_cast<std::size_t>(id)];
    if (at < 0) {
        at = static_cast<std::int32_t>(mForm->cells.size());
        mForm->cells.emplace_back();
        FormCell cell{};
        compileCell(id, cell);
        mForm->cells[static_cast<std::size_t>(at)] = cell;
    }
    return at;
}

void Compiler::compileCell(CellId id, FormCell& out)
{
    const Cell& cell = mVolume.cell(id);
    const unsigned valid = validCorners(mVolume, cell);
    setCorners(cell, valid, out);
    // Cells without a valid corner have no better nodes to offer a split.
    const bool split = splits() && valid != 0 && GhostBuilder::touchesFiner(mVolume, cell);
    if (const CellVisibility* visibility = mVolume.visibility(id)) {
        compileCut(cell, valid, *visibility, split, out);
    } else if (split) {
        out.next = addSplit(cell, 0xff, out);
        out.kind = FormCell::Split;
    }
}

void Compiler::setCorners(const Cell& cell, unsigned usable, FormCell& out)
{
    for (int i = 0; i < 8; ++i) {
        out.node[i] = usable ? cell.corners[i] : rawNode(cell.corners[i]);
    }
    out.origin = cell.origin;
    out.size = static_cast<float>(1 << cell.level);
    out.inverseSize = 1.0f / out.size;
    out.next = -1;
    out.kind = FormCell::Whole;
    out.level = static_cast<std::uint8_t>(cell.level);
    out.usable = static_cast<std::uint8_t>(usable ? usable : 0xff);
    out.wide = 0;
}

/// Eight cells of half the size, of the corners in @a mask. One whose nodes all are without weight
/// looks at the corners of the whole cell.
std::int32_t Compiler::addSplit(const Cell& cell, unsigned mask, const FormCell& whole)
{
    const GhostBuilder::Split& split = mGhosts->split(cell, mask);
    const auto first = static_cast<std::int32_t>(mForm->cells.size());
    const int half = 1 << (cell.level - 1);
    for (int octant = 0; octant < 8; ++octant) {
        const int at[3] = {octant & 1, octant >> 1 & 1, octant >> 2 & 1};
        FormCell part = whole;
        part.wide = mOptions.mode == Interpolation::Tricubic;
        float weight = 0;
        for (int i = 0; i < 8; ++i) {
            const int point
                = at[0] + (i & 1) + 3 * (at[1] + (i >> 1 & 1)) + 9 * (at[2] + (i >> 2 & 1));
            part.node[i] = split.node[static_cast<std::size_t>(point)];
            weight += split.weight[static_cast<std::size_t>(point)];
        }
        if (weight > 0) {
            part.origin = cell.origin + Coord(at[0], at[1], at[2]) * half;
            part.size = static_cast<float>(half);
            part.inverseSize = 1.0f / part.size;
        } else {
            for (int i = 0; i < 8; ++i) {
                part.node[i] = split.node[static_cast<std::size_t>(
                    2 * (i & 1) + 6 * (i >> 1 & 1) + 18 * (i >> 2 & 1))];
            }
        }
        mForm->cells.push_back(part);
    }
    return first;
}

void Compiler::compileCut(
    const Cell& cell, unsigned valid, const CellVisibility& visibility, bool split, FormCell& out)
{
    FormCut cut{};
    FormCutMore more{};
    cut.level = cell.level;
    for (int k = 0; k < 3; ++k) {
        for (int a = 0; a < 3; ++a) cut.normal[k][a] = visibility.normal[k][a];
        cut.offset[k] = visibility.offset[k];
    }
    for (int i = 0; i < 8; ++i) more.validity[i] = mVolume.validity(cell.corners[i]);
    for (int r = 0; r < 8; ++r) {
        const auto seen = static_cast<unsigned>(visibility.masks >> (8 * r) & 0xff);
        const unsigned mask = seen & valid ? seen : 0xff;
        cut.masks |= std::uint64_t{mask} << (8 * r);
        more.split[r] = -1;
        if (!split) continue;
        for (int q = 0; q < r && more.split[r] < 0; ++q) {
            if ((cut.masks >> (8 * q) & 0xff) == mask) more.split[r] = more.split[q];
        }
        if (more.split[r] < 0) more.split[r] = addSplit(cell, mask, out);
    }
    out.kind = FormCell::Cut;
    out.next = static_cast<std::int32_t>(mForm->cuts.size());
    mForm->cuts.push_back(cut);
    mForm->cutsMore.push_back(more);
}

/// Power of two that brings the largest finite number of all records to the top of the range of
/// halves, so that the most of it is used.
float Compiler::scaleFor(const std::vector<float>& ghosts) const
{
    const auto channels = static_cast<std::size_t>(mPlain.channels());
    const auto larger = [channels](float m, const float* records, std::size_t count) {
        for (std::size_t i = 0; i < count; ++i) {
            const float a = std::abs(records[i]);
            // Weight and validity, the last two, are kept as they are.
            if (i % channels + 2 < channels && a > m && std::isfinite(a)) m = a;
        }
        return m;
    };
    const auto samples = static_cast<SampleId>(mVolume.sampleCount());
    const std::size_t size = channels * static_cast<std::size_t>(mPlain.blocks());
    float largest = tbb::parallel_reduce(
        tbb::blocked_range<SampleId>(0, samples), 0.0f,
        [&](const tbb::blocked_range<SampleId>& range, float m) {
            std::vector<float> record(size);
            for (SampleId s = range.begin(); s < range.end(); ++s) {
                mPlain.load(s, true, record.data());
                m = larger(m, record.data(), size);
            }
            return m;
        },
        [](float a, float b) { return std::max(a, b); });
    largest = larger(largest, ghosts.data(), ghosts.size());
    if (largest == 0) return 1;
    return std::ldexp(1.0f, std::clamp(kLargestHalfExponent - std::ilogb(largest), -120, 120));
}

/// Writes records in their packed form.
class Packer {
public:
    Packer(const RecordLayout& layout, int channels, float scale)
        : mLayout(layout)
        , mChannels(channels)
        , mScale(scale)
    {
    }
    void write(const float* record, std::byte* to) const
    {
        for (int b = 0; b < mLayout.blocks; ++b) {
            const float* from = record + b * mChannels;
            const int base = b * mLayout.lanes;
            // The weight first rounds, then multiplies: quotients keep their precision.
            const float weight = from[mChannels - 2];
            put(to, base + mLayout.weightLane(), weight);
            put(to, base + mLayout.validityLane(), from[mChannels - 1]);
            const float scale = b == 0 && weight > 0 ? mScale * rounded(weight) / weight : mScale;
            for (int i = 0; i < mLayout.coefficients; ++i)
                for (int c = 0; c < 3; ++c)
                    put(to, base + mLayout.lane(i, c), from[3 * i + c] * scale);
        }
    }

private:
    float rounded(float v) const
    {
        return mLayout.scalarBytes == 4 ? v : static_cast<float>(Imath::half(v));
    }
    void put(std::byte* to, int lane, float v) const
    {
        if (mLayout.scalarBytes == 4) {
            std::memcpy(to + 4 * lane, &v, 4);
        } else {
            const std::uint16_t bits = Imath::half(v).bits();
            std::memcpy(to + 2 * lane, &bits, 2);
        }
    }
    const RecordLayout& mLayout;
    int mChannels;
    float mScale;
};

void Compiler::pack()
{
    SamplerForm& f = *mForm;
    const std::vector<float>& ghosts = mGhosts->records();
    const bool wide = mOptions.mode == Interpolation::Tricubic;
    const std::size_t size = static_cast<std::size_t>(mGhosts->blockCount()) * mPlain.channels();
    const std::size_t ghostCount = ghosts.size() / size;
    const float scale = mOptions.precision == Precision::Half ? scaleFor(ghosts) : 1.0f;
    f.unscale = 1.0f / scale;
    const std::uint32_t samples = static_cast<std::uint32_t>(mVolume.sampleCount());
    f.records.resize((f.firstGhost + (wide ? 0 : ghostCount)) * f.stride);
    f.wide.resize(wide ? ghostCount * f.wideStride : 0);
    const Packer packer(f.layout, mPlain.channels(), scale);
    std::atomic<bool> finite{true};
    tbb::parallel_for(tbb::blocked_range<std::uint32_t>(0, f.firstGhost),
        [&](const tbb::blocked_range<std::uint32_t>& range) {
            std::vector<float> record(
                static_cast<std::size_t>(mPlain.blocks()) * mPlain.channels());
            bool all = true;
            for (std::uint32_t node = range.begin(); node < range.end(); ++node) {
                const bool raw = node >= samples;
                mPlain.load(raw ? mRaw[node - samples] : node, raw, record.data());
                for (const float v : record) all = all && std::isfinite(v);
                packer.write(record.data(), f.records.data() + node * f.stride);
            }
            if (!all) finite = false;
        });
    const Packer widePacker(f.wideLayout, mPlain.channels(), scale);
    tbb::parallel_for(std::size_t{0}, ghostCount, [&](std::size_t g) {
        if (wide) {
            widePacker.write(ghosts.data() + g * size, f.wide.data() + g * f.wideStride);
        } else {
            packer.write(
                ghosts.data() + g * size, f.records.data() + (f.firstGhost + g) * f.stride);
        }
    });
    f.finite = finite;
    if (mOptions.mode != Interpolation::InverseDistance) return;
    f.parentBegin = mGhosts->parentBegin();
    f.parents = mGhosts->parents();
    f.nodePosition.resize(f.firstGhost);
    for (std::uint32_t node = 0; node < f.firstGhost; ++node)
        f.nodePosition[node] = mVolume.samplePosition(node < samples ? node : mRaw[node - samples]);
}

} // namespace

void* allocateLines(std::size_t bytes)
{
    const std::size_t alignment = bytes >= 2 * kHugePage ? kHugePage : 64;
    const std::size_t whole = (bytes + alignment - 1) / alignment * alignment;
    void* memory = std::aligned_alloc(alignment, whole);
    if (!memory) throw std::bad_alloc();
#ifdef __linux__
    if (alignment == kHugePage) madvise(memory, whole, MADV_HUGEPAGE);
#endif
    return memory;
}

std::size_t SamplerForm::memoryBytes() const
{
    return records.size() + wide.size() + table.size() * sizeof(table[0])
        + lattices.size() * sizeof(FormLattice) + columns.size() * sizeof(FormColumn)
        + cells.size() * sizeof(FormCell) + cuts.size() * (sizeof(FormCut) + sizeof(FormCutMore))
        + parentBegin.size() * sizeof(parentBegin[0]) + parents.size() * sizeof(Parent)
        + nodePosition.size() * sizeof(Coord);
}

CellId findInTree(const SamplerForm& form, const Coord& voxel)
{
    return form.topology->index->getValue(openvdb::Coord(voxel.x, voxel.y, voxel.z));
}

std::shared_ptr<const SamplerForm> compileSampler(
    const IrradianceVolume& volume, const SamplerOptions& options)
{
    return Compiler(volume, options).run();
}

} // namespace lumivdb::detail
