// bp: data sets: what is written is read back bit by bit.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

TEST(Bp, RoundTrip) {
    const TempFolder folder;
    const std::string uri = "bp:" + (folder / "data.bp").string();
    write_data_set(uri, 10);
    EXPECT_EQ(check_data_set(uri, 10), "");
}

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

}  // namespace
}  // namespace pave::test
