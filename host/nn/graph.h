// The exported network as data: what generator.json says, with its tensors, checked.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "host/nn/safetensors.h"

namespace pave::nn {

enum class Op : int {
    kInput,
    kConv2d,
    kConvTranspose2d,
    kBatchNorm,
    kInstanceNorm,
    kLeakyRelu,
    kRelu,
    kSigmoid,
    kTanh,
    kConcat,
    kAdd,
    kMul,
    kSliceChannels,
    kUpsampleNearest
};

/// One operation. Fields that its op does not use keep their defaults.
struct Node {
    std::string name;
    Op op = Op::kInput;
    std::vector<int> inputs;      // indices of nodes before it
    int stride = 1, padding = 0;  // convolutions; the same in both directions
    int kernel_w = 0, kernel_h = 0;
    int out_channels = 0;
    int first = 0, count = 0;  // slice_channels
    int scale = 1;             // upsample_nearest
    float slope = 0.0f;        // leaky_relu
    float eps = 0.0f;          // norms
    // conv2d (out, in, h, w), conv_transpose2d (in, out, h, w), norms (channels).
    std::vector<float> weight;
    std::vector<float> bias;       // empty: none
    std::vector<float> mean, var;  // batch_norm's running statistics
    int weight_in_channels = 0;    // what the weight expects, also the length of the norms' vectors
};

/// Nodes in an order in which each comes after its inputs; nodes[0] is the input.
struct Graph {
    std::string file;  // for errors
    std::vector<Node> nodes;
    int input_channels = 0, output_channels = 0;
    int result = 0;  // index
};

/// Size of a node's output.
struct Extent {
    int channels = 0, height = 0, width = 0;
    bool operator==(const Extent&) const = default;
};

/// Output sizes of all nodes for an input of this size. Throws InputError "FILE: node 'NAME':
/// reason" where shapes clash.
std::vector<Extent> infer_extents(const Graph& graph, int width, int height);
/// The same for a whole network: its result must be output_channels planes of this very size.
std::vector<Extent> infer_image_extents(const Graph& graph, int width, int height);

/// How a frame's channel becomes planes of the network's input.
enum class Encode : int { kUnit, kSigned, kRadiance, kDepth, kPosition };

struct InputChannel {
    std::string channel;
    int planes = 0;  // in the frame
    int repeat = 1;  // the group of planes is repeated this often
    Encode encode = Encode::kUnit;
    float scale = 1.0f;             // kDepth: scale / (scale + d)
    std::array<float, 3> center{};  // kPosition: (p - center) / radius
    float radius = 1.0f;
};

/// A whole generator.json with its weights.
struct Schema {
    std::vector<InputChannel> inputs;
    float peak = 1.0f;  // srgb_log: f(peak) is encoded as 1
    std::string output_channel;
    int multiple = 1;  // width and height are padded to multiples of it
    Graph graph;
};

// Lowering is cubic in the worst case, and that stays below a second.
inline constexpr int kMaxNodes = 1024;
inline constexpr int kMaxChannels = 65536;
inline constexpr int kMaxKernelExtent = 64;

/// Weights file and its checksum as `text` (a generator.json, called `file` in errors) states them,
/// and nothing else yet.
struct WeightsReference {
    std::string file, hash;
};
WeightsReference read_weights_reference(std::string_view text, const std::string& file);

/// The schema of `text` over `tensors`. Throws InputError "FILE: node 'NAME': reason" for whatever
/// is not version 1 of the format, e.g. an unknown op or key, a cycle, a missing tensor or one of a
/// wrong shape. A tensor serves one node.
Schema read_schema(std::string_view text, const std::string& file,
                   std::map<std::string, Tensor> tensors);

}  // namespace pave::nn
