// mem: frames shared inside the process, without a copy.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <optional>
#include <thread>

#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

using std::chrono::milliseconds;

TEST(Mem, SourceSeesTheVerySlot) {
    Stage stage("mem:very-slot", small_options());
    Frame frame = stage.acquire();
    fill(frame, 0);
    const std::byte* address = frame.slot()->data;
    stage.publish(std::move(frame));
    stage.flush();
    const auto source = Source::open("mem:very-slot");
    ASSERT_EQ(source->frame_count(), 1);
    EXPECT_EQ(source->read(0).slot()->data, address);
    EXPECT_EQ(difference(source->read(0), 0), "");
}

TEST(Mem, EveryPublishedFrameIsSeen) {
    Stage stage("mem:all", small_options());
    publish_frames(stage, 0, 4);
    stage.flush();
    EXPECT_FALSE(Source::open("mem:all")->finished());
    EXPECT_EQ(check_data_set("mem:all", 4), "");
    stage.close();
    EXPECT_TRUE(Source::open("mem:all")->finished());
    EXPECT_EQ(check_data_set("mem:all", 4), "");
}

TEST(Mem, FramesKeepTheirSlotsUntilTaken) {
    StageOptions options = small_options();
    options.timeout = milliseconds(50);
    Stage stage("mem:retained", options);
    publish_frames(stage, 0, 4);
    stage.flush();
    EXPECT_THROW(stage.acquire(), RunError);
    const auto source = Source::open("mem:retained");
    EXPECT_EQ(difference(source->next(milliseconds(0)), 0), "");
    EXPECT_TRUE(stage.acquire());
    EXPECT_EQ(source->frame_count(), 3);
    EXPECT_EQ(difference(source->read(0), 1), "");
    EXPECT_THROW(source->read(3), UsageError);
    EXPECT_THROW(source->metadata(-1), UsageError);
}

TEST(Mem, NextWaitsWithADeadlineAndEndsWithTheStage) {
    std::optional<Stage> stage(std::in_place, "mem:stream", small_options());
    const auto source = Source::open("mem:stream");
    EXPECT_THROW(source->next(milliseconds(20)), PeerError);
    std::thread producer([&] {
        std::this_thread::sleep_for(milliseconds(30));
        publish_frames(*stage, 0, 2);
        stage->close();
    });
    EXPECT_EQ(difference(source->next(std::chrono::seconds(10)), 0), "");
    EXPECT_EQ(difference(source->next(std::chrono::seconds(10)), 1), "");
    EXPECT_FALSE(source->next(std::chrono::seconds(10)));
    producer.join();
}

TEST(Mem, DropOldestKeepsTheNewestWindow) {
    StageOptions options = small_options();
    options.policy = QueuePolicy::kDropOldest;
    Stage stage("mem:window", options);
    publish_frames(stage, 0, 30);
    stage.flush();
    const auto source = Source::open("mem:window");
    const int64_t count = source->frame_count();
    EXPECT_GE(count, 3);
    // The newest ones in their order. The one that is on its way to the store cannot be dropped, so
    // a newer one may have had to go in its place.
    int64_t last = 30 - options.slots - 2;
    for (int64_t i = 0; i < count; ++i) {
        const Frame frame = source->read(i);
        const int64_t index = frame.metadata().index;
        EXPECT_GT(index, last);
        EXPECT_EQ(difference(frame, index), "");
        last = index;
    }
    EXPECT_EQ(last, 29);
    EXPECT_EQ(stage.dropped(), 30 - count);
    EXPECT_EQ(stage.published(), stage.acknowledged() + stage.dropped());
}

TEST(Mem, DropOldestTakesAFrameWhenItsReadersLetGo) {
    StageOptions options = small_options();
    options.policy = QueuePolicy::kDropOldest;
    options.timeout = std::chrono::seconds(10);
    Stage stage("mem:held", options);
    publish_frames(stage, 0, 4);
    stage.flush();
    auto held = Source::open("mem:held")->read_all();
    ASSERT_EQ(held.size(), 4u);
    std::thread reader([&] {
        std::this_thread::sleep_for(milliseconds(100));
        held.clear();  // no slot comes free by that: the store has them all
    });
    const auto begin = std::chrono::steady_clock::now();
    EXPECT_TRUE(stage.acquire());
    EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(5));
    reader.join();
}

TEST(Mem, ReadAllIsOfOneMoment) {
    constexpr int64_t kFrames = 3000;
    StageOptions options = small_options();
    options.width = options.height = 4;
    options.slots = kFrames;
    Stage stage("mem:moment", options);
    publish_frames(stage, 0, kFrames);
    stage.close();
    const auto source = Source::open("mem:moment");
    std::thread taker([] {
        const auto other = Source::open("mem:moment");
        while (other->next(std::chrono::seconds(20))) continue;
    });
    int partial = 0;
    for (std::vector<Frame> frames; source->frame_count() > 0;) {
        frames = source->read_all();
        for (size_t i = 0; i < frames.size(); ++i)
            partial +=
                frames[i].metadata().index != kFrames - static_cast<int64_t>(frames.size() - i);
    }
    taker.join();
    EXPECT_EQ(partial, 0);
}

TEST(Mem, TwoStagesOfOneNameAreRefused) {
    std::optional<Stage> first(std::in_place, "mem:twice", small_options());
    EXPECT_THROW(Stage("mem:twice", small_options()), UsageError);
    first->close();
    EXPECT_NO_THROW(Stage("mem:twice", small_options()));
}

TEST(Mem, StoreDisappearsWithItsLastHolder) {
    EXPECT_THROW(Source::open("mem:gone"), UsageError);
    std::unique_ptr<Source> source;
    {
        Stage stage("mem:gone", small_options());
        publish_frames(stage, 0, 2);
        stage.close();
        source = Source::open("mem:gone");
    }
    EXPECT_EQ(difference(source->read(1), 1), "");  // the source holds it now
    EXPECT_EQ(check_data_set("mem:gone", 2), "");
    source.reset();
    EXPECT_THROW(Source::open("mem:gone"), UsageError);
}

TEST(Mem, WithoutANameNothingIsRetained) {
    Stage stage("mem:", small_options());
    publish_frames(stage, 0, 100);
    stage.close();
    EXPECT_EQ(stage.acknowledged(), 100);
    EXPECT_THROW(Source::open("mem:"), UsageError);
}

TEST(Mem, AbandonedStageIsNotFinished) {
    Stage stage("mem:abandoned", small_options());
    publish_frames(stage, 0, 1);
    stage.abandon();
    const auto source = Source::open("mem:abandoned");
    EXPECT_FALSE(source->finished());
    EXPECT_TRUE(source->next(milliseconds(0)));
    EXPECT_FALSE(source->next(milliseconds(0)));
}

}  // namespace
}  // namespace pave::test
