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

}  // namespace
}  // namespace pave::test
