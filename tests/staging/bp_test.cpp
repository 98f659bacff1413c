// bp: data sets: what is written is read back bit by bit, in bytes that depend on the frames alone.
// SPDX-License-Identifier: BSD-3-Clause
#include <adios2.h>
#include <gtest/gtest.h>
#include <malloc.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <optional>
#include <thread>

#include "tests/staging/helpers.h"

namespace pave::test {
namespace {

struct BpTest : ::testing::Test {
    std::string uri(const std::string& name) const { return "bp:" + (folder / name).string(); }
    const TempFolder folder;
};

/// "" if both folders hold the same files with the same bytes, but for the timings.
std::string folder_difference(const fs::path& a, const fs::path& b) {
    const auto names = list_files(a);
    if (names != list_files(b)) return "other files";
    for (const std::string& name : names)
        if (name != "timings.jsonl" && read_text(a / name) != read_text(b / name)) return name;
    return {};
}

TEST_F(BpTest, RoundTrip) {
    write_data_set(uri("data.bp"), 10);
    EXPECT_EQ(check_data_set(uri("data.bp"), 10), "");
}

TEST_F(BpTest, ShardsFollowFrameNumbers) {
    StageOptions options = small_options();
    Stage stage(uri("data.bp"), options);
    for (const int64_t index : {1, 2, 5, 7, 8, 20}) publish_frames(stage, index, index + 1);
    stage.close();
    std::vector<std::string> shards;
    for (const std::string& file : list_files(folder / "data.bp"))
        if (file.ends_with("/data.0")) shards.push_back(file.substr(0, file.find('/')));
    // Without its count where the last frame is the shard's last.
    EXPECT_EQ(shards, (std::vector<std::string>{"frames-00000001-2.bp", "frames-00000005.bp",
                                                "frames-00000008-1.bp", "frames-00000020-1.bp"}));
    const auto source = Source::open(uri("data.bp"));
    EXPECT_EQ(difference(source->read(3), 7), "");
    EXPECT_EQ(source->metadata(5).index, 20);
}

TEST_F(BpTest, OnlyWholeShardsAreAcknowledgedUntilAFlush) {
    Stage stage(uri("data.bp"), small_options());
    publish_frames(stage, 0, 6);
    stage.flush();
    EXPECT_EQ(stage.acknowledged(), 6);
    EXPECT_EQ(check_data_set(uri("data.bp"), 6, true), "");
    EXPECT_THROW(Source::open(uri("data.bp")), InputError);  // unfinished
}

TEST_F(BpTest, SameFramesGiveTheSameBytes) {
    write_data_set(uri("a.bp"), 9);
    // Dirt in fresh heap memory must not show: ADIOS2 pads with it.
    mallopt(M_PERTURB, 0x5A);
    StageOptions options = small_options();
    options.slots = 2;
    write_data_set(uri("b.bp"), 9, options);
    mallopt(M_PERTURB, 0xC3);
    write_data_set(uri("c.bp"), 9);
    mallopt(M_PERTURB, 0);
    EXPECT_EQ(folder_difference(folder / "a.bp", folder / "b.bp"), "");
    EXPECT_EQ(folder_difference(folder / "a.bp", folder / "c.bp"), "");
}

TEST_F(BpTest, ResumedRunEqualsAnUnbrokenOne) {
    write_data_set(uri("whole.bp"), 22);
    for (const int64_t stop : {0, 1, 3, 4, 6, 8, 21, 22}) {
        const std::string name = "stopped-" + std::to_string(stop) + ".bp";
        {
            Stage stage(uri(name), small_options());
            publish_frames(stage, 0, stop);
            stage.abandon();
        }
        StageOptions options = small_options();
        options.resume = true;
        {
            Stage stage(uri(name), options);
            EXPECT_EQ(stage.first_index(), stop);
            EXPECT_EQ(stage.acknowledged(), stop);
            if (stop < 7) publish_frames(stage, stop, 7);
            stage.close();  // finished too early ...
        }
        write_data_set(uri(name), 22, options);  // ... and extended
        EXPECT_EQ(folder_difference(folder / "whole.bp", folder / name), "")
            << "stopped at " << stop;
        EXPECT_EQ(check_data_set(uri(name), 22), "");
    }
}

TEST_F(BpTest, ResumeFillsAGapThatEndedAShard) {
    for (const bool is_killed : {false, true}) {
        const std::string name = is_killed ? "killed.bp" : "whole.bp";
        {
            Stage stage(uri(name), small_options());
            for (const int64_t index : {0, 1, 2, 3, 4, 5, 8}) {
                if (!is_killed && index == 8) publish_frames(stage, 6, 8);
                publish_frames(stage, index, index + 1);
            }
            stage.abandon();
        }
        StageOptions options = small_options();
        options.resume = true;
        if (is_killed) {
            // As killed after the shard of 4 and 5, which 8 had ended, became durable.
            const std::string text = read_text(folder / name / "manifest.jsonl");
            const size_t line = text.find("{\"block\":\"frames-00000008");
            ASSERT_NE(line, std::string::npos);
            write_text(folder / name / "manifest.jsonl", text.substr(0, line));
            Stage stage(uri(name), options);
            EXPECT_EQ(stage.first_index(), 6);
            publish_frames(stage, 6, 9);
            stage.abandon();
        }
        write_data_set(uri(name), 12, options);
        EXPECT_EQ(check_data_set(uri(name), 12), "");
    }
    EXPECT_EQ(folder_difference(folder / "whole.bp", folder / "killed.bp"), "");
}

TEST_F(BpTest, ResumeCleansUpWhatWasNotAcknowledged) {
    write_data_set(uri("whole.bp"), 8);
    {
        Stage stage(uri("data.bp"), small_options());
        publish_frames(stage, 0, 4);
        stage.abandon();
    }
    const fs::path data = folder / "data.bp";
    fs::create_directories(data / ".tmp-shard");
    write_text(data / ".tmp-shard/data.0", "half");
    write_text(data / ".tmp-1-manifest.jsonl", "half");
    fs::copy(data / "frames-00000000.bp", data / "frames-00000004.bp");
    write_text(data / "manifest.jsonl", read_text(data / "manifest.jsonl") + "{\"block\":\"fra");
    write_text(data / "timings.jsonl", read_text(data / "timings.jsonl") + "{\"index\":4,");
    EXPECT_EQ(check_data_set(uri("data.bp"), 4, true), "");
    StageOptions options = small_options();
    options.resume = true;
    write_data_set(uri("data.bp"), 8, options);
    EXPECT_EQ(folder_difference(folder / "whole.bp", data), "");
}

TEST_F(BpTest, ResumeOfNothingStarts) {
    StageOptions options = small_options();
    options.resume = true;
    write_data_set(uri("deep/er/data.bp"), 3, options);
    EXPECT_EQ(check_data_set(uri("deep/er/data.bp"), 3), "");
}

TEST_F(BpTest, ResumeWithAnotherSchemaIsRefused) {
    {
        Stage stage(uri("data.bp"), small_options());
        publish_frames(stage, 0, 2);
        stage.abandon();
    }
    const auto refused = [&](auto change) {
        StageOptions options = small_options();
        options.resume = true;
        change(options);
        try {
            Stage stage(uri("data.bp"), options);
            return std::string("not refused");
        } catch (const UsageError& error) {
            return std::string(error.what());
        }
    };
    EXPECT_NE(refused([](StageOptions& o) { o.width = 17; }).find("cannot be resumed"),
              std::string::npos);
    EXPECT_NE(
        refused([](StageOptions& o) {
            o.channels = {"color", "depth", "normal"};
        })
            .find("it is bp 16x8 with color:3 normal:3 depth:1, frames_per_shard 4, this stage is "
                  "bp 16x8 with color:3 depth:1 normal:3"),
        std::string::npos);
    EXPECT_NE(refused([](StageOptions& o) { o.frames_per_shard = 5; }).find("cannot be resumed"),
              std::string::npos);
    EXPECT_EQ(check_data_set(uri("data.bp"), 2, true), "");
}

TEST_F(BpTest, ExistingDataAreNeverOverwritten) {
    write_data_set(uri("data.bp"), 3);
    EXPECT_THROW(Stage(uri("data.bp"), small_options()), UsageError);
    EXPECT_EQ(check_data_set(uri("data.bp"), 3), "");
    fs::create_directories(folder / "home");
    write_text(folder / "home/letter.txt", "dear");
    write_text(folder / "file", "plain");
    StageOptions resume = small_options();
    resume.resume = true;
    EXPECT_THROW(Stage(uri("home"), small_options()), UsageError);
    EXPECT_THROW(Stage(uri("home"), resume), InputError);
    EXPECT_THROW(Stage(uri("file"), small_options()), UsageError);
    EXPECT_EQ(list_files(folder / "home"), std::vector<std::string>{"letter.txt"});
}

TEST_F(BpTest, ASecondWriterIsKeptOut) {
    std::optional<Stage> first(std::in_place, uri("data.bp"), small_options());
    publish_frames(*first, 0, 2);
    StageOptions options = small_options();
    options.resume = true;
    try {
        Stage second(uri("data.bp"), options);
        FAIL() << "two writers";
    } catch (const RunError& error) {
        EXPECT_NE(std::string(error.what()).find("another writer"), std::string::npos);
    }
    first.reset();
    EXPECT_TRUE(
        fs::exists(folder / "data.bp/.lock"));  // a lock file that nobody holds does not matter
    write_data_set(uri("data.bp"), 5, options);
    EXPECT_EQ(check_data_set(uri("data.bp"), 5), "");
}

TEST_F(BpTest, OneOfTwoWritersThatStartTogetherWins) {
    for (int round = 0; round < 50; ++round) {
        const std::string name = "race-" + std::to_string(round);
        std::atomic<int> ready{0}, winners{0};
        const auto start = [&] {
            ++ready;
            while (ready < 2) continue;
            try {
                Stage stage(uri(name), small_options());
                ++winners;
                publish_frames(stage, 0, 2);
                stage.close();
            } catch (const UsageError&) {  // it exists
            } catch (const RunError& error) {
                EXPECT_NE(std::string(error.what()).find("another writer"), std::string::npos)
                    << error.what();
            }
        };
        std::thread other(start);
        start();
        other.join();
        EXPECT_EQ(winners, 1);
        ASSERT_EQ(check_data_set(uri(name), 2), "");
    }
}

TEST_F(BpTest, AForkedChildReadsWhileItsParentIsInAdios2) {
    write_data_set(uri("data.bp"), 8);
    std::atomic<bool> is_done{false};
    std::thread reader([&] {
        while (!is_done) EXPECT_EQ(check_data_set(uri("data.bp"), 8), "");
    });
    for (int round = 0; round < 30 && !HasFailure(); ++round) {
        const pid_t pid = fork();
        if (pid == 0) {
            alarm(60);
            int status = 1;
            try {
                status = check_data_set(uri("data.bp"), 8).empty() ? 0 : 1;
            } catch (const std::exception&) {
            }
            _exit(status);
        }
        int status = 0;
        waitpid(pid, &status, 0);
        EXPECT_EQ(status, 0) << "fork " << round;
    }
    is_done = true;
    reader.join();
}

TEST_F(BpTest, UnfinishedDataAreReadOnRequestOnly) {
    Stage stage(uri("data.bp"), small_options());
    publish_frames(stage, 0, 4);
    stage.flush();
    EXPECT_THROW(Source::open(uri("data.bp")), InputError);
    const auto source = Source::open(uri("data.bp"), true);
    EXPECT_FALSE(source->finished());
    EXPECT_EQ(source->frame_count(), 4);
    stage.close();
    EXPECT_TRUE(Source::open(uri("data.bp"))->finished());
}

TEST_F(BpTest, ForeignDataAreNotRead) {
    EXPECT_THROW(Source::open(uri("missing")), InputError);
    write_data_set(uri("data.bp"), 3);
    EXPECT_THROW(Source::open("exr:" + (folder / "data.bp").string()), InputError);
    fs::remove(folder / "data.bp/manifest.jsonl");
    try {
        Source::open(uri("data.bp"), true);
        FAIL() << "read without a manifest";
    } catch (const InputError& error) {
        EXPECT_NE(std::string(error.what()).find("foreign data are not read"), std::string::npos);
    }
}

TEST_F(BpTest, NextGivesFramesInOrderThenNothing) {
    write_data_set(uri("data.bp"), 3);
    const auto source = Source::open(uri("data.bp"));
    for (int64_t index = 0; index < 3; ++index)
        EXPECT_EQ(difference(source->next(std::chrono::seconds(1)), index), "");
    EXPECT_FALSE(source->next(std::chrono::seconds(1)));
    EXPECT_THROW(source->read(3), UsageError);
}

TEST_F(BpTest, AShardThatIsOpenedAgainIsVerifiedAgain) {
    StageOptions options = small_options();
    options.frames_per_shard = 1;
    write_data_set(uri("data.bp"), 70, options);
    const auto source = Source::open(uri("data.bp"));
    for (int64_t index = 0; index < 70; ++index)  // more than a source keeps open
        ASSERT_EQ(difference(source->read(index), index), "");
    const fs::path path = folder / "data.bp/frames-00000000.bp/md.0";
    std::string text = read_text(path);
    const size_t at = text.find("row-major");  // what no pixel depends on
    ASSERT_NE(at, std::string::npos);
    text[at] = 'R';
    write_text(path, text);
    EXPECT_THROW(source->read(0), InputError);
    EXPECT_EQ(difference(source->read(69), 69), "");  // still open
}

TEST_F(BpTest, RouletteDepthOfZeroIsThatOfOlderData) {
    // Data sets from before this key have none; their content hash must stay what it was.
    StageOptions options = small_options();
    Stage stage(uri("data.bp"), options);
    for (const int rr_depth : {0, 7}) {
        Frame frame = stage.acquire();
        frame.metadata().rr_depth = rr_depth;
        stage.publish(std::move(frame));
    }
    stage.close();
    const std::string manifest = read_text(folder / "data.bp/manifest.jsonl");
    const size_t key = manifest.find("\"rr_depth\"");
    EXPECT_EQ(manifest.substr(key, 13), "\"rr_depth\":7,");
    EXPECT_EQ(manifest.find("\"rr_depth\"", key + 1), std::string::npos);
    const auto source = Source::open(uri("data.bp"));
    EXPECT_EQ(source->metadata(0).rr_depth, 0);
    EXPECT_EQ(source->metadata(1).rr_depth, 7);
}

TEST_F(BpTest, CustomChannelsAndOddSizes) {
    StageOptions options;
    options.width = 3;
    options.height = 5;
    options.custom_channels = {{"a.1", 1}, {"speed", 2}, {"index", 64}};
    write_data_set(uri("data.bp"), 5, options);
    EXPECT_EQ(check_data_set(uri("data.bp"), 5), "");
}

// The shards are plain ADIOS2 data: variables by channel, steps, units and metadata, read here
// without PAVE's reader.
TEST_F(BpTest, AnyAdios2ReaderUnderstandsAShard) {
    write_data_set(uri("data.bp"), 4);
    adios2::ADIOS adios;
    adios2::IO io = adios.DeclareIO("foreign");
    adios2::Engine engine =
        io.Open((folder / "data.bp/frames-00000000.bp").string(), adios2::Mode::ReadRandomAccess);
    auto normal = io.InquireVariable<float>("normal");
    ASSERT_TRUE(normal);
    EXPECT_EQ(normal.Shape(), (adios2::Dims{3, 8, 16}));
    ASSERT_EQ(normal.Steps(), 4u);
    for (size_t step = 0; step < 4; ++step) {
        const auto index = static_cast<int64_t>(step);
        std::vector<float> pixels;
        normal.SetStepSelection({step, 1});
        engine.Get(normal, pixels, adios2::Mode::Sync);
        for (int plane = 0, i = 0; plane < 3; ++plane)
            for (int y = 0; y < 8; ++y)
                for (int x = 0; x < 16; ++x, ++i)
                    ASSERT_EQ(pixels[static_cast<size_t>(i)], pixel_value(index, 1, plane, x, y));
        auto seed = io.InquireVariable<uint64_t>("frame/seed");
        seed.SetStepSelection({step, 1});
        uint64_t value = 0;
        engine.Get(seed, value, adios2::Mode::Sync);
        EXPECT_EQ(value, 0xFFFFFFFFFFFFFFF0ull - step);
        auto rr_depth = io.InquireVariable<int32_t>("frame/rr_depth");
        rr_depth.SetStepSelection({step, 1});
        int32_t depth = -1;
        engine.Get(rr_depth, depth, adios2::Mode::Sync);
        EXPECT_EQ(depth, static_cast<int32_t>(step % 4));
        auto scene = io.InquireVariable<std::string>("frame/scene");
        scene.SetStepSelection({step, 1});
        std::string name;
        engine.Get(scene, name, adios2::Mode::Sync);
        EXPECT_EQ(name, "cornell " + std::string(step, 'x'));
    }
    EXPECT_EQ(io.InquireAttribute<std::string>("depth/unit").Data().at(0), "scene unit");
    engine.Close();
}

TEST_F(BpTest, ContentHashIsThatOfMem) {
    StageOptions options = small_options();
    options.slots = 8;
    Stage stage("mem:content", options);
    publish_frames(stage, 0, 6);
    stage.close();
    write_data_set(uri("data.bp"), 6);
    const std::string hash = Source::open("mem:content")->content_hash();
    EXPECT_EQ(hash.size(), 32u);
    EXPECT_EQ(Source::open(uri("data.bp"))->content_hash(), hash);
    write_data_set("exr:" + (folder / "exr").string(), 6);
    EXPECT_EQ(Source::open("exr:" + (folder / "exr").string())->content_hash(), hash);
    write_data_set(uri("other.bp"), 5);
    EXPECT_NE(Source::open(uri("other.bp"))->content_hash(), hash);
}

}  // namespace
}  // namespace pave::test
