// Materials as rows of the device's table.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>

#include "host/render/scene_data.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr float kLeastAlpha = 1e-4f;  // as in Mitsuba: below it float32 cannot hold the lobe

int kernel_type(Bsdf::Type type) {
    switch (type) {
        case Bsdf::Type::kDiffuse:
            return BSDF_DIFFUSE;
        case Bsdf::Type::kConductor:
            return BSDF_CONDUCTOR;
        case Bsdf::Type::kRoughConductor:
            return BSDF_ROUGH_CONDUCTOR;
        case Bsdf::Type::kDielectric:
            return BSDF_DIELECTRIC;
        case Bsdf::Type::kPlastic:
            return BSDF_PLASTIC;
        case Bsdf::Type::kRoughDielectric:
            return BSDF_ROUGH_DIELECTRIC;
    }
    throw InternalError("material type " + std::to_string(static_cast<int>(type)));
}

/// Reflectance at normal incidence, the albedo of a rough conductor.
float normal_reflectance(float eta, float k) {
    const float below = (eta - 1) * (eta - 1) + k * k, above = (eta + 1) * (eta + 1) + k * k;
    return above > 0 ? below / above : 1.0f;
}

float relative_index(const Bsdf& bsdf) { return bsdf.int_ior / bsdf.ext_ior; }

/// Mean reflectance of a dielectric boundary under diffuse light, `eta` beyond over before it. Fits
/// of Egan and Hilgeman 1973 below 1 and of d'Eon and Irving 2011 above: the very ones that Mitsuba
/// defines its plastic by.
double diffuse_fresnel(double eta) {
    const double x = 1 / eta;
    if (eta < 1) return -1.4399 * eta * eta + 0.7099 * eta + 0.6681 + 0.0636 * x;
    constexpr double kFit[] = {0.919317, -3.4793, 6.75335, -7.80989, 4.98554, -1.36881};
    double sum = 0;
    for (int i = 5; i >= 0; --i) sum = sum * x + kFit[i];
    return sum;
}

/// Of a colour and its texture.
double mean(const Scene& scene, const Rgb& rgb, int texture) {
    Rgb factor{1, 1, 1};
    if (texture >= 0) factor = mean_colour(scene.textures[static_cast<size_t>(texture)]);
    double sum = 0;
    for (size_t c = 0; c < 3; ++c) sum += static_cast<double>(rgb[c]) * factor[c];
    return sum / 3;
}

float texture_bits(int texture) { return as_float_bits(static_cast<uint32_t>(texture)); }

/// The texture that a material's albedo is a factor of. A rough dielectric's has two colours: that
/// of the light that goes through counts.
int albedo_texture(const Bsdf& bsdf) {
    switch (bsdf.type) {
        case Bsdf::Type::kDiffuse:
        case Bsdf::Type::kPlastic:
            return bsdf.reflectance_texture;
        case Bsdf::Type::kRoughConductor:
            return bsdf.specular_reflectance_texture;
        case Bsdf::Type::kRoughDielectric:
            return bsdf.specular_transmittance_texture;
        case Bsdf::Type::kConductor:
        case Bsdf::Type::kDielectric:
            return -1;
    }
    return -1;
}

Rgb albedo_of(const Bsdf& bsdf) {
    Rgb albedo{0, 0, 0};
    const Rgb &r = bsdf.specular_reflectance, &t = bsdf.specular_transmittance;
    const float f = normal_reflectance(relative_index(bsdf), 0);
    switch (bsdf.type) {
        case Bsdf::Type::kDiffuse:
        case Bsdf::Type::kPlastic:
            return bsdf.reflectance;
        case Bsdf::Type::kRoughConductor:
            for (size_t c = 0; c < 3; ++c)
                albedo[c] = r[c] * normal_reflectance(bsdf.eta[c], bsdf.k[c]);
            return albedo;
        case Bsdf::Type::kRoughDielectric:
            for (size_t c = 0; c < 3; ++c) albedo[c] = f * r[c] + (1 - f) * t[c];
            return albedo;
        case Bsdf::Type::kConductor:
        case Bsdf::Type::kDielectric:
            return albedo;
    }
    return albedo;
}

/// Second row of a material: a conductor's index, or what plastic needs beside its own.
Row second_row(const Scene& scene, const Bsdf& b) {
    if (b.type != Bsdf::Type::kPlastic)
        return {b.eta[0], b.eta[1], b.eta[2], 0, b.k[0], b.k[1], b.k[2], 0};
    const double specular = mean(scene, b.specular_reflectance, b.specular_reflectance_texture),
                 base = mean(scene, b.reflectance, b.reflectance_texture);
    const double share = specular + base > 0 ? specular / (specular + base) : 0.5;
    return {static_cast<float>(diffuse_fresnel(1.0 / relative_index(b))), static_cast<float>(share),
            b.nonlinear ? 1.0f : 0.0f};
}

}  // namespace

uint32_t surface_bits(const Scene& scene, const Shape& shape, int kind, bool inverted) {
    const Bsdf& bsdf = scene.bsdfs[static_cast<size_t>(shape.bsdf)];
    return make_bits(shape.bsdf, kernel_type(bsdf.type), bsdf.two_sided, emits(shape), kind,
                     inverted, has_texture(bsdf));
}

void add_materials(const Scene& scene, SceneData& data) {
    if (scene.bsdfs.size() >= MAX_BSDFS)
        throw InputError("scene '" + scene.name + "': " + std::to_string(scene.bsdfs.size()) +
                         " materials, at most " + std::to_string(MAX_BSDFS - 1));
    const auto check = [&](const Shape& shape) {
        if (shape.bsdf < 0 || static_cast<size_t>(shape.bsdf) >= scene.bsdfs.size())
            throw InputError(name_of(scene, shape) + ": material " + std::to_string(shape.bsdf) +
                             " of " + std::to_string(scene.bsdfs.size()));
    };
    for (const ShapeGroup& group : scene.groups)
        for (const Shape& shape : group.shapes) check(shape);
    for (const Shape& shape : scene.shapes)
        if (shape.type != Shape::Type::kInstance) check(shape);
    for (const Bsdf& b : scene.bsdfs) {
        for (const int texture : {b.reflectance_texture, b.specular_reflectance_texture,
                                  b.specular_transmittance_texture})
            if (texture < -1 || texture >= static_cast<int>(scene.textures.size()))
                throw InputError("scene '" + scene.name + "': texture " + std::to_string(texture) +
                                 " of " + std::to_string(scene.textures.size()));
        const Rgb a = albedo_of(b);
        const Rgb &r = b.specular_reflectance, &t = b.specular_transmittance;
        data.bsdfs.push_back({a[0], a[1], a[2], texture_bits(albedo_texture(b)),
                              std::max(b.alpha_u, kLeastAlpha), std::max(b.alpha_v, kLeastAlpha),
                              relative_index(b), 0});
        data.bsdfs.push_back(second_row(scene, b));
        data.bsdfs.push_back({r[0], r[1], r[2], texture_bits(b.specular_reflectance_texture), t[0],
                              t[1], t[2], texture_bits(b.specular_transmittance_texture)});
    }
}

}  // namespace pave
