// <emitter type="envmap">: an image of what lies around the scene.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/environment.h"

#include <cmath>
#include <numbers>

#include "host/scene/transform.h"

namespace pave {
namespace {

constexpr double kTolerance = 1e-4;  // as files round rotations
constexpr float kMaxRadiance = 1e30f;

/// Linear floats of sRGB bytes.
void decode_bytes(Image& image) {
    for (size_t i = 0; i < image.bytes.size(); ++i) {
        if (i % 4 == 3) continue;
        const double x = image.bytes[i] / 255.0;
        image.floats.push_back(
            static_cast<float>(x <= 0.04045 ? x / 12.92 : std::pow((x + 0.055) / 1.055, 2.4)));
    }
    image.bytes.clear();
}

bool is_rotation(const Affine& map) {
    for (size_t i = 0; i < 3; ++i)
        for (size_t j = i; j < 3; ++j)
            if (std::abs(dot(map.column(i), map.column(j)) - (i == j ? 1 : 0)) > kTolerance)
                return false;
    return true;
}

/// Mean radiance over the sphere; a row of pixels weighs by its circle's length.
Rgb mean_radiance(const Image& image) {
    std::array<double, 3> sum{};
    double weights = 0;
    for (int row = 0; row < image.height; ++row) {
        const double weight = std::sin(std::numbers::pi * row / (image.height - 1));
        weights += weight * image.width;
        const size_t first =
            size_t{3} * static_cast<size_t>(image.width) * static_cast<size_t>(row);
        for (size_t i = 0; i < size_t{3} * static_cast<size_t>(image.width); ++i)
            sum[i % 3] += weight * image.floats[first + i];
    }
    Rgb mean{};
    for (size_t c = 0; c < 3; ++c) mean[c] = static_cast<float>(sum[c] / weights);
    return mean;
}

}  // namespace

void read_environment_map(Properties& emitter, TextureReader& images, Scene& scene) {
    SceneFile& file = emitter.file();
    const pugi::xml_node image_node = emitter.peek("filename"), map_node = emitter.peek("to_world"),
                         scale_node = emitter.peek("scale");
    Image image = images.read_image(emitter);
    if (image.width < 2 || image.height < 3)
        file.fail(image_node, "an environment has at least 2 x 3 pixels");
    decode_bytes(image);
    const double scale = emitter.number("scale", 1);
    if (!(scale >= 0) || scale > kMaxRadiance) file.fail(scale_node, "must be in [0, 1e30]");
    for (float& x : image.floats) {
        x *= static_cast<float>(scale);
        if (!(x >= 0 && x <= kMaxRadiance))
            file.fail(image_node, "a pixel's radiance is negative, not finite or beyond 1e30");
    }
    const Affine to_world = read_to_world(emitter);
    if (!is_rotation(to_world)) file.fail(map_node, "an environment can only be turned");
    emitter.accept({"mis_compensation"});  // how Mitsuba draws samples
    for (size_t row = 0; row < 3; ++row)
        for (size_t column = 0; column < 3; ++column)
            scene.map_from_world[3 * row + column] =
                static_cast<float>(to_world.linear[column][row]);
    scene.environment = mean_radiance(image);
    scene.has_environment = scene.environment != Rgb{0, 0, 0};
    if (scene.has_environment) scene.environment_map = std::move(image);
}

}  // namespace pave
