// The light table and the share of the samples that each light gets, by power.
// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <numbers>
#include <string>

#include "host/render/scene_data.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr double kRange = 4294967296.0;  // 2^32, the numbers that lights are chosen by

/// Ends of the lights' parts of [0, 2^32), at least one number each, in proportion to their power.
std::vector<double> parts(const std::vector<LightSource>& lights) {
    double total = 0;
    for (const LightSource& light : lights) total += light.power;
    std::vector<double> ends;
    double sum = 0;
    const double spare = kRange - static_cast<double>(lights.size());
    for (const LightSource& light : lights) {
        sum += light.power;
        ends.push_back(std::floor(sum / total * spare) + static_cast<double>(ends.size() + 1));
    }
    ends.back() = kRange;
    return ends;
}

void put3(Row& row, size_t at, Double3 v) {
    const std::array<float, 3> f = to_floats(v);
    for (size_t c = 0; c < 3; ++c) row[at + c] = f[c];
}

void add_row(SceneData& data, const LightSource& light, double pmf) {
    Row a{}, b{}, c{};
    put3(a, 0, light.p);
    a[3] = as_float_bits(static_cast<uint32_t>(light.kind));
    put3(a, 4, light.e1);
    a[7] = static_cast<float>(pmf);
    put3(b, 0, light.e2);
    b[3] = static_cast<float>(light.radius);
    put3(b, 4, light.normal);
    b[7] = light.area > 0 ? static_cast<float>(pmf / light.area) : 0.0f;
    for (size_t i = 0; i < 3; ++i) c[i] = light.radiance[i];
    c[4] =
        static_cast<float>(max_abs(light.p) + max_abs(light.e1) + max_abs(light.e2) + light.radius);
    c[3] = as_float_bits(static_cast<uint32_t>(light.normals));
    data.lights.insert(data.lights.end(), {a, b, c});
}

}  // namespace

double luminance(const Rgb& rgb) { return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]; }

void add_lights(const Scene& scene, SceneData& data, std::vector<LightSource> lights) {
    const Double3 low = to_double3(data.bounds.lower), high = to_double3(data.bounds.upper);
    const double radius = data.bounds.empty() ? 1.0 : length(high - low) / 2;
    if (scene.has_environment && luminance(scene.environment) > 0)
        lights.push_back({.kind = LIGHT_ENVIRONMENT,
                          .radiance = scene.environment,
                          .power = 4 * std::numbers::pi * std::numbers::pi * radius * radius *
                                   luminance(scene.environment)});
    for (const Scene::PointLight& light : scene.point_lights)
        if (luminance(light.intensity) > 0)
            lights.push_back({.kind = LIGHT_POINT,
                              .p = to_double3(light.position),
                              .radiance = light.intensity,
                              .power = 4 * std::numbers::pi * luminance(light.intensity)});
    if (lights.empty()) return;
    for (const LightSource& light : lights)
        if (!std::isfinite(light.power))
            throw InputError("scene '" + scene.name +
                             "': a light's power is not finite; check its radiance and size");
    const std::vector<double> ends = parts(lights);
    for (size_t i = 0; i < lights.size(); ++i) {
        const double pmf = (ends[i] - (i > 0 ? ends[i - 1] : 0.0)) / kRange;
        add_row(data, lights[i], pmf);
        data.light_cdf.push_back(static_cast<uint32_t>(std::min(ends[i], kRange - 1)));
        if (lights[i].kind == LIGHT_ENVIRONMENT) data.environment_pmf = static_cast<float>(pmf);
    }
}

}  // namespace pave
