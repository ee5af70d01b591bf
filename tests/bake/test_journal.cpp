// SPDX-License-Identifier: Apache-2.0
// The journal of samples: what it gives back, what damage costs, and bakes that go on with it.

#include "bake_makers.h"

#include "../../bake/src/sample_baker.h"
#include "../../bake/src/sample_journal.h"

#include <lumivdb/bake/environment.h>
#include <lumivdb/bake/radiance_cache.h>
#include <lumivdb/core/random.h>

#include <catch2/catch.hpp>

#include <atomic>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>

#include <csignal>
#include <sys/resource.h>

using namespace lumivdb;
using namespace lumivdb::test;
namespace fs = std::filesystem;

namespace {

using Start = SampleJournal::Start;

/// A folder that goes with the test.
class Folder {
public:
    Folder()
    {
        std::string name = (fs::temp_directory_path() / "lumivdb_journal_XXXXXX").string();
        REQUIRE(::mkdtemp(name.data()) != nullptr);
        mPath = name;
    }
    ~Folder() { fs::remove_all(mPath); }
    Folder(const Folder&) = delete;
    Folder& operator=(const Folder&) = delete;
    std::string file(const std::string& name) const { return (mPath / name).string(); }

private:
    fs::path mPath;
};

std::string contentOf(const std::string& path)
{
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
}

void write(const std::string& path, const std::string& content)
{
    std::ofstream(path, std::ios::binary) << content;
}

/// A sample whose every number depends on @a seed.
BakedSample madeSample(float seed, std::size_t values, std::size_t gradients)
{
    BakedSample s;
    float next = seed;
    const auto color = [&] {
        next += 0.25f;
        return Color(next, -next, 1 / next);
    };
    for (std::size_t i = 0; i < values; ++i) s.result.value.push_back(color());
    for (std::size_t i = 0; i < values; ++i) s.result.stderr_.push_back(color());
    for (std::size_t i = 0; i < gradients; ++i) s.result.gradient.push_back(color());
    s.result.validity = seed / 1000;
    s.result.distance = std::numeric_limits<float>::infinity();
    s.result.minDistance = seed + 3;
    s.result.rays = 1000 + static_cast<std::uint64_t>(seed);
    s.offset = color();
    s.variance = color();
    s.rays = 2000 + static_cast<std::uint64_t>(seed);
    return s;
}

bool same(const BakedSample& a, const BakedSample& b)
{
    const ProbeResult &r = a.result, &s = b.result;
    return r.value == s.value && r.stderr_ == s.stderr_ && r.gradient == s.gradient
        && r.validity == s.validity && r.distance == s.distance && r.minDistance == s.minDistance
        && r.rays == s.rays && a.offset == b.offset && a.variance == b.variance && a.rays == b.rays;
}

constexpr int kSamples = 6;
const SampleJournal::Kind kPlain{7, 4, 0}, kGradients{8, 4, 12};

const SampleJournal::Kind& kindOf(int i) { return i % 2 == 0 ? kPlain : kGradients; }
BakedSample sampleOf(int i)
{
    return madeSample(static_cast<float>(i + 1), 4, kindOf(i).gradients);
}

/// Samples 0 … kSamples − 1, each in a block of its own.
void writeJournal(const std::string& path)
{
    SampleJournal journal(path, "rays 4\n", Start::Anew);
    for (int i = 0; i < kSamples; ++i) {
        journal.add(kindOf(i), Coord(i, -i, 0), sampleOf(i));
        journal.flush();
    }
    REQUIRE(journal.warnings().empty());
}

/// How many of the first samples @a journal holds. Fails where it holds others or wrong ones.
int heldBy(SampleJournal& journal)
{
    int held = 0, first = kSamples;
    for (int i = 0; i < kSamples; ++i) {
        BakedSample sample;
        if (journal.take(kindOf(i), Coord(i, -i, 0), sample)) {
            ++held;
            CHECK(same(sample, sampleOf(i)));
        } else {
            first = std::min(first, i);
        }
    }
    CHECK(held == first);
    return held;
}

} // namespace

TEST_CASE("a journal gives back samples bit for bit", "[bake][journal]")
{
    const Folder folder;
    const std::string path = folder.file("j");
    writeJournal(path);
    SampleJournal journal(path, "rays 4\n", Start::GoOn);
    CHECK(heldBy(journal) == kSamples);
    CHECK(journal.taken() == kSamples);
    CHECK(journal.takenRays() == 6 * 2000 + 1 + 2 + 3 + 4 + 5 + 6);
    BakedSample sample;
    CHECK(!journal.take(kPlain, Coord(1, -1, 0), sample)); // of the other kind
    CHECK(!journal.take(kPlain, Coord(0, 0, 1), sample));
    // The same hash for samples of another size can only be a forgery.
    CHECK(!journal.take({7, 9, 0}, Coord(0, 0, 0), sample));
    CHECK(!journal.take({7, 4, 12}, Coord(0, 0, 0), sample));
    CHECK(journal.warnings().empty());
}

TEST_CASE("a journal anew forgets, and one without samples goes", "[bake][journal]")
{
    const Folder folder;
    const std::string path = folder.file("j");
    writeJournal(path);
    {
        SampleJournal journal(path, "rays 4\n", Start::Anew);
        CHECK(heldBy(journal) == 0);
        CHECK(fs::exists(path));
    }
    CHECK(!fs::exists(path));
}

TEST_CASE("a journal torn at any byte keeps what is whole and goes on", "[bake][journal]")
{
    const Folder folder;
    const std::string path = folder.file("j");
    writeJournal(path);
    const std::string whole = contentOf(path);
    int last = 0;
    for (std::size_t size = 0; size <= whole.size(); ++size) {
        CAPTURE(size);
        write(path, whole.substr(0, size));
        int held = 0;
        {
            SampleJournal journal(path, "rays 4\n", Start::GoOn);
            held = heldBy(journal);
            CHECK(held >= last);
            for (int i = held; i < kSamples; ++i) {
                journal.add(kindOf(i), Coord(i, -i, 0), sampleOf(i));
                journal.flush();
            }
        }
        last = held;
        if (contentOf(path) != whole) FAIL("the journal that went on differs");
    }
    CHECK(last == kSamples);
}

TEST_CASE("a damaged byte costs its block and those behind, nothing else", "[bake][journal]")
{
    const Folder folder;
    const std::string path = folder.file("j");
    writeJournal(path);
    const std::string whole = contentOf(path);
    const std::size_t headerEnd = 16 + std::string("rays 4\n").size();
    for (std::size_t at = 0; at < whole.size(); ++at) {
        CAPTURE(at);
        std::string damaged = whole;
        damaged[at] = static_cast<char>(damaged[at] ^ (1 << at % 8));
        write(path, damaged);
        SampleJournal journal(path, "rays 4\n", Start::GoOn);
        const int held = heldBy(journal);
        CHECK(held < kSamples);
        if (at < 4) {
            CHECK(journal.warnings().size() == 1); // no journal at all: left alone
            CHECK(contentOf(path) == damaged);
        }
        // The block that holds the byte; the header holds none.
        int block = 0;
        for (std::size_t end = headerEnd; at >= headerEnd; ++block) {
            end += 16 + 88 + 12 * (2 * kindOf(block).values + kindOf(block).gradients);
            if (at < end) break;
        }
        CHECK(held == block);
    }
}

TEST_CASE("a journal of other options is refused by their names", "[bake][journal]")
{
    const Folder folder;
    const std::string path = folder.file("j");
    writeJournal(path);
    const std::string before = contentOf(path);
    const std::string message = errorOf(
        ErrorCode::Usage, [&] { SampleJournal(path, "rays 8\nspacing 0.5\n", Start::GoOn); });
    CHECK(message.find("rays 4 there, 8 now; spacing nothing there, 0.5 now") != std::string::npos);
    CHECK(message.find("--resume") != std::string::npos);
    CHECK(contentOf(path) == before);
}

TEST_CASE("samples have the bits of their revision", "[bake][journal][revision]")
{
    // Where this fails, what samples are made of has changed: raise kSampleRevision, then put the
    // new hashes here.
    REQUIRE(kSampleRevision == 3);
    const std::string samples = LUMIVDB_SAMPLES;
    const auto hashOf = [&](const std::string& file, const std::string& sky, bool cached) {
        auto scene = std::make_shared<Scene>(loadScene(samples + file));
        std::vector<std::string> warnings;
        if (!sky.empty()) scene->environment = Environment::load(samples + sky, {}, warnings);
        const Tracer tracer(scene);
        ProbeOptions options;
        options.rays = 300;
        RadianceCacheOptions small;
        small.patches = 128;
        if (cached) options.cache = std::make_shared<const RadianceCache>(tracer, small);
        const ProbeEstimator estimator(tracer, options);
        ProbeEstimator::Workspace workspace;
        std::uint64_t hash = 0;
        const Box3d box = scene->bounds();
        for (int i = 1; i < 8; ++i) {
            const Vec3d p = box.min + (box.max - box.min) * (i / 8.0);
            const ProbeResult r
                = estimator.radianceSh(p, 3, static_cast<std::uint64_t>(i), workspace, true);
            for (const std::vector<Color>* part : {&r.value, &r.stderr_, &r.gradient}) {
                for (const Color& value : *part) {
                    for (int c = 0; c < 3; ++c) {
                        std::uint32_t bits = 0;
                        std::memcpy(&bits, &value[c], sizeof bits);
                        hash = hashCombine(hash, bits);
                    }
                }
            }
        }
        return hash;
    };
    // Hits have other bits on other kinds of processors: these are of two.
    const std::string kind = processorKind();
    CHECK(journalHeader(BakeOptions(), Scene()).find("kind-of-processor " + kind + '\n')
        != std::string::npos);
    const auto isKnown = [&](std::uint64_t hash, std::uint64_t other, std::uint64_t mine) {
        INFO("processor " << kind << ", hash " << std::hex << hash);
        CHECK((hash == mine || (kind != "671973f7d5b0ad36" && hash == other)));
    };
    isKnown(hashOf("/cornell_box.glb", "", false), 0x698c296b032a1cbdull, 0xd54d9d085c720f2eull);
    isKnown(hashOf("/cornell_box.glb", "", true), 0xc52ec34b37129d76ull, 0x0f9de37a570f69bbull);
    isKnown(hashOf("/house.glb", "/sky.hdr", false), 0x0ac0d0298c8ad696ull, 0x86ef779425ee0793ull);
    isKnown(hashOf("/house.glb", "/sky.hdr", true), 0xc5c0e023afd975a7ull, 0x9082568f87a9c313ull);
}

TEST_CASE("a second bake does without the journal of the first", "[bake][journal]")
{
    const Folder folder;
    const std::string path = folder.file("j");
    SampleJournal first(path, "rays 4\n", Start::Anew);
    for (const Start start : {Start::Anew, Start::GoOn}) {
        SampleJournal second(path, "rays 8\n", start);
        CHECK(second.warnings().size() == 1);
        second.add(kPlain, Coord(0), madeSample(1, 4, 0));
        CHECK(heldBy(second) == 0);
        second.remove(); // not that of a running bake
    }
    first.add(kPlain, Coord(0), sampleOf(0));
    CHECK(fs::exists(path));
    CHECK(first.warnings().empty());
}

namespace {

BakeOptions uniformOptions()
{
    BakeOptions o = bakeOptions(0.4, Vec3d(0.0), Vec3d(1.6), 64);
    o.gradients = GradientMethod::Central;
    return o;
}

BakeOptions adaptiveOptions()
{
    BakeOptions o = bakeOptions(0.1, Vec3d(0.0), Vec3d(1.6), 32);
    o.levels = 3;
    o.gradients = GradientMethod::Analytic;
    return o;
}

BakeOptions targetOptions()
{
    BakeOptions o = bakeOptions(0.1, Vec3d(0.2), Vec3d(1.0), 32);
    o.levels = 2;
    o.bands = 0;
    o.target.error = 0.2;
    return o;
}

/// Stops after a number of samples.
class StopAfter : public Progress {
public:
    explicit StopAfter(std::uint64_t count)
        : mLeft(static_cast<std::int64_t>(count))
    {
    }
    void advance(std::uint64_t n) override { mLeft -= static_cast<std::int64_t>(n); }
    bool cancelled() override { return mLeft <= 0; }

private:
    std::atomic<std::int64_t> mLeft;
};

} // namespace

TEST_CASE("a bake that goes on makes the same volume", "[bake][journal][heavy]")
{
    const auto tracer = makeTracer(litRoom());
    int taken = 0;
    for (const BakeOptions& plain : {uniformOptions(), adaptiveOptions(), targetOptions()}) {
        const BakeResult wanted = bakeVolume(*tracer, plain);
        for (const std::uint64_t stop : {1, 60, 300, 1000, 3000}) {
            const Folder folder;
            BakeOptions o = plain;
            o.journal = folder.file("j");
            o.threads = 2;
            StopAfter progress(stop);
            const std::string message
                = errorOf(ErrorCode::Interrupted, [&] { bakeVolume(*tracer, o, &progress); });
            o.resume = true;
            o.threads = 1 + static_cast<int>(stop % 3);
            const BakeResult resumed = bakeVolume(*tracer, o);
            CAPTURE(plain.levels, stop, message, resumed.report.journalSamples);
            CHECK(differentRecords(wanted.volume, resumed.volume) == 0);
            CHECK(wanted.report.rays == resumed.report.rays);
            CHECK(wanted.report.tracedSamples == resumed.report.tracedSamples);
            CHECK(wanted.report.meanRelativeStderr == resumed.report.meanRelativeStderr);
            CHECK(wanted.report.achieved.upper == resumed.report.achieved.upper);
            CHECK(resumed.report.warnings == wanted.report.warnings);
            taken += resumed.report.journalSamples > 0;
            CHECK(fs::exists(o.journal));
            removeJournal(resumed);
            CHECK(!fs::exists(o.journal));
        }
    }
    CHECK(taken >= 8);
}

TEST_CASE("a whole journal leaves nothing to trace", "[bake][journal]")
{
    const auto tracer = makeTracer(litRoom());
    const Folder folder;
    BakeOptions o = adaptiveOptions();
    o.journal = folder.file("j");
    BakeResult first = bakeVolume(*tracer, o);
    CHECK(first.report.journalSamples == 0);
    first.journal.reset();
    o.resume = true;
    BakeResult second = bakeVolume(*tracer, o);
    second.journal.reset();
    CHECK(second.report.journalSamples == second.report.tracedSamples);
    CHECK(differentRecords(first.volume, second.volume) == 0);
    // Each option that changes samples is told.
    const auto refused = [&](auto&& change) {
        BakeOptions other = o;
        change(other);
        return errorOf(ErrorCode::Usage, [&] { bakeVolume(*tracer, other); });
    };
    const auto says = [&](auto&& change, const std::string& what) {
        return refused(change).find(what) != std::string::npos;
    };
    CHECK(says([](BakeOptions& b) { b.probe.rays = 64; }, "rays 32 there, 64 now"));
    CHECK(says([](BakeOptions& b) { b.probe.seed = 2; }, "seed 1 there, 2 now"));
    CHECK(says([](BakeOptions& b) { b.bands = 2; }, "bands 3 there, 2 now"));
    CHECK(says([](BakeOptions& b) { b.refine.error = 0.5; }, "refine-error"));
    CHECK(says([](BakeOptions& b) { b.bounds.reset(); }, "bounds-x"));
    CHECK(says([](BakeOptions& b) { b.target.error = 0.2; }, "target-error"));
    CHECK(refused([](BakeOptions& b) { b.threads = 1; }).empty());
}

TEST_CASE("a bake goes on without a journal where none can be written", "[bake][journal]")
{
    const auto tracer = makeTracer(litRoom());
    const Folder folder;
    BakeOptions o = uniformOptions();
    const BakeResult wanted = bakeVolume(*tracer, o);
    o.journal = folder.file("no folder/j");
    for (const bool resume : {false, true}) {
        o.resume = resume;
        const BakeResult r = bakeVolume(*tracer, o);
        CHECK(r.report.warnings.size() == wanted.report.warnings.size() + 1);
        CHECK(differentRecords(wanted.volume, r.volume) == 0);
    }
}

namespace {

/// Keeps what it is warned of, and how far the work was then.
class Listener : public Progress {
public:
    void advance(std::uint64_t n) override { mDone += n; }
    void warn(const std::string& sentence) override
    {
        warnings.push_back(sentence);
        doneAtWarning = mDone;
    }
    std::vector<std::string> warnings;
    std::uint64_t doneAtWarning = 0;

private:
    std::atomic<std::uint64_t> mDone{0};
};

/// Files may not grow beyond some bytes, as on a disk that is full then.
class SmallFiles {
public:
    explicit SmallFiles(rlim_t bytes)
    {
        mHandler = std::signal(SIGXFSZ, SIG_IGN);
        REQUIRE(::getrlimit(RLIMIT_FSIZE, &mBefore) == 0);
        struct rlimit limit = mBefore;
        limit.rlim_cur = bytes;
        REQUIRE(::setrlimit(RLIMIT_FSIZE, &limit) == 0);
    }
    ~SmallFiles()
    {
        ::setrlimit(RLIMIT_FSIZE, &mBefore);
        std::signal(SIGXFSZ, mHandler);
    }
    SmallFiles(const SmallFiles&) = delete;
    SmallFiles& operator=(const SmallFiles&) = delete;

private:
    struct rlimit mBefore { };
    void (*mHandler)(int) = nullptr;
};

} // namespace

TEST_CASE("a journal that cannot be written is told before the first sample", "[bake][journal]")
{
    const auto tracer = makeTracer(litRoom());
    const Folder folder;
    BakeOptions o = uniformOptions();
    o.journal = folder.file("no folder/j");
    Listener listener;
    const BakeResult r = bakeVolume(*tracer, o, &listener);
    REQUIRE(listener.warnings.size() == 1);
    CHECK(listener.doneAtWarning == 0);
    CHECK(r.report.warnings.back() == listener.warnings.front());
}

TEST_CASE("a disk that fills up ends the journal, not the bake", "[bake][journal]")
{
    const auto tracer = makeTracer(litRoom());
    const Folder folder;
    BakeOptions o = uniformOptions();
    const BakeResult wanted = bakeVolume(*tracer, o);
    o.journal = folder.file("j");
    Listener listener;
    for (const rlim_t room : {10, 3000}) { // not even the header; no samples
        CAPTURE(room);
        {
            const SmallFiles small(room);
            const BakeResult r = bakeVolume(*tracer, o, &listener);
            CHECK(differentRecords(wanted.volume, r.volume) == 0);
        }
        CHECK(listener.warnings.size() == 1);
        listener.warnings.clear();
    }
}

TEST_CASE("a journal stays locked until its volume is in its place", "[bake][journal]")
{
    const auto tracer = makeTracer(litRoom());
    const Folder folder;
    BakeOptions o = uniformOptions();
    o.journal = folder.file("j");
    {
        const BakeResult r = bakeVolume(*tracer, o);
        SampleJournal other(o.journal, "rays 8\n", Start::Anew);
        CHECK(other.warnings().size() == 1);
        removeJournal(r);
        CHECK(!fs::exists(o.journal));
        // A new bake's journal of that name is not the old bake's to delete.
        SampleJournal next(o.journal, "rays 8\n", Start::Anew);
        CHECK(next.warnings().empty());
        removeJournal(r);
        CHECK(fs::exists(o.journal));
    }
    const BakeResult again = bakeVolume(*tracer, o);
    CHECK(again.report.warnings.empty());
}
