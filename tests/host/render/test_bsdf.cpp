// Materials: samples follow their density, no energy is made, both directions agree, glass obeys
// Snell and Fresnel.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <complex>
#include <random>

#include "selftest.h"

namespace pave::test {
namespace {

using Dir = std::array<double, 3>;

struct Case {
    const char* name;
    Bsdf bsdf;
    bool below = false;  // seen from behind

    bool lets_through() const { return bsdf.type == Bsdf::Type::kRoughDielectric; }
    double index() const { return lets_through() ? bsdf.int_ior / bsdf.ext_ior : 1.0; }
};

Bsdf plastic_of(Rgb base, Rgb coat, bool nonlinear) {
    Bsdf plastic;
    plastic.type = Bsdf::Type::kPlastic;
    plastic.int_ior = 1.6f;
    plastic.ext_ior = 1.0f;
    plastic.reflectance = base;
    plastic.specular_reflectance = coat;
    plastic.nonlinear = nonlinear;
    return plastic;
}

Bsdf rough_glass(float alpha) {
    Bsdf glass;
    glass.type = Bsdf::Type::kRoughDielectric;
    glass.int_ior = 1.5f;
    glass.ext_ior = 1.0f;
    glass.alpha_u = glass.alpha_v = alpha;
    return glass;
}

std::vector<Case> opaque_cases() {
    Bsdf white;
    white.reflectance = {1, 1, 1};
    Bsdf both = white;
    both.two_sided = true;
    Bsdf gold;
    gold.type = Bsdf::Type::kRoughConductor;
    gold.eta = {0.14f, 0.37f, 1.44f};
    gold.k = {3.98f, 2.39f, 1.6f};
    gold.alpha_u = gold.alpha_v = 0.3f;
    Bsdf brushed = gold;
    brushed.alpha_u = 0.15f;
    brushed.alpha_v = 0.6f;
    brushed.two_sided = true;
    Bsdf matte = gold;
    matte.alpha_u = matte.alpha_v = 1.0f;
    const Bsdf clear = plastic_of({1, 1, 1}, {1, 1, 1}, true);
    Bsdf red = plastic_of({0.8f, 0.2f, 0.1f}, {0.5f, 0.5f, 0.5f}, false);
    red.two_sided = true;
    return {{"diffuse", white},       {"diffuse from behind", both, true},    {"rough 0.3", gold},
            {"brushed", brushed},     {"brushed from behind", brushed, true}, {"rough 1", matte},
            {"white plastic", clear}, {"red plastic from behind", red, true}};
}

/// And those that let light through.
std::vector<Case> smooth_cases() {
    std::vector<Case> cases = opaque_cases();
    Bsdf tinted = rough_glass(0.5f);
    tinted.alpha_v = 0.25f;
    tinted.specular_reflectance = {0.9f, 0.5f, 0.2f};
    tinted.specular_transmittance = {0.2f, 0.6f, 1.0f};
    for (const bool below : {false, true}) {
        cases.push_back({"rough glass 0.3", rough_glass(0.3f), below});
        cases.push_back({"rough glass 0.8", rough_glass(0.8f), below});
        cases.push_back({"tinted rough glass", tinted, below});
    }
    return cases;
}

Scene scene_with(const std::vector<Case>& cases) {
    Scene scene;
    for (const Case& c : cases) {
        scene.bsdfs.push_back(c.bsdf);
        add_shape(scene, Shape::Type::kRectangle, scale(1.0f),
                  static_cast<int>(scene.bsdfs.size()) - 1);
    }
    return scene;
}

/// `count` directions over the hemisphere, evenly in cos.
std::vector<Dir> directions(int count, bool below, uint32_t seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    std::vector<Dir> result;
    for (int i = 0; i < count; ++i) {
        const double z = 0.02 + 0.98 * (i + unit(rng)) / count, phi = 2 * M_PI * unit(rng),
                     r = std::sqrt(1 - z * z);
        result.push_back({r * std::cos(phi), r * std::sin(phi), below ? -z : z});
    }
    return result;
}

Planes pairs_of(const Dir& wi, const Planes& wo) {
    Planes pairs = make_planes(3, wo[0].size());
    for (size_t k = 0; k < 3; ++k)
        std::fill(pairs[k].begin(), pairs[k].end(), static_cast<float>(wi[k]));
    pairs.insert(pairs.end(), wo.begin(), wo.begin() + 3);
    return pairs;
}

TEST(BsdfChi2, SamplesFollowTheirDensity) {
    const std::vector<Case> cases = smooth_cases();
    SelfTest test(scene_with(cases));
    constexpr int kDirections = 20;
    const double least_p = sidak(kDirections * static_cast<int>(cases.size()));
    const DirectionTest chi2{.rows = 32, .columns = 32, .fine = 16};
    double smallest = 1;
    for (size_t c = 0; c < cases.size(); ++c)
        for (const Dir& wi : directions(kDirections, cases[c].below, 11)) {
            const Planes s = test.sample_bsdf(static_cast<int>(c), wi, 5, 1 << 17);
            const double p = chi2.p_value(
                s, [&](size_t i) { return s[3][i] > 0 && std::isfinite(s[6][i]); },
                [&](const Planes& wo) {
                    return test.eval_bsdf(static_cast<int>(c), pairs_of(wi, wo))[3];
                });
            smallest = std::min(smallest, p);
            EXPECT_GT(p, least_p) << cases[c].name << " from " << wi[0] << " " << wi[1] << " "
                                  << wi[2];
        }
    RecordProperty("smallest_p", std::to_string(smallest));
}

TEST(Bsdf, WeightIsValueOverDensity) {
    const std::vector<Case> cases = smooth_cases();
    SelfTest test(scene_with(cases));
    for (size_t c = 0; c < cases.size(); ++c)
        for (const Dir& wi : directions(20, cases[c].below, 12)) {
            const Planes s = test.sample_bsdf(static_cast<int>(c), wi, 6, 4096);
            const Planes e = test.eval_bsdf(static_cast<int>(c), pairs_of(wi, s));
            for (size_t i = 0; i < 4096; ++i) {
                if (s[3][i] == 0 || std::isinf(s[6][i])) continue;
                ASSERT_NEAR(s[6][i] / e[3][i], 1.0, 2e-3)
                    << cases[c].name << " density of sample " << i;
                for (size_t k = 0; k < 3; ++k)
                    ASSERT_NEAR(e[k][i] / e[3][i], s[3 + k][i], 2e-3)
                        << cases[c].name << " weight of sample " << i;
            }
        }
}

TEST(Bsdf, MakesNoEnergy) {
    const std::vector<Case> cases = smooth_cases();
    SelfTest test(scene_with(cases));
    for (size_t c = 0; c < cases.size(); ++c)
        for (const Dir& wi : directions(100, cases[c].below, 13)) {
            for (double reflected : test.bsdf_power(static_cast<int>(c), wi, 7, 1 << 20)) {
                // The published fit that defines plastic's inner reflectance is a thousandth off.
                const bool is_fit = cases[c].bsdf.type == Bsdf::Type::kPlastic;
                EXPECT_LE(reflected, is_fit ? 1.003 : 1.001) << cases[c].name;
                if (cases[c].bsdf.type == Bsdf::Type::kDiffuse) {
                    EXPECT_NEAR(reflected, 1.0, 5e-4) << cases[c].name;
                }
            }
        }
}

void expect_reciprocal(SelfTest& test, int surface, const Case& c, bool through) {
    constexpr int kPairs = 16384;
    std::vector<Dir> a = directions(kPairs, c.below, 14),
                     b = directions(kPairs, c.below != through, 15);
    std::shuffle(b.begin(), b.end(), std::mt19937(1));
    Planes there = make_planes(6, kPairs), back = make_planes(6, kPairs);
    for (size_t i = 0; i < kPairs; ++i)
        for (size_t k = 0; k < 3; ++k) {
            there[k][i] = back[3 + k][i] = static_cast<float>(a[i][k]);
            there[3 + k][i] = back[k][i] = static_cast<float>(b[i][k]);
        }
    const Planes f = test.eval_bsdf(surface, there), g = test.eval_bsdf(surface, back);
    // What radiance keeps on a path through a surface is radiance over the square of the index.
    const double n_a = c.below ? c.index() : 1, n_b = through ? c.index() / n_a : n_a;
    // The half vector and its slopes are rounded: 2e-5 is what float32 leaves of 1e-5 at roughness
    // 0.15. Glass has a critical angle, and where light goes nearly straight through, the half
    // vector is the small sum of two long vectors.
    const double tolerance = c.lets_through() ? 2e-4 : 2e-5, floor = c.lets_through() ? 5e-6 : 1e-7;
    double sum = 0;
    for (size_t i = 0; i < kPairs; ++i)
        for (size_t k = 0; k < 3; ++k) {
            const double x = f[k][i] / std::abs(b[i][2]) / (n_a * n_a),
                         y = g[k][i] / std::abs(a[i][2]) / (n_b * n_b);
            ASSERT_NEAR(x, y, tolerance * std::max(x, y) + floor) << c.name << " pair " << i;
            sum += x;
        }
    EXPECT_GT(sum, 0) << c.name;
}

TEST(Bsdf, IsReciprocal) {
    const std::vector<Case> cases = smooth_cases();
    SelfTest test(scene_with(cases));
    for (size_t c = 0; c < cases.size(); ++c) {
        expect_reciprocal(test, static_cast<int>(c), cases[c], false);
        if (cases[c].lets_through()) expect_reciprocal(test, static_cast<int>(c), cases[c], true);
    }
}

TEST(Bsdf, BackOfOneSidedIsBlack) {
    std::vector<Case> cases = opaque_cases();
    for (Case& c : cases) c.bsdf.two_sided = false;
    Bsdf mirror;
    mirror.type = Bsdf::Type::kConductor;
    cases.push_back({"mirror", mirror});
    SelfTest test(scene_with(cases));
    for (size_t c = 0; c < cases.size(); ++c)
        for (const Dir& wi : directions(10, true, 16)) {
            const Planes s = test.sample_bsdf(static_cast<int>(c), wi, 8, 256);
            for (size_t i = 0; i < 256; ++i)
                ASSERT_EQ(s[3][i] + s[4][i] + s[5][i], 0.0f) << cases[c].name;
        }
}

TEST(Bsdf, PerfectMirrorReflectsAll) {
    Bsdf mirror;
    mirror.type = Bsdf::Type::kConductor;  // eta 0, k 1
    SelfTest test(scene_with({{"mirror", mirror}}));
    for (const Dir& wi : directions(20, false, 17)) {
        const Planes s = test.sample_bsdf(0, wi, 9, 16);
        EXPECT_NEAR(s[0][0], -wi[0], 1e-6);
        EXPECT_NEAR(s[1][0], -wi[1], 1e-6);
        EXPECT_NEAR(s[2][0], wi[2], 1e-6);
        for (size_t k = 3; k < 6; ++k) EXPECT_NEAR(s[k][0], 1.0, 1e-5);
        EXPECT_TRUE(std::isinf(s[6][0]));
    }
}

TEST(Bsdf, MetalsReflectByFresnel) {
    Bsdf metal;
    metal.type = Bsdf::Type::kConductor;
    metal.eta = {0.14f, 1.4f, 2.8f};
    metal.k = {3.98f, 7.3f, 0.4f};
    metal.specular_reflectance = {0.9f, 1.0f, 0.5f};
    SelfTest test(scene_with({{"metal", metal}}));
    for (const Dir& wi : directions(25, false, 21)) {
        const Planes s = test.sample_bsdf(0, wi, 9, 16);
        for (size_t c = 0; c < 3; ++c) {
            // Fresnel's equations as they are, with complex numbers; Born and Wolf, section 1.5.2.
            const std::complex<double> n(metal.eta[c], metal.k[c]);
            const std::complex<double> cos_t = std::sqrt(1.0 - (1 - wi[2] * wi[2]) / (n * n));
            const double reflected = (std::norm((wi[2] - n * cos_t) / (wi[2] + n * cos_t)) +
                                      std::norm((n * wi[2] - cos_t) / (n * wi[2] + cos_t))) /
                                     2;
            EXPECT_NEAR(s[3 + c][0], metal.specular_reflectance[c] * reflected, 2e-6) << wi[2];
        }
    }
}

/// Reflectance by Fresnel's equations in double, for the index ratio n = transmitted over incident.
double fresnel(double cos_i, double n) {
    const double sin_t = std::sqrt(1 - cos_i * cos_i) / n;
    if (sin_t >= 1) return 1.0;
    const double cos_t = std::sqrt(1 - sin_t * sin_t);
    const double s = (cos_i - n * cos_t) / (cos_i + n * cos_t),
                 p = (n * cos_i - cos_t) / (n * cos_i + cos_t);
    return (s * s + p * p) / 2;
}

TEST(Bsdf, PlasticReflectsByFresnelAndItsBase) {
    // Power of either lobe against the formulas in double; coat and base of known reflectance.
    for (const bool nonlinear : {false, true}) {
        SelfTest test(scene_with(
            {{"plastic", plastic_of({0.8f, 0.5f, 0.1f}, {0.7f, 0.7f, 0.7f}, nonlinear)}}));
        constexpr size_t kCount = 1 << 16;
        const double n = 1.6, inner = -1.4399 / (n * n) + 0.7099 / n + 0.6681 + 0.0636 * n;
        double out = 0;  // cosine-weighted mean of what leaves
        for (int i = 0; i < 10000; ++i) out += (1 - fresnel(std::sqrt((i + 0.5) / 10000), n)) / 1e4;
        for (const Dir& wi : directions(20, false, 19)) {
            const Planes s = test.sample_bsdf(0, wi, 9, kCount);
            const double f = fresnel(wi[2], n);
            for (size_t k = 0; k < 3; ++k) {
                double coat = 0, base = 0, square = 0;
                for (size_t i = 0; i < kCount; ++i) {
                    (std::isinf(s[6][i]) ? coat : base) += s[3 + k][i] / kCount;
                    square += s[3 + k][i] * s[3 + k][i] / kCount;
                }
                const double rho = std::array{0.8, 0.5, 0.1}[k];
                const double expected =
                    rho / (1 - inner * (nonlinear ? rho : 1)) * (1 - f) * out / (n * n);
                const double spread = 4.5 * std::sqrt(square / kCount) + 1e-4;
                EXPECT_NEAR(coat, 0.7 * f, spread) << "cos " << wi[2];
                EXPECT_NEAR(base, expected, spread) << "cos " << wi[2];
            }
        }
    }
}

TEST(Bsdf, RoughGlassBecomesGlass) {
    SelfTest test(scene_with({{"rough glass", rough_glass(1e-4f)}}));
    constexpr size_t kCount = 1 << 12;
    for (bool below : {false, true})
        for (const Dir& wi : directions(25, below, 20)) {
            const double n = below ? 1 / 1.5 : 1.5, expected = fresnel(std::abs(wi[2]), n);
            const Planes s = test.sample_bsdf(0, wi, 10, kCount);
            size_t reflected = 0, strays = 0;  // GGX has a tail, however smooth
            for (size_t i = 0; i < kCount; ++i) {
                if (s[3][i] == 0) continue;
                const bool up = (s[2][i] > 0) == (wi[2] > 0);
                reflected += up;
                strays += std::abs(s[0][i] + wi[0] / (up ? 1 : n)) > 0.02 ||
                          std::abs(s[1][i] + wi[1] / (up ? 1 : n)) > 0.02;
                ASSERT_NEAR(s[7][i], up ? 1 : n, 1e-5);
            }
            EXPECT_LE(strays, kCount / 256) << "cos " << wi[2];
            const double spread = std::sqrt(expected * (1 - expected) / kCount);
            EXPECT_NEAR(static_cast<double>(reflected) / kCount, expected, 4.5 * spread + 2e-3)
                << "cos " << wi[2];
        }
}

TEST(Bsdf, GlassObeysSnellAndFresnel) {
    Bsdf glass;
    glass.type = Bsdf::Type::kDielectric;
    glass.int_ior = 1.5f;
    glass.ext_ior = 1.0f;
    SelfTest test(scene_with({{"glass", glass}}));
    constexpr size_t kCount = 1 << 14;
    for (bool below : {false, true})
        for (const Dir& wi : directions(25, below, 18)) {
            const double n = below ? 1 / 1.5 : 1.5, expected = fresnel(std::abs(wi[2]), n);
            const Planes s = test.sample_bsdf(0, wi, 10, kCount);
            size_t reflected = 0;
            for (size_t i = 0; i < kCount; ++i) {
                const bool up = (s[2][i] > 0) == (wi[2] > 0);
                reflected += up;
                ASSERT_NEAR(s[0][i], -wi[0] / (up ? 1 : n), 1e-5);
                ASSERT_NEAR(s[1][i], -wi[1] / (up ? 1 : n), 1e-5);
                ASSERT_NEAR(s[3][i], up ? 1 : 1 / (n * n), 1e-5)
                    << "radiance is scaled by the square of the index ratio";
                ASSERT_NEAR(s[7][i], up ? 1 : n, 1e-5);
            }
            const double spread = std::sqrt(expected * (1 - expected) / kCount);
            EXPECT_NEAR(static_cast<double>(reflected) / kCount, expected, 4.5 * spread + 1e-4)
                << "cos " << wi[2];
        }
}

}  // namespace
}  // namespace pave::test
