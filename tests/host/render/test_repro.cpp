// Same frame, same bits, whatever the schedule; every lane width and every way through the kernels
// gives the same image.
// SPDX-License-Identifier: BSD-3-Clause
#include <sys/wait.h>
#include <unistd.h>

#include <bit>
#include <cstdio>
#include <cstdlib>
#include <sstream>

#include "support.h"

namespace pave::test {
namespace {

const std::vector<std::string> kAll = {"color",    "albedo",   "direct",   "normal", "depth",
                                       "distance", "variance", "position", "object"};

::testing::AssertionResult same_frame(const Frame& a, const Frame& b) {
    for (const std::string& channel : kAll)
        if (auto result = same_bits(a, b, channel); !result) return result;
    return ::testing::AssertionSuccess();
}

TEST(Repro, BitsDoNotDependOnTheSchedule) {
    for (const Scene& scene : {cornell(), menagerie()}) {
        Renderer renderer(device(), scene);
        const RenderOptions options{.spp = 20, .seed = 9};
        const Frame reference = render(renderer, 37, 23, kAll, options);
        for (int tile_rows : {1, 2, 7, 23})
            for (int group : {0, 1, 2, 5}) {
                RenderOptions other = options;
                other.tile_rows = tile_rows;
                other.work_group_size = group;
                EXPECT_TRUE(same_frame(render(renderer, 37, 23, kAll, other), reference))
                    << tile_rows << " rows, group " << group;
            }
        for (int repeat = 0; repeat < 5; ++repeat)
            EXPECT_TRUE(same_frame(render(renderer, 37, 23, kAll, options), reference))
                << "repeat " << repeat;
        EXPECT_TRUE(same_frame(render(scene, 37, 23, kAll, options), reference))
            << "another renderer";
    }
}

TEST(Repro, ScalarBitsDoNotDependOnTheGroupSize) {
    Renderer renderer(device(), cornell());
    const RenderOptions options{.spp = 3, .lane_width = 1};
    const Frame reference = render(renderer, 64, 8, kAll, options);
    for (int group : {1, 4, 16, 64})
        for (int tile_rows : {1, 8}) {
            RenderOptions other = options;
            other.work_group_size = group;
            other.tile_rows = tile_rows;
            EXPECT_TRUE(same_frame(render(renderer, 64, 8, kAll, other), reference))
                << "group " << group;
        }
}

TEST(Repro, BitsDoNotDependOnThePasses) {
    // More samples than one pass holds, launched in different tiles.
    Renderer renderer(device(), cornell());
    const RenderOptions options{.spp = 700, .tile_rows = 1};
    RenderOptions whole = options;
    whole.tile_rows = 6;
    EXPECT_TRUE(
        same_frame(render(renderer, 7, 6, kAll, options), render(renderer, 7, 6, kAll, whole)));
}

TEST(Repro, OtherSeedsAndFramesGiveOtherImages) {
    Renderer renderer(device(), cornell());
    const std::vector<std::string> channels{"color", "variance"};
    const Frame a = render(renderer, 32, 32, channels, {.spp = 64, .seed = 1});
    const Frame b = render(renderer, 32, 32, channels, {.spp = 64, .seed = 2});
    const Frame c = render(renderer, 32, 32, channels, {.spp = 64, .seed = 1, .frame_index = 1});
    const Frame d = render(renderer, 32, 32, channels, {.spp = 64, .seed = 1ull << 32 | 1});
    for (const Frame* other : {&b, &c, &d}) {
        EXPECT_FALSE(same_bits(a, *other, "color"));
        EXPECT_TRUE(same_image(a, *other));
    }
}

/// Largest difference between the channels of two frames, in the values' own size.
double largest_gap(const Frame& a, const Frame& b, const std::string& channel) {
    const auto x = a.channel(channel), y = b.channel(channel);
    double gap = 0;
    for (size_t i = 0; i < x.size(); ++i)
        if (x[i] != y[i])  // infinite where nothing is hit
            gap = std::max(gap, std::abs(static_cast<double>(x[i]) - y[i]) / (1 + std::abs(x[i])));
    return gap;
}

TEST(Repro, OtherChannelsChangeTheOrderOfSumsAlone) {
    // Paths end sooner where fewer channels are asked for, and are added as they end: each of 16
    // additions may round another way.
    constexpr double kTolerance = 16 * 0x1p-23;
    Renderer renderer(device(), menagerie());
    const RenderOptions options{.spp = 16};
    const Frame all = render(renderer, 24, 16, kAll, options);
    for (const std::string& channel : kAll) {
        const Frame alone = render(renderer, 24, 16, {channel}, options);
        EXPECT_LE(largest_gap(alone, all, channel), kTolerance) << channel;
    }
    const Frame cheap = render(renderer, 24, 16, {"direct", "albedo", "normal", "depth"}, options);
    for (const char* channel : {"direct", "albedo", "normal", "depth"})
        EXPECT_LE(largest_gap(cheap, all, channel), kTolerance) << channel;
}

/// Largest share of values that differ by more than rounding.
double differing(const Frame& a, const Frame& b, const std::string& channel) {
    const auto x = a.channel(channel), y = b.channel(channel);
    size_t far = 0;
    for (size_t i = 0; i < x.size(); ++i)
        if (std::isinf(x[i]) != std::isinf(y[i]) ||
            (std::isfinite(x[i]) && std::abs(x[i] - y[i]) > 1e-3f * (1 + std::abs(x[i]))))
            ++far;
    return static_cast<double>(far) / static_cast<double>(x.size());
}

TEST(Paths, LaneWidthsAgree) {
    for (const Scene& scene : {cornell(), menagerie()}) {
        Renderer renderer(device(), scene);
        RenderOptions options{.spp = 64, .lane_width = 8};
        const Frame reference = render(renderer, 32, 32, kAll, options);
        for (int lanes : {1, 4, 16}) {
            options.lane_width = lanes;
            const Frame other = render(renderer, 32, 32, kAll, options);
            EXPECT_TRUE(same_image(reference, other)) << scene.name << " lanes " << lanes;
            // The same samples: but for the order of additions, and paths that a rounding sends
            // another way, all is equal.
            for (const std::string& channel : kAll)
                EXPECT_LT(differing(reference, other, channel),
                          channel == "color" || channel == "variance" ? 0.05 : 0.005)
                    << scene.name << " lanes " << lanes << " " << channel;
            options.seed = static_cast<uint64_t>(lanes);
            EXPECT_TRUE(same_image(reference, render(renderer, 32, 32, kAll, options)))
                << scene.name << " lanes " << lanes << ", other seed";
            options.seed = 0;
        }
    }
}

TEST(Paths, EveryForcedPathGivesTheSameImage) {
    for (const Scene& scene : {cornell(), menagerie()}) {
        const RenderOptions options{.spp = 64};
        const Frame reference = render(scene, 32, 32, kAll, options);
        for (const RendererPaths& paths :
             {RendererPaths{.broadcast_shapes = 0}, RendererPaths{.cull_occluders = false},
              RendererPaths{.specialise = false},
              RendererPaths{.broadcast_shapes = 0, .cull_occluders = false, .specialise = false}}) {
            const Frame other = render(scene, 32, 32, kAll, options, paths);
            EXPECT_TRUE(same_image(reference, other)) << scene.name;
            for (const char* channel : {"normal", "depth", "direct", "object"})
                EXPECT_LT(differing(reference, other, channel), 0.005)
                    << scene.name << " " << channel << ": tree " << !paths.broadcast_shapes
                    << ", cull " << paths.cull_occluders << ", specialise " << paths.specialise;
        }
    }
}

TEST(Paths, ManyShapesGoIntoTheTree) {
    Scene scene = cornell();
    scene.shapes.resize(6);
    for (int i = 0; i < 200; ++i)
        add_shape(
            scene, i % 2 ? Shape::Type::kSphere : Shape::Type::kCube,
            translate(-0.8f + 0.17f * static_cast<float>(i % 10),
                      -0.9f + 0.17f * static_cast<float>(i / 10 % 10), i < 100 ? -0.5f : 0.2f) *
                scale(0.05f),
            i % 3);
    const RenderOptions options{.spp = 32};
    EXPECT_TRUE(same_image(render(scene, 24, 24, kAll, options),
                           render(scene, 24, 24, kAll, options, {.broadcast_shapes = 1000})));
}

// ---- Other processes: with another number of threads, and under a checking simulator ----

/// Runs `command` and returns its standard output; `status` gets the exit status.
std::string run_command(const std::string& command, int* status) {
    std::string output;
    FILE* pipe = popen(command.c_str(), "r");
    if (pipe == nullptr) throw RunError("cannot run " + command);
    std::array<char, 4096> part;
    while (const size_t n = fread(part.data(), 1, part.size(), pipe)) output.append(part.data(), n);
    *status = pclose(pipe);
    return output;
}
std::string self() {
    std::array<char, 4096> path{};
    if (readlink("/proc/self/exe", path.data(), path.size() - 1) < 0)
        throw RunError("cannot find the test program");
    return path.data();
}

/// Prints sums over the bits of a small image, for the tests below; renders as PAVE_CHILD says.
TEST(Child, PrintsBits) {
    const char* lanes = std::getenv("PAVE_CHILD");
    const RenderOptions options{
        .spp = 2, .max_depth = 4, .lane_width = lanes ? std::stoi(lanes) : 0};
    for (const Scene& scene : {cornell(), menagerie()}) {
        const Frame frame = render(scene, 5, 3, kAll, options);
        uint64_t sum = 0;
        for (const std::string& channel : kAll)
            for (float x : frame.channel(channel))
                sum = sum * 0x9E3779B97F4A7C15ull + std::bit_cast<uint32_t>(x);
        std::printf("bits %s %016llx\n", scene.name.c_str(), static_cast<unsigned long long>(sum));
    }
}
std::string bit_lines(const std::string& output) {
    std::istringstream lines(output);
    std::string line, result;
    while (std::getline(lines, line))
        if (line.rfind("bits ", 0) == 0) result += line + "\n";
    return result;
}

TEST(Repro, BitsDoNotDependOnTheThreads) {
    std::string reference;
    for (const char* threads : {"1", "2"}) {
        int status = 0;
        const std::string output =
            run_command("POCL_MAX_PTHREAD_COUNT=" + std::string(threads) + " " + self() +
                            " --gtest_filter=Child.PrintsBits 2>&1",
                        &status);
        ASSERT_EQ(status, 0) << output;
        const std::string bits = bit_lines(output);
        ASSERT_FALSE(bits.empty()) << output;
        if (reference.empty()) reference = bits;
        EXPECT_EQ(bits, reference) << threads << " threads";
    }
}

class Oclgrind : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Lanes, Oclgrind, ::testing::Values(1, 4));

// Without optimisation: inlined code has intrinsics that Oclgrind 21.10 does not know. Without
// cache: to build anew.
TEST_P(Oclgrind, FindsNothing) {
    int status = 0;
    const std::string found = run_command("command -v oclgrind", &status);
    ASSERT_EQ(status, 0) << "oclgrind is not installed: apt install oclgrind";
    const std::string output = run_command(
        "PAVE_NO_CACHE=1 PAVE_DEVICE=Oclgrind PAVE_CHILD=" + std::to_string(GetParam()) +
            " timeout 300 oclgrind --build-options -cl-opt-disable --data-races --uninitialized " +
            self() + " --gtest_filter=Child.PrintsBits 2>&1",
        &status);
    EXPECT_EQ(status, 0) << output;
    EXPECT_NE(bit_lines(output), "") << output;
    for (const char* fault : {"Invalid", "Uninitialized", "race", "divergence"})
        EXPECT_EQ(output.find(fault), std::string::npos) << output.substr(0, 4000);
}

}  // namespace
}  // namespace pave::test
