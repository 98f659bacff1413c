// Samplers: the inverse gives the numbers back, the density is that of the samples.
// SPDX-License-Identifier: BSD-3-Clause
#include "kernels/render_types.h"
#include "selftest.h"

namespace pave::test {
namespace {

// As in kernels/selftest.cl.
enum { kDisk, kCosine, kSphere, kCone, kTriangle };
constexpr size_t kCount = 1 << 16;

Planes grid() {
    Planes u = make_planes(2, kCount);
    for (size_t i = 0; i < kCount; ++i) {
        u[0][i] = (static_cast<float>(i % 256) + 0.5f) / 256;
        u[1][i] = (static_cast<float>(i / 256) + 0.5f) / 256;
    }
    return u;
}

class Samplers : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Lanes, Samplers, ::testing::Values(1, 4, 8, 16));

TEST_P(Samplers, InverseGivesTheNumbersBack) {
    SelfTest test(cornell(), GetParam());
    const Planes u = grid();
    for (int shape : {kDisk, kCosine, kSphere, kCone, kTriangle}) {
        const Planes out = test.sample_shape(shape, 0.25f, u);
        for (size_t i = 0; i < kCount; ++i)
            for (size_t k = 0; k < 2; ++k) {
                // The angle of a cone wraps around.
                const double gap = std::abs(static_cast<double>(out[4 + k][i]) - u[k][i]);
                ASSERT_LT(std::min(gap, 1 - gap), 2e-5)
                    << "shape " << shape << " u " << u[0][i] << " " << u[1][i];
            }
    }
}

TEST(SamplersOnce, StayInTheirDomain) {
    SelfTest test(cornell());
    const Planes u = grid();
    for (int shape : {kCosine, kSphere, kCone}) {
        const Planes out = test.sample_shape(shape, 0.25f, u);
        for (size_t i = 0; i < kCount; ++i) {
            const double x = out[0][i], y = out[1][i], z = out[2][i];
            ASSERT_NEAR(x * x + y * y + z * z, 1.0, 1e-6);
            ASSERT_GE(z, shape == kCosine ? 0.0 : shape == kCone ? 0.75 - 1e-6 : -1.0);
        }
    }
}

TEST(SamplersOnce, DensityIsThatOfTheSamples) {
    // Small steps in u span an area of solid angle; their ratio is the density.
    SelfTest test(cornell());
    Planes u = make_planes(2, 3 * 4096);
    constexpr float kStep = 1.0f / 512;
    for (size_t i = 0; i < 4096; ++i) {
        const float a = 0.05f + 0.9f * static_cast<float>(i % 64) / 64,
                    b = 0.05f + 0.9f * static_cast<float>(i / 64) / 64;
        for (size_t k = 0; k < 3; ++k) {
            u[0][3 * i + k] = a + (k == 1 ? kStep : 0);
            u[1][3 * i + k] = b + (k == 2 ? kStep : 0);
        }
    }
    for (int shape : {kCosine, kSphere, kCone}) {
        const Planes out = test.sample_shape(shape, 0.25f, u);
        double worst = 0;
        for (size_t i = 0; i < 4096; ++i) {
            const auto w = [&](size_t k) {
                return Double3{out[0][3 * i + k], out[1][3 * i + k], out[2][3 * i + k]};
            };
            const double area = length(cross(w(1) - w(0), w(2) - w(0)));
            // The disk's map has a seam along its diagonals, where the small step is torn.
            const bool seam =
                shape == kCosine &&
                std::abs(std::abs(2 * u[0][3 * i] - 1) - std::abs(2 * u[1][3 * i] - 1)) < 3 * kStep;
            if (!seam)
                worst = std::max(worst, std::abs(out[3][3 * i] * area / (kStep * kStep) - 1));
        }
        EXPECT_LT(worst, 0.05) << "shape " << shape;
    }
}

/// Maps a sampler's domain to the unit square so that equal areas have equal chances, and says what
/// the density by area or solid angle has to be.
struct Domain {
    int shape;
    std::array<double, 2> (*place)(double x, double y, double z);
    double (*density)(double z);
};
double turn_of(double x, double y) {
    const double turn = std::atan2(y, x) / (2 * M_PI);
    return turn < 0 ? turn + 1 : turn;
}
constexpr double kConeHeight = 0.25;  // 1 - cos of the half angle
const Domain kDomains[] = {
    {kDisk,
     [](double x, double y, double) {
         return std::array{x * x + y * y, turn_of(x, y)};
     },
     [](double) { return 1 / M_PI; }},
    // Cosine-weighted directions are uniform in z * z and the angle.
    {kCosine,
     [](double x, double y, double z) {
         return std::array{z * z, turn_of(x, y)};
     },
     [](double z) { return z / M_PI; }},
    {kSphere,
     [](double x, double y, double z) {
         return std::array{(z + 1) / 2, turn_of(x, y)};
     },
     [](double) { return 1 / (4 * M_PI); }},
    {kCone,
     [](double x, double y, double z) {
         return std::array{(1 - z) / kConeHeight, turn_of(x, y)};
     },
     [](double) { return 1 / (2 * M_PI * kConeHeight); }},
    // b1 / (1 - b2) and (1 - b2)^2 of the triangle with area 1/2.
    {kTriangle,
     [](double b1, double b2, double) {
         return std::array{(1 - b2) * (1 - b2), b2 < 1 ? b1 / (1 - b2) : 0.0};
     },
     [](double) { return 2.0; }},
};

TEST(SamplersChi2, SamplesFollowTheirDensity) {
    constexpr size_t kSide = 24, kSamples = 1 << 18;
    SelfTest test(cornell());
    const double least_p = sidak(static_cast<int>(std::size(kDomains)));
    for (const Domain& domain : kDomains) {
        const Planes units = test.philox_units(static_cast<uint32_t>(17 + domain.shape), kSamples);
        const Planes out = test.sample_shape(domain.shape, kConeHeight, {units[0], units[1]});
        std::vector<double> seen(kSide * kSide, 0.0);
        for (size_t i = 0; i < kSamples; ++i) {
            const auto at = domain.place(out[0][i], out[1][i], out[2][i]);
            const auto cell = [](double x) {
                return std::min(static_cast<size_t>(std::max(x, 0.0) * kSide), kSide - 1);
            };
            seen[cell(at[0]) * kSide + cell(at[1])] += 1;
            ASSERT_NEAR(out[3][i], domain.density(out[2][i]), 1e-5 * (1 + out[3][i]))
                << "shape " << domain.shape << " sample " << i;
        }
        const double expected = static_cast<double>(kSamples) / (kSide * kSide);
        double statistic = 0;
        for (double n : seen) statistic += (n - expected) * (n - expected) / expected;
        const double p = chi2_tail(statistic, kSide * kSide - 1);
        EXPECT_GT(p, least_p) << "shape " << domain.shape;
    }
}

}  // namespace
}  // namespace pave::test
