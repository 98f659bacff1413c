// How the error falls with the samples, and whether `variance` says how large it is.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>

#include "support.h"

namespace pave::test {
namespace {

constexpr int kSize = 48;
const std::vector<std::string> kChannels{"color", "variance"};

/// Two independent images of `spp` samples a pixel.
std::array<Frame, 2> pair_of(Renderer& renderer, int spp) {
    const auto image = [&](uint64_t seed) {
        return render(renderer, kSize, kSize, kChannels,
                      {.spp = spp, .sampler = Sampler::kIndependent, .seed = seed});
    };
    return {image(2 * static_cast<uint64_t>(spp)), image(2 * static_cast<uint64_t>(spp) + 1)};
}

TEST(Convergence, ErrorFallsAsOneOverSamples) {
    Renderer renderer(device(), cornell());
    // Least squares of log2(error) over log2(samples), 2^4 to 2^14.
    double n = 0, x_sum = 0, y_sum = 0, xx_sum = 0, xy_sum = 0;
    for (int log_spp = 4; log_spp <= 14; log_spp += 2) {
        const auto [a, b] = pair_of(renderer, 1 << log_spp);
        double error = 0;
        for (size_t i = 0; i < 3 * kSize * kSize; ++i) {
            const double gap = a.channel("color")[i] - b.channel("color")[i];
            error += gap * gap;
        }
        const double x = log_spp, y = std::log2(error);
        n += 1, x_sum += x, y_sum += y, xx_sum += x * x, xy_sum += x * y;
    }
    const double slope = (n * xy_sum - x_sum * y_sum) / (n * xx_sum - x_sum * x_sum);
    EXPECT_NEAR(slope, -1.0, 0.05);
}

TEST(Convergence, VarianceIsAOneSigmaBand) {
    Renderer renderer(device(), cornell());
    const auto [a, b] = pair_of(renderer, 4096);
    size_t inside = 0, noisy = 0;
    for (size_t i = 0; i < 3 * kSize * kSize; ++i) {
        const double band = std::sqrt(static_cast<double>(a.channel("variance")[i]) +
                                      static_cast<double>(b.channel("variance")[i]));
        noisy += band > 0;
        inside += band > 0 && std::abs(a.channel("color")[i] - b.channel("color")[i]) <= band;
    }
    EXPECT_GT(noisy, size_t{2 * kSize * kSize});
    EXPECT_NEAR(static_cast<double>(inside) / static_cast<double>(noisy), 0.6827, 0.03);
}

TEST(Convergence, PixelsAreIndependent) {
    // Over many pairs of images, what one pixel is off says nothing of its neighbours.
    Renderer renderer(device(), cornell());
    for (const Sampler sampler : {Sampler::kSobol, Sampler::kIndependent}) {
        double own = 0, beside = 0, below = 0;
        for (uint64_t seed = 0; seed < 32; seed += 2) {
            std::vector<double> gap;
            const RenderOptions options{.spp = 16, .sampler = sampler, .seed = seed};
            RenderOptions other = options;
            ++other.seed;
            const Frame a = render(renderer, kSize, kSize, kChannels, options),
                        b = render(renderer, kSize, kSize, kChannels, other);
            // As many standard deviations, so that all pixels count alike.
            for (size_t i = 0; i < kSize * kSize; ++i) {
                const double deviation = std::sqrt(a.channel("variance")[i] +
                                                   static_cast<double>(b.channel("variance")[i]));
                const double off = a.channel("color")[i] - b.channel("color")[i];
                gap.push_back(deviation > 0 ? std::clamp(off / deviation, -3.0, 3.0) : 0);
            }
            for (size_t i = 0; i + kSize < gap.size(); ++i) {
                own += gap[i] * gap[i];
                if (i % kSize + 1 < kSize) beside += gap[i] * gap[i + 1];
                below += gap[i] * gap[i + kSize];
            }
        }
        EXPECT_NEAR(beside / own, 0.0, 0.03);
        EXPECT_NEAR(below / own, 0.0, 0.03);
    }
}

}  // namespace
}  // namespace pave::test
