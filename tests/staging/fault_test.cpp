// Places that cannot be written: full disks, limits, missing rights. One clear error, acknowledged
// frames stay readable.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstring>

#include "pave/exr.h"
#include "pave/trace.h"
#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

/// Writes until the place is full. "" if the error is as promised and what was acknowledged is
/// there, else what is wrong.
std::string write_until_full(const std::string& uri, const fs::path& folder, const char* reason) {
    int64_t acknowledged = 0;
    std::string error = "no error";
    try {
        Stage stage(uri, small_options());
        try {
            publish_frames(stage, 0, 60);
            stage.close();
        } catch (const RunError& failure) {
            error = failure.what();
        }
        acknowledged = stage.acknowledged();
        try {
            stage.close();
        } catch (const RunError&) {
        }
    } catch (const RunError& failure) {
        error = failure.what();
        if (fs::exists(folder / "manifest.jsonl")) return "a manifest in spite of: " + error;
    }
    if (error.find(reason) == std::string::npos ||
        error.find(folder.string()) == std::string::npos || error.find('\n') != std::string::npos ||
        error.find('\033') != std::string::npos)
        return "not one clear line: " + error;
    if (!fs::exists(folder / "manifest.jsonl")) return {};
    for (const std::string& file : list_files(folder))
        if (file.starts_with(".tmp-")) return "left behind: " + file;
    // Nothing half-written under a final name either: every block is in the manifest, every frame
    // whole.
    return check_data_set(uri, acknowledged, true);
}

/// Runs `body` in a process of its own, after `prepare` there; its words come back. What `prepare`
/// says instead of "" comes back too, and then `body` does not run.
template <typename Prepare, typename Body>
std::string in_process(Prepare prepare, Body body) {
    int ends[2];
    if (pipe(ends) != 0) return "pipe failed";
    const pid_t pid = fork();
    if (pid == 0) {
        std::string text = prepare();
        if (text.empty()) text = body();
        const bool told =
            write(ends[1], text.data(), text.size()) == static_cast<ssize_t>(text.size());
        _exit(told ? 0 : 1);
    }
    close(ends[1]);
    std::string text;
    char buffer[4096];
    for (ssize_t got = 0; (got = read(ends[0], buffer, sizeof buffer)) > 0;)
        text.append(buffer, static_cast<size_t>(got));
    close(ends[0]);
    int status = 0;
    waitpid(pid, &status, 0);
    return WIFEXITED(status) && WEXITSTATUS(status) == 0
               ? text
               : "the process died: " + std::to_string(status);
}

/// Files of at most `byte_size` bytes.
template <typename Body>
std::string with_file_limit(rlim_t byte_size, Body body) {
    const auto limit_files = [&]() -> std::string {
        signal(SIGXFSZ, SIG_IGN);
        const rlimit limit{byte_size, byte_size};
        return setrlimit(RLIMIT_FSIZE, &limit) == 0 ? "" : std::strerror(errno);
    };
    return in_process(limit_files, body);
}

constexpr const char* kNotAllowed = "mounting is not allowed here";

/// Mounts that only this process sees, and that go with it: by its own right or, for users that
/// have none, in a user namespace. "" or why not.
std::string enter_own_mounts() {
    const uid_t user = getuid();
    const gid_t group = getgid();
    if (unshare(CLONE_NEWNS) != 0) {
        if (unshare(CLONE_NEWUSER | CLONE_NEWNS) != 0)
            return errno == EPERM || errno == EINVAL || errno == ENOSPC ? kNotAllowed
                                                                        : std::strerror(errno);
        write_text("/proc/self/setgroups", "deny");
        write_text("/proc/self/uid_map", "0 " + std::to_string(user) + " 1");
        write_text("/proc/self/gid_map", "0 " + std::to_string(group) + " 1");
    }
    if (mount(nullptr, "/", nullptr, MS_REC | MS_PRIVATE, nullptr) == 0) return {};
    // EINVAL: in a chroot / is no mount of its own, and others would see the disk.
    return errno == EPERM || errno == EACCES || errno == EINVAL ? kNotAllowed
                                                                : std::strerror(errno);
}

/// A disk of `pages` pages, a tmpfs, given to `body` as a folder.
template <typename Body>
std::string with_small_disk(int pages, Body body) {
    const TempFolder folder;
    const auto mount_disk = [&]() -> std::string {
        if (std::string reason = enter_own_mounts(); !reason.empty()) return reason;
        const std::string options = "size=" + std::to_string(pages * 4096) + ",mode=0700";
        if (mount("tmpfs", folder.path().c_str(), "tmpfs", 0, options.c_str()) == 0) return {};
        return errno == EPERM || errno == EACCES ? kNotAllowed : std::strerror(errno);
    };
    return in_process(mount_disk, [&] { return body(folder.path()); });
}

class FaultTest : public ::testing::TestWithParam<const char*> {};

// Every size of disk up to what some shards need: each write of the whole chain meets the end of
// the disk once. Files of limited size are another way to the same; where mounting is not allowed
// they stand in for the disks, in as many sizes.
TEST_P(FaultTest, FullDiskIsNamedAndNothingIsLost) {
    const std::string kind = GetParam();
    bool has_disks = true;
    for (int pages = 1; pages < 60 && has_disks; ++pages) {
        const std::string said = with_small_disk(pages, [&](const fs::path& disk) {
            const fs::path folder = disk / "data";
            return write_until_full(kind + ":" + folder.string(), folder,
                                    "No space left on device");
        });
        has_disks = said != kNotAllowed;
        EXPECT_EQ(has_disks ? said : "", "") << "a disk of " << pages << " pages";
    }
    std::vector<rlim_t> limits{0, 100, 700, 1500, 3000, 5000, 7000, 12000};
    if (!has_disks) {
        std::printf("%s: files of 59 limited sizes instead of disks\n", kNotAllowed);
        for (rlim_t limit = 200; limit <= 11800; limit += 200) limits.push_back(limit);
    }
    for (const rlim_t limit : limits) {
        const TempFolder place;
        const fs::path folder = place / "data";
        EXPECT_EQ(with_file_limit(limit,
                                  [&] {
                                      return write_until_full(kind + ":" + folder.string(), folder,
                                                              "File too large");
                                  }),
                  "")
            << "files of at most " << limit << " bytes";
    }
}

TEST_P(FaultTest, RunGoesOnWhenThereIsSpaceAgain) {
    const std::string kind = GetParam();
    const TempFolder place;
    const fs::path folder = place / "data";
    const std::string uri = kind + ":" + folder.string();
    EXPECT_EQ(
        with_file_limit(9000, [&] { return write_until_full(uri, folder, "File too large"); }), "");
    StageOptions options = small_options();
    options.resume = true;
    write_data_set(uri, 20, options);
    EXPECT_EQ(check_data_set(uri, 20), "");
}

TEST_P(FaultTest, PlacesThatCannotBeMadeAreNamed) {
    const std::string kind = GetParam();
    for (const std::string path : {"/proc/nothing/data", "/dev/null/data"}) {
        try {
            Stage stage(kind + ":" + path, small_options());
            FAIL() << path;
        } catch (const Error& error) {
            EXPECT_NE(std::string(error.what()).find(path.substr(0, 9)), std::string::npos)
                << error.what();
        }
    }
}

// A folder pulled away in the middle: an error, no crash, no hang.
TEST_P(FaultTest, AFolderThatDisappearsIsAnError) {
    const std::string kind = GetParam();
    const TempFolder place;
    const fs::path folder = place / "data";
    Stage stage(kind + ":" + folder.string(), small_options());
    publish_frames(stage, 0, 4);
    stage.flush();
    fs::remove_all(folder);
    EXPECT_THROW(
        {
            publish_frames(stage, 4, 40);
            stage.close();
        },
        RunError);
}

INSTANTIATE_TEST_SUITE_P(Kinds, FaultTest, ::testing::Values("bp", "exr"),
                         [](const auto& info) { return std::string(info.param); });

TEST(Fault, LoneFilesAreWholeOrAbsentOnAFullDisk) {
    const TempFolder folder;
    const std::string said = with_file_limit(2000, [&]() -> std::string {
        Frame frame = make_frame(FrameSchema::of_known(64, 64, {"color"}));
        fill(frame, 0);
        try {
            write_exr(frame, (folder / "a.exr").string());
            return "written";
        } catch (const RunError& error) {
            if (std::string(error.what()).find("File too large") == std::string::npos)
                return error.what();
        }
        Trace trace;
        for (int i = 0; i < 100; ++i) trace.span("x", {}, {});
        try {
            trace.write((folder / "trace.json").string());
            return "written";
        } catch (const RunError&) {
            return "";
        }
    });
    EXPECT_EQ(said, "");
    EXPECT_TRUE(list_files(folder.path()).empty());
}

TEST(Fault, MemoryThatCannotBeHadIsARunError) {
    struct NoMemory final : ArenaAllocator {
        std::unique_ptr<Arena> allocate_arena(size_t, int) override { throw RunError("no memory"); }
    } none;
    const TempFolder place;
    EXPECT_THROW(Stage(none, "bp:" + (place / "data").string(), small_options()), RunError);
    EXPECT_FALSE(fs::exists(place / "data"));
}

}  // namespace
}  // namespace pave::test
