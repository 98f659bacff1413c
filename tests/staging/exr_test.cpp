// exr: one multi-layer file a frame, spelled as other programs expect it.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/exr.h"

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfIntAttribute.h>
#include <OpenEXR/ImfMatrixAttribute.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

struct ExrTest : ::testing::Test {
    std::string uri(const std::string& name) const { return "exr:" + (folder / name).string(); }
    Frame frame_of(const std::vector<std::string>& channels) const {
        Frame frame = make_frame(FrameSchema::of_known(7, 5, channels));
        fill(frame, 6);
        return frame;
    }
    const TempFolder folder;
};

const std::vector<std::string> kAllChannels{"color",    "albedo",   "direct",   "normal", "depth",
                                            "distance", "variance", "position", "object", "drawn"};

std::vector<std::string> channel_names(const fs::path& path) {
    Imf::InputFile file(path.c_str());
    std::vector<std::string> names;
    for (auto c = file.header().channels().begin(); c != file.header().channels().end(); ++c) {
        EXPECT_EQ(c.channel().type, Imf::FLOAT);
        names.emplace_back(c.name());
    }
    return names;
}

TEST_F(ExrTest, RoundTrip) {
    write_data_set(uri("data"), 5);
    EXPECT_EQ(check_data_set(uri("data"), 5), "");
    EXPECT_TRUE(fs::exists(folder / "data/frame-00000004.exr"));
}

TEST_F(ExrTest, EveryFrameIsAcknowledgedAlone) {
    Stage stage(uri("data"), small_options());
    publish_frames(stage, 0, 3);
    stage.flush();
    EXPECT_EQ(stage.acknowledged(), 3);
    EXPECT_EQ(check_data_set(uri("data"), 3, true), "");
}

TEST_F(ExrTest, ResumedRunEqualsAnUnbrokenOne) {
    write_data_set(uri("whole"), 4);
    {
        Stage stage(uri("data"), small_options());
        publish_frames(stage, 0, 2);
        stage.abandon();
    }
    write_text(folder / "data/.tmp-frame-00000002.exr", "half");
    write_text(folder / "data/frame-00000002.exr", "not acknowledged");
    StageOptions options = small_options();
    options.resume = true;
    write_data_set(uri("data"), 4, options);
    EXPECT_EQ(list_files(folder / "data"), list_files(folder / "whole"));
    for (const std::string& name : list_files(folder / "whole"))
        if (name != "timings.jsonl") {
            EXPECT_EQ(read_text(folder / "data" / name), read_text(folder / "whole" / name))
                << name;
        }
}

TEST_F(ExrTest, LayerNamesFollowTheSpelling) {
    const Frame frame = frame_of(kAllChannels);
    for (const char* names : {"pave", "oidn", "cycles"})
        write_exr(frame, (folder / names).string() + ".exr", names);
    EXPECT_EQ(
        channel_names(folder / "pave.exr"),
        (std::vector<std::string>{
            "B",          "G",          "R",          "albedo.B",   "albedo.G",   "albedo.R",
            "depth.Z",    "direct.B",   "direct.G",   "direct.R",   "distance.Z", "drawn.B",
            "drawn.G",    "drawn.R",    "normal.X",   "normal.Y",   "normal.Z",   "object.I",
            "position.X", "position.Y", "position.Z", "variance.B", "variance.G", "variance.R"}));
    const auto oidn = channel_names(folder / "oidn.exr");
    for (const char* name : {"R", "albedo.R", "normal.X", "Denoising Depth.Z"})
        EXPECT_NE(std::find(oidn.begin(), oidn.end(), name), oidn.end()) << name;
    const auto cycles = channel_names(folder / "cycles.exr");
    for (const char* name : {"ViewLayer.Combined.R", "ViewLayer.Combined.A",
                             "ViewLayer.Denoising Albedo.R", "ViewLayer.Denoising Normal.X",
                             "ViewLayer.Depth.Z", "ViewLayer.Position.X", "ViewLayer.IndexOB.X"})
        EXPECT_NE(std::find(cycles.begin(), cycles.end(), name), cycles.end()) << name;
    EXPECT_THROW(write_exr(frame, (folder / "x.exr").string(), "vray"), UsageError);
}

TEST_F(ExrTest, PixelsAreEqualInEverySpelling) {
    const Frame frame = frame_of(kAllChannels);
    for (const char* names : {"pave", "oidn", "cycles"}) {
        const std::string path = (folder / names).string() + ".exr";
        write_exr(frame, path, names);
        EXPECT_EQ(difference(read_exr(path), 6), "") << names;
    }
}

// Read with OpenEXR alone, as another program would.
TEST_F(ExrTest, OtherProgramsReadPixelsAndAttributes) {
    write_exr(frame_of({"color", "normal", "depth"}), (folder / "a.exr").string());
    Imf::InputFile file((folder / "a.exr").c_str());
    const Imf::Header& header = file.header();
    EXPECT_EQ(header.compression(), Imf::ZIPS_COMPRESSION);
    EXPECT_TRUE(Imf::hasChromaticities(header));
    EXPECT_EQ(header.typedAttribute<Imf::StringAttribute>("pave.scene").value(), "cornell xxxxxx");
    EXPECT_EQ(header.typedAttribute<Imf::StringAttribute>("pave.seed").value(),
              std::to_string(0xFFFFFFFFFFFFFFF0ull - 6));
    EXPECT_EQ(header.typedAttribute<Imf::IntAttribute>("pave.rr_depth").value(), 2);
    EXPECT_EQ(header.typedAttribute<Imf::M44fAttribute>("pave.world_from_camera").value()[1][2],
              0.1f * 6 - 2.0f);
    EXPECT_EQ(header.typedAttribute<Imf::StringAttribute>("pave.depth.unit").value(), "scene unit");
    std::vector<float> pixels(7 * 5);
    Imf::FrameBuffer buffer;
    buffer.insert("normal.Y",
                  Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(pixels.data()), 4, 28));
    file.setFrameBuffer(buffer);
    file.readPixels(0, 4);
    for (int y = 0, i = 0; y < 5; ++y)
        for (int x = 0; x < 7; ++x, ++i)
            ASSERT_EQ(pixels[static_cast<size_t>(i)], pixel_value(6, 1, 1, x, y));
}

TEST_F(ExrTest, CustomChannelsAreNumbered) {
    Frame frame = make_frame(FrameSchema(4, 3, {{"speed", 2}, {"color", 1}}));
    fill(frame, 6);
    write_exr(frame, (folder / "a.exr").string());
    EXPECT_EQ(channel_names(folder / "a.exr"),
              (std::vector<std::string>{"color.0", "speed.0", "speed.1"}));
    EXPECT_EQ(difference(read_exr((folder / "a.exr").string()), 6), "");
}

TEST_F(ExrTest, EqualFramesGiveEqualBytes) {
    Frame frame = frame_of({"color"});
    write_exr(frame, (folder / "a.exr").string());
    frame.metadata().seconds_spent = 99;
    write_exr(frame, (folder / "b.exr").string());
    EXPECT_EQ(read_text(folder / "a.exr"), read_text(folder / "b.exr"));
}

TEST_F(ExrTest, WriteIsWholeOrAbsent) {
    const Frame frame = frame_of({"color"});
    EXPECT_THROW(write_exr(frame, (folder / "missing/a.exr").string()), RunError);
    write_text(folder / "old.exr", "old");
    EXPECT_THROW(write_exr(frame, (folder / "old.exr").string(), "vray"), UsageError);
    EXPECT_EQ(read_text(folder / "old.exr"), "old");
    write_exr(frame, (folder / "old.exr").string());  // replaced
    EXPECT_EQ(difference(read_exr((folder / "old.exr").string()), 6), "");
    EXPECT_EQ(list_files(folder.path()), std::vector<std::string>{"old.exr"});
}

TEST_F(ExrTest, UnknownSpellingIsRefusedBeforeAnythingIsMade) {
    StageOptions options = small_options();
    options.exr_names = "vray";
    EXPECT_THROW(Stage(uri("data"), options), UsageError);
    EXPECT_FALSE(fs::exists(folder / "data"));
}

}  // namespace
}  // namespace pave::test
