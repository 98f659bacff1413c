// The example programs run, and what they write is right.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>

#include "pave/pave.h"

namespace {
namespace fs = std::filesystem;

struct Outcome {
    int exit_code = -1;
    std::string text;
};

// Runs one of the example programs; its output and errors together.
Outcome run(const std::string& program, const std::string& arguments) {
    const std::string command = std::string(PAVE_EXAMPLES_DIR) + "/" + program + " " + arguments;
    FILE* pipe = popen((command + " 2>&1").c_str(), "r");
    if (pipe == nullptr) return {};
    Outcome outcome;
    std::array<char, 256> buffer;
    while (fgets(buffer.data(), buffer.size(), pipe) != nullptr) outcome.text += buffer.data();
    const int status = pclose(pipe);
    if (WIFEXITED(status)) outcome.exit_code = WEXITSTATUS(status);
    return outcome;
}

class Examples : public testing::Test {
   protected:
    void SetUp() override {
        std::string name = fs::temp_directory_path() / "pave-examples-XXXXXX";
        ASSERT_NE(mkdtemp(name.data()), nullptr);
        folder_ = name;
    }
    void TearDown() override { fs::remove_all(folder_); }
    std::string uri(const std::string& name) const { return "bp:" + (folder_ / name).string(); }
    fs::path folder_;
};

TEST_F(Examples, SimulationSavesEveryStepOfItsLoop) {
    const Outcome outcome = run("simulation", uri("plate.bp") + " 3");
    ASSERT_EQ(outcome.exit_code, 0) << outcome.text;
    EXPECT_EQ(outcome.text, "saved 3 frames of temperature, hottest 1\n");

    const auto source = pave::Source::open(uri("plate.bp"));
    ASSERT_EQ(source->frame_count(), 3);
    EXPECT_TRUE(source->finished());
    double last_heat = 0;
    for (int position = 0; position < 3; ++position) {
        const pave::Frame frame = source->read(position);
        const auto plate = frame.channel("temperature");
        ASSERT_EQ(plate.size(), 256u * 256u);
        double heat = 0;
        for (size_t y = 0; y < 256; ++y)
            for (size_t x = 0; x < 256; ++x) {
                const float here = plate[y * 256 + x];
                ASSERT_GE(here, 0.0f);
                ASSERT_LE(here, 1.0f);
                // The spot moves along the diagonal, so the plate is its own mirror image but for
                // rounding.
                ASSERT_NEAR(here, plate[x * 256 + y], 1e-5f);
                const bool is_edge = x == 0 || y == 0 || x == 255 || y == 255;
                ASSERT_TRUE(!is_edge || here == 0.0f) << x << ", " << y;
                heat += here;
            }
        EXPECT_GT(heat, last_heat) << "frame " << position;  // the spot feeds the plate
        last_heat = heat;
    }
}

TEST_F(Examples, SimulationEndsWithTheErrorsCodeAndOneLine) {
    const Outcome outcome = run("simulation", "bp:/proc/no-such-folder/x.bp 1");
    EXPECT_EQ(outcome.exit_code, static_cast<int>(pave::ExitCode::kRun)) << outcome.text;
    EXPECT_EQ(outcome.text.rfind("simulation: error: ", 0), 0u) << outcome.text;
    EXPECT_EQ(std::count(outcome.text.begin(), outcome.text.end(), '\n'), 1) << outcome.text;
}

void expect_right_frame(const pave::Frame& frame) {
    const auto color = frame.channel("color"), albedo = frame.channel("albedo");
    const auto normal = frame.channel("normal"), depth = frame.channel("depth");
    const size_t pixels = depth.size();
    ASSERT_EQ(pixels, 64u * 64u);
    double sum = 0;
    for (const float value : color) {
        ASSERT_TRUE(std::isfinite(value) && value >= 0.0f);
        sum += value;
    }
    EXPECT_GT(sum / static_cast<double>(color.size()), 0.01);
    for (const float value : albedo) ASSERT_TRUE(value >= 0.0f && value <= 1.0f) << value;
    for (size_t i = 0; i < pixels; ++i) {
        const float x = normal[i], y = normal[pixels + i], z = normal[2 * pixels + i];
        const bool hit = std::isfinite(depth[i]);
        // Means over a pixel's samples: edges are shorter than unit normals, never longer.
        const float length = std::sqrt(x * x + y * y + z * z);
        ASSERT_LE(length, 1.0f + 1e-4f);
        ASSERT_TRUE(hit ? depth[i] > 0.0f : length == 0.0f) << "pixel " << i;
    }
}

TEST_F(Examples, EmbeddedRendererStoresWhatItRendered) {
    const Outcome outcome = run("embedded_renderer", uri("views.bp") + " 3");
    ASSERT_EQ(outcome.exit_code, 0) << outcome.text;
    EXPECT_NE(outcome.text.find("rendered 3 views on "), std::string::npos) << outcome.text;
    EXPECT_NE(outcome.text.find(", 3 acknowledged\n"), std::string::npos) << outcome.text;

    const auto source = pave::Source::open(uri("views.bp"));
    ASSERT_EQ(source->frame_count(), 3);
    const auto views = pave::hemisphere_views(pave::load_scene("cornell"), 3, 7);
    for (int position = 0; position < 3; ++position) {
        const pave::Frame frame = source->read(position);
        const pave::FrameMetadata& metadata = frame.metadata();
        EXPECT_EQ(metadata.index, position);
        EXPECT_EQ(metadata.view, views[static_cast<size_t>(position)]);
        EXPECT_EQ(metadata.scene, "cornell");
        EXPECT_EQ(metadata.seed, 7u);
        EXPECT_EQ(metadata.spp, 16);
        expect_right_frame(frame);
    }
}

}  // namespace
