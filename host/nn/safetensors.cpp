// Reader of safetensors files; every size is checked before it is used.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/nn/safetensors.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <string_view>

#include "host/nn/file.h"
#include "pave/error.h"

namespace pave::nn {
namespace {

static_assert(std::endian::native == std::endian::little, "safetensors data are little endian");

using nlohmann::json;
constexpr size_t kLengthByteSize = 8;

struct Entry {
    std::string name;
    std::vector<int64_t> shape;
    uint64_t begin = 0, end = 0;  // bytes from the start of the data
};

[[noreturn]] void fail(const std::string& file, const std::string& name,
                       const std::string& reason) {
    throw InputError(file + ": tensor '" + name + "': " + reason);
}

uint64_t unsigned_of(const json& number, const std::string& file, const std::string& name,
                     const char* what) {
    if (!number.is_number_unsigned())
        fail(file, name, std::string(what) + " must be whole numbers from 0 on");
    return number.get<uint64_t>();
}

/// Bytes that `entry.shape` takes; InputError if that overflows.
uint64_t byte_size_of(const Entry& entry, const std::string& file) {
    uint64_t byte_size = sizeof(float);
    for (int64_t extent : entry.shape)
        if (__builtin_mul_overflow(byte_size, static_cast<uint64_t>(extent), &byte_size))
            fail(file, entry.name, "the shape overflows");
    return byte_size;
}

Entry entry_of(const std::string& name, const json& fields, uint64_t data_byte_size,
               const std::string& file) {
    if (!fields.is_object() || fields.size() != 3 || !fields.contains("dtype") ||
        !fields.contains("shape") || !fields.contains("data_offsets"))
        fail(file, name, "must have dtype, shape and data_offsets and nothing else");
    if (fields["dtype"] != "F32") fail(file, name, "dtype must be F32");
    const json &shape = fields["shape"], &offsets = fields["data_offsets"];
    if (!shape.is_array() || shape.size() > kMaxTensorRank)
        fail(file, name, "shape must be a list of at most 8 numbers");
    if (!offsets.is_array() || offsets.size() != 2)
        fail(file, name, "data_offsets must be two numbers");
    Entry entry{name, {}, 0, 0};
    for (const json& extent : shape) {
        const uint64_t value = unsigned_of(extent, file, name, "shape's");
        if (value > data_byte_size) fail(file, name, "the shape is larger than the file");
        entry.shape.push_back(static_cast<int64_t>(value));
    }
    entry.begin = unsigned_of(offsets[0], file, name, "data_offsets");
    entry.end = unsigned_of(offsets[1], file, name, "data_offsets");
    if (entry.begin > entry.end || entry.end > data_byte_size)
        fail(file, name, "data_offsets lie outside the file");
    if (entry.end - entry.begin != byte_size_of(entry, file))
        fail(file, name, "data_offsets do not fit the shape");
    return entry;
}

std::vector<Entry> entries_of(const json& header, uint64_t data_byte_size,
                              const std::string& file) {
    if (!header.is_object()) throw InputError(file + ": the header is not a JSON object");
    std::vector<Entry> entries;
    for (const auto& [name, fields] : header.items()) {
        if (name == "__metadata__") continue;
        entries.push_back(entry_of(name, fields, data_byte_size, file));
    }
    std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
        return std::pair(a.begin, a.end) < std::pair(b.begin, b.end);
    });
    uint64_t covered = 0;
    for (const Entry& entry : entries) {
        if (entry.begin != covered)
            fail(file, entry.name,
                 "its data do not follow the tensor before it without gap or overlap");
        covered = entry.end;
    }
    if (covered != data_byte_size)
        throw InputError(file + ": " + std::to_string(data_byte_size - covered) +
                         " bytes at the end belong to no tensor");
    return entries;
}

}  // namespace

std::map<std::string, Tensor> read_safetensors(std::span<const std::byte> bytes,
                                               const std::string& file) {
    if (bytes.size() < kLengthByteSize) throw InputError(file + ": too short for a header");
    uint64_t header_byte_size = 0;
    std::memcpy(&header_byte_size, bytes.data(), kLengthByteSize);
    if (header_byte_size > kMaxHeaderByteSize)
        throw InputError(file + ": the header says that it is " + std::to_string(header_byte_size) +
                         " bytes, at most 1 MiB is taken");
    if (header_byte_size > bytes.size() - kLengthByteSize)
        throw InputError(file + ": truncated in the header");
    const std::string_view text(reinterpret_cast<const char*>(bytes.data()) + kLengthByteSize,
                                static_cast<size_t>(header_byte_size));
    const std::span<const std::byte> data =
        bytes.subspan(kLengthByteSize + static_cast<size_t>(header_byte_size));
    std::map<std::string, Tensor> tensors;
    for (Entry& entry : entries_of(parse_json(text, file), data.size(), file)) {
        Tensor tensor;
        tensor.shape = std::move(entry.shape);
        tensor.values.resize(static_cast<size_t>(entry.end - entry.begin) / sizeof(float));
        if (!tensor.values.empty())
            std::memcpy(tensor.values.data(), data.data() + entry.begin,
                        tensor.values.size() * sizeof(float));
        for (float value : tensor.values)
            if (!std::isfinite(value)) fail(file, entry.name, "holds values that are not finite");
        tensors.emplace(entry.name, std::move(tensor));
    }
    return tensors;
}

}  // namespace pave::nn
