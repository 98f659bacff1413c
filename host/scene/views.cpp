// hemisphere_views(): cameras on the cap of the hemisphere from which the scene's open side is
// seen, as in the papers.
// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <numbers>

#include "host/scene/transform.h"
#include "pave/error.h"
#include "pave/scene.h"

namespace pave {
namespace {

// From farther off the axis than this the line from the camera to the centre of a cubic box with an
// open front no longer goes through the opening (tan 45 degrees = half width / half depth): the
// picture's middle is the outside of a wall.
constexpr double kMaxPolarDegrees = 45.0;

// R2 of Roberts (2018): additive steps 1/g and 1/g^2, g^3 = g + 1, as fractions of 2^64. Any prefix
// is evenly spread, so that view i is the same however many views are asked for.
constexpr uint64_t kStepU = 13925035116211876495ull;
constexpr uint64_t kStepV = 10511698010929265437ull;

// The finaliser of SplitMix64 (Steele et al. 2014): seeds that differ in a bit shift the sequence
// elsewhere.
uint64_t mix(uint64_t x) {
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ull;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBull;
    return x ^ (x >> 31);
}

double to_unit_interval(uint64_t x) { return static_cast<double>(x >> 11) * 0x1p-53; }

struct Hemisphere {
    Double3 center;
    double radius;
    Double3 axis, up, side;  // orthonormal
};

Hemisphere hemisphere_of(const Scene& scene) {
    Hemisphere result{};
    const Matrix4& camera = scene.view.world_from_camera;
    const Double3 eye{camera[3], camera[7], camera[11]}, camera_up{camera[1], camera[5], camera[9]};
    for (size_t i = 0; i < 3; ++i)
        result.center[i] = 0.5 * (static_cast<double>(scene.bounds_min[i]) + scene.bounds_max[i]);
    result.radius = length(eye - result.center);
    double extent = 0;
    for (size_t i = 0; i < 3; ++i)
        extent = std::max<double>(extent, scene.bounds_max[i] - scene.bounds_min[i]);
    if (!(result.radius > 1e-3 * extent))
        throw UsageError("hemisphere views need a camera away from the centre of scene '" +
                         scene.name + "'; give a list of views instead");
    result.axis = normalized(eye - result.center);
    Double3 up = camera_up - dot(camera_up, result.axis) * result.axis;
    if (length(up) <
        1e-3) {  // the camera looks across the line to the centre: take its own axis for up
        const Double3 forward{camera[2], camera[6], camera[10]};
        up = forward - dot(forward, result.axis) * result.axis;
    }
    result.up = normalized(up);
    result.side = cross(result.up, result.axis);
    return result;
}

}  // namespace

std::vector<View> hemisphere_views(const Scene& scene, int count, uint64_t seed) {
    constexpr int kMaxViews = 1 << 24;
    if (count < 0 || count > kMaxViews)
        throw UsageError("count of views must be in 0.." + std::to_string(kMaxViews) + ", not " +
                         std::to_string(count));
    const Hemisphere hemisphere = hemisphere_of(scene);
    const uint64_t shift_u = mix(seed + 0x9E3779B97F4A7C15ull),
                   shift_v = mix(seed + 2 * 0x9E3779B97F4A7C15ull);
    const double cos_max = std::cos(kMaxPolarDegrees * std::numbers::pi / 180.0);
    std::vector<View> views;
    views.reserve(static_cast<size_t>(count));
    for (uint64_t i = 0; i < static_cast<uint64_t>(count); ++i) {
        // Uniform over the cap's area: cos(polar) and azimuth are uniform.
        const double cos_polar = 1 - to_unit_interval(shift_u + i * kStepU) * (1 - cos_max);
        const double sin_polar = std::sqrt(1 - cos_polar * cos_polar);
        const double azimuth = 2 * std::numbers::pi * to_unit_interval(shift_v + i * kStepV);
        const Double3 direction =
            cos_polar * hemisphere.axis +
            sin_polar * (std::cos(azimuth) * hemisphere.side + std::sin(azimuth) * hemisphere.up);
        const Double3 eye = hemisphere.center + hemisphere.radius * direction;
        const auto narrow = [](const Double3& v) {
            return std::array<float, 3>{static_cast<float>(v[0]), static_cast<float>(v[1]),
                                        static_cast<float>(v[2])};
        };
        views.push_back(look_at(narrow(eye), narrow(hemisphere.center), narrow(hemisphere.up),
                                scene.view.fov_x_degrees));
    }
    return views;
}

}  // namespace pave
