// Reader of safetensors files with float32 tensors, written for files that nobody vouches for.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <vector>

namespace pave::nn {

struct Tensor {
    std::vector<int64_t> shape;
    std::vector<float> values;  // row-major
};

inline constexpr size_t kMaxHeaderByteSize = size_t{1} << 20;
inline constexpr size_t kMaxTensorRank = 8;

/// Tensors of the file's bytes by name. The layout is 8 bytes of header length (little endian), a
/// JSON header, the data; the tensors must cover the data in order without gap or overlap. Throws
/// InputError "FILE: tensor 'NAME': reason" for anything else: a dtype other than F32, offsets that
/// do not fit the shape, values that are not finite.
std::map<std::string, Tensor> read_safetensors(std::span<const std::byte> bytes,
                                               const std::string& file);

}  // namespace pave::nn
