// The kernel cache: what it takes as its folder, what it takes as an entry, and that nothing in it
// can stop a start.
// SPDX-License-Identifier: BSD-3-Clause
#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <ctime>
#include <thread>

#include "host/device/cache.h"
#include "host/device/source.h"
#include "tests/host/device/environment.h"
#include "tests/host/device/saxpy.h"

namespace pave {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

// ---- Entries ----

const std::string kKey(32, 'a');

std::vector<PackedFile> sample_files() {
    return {{"AB/CDE/program.bc", std::string(700, 'x')},
            {"AB/CDE/k/1-1-1/k.so", std::string("\0\1\2", 3)},
            {"program.binary", ""}};
}

TEST(Pack, RoundTrip) {
    const auto files = unpack(kKey, pack(kKey, sample_files()));
    ASSERT_TRUE(files);
    ASSERT_EQ(files->size(), 3u);
    for (size_t i = 0; i < files->size(); ++i) {
        EXPECT_EQ((*files)[i].path, sample_files()[i].path);
        EXPECT_EQ((*files)[i].bytes, sample_files()[i].bytes);
    }
    EXPECT_TRUE(unpack(kKey, pack(kKey, {})));
}

TEST(Pack, EveryTruncationAndEveryFlipIsSeen) {
    const std::string entry = pack(kKey, sample_files());
    for (size_t size = 0; size < entry.size(); ++size)
        EXPECT_FALSE(unpack(kKey, std::string_view(entry).substr(0, size)))
            << size << " bytes left";
    for (size_t i = 0; i < entry.size(); ++i) {
        std::string flipped = entry;
        flipped[i] = static_cast<char>(flipped[i] ^ (1 << (i % 8)));
        EXPECT_FALSE(unpack(kKey, flipped)) << "bit " << i % 8 << " of byte " << i;
    }
    EXPECT_FALSE(unpack(kKey, entry + "x"));
    EXPECT_FALSE(unpack(std::string(32, 'b'), entry)) << "an entry under another's name";
}

TEST(Pack, PathsThatLeadOutAreRefused) {
    for (const char* path : {"/etc/passwd", "../x", "a/../../x", "a//b", "./a", "a/.", "", "a/"})
        EXPECT_FALSE(unpack(kKey, pack(kKey, {{path, "x"}}))) << path;
}

TEST(PackDeathTest, AFullDiskLeavesNothingHalf) {
    GTEST_FLAG_SET(death_test_style, "threadsafe");
    const auto fill = [] {
        TemporaryFolder folder;
        signal(SIGXFSZ, SIG_IGN);
        const rlimit limit{100, 100};
        setrlimit(RLIMIT_FSIZE, &limit);
        const bool small = try_write_file(folder.path() / "small", std::string(100, 'x'));
        const bool large = try_write_file(folder.path() / "large", std::string(101, 'x'));
        const auto left =
            std::distance(fs::directory_iterator(folder.path()), fs::directory_iterator());
        return small && !large && left == 1;
    };
    EXPECT_EXIT(std::exit(fill() ? 0 : 1), testing::ExitedWithCode(0), "");
}

// ---- Folders ----

std::string note_of(const fs::path& folder) {
    ScopedVariable variable("PAVE_CACHE_DIR", folder.c_str());
    ScopedVariable on("PAVE_NO_CACHE", nullptr);
    return open_cache_folder().note;
}

TEST(CacheFolder, IsMadePrivate) {
    TemporaryFolder parent;
    const fs::path folder = parent.path() / "not" / "there" / "yet";
    ScopedVariable mask("PAVE_CACHE_DIR", folder.c_str());
    ScopedVariable on("PAVE_NO_CACHE", nullptr);
    EXPECT_EQ(open_cache_folder().path, folder);
    struct stat info {};
    ASSERT_EQ(stat(folder.c_str(), &info), 0);
    EXPECT_EQ(info.st_mode & 07777, 0700u);
    EXPECT_EQ(open_cache_folder().path, folder) << "and taken the second time";
}

TEST(CacheFolder, ThatOthersMayChangeIsRefused) {
    TemporaryFolder parent;
    const fs::path folder = parent.path() / "cache";
    fs::create_directory(folder);
    for (mode_t mode : {0777u, 0755u, 0770u, 0701u}) {
        ASSERT_EQ(chmod(folder.c_str(), mode), 0);
        EXPECT_NE(note_of(folder).find("is open to others (chmod 700)"), std::string::npos) << mode;
    }
    ASSERT_EQ(chmod(folder.c_str(), 0700), 0);
    EXPECT_EQ(note_of(folder), "");
    ASSERT_EQ(chmod(parent.path().c_str(), 0777), 0);
    EXPECT_NE(note_of(folder).find("lies in a folder that everybody can change"),
              std::string::npos);
    ASSERT_EQ(chmod(parent.path().c_str(), 01777), 0);
    EXPECT_EQ(note_of(folder), "") << "sticky, as /tmp is";
}

TEST(CacheFolder, LinksAndFilesAndStrangersAreRefused) {
    TemporaryFolder parent;
    fs::create_directory(parent.path() / "real");
    chmod((parent.path() / "real").c_str(), 0700);
    fs::create_directory_symlink(parent.path() / "real", parent.path() / "link");
    EXPECT_NE(note_of(parent.path() / "link").find("is a symbolic link"), std::string::npos);
    EXPECT_NE(note_of(parent.path() / "link" / "").find("is a symbolic link"), std::string::npos);
    fs::create_directory_symlink(parent.path() / "nowhere", parent.path() / "dangling");
    EXPECT_NE(note_of(parent.path() / "dangling").find("is a symbolic link"), std::string::npos);
    write_text(parent.path() / "file", "");
    EXPECT_NE(note_of(parent.path() / "file").find("is not a folder"), std::string::npos);
    EXPECT_NE(note_of(parent.path() / "file" / "below"), "");
    EXPECT_NE(note_of("/proc/cannot-be-made"), "");
    // root makes a stranger's folder, anybody else finds root's.
    fs::path strange = "/usr";
    if (geteuid() == 0) {
        strange = parent.path() / "strange";
        fs::create_directory(strange);
        ASSERT_EQ(chown(strange.c_str(), 65534, 65534), 0);
    }
    EXPECT_NE(note_of(strange).find("belongs to another user"), std::string::npos);
}

TEST(CacheFolder, FollowsTheVariablesInOrder) {
    TemporaryFolder home;
    ScopedVariable on("PAVE_NO_CACHE", nullptr), own("PAVE_CACHE_DIR", nullptr);
    ScopedVariable xdg("XDG_CACHE_HOME", nullptr), at_home("HOME", home.path().c_str());
    EXPECT_EQ(open_cache_folder().path, home.path() / ".cache" / "pave");
    {
        ScopedVariable relative("XDG_CACHE_HOME", "relative");
        EXPECT_EQ(open_cache_folder().path, home.path() / ".cache" / "pave");
    }
    {
        ScopedVariable absolute("XDG_CACHE_HOME", (home.path() / "xdg").c_str());
        EXPECT_EQ(open_cache_folder().path, home.path() / "xdg" / "pave");
        ScopedVariable first("PAVE_CACHE_DIR", (home.path() / "first").c_str());
        EXPECT_EQ(open_cache_folder().path, home.path() / "first");
        ScopedVariable off("PAVE_NO_CACHE", "1");
        EXPECT_EQ(open_cache_folder().path, "");
    }
    ScopedVariable homeless("HOME", nullptr);
    EXPECT_EQ(open_cache_folder().path, "");
    EXPECT_NE(open_cache_folder().note.find("HOME"), std::string::npos);
}

TEST(ProcessFolder, IsPrivateLockedAndRemoved) {
    TemporaryFolder cache;
    fs::path first;
    {
        const ProcessFolder folder(cache.path());
        first = folder.path();
        EXPECT_EQ(first.parent_path(), cache.path() / "run");
        struct stat info {};
        ASSERT_EQ(stat(first.c_str(), &info), 0);
        EXPECT_EQ(info.st_mode & 07777, 0700u);
        const ProcessFolder other(cache.path());
        EXPECT_NE(other.path(), first);
        EXPECT_TRUE(fs::exists(first)) << "the second swept the first, which lives";
    }
    EXPECT_FALSE(fs::exists(first));
    const ProcessFolder temporary{fs::path()};
    EXPECT_EQ(temporary.path().parent_path(), fs::temp_directory_path());
}

// ---- Whole processes, each a fork that makes its first OpenCL call itself ----

struct Child {
    pid_t pid = -1;
    int pipe = -1;
};

struct Outcome {
    int status = -1;    // as waitpid gives it
    std::string text;   // what the child said
    double cpu_ms = 0;  // of its processors: other programs on the machine don't count
};

/// Runs `body` in a fork; the parent must not have used OpenCL. `body` returns what it has to say.
template <class Body>
Child start(Body body) {
    int ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) return {};
    const pid_t pid = fork();
    if (pid != 0) {
        close(ends[1]);
        return {pid, ends[0]};
    }
    std::string text;
    try {
        text = body();
    } catch (const std::exception& error) {
        text = error.what();
    }
    dprintf(ends[1], "%f %s", 1e3 * static_cast<double>(std::clock()) / CLOCKS_PER_SEC,
            text.c_str());
    std::exit(0);  // with exit handlers: they save and sweep
}

/// Waits for the child's end, 400 s at most, then kills it.
Outcome finish_child(const Child& child) {
    Outcome outcome;
    std::string text;
    char bytes[512];
    const Clock::time_point deadline = Clock::now() + std::chrono::seconds(400);
    for (pollfd ready{child.pipe, POLLIN, 0}; Clock::now() < deadline;) {
        if (poll(&ready, 1, 200) <= 0) continue;
        const ssize_t got = read(child.pipe, bytes, sizeof bytes);
        if (got <= 0) break;
        text.append(bytes, static_cast<size_t>(got));
    }
    close(child.pipe);
    if (Clock::now() >= deadline) kill(child.pid, SIGKILL);
    waitpid(child.pid, &outcome.status, 0);
    const size_t space = text.find(' ');
    if (space != std::string::npos) {
        outcome.cpu_ms = std::atof(text.c_str());
        outcome.text = text.substr(space + 1);
    }
    return outcome;
}

std::string saxpy_of_selected() { return run_saxpy(Device::select()); }

Outcome run_process(std::string (*body)() = saxpy_of_selected) { return finish_child(start(body)); }

/// A death test's fresh process reports through this: prints what failed and where.
#define REQUIRE_THAT(condition, detail)                                                           \
    do {                                                                                          \
        if (!(condition)) {                                                                       \
            std::cerr << __FILE__ << ":" << __LINE__ << ": " #condition ": " << (detail) << "\n"; \
            return false;                                                                         \
        }                                                                                         \
    } while (false)

bool is_right(const Outcome& outcome) {
    REQUIRE_THAT(outcome.status == 0 && outcome.text.empty(),
                 outcome.text + " (status " + std::to_string(outcome.status) + ")");
    return true;
}

std::vector<fs::path> entries_of(const fs::path& cache) {
    std::vector<fs::path> entries;
    for (const auto& entry : fs::directory_iterator(cache))
        if (entry.path().extension() == ".kernel") entries.push_back(entry.path());
    return entries;
}

size_t count_in(const fs::path& folder) {
    std::error_code error;
    return static_cast<size_t>(
        std::distance(fs::directory_iterator(folder, error), fs::directory_iterator()));
}

/// Second start: from the cache, right, and faster than half the first one.
bool warm_start_is_fast() {
    TemporaryFolder cache;
    setenv("PAVE_CACHE_DIR", cache.path().c_str(), 1);
    TemporaryFolder planted;  // a PoCL cache that somebody else prepared
    setenv("POCL_CACHE_DIR", planted.path().c_str(), 1);
    const Outcome cold = run_process();
    if (!is_right(cold)) return false;
    REQUIRE_THAT(entries_of(cache.path()).size() == 1, "one program, one entry");
    REQUIRE_THAT(count_in(cache.path() / "run") == 0, "the process's folder stays behind");
    const Outcome warm = run_process();
    if (!is_right(warm)) return false;
    const double warm_ms = warm.cpu_ms;
    std::cerr << "cold " << cold.cpu_ms << " ms, warm " << warm_ms << " ms\n";
    REQUIRE_THAT(warm_ms < 0.5 * cold.cpu_ms && warm_ms < 1000.0, warm_ms);
    REQUIRE_THAT(count_in(planted.path()) == 0, "the driver used a folder that is not PAVE's");
    return true;
}

bool damaged_entries_are_compiled_again() {
    TemporaryFolder cache;
    setenv("PAVE_CACHE_DIR", cache.path().c_str(), 1);
    if (!is_right(run_process())) return false;
    const fs::path entry = entries_of(cache.path()).at(0);
    const std::string whole = read_text(entry);
    std::string flipped = whole;
    flipped[whole.size() / 2] = static_cast<char>(flipped[whole.size() / 2] ^ 4);
    for (const std::string& damaged : {whole.substr(0, whole.size() / 2), flipped}) {
        write_text(entry, damaged);
        if (!is_right(run_process())) return false;
        REQUIRE_THAT(read_text(entry).size() > whole.size() / 2, "the entry was not replaced");
    }
    // A binary with a right checksum that the driver cannot read: source is the way then.
    write_text(entry, pack(entry.stem().string(), {{"program.binary", "not a binary"}}));
    return is_right(run_process());
}

bool eight_cold_starts_at_once_are_right() {
    TemporaryFolder cache;
    setenv("PAVE_CACHE_DIR", (cache.path() / "shared").c_str(), 1);
    std::vector<Child> children;
    for (int i = 0; i < 8; ++i) children.push_back(start(saxpy_of_selected));
    bool right = true;
    for (const Child& child : children) right = is_right(finish_child(child)) && right;
    REQUIRE_THAT(entries_of(cache.path() / "shared").size() == 1, "one program, one entry");
    REQUIRE_THAT(count_in(cache.path() / "shared" / "run") == 0, "folders stay behind");
    return right && is_right(run_process());
}

bool no_folder_is_no_hindrance() {
    TemporaryFolder temporary;
    setenv("TMPDIR", temporary.path().c_str(), 1);
    unsetenv("HOME");
    unsetenv("XDG_CACHE_HOME");
    unsetenv("PAVE_CACHE_DIR");
    if (!is_right(run_process())) return false;
    REQUIRE_THAT(count_in(temporary.path()) == 0, "something stays in the temporary folder");
    setenv("TMPDIR", "/proc", 1);
    const Outcome nowhere = run_process();
    REQUIRE_THAT(nowhere.text.find("set PAVE_CACHE_DIR or TMPDIR") != std::string::npos,
                 nowhere.text);
    return true;
}

/// A killed process has kept what was compiled at its launches, and the next one clears up after
/// it.
bool killed_processes_leave_only_the_cache() {
    TemporaryFolder cache;
    setenv("PAVE_CACHE_DIR", cache.path().c_str(), 1);
    if (!is_right(run_process())) return false;
    const size_t before = fs::file_size(entries_of(cache.path()).at(0));
    const Outcome killed = run_process([]() -> std::string {
        const Device device = Device::select();
        run_saxpy(device, 1024, 64);
        std::this_thread::sleep_for(std::chrono::milliseconds(600));
        finish(device, "nothing");
        raise(SIGKILL);
        return "";
    });
    REQUIRE_THAT(WIFSIGNALED(killed.status), killed.text);
    REQUIRE_THAT(count_in(cache.path() / "run") == 1, "nothing to sweep");
    const size_t after = fs::file_size(entries_of(cache.path()).at(0));
    REQUIRE_THAT(after > before, after);
    if (!is_right(run_process())) return false;
    REQUIRE_THAT(count_in(cache.path() / "run") == 0, "a dead process's folder stays behind");
    return true;
}

class CacheDeathTest : public testing::Test {
   protected:
    void SetUp() override { GTEST_FLAG_SET(death_test_style, "threadsafe"); }
};

#define EXPECT_SCENARIO(scenario) \
    EXPECT_EXIT(std::exit(scenario() ? 0 : 1), testing::ExitedWithCode(0), "")

TEST_F(CacheDeathTest, WarmStartIsFast) { EXPECT_SCENARIO(warm_start_is_fast); }
TEST_F(CacheDeathTest, DamagedEntriesAreCompiledAgain) {
    EXPECT_SCENARIO(damaged_entries_are_compiled_again);
}
TEST_F(CacheDeathTest, EightColdStartsAtOnceAreRight) {
    EXPECT_SCENARIO(eight_cold_starts_at_once_are_right);
}
TEST_F(CacheDeathTest, NoFolderIsNoHindrance) { EXPECT_SCENARIO(no_folder_is_no_hindrance); }
TEST_F(CacheDeathTest, KilledProcessesLeaveOnlyTheCache) {
    EXPECT_SCENARIO(killed_processes_leave_only_the_cache);
}

}  // namespace
}  // namespace pave
