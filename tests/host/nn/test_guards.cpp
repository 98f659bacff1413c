// Nothing is written between tensors, and host and device agree on the parameter blocks.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include "host/nn/network.h"
#include "tests/host/nn/fixtures.h"

namespace pave::nn {
namespace {

constexpr size_t kGuardByteSize = 1024;
constexpr float kCanary = -12345.678f;

class Guards : public testing::TestWithParam<ConvPolicy> {};

TEST_P(Guards, stay_untouched) {
    for (const FixtureCase& item : fixture_cases()) {
        const Device& device = device_with_lanes(0);
        Network network(device, item.schema().graph, {GetParam(), kGuardByteSize});
        network.prepare(item.width, item.height, false);
        const MemoryPlan& plan = network.layout().memory;
        std::vector<float> memory(plan.byte_size / sizeof(float), kCanary);
        write_buffer(device, network.arena(), memory, "canaries");
        network.write_input(item.input(0));
        network.enqueue();
        read_buffer(device, network.arena(), memory, "canaries");
        std::vector<bool> owned(memory.size(), false);
        for (size_t i = 0; i < plan.byte_offsets.size(); ++i)
            std::fill_n(
                owned.begin() + static_cast<std::ptrdiff_t>(plan.byte_offsets[i] / sizeof(float)),
                network.layout().lifetimes[i].byte_size / sizeof(float), true);
        size_t guards = 0, broken = 0;
        for (size_t i = 0; i < memory.size(); ++i) {
            if (owned[i]) continue;
            ++guards;
            broken += memory[i] != kCanary;
        }
        EXPECT_GE(guards, kGuardByteSize / sizeof(float)) << item.name;
        EXPECT_EQ(broken, 0u) << item.name;
    }
}

INSTANTIATE_TEST_SUITE_P(Convolutions, Guards,
                         testing::Values(ConvPolicy::kDirect, ConvPolicy::kGemm),
                         [](const auto& info) {
                             return info.param == ConvPolicy::kDirect ? "direct" : "clblast";
                         });

TEST(Structs, have_the_same_size_on_both_sides) {
    const Device& device = device_with_lanes(0);
    cl::Kernel kernel = make_kernel(build_program(device, "nn_ops.cl"), "nn_struct_sizes");
    const std::vector<int> expected{sizeof(NnRows),    sizeof(NnConv),    sizeof(NnPhase),
                                    sizeof(NnColumns), sizeof(NnScatter), sizeof(NnMoments),
                                    sizeof(NnEncode),  sizeof(NnDecode)};
    std::vector<int> sizes(expected.size());
    const cl::Buffer buffer = make_buffer(device, sizes.size() * sizeof(int), "sizes");
    launch(device, kernel, cl::NDRange(1), cl::NDRange(1), buffer);
    read_buffer(device, buffer, sizes, "sizes");
    EXPECT_EQ(sizes, expected);
}

}  // namespace
}  // namespace pave::nn
