// An environment's image on the device: pixels, and the shares by which light samples choose them.
// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <cstring>
#include <numbers>

#include "host/render/scene_data.h"
#include "pave/error.h"

namespace pave {
namespace {

float int_bits(size_t value) { return as_float_bits(static_cast<uint32_t>(value)); }

size_t append_floats(std::vector<Row>& rows, const std::vector<float>& floats) {
    const size_t first = rows.size();
    rows.resize(first + (floats.size() + 7) / 8);
    std::memcpy(rows[first].data(), floats.data(), floats.size() * sizeof(float));
    return first;
}

/// Appends the running sums of the weights as shares of their total: 0, ..., 1. Returns the total.
double append_ends(const std::vector<double>& weights, std::vector<float>& ends) {
    double total = 0, sum = 0;
    for (const double weight : weights) total += weight;
    ends.push_back(0);
    for (size_t i = 0; i < weights.size(); ++i) {
        sum += weights[i];
        const double even = static_cast<double>(i + 1) / static_cast<double>(weights.size());
        ends.push_back(static_cast<float>(total > 0 ? sum / total : even));
    }
    ends.back() = 1;
    return total;
}

}  // namespace

void add_environment(const Scene& scene, SceneData& data) {
    data.environment.resize(ENVIRONMENT_ROWS);
    const Image& image = scene.environment_map;
    if (image.width == 0 || data.environment_pmf == 0) return;
    const auto width = static_cast<size_t>(image.width), height = static_cast<size_t>(image.height);
    if (image.width < 2 || image.height < 2 || image.floats.size() != 3 * width * height)
        throw InputError("scene '" + scene.name + "': its environment has not the pixels it needs");
    std::vector<float> pixels(4 * width * height), row_ends, column_ends;
    for (size_t i = 0; i < image.floats.size(); ++i) pixels[i / 3 * 4 + i % 3] = image.floats[i];
    const auto brightness = [&](size_t x, size_t y) {
        const float* p = &image.floats[3 * (y * width + x % width)];
        return luminance({p[0], p[1], p[2]});
    };
    std::vector<double> rows;
    for (size_t y = 0; y + 1 < height; ++y) {
        // A cell's mean between its four pixels, by its solid angle.
        const double theta =
            std::numbers::pi * (static_cast<double>(y) + 0.5) / static_cast<double>(height - 1);
        std::vector<double> cells;
        for (size_t x = 0; x < width; ++x)
            cells.push_back(std::sin(theta) * (brightness(x, y) + brightness(x + 1, y) +
                                               brightness(x, y + 1) + brightness(x + 1, y + 1)));
        rows.push_back(append_ends(cells, column_ends));
    }
    append_ends(rows, row_ends);
    const auto& m = scene.map_from_world;
    Row head{int_bits(width), int_bits(height)};
    head[2] = int_bits(append_floats(data.environment, pixels));
    head[3] = int_bits(append_floats(data.environment, row_ends));
    head[4] = int_bits(append_floats(data.environment, column_ends));
    data.environment[0] = head;
    data.environment[1] = {m[0], m[1], m[2], 0, m[3], m[4], m[5], 0};
    data.environment[2] = {m[6], m[7], m[8], 0, 0, 0, 0, 0};
}

}  // namespace pave
