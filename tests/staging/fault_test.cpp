// Places that cannot be written: full disks, limits, missing rights. One clear error, acknowledged
// frames stay readable.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>

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

/// A tmpfs of `pages` pages, or nothing where mounting is not allowed.
class SmallDisk {
   public:
    explicit SmallDisk(int pages) {
        const std::string options = "size=" + std::to_string(pages * 4096) + ",mode=0700";
        is_mounted_ = mount("tmpfs", folder_.path().c_str(), "tmpfs", 0, options.c_str()) == 0;
    }
    ~SmallDisk() {
        if (is_mounted_) umount2(folder_.path().c_str(), MNT_DETACH);
    }
    bool is_mounted() const { return is_mounted_; }
    fs::path operator/(const std::string& name) const { return folder_ / name; }

   private:
    const TempFolder folder_;
    bool is_mounted_ = false;
};

/// Runs `body` in a process of its own whose files may not grow beyond `byte_size`; its exit status
/// and words come back.
template <typename Body>
std::string with_file_limit(rlim_t byte_size, Body body) {
    int ends[2];
    if (pipe(ends) != 0) return "pipe failed";
    const pid_t pid = fork();
    if (pid == 0) {
        signal(SIGXFSZ, SIG_IGN);
        const rlimit limit{byte_size, byte_size};
        setrlimit(RLIMIT_FSIZE, &limit);
        const std::string text = body();
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

class FaultTest : public ::testing::TestWithParam<const char*> {};

// Every size of disk up to what some shards need: each write of the whole chain meets the end of
// the disk once. Where mounting is not allowed the files' size is limited instead.
TEST_P(FaultTest, FullDiskIsNamedAndNothingIsLost) {
    const std::string kind = GetParam();
    if (SmallDisk(1).is_mounted()) {
        for (int pages = 1; pages < 60; ++pages) {
            const SmallDisk disk(pages);
            const fs::path folder = disk / "data";
            EXPECT_EQ(
                write_until_full(kind + ":" + folder.string(), folder, "No space left on device"),
                "")
                << "a disk of " << pages << " pages";
        }
    }
    for (const rlim_t limit : {0, 100, 700, 1500, 3000, 5000, 7000, 12000}) {
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
