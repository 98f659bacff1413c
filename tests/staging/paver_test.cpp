// The papers' facade: initialize, save, flush.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/paver.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

/// Data sets by plain name go to the working folder.
struct PaverTest : ::testing::Test {
    void SetUp() override { fs::current_path(folder.path()); }
    void TearDown() override { fs::current_path(before); }
    const fs::path before = fs::current_path();
    const TempFolder folder;
};

TEST_F(PaverTest, ThePapersListing) {
    constexpr int width = 256;
    constexpr int height = 256;
    std::vector<float> image(width * height);
    for (size_t i = 0; i < image.size(); ++i) image[i] = static_cast<float>(i) - 1000.5f;
    Paver paver("TrainingSetName");
    paver.save("varName", width, height, image);
    paver.flush();
    const auto source = Source::open("bp:TrainingSetName.bp", true);
    ASSERT_EQ(source->frame_count(), 1);
    const Frame frame = source->read(0);
    EXPECT_EQ(frame.schema().channels(), (std::vector<Channel>{{"varName", 1}}));
    EXPECT_TRUE(std::equal(image.begin(), image.end(), frame.channel("varName").begin()));
}

TEST_F(PaverTest, VectorsAreFreeOnReturn) {
    {
        Paver paver("cornell");
        for (int frame = 0; frame < 20; ++frame) {
            std::vector<double> albedo(2 * 3 * 3);
            for (size_t i = 0; i < albedo.size(); ++i)
                albedo[i] = frame * 100.0 + static_cast<double>(i);
            paver.save("albedo", 3, 2, albedo);
            std::fill(albedo.begin(), albedo.end(), -1.0);
            std::vector<uint8_t> mask(6, static_cast<uint8_t>(frame));
            if (frame % 2 == 0)
                paver.save("mask", 3, 2, std::span<const uint8_t>(mask));
            else
                paver.save("mask", 3, 2, std::span<uint8_t>(mask));
            std::fill(mask.begin(), mask.end(), uint8_t{0});
        }
    }
    const auto source = Source::open("bp:cornell.bp");  // the destructor closed it
    ASSERT_EQ(source->frame_count(), 20);
    for (int64_t index = 0; index < 20; ++index) {
        const Frame frame = source->read(index);
        EXPECT_EQ(frame.metadata().index, index);
        // Interleaved pixels became planes.
        for (size_t pixel = 0; pixel < 6; ++pixel)
            for (size_t plane = 0; plane < 3; ++plane)
                EXPECT_EQ(
                    frame.channel("albedo")[plane * 6 + pixel],
                    static_cast<float>(index) * 100.0f + static_cast<float>(pixel * 3 + plane));
        EXPECT_EQ(frame.channel("mask")[5], static_cast<float>(index));
    }
}

TEST_F(PaverTest, OrderOfNamesMayChangeFromFrameToFrame) {
    Paver paver("exr:set");
    const std::vector<float> one(4, 1.0f), two(4, 2.0f);
    paver.save("a", 2, 2, one);
    paver.save("b", 2, 2, two);
    paver.save("b", 2, 2, one);  // comes again: the first frame is complete
    paver.save("a", 2, 2, two);
    paver.close();
    const auto source = Source::open("exr:set");
    ASSERT_EQ(source->frame_count(), 2);
    EXPECT_EQ(source->read(1).channel("a")[0], 2.0f);
    EXPECT_EQ(source->read(1).channel("b")[0], 1.0f);
}

TEST_F(PaverTest, BadNamesAndSizesAreUsageErrors) {
    for (const char* name : {"", "a/b", "../x", "/tmp/x", ".hidden", "a b", "foo:x"})
        EXPECT_THROW(Paver{name}, UsageError) << name;
    Paver paver("set");
    const std::vector<float> values(4);
    EXPECT_THROW(paver.save("a/b", 2, 2, values), UsageError);
    EXPECT_THROW(paver.save("a", 0, 2, values), UsageError);
    EXPECT_THROW(paver.save("a", 3, 2, values), UsageError);
    EXPECT_THROW(paver.save("a", 2, 2, std::vector<float>{}), UsageError);
    paver.save("a", 2, 2, values);
    EXPECT_THROW(paver.save("b", 4, 1, values), UsageError);
    paver.flush();
    EXPECT_THROW(paver.save("c", 2, 2, values), UsageError);
    EXPECT_THROW(paver.save("a", 2, 2, std::vector<float>(8)), UsageError);
    paver.save("a", 2, 2, values);
    paver.close();
    EXPECT_EQ(Source::open("bp:set.bp")->frame_count(), 2);
}

TEST_F(PaverTest, ARefusedSaveDoesNotEndTheFrame) {
    const std::vector<float> four(4), eight(8);
    Paver paver("set");
    paver.save("a", 2, 2, four);
    EXPECT_THROW(paver.save("a", 4, 1, four), UsageError);
    EXPECT_THROW(paver.save("a", 2, 2, eight), UsageError);
    EXPECT_FALSE(fs::exists(folder / "set.bp"));
    paver.save("b", 2, 2, four);  // still the first frame
    paver.save("b", 2, 2, four);
    EXPECT_THROW(paver.save("b", 2, 2, eight), UsageError);
    paver.save("a", 2, 2, four);
    paver.close();
    EXPECT_EQ(Source::open("bp:set.bp")->frame_count(), 2);
}

TEST_F(PaverTest, IncompleteFramesAreErrorsAndNeverWritten) {
    const std::vector<float> values(4);
    {
        Paver paver("set");
        for (const char* name : {"a", "b", "a"}) paver.save(name, 2, 2, values);
        EXPECT_THROW(paver.flush(), UsageError);
        ::testing::internal::CaptureStderr();
    }
    EXPECT_EQ(::testing::internal::GetCapturedStderr(),
              "pave: the frame is not complete: 'b' was not saved\n");
    EXPECT_EQ(Source::open("bp:set.bp")->frame_count(), 1);
}

TEST_F(PaverTest, NothingIsMadeBeforeTheFirstFrame) {
    { Paver paver("set"); }
    EXPECT_FALSE(fs::exists(folder / "set.bp"));
}

TEST_F(PaverTest, ExistingDataAreNotOverwrittenButResumed) {
    const std::vector<float> values(4);
    {
        Paver paver("set");
        paver.save("a", 2, 2, values);
    }
    Paver again("set");
    again.save("a", 2, 2, values);
    EXPECT_THROW(again.flush(), UsageError);
    StageOptions options;
    options.resume = true;
    Paver resumed("set", options);
    resumed.save("a", 2, 2, values);
    resumed.close();
    EXPECT_EQ(Source::open("bp:set.bp")->frame_count(), 2);
    Paver moved = std::move(again);  // the frame that could not be written is dropped with it
    ::testing::internal::CaptureStderr();
    moved = Paver("other");
    EXPECT_NE(::testing::internal::GetCapturedStderr(), "");
}

}  // namespace
}  // namespace pave::test
