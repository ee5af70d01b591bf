// SPDX-License-Identifier: Apache-2.0
#include "sample_journal.h"

#include "sample_baker.h"

#include <lumivdb/bake/bake.h>
#include <lumivdb/core/error.h>
#include <lumivdb/core/progress.h>
#include <lumivdb/core/random.h>
#include <lumivdb/core/xxhash64.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <map>
#include <sstream>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

namespace lumivdb {

namespace {

constexpr std::uint32_t kHeaderMagic = 0x484a564c, kBlockMagic = 0x424a564c; // "LVJH", "LVJB"
/// Written when a block is that large or that old: what a kill can cost.
constexpr std::size_t kBlockBytes = std::size_t{256} << 10;
constexpr std::chrono::seconds kBlockAge{2};
/// Between two requests that the disk has it: what a power cut can cost.
constexpr std::chrono::seconds kSyncAge{8};

struct BlockHead {
    std::uint32_t magic, size;
    std::uint64_t checksum;
};
static_assert(sizeof(BlockHead) == 16, "no padding goes to the file");

struct RecordHead {
    std::uint64_t settings;
    std::int32_t x, y, z;
    float validity, distance, minDistance;
    float offset[3], variance[3];
    std::uint64_t rays, resultRays, directions;
    std::uint32_t values, gradients; // colours of value and of standard error each; of gradient
};
static_assert(sizeof(RecordHead) == 88, "no padding goes to the file");
static_assert(sizeof(Color) == 12, "colours are copied as bytes");

/// Bytes of the whole record; 0 where no sample has such sizes.
std::size_t recordSize(const RecordHead& head)
{
    const bool possible = head.values > 0 && head.values <= kMaxCoefficients
        && (head.gradients == 0 || head.gradients == 3 * head.values);
    return possible ? sizeof head + sizeof(Color) * (2 * head.values + head.gradients) : 0;
}

std::uint64_t checksum(const char* data, std::size_t size)
{
    XxHash64 hash;
    hash.update(data, size);
    return hash.digest();
}

void append(std::vector<char>& bytes, const void* data, std::size_t size)
{
    const auto* p = static_cast<const char*>(data);
    bytes.insert(bytes.end(), p, p + size);
}

const char* takeColors(const char* from, std::size_t count, std::vector<Color>& to)
{
    to.resize(count);
    if (count > 0) std::memcpy(static_cast<void*>(to.data()), from, count * sizeof(Color));
    return from + count * sizeof(Color);
}

std::map<std::string, std::string> linesOf(const std::string& header)
{
    std::map<std::string, std::string> lines;
    std::istringstream text(header);
    for (std::string line; std::getline(text, line);) {
        const auto blank = line.find(' ');
        lines[line.substr(0, blank)] = blank == std::string::npos ? "" : line.substr(blank + 1);
    }
    return lines;
}

/// "rays 16 there, 32 now; …"
std::string differences(const std::string& there, const std::string& now)
{
    const auto old = linesOf(there), wanted = linesOf(now);
    std::map<std::string, std::string> all = old;
    all.insert(wanted.begin(), wanted.end());
    const auto value = [](const auto& lines, const std::string& name) {
        const auto found = lines.find(name);
        return found == lines.end() || found->second.empty() ? "nothing" : found->second;
    };
    std::string text;
    for (const auto& line : all) {
        const std::string a = value(old, line.first), b = value(wanted, line.first);
        if (a != b)
            text += (text.empty() ? "" : "; ") + line.first + " " + a + " there, " + b + " now";
    }
    return text;
}

/// The name of a new file is its folder's content. Where that fails, the file is there all the same
/// unless the power is cut.
void syncFolder(const std::string& path)
{
    const auto slash = path.rfind('/');
    const std::string folder = slash == std::string::npos ? "." : path.substr(0, slash + 1);
    const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) return;
    ::fsync(fd);
    ::close(fd);
}

/// Whether the file begins like something else. A header torn at any place is ours.
bool isForeign(int fd)
{
    char begin[sizeof kHeaderMagic];
    const ssize_t n = ::pread(fd, begin, sizeof begin, 0);
    return n < 0 || std::memcmp(begin, &kHeaderMagic, static_cast<std::size_t>(n)) != 0;
}

} // namespace

std::size_t SampleJournal::KeyHash::operator()(const Key& key) const
{
    return static_cast<std::size_t>(hashPoint(key.settings, key.c.x, key.c.y, key.c.z));
}

SampleJournal::SampleJournal(
    const std::string& path, const std::string& header, Start start, Progress* progress)
    : mPath(path)
    , mProgress(progress)
{
    mPending.resize(sizeof(BlockHead));
    mWritten = mSynced = std::chrono::steady_clock::now();
    if (!open()) return;
    try {
        if (start == Start::Anew || !goOn(header)) begin(header);
    } catch (...) {
        ::close(mFd);
        throw;
    }
}

SampleJournal::~SampleJournal()
{
    if (mFd < 0) return;
    flush();
    if (!mHoldsSamples) remove();
    ::close(mFd);
}

void SampleJournal::remove()
{
    const std::lock_guard<std::mutex> guard(mMutex);
    if (mFd < 0 || mRemoved) return;
    ::unlink(mPath.c_str());
    mRemoved = true;
    mWrites = false;
}

void SampleJournal::warn(const std::string& why, const std::string& so)
{
    mWarnings.push_back("The journal '" + mPath + "' " + why + ": " + so + ".");
    if (mProgress) mProgress->warn(mWarnings.back());
}

std::vector<std::string> SampleJournal::warnings() const
{
    const std::lock_guard<std::mutex> guard(mMutex);
    return mWarnings;
}

/// The file at mPath, locked and one of ours or empty.
bool SampleJournal::open()
{
    const std::string without = "the bake goes on without, and could not be resumed";
    const auto giveUp = [&](const std::string& why) {
        if (mFd >= 0) ::close(mFd);
        mFd = -1;
        warn(why, without);
        return false;
    };
    // A file that its owner removed between our opening and locking it is no use to anyone.
    for (int attempt = 0; attempt < 8; ++attempt) {
        // O_NONBLOCK: a pipe of that name must not be waited for.
        mFd = ::open(mPath.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NONBLOCK, 0666);
        if (mFd < 0) return giveUp(std::string("cannot be opened (") + std::strerror(errno) + ")");
        struct stat opened {
        }, named{};
        if (::fstat(mFd, &opened) != 0 || !S_ISREG(opened.st_mode)) return giveUp("is not a file");
        if (::flock(mFd, LOCK_EX | LOCK_NB) != 0) {
            return giveUp(errno == EWOULDBLOCK
                    ? "belongs to another bake that is running"
                    : std::string("cannot be locked (") + std::strerror(errno) + ")");
        }
        if (::stat(mPath.c_str(), &named) == 0 && named.st_ino == opened.st_ino
            && named.st_dev == opened.st_dev) {
            if (isForeign(mFd)) return giveUp("is a file of another kind");
            return true;
        }
        ::close(mFd);
    }
    mFd = -1;
    warn("cannot be locked", without);
    return false;
}

/// Empties the file and writes the header.
void SampleJournal::begin(const std::string& header)
{
    mWrites = true;
    if (::ftruncate(mFd, 0) != 0) {
        mWrites = false;
        warn(std::string("cannot be emptied (") + std::strerror(errno) + ")",
            "the bake goes on without");
        return;
    }
    std::vector<char> block(sizeof(BlockHead));
    append(block, header.data(), header.size());
    if (writeBlock(kHeaderMagic, block)) syncFolder(mPath);
}

/// Reads what is there. False where it is not even a header.
bool SampleJournal::goOn(const std::string& header)
{
    std::vector<char> payload;
    if (!readBlock(kHeaderMagic, 0, payload)) {
        struct stat opened { };
        const bool empty = ::fstat(mFd, &opened) == 0 && opened.st_size == 0;
        if (!empty) warn("is damaged from its beginning", "the bake starts anew");
        return false;
    }
    const std::string there(payload.begin(), payload.end());
    if (there != header) {
        throw Error(ErrorCode::Usage,
            "The journal '" + mPath + "' is of another bake (" + differences(there, header)
                + "): delete the file or drop --resume.");
    }
    mEnd = sizeof(BlockHead) + payload.size();
    while (
        readBlock(kBlockMagic, mEnd, payload) && indexRecords(payload, mEnd + sizeof(BlockHead))) {
        mEnd += sizeof(BlockHead) + payload.size();
    }
    mReads = mHoldsSamples = !mIndex.empty();
    mWrites = ::ftruncate(mFd, static_cast<off_t>(mEnd)) == 0;
    if (!mWrites) {
        warn(std::string("cannot be continued (") + std::strerror(errno) + ")",
            "what is in it is used, and nothing added");
    }
    return true;
}

bool SampleJournal::readAt(std::uint64_t offset, void* data, std::size_t size) const
{
    auto* p = static_cast<char*>(data);
    while (size > 0) {
        const ssize_t n = ::pread(mFd, p, size, static_cast<off_t>(offset));
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) return false;
        p += n;
        offset += static_cast<std::uint64_t>(n);
        size -= static_cast<std::size_t>(n);
    }
    return true;
}

/// False where there is no whole and undamaged block of that kind.
bool SampleJournal::readBlock(
    std::uint32_t magic, std::uint64_t offset, std::vector<char>& payload) const
{
    BlockHead head;
    if (!readAt(offset, &head, sizeof head)) return false;
    if (head.magic != magic || head.size > kMaxPayload) return false;
    payload.resize(head.size);
    return readAt(offset + sizeof head, payload.data(), payload.size())
        && checksum(payload.data(), payload.size()) == head.checksum;
}

/// Adds the records of a block whose payload lies at @a offset. False where it is not made of
/// records; nothing was added then.
bool SampleJournal::indexRecords(const std::vector<char>& payload, std::uint64_t offset)
{
    std::vector<std::pair<Key, Place>> found;
    RecordHead head;
    for (std::size_t at = 0; at < payload.size();) {
        if (payload.size() - at < sizeof head) return false;
        std::memcpy(&head, payload.data() + at, sizeof head);
        const std::size_t size = recordSize(head);
        if (size == 0 || size > payload.size() - at) return false;
        found.push_back({{head.settings, Coord(head.x, head.y, head.z)},
            {offset + at, static_cast<std::uint32_t>(size)}});
        at += size;
    }
    mIndex.insert(found.begin(), found.end());
    return true;
}

bool SampleJournal::holds(const Kind& kind, const Coord& c) const
{
    return mReads && mIndex.count({kind.settings, c}) != 0;
}

bool SampleJournal::take(const Kind& kind, const Coord& c, BakedSample& sample)
{
    if (!mReads) return false;
    const auto found = mIndex.find({kind.settings, c});
    if (found == mIndex.end()) return false;
    std::vector<char> record(found->second.size);
    if (!readAt(found->second.offset, record.data(), record.size())) return false;
    RecordHead head;
    std::memcpy(&head, record.data(), sizeof head);
    if (head.values != kind.values || head.gradients != kind.gradients
        || recordSize(head) != record.size()) {
        return false;
    }
    ProbeResult& r = sample.result;
    r.validity = head.validity;
    r.distance = head.distance;
    r.minDistance = head.minDistance;
    r.rays = head.resultRays;
    r.directions = head.directions;
    sample.offset = Vec3f(head.offset[0], head.offset[1], head.offset[2]);
    sample.variance = Color(head.variance[0], head.variance[1], head.variance[2]);
    sample.rays = head.rays;
    const char* colors = takeColors(record.data() + sizeof head, head.values, r.value);
    colors = takeColors(colors, head.values, r.stderr_);
    takeColors(colors, head.gradients, r.gradient);
    ++mTaken;
    mTakenRays += head.rays;
    return true;
}

void SampleJournal::add(const Kind& kind, const Coord& c, const BakedSample& sample)
{
    const ProbeResult& r = sample.result;
    const Vec3f& o = sample.offset;
    const Color& v = sample.variance;
    const RecordHead head
        = {kind.settings, c.x, c.y, c.z, r.validity, r.distance, r.minDistance, {o.x, o.y, o.z},
            {v.x, v.y, v.z}, sample.rays, r.rays, r.directions, kind.values, kind.gradients};
    const bool whole = r.value.size() == kind.values && r.stderr_.size() == kind.values
        && r.gradient.size() == kind.gradients;
    bool due = false;
    {
        const std::lock_guard<std::mutex> guard(mMutex);
        if (!mWrites || !whole) return;
        append(mPending, &head, sizeof head);
        for (const std::vector<Color>* colors : {&r.value, &r.stderr_, &r.gradient})
            append(mPending, colors->data(), colors->size() * sizeof(Color));
        if (mPending.size() >= kBlockBytes
            || std::chrono::steady_clock::now() - mWritten >= kBlockAge) {
            writePending();
            due = isSyncDue();
        }
    }
    if (due) sync(); // may take long: the other threads go on meanwhile
}

/// Whether the caller should sync(); it alone is told so.
bool SampleJournal::isSyncDue()
{
    const auto now = std::chrono::steady_clock::now();
    if (now - mSynced < kSyncAge) return false;
    mSynced = now;
    return true;
}

void SampleJournal::sync()
{
    if (::fdatasync(mFd) == 0) return;
    const int error = errno;
    const std::lock_guard<std::mutex> guard(mMutex);
    if (!mWrites) return;
    mWrites = false;
    warn(std::string("cannot be written (") + std::strerror(error) + ")",
        "the bake goes on without; what it holds can still be resumed");
}

void SampleJournal::finish()
{
    flush();
    if (mFd >= 0) sync();
    const std::lock_guard<std::mutex> guard(mMutex);
    mProgress = nullptr;
}

void SampleJournal::flush()
{
    const std::lock_guard<std::mutex> guard(mMutex);
    writePending();
}

void SampleJournal::writePending()
{
    if (!mWrites || mPending.size() <= sizeof(BlockHead)) return;
    if (writeBlock(kBlockMagic, mPending)) mHoldsSamples = true;
    mPending.resize(sizeof(BlockHead));
    mWritten = std::chrono::steady_clock::now();
}

/// Appends @a block, whose first bytes are left for the head. Where that fails, the first time is
/// the last: the file keeps what it has.
bool SampleJournal::writeBlock(std::uint32_t magic, std::vector<char>& block)
{
    const std::size_t size = block.size() - sizeof(BlockHead);
    const BlockHead head
        = {magic, static_cast<std::uint32_t>(size), checksum(block.data() + sizeof head, size)};
    std::memcpy(block.data(), &head, sizeof head);
    for (std::size_t done = 0; done < block.size();) {
        const ssize_t n = ::pwrite(
            mFd, block.data() + done, block.size() - done, static_cast<off_t>(mEnd + done));
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) {
            mWrites = false;
            warn(std::string("cannot be written (") + std::strerror(n < 0 ? errno : ENOSPC) + ")",
                "the bake goes on without; what it holds can still be resumed");
            return ::ftruncate(mFd, static_cast<off_t>(mEnd)) == 0 && false;
        }
        done += static_cast<std::size_t>(n);
    }
    mEnd += block.size();
    return true;
}

std::shared_ptr<SampleJournal> openJournal(
    const BakeOptions& options, const Scene& scene, Progress& progress)
{
    if (options.journal.empty()) return nullptr;
    return std::make_shared<SampleJournal>(options.journal, journalHeader(options, scene),
        options.resume ? SampleJournal::Start::GoOn : SampleJournal::Start::Anew, &progress);
}

void removeJournal(const BakeResult& result)
{
    if (result.journal) result.journal->remove();
}

} // namespace lumivdb
