// Files that are damaged or made to harm: every one ends as an InputError that names the file.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <algorithm>
#include <cstring>

#include "host/nn/run_folder.h"
#include "pave/error.h"
#include "pave/generator.h"
#include "pave/hash.h"
#include "tests/host/nn/fixtures.h"

namespace pave::nn {
namespace {

using nlohmann::json;

/// What `call` threw as an InputError, "" if it threw nothing.
template <class Call>
std::string input_error(Call&& call) {
    try {
        call();
    } catch (const InputError& error) {
        EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
        return error.what();
    }
    return {};
}

std::string with_header(const std::string& header, const std::string& data = std::string(8, '\0')) {
    std::string bytes(8, '\0');
    const uint64_t length = header.size();
    std::memcpy(bytes.data(), &length, 8);
    return bytes + header + data;
}

std::string tensors_error(const std::string& bytes) {
    return input_error([&] {
        read_safetensors(std::as_bytes(std::span(bytes.data(), bytes.size())), "w.safetensors");
    });
}

TEST(Safetensors, takes_what_is_well_formed) {
    EXPECT_EQ(
        tensors_error(with_header(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})")),
        "");
    EXPECT_EQ(tensors_error(with_header(
                  R"({"__metadata__":{"x":"y"},"a":{"dtype":"F32","shape":[1,1],)"
                  R"("data_offsets":[4,8]},"b":{"dtype":"F32","shape":[],"data_offsets":[0,4]}})")),
              "");
    EXPECT_EQ(tensors_error(with_header("{}", "")), "");
}

TEST(Safetensors, refuses_what_is_not) {
    const auto one = [](const std::string& fields) {
        return with_header(std::string("{\"a\":{").append(fields).append("}}"));
    };
    const std::map<std::string, std::string> hostile{
        {"empty", ""},
        {"no header", std::string(7, '\0')},
        {"header beyond the file", std::string("\x20\0\0\0\0\0\0\0{}", 10)},
        {"header of 2^63", std::string("\0\0\0\0\0\0\0\x80{}", 10)},
        {"header above 1 MiB", with_header(std::string((1 << 20) + 1, ' '))},
        {"not JSON", with_header("{\"a\":")},
        {"not UTF-8", with_header("{\"\xff\":1}")},
        {"a million brackets", with_header(std::string(1 << 20, '['))},
        {"nested objects", with_header(std::string(1000, '{'))},
        {"an array", with_header("[]")},
        {"other dtype", one(R"("dtype":"F16","shape":[4],"data_offsets":[0,8])")},
        {"extra key", one(R"("dtype":"F32","shape":[2],"data_offsets":[0,8],"x":1)")},
        {"no dtype", one(R"("shape":[2],"data_offsets":[0,8])")},
        {"negative shape", one(R"("dtype":"F32","shape":[-2],"data_offsets":[0,8])")},
        {"fractional shape", one(R"("dtype":"F32","shape":[2.0],"data_offsets":[0,8])")},
        {"shape 2^64 overflow",
         one(R"("dtype":"F32","shape":[4294967296,4294967296],"data_offsets":[0,8])")},
        {"shape product 0 of large",
         one(R"("dtype":"F32","shape":[9223372036854775807,0],"data_offsets":[0,8])")},
        {"rank 9", one(R"("dtype":"F32","shape":[1,1,1,1,1,1,1,1,2],"data_offsets":[0,8])")},
        {"offsets beyond the file", one(R"("dtype":"F32","shape":[4],"data_offsets":[0,16])")},
        {"offsets backwards", one(R"("dtype":"F32","shape":[2],"data_offsets":[8,0])")},
        {"offsets negative", one(R"("dtype":"F32","shape":[2],"data_offsets":[-8,0])")},
        {"offsets do not fit the shape", one(R"("dtype":"F32","shape":[1],"data_offsets":[0,8])")},
        {"one offset", one(R"("dtype":"F32","shape":[2],"data_offsets":[8])")},
        {"hole at the start", one(R"("dtype":"F32","shape":[1],"data_offsets":[4,8])")},
        {"bytes left over", one(R"("dtype":"F32","shape":[1],"data_offsets":[0,4])")},
        {"overlap", with_header(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},)"
                                R"("b":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}})")},
        {"infinity", with_header(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})",
                                 std::string("\0\0\x80\x7f\0\0\0\0", 8))},
        {"not a number", with_header(R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})",
                                     std::string("\0\0\xc0\x7f\0\0\0\0", 8))}};
    for (const auto& [name, bytes] : hostile)
        EXPECT_EQ(tensors_error(bytes).substr(0, 13), "w.safetensors") << name;
}

TEST(Safetensors, survives_every_flip_and_cut_of_its_header) {
    const std::string good =
        safetensors_bytes(tensors_of(fixture_case("norm_folded").document, fixture_tensors()));
    uint64_t header = 0;
    std::memcpy(&header, good.data(), 8);
    for (size_t cut = 0; cut < 8 + header + 4; ++cut)
        EXPECT_NE(tensors_error(good.substr(0, cut)), "") << "cut at " << cut;
    int refused = 0;
    for (size_t byte = 0; byte < 8 + header; ++byte)
        for (int bit : {0, 3, 7}) {
            std::string bad = good;
            bad[byte] = static_cast<char>(bad[byte] ^ (1 << bit));
            refused += !tensors_error(bad).empty();  // a flip in a name is another valid file
        }
    EXPECT_GT(refused, static_cast<int>(header));
}

// ---- generator.json ----

json unet() { return fixture_case("unet_batch").document; }

std::string schema_error(const json& document) {
    return input_error([&] {
        read_schema(document.dump(), "generator.json", tensors_of(unet(), fixture_tensors()));
    });
}

json& node_of(json& document, const std::string& op) {
    for (json& node : document["nodes"])
        if (node["op"] == op) return node;
    throw std::runtime_error("no " + op);
}

struct Mutation {
    const char* name;
    void (*apply)(json&);
    const char* says;  // part of the message
};

const Mutation kMutations[] = {
    {"format", [](json& d) { d["format"] = "onnx"; }, "format"},
    {"version 2", [](json& d) { d["version"] = 2; }, "version 2"},
    {"version text", [](json& d) { d["version"] = "1"; }, "version"},
    {"no version", [](json& d) { d.erase("version"); }, "version is missing"},
    {"unknown key", [](json& d) { d["dilation"] = 1; }, "unknown key 'dilation'"},
    {"unknown key of a node", [](json& d) { node_of(d, "conv2d")["groups"] = 2; },
     "node 'n0.conv2d': unknown key 'groups'"},
    {"unknown op", [](json& d) { d["nodes"][1]["op"] = "eval"; }, "unknown op 'eval'"},
    {"op with a newline", [](json& d) { d["nodes"][1]["op"] = "a\nb"; }, "unknown op 'a?b'"},
    {"op a number", [](json& d) { d["nodes"][1]["op"] = 3; }, "op must be a string"},
    {"name a path", [](json& d) { d["nodes"][1]["name"] = "../x"; }, "no valid name"},
    {"name doubled", [](json& d) { d["nodes"][1]["name"] = d["nodes"][0]["name"]; },
     "the name is taken"},
    {"name input", [](json& d) { d["nodes"][1]["name"] = "input"; }, "the name is taken"},
    {"unknown input", [](json& d) { d["nodes"][1]["inputs"] = {"nobody"}; },
     "no node is called 'nobody'"},
    {"no inputs", [](json& d) { d["nodes"][1]["inputs"] = json::array(); }, "0 inputs"},
    {"two inputs",
     [](json& d) {
         d["nodes"][0]["inputs"] = {"input", "input"};
     },
     "2 inputs"},
    {"its own input", [](json& d) { d["nodes"][1]["inputs"] = {d["nodes"][1]["name"]}; }, "cycle"},
    {"a cycle", [](json& d) { d["nodes"][0]["inputs"] = {d["nodes"][3]["name"]}; }, "cycle"},
    {"unknown result", [](json& d) { d["result"] = "nobody"; }, "result"},
    {"result the input", [](json& d) { d["result"] = "input"; }, "result"},
    {"result of another size", [](json& d) { d["result"] = d["nodes"][0]["name"]; },
     "not the output's planes"},
    {"missing tensor", [](json& d) { d["nodes"][0]["weight"] = "nothing"; }, "no tensor 'nothing'"},
    {"tensor used twice", [](json& d) { d["nodes"][2]["weight"] = d["nodes"][0]["weight"]; },
     "another node uses it"},
    {"weight null", [](json& d) { d["nodes"][0]["weight"] = nullptr; }, "weight must be a string"},
    {"weight of rank 1", [](json& d) { d["nodes"][0]["weight"] = d["nodes"][0]["bias"]; },
     "4 dimensions"},
    {"bias of rank 4", [](json& d) { d["nodes"][0]["bias"] = d["nodes"][2]["weight"]; },
     "bias must be a list"},
    {"bias of another length",
     [](json& d) { d["nodes"][0]["bias"] = node_of(d, "batch_norm")["bias"]; },
     "bias must be a list of 8"},
    {"no bias key", [](json& d) { d["nodes"][0].erase("bias"); }, "bias is missing"},
    {"no statistics", [](json& d) { node_of(d, "batch_norm")["running_var"] = nullptr; },
     "running_var must be a string"},
    {"stride 0", [](json& d) { d["nodes"][0]["stride"] = 0; }, "stride must be"},
    {"stride 2^32 + 2", [](json& d) { d["nodes"][0]["stride"] = 4294967298; }, "stride must be"},
    {"stride 2.0", [](json& d) { d["nodes"][0]["stride"] = 2.0; }, "stride must be"},
    {"padding negative", [](json& d) { d["nodes"][0]["padding"] = -1; }, "padding must be"},
    {"slope text", [](json& d) { node_of(d, "leaky_relu")["slope"] = "0.2"; },
     "slope must be a number"},
    {"slope huge", [](json& d) { node_of(d, "leaky_relu")["slope"] = 1e300; },
     "slope is out of range"},
    {"eps negative", [](json& d) { node_of(d, "batch_norm")["eps"] = -1; }, "eps is out of range"},
    {"slice too long", [](json& d) { node_of(d, "slice_channels")["count"] = 9; }, "ends beyond"},
    {"slice of nothing", [](json& d) { node_of(d, "slice_channels")["count"] = 0; },
     "count must be"},
    {"more planes than weights", [](json& d) { d["inputs"][0]["planes"] = 11; },
     "its weights are for 10 channels"},
    {"planes 0", [](json& d) { d["inputs"][0]["planes"] = 0; }, "planes must be"},
    {"repeat 10^9", [](json& d) { d["inputs"][0]["repeat"] = 1000000000; }, "repeat must be"},
    {"no inputs at all", [](json& d) { d["inputs"] = json::array(); }, "inputs must not be empty"},
    {"unknown encode", [](json& d) { d["inputs"][0]["encode"] = "srgb"; }, "unknown encode 'srgb'"},
    {"depth without scale", [](json& d) { d["inputs"][0]["encode"] = "depth"; },
     "scale is missing"},
    {"depth of scale 0",
     [](json& d) {
         d["inputs"][0]["encode"] = "depth";
         d["inputs"][0]["scale"] = 0;
     },
     "scale is out of range"},
    {"unknown transfer", [](json& d) { d["transfer"]["name"] = "pq"; }, "srgb_log"},
    {"peak 0", [](json& d) { d["transfer"]["peak"] = 0; }, "peak is out of range"},
    {"unknown decode", [](json& d) { d["output"]["decode"] = "unit"; }, "decode"},
    {"multiple 0", [](json& d) { d["multiple"] = 0; }, "multiple must be"},
    {"multiple too small", [](json& d) { d["multiple"] = 1; }, "node 'n"},
    {"nodes an object", [](json& d) { d["nodes"] = json::object(); }, "nodes must be a list"},
    {"no nodes", [](json& d) { d["nodes"] = json::array(); }, "result"},
    {"node a number", [](json& d) { d["nodes"][0] = 3; }, "must be a JSON object"},
    {"too many nodes",
     [](json& d) {
         for (int i = 0; i < 2000; ++i) d["nodes"].push_back(d["nodes"][1]);
     },
     "at most 1024"},
    {"shapes that clash",
     [](json& d) {
         for (json& node : d["nodes"])
             if (node["op"] == "concat") {
                 node["inputs"][1] = "input";
                 break;
             }
     },
     "do not fit"}};

TEST(Schema, takes_the_fixtures) {
    for (const FixtureCase& item : fixture_cases())
        EXPECT_EQ(input_error([&] { item.schema(); }), "");
}

TEST(Schema, refuses_what_is_not_of_the_format) {
    for (const Mutation& mutation : kMutations) {
        json document = unet();
        mutation.apply(document);
        const std::string message = schema_error(document);
        EXPECT_NE(message.find(mutation.says), std::string::npos)
            << mutation.name << ": '" << message << "'";
        EXPECT_EQ(message.substr(0, 14), "generator.json") << mutation.name;
    }
}

TEST(Schema, every_key_is_needed_and_every_type_checked) {
    const json wrong[] = {nullptr, -1, 1e99, "x", json::array({1}), json::object()};
    const json good = unet();
    for (const auto& [key, value] : good.items()) {
        if (key == "training") continue;
        json missing = good;
        missing.erase(key);
        EXPECT_NE(schema_error(missing), "") << key;
        if (key == "weights") continue;  // read_weights_reference looks at it
        for (const json& other : wrong) {
            json changed = good;
            changed[key] = other;
            EXPECT_NE(schema_error(changed), "") << key << " = " << other;
        }
    }
}

TEST(Schema, nodes_may_come_in_any_order) {
    json document = unet();
    std::reverse(document["nodes"].begin(), document["nodes"].end());
    EXPECT_EQ(schema_error(document), "");
}

TEST(Schema, a_small_file_cannot_ask_for_much) {
    // Concats of concats double the channels 60 times.
    json document = fixture_case("unary").document;
    json nodes = json::array();
    std::string last = "input";
    for (int i = 0; i < 60; ++i) {
        const std::string name = std::string("c").append(std::to_string(i));
        nodes.push_back({{"name", name}, {"op", "concat"}, {"inputs", {last, last}}});
        last = name;
    }
    document["nodes"] = nodes;
    document["result"] = last;
    EXPECT_NE(input_error([&] { read_schema(document.dump(), "generator.json", {}); }), "");
    // Upsampling of upsampling.
    for (json& node : document["nodes"]) {
        node["op"] = "upsample_nearest";
        node["inputs"].erase(1);
        node["scale"] = 64;
    }
    EXPECT_NE(input_error([&] { read_schema(document.dump(), "generator.json", {}); }), "");
}

/// A network that enlarges by 63 and takes every 64th pixel: of the input's size for images of 1 x
/// 1 and 2 x 2, of another at 64 x 64.
json nearly_fitting() {
    json document = unet();
    document["inputs"] = json::array({{{"channel", "depth"}, {"planes", 1}, {"encode", "unit"}}});
    document["output"]["planes"] = 1;
    document["multiple"] = 1;
    document["nodes"] = json::array(
        {{{"name", "up"}, {"op", "upsample_nearest"}, {"inputs", {"input"}}, {"scale", 63}},
         {{"name", "down"},
          {"op", "conv2d"},
          {"inputs", {"up"}},
          {"weight", "w"},
          {"bias", nullptr},
          {"stride", 64},
          {"padding", 0}}});
    document["result"] = "down";
    return document;
}

TEST(Schema, a_result_that_fits_at_some_sizes_is_refused_at_others) {
    const TemporaryFolder folder;
    write_run(folder, nearly_fitting(), {{"w", {{1, 1, 1, 1}, {1.0f}}}});
    Generator generator(device_with_lanes(0), folder.path());
    EXPECT_EQ(generator.run(std::vector<float>(4, 0.5f), 2, 2), std::vector<float>(4, 0.5f));
    const std::string reason = "generator.json: node 'down': the result is 1 x 63 x 63";
    const std::vector<float> input(64 * 64);
    EXPECT_NE(input_error([&] { generator.run(input, 64, 64); }).find(reason), std::string::npos);
    Frame frame = make_frame(FrameSchema(64, 64, {{"depth", 1}, {"drawn", 1}}));
    EXPECT_NE(input_error([&] { generator.draw(frame); }).find(reason), std::string::npos);
    EXPECT_NE(input_error([&] { generator.planned_byte_size(64, 64); }).find(reason),
              std::string::npos);
}

TEST(Schema, deep_nesting_does_not_overflow_the_stack) {
    const std::string deep = std::string(200000, '[') + std::string(200000, ']');
    std::string text = unet().dump();
    text.insert(1, "\"training\":" + deep + ",");
    EXPECT_NE(
        input_error([&] { read_schema(text, "generator.json", {}); }).find("nests deeper than"),
        std::string::npos);
    EXPECT_NE(tensors_error(with_header("{\"a\":" + deep + "}")).find("nests deeper than"),
              std::string::npos);
}

// ---- Whole run folders ----

class RunFolder : public testing::Test {
   protected:
    void SetUp() override {
        write_run(folder_, fixture_case("norm_folded").document,
                  tensors_of(fixture_case("norm_folded").document, fixture_tensors()));
    }
    std::string error() {
        return input_error([&] { load_run(folder_.path()); });
    }
    TemporaryFolder folder_;
};

TEST_F(RunFolder, loads_with_its_manifest_and_not_without) {
    EXPECT_EQ(error(), "");
    EXPECT_EQ(load_run(folder_.path()).weights_version,
              hash_hex(folder_.read("generator.safetensors")));
    std::filesystem::remove(std::filesystem::path(folder_.path()) / "run-manifest.json");
    EXPECT_NE(error().find("run-manifest.json: No such file"), std::string::npos) << error();
}

TEST_F(RunFolder, names_the_file_that_is_missing) {
    for (const char* name : {"generator.safetensors", "generator.json"}) {
        std::filesystem::remove(std::filesystem::path(folder_.path()) / name);
        EXPECT_NE(error().find(std::string(name) + ": No such file"), std::string::npos) << error();
    }
    EXPECT_NE(input_error([] { load_run("/nonexistent"); }), "");
}

TEST_F(RunFolder, every_flip_of_the_weights_is_found) {
    const std::string good = folder_.read("generator.safetensors");
    for (size_t byte = 0; byte < good.size(); byte += 1 + good.size() / 400) {
        std::string bad = good;
        bad[byte] = static_cast<char>(bad[byte] ^ (1 << (byte % 8)));
        folder_.write("generator.safetensors", bad);
        EXPECT_NE(error().find("generator.safetensors: checksum"), std::string::npos) << byte;
    }
    for (size_t cut = 0; cut < good.size(); cut += 1 + good.size() / 100) {
        folder_.write("generator.safetensors", good.substr(0, cut));
        EXPECT_NE(error().find("generator.safetensors: checksum"), std::string::npos) << cut;
    }
}

TEST_F(RunFolder, every_flip_of_the_graph_is_found_and_harmless_where_the_manifest_is_forged) {
    const std::string good = folder_.read("generator.json");
    for (bool forged : {false, true}) {
        for (size_t byte = 0; byte < good.size(); byte += 1 + good.size() / 600) {
            std::string bad = good;
            bad[byte] = static_cast<char>(bad[byte] ^ (1 << (byte % 7)));
            folder_.write("generator.json", bad);
            if (forged) {
                write_run_manifest(folder_);
                error();  // either still a network or an InputError; nothing else
            } else {
                EXPECT_NE(error().find("generator.json: checksum"), std::string::npos) << byte;
            }
        }
        for (size_t cut = 0; cut < good.size(); cut += 1 + good.size() / 100) {
            folder_.write("generator.json", good.substr(0, cut));
            if (forged) write_run_manifest(folder_);
            EXPECT_NE(error(), "") << cut;
        }
        folder_.write("generator.json", good);
    }
}

TEST_F(RunFolder, refuses_bad_manifests) {
    const std::string deep = R"({"format":"pave-run","version":1,"xxh3_128":)" +
                             std::string(200000, '[') + std::string(200000, ']') + "}";
    for (const std::string& text : std::initializer_list<std::string>{
             "", "{", "[]", "{}", R"({"format":"pave-run","version":1})",
             R"({"format":"pave-run","version":2,"xxh3_128":{}})",
             R"({"format":"pave-run","version":1,"xxh3_128":[]})",
             R"({"format":"pave-run","version":1,"xxh3_128":{}})",
             R"({"format":"pave-run","version":1,"xxh3_128":{"generator.json":7}})", deep}) {
        folder_.write("run-manifest.json", text);
        EXPECT_NE(error().find("run-manifest.json"), std::string::npos) << text.substr(0, 100);
    }
}

TEST_F(RunFolder, takes_no_path_for_the_weights) {
    for (const char* name : {"../generator.safetensors", "/etc/passwd", "a/b", "", ".hidden"}) {
        json document = fixture_case("norm_folded").document;
        document["weights"] = {{"file", name}, {"xxh3_128", std::string(32, '0')}};
        folder_.write("generator.json", document.dump());
        write_run_manifest(folder_);
        EXPECT_NE(error().find("no valid name"), std::string::npos) << name;
    }
}

TEST_F(RunFolder, a_pipe_or_a_folder_in_a_files_place_is_refused_at_once) {
    const auto path = std::filesystem::path(folder_.path()) / "generator.json";
    std::filesystem::remove(path);
    std::filesystem::create_directory(path);
    EXPECT_NE(error().find("not a regular file"), std::string::npos);
    std::filesystem::remove(path);
    ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
    EXPECT_NE(error().find("not a regular file"), std::string::npos);
}

}  // namespace
}  // namespace pave::nn
