// Slots: where they lie, who may reuse them and when.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/ring.h"

#include <gtest/gtest.h>

#include <atomic>
#include <optional>
#include <set>
#include <thread>

#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

TEST(Ring, SlotsAreOneAlignedContiguousArena) {
    Stage stage("mem:", small_options());
    std::vector<Frame> frames;
    for (int i = 0; i < 4; ++i) frames.push_back(stage.acquire());
    std::set<const std::byte*> addresses;
    for (const Frame& frame : frames) {
        const Slot& slot = *frame.slot();
        EXPECT_EQ(slot.arena, frames[0].slot()->arena);
        EXPECT_EQ(slot.data, slot.arena->data() +
                                 static_cast<size_t>(slot.index) * stage.schema().slot_byte_size());
        addresses.insert(slot.data);
        for (const Channel& channel : stage.schema().channels())
            EXPECT_EQ(
                reinterpret_cast<uintptr_t>(frame.channel(channel.name).data()) % kChannelAlignment,
                0u);
    }
    EXPECT_EQ(addresses.size(), 4u);
}

TEST(Ring, SlotReturnsWhenItsLastFrameGoes) {
    StageOptions options = small_options();
    options.slots = 1;
    options.timeout = std::chrono::milliseconds(20);
    Stage stage("mem:", options);
    Frame frame = stage.acquire();
    std::optional<Frame> copy = frame;
    const std::byte* address = frame.slot()->data;
    frame = {};
    EXPECT_THROW(stage.acquire(), RunError);
    copy.reset();
    EXPECT_EQ(stage.acquire().slot()->data, address);
}

TEST(Ring, AcquiredButUnpublishedFramesAreNoFrames) {
    Stage stage("mem:", small_options());
    for (int i = 0; i < 20; ++i) stage.acquire();
    publish_frames(stage, 0, 1);
    stage.close();
    EXPECT_EQ(stage.published(), 1);
}

TEST(Ring, FrameOutlivesItsStage) {
    Frame frame;
    {
        Stage stage("mem:", small_options());
        frame = stage.acquire();
        fill(frame, 5);
        stage.publish(frame);
    }
    EXPECT_EQ(difference(frame, 5), "");
}

TEST(Ring, SlotIsNotReusedWhileAFrameLives) {
    StageOptions options = small_options();
    options.slots = 3;
    Stage stage("mem:", options);
    Frame held = stage.acquire();
    fill(held, 0);
    stage.publish(held);
    for (int64_t index = 1; index < 200; ++index) {
        Frame frame = stage.acquire();
        ASSERT_NE(frame.slot()->data, held.slot()->data);
        fill(frame, index);
        stage.publish(std::move(frame));
    }
    EXPECT_EQ(difference(held, 0), "");
}

TEST(Ring, AWakeUpBeforeTheWaitIsNotLost) {
    // A sink that fails while acquire looks for a slot must not leave it waiting for its time-out.
    const auto ring =
        std::make_shared<Ring>(host_memory(), FrameSchema::of_known(4, 4, {"depth"}), 1);
    const Frame held = ring->try_acquire();
    ring->wake();
    EXPECT_FALSE(ring->try_acquire());
    const auto begin = Ring::Clock::now();
    ring->wait_for_free(begin + std::chrono::seconds(20));
    EXPECT_LT(Ring::Clock::now() - begin, std::chrono::seconds(10));
    const auto again = Ring::Clock::now();
    ring->wait_for_free(again + std::chrono::milliseconds(50));  // woken once, not for ever
    EXPECT_GE(Ring::Clock::now() - again, std::chrono::milliseconds(50));
}

// One producer, three readers that take, check and hold frames for a while: every frame comes once,
// whole, in order for each reader, while the slots are reused hundreds of times.
TEST(Ring, StressUnderThreads) {
    constexpr int64_t kFrames = 1500;
    StageOptions options = small_options();
    options.slots = 6;
    options.width = options.height = 4;
    Stage stage("mem:stress", options);
    std::atomic<int64_t> taken{0}, sum{0};
    std::atomic<int> errors{0};
    std::vector<std::thread> readers;
    for (int i = 0; i < 3; ++i)
        readers.emplace_back([&] {
            const auto source = Source::open("mem:stress");
            Frame held;
            int64_t last = -1;
            while (Frame frame = source->next(std::chrono::seconds(20))) {
                const int64_t index = frame.metadata().index;
                if (index <= last || !difference(frame, index).empty()) ++errors;
                if (held && !difference(held, last).empty()) ++errors;
                last = index;
                sum += index;
                ++taken;
                held = std::move(frame);
            }
        });
    publish_frames(stage, 0, kFrames);
    stage.close();
    for (std::thread& reader : readers) reader.join();
    EXPECT_EQ(errors, 0);
    EXPECT_EQ(taken, kFrames);
    EXPECT_EQ(sum, kFrames * (kFrames - 1) / 2);
}

}  // namespace
}  // namespace pave::test
