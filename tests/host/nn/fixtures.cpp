// The stored networks of tests/data/nn, and run folders written for one test.
// SPDX-License-Identifier: BSD-3-Clause
#include "tests/host/nn/fixtures.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <sstream>
#include <stdexcept>

#include "host/device/cl.h"
#include "host/nn/file.h"
#include "pave/hash.h"

namespace pave::nn {
namespace {

const std::string kFolder = std::string(PAVE_TEST_DATA) + "/nn/";
constexpr size_t kFixtureByteLimit = 4u << 20;

std::string text_of(const std::vector<std::byte>& bytes) {
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

}  // namespace

const std::map<std::string, Tensor>& fixture_tensors() {
    static const std::map<std::string, Tensor> tensors = read_safetensors(
        read_file(kFolder + "fixtures.safetensors", kFixtureByteLimit), "fixtures");
    return tensors;
}

const std::vector<FixtureCase>& fixture_cases() {
    static const std::vector<FixtureCase> cases = [] {
        const auto file =
            nlohmann::json::parse(text_of(read_file(kFolder + "fixtures.json", kFixtureByteLimit)));
        std::vector<FixtureCase> all;
        for (const auto& item : file.at("cases"))
            all.push_back({item.at("name"), item.at("width"), item.at("height"), item.at("inputs"),
                           item.at("layers"), item.at("document")});
        return all;
    }();
    return cases;
}

const FixtureCase& fixture_case(const std::string& name) {
    for (const FixtureCase& item : fixture_cases())
        if (item.name == name) return item;
    throw std::runtime_error("no fixture " + name);
}

Schema FixtureCase::schema() const {
    return read_schema(document.dump(), name, tensors_of(document, fixture_tensors()));
}

std::vector<float> FixtureCase::input(int index) const {
    return fixture_tensors().at(name + "/in/" + std::to_string(index)).values;
}

std::map<std::string, std::vector<float>> FixtureCase::outputs(int index) const {
    std::map<std::string, std::vector<float>> found;
    const std::string prefix = name + "/out/" + std::to_string(index) + "/";
    for (const auto& [key, tensor] : fixture_tensors())
        if (key.starts_with(prefix)) found[key.substr(prefix.size())] = tensor.values;
    return found;
}

std::string safetensors_bytes(const std::map<std::string, Tensor>& tensors) {
    nlohmann::json header = nlohmann::json::object();
    std::string data;
    for (const auto& [name, tensor] : tensors) {
        const size_t begin = data.size();
        data.append(reinterpret_cast<const char*>(tensor.values.data()),
                    tensor.values.size() * sizeof(float));
        header[name] = {
            {"dtype", "F32"}, {"shape", tensor.shape}, {"data_offsets", {begin, data.size()}}};
    }
    const std::string text = header.dump();
    std::string bytes(8, '\0');
    for (size_t i = 0; i < 8; ++i) bytes[i] = static_cast<char>(text.size() >> (8 * i) & 0xff);
    return bytes + text + data;
}

TemporaryFolder::TemporaryFolder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "pave-nn-XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("no temporary folder");
    path_ = pattern;
}

TemporaryFolder::~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
}

void TemporaryFolder::write(const std::string& name, const std::string& bytes) const {
    std::ofstream file(path_ / name, std::ios::binary);
    file << bytes;
    if (!file.flush()) throw std::runtime_error("cannot write " + name);
}

std::string TemporaryFolder::read(const std::string& name) const {
    std::ifstream file(path_ / name, std::ios::binary);
    std::ostringstream text;
    text << file.rdbuf();
    return text.str();
}

void write_run(const TemporaryFolder& folder, nlohmann::json document,
               const std::map<std::string, Tensor>& tensors) {
    const std::string weights = safetensors_bytes(tensors);
    folder.write("generator.safetensors", weights);
    document["weights"] = {{"file", "generator.safetensors"}, {"xxh3_128", hash_hex(weights)}};
    folder.write("generator.json", document.dump());
    write_run_manifest(folder);
}

void write_run_manifest(const TemporaryFolder& folder) {
    nlohmann::json hashes;
    for (const char* name : {"generator.json", "generator.safetensors"})
        hashes[name] = hash_hex(folder.read(name));
    folder.write(
        "run-manifest.json",
        nlohmann::json{{"format", "pave-run"}, {"version", 1}, {"xxh3_128", hashes}}.dump());
}

std::map<std::string, Tensor> tensors_of(const nlohmann::json& document,
                                         const std::map<std::string, Tensor>& all) {
    std::map<std::string, Tensor> tensors;
    for (const auto& node : document.at("nodes"))
        for (const char* key : {"weight", "bias", "running_mean", "running_var"})
            if (node.contains(key) && node[key].is_string())
                tensors[node[key]] = all.at(node[key].get<std::string>());
    return tensors;
}

namespace {

// Never destroyed: some drivers are gone when static objects are.
std::map<int, Device>& devices = *new std::map<int, Device>;

/// PoCL aborts if it still compiles a kernel when the process ends.
class IdleAtTheEnd : public testing::Environment {
    void TearDown() override {
        for (const auto& [lanes, device] : devices) finish(device, "the last test");
    }
};
const auto* const kIdleAtTheEnd = testing::AddGlobalTestEnvironment(new IdleAtTheEnd);

}  // namespace

const Device& device_with_lanes(int lanes) {
    if (const auto found = devices.find(lanes); found != devices.end()) return found->second;
    const char* before = std::getenv("PAVE_LANES");
    const std::string kept = before == nullptr ? "" : before;
    if (lanes != 0) setenv("PAVE_LANES", std::to_string(lanes).c_str(), 1);
    Device device = Device::select();
    if (before == nullptr)
        unsetenv("PAVE_LANES");
    else
        setenv("PAVE_LANES", kept.c_str(), 1);
    return devices.emplace(lanes, std::move(device)).first->second;
}

double largest_difference(const std::vector<float>& a, const std::vector<float>& b) {
    if (a.size() != b.size()) return std::numeric_limits<double>::infinity();
    double largest = 0.0;
    for (size_t i = 0; i < a.size(); ++i) {
        const double difference = std::abs(static_cast<double>(a[i]) - static_cast<double>(b[i]));
        if (!(difference <= largest)) largest = difference;
        if (std::isnan(difference)) return std::numeric_limits<double>::infinity();
    }
    return largest;
}

}  // namespace pave::nn
