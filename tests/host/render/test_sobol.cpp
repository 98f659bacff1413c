// The stratified sampler: what its table promises, and that images keep their mean and lose noise.
// SPDX-License-Identifier: BSD-3-Clause
#include <bit>
#include <set>

#include "host/render/sobol.h"
#include "support.h"

namespace pave::test {
namespace {

/// Dimension 0, 1: camera; 2 to 5: vertex 0; 6 to 9: vertex 1; 10, 11: choices of the
/// lights; 12, 13: lobes.
std::vector<std::array<uint32_t, 14>> points() {
    const std::vector<Row> rows = sobol_rows();
    std::vector<std::array<uint32_t, 14>> result(SOBOL_SAMPLES);
    for (size_t i = 0; i < result.size(); ++i)
        for (size_t vertex = 0; vertex < SOBOL_VERTICES; ++vertex) {
            const Row& row = rows[i * SOBOL_VERTICES + vertex];
            for (size_t k = 0; k < 4; ++k)
                result[i][2 + 4 * vertex + k] = std::bit_cast<uint32_t>(row[k]);
            for (size_t k = 0; k < 2; ++k) result[i][k] = std::bit_cast<uint32_t>(row[4 + k]);
            result[i][10 + vertex] = std::bit_cast<uint32_t>(row[6]);
            result[i][12 + vertex] = std::bit_cast<uint32_t>(row[7]);
        }
    return result;
}

/// Whether each of the 2^(a + b) boxes with sides 2^-a and 2^-b holds one of as many points.
bool is_net(const std::vector<std::array<uint32_t, 14>>& p, size_t first, size_t x, size_t y, int a,
            int b) {
    std::set<std::pair<uint64_t, uint64_t>> boxes;
    const size_t count = size_t{1} << (a + b);
    for (size_t i = first; i < first + count; ++i)
        boxes.insert({uint64_t{p[i][x]} >> (32 - a), uint64_t{p[i][y]} >> (32 - b)});
    return boxes.size() == count;
}

TEST(Sobol, EveryDimensionIsStratified) {
    const auto p = points();
    for (size_t d = 0; d < 14; ++d)
        for (int log_count = 1; log_count <= 10; ++log_count)
            for (size_t first = 0; first < p.size(); first += size_t{1} << log_count)
                ASSERT_TRUE(is_net(p, first, d, d, log_count, 0)) << d << " " << log_count;
}

TEST(Sobol, CameraIsANetInTwoDimensions) {
    const auto p = points();
    for (int log_count = 1; log_count <= 10; ++log_count)
        for (int a = 0; a <= log_count; ++a)
            for (size_t first = 0; first < p.size(); first += size_t{1} << log_count)
                ASSERT_TRUE(is_net(p, first, 0, 1, a, log_count - a)) << log_count << " " << a;
}

TEST(Sobol, TableIsLinearInTheIndex) {
    const auto p = points();
    for (size_t i = 0; i < p.size(); ++i)
        for (size_t d = 0; d < 14; ++d)
            ASSERT_EQ(p[i][d], p[i & 15][d] ^ p[i & 0xf0][d] ^ p[i & 0x300][d]) << i << " " << d;
}

TEST(Sobol, LowBitsAreBalanced) {
    // Roulette reads the lowest byte; being linear, each bit is 1 in one half of the points or in
    // none.
    for (size_t d = 0; d < 14; ++d)
        for (int bit = 0; bit < 32; ++bit) {
            size_t ones = 0;
            for (const auto& point : points()) ones += point[d] >> bit & 1;
            EXPECT_EQ(ones, SOBOL_SAMPLES / 2) << "dimension " << d << " bit " << bit;
        }
}

/// Mean over pixels of the squared deviation from `truth`.
double error_of(const Frame& frame, const std::vector<double>& truth) {
    double sum = 0;
    const auto pixels = frame.channel("color");
    for (size_t i = 0; i < pixels.size(); ++i)
        sum += (pixels[i] - truth[i]) * (pixels[i] - truth[i]);
    return sum / static_cast<double>(pixels.size());
}

TEST(Sobol, EveryNumberAloneIsUniform) {
    // One sample: what each third of the image gets from the light, over many seeds.
    constexpr int kSize = 24, kSeeds = 256;
    Renderer renderer(device(), cornell());
    const auto third = [&](const Frame& frame, int which) {
        double sum = 0;
        for (int y = 0; y < kSize; ++y)
            for (int x = kSize / 3 * which; x < kSize / 3 * (which + 1); ++x)
                sum += frame.channel("direct")[static_cast<size_t>(kSize * y + x)];
        return 3 * sum / (kSize * kSize);
    };
    const Frame truth = render(renderer, kSize, kSize, {"direct"},
                               {.spp = 1 << 15, .sampler = Sampler::kIndependent, .seed = 77});
    double sum[3] = {}, squares[3] = {};
    for (uint64_t seed = 0; seed < kSeeds; ++seed) {
        const Frame frame = render(renderer, kSize, kSize, {"direct"}, {.spp = 1, .seed = seed});
        for (int which = 0; which < 3; ++which) {
            const double m = third(frame, which);
            sum[which] += m;
            squares[which] += m * m;
        }
    }
    for (int which = 0; which < 3; ++which) {
        const double m = sum[which] / kSeeds;
        const double error = std::sqrt((squares[which] / kSeeds - m * m) / (kSeeds - 1));
        EXPECT_NEAR(m, third(truth, which), 4 * error) << "third " << which;
        EXPECT_LT(error, 0.02 * m);
    }
}

TEST(Sobol, KeepsTheMeanAndHasLessNoise) {
    // A block of the table and less, and more than one block.
    constexpr int kSize = 24;
    for (const Scene& scene : {cornell(), menagerie()}) {
        Renderer renderer(device(), scene);
        for (const int spp : {16, 1536}) {
            const int images = spp == 16 ? 64 : 4;
            std::vector<double> truth(3 * kSize * kSize);
            for (int k = 0; k < 8; ++k) {
                const Frame frame = render(renderer, kSize, kSize, {"color"},
                                           {.spp = 2048,
                                            .sampler = Sampler::kIndependent,
                                            .seed = 1000 + static_cast<uint64_t>(k)});
                for (size_t i = 0; i < truth.size(); ++i)
                    truth[i] += static_cast<double>(frame.channel("color")[i]) / 8;
            }
            double error[2] = {}, mean_of[2] = {}, squares[2] = {};
            for (int s = 0; s < 2; ++s)
                for (int k = 0; k < images; ++k) {
                    const RenderOptions options{
                        .spp = spp,
                        .sampler = s == 0 ? Sampler::kSobol : Sampler::kIndependent,
                        .seed = static_cast<uint64_t>(k)};
                    const Frame frame = render(renderer, kSize, kSize, {"color"}, options);
                    error[s] += error_of(frame, truth) / images;
                    const double m = mean(frame, "color");
                    mean_of[s] += m / images;
                    squares[s] += m * m / images;
                }
            double spread = 0;
            for (int s = 0; s < 2; ++s)
                spread += std::max(squares[s] - mean_of[s] * mean_of[s], 0.0) / (images - 1);
            EXPECT_NEAR(mean_of[0], mean_of[1], 4 * std::sqrt(spread)) << scene.name << " " << spp;
            if (spp == 16) {
                EXPECT_LT(error[0], 0.8 * error[1]) << scene.name;
            } else {
                EXPECT_LT(error[0], error[1]) << scene.name;
            }
            RecordProperty(scene.name + std::to_string(spp), std::to_string(error[0] / error[1]));
            std::printf("%s, %d samples: error %.3f of that of independent samples\n",
                        scene.name.c_str(), spp, error[0] / error[1]);
        }
    }
}

}  // namespace
}  // namespace pave::test
