// The choice between implementations: forced, measured, remembered, and never trusted when damaged.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cstdlib>
#include <limits>

#include "host/nn/network.h"
#include "pave/error.h"
#include "tests/host/nn/fixtures.h"

namespace pave::nn {
namespace {

TEST(ConvPlan, timings_survive_as_text_and_damage_is_noticed) {
    const std::map<std::string, ConvTiming> timings{
        {"conv2d 3>64 4x4 s2 p1 128x128>64x64", {120.5, 800}},
        {"conv2d 1>1 1x1 s1 p0 1x1>1x1", {9, 2.5}}};
    const std::string text = timings_text(timings);
    const auto back = parse_timings(text);
    ASSERT_TRUE(back.has_value());
    ASSERT_EQ(back->size(), 2u);
    for (const auto& [shape, timing] : timings) {
        EXPECT_DOUBLE_EQ(back->at(shape).direct_us, timing.direct_us);
        EXPECT_EQ(back->at(shape).best(), timing.best());
    }
    for (size_t i = 0; i < text.size(); ++i) {
        std::string bad = text;
        bad[i] = static_cast<char>(bad[i] ^ 1);
        EXPECT_FALSE(parse_timings(bad).has_value()) << i;
        EXPECT_FALSE(parse_timings(text.substr(0, i)).has_value()) << i;
    }
}

TEST(ConvPlan, environment_forces_a_choice) {
    const std::pair<const char*, ConvPolicy> words[] = {{"", ConvPolicy::kRemember},
                                                        {"measure", ConvPolicy::kMeasure},
                                                        {"direct", ConvPolicy::kDirect},
                                                        {"clblast", ConvPolicy::kGemm}};
    for (const auto& [word, policy] : words) {
        setenv("PAVE_CONV", word, 1);
        EXPECT_EQ(conv_policy(), policy) << word;
    }
    setenv("PAVE_CONV", "fastest", 1);
    EXPECT_THROW(conv_policy(), UsageError);
    unsetenv("PAVE_CONV");
}

TEST(ConvPlan, measures_each_shape_once_and_remembers_between_networks) {
    const FixtureCase& item = fixture_case("norm_folded");
    const auto run = [&](ConvPolicy policy) {
        Network network(device_with_lanes(0), item.schema().graph, {policy, 0});
        network.prepare(item.width, item.height, false);
        network.write_input(item.input(0));
        network.enqueue();
        network.read(network.graph().result);
        return network.plan().timings();
    };
    const auto measured = run(ConvPolicy::kMeasure);
    ASSERT_EQ(measured.size(), 2u);
    for (const auto& [shape, timing] : measured) {
        EXPECT_GT(timing.direct_us, 0.0) << shape;
        EXPECT_GT(timing.gemm_us, 0.0) << shape;
    }
    const auto remembered = run(ConvPolicy::kRemember);
    for (const auto& [shape, timing] : measured) {
        ASSERT_TRUE(remembered.contains(shape)) << shape;
        EXPECT_NEAR(remembered.at(shape).direct_us, timing.direct_us, 1e-3 * timing.direct_us);
    }
    EXPECT_TRUE(run(ConvPolicy::kDirect).empty());
}

TEST(GemmConv, memory_of_a_chunk_is_bounded_by_the_wider_of_both_matrices) {
    // One channel in, many out: the columns are small, their products are not.
    constexpr int kOuts = 4096, kSize = 64;
    Node node;
    node.op = Op::kConv2d;
    node.kernel_w = node.kernel_h = node.weight_in_channels = 1;
    node.out_channels = kOuts;
    node.weight.assign(kOuts, 1.0f);
    node.bias.assign(kOuts, 0.0f);
    Runtime runtime(device_with_lanes(0));
    WeightStore store(device_with_lanes(0));
    const ConvSite site{
        &node, {0, 1, kSize, kSize, 1}, {kSize * kSize, kOuts, kSize, kSize, kOuts}, Activation{}};
    const size_t floats = size_t{kSize} * kSize * (kOuts + 1);
    const cl::Buffer arena =
        make_buffer(device_with_lanes(0), floats * sizeof(float), "a wide convolution");
    const double part = make_gemm_conv(runtime, store, site)
                            ->enqueue_sample(arena, std::numeric_limits<int64_t>::max());
    finish(device_with_lanes(0), "a wide convolution");
    EXPECT_LE(part * kSize * kSize * kOuts * sizeof(float), 16 << 20);
}

}  // namespace
}  // namespace pave::nn
