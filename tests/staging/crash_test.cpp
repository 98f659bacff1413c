// kill -9 of a writer at random moments: exactly the acknowledged frames remain, and a resumed run
// ends as an unbroken one.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <random>
#include <thread>

#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

constexpr int64_t kFrames = 40;
constexpr unsigned kSeed = 5;

/// PAVE_KILLS=50 makes this a longer run.
int kills() {
    const char* text = std::getenv("PAVE_KILLS");
    return text != nullptr ? std::atoi(text) : 12;
}

StageOptions resumed() {
    StageOptions options = small_options();
    options.resume = true;
    return options;
}

struct Child {
    pid_t pid;
    int announcements;  // read end: an int64 each time more frames were acknowledged
};

/// A writer in a process of its own. The parent has no other threads here, so that fork is safe.
Child start_writer(const std::string& uri, bool with_flush) {
    int ends[2];
    if (pipe(ends) != 0) throw std::runtime_error("pipe failed");
    const pid_t pid = fork();
    if (pid == 0) {
        int status = 1;
        try {
            Stage stage(uri, resumed());
            int64_t told = -1;
            const auto tell = [&] {
                const int64_t now = stage.acknowledged();
                if (now != told && write(ends[1], &now, sizeof now) == sizeof now) told = now;
            };
            for (int64_t index = stage.first_index(); index < kFrames; ++index) {
                tell();
                publish_frames(stage, index, index + 1);
                std::this_thread::sleep_for(std::chrono::milliseconds(1));
                if (with_flush && index % 11 == 10) stage.flush();
            }
            stage.close();
            tell();
            status = 0;
        } catch (const std::exception& error) {
            std::fprintf(stderr, "writer: %s\n", error.what());
        }
        _exit(status);
    }
    close(ends[1]);
    return {pid, ends[0]};
}

/// Kills the writer after `delay` and returns the last number of frames it announced; -1 if none.
/// `done`: it was faster.
int64_t kill_writer(const Child& child, std::chrono::microseconds delay, bool* done) {
    std::this_thread::sleep_for(delay);
    kill(child.pid, SIGKILL);
    int status = 0;
    waitpid(child.pid, &status, 0);
    *done = WIFEXITED(status);
    EXPECT_TRUE(!WIFEXITED(status) || WEXITSTATUS(status) == 0);
    int64_t announced = -1, value = 0;
    while (read(child.announcements, &value, sizeof value) == sizeof value) announced = value;
    close(child.announcements);
    return announced;
}

/// Frames that a reader sees; none if the writer did not come to make the folder.
int64_t check_survivors(const std::string& uri, const fs::path& folder) {
    if (!fs::exists(folder / "manifest.jsonl")) return 0;
    const auto source = Source::open(uri, true);
    EXPECT_EQ(check_data_set(uri, source->frame_count(), true), "");
    return source->frame_count();
}

void expect_same_files(const fs::path& whole, const fs::path& resumed_one) {
    EXPECT_EQ(list_files(whole), list_files(resumed_one));
    for (const std::string& name : list_files(whole))
        if (name != "timings.jsonl") {
            EXPECT_EQ(read_text(whole / name), read_text(resumed_one / name)) << name;
        }
}

void run_kills(const std::string& kind, int count, bool with_flush) {
    const TempFolder folder;
    const fs::path whole = folder / "whole";
    write_data_set(kind + ":" + whole.string(), kFrames);
    std::mt19937 random(kSeed);
    int64_t most = 0;
    for (int i = 0, set = 0; i < count; ++i) {
        const fs::path data = folder / ("data" + std::to_string(set));
        const std::string uri = kind + ":" + data.string();
        const std::chrono::microseconds delay(random() % 250000);
        bool done = false;
        const int64_t announced = kill_writer(start_writer(uri, with_flush), delay, &done);
        const std::string moment = "kill " + std::to_string(i) + " of " + std::to_string(count) +
                                   " after " + std::to_string(delay.count()) + " us, seed " +
                                   std::to_string(kSeed) + ", " + kind;
        const int64_t survivors = check_survivors(uri, data);
        // What was announced is there. Behind it no more can be than was in flight: the slots, the
        // open shard, one frame.
        EXPECT_GE(survivors, announced) << moment;
        EXPECT_LE(survivors, std::max<int64_t>(announced, most) + 8) << moment;
        most = std::max(most, survivors);
        if (done || i + 1 == count || survivors > kFrames / 2) {
            Stage stage(uri, resumed());
            EXPECT_EQ(stage.first_index(), survivors) << moment;
            publish_frames(stage, stage.first_index(), kFrames);
            stage.close();
            EXPECT_EQ(check_data_set(uri, kFrames), "") << moment;
            if (!with_flush) expect_same_files(whole, data);  // a flush ends its shard early
            EXPECT_EQ(Source::open(uri)->content_hash(),
                      Source::open(kind + ":" + whole.string())->content_hash());
            ++set;
            most = 0;
        }
    }
}

TEST(Crash, KilledBpWriterLeavesExactlyTheAcknowledgedFrames) { run_kills("bp", kills(), false); }
TEST(Crash, KilledBpWriterThatFlushesLosesNothing) { run_kills("bp", kills() / 2, true); }
TEST(Crash, KilledExrWriterLeavesExactlyTheAcknowledgedFrames) { run_kills("exr", kills(), false); }

}  // namespace
}  // namespace pave::test
