// Same frame, same bits, whatever the schedule; every lane width and every way through the kernels
// gives the same image.
// SPDX-License-Identifier: BSD-3-Clause
#include <sys/wait.h>
#include <unistd.h>

#include <bit>
#include <cstdio>
#include <cstdlib>
#include <sstream>

#include "selftest.h"

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
        // Segments of 8 pixels: a row of 63 has 8 work-items, the last one shorter.
        const RenderOptions options{.spp = 128, .seed = 9};
        const Frame reference = render(renderer, 63, 11, kAll, options);
        for (int tile_rows : {1, 2, 7, 11})
            for (int group : {0, 1, 2, 4, 8}) {
                RenderOptions other = options;
                other.tile_rows = tile_rows;
                other.work_group_size = group;
                EXPECT_TRUE(same_frame(render(renderer, 63, 11, kAll, other), reference))
                    << tile_rows << " rows, group " << group;
            }
        for (int repeat = 0; repeat < 5; ++repeat)
            EXPECT_TRUE(same_frame(render(renderer, 63, 11, kAll, options), reference))
                << "repeat " << repeat;
        EXPECT_TRUE(same_frame(render(scene, 63, 11, kAll, options), reference))
            << "another renderer";
    }
}

TEST(Repro, ScalarBitsDoNotDependOnTheGroupSize) {
    Renderer renderer(device(), cornell());
    const RenderOptions options{.spp = 3, .lane_width = 1};
    const auto largest = static_cast<int>(device().profile().max_work_group_size);
    for (int width : {7 * 64, largest}) {
        const Frame reference = render(renderer, width, 2, kAll, options);
        for (int group : {1, 7, 64, largest})
            for (int tile_rows : {1, 2}) {
                if (width % group != 0) continue;
                RenderOptions other = options;
                other.work_group_size = group;
                other.tile_rows = tile_rows;
                EXPECT_TRUE(same_frame(render(renderer, width, 2, kAll, other), reference))
                    << "width " << width << " group " << group;
            }
    }
}

TEST(Repro, BitsDoNotDependOnThePasses) {
    // More samples than one pass holds, launched in different tiles.
    Renderer renderer(device(), cornell());
    const RenderOptions options{.spp = 700, .tile_rows = 1};
    RenderOptions whole = options;
    whole.tile_rows = 6;
    whole.work_group_size = 3;
    EXPECT_TRUE(
        same_frame(render(renderer, 21, 6, kAll, options), render(renderer, 21, 6, kAll, whole)));
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

TEST(Paths, RaysThatTakeTurnsGiveTheSameBits) {
    const RenderOptions options{.spp = 64};
    for (const Scene& scene : {cornell(), menagerie()}) {
        RendererPaths paths{.broadcast_shapes = 0, .tree_turns = TreeTurns::kNever};
        const Frame alone = render(scene, 32, 32, kAll, options, paths);
        paths.tree_turns = TreeTurns::kAlways;
        const Frame turns = render(scene, 32, 32, kAll, options, paths);
        for (const char* channel : {"color", "normal", "depth", "direct", "object"})
            EXPECT_TRUE(same_bits(alone, turns, channel)) << scene.name;
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

/// What a child process renders.
struct ChildCase {
    const char* name;
    int width, height;
    RenderOptions options;
    RendererPaths paths = {};
};
const ChildCase kChildCases[] = {
    {"threads", 64, 40, {.spp = 128, .max_depth = 50}},
    {"scalar", 5, 3, {.spp = 2, .max_depth = 4, .lane_width = 1}},
    {"four lanes", 5, 3, {.spp = 2, .max_depth = 4, .lane_width = 4}},
    // More than one segment a row, the last one shorter.
    {"segments", 11, 1, {.spp = 128, .max_depth = 3, .lane_width = 8}},
    // A second pass over the same pixels.
    {"passes", 2, 1, {.spp = 257, .max_depth = 3, .lane_width = 16}},
    {"roulette", 4, 2, {.spp = 4, .max_depth = 8, .rr_depth = 1, .lane_width = 8}},
    {"general", 5, 2, {.spp = 2, .max_depth = 4, .lane_width = 8}, {.specialise = false}},
    {"turns",
     5,
     2,
     {.spp = 2, .max_depth = 4, .lane_width = 8},
     {.broadcast_shapes = 0, .tree_turns = TreeTurns::kAlways}},
    {"tree", 5, 2, {.spp = 2, .max_depth = 4, .lane_width = 4}, {.broadcast_shapes = 0}},
};

/// Prints sums over the bits, and the pixels, of four small images; for the tests below, which say
/// in PAVE_CHILD which case. Without it, a case of no special meaning.
TEST(Child, PrintsBits) {
    const char* child = std::getenv("PAVE_CHILD");
    const ChildCase& c = kChildCases[child != nullptr ? std::stoi(child) : 1];
    std::printf("units %d\n", device().profile().compute_units);
    RendererPaths paths = c.paths;
    paths.copied_triangles = -1;
    for (const Scene& scene : {cornell(), menagerie(), outdoors(), grove()}) {
        const Frame frame = render(scene, c.width, c.height, kAll, c.options, paths);
        uint64_t sum = 0;
        for (const std::string& channel : kAll) {
            std::printf("pixels %s %s", scene.name.c_str(), channel.c_str());
            for (float x : frame.channel(channel)) {
                sum = sum * 0x9E3779B97F4A7C15ull + std::bit_cast<uint32_t>(x);
                std::printf(" %.9g", static_cast<double>(x));
            }
            std::printf("\n");
        }
        std::printf("bits %s %016llx\n", scene.name.c_str(), static_cast<unsigned long long>(sum));
    }
}

/// Every kernel of selftest.cl once, on a few items.
TEST(Child, RunsEveryTestKernel) {
    SelfTest test(grove(), 4, {.copied_triangles = -1, .specialise = false});
    test.struct_sizes();
    test.philox(std::vector<std::array<uint32_t, 4>>(16), 1, 2);
    const Planes u = test.philox_units(3, 16);
    test.texture(0, {u[0], u[1]});
    for (int shape = 0; shape < 5; ++shape) test.sample_shape(shape, 0.25f, {u[0], u[1]});
    const Planes wo = test.sample_bsdf(0, {0.1, 0.2, 0.97}, 4, 16);
    test.eval_bsdf(0, {wo[0], wo[1], wo[2], wo[0], wo[1], wo[2]});
    const Planes wi = test.sample_light({0, 0, 0.5f}, 5, 16);
    test.light_pdf({0, 0, 0.5f}, {wi[0], wi[1], wi[2]});
    Planes rays = make_planes(9, 16);
    for (size_t i = 0; i < 16; ++i) {
        for (size_t k = 0; k < 3; ++k) rays[3 + k][i] = wi[k][i];
        rays[6][i] = std::numeric_limits<float>::infinity();
        rays[7][i] = rays[8][i] = std::bit_cast<float>(-1);
    }
    test.trace(rays);
}

/// A kernel that reads far outside of a table, where the tests below ask for it.
TEST(Child, ReadsOutsideIfAsked) {
    if (std::getenv("PAVE_CHILD") == nullptr) return;
    SelfTest(cornell(), 1).sample_bsdf(100000, {0.1, 0.2, 0.97}, 4, 16);
}

/// The lines of a child's output that begin with `word`.
std::string lines_of(const std::string& output, const std::string& word) {
    std::istringstream lines(output);
    std::string line, result;
    while (std::getline(lines, line))
        if (line.rfind(word + " ", 0) == 0) result += line + "\n";
    return result;
}
std::string run_child(size_t child, const std::string& before, int* status,
                      const std::string& test = "PrintsBits") {
    return run_command("PAVE_CHILD=" + std::to_string(child) + " " + before + " " + self() +
                           " --gtest_filter=Child." + test + " 2>&1",
                       status);
}

TEST(Repro, BitsDoNotDependOnTheThreads) {
    std::string reference;
    for (const std::string threads : {"1", "2"}) {
        int status = 0;
        const std::string output = run_child(0, "POCL_MAX_PTHREAD_COUNT=" + threads, &status);
        ASSERT_EQ(status, 0) << output;
        EXPECT_EQ(lines_of(output, "units"), "units " + threads + "\n");
        const std::string bits = lines_of(output, "bits");
        ASSERT_FALSE(bits.empty()) << output;
        if (reference.empty()) reference = bits;
        EXPECT_EQ(bits, reference) << threads << " threads";
    }
}

class Oclgrind : public ::testing::TestWithParam<size_t> {};
INSTANTIATE_TEST_SUITE_P(Cases, Oclgrind, ::testing::Range<size_t>(1, std::size(kChildCases)));

/// Share of the numbers in two equally long texts that differ by more than a thousandth.
double differing_numbers(const std::string& a, const std::string& b) {
    std::istringstream first(a), second(b);
    std::string x, y;
    size_t count = 0, far = 0;
    while (first >> x && second >> y) {
        char* end = nullptr;
        const double u = std::strtod(x.c_str(), &end), v = std::strtod(y.c_str(), nullptr);
        if (end == x.c_str()) {
            if (x != y) return 1.0;
            continue;
        }
        ++count;
        far += std::isinf(u) != std::isinf(v) ||
               (std::isfinite(u) && std::abs(u - v) > 1e-3 * (1 + std::abs(u)));
    }
    return count == 0 ? 1.0 : static_cast<double>(far) / static_cast<double>(count);
}

// Without optimisation: inlined code has intrinsics that Oclgrind 21.10 does not know. Without
// cache: to build anew. Its check for uninitialised values ends in its own memcpy where vectors are
// wider than 4, so wider lanes are watched for memory and races only; the source is the same.
std::string under_oclgrind(int lanes) {
    return std::string("PAVE_NO_CACHE=1 PAVE_DEVICE=Oclgrind timeout 300 oclgrind ") +
           "--build-options -cl-opt-disable --data-races" + (lanes <= 4 ? " --uninitialized" : "");
}

void expect_clean(const std::string& output, int status) {
    EXPECT_EQ(status, 0) << output.substr(0, 4000);
    EXPECT_NE(output.find("[  PASSED  ] 1 test"), std::string::npos) << output.substr(0, 4000);
    for (const char* fault : {"Invalid", "Uninitialized", "race", "divergence"})
        EXPECT_EQ(output.find(fault), std::string::npos) << output.substr(0, 4000);
}

TEST_P(Oclgrind, FindsNothingAndAgreesWithThisDevice) {
    int status = 0;
    const std::string output =
        run_child(GetParam(), under_oclgrind(kChildCases[GetParam()].options.lane_width), &status);
    expect_clean(output, status);
    // Two devices agree but for rounding and the paths that a rounding sends another way.
    const std::string here = run_child(GetParam(), "", &status);
    EXPECT_EQ(status, 0) << here;
    EXPECT_LE(differing_numbers(lines_of(here, "pixels"), lines_of(output, "pixels")), 0.02)
        << kChildCases[GetParam()].name;
}

TEST(OclgrindOnce, FindsNothingInTheTestKernels) {
    int status = 0;
    const std::string output = run_child(0, under_oclgrind(4), &status, "RunsEveryTestKernel");
    expect_clean(output, status);
}

TEST(OclgrindOnce, NoticesAReadOutsideOfATable) {
    // The tests above are worth something only if a fault in a kernel would be seen.
    int status = 0;
    const std::string output = run_child(0, under_oclgrind(1), &status, "ReadsOutsideIfAsked");
    EXPECT_NE(output.find("Invalid read"), std::string::npos) << output.substr(0, 4000);
}

}  // namespace
}  // namespace pave::test
