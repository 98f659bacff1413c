// The C++ sketch of README.md, word for word: it compiles with all warnings on, and it runs.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

// clang-format off
// sketch: begin
#include <pave/pave.h>

void sketch(int width, int height, const std::vector<float>& pixels, const pave::View& view) {
pave::Paver paver("bp:cornell.bp");                          // the papers' three verbs: initialize, save, flush
paver.save("albedo", width, height, pixels);                 // std::vector<T> or std::span; free on return
paver.flush();

auto device   = pave::Device::select("pocl");                // zero copy, and the renderer inside a host program
auto scene    = pave::load_scene("scenes/cornell.xml");
pave::Renderer renderer(device, scene);
pave::Stage    stage(device, "mem:", {.width = 256, .height = 256, .channels = {"color", "albedo", "direct", "normal", "depth"}, .slots = 8});
pave::Frame frame = stage.acquire();
renderer.render(view, {.spp = 64, .max_depth = 50, .seed = 7}, frame);
pave::Generator generator(device, "run/");
generator.draw(frame);                                       // writes channel "drawn" on the same queue
stage.publish(std::move(frame));
stage.flush();
}
// sketch: end
// clang-format on

namespace {
namespace fs = std::filesystem;

std::string read_text(const fs::path& path) {
    std::ifstream file(path);
    std::stringstream text;
    text << file.rdbuf();
    return text.str();
}

// Lines of the function's body, without the function around them.
std::string sketch_text() {
    const std::string text =
        read_text(fs::path(PAVE_SOURCE_DIR) / "tests/examples/test_sketch.cpp");
    const size_t open = text.find("{\n", text.find("void sketch(")) + 2;
    return text.substr(open, text.find("}\n// sketch: end") - open);
}

TEST(Sketch, IsTheOneInReadme) {
    const std::string readme = read_text(fs::path(PAVE_SOURCE_DIR) / "README.md");
    EXPECT_NE(readme.find(sketch_text()), std::string::npos)
        << "README.md does not hold this text:\n"
        << sketch_text();
}

// In a folder of its own, where scenes/ and run/ are what the sketch expects them to be.
TEST(Sketch, Runs) {
    std::string name = fs::temp_directory_path() / "pave-sketch-XXXXXX";
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    const fs::path before = fs::current_path();
    fs::current_path(name);
    fs::create_directory_symlink(fs::path(PAVE_SOURCE_DIR) / "scenes", "scenes");
    fs::copy(fs::path(PAVE_TEST_DATA) / "tiny-run", "run");

    const pave::View view = pave::look_at({0, 0, 3.9f}, {0, 0, 0}, {0, 1, 0}, 39.3f);
    const std::vector<float> pixels(64 * 48, 0.5f);
    EXPECT_NO_THROW(sketch(64, 48, pixels, view));
    const auto source = pave::Source::open("bp:cornell.bp");
    EXPECT_EQ(source->frame_count(), 1);
    EXPECT_EQ(source->read(0).channel("albedo")[64 * 48 - 1], 0.5f);

    fs::current_path(before);
    fs::remove_all(name);
}

}  // namespace
