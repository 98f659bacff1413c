// The stored networks of tests/data/nn, and run folders written for one test.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "host/nn/graph.h"
#include "pave/device.h"

namespace pave::nn {

struct FixtureCase {
    std::string name;
    int width = 0, height = 0, inputs = 0, layers = 0;
    nlohmann::json document;  // a generator.json
    /// The checked network, with its own copy of the weights.
    Schema schema() const;
    std::vector<float> input(int index) const;
    /// torch's output of each node that is stored for input `index`.
    std::map<std::string, std::vector<float>> outputs(int index) const;
};

const std::vector<FixtureCase>& fixture_cases();
const FixtureCase& fixture_case(const std::string& name);

/// All tensors of fixtures.safetensors.
const std::map<std::string, Tensor>& fixture_tensors();

/// The bytes of a safetensors file.
std::string safetensors_bytes(const std::map<std::string, Tensor>& tensors);

/// A folder that goes with the object.
class TemporaryFolder {
   public:
    TemporaryFolder();
    ~TemporaryFolder();
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;
    std::string path() const { return path_.string(); }
    void write(const std::string& name, const std::string& bytes) const;
    std::string read(const std::string& name) const;

   private:
    std::filesystem::path path_;
};

/// Writes `document` (its weights entry is filled in) and `tensors` as a run folder.
void write_run(const TemporaryFolder& folder, nlohmann::json document,
               const std::map<std::string, Tensor>& tensors);
/// Makes the manifest of a run folder fit its files.
void write_run_manifest(const TemporaryFolder& folder);

/// The tensors that `document`'s nodes name, out of all.
std::map<std::string, Tensor> tensors_of(const nlohmann::json& document,
                                         const std::map<std::string, Tensor>& all);

/// The device of this process with `lanes` forced (0: its own). Devices are kept.
const Device& device_with_lanes(int lanes);

/// Largest absolute difference; infinity where sizes or finiteness differ.
double largest_difference(const std::vector<float>& a, const std::vector<float>& b);

}  // namespace pave::nn
