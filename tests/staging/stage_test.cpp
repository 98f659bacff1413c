// The stage's promises towards its producer: order, policies, deadlines, and errors that come back
// from the background.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <chrono>
#include <limits>
#include <numeric>
#include <optional>
#include <thread>

#include "pave/hash.h"
#include "tests/staging/helpers.h"
#include "tests/staging/test_sinks.h"

namespace pave::test {
namespace {

using std::chrono::milliseconds;

struct StageTest : ::testing::Test {
    Stage make_stage(StageOptions options = small_options()) {
        return Stage(host_memory(), std::make_unique<TestSink>(control), std::move(options));
    }
    void TearDown() override {
        control->set_stuck(false);
        EXPECT_TRUE(control->wait_until_destroyed());  // a thread that was left behind ends here
    }
    std::shared_ptr<SinkControl> control = std::make_shared<SinkControl>();
};

template <typename Call>
std::string error_of(Call call) {
    try {
        call();
        return "no error";
    } catch (const Error& error) {
        return error.what();
    }
}

bool has(const std::string& text, const std::string& part) {
    return text.find(part) != std::string::npos;
}

double seconds_since(std::chrono::steady_clock::time_point begin) {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

TEST_F(StageTest, FramesReachTheSinkInOrder) {
    Stage stage = make_stage();
    publish_frames(stage, 0, 50);
    stage.close();
    std::vector<int64_t> expected(50);
    std::iota(expected.begin(), expected.end(), 0);
    EXPECT_EQ(control->indices(), expected);
    EXPECT_EQ(stage.published(), 50);
    EXPECT_EQ(stage.acknowledged(), 50);
    EXPECT_EQ(stage.dropped(), 0);
    EXPECT_TRUE(control->finished);
}

TEST_F(StageTest, ChecksumsAreOfTheBytesAsPublished) {
    Stage stage = make_stage();
    Frame frame = stage.acquire();
    fill(frame, 3);
    std::vector<std::string> expected;
    for (const Channel& channel : frame.schema().channels())
        expected.push_back(hash_hex(std::as_bytes(frame.channel(channel.name))));
    stage.publish(std::move(frame));
    stage.flush();
    ASSERT_EQ(control->seen.size(), 1u);
    EXPECT_EQ(control->seen[0].channel_hashes, expected);
}

TEST_F(StageTest, PublishReturnsWhileTheSinkIsStuck) {
    control->set_stuck(true);
    Stage stage = make_stage();
    const auto begin = std::chrono::steady_clock::now();
    publish_frames(stage, 0, 4);  // all four slots
    EXPECT_LT(seconds_since(begin), 2.0);
    control->set_stuck(false);
}

TEST_F(StageTest, BlockPolicyWaitsForTheSlowSinkAndLosesNothing) {
    control->delay_ms = 5;
    Stage stage = make_stage();
    publish_frames(stage, 0, 20);
    stage.close();
    EXPECT_EQ(control->indices().size(), 20u);
}

TEST_F(StageTest, BlockPolicyEndsAtTheDeadlineAndNamesTheHolders) {
    control->set_stuck(true);
    StageOptions options = small_options();
    options.timeout = milliseconds(200);
    Stage stage = make_stage(options);
    publish_frames(stage, 0, 2);
    ASSERT_TRUE(control->wait_for_entries(1));
    const Frame mine = stage.acquire();
    const Frame also_mine = stage.acquire();
    const auto begin = std::chrono::steady_clock::now();
    const std::string error = error_of([&] { stage.acquire(); });
    EXPECT_GE(seconds_since(begin), 0.19);
    EXPECT_LT(seconds_since(begin), 3.0);
    for (const char* part :
         {"no free slot", "200 ms", "test:sink", "2 with the producer",
          "1 waiting for test:sink (frame 1)", "1 being taken by test:sink (frame 0)"})
        EXPECT_TRUE(has(error, part)) << part << " is not in: " << error;
    control->set_stuck(false);
}

TEST_F(StageTest, DeadlineNamesFramesThatReadersHold) {
    StageOptions options = small_options();
    options.timeout = milliseconds(50);
    Stage stage = make_stage(options);
    std::vector<Frame> held;
    for (int64_t index = 0; index < 4; ++index) {
        Frame frame = stage.acquire();
        fill(frame, index);
        held.push_back(frame);
        stage.publish(std::move(frame));
    }
    stage.flush();
    const std::string error = error_of([&] { stage.acquire(); });
    EXPECT_TRUE(has(error, "4 held by readers (frames 0, 1, 2, 3)")) << error;
}

TEST_F(StageTest, DropOldestNeverWaitsAndCounts) {
    control->set_stuck(true);
    StageOptions options = small_options();
    options.policy = QueuePolicy::kDropOldest;
    Stage stage = make_stage(options);
    publish_frames(stage, 0, 1);
    ASSERT_TRUE(control->wait_for_entries(1));
    const auto begin = std::chrono::steady_clock::now();
    publish_frames(stage, 1, 20);
    EXPECT_LT(seconds_since(begin), 2.0);
    EXPECT_EQ(stage.dropped(), 16);
    control->set_stuck(false);
    stage.close();
    // Frame 0 was in the sink already; of the others the newest three are there.
    EXPECT_EQ(control->indices(), (std::vector<int64_t>{0, 17, 18, 19}));
    EXPECT_EQ(stage.published(), stage.acknowledged() + stage.dropped());
}

TEST_F(StageTest, DropNewestNeverWaitsAndCounts) {
    control->set_stuck(true);
    StageOptions options = small_options();
    options.policy = QueuePolicy::kDropNewest;
    Stage stage = make_stage(options);
    const auto begin = std::chrono::steady_clock::now();
    publish_frames(stage, 0, 20);
    EXPECT_LT(seconds_since(begin), 2.0);
    EXPECT_EQ(stage.dropped(), 17);
    control->set_stuck(false);
    stage.close();
    EXPECT_EQ(control->indices(), (std::vector<int64_t>{0, 1, 2}));
    EXPECT_EQ(stage.published(), stage.acknowledged() + stage.dropped());
}

TEST_F(StageTest, PublishTellsWhetherTheFrameWasDropped) {
    control->set_stuck(true);
    StageOptions options = small_options();
    options.slots = 2;
    options.policy = QueuePolicy::kDropNewest;
    Stage stage = make_stage(options);
    for (int64_t index = 0; index < 3; ++index) {
        Frame frame = stage.acquire();
        fill(frame, index);
        EXPECT_EQ(stage.publish(std::move(frame)), index == 0);
    }
    control->set_stuck(false);
}

TEST_F(StageTest, DropOldestSparesFramesThatSomebodyHolds) {
    control->set_stuck(true);
    StageOptions options = small_options();
    options.policy = QueuePolicy::kDropOldest;
    Stage stage = make_stage(options);
    publish_frames(stage, 0, 1);
    ASSERT_TRUE(control->wait_for_entries(1));
    Frame held = stage.acquire();
    fill(held, 1);
    stage.publish(held);
    publish_frames(stage, 2, 10);
    control->set_stuck(false);
    stage.close();
    EXPECT_EQ(control->indices(), (std::vector<int64_t>{0, 1, 8, 9}));
    EXPECT_EQ(difference(held, 1), "");
}

TEST_F(StageTest, DeadSinkIsNamedAtAcquireFlushAndClose) {
    control->fail_at = 2;
    Stage stage = make_stage();
    publish_frames(stage, 0, 3);
    const std::string expected = "test:sink: frame 2: the disk is on fire";
    EXPECT_EQ(error_of([&] { stage.flush(); }), expected);
    EXPECT_EQ(error_of([&] { stage.acquire(); }), expected);
    EXPECT_EQ(error_of([&] { stage.flush(); }), expected);
    EXPECT_EQ(error_of([&] { stage.close(); }), expected);
    EXPECT_EQ(error_of([&] { stage.close(); }), "no error");
    EXPECT_EQ(stage.acknowledged(), 2);
    EXPECT_EQ(control->abandons, 1);
    EXPECT_EQ(control->closes, 0);
}

TEST_F(StageTest, DeadSinkHangsNobody) {
    control->fail_at = 0;
    Stage stage = make_stage();
    const auto begin = std::chrono::steady_clock::now();
    // However the failure falls, the producer is told within a few frames.
    EXPECT_TRUE(has(error_of([&] { publish_frames(stage, 0, 1000); }), "the disk is on fire"));
    EXPECT_LT(seconds_since(begin), 5.0);
}

TEST_F(StageTest, FlushAndCloseHaveADeadline) {
    control->set_stuck(true);
    StageOptions options = small_options();
    options.timeout = milliseconds(100);
    std::optional<Stage> stage(make_stage(options));
    publish_frames(*stage, 0, 2);
    ASSERT_TRUE(control->wait_for_entries(1));
    const std::string error = error_of([&] { stage->flush(); });
    for (const char* part : {"flush of test:sink", "100 ms", "frame 0 is being written"})
        EXPECT_TRUE(has(error, part)) << part << " is not in: " << error;
    EXPECT_TRUE(has(error_of([&] { stage->close(); }), "close of test:sink"));
    const auto begin = std::chrono::steady_clock::now();
    stage.reset();
    EXPECT_LT(seconds_since(begin), 2.0);
    control->set_stuck(false);
}

TEST_F(StageTest, ProgressPutsTheDeadlineOff) {
    control->delay_ms = 60;
    StageOptions options = small_options();
    options.timeout = milliseconds(150);
    Stage stage = make_stage(options);
    publish_frames(stage, 0, 4);
    stage.close();  // 240 ms of work, never 150 ms without a frame done
    EXPECT_EQ(stage.acknowledged(), 4);
}

TEST_F(StageTest, FlushCoversWhatWasPublishedBefore) {
    control->delay_ms = 20;
    Stage stage = make_stage();
    publish_frames(stage, 0, 3);
    stage.flush();
    EXPECT_EQ(stage.acknowledged(), 3);
    EXPECT_EQ(control->flushes, 1);
    stage.close();
    EXPECT_EQ(error_of([&] { stage.flush(); }), "the stage of test:sink is closed");
    EXPECT_EQ(error_of([&] { stage.acquire(); }), "the stage of test:sink is closed");
}

TEST_F(StageTest, DestructorCloses) {
    {
        Stage stage = make_stage();
        publish_frames(stage, 0, 3);
    }
    EXPECT_EQ(control->indices().size(), 3u);
    EXPECT_TRUE(control->finished);
}

TEST_F(StageTest, DestructorLogsWhatWentWrong) {
    control->fail_at = 1;
    ::testing::internal::CaptureStderr();
    {
        Stage stage = make_stage();
        publish_frames(stage, 0, 2);
    }
    EXPECT_EQ(::testing::internal::GetCapturedStderr(),
              "pave: test:sink: frame 1: the disk is on fire\n");
}

TEST_F(StageTest, AnExceptionDoesNotFinishTheDataSet) {
    try {
        Stage stage = make_stage();
        publish_frames(stage, 0, 2);
        throw std::runtime_error("the renderer failed");
    } catch (const std::runtime_error&) {
    }
    EXPECT_EQ(control->indices().size(), 2u);
    EXPECT_EQ(control->closes, 1);
    EXPECT_FALSE(control->finished);
}

TEST_F(StageTest, AbandonKeepsFramesButDoesNotFinish) {
    Stage stage = make_stage();
    publish_frames(stage, 0, 2);
    stage.abandon();
    EXPECT_EQ(control->indices().size(), 2u);
    EXPECT_FALSE(control->finished);
}

TEST_F(StageTest, MovedStageGoesOn) {
    Stage first = make_stage();
    publish_frames(first, 0, 2);
    Stage second = std::move(first);
    publish_frames(second, 2, 4);
    second.close();
    EXPECT_EQ(control->indices(), (std::vector<int64_t>{0, 1, 2, 3}));
}

TEST_F(StageTest, PublishRefusesFramesThatAreNotItsOwn) {
    Stage stage = make_stage();
    EXPECT_TRUE(has(error_of([&] { stage.publish({}); }), "publish takes a frame"));
    EXPECT_TRUE(
        has(error_of([&] { stage.publish(make_frame(stage.schema())); }), "publish takes a frame"));
    Frame frame = stage.acquire();
    fill(frame, 0);
    stage.publish(frame);
    EXPECT_TRUE(has(error_of([&] { stage.publish(frame); }), "publish takes a frame"));
}

TEST_F(StageTest, PublishRefusesBadMetadata) {
    Stage stage = make_stage();
    publish_frames(stage, 0, 5);
    Frame frame = stage.acquire();
    EXPECT_EQ(frame.metadata().index, 5);
    fill(frame, 4);
    EXPECT_TRUE(has(error_of([&] { stage.publish(frame); }), "frame number 4 is not above"));
    fill(frame, 7);
    frame.metadata().view.fov_x_degrees = std::numeric_limits<float>::quiet_NaN();
    EXPECT_TRUE(has(error_of([&] { stage.publish(frame); }), "the view is not finite"));
    fill(frame, 7);
    frame.metadata().scene = "\xFF\xFE";
    EXPECT_TRUE(has(error_of([&] { stage.publish(frame); }), "'scene' is not UTF-8"));
    fill(frame, 7);  // a gap is allowed
    stage.publish(std::move(frame));
    stage.close();
    EXPECT_EQ(control->indices().back(), 7);
}

TEST_F(StageTest, AcquireGivesFreshMetadata) {
    StageOptions options = small_options();
    options.slots = 1;
    Stage stage = make_stage(options);
    publish_frames(stage, 0, 1);
    const Frame frame = stage.acquire();
    EXPECT_EQ(frame.metadata().index, 1);
    EXPECT_EQ(frame.metadata().scene, "");
    EXPECT_EQ(frame.metadata().seconds_spent, 0.0);
}

TEST(StageOptionsTest, OutOfRangeIsAUsageError) {
    const auto refused = [](auto change) {
        StageOptions options = small_options();
        change(options);
        try {
            Stage stage("mem:", options);
            return false;
        } catch (const UsageError&) {
            return true;
        }
    };
    EXPECT_TRUE(refused([](StageOptions& o) { o.slots = 0; }));
    EXPECT_TRUE(refused([](StageOptions& o) { o.slots = 65537; }));
    EXPECT_TRUE(refused([](StageOptions& o) { o.width = 0; }));
    EXPECT_TRUE(refused([](StageOptions& o) { o.height = 20000; }));
    EXPECT_TRUE(refused([](StageOptions& o) { o.channels = {"colour"}; }));
    EXPECT_TRUE(refused([](StageOptions& o) { o.channels = {"color", "color"}; }));
    EXPECT_TRUE(refused([](StageOptions& o) { o.channels.clear(); }));
    EXPECT_TRUE(refused([](StageOptions& o) { o.timeout = milliseconds(-1); }));
    EXPECT_TRUE(refused([](StageOptions& o) { o.frames_per_shard = 0; }));
    EXPECT_TRUE(refused([](StageOptions& o) {
        o.policy = QueuePolicy::kDropOldest;
        o.slots = 1;
    }));
    EXPECT_TRUE(refused([](StageOptions& o) {
        o.width = o.height = 16384;
        o.slots = 65536;
    }));
    EXPECT_FALSE(refused([](StageOptions&) {}));
}

TEST(UriTest, UnknownSchemesAndBadNamesAreUsageErrors) {
    for (const char* uri : {"", "cornell", "foo:bar", "shm:x", "bp:", "exr:", "mem:../x", "mem:a/b",
                            "mem:.hidden", "mem:a b"}) {
        EXPECT_THROW(Stage(uri, small_options()), UsageError) << uri;
        EXPECT_THROW(Source::open(uri), UsageError) << uri;
    }
    EXPECT_TRUE(has(error_of([] { Source::open("sst:x"); }),
                    "unknown scheme 'sst:' in 'sst:x'; known are mem:NAME, bp:PATH and exr:DIR"));
}

}  // namespace
}  // namespace pave::test
