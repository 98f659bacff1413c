// The network's kernels on Oclgrind, which watches every access, and on memory that holds NaN.
// SPDX-License-Identifier: BSD-3-Clause
#include <clblast.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <limits>

#include "host/nn/network.h"
#include "tests/host/nn/fixtures.h"

namespace pave::nn {
namespace {

std::vector<float> result_of(const FixtureCase& item, Network& network, float before) {
    network.prepare(item.width, item.height, false);
    const std::vector<float> memory(network.layout().memory.byte_size / sizeof(float), before);
    write_buffer(network.runtime().device(), network.arena(), memory, "what was there before");
    network.write_input(item.input(0));
    network.enqueue();
    return network.read(network.graph().result);
}

class Memory : public testing::TestWithParam<ConvPolicy> {};

TEST_P(Memory, that_was_not_written_is_not_read) {
    for (const FixtureCase& item : fixture_cases()) {
        Network network(device_with_lanes(0), item.schema().graph, {GetParam(), 0});
        const std::vector<float> zeros = result_of(item, network, 0.0f);
        const std::vector<float> nans =
            result_of(item, network, std::numeric_limits<float>::quiet_NaN());
        EXPECT_EQ(zeros, nans) << item.name;
    }
}

INSTANTIATE_TEST_SUITE_P(Convolutions, Memory,
                         testing::Values(ConvPolicy::kDirect, ConvPolicy::kGemm),
                         [](const auto& info) {
                             return info.param == ConvPolicy::kDirect ? "direct" : "clblast";
                         });

/// Every operation on small odd sizes, in the lanes and the convolution that the environment says;
/// what the tests below run.
TEST(Child, runs_every_operation) {
    const char* lanes = std::getenv("PAVE_CHILD_LANES");
    if (lanes == nullptr) return;
    for (const FixtureCase& item : fixture_cases()) {
        if (item.width * item.height > 256 || item.inputs > 1) continue;
        Network network(device_with_lanes(std::stoi(lanes)), item.schema().graph,
                        {conv_policy(), 0});
        network.prepare(item.width, item.height, true);
        network.write_input(item.input(0));
        network.enqueue();
        const std::string& name =
            network.graph().nodes[static_cast<size_t>(network.graph().result)].name;
        EXPECT_LE(
            largest_difference(network.read(network.graph().result), item.outputs(0).at(name)),
            1e-4)
            << item.name;
    }
    clblast::ClearCache();  // its static objects would outlive Oclgrind's
}

class Oclgrind : public testing::TestWithParam<std::string> {};
INSTANTIATE_TEST_SUITE_P(Settings, Oclgrind,
                         testing::Values("PAVE_CHILD_LANES=1 PAVE_CONV=direct",
                                         "PAVE_CHILD_LANES=4 PAVE_CONV=direct",
                                         "PAVE_CHILD_LANES=16 PAVE_CONV=direct",
                                         "PAVE_CHILD_LANES=4 PAVE_CONV=clblast"),
                         [](const auto& info) { return "setting" + std::to_string(info.index); });

// Not --uninitialized: Oclgrind 21.10 takes values that nn_encode has written for such; the test
// of memory that holds NaN stands in for it.
TEST_P(Oclgrind, finds_nothing) {
    TemporaryFolder folder;
    const std::string self = std::filesystem::canonical("/proc/self/exe").string();
    const std::string command =
        GetParam() +
        " PAVE_NO_CACHE=1 PAVE_DEVICE=Oclgrind timeout 300 oclgrind --build-options "
        "-cl-opt-disable --data-races --log '" +
        folder.path() + "/log' '" + self + "' --gtest_filter=Child.runs_every_operation >'" +
        folder.path() + "/output' 2>&1";
    const int status = std::system(command.c_str());
    EXPECT_EQ(status, 0) << command << "\n" << folder.read("output").substr(0, 4000);
    EXPECT_NE(folder.read("output").find("[  PASSED  ] 1 test"), std::string::npos);
    EXPECT_EQ(folder.read("log").substr(0, 4000), "") << command;
}

}  // namespace
}  // namespace pave::nn
