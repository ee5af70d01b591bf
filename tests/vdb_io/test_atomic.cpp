// SPDX-License-Identifier: Apache-2.0
#include "vdb_test.h"

#include <lumivdb/core/error.h>
#include <lumivdb/vdb_io/volume_file.h>

#include <catch2/catch.hpp>

#include <atomic>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <limits>

#include <spawn.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

using namespace vdb_test;
namespace fs = std::filesystem;

namespace {

/// The code of the Error that saving throws, or nothing.
int saveCode(const IrradianceVolume& volume, const std::string& path,
    const SaveOptions& options = {}, Progress* progress = nullptr)
{
    try {
        saveVolume(volume, path, options, progress);
    } catch (const Error& e) {
        UNSCOPED_INFO(e.what());
        return static_cast<int>(e.code());
    }
    return 0;
}

std::string saveMessage(
    const IrradianceVolume& volume, const std::string& path, const SaveOptions& options = {})
{
    try {
        saveVolume(volume, path, options);
    } catch (const Error& e) {
        CHECK(e.code() == ErrorCode::Output);
        return e.what();
    }
    return {};
}

/// Limits the size of files this process writes, as a full disk would.
class FileSizeLimit {
public:
    explicit FileSizeLimit(rlim_t bytes)
    {
        mOldHandler = std::signal(SIGXFSZ, SIG_IGN);
        ::getrlimit(RLIMIT_FSIZE, &mOld);
        const rlimit limit{bytes, mOld.rlim_max};
        ::setrlimit(RLIMIT_FSIZE, &limit);
    }
    ~FileSizeLimit()
    {
        ::setrlimit(RLIMIT_FSIZE, &mOld);
        std::signal(SIGXFSZ, mOldHandler);
    }

private:
    rlimit mOld{};
    void (*mOldHandler)(int) = nullptr;
};

/// Asks to stop at the n-th question.
class StopAt : public Progress {
public:
    explicit StopAt(int question)
        : mLeft(question)
    {
    }
    bool cancelled() override { return mLeft-- <= 0; }

private:
    std::atomic<int> mLeft;
};

constexpr int kOutput = static_cast<int>(ErrorCode::Output);
constexpr int kInterrupted = static_cast<int>(ErrorCode::Interrupted);

} // namespace

TEST_CASE("places that cannot be written are refused")
{
    const TempFolder folder;
    const IrradianceVolume volume = uniformVolume({0, 0, 0}, {2, 2, 2}, 1, false);
    writeBytes(folder.file("file"), {'x'});
    for (const std::string& path :
        {folder.file("absent/a.vdb"), folder.file("file/a.vdb"), folder.path().string(),
            std::string("/proc/lumivdb.vdb"), std::string("/dev/full"), std::string()}) {
        INFO(path);
        CHECK(saveCode(volume, path) == kOutput);
    }
    CHECK(fs::is_character_file("/dev/full"));
    CHECK(folder.entries() == 1);
    fs::create_symlink("loop", folder.path() / "loop");
    CHECK(saveCode(volume, folder.file("loop")) == kOutput);
    CHECK(folder.entries() == 2);
}

TEST_CASE("a full disk leaves the old file")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb");
    const IrradianceVolume old = uniformVolume({0, 0, 0}, {2, 2, 2}, 1, false);
    const IrradianceVolume big = uniformVolume({0, 0, 0}, {20, 20, 20}, 3, false);
    saveVolume(old, path);
    const auto full = [&] {
        const TempFolder other;
        saveVolume(big, other.file("a.vdb"));
        return fs::file_size(other.file("a.vdb"));
    }();
    for (const double share : {0.0, 0.01, 0.5, 0.9, 0.99999}) {
        const FileSizeLimit limit(static_cast<rlim_t>(share * static_cast<double>(full)));
        CHECK(saveCode(big, path) == kOutput);
        CHECK(folder.entries() == 1);
    }
    CHECK(difference(old, loadVolume(path)) == "");
}

TEST_CASE("interruption at any moment leaves the old file")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb");
    const IrradianceVolume old = uniformVolume({0, 0, 0}, {2, 2, 2}, 1, false);
    const IrradianceVolume next = uniformVolume({0, 0, 0}, {16, 16, 16}, 2, true);
    saveVolume(old, path);
    int interrupted = 0;
    for (int question = 0;; ++question) {
        StopAt progress(question);
        const int code = saveCode(next, path, {}, &progress);
        CHECK(folder.entries() == 1);
        if (code == 0) break;
        REQUIRE(code == kInterrupted);
        ++interrupted;
        if (question % 8 == 0) CHECK(difference(old, loadVolume(path)) == "");
    }
    CHECK(interrupted > 20);
    CHECK(difference(next, loadVolume(path)) == "");
    StopAt reading(3);
    CHECK_THROWS_AS(loadVolume(path, &reading), Error);
}

TEST_CASE("symbolic links stay and permissions are kept")
{
    const TempFolder folder;
    const IrradianceVolume a = uniformVolume({0, 0, 0}, {2, 2, 2}, 1, false);
    const IrradianceVolume b = uniformVolume({0, 0, 0}, {3, 2, 2}, 1, false);
    fs::create_directory(folder.path() / "data");
    fs::create_symlink("data/real.vdb", folder.path() / "link.vdb");
    saveVolume(a, folder.file("link.vdb")); // the target does not exist yet
    CHECK(fs::is_symlink(folder.path() / "link.vdb"));
    CHECK(difference(a, loadVolume(folder.file("data/real.vdb"))) == "");
    fs::permissions(folder.file("data/real.vdb"), fs::perms(0640));
    saveVolume(b, folder.file("link.vdb"));
    CHECK(fs::is_symlink(folder.path() / "link.vdb"));
    CHECK(difference(b, loadVolume(folder.file("data/real.vdb"))) == "");
    CHECK(fs::status(folder.file("data/real.vdb")).permissions() == fs::perms(0640));
}

TEST_CASE("values that the file cannot hold are refused before anything is written")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb");
    IrradianceVolume volume = uniformVolume({-1, 0, 0}, {2, 2, 2}, 2, true);
    SaveOptions asHalf;
    asHalf.half = true;
    const auto sample = static_cast<SampleId>(volume.findSample({-1, 2, 1}));

    volume.gradient(sample)[4 + 2].y = -65505.0f; // axis y, coefficient 2
    const std::string overflow = saveMessage(volume, path, asHalf);
    CHECK_THAT(overflow, Catch::Contains("'sh_2_dy'") && Catch::Contains("(-1, 2, 1)"));
    CHECK_THAT(overflow, Catch::Contains("65504") && Catch::Contains(path));
    CHECK(saveMessage(volume, path).empty()); // full floats hold it
    fs::remove(path);

    volume.gradient(sample)[4 + 2].y = 65504.0f;
    CHECK(saveMessage(volume, path, asHalf).empty());
    CHECK(loadVolume(path).gradient(sample)[4 + 2].y == 65504.0f);
    fs::remove(path);

    volume.distance(sample) = 1e9f; // stays a full float
    CHECK(saveMessage(volume, path, asHalf).empty());
    CHECK(loadVolume(path).distance(sample) == 1e9f);
    fs::remove(path);

    for (const float bad : {std::nanf(""), std::numeric_limits<float>::infinity()}) {
        volume.radiance(sample)[3].z = bad;
        CHECK_THAT(saveMessage(volume, path), Catch::Contains("'sh_3'"));
        CHECK_THAT(saveMessage(volume, path, asHalf), Catch::Contains("NaN or infinite"));
    }
    volume.radiance(sample)[3].z = 0.0f;
    volume.validity(sample) = std::nanf("");
    CHECK_THAT(saveMessage(volume, path), Catch::Contains("'validity'"));
    volume.validity(sample) = 1.0f;
    volume.distance(sample) = std::nanf("");
    CHECK_THAT(saveMessage(volume, path), Catch::Contains("'distance'"));
    CHECK(folder.entries() == 0);
}

// Runs in a process of its own, see below.
TEST_CASE("write a file again and again", "[.write-forever]")
{
    const char* path = std::getenv("LUMIVDB_TEST_FILE");
    REQUIRE(path);
    const IrradianceVolume volume = uniformVolume({0, 0, 0}, {24, 24, 24}, 3, false);
    for (;;) saveVolume(volume, path);
}

TEST_CASE("a killed process leaves a whole file and nothing else")
{
    const TempFolder folder;
    const std::string path = folder.file("a.vdb");
    const std::string self = fs::read_symlink("/proc/self/exe").string();
    const std::string variable = "LUMIVDB_TEST_FILE=" + path;
    std::vector<char*> environment;
    for (char** e = environ; *e; ++e) environment.push_back(*e);
    environment.push_back(const_cast<char*>(variable.c_str()));
    environment.push_back(nullptr);
    const char* arguments[] = {self.c_str(), "[.write-forever]", "-o", "/dev/null", nullptr};
    const IrradianceVolume expected = uniformVolume({0, 0, 0}, {24, 24, 24}, 3, false);
    for (int round = 0; round < 6; ++round) {
        pid_t child = 0;
        REQUIRE(::posix_spawn(&child, self.c_str(), nullptr, nullptr,
                    const_cast<char* const*>(arguments), environment.data())
            == 0);
        for (int wait = 0; wait < 2000 && !fs::exists(path); ++wait) ::usleep(10000);
        ::usleep(static_cast<useconds_t>(7000 + 31000 * round));
        ::kill(child, SIGKILL);
        ::waitpid(child, nullptr, 0);
        CHECK(difference(expected, loadVolume(path)) == "");
        // A name besides the old one exists only between link and rename.
        CHECK(folder.entries() <= 2);
    }
}
