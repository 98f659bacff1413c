// Textures as rows of the device's table, followed by their texels.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <cstring>

#include "host/render/scene_data.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr size_t kTableRows = size_t{1} << 30;  // row numbers are ints
constexpr size_t kValues = 256;

std::array<float, kValues> values_of_bytes(bool is_raw) {
    std::array<float, kValues> values{};
    for (size_t i = 0; i < kValues; ++i) {
        const double x = static_cast<double>(i) / 255;
        const double linear = x <= 0.04045 ? x / 12.92 : std::pow((x + 0.055) / 1.055, 2.4);
        values[i] = static_cast<float>(is_raw ? x : linear);
    }
    return values;
}

float int_bits(size_t value) { return as_float_bits(static_cast<uint32_t>(value)); }

/// Appends `count` floats in whole rows; returns the first row.
size_t append_rows(std::vector<Row>& rows, const void* data, size_t byte_size) {
    const size_t first = rows.size();
    rows.resize(first + (byte_size + sizeof(Row) - 1) / sizeof(Row));
    std::memcpy(rows[first].data(), data, byte_size);
    return first;
}

void check(const Scene& scene, const Texture& texture, size_t rows) {
    const auto refuse = [&](const std::string& reason) {
        throw InputError("scene '" + scene.name + "': texture " +
                         std::to_string(&texture - scene.textures.data()) + ": " + reason);
    };
    if (texture.type == Texture::Type::kCheckerboard) return;
    const Image& image = texture.image;
    if (image.width < 1 || image.height < 1) refuse("has no pixels");
    const size_t pixels = static_cast<size_t>(image.width) * static_cast<size_t>(image.height);
    if (image.bytes.size() != 4 * pixels && image.floats.size() != 3 * pixels)
        refuse("has not the pixels that its size asks for");
    if (rows + pixels > kTableRows) refuse("there are too many texels");
}

/// Texels of a bitmap, and where they are in its row.
void add_texels(const Texture& texture, std::vector<Row>& rows, Row& head) {
    const Image& image = texture.image;
    head[1] = int_bits(static_cast<size_t>(image.width));
    head[2] = int_bits(static_cast<size_t>(image.height));
    head[5] = int_bits(static_cast<size_t>(texture.wrap));
    head[6] = int_bits(texture.is_nearest ? TEXTURE_NEAREST : TEXTURE_BILINEAR);
    if (!image.bytes.empty()) {
        const std::array<float, kValues> values = values_of_bytes(texture.is_raw);
        head[0] = int_bits(TEXTURE_BYTES);
        head[3] = int_bits(append_rows(rows, image.bytes.data(), image.bytes.size()));
        head[4] = int_bits(append_rows(rows, values.data(), sizeof values));
        return;
    }
    std::vector<float> padded(image.floats.size() / 3 * 4);
    for (size_t i = 0; i < image.floats.size(); ++i) padded[i / 3 * 4 + i % 3] = image.floats[i];
    head[0] = int_bits(TEXTURE_FLOATS);
    head[3] = int_bits(append_rows(rows, padded.data(), padded.size() * sizeof(float)));
}

}  // namespace

void add_textures(const Scene& scene, SceneData& data) {
    static_assert(static_cast<int>(Texture::Wrap::kMirror) == TEXTURE_MIRROR &&
                  static_cast<int>(Texture::Wrap::kClamp) == TEXTURE_CLAMP);
    data.textures.resize(scene.textures.size() * TEXTURE_ROWS);
    for (size_t i = 0; i < scene.textures.size(); ++i) {
        const Texture& texture = scene.textures[i];
        check(scene, texture, data.textures.size());
        Row head{}, map{}, colours{};
        std::copy(texture.uv_map.begin(), texture.uv_map.end(), map.begin());
        if (texture.type == Texture::Type::kCheckerboard) {
            head[0] = int_bits(TEXTURE_CHECKERS);
            std::copy(texture.color0.begin(), texture.color0.end(), colours.begin());
            std::copy(texture.color1.begin(), texture.color1.end(), colours.begin() + 4);
        } else {
            add_texels(texture, data.textures, head);
        }
        data.textures[i * TEXTURE_ROWS] = head;
        data.textures[i * TEXTURE_ROWS + 1] = map;
        data.textures[i * TEXTURE_ROWS + 2] = colours;
    }
}

Rgb mean_colour(const Texture& texture) {
    std::array<double, 3> sum{};
    if (texture.type == Texture::Type::kCheckerboard) {
        for (size_t c = 0; c < 3; ++c) sum[c] = (texture.color0[c] + texture.color1[c]) / 2.0;
    } else {
        const Image& image = texture.image;
        const std::array<float, kValues> values = values_of_bytes(texture.is_raw);
        const size_t pixels = std::max<size_t>(
            1, static_cast<size_t>(image.width) * static_cast<size_t>(image.height));
        for (size_t i = 0; i < image.bytes.size(); ++i)
            if (i % 4 < 3) sum[i % 4] += values[image.bytes[i]];
        for (size_t i = 0; i < image.floats.size(); ++i) sum[i % 3] += image.floats[i];
        for (double& x : sum) x /= static_cast<double>(pixels);
    }
    return {static_cast<float>(sum[0]), static_cast<float>(sum[1]), static_cast<float>(sum[2])};
}

}  // namespace pave
