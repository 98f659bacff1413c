// generator.json to Schema: keys, types, ranges, the order of the nodes and their tensors.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <limits>

#include "host/nn/fields.h"
#include "host/nn/file.h"
#include "host/nn/graph.h"
#include "pave/error.h"

namespace pave::nn {
namespace {

using nlohmann::json;
constexpr double kFloatMax = std::numeric_limits<float>::max();
constexpr double kFloatMin = std::numeric_limits<float>::min();
constexpr int kFormatVersion = 1;
constexpr size_t kMaxInputs = 64;

const std::map<std::string, Op>& op_names() {
    static const std::map<std::string, Op> names{{"conv2d", Op::kConv2d},
                                                 {"conv_transpose2d", Op::kConvTranspose2d},
                                                 {"batch_norm", Op::kBatchNorm},
                                                 {"instance_norm", Op::kInstanceNorm},
                                                 {"leaky_relu", Op::kLeakyRelu},
                                                 {"relu", Op::kRelu},
                                                 {"sigmoid", Op::kSigmoid},
                                                 {"tanh", Op::kTanh},
                                                 {"concat", Op::kConcat},
                                                 {"add", Op::kAdd},
                                                 {"mul", Op::kMul},
                                                 {"slice_channels", Op::kSliceChannels},
                                                 {"upsample_nearest", Op::kUpsampleNearest}};
    return names;
}

/// Reads one node; its inputs stay names until the nodes are sorted.
class NodeReader {
   public:
    NodeReader(std::map<std::string, Tensor>& tensors, const std::string& place)
        : tensors_(tensors), place_(place) {}

    Node read(const json& object, std::vector<std::string>& input_names) const {
        Node node;
        node.name = Fields(object, place_).name("name");
        Fields fields(object, place_ + ": node '" + node.name + "'");
        fields.any("name");
        const std::string op = fields.text("op");
        const auto known = op_names().find(op);
        if (known == op_names().end())
            fields.fail("unknown op '" + shown(op) + "'; known: " + list_of_ops());
        node.op = known->second;
        for (const json& name : fields.array("inputs", kMaxInputs)) {
            if (!name.is_string()) fields.fail("inputs must be names of nodes");
            input_names.push_back(name.get<std::string>());
        }
        check_input_count(node.op, input_names.size(), fields);
        read_parameters(node, fields);
        fields.end();
        return node;
    }

   private:
    static std::string list_of_ops() {
        std::string list;
        for (const auto& [name, op] : op_names()) list += (list.empty() ? "" : ", ") + name;
        return list;
    }

    static void check_input_count(Op op, size_t count, const Fields& fields) {
        if (op == Op::kConcat ? count < 1 : count != (op == Op::kAdd || op == Op::kMul ? 2u : 1u))
            fields.fail("has " + std::to_string(count) + " inputs, which its op does not take");
    }

    void read_parameters(Node& node, Fields& fields) const {
        switch (node.op) {
            case Op::kConv2d:
            case Op::kConvTranspose2d:
                return read_convolution(node, fields);
            case Op::kBatchNorm:
            case Op::kInstanceNorm:
                return read_norm(node, fields);
            case Op::kLeakyRelu:
                node.slope = fields.number("slope", -kFloatMax, kFloatMax);
                return;
            case Op::kSliceChannels:
                node.first = fields.integer("first", 0, kMaxChannels);
                node.count = fields.integer("count", 1, kMaxChannels);
                return;
            case Op::kUpsampleNearest:
                node.scale = fields.integer("scale", 1, kMaxKernelExtent);
                return;
            default:
                return;
        }
    }

    void read_convolution(Node& node, Fields& fields) const {
        node.stride = fields.integer("stride", 1, kMaxKernelExtent);
        node.padding = fields.integer("padding", 0, kMaxKernelExtent);
        Tensor weight = take_tensor(fields, "weight");
        if (weight.shape.size() != 4) fields.fail("weight must have 4 dimensions");
        for (size_t i = 0; i < 4; ++i)
            if (weight.shape[i] < 1 || weight.shape[i] > (i < 2 ? kMaxChannels : kMaxKernelExtent))
                fields.fail("weight has a dimension of " + std::to_string(weight.shape[i]));
        const bool transposed = node.op == Op::kConvTranspose2d;
        node.out_channels = static_cast<int>(weight.shape[transposed ? 1 : 0]);
        node.weight_in_channels = static_cast<int>(weight.shape[transposed ? 0 : 1]);
        node.kernel_h = static_cast<int>(weight.shape[2]);
        node.kernel_w = static_cast<int>(weight.shape[3]);
        node.weight = std::move(weight.values);
        if (!fields.any("bias").is_null()) node.bias = vector_of(fields, "bias", node.out_channels);
    }

    void read_norm(Node& node, Fields& fields) const {
        const bool batch = node.op == Op::kBatchNorm;
        node.eps = fields.number("eps", 0.0, 1e6);
        // Affine parameters may be absent (null); the length then comes from the input or the
        // statistics.
        for (const char* key : {"weight", "bias", "running_mean", "running_var"}) {
            const bool statistics = key[0] == 'r';
            if (statistics && !batch) continue;
            if (fields.any(key).is_null() && !statistics) continue;
            std::vector<float> values = vector_of(fields, key, node.weight_in_channels);
            node.weight_in_channels = static_cast<int>(values.size());
            (std::string(key) == "weight" ? node.weight
             : std::string(key) == "bias" ? node.bias
             : key[8] == 'm'              ? node.mean
                                          : node.var) = std::move(values);
        }
        for (float var : node.var)
            if (!(var + node.eps > 0.0f)) fields.fail("running_var + eps must be above 0");
    }

    /// The tensor that `key` names, taken out: one used twice would let a small file ask for much
    /// memory.
    Tensor take_tensor(Fields& fields, const std::string& key) const {
        const std::string name = fields.text(key);
        const auto found = tensors_.find(name);
        if (found == tensors_.end())
            fields.fail("the weights have no tensor '" + shown(name) +
                        "', or another node uses it");
        Tensor tensor = std::move(found->second);
        tensors_.erase(found);
        return tensor;
    }

    /// Values of a one-dimensional tensor of `length` items; any length if that is 0.
    std::vector<float> vector_of(Fields& fields, const std::string& key, int length) const {
        Tensor found = take_tensor(fields, key);
        if (found.shape.size() != 1 || found.shape[0] < 1 || found.shape[0] > kMaxChannels ||
            (length != 0 && found.shape[0] != length))
            fields.fail(key + " must be a list of " +
                        (length != 0 ? std::to_string(length) : "1 to 65536") + " numbers");
        return std::move(found.values);
    }

    std::map<std::string, Tensor>& tensors_;
    const std::string& place_;
};

/// Nodes in an order that has each after its inputs; among those that are ready the file's order.
Graph sort_nodes(std::vector<Node> nodes, const std::vector<std::vector<std::string>>& input_names,
                 const std::string& result, const std::string& file) {
    std::map<std::string, int> position_of{{"input", -1}};
    for (size_t i = 0; i < nodes.size(); ++i)
        if (!position_of.emplace(nodes[i].name, static_cast<int>(i)).second)
            throw InputError(file + ": node '" + nodes[i].name + "': the name is taken");
    std::vector<std::vector<int>> consumers(nodes.size());
    std::vector<int> missing(nodes.size(), 0);
    std::vector<int> ready;
    for (size_t i = 0; i < nodes.size(); ++i) {
        for (const std::string& name : input_names[i]) {
            const auto found = position_of.find(name);
            if (found == position_of.end())
                throw InputError(file + ": node '" + nodes[i].name + "': no node is called '" +
                                 shown(name) + "'");
            if (found->second < 0) continue;
            consumers[static_cast<size_t>(found->second)].push_back(static_cast<int>(i));
            ++missing[i];
        }
        if (missing[i] == 0) ready.push_back(static_cast<int>(i));
    }
    std::make_heap(ready.begin(), ready.end(), std::greater<>());
    Graph graph;
    graph.file = file;
    graph.nodes.emplace_back().name = "input";
    std::vector<int> index_of(nodes.size(), -1);
    while (!ready.empty()) {
        std::pop_heap(ready.begin(), ready.end(), std::greater<>());
        const size_t i = static_cast<size_t>(ready.back());
        ready.pop_back();
        index_of[i] = static_cast<int>(graph.nodes.size());
        for (const std::string& name : input_names[i]) {
            const int position = position_of.at(name);
            nodes[i].inputs.push_back(position < 0 ? 0 : index_of[static_cast<size_t>(position)]);
        }
        graph.nodes.push_back(std::move(nodes[i]));
        for (int consumer : consumers[i])
            if (--missing[static_cast<size_t>(consumer)] == 0) {
                ready.push_back(consumer);
                std::push_heap(ready.begin(), ready.end(), std::greater<>());
            }
    }
    for (size_t i = 0; i < nodes.size(); ++i)
        if (index_of[i] < 0)
            throw InputError(file + ": node '" + nodes[i].name + "': depends on itself (cycle)");
    const auto found = position_of.find(result);
    if (found == position_of.end() || found->second < 0)
        throw InputError(file + ": result: no node is called '" + shown(result) + "'");
    graph.result = index_of[static_cast<size_t>(found->second)];
    return graph;
}

InputChannel read_input(const json& object, const std::string& place) {
    InputChannel input;
    input.channel = Fields(object, place).name("channel");
    Fields fields(object, place + " '" + input.channel + "'");
    fields.any("channel");
    input.planes = fields.integer("planes", 1, 64);
    if (fields.has("repeat")) input.repeat = fields.integer("repeat", 1, 64);
    const std::string encode = fields.text("encode");
    if (encode == "unit") {
        input.encode = Encode::kUnit;
    } else if (encode == "signed") {
        input.encode = Encode::kSigned;
    } else if (encode == "radiance") {
        input.encode = Encode::kRadiance;
    } else if (encode == "depth") {
        input.encode = Encode::kDepth;
        input.scale = fields.number("scale", kFloatMin, kFloatMax);
    } else if (encode == "position") {
        input.encode = Encode::kPosition;
        const json& center = fields.array("center", 3);
        if (center.size() != 3 || input.planes != 3) fields.fail("center and planes must be 3");
        for (size_t i = 0; i < 3; ++i) {
            if (!center[i].is_number() || std::abs(center[i].get<double>()) > kFloatMax)
                fields.fail("center must be 3 numbers");
            input.center[i] = center[i].get<float>();
        }
        input.radius = fields.number("radius", kFloatMin, kFloatMax);
    } else {
        fields.fail("unknown encode '" + shown(encode) +
                    "'; known: unit, signed, radiance, depth, position");
    }
    fields.end();
    return input;
}

void read_nodes(Schema& schema, Fields& fields, std::map<std::string, Tensor>& tensors,
                const std::string& file) {
    const json& objects = fields.array("nodes", kMaxNodes);
    std::vector<Node> nodes;
    std::vector<std::vector<std::string>> input_names;
    const NodeReader reader(tensors, file);
    for (const json& object : objects) {
        input_names.emplace_back();
        nodes.push_back(reader.read(object, input_names.back()));
    }
    schema.graph = sort_nodes(std::move(nodes), input_names, fields.text("result"), file);
    for (const InputChannel& input : schema.inputs)
        schema.graph.input_channels += input.planes * input.repeat;
}

void read_header(Fields& fields) {
    if (fields.text("format") != "pave-generator") fields.fail("format must be 'pave-generator'");
    const int version = fields.integer("version", 0, std::numeric_limits<int>::max());
    if (version != kFormatVersion)
        fields.fail("version " + std::to_string(version) + " is not known, only " +
                    std::to_string(kFormatVersion));
}

}  // namespace

WeightsReference read_weights_reference(std::string_view text, const std::string& file) {
    const json document = parse_json(text, file);
    Fields fields(document, file);
    read_header(fields);
    Fields weights(fields.any("weights"), file + ": weights");
    WeightsReference reference{weights.name("file"), weights.text("xxh3_128")};
    weights.end();
    if (reference.hash.size() != 32 ||
        reference.hash.find_first_not_of("0123456789abcdef") != std::string::npos)
        weights.fail("xxh3_128 must be 32 lower-case hexadecimal digits");
    return reference;
}

Schema read_schema(std::string_view text, const std::string& file,
                   std::map<std::string, Tensor> tensors) {
    const json document = parse_json(text, file);
    Fields fields(document, file);
    read_header(fields);
    fields.any("weights");
    Schema schema;
    for (const json& object : fields.array("inputs", kMaxInputs))
        schema.inputs.push_back(read_input(object, file + ": input"));
    if (schema.inputs.empty()) fields.fail("inputs must not be empty");
    Fields transfer(fields.any("transfer"), file + ": transfer");
    if (transfer.text("name") != "srgb_log") transfer.fail("name must be 'srgb_log'");
    schema.peak = transfer.number("peak", kFloatMin, kFloatMax);
    transfer.end();
    Fields output(fields.any("output"), file + ": output");
    schema.output_channel = output.name("channel");
    const int output_planes = output.integer("planes", 1, 64);
    if (output.text("decode") != "radiance") output.fail("decode must be 'radiance'");
    output.end();
    schema.multiple = fields.integer("multiple", 1, 4096);
    if (fields.has("training")) fields.any("training");  // for people; nothing is drawn from it
    read_nodes(schema, fields, tensors, file);
    fields.end();
    schema.graph.output_channels = output_planes;
    // Most graphs that do not fit are told here; Network looks again at every size it is asked for.
    for (int size : {schema.multiple, 2 * schema.multiple})
        infer_image_extents(schema.graph, size, size);
    return schema;
}

}  // namespace pave::nn
