// SPDX-License-Identifier: Apache-2.0
#pragma once

/// @file sample_journal.h
/// What a bake has traced, on disk while it runs, so that a bake that was killed can go on.
///
/// A bake decides everything from samples that depend on their settings and lattice point alone.
/// One that goes on repeats its decisions and takes from the journal what it would trace again; so
/// it ends in the same bytes.
///
/// The file is a sequence of blocks in the byte order of the machine: uint32 magic, uint32 payload
/// size (at most kMaxPayload), uint64 XXH64 of the payload, payload. The first one holds the
/// header, lines "name value" of all that the samples depend on, with the magic "LVJH". The others,
/// "LVJB", hold records: 80 bytes that name settings, lattice point and sizes, then the floats of
/// value, standard error and gradient. Blocks are appended; at the first one that is torn or
/// damaged the file is cut off, and what it held is traced again. Its bytes are not trusted: sizes
/// are compared with what is there before anything is read or allocated.

#include <lumivdb/core/types.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

namespace lumivdb {

struct BakedSample; // sample_baker.h
struct BakeOptions; // bake.h
class Progress;
struct Scene; // scene.h

class SampleJournal {
public:
    enum class Start {
        Anew, ///< what an earlier bake left is dropped
        GoOn ///< it is used, if there is any
    };
    /// Samples of one kind: a hash of all settings that change them, and what their size must be.
    struct Kind {
        std::uint64_t settings = 0;
        std::uint32_t values = 0, gradients = 0;
    };
    static constexpr std::size_t kMaxPayload = std::size_t{1} << 20;

    /// Opens the journal at @a path and locks it. Where that cannot be done (another bake has it,
    /// the folder is read-only, a file of another kind has its name), or the disk is full later,
    /// the bake goes on without; @a progress, until finish(), and warnings() say so.
    /// @throws Error(Usage) with GoOn where the file's header is not @a header, naming the lines.
    SampleJournal(const std::string& path, const std::string& header, Start start,
        Progress* progress = nullptr);
    /// flush(). A journal without samples is removed; the lock ends.
    ~SampleJournal();
    SampleJournal(const SampleJournal&) = delete;
    SampleJournal& operator=(const SampleJournal&) = delete;

    /// Whether take() will find the sample, damage in the meantime excepted. From any thread.
    bool holds(const Kind& kind, const Coord& c) const;
    /// The sample at @a c, if an earlier bake left it. From any thread.
    bool take(const Kind& kind, const Coord& c, BakedSample& sample);
    /// Keeps @a sample for later bakes. From any thread.
    void add(const Kind& kind, const Coord& c, const BakedSample& sample);

    std::uint64_t taken() const { return mTaken; }
    std::uint64_t takenRays() const { return mTakenRays; } ///< shadow rays included
    /// Writes what is not yet written.
    void flush();
    /// The bake is over: flush(), and what is there outlasts a power cut.
    void finish();
    /// Deletes the file. Not one that another bake holds or that is no journal.
    void remove();
    std::vector<std::string> warnings() const;

private:
    struct Key {
        std::uint64_t settings;
        Coord c;
        bool operator==(const Key& o) const { return settings == o.settings && c == o.c; }
    };
    struct KeyHash {
        std::size_t operator()(const Key& key) const;
    };
    struct Place {
        std::uint64_t offset;
        std::uint32_t size;
    };
    bool open();
    void begin(const std::string& header);
    bool goOn(const std::string& header);
    bool readBlock(std::uint32_t magic, std::uint64_t offset, std::vector<char>& payload) const;
    bool indexRecords(const std::vector<char>& payload, std::uint64_t offset);
    bool readAt(std::uint64_t offset, void* data, std::size_t size) const;
    bool writeBlock(std::uint32_t magic, std::vector<char>& block);
    void writePending();
    bool isSyncDue();
    void sync();
    void warn(const std::string& why, const std::string& so);

    std::string mPath;
    int mFd = -1;
    bool mReads = false; // mIndex is worth asking
    std::unordered_map<Key, Place, KeyHash> mIndex; // unchanged once constructed
    std::atomic<std::uint64_t> mTaken{0}, mTakenRays{0};

    mutable std::mutex mMutex; // guards what follows
    bool mWrites = false;
    std::vector<char> mPending; // room for a block's head, then records
    std::uint64_t mEnd = 0; // where the next block goes
    bool mHoldsSamples = false, mRemoved = false;
    std::chrono::steady_clock::time_point mWritten, mSynced;
    Progress* mProgress; // who is told of warnings
    std::vector<std::string> mWarnings;
};

/// The journal of a bake; null where @a options name none. @throws Error(Usage).
std::shared_ptr<SampleJournal> openJournal(
    const BakeOptions& options, const Scene& scene, Progress& progress);

/// Of what samples of the same options are made of: one more whenever their bits change, so that no
/// bake goes on with samples of another. test_bake "[revision]" fails where that was forgotten.
constexpr int kSampleRevision = 3;

/// Of this machine's processor, as far as it decides the bits of samples: a hash of its approximate
/// reciprocals and inverse roots, which Embree's hits begin with and which makers are free in.
std::string processorKind();

/// Lines "name value": all that changes what the bake makes, but for how a file is written.
std::string journalHeader(const BakeOptions& options, const Scene& scene);

} // namespace lumivdb
