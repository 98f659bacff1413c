// Loading of an exported run: checksums first, then both files.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/run_folder.h"

#include <filesystem>
#include <map>

#include "host/nn/fields.h"
#include "host/nn/file.h"
#include "pave/error.h"
#include "pave/hash.h"

namespace pave::nn {
namespace {

namespace fs = std::filesystem;
constexpr const char* kSchemaName = "generator.json";
constexpr const char* kManifestName = "run-manifest.json";
constexpr size_t kSchemaByteLimit = size_t{4} << 20;
constexpr size_t kWeightsByteLimit = size_t{4} << 30;  // 2^30 parameters

std::string_view text_of(const std::vector<std::byte>& bytes) {
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// The run's manifest: {"format": "pave-run", "version": 1, "xxh3_128": {file: checksum}}. No run
/// is without one.
class Manifest {
   public:
    explicit Manifest(const fs::path& folder) : path_((folder / kManifestName).string()) {
        const nlohmann::json document =
            parse_json(text_of(read_file(path_, kSchemaByteLimit)), path_);
        Fields fields(document, path_);
        if (fields.text("format") != "pave-run") fields.fail("format must be 'pave-run'");
        fields.integer("version", 1, 1);
        const nlohmann::json& hashes = fields.any("xxh3_128");
        if (!hashes.is_object()) fields.fail("xxh3_128 must be an object");
        for (const auto& [name, hash] : hashes.items()) {
            if (!hash.is_string()) fields.fail("the checksum of '" + shown(name) + "' is no text");
            hashes_[name] = hash.get<std::string>();
        }
    }

    /// Throws InputError if the manifest knows another checksum of `name` than `hash`, or none.
    void verify(const fs::path& file, const std::string& name, const std::string& hash) const {
        const auto found = hashes_.find(name);
        if (found == hashes_.end())
            throw InputError(path_ + ": has no checksum of " + name + "; export the run again");
        if (found->second != hash)
            throw InputError(file.string() + ": checksum differs from " + path_ +
                             "; the file is damaged, export the run again");
    }

   private:
    std::string path_;
    std::map<std::string, std::string> hashes_;
};

}  // namespace

Run load_run(const std::string& run_folder) {
    const fs::path folder(run_folder), schema_path = folder / kSchemaName;
    const Manifest manifest(folder);
    const std::vector<std::byte> schema_bytes = read_file(schema_path.string(), kSchemaByteLimit);
    manifest.verify(schema_path, kSchemaName, hash_hex(schema_bytes));
    const WeightsReference reference =
        read_weights_reference(text_of(schema_bytes), schema_path.string());
    const fs::path weights_path = folder / reference.file;
    const std::vector<std::byte> weights_bytes =
        read_file(weights_path.string(), kWeightsByteLimit);
    const std::string hash = hash_hex(weights_bytes);
    if (hash != reference.hash)
        throw InputError(weights_path.string() + ": checksum differs from " + schema_path.string() +
                         "; the file is damaged or of another run, export the run again");
    manifest.verify(weights_path, reference.file, hash);
    return {read_schema(text_of(schema_bytes), schema_path.string(),
                        read_safetensors(weights_bytes, weights_path.string())),
            hash};
}

}  // namespace pave::nn
