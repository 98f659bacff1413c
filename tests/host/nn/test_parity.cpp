// Every operation and two U-Nets against torch, on all lane widths and both convolutions.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include "host/nn/network.h"
#include "tests/host/nn/fixtures.h"

namespace pave::nn {
namespace {

// The stored outputs are torch's in double precision; this is what fp32 may lose in these depths.
constexpr double kTolerance = 1e-4;

/// Runs input 0.. of `item` through its network and compares each stored node that the network has
/// in memory.
int compare(const FixtureCase& item, Network& network, bool layers) {
    int compared = 0;
    for (int i = 0; i < item.inputs; ++i) {
        network.prepare(item.width, item.height, layers);
        network.write_input(item.input(i));
        const auto expected = item.outputs(i);
        network.enqueue([&](int value) {
            const std::string& name = network.graph().nodes[static_cast<size_t>(value)].name;
            const auto found = expected.find(name);
            if (found == expected.end()) return;
            ++compared;
            EXPECT_LE(largest_difference(network.read(value), found->second), kTolerance)
                << item.name << ", input " << i << ", node " << name << ", layers " << layers;
        });
    }
    return compared;
}

struct Setting {
    int lanes;
    ConvPolicy policy;
};

class Parity : public testing::TestWithParam<Setting> {};

TEST_P(Parity, every_node_equals_torch) {
    const Device& device = device_with_lanes(GetParam().lanes);
    for (const FixtureCase& item : fixture_cases()) {
        // Without lanes the driver chooses work-group sizes, and PoCL compiles anew for each.
        if (GetParam().lanes == 1 && item.name.find("k4s2p1") == std::string::npos &&
            item.name != "instance_affine" && item.name != "upsample")
            continue;
        Network network(device, item.schema().graph, {GetParam().policy, 0});
        EXPECT_GE(compare(item, network, true), 1) << item.name;
    }
}

INSTANTIATE_TEST_SUITE_P(
    Settings, Parity,
    testing::Values(Setting{0, ConvPolicy::kDirect}, Setting{0, ConvPolicy::kGemm},
                    Setting{1, ConvPolicy::kDirect}, Setting{1, ConvPolicy::kGemm},
                    Setting{4, ConvPolicy::kDirect}, Setting{16, ConvPolicy::kDirect}),
    [](const auto& info) {
        return "lanes" + std::to_string(info.param.lanes) +
               (info.param.policy == ConvPolicy::kDirect ? "_direct" : "_clblast");
    });

TEST(Parity, fused_activations_change_no_bit) {
    for (const char* name : {"unet_batch", "unet_instance", "norm_folded", "joins", "hazards"}) {
        const FixtureCase& item = fixture_case(name);
        Network network(device_with_lanes(0), item.schema().graph, {ConvPolicy::kDirect, 0});
        EXPECT_GE(compare(item, network, false), 1) << name;
        for (bool layers : {false, true}) {
            network.prepare(item.width, item.height, layers);
            network.write_input(item.input(0));
            network.enqueue();
            static std::vector<float> fused;
            const std::vector<float> result = network.read(network.graph().result);
            if (!layers)
                fused = result;
            else
                EXPECT_EQ(fused, result) << name;
        }
    }
}

TEST(Parity, layers_name_every_node_but_folded_convolutions) {
    const FixtureCase& item = fixture_case("unet_batch");
    Network network(device_with_lanes(0), item.schema().graph, {ConvPolicy::kDirect, 0});
    network.prepare(item.width, item.height, true);
    network.write_input(item.input(0));
    std::set<std::string> seen;
    network.enqueue(
        [&](int value) { seen.insert(network.graph().nodes[static_cast<size_t>(value)].name); });
    std::set<std::string> expected{"input"};
    const auto& nodes = item.document.at("nodes");
    for (size_t i = 0; i < nodes.size(); ++i)
        if (i + 1 == nodes.size() || nodes[i + 1].at("op") != "batch_norm")
            expected.insert(nodes[i].at("name"));
    EXPECT_EQ(seen, expected);
}

}  // namespace
}  // namespace pave::nn
