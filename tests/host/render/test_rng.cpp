// Random numbers: published vectors, host and device bit for bit, uniform and independent words;
// shared struct sizes.
// SPDX-License-Identifier: BSD-3-Clause
#include <random>

#include "selftest.h"

namespace pave::test {
namespace {

using Block = std::array<uint32_t, 4>;

/// Philox4x32-7 once more, for the host; Salmon et al. 2011, section 3.3.
Block philox_host(Block c, uint32_t k0, uint32_t k1) {
    for (int round = 0; round < 7; ++round) {
        const uint64_t p0 = uint64_t{0xD2511F53} * c[0], p1 = uint64_t{0xCD9E8D57} * c[2];
        c = {static_cast<uint32_t>(p1 >> 32) ^ c[1] ^ k0, static_cast<uint32_t>(p1),
             static_cast<uint32_t>(p0 >> 32) ^ c[3] ^ k1, static_cast<uint32_t>(p0)};
        k0 += 0x9E3779B9;
        k1 += 0xBB67AE85;
    }
    return c;
}

struct KnownAnswer {
    Block counter;
    std::array<uint32_t, 2> key;
    Block answer;
};
// Random123's kat_vectors for philox4x32 with 7 rounds.
constexpr KnownAnswer kKnownAnswers[] = {
    {{0, 0, 0, 0}, {0, 0}, {0x5f6fb709, 0x0d893f64, 0x4f121f81, 0x4f730a48}},
    {{0xffffffff, 0xffffffff, 0xffffffff, 0xffffffff},
     {0xffffffff, 0xffffffff},
     {0x5207ddc2, 0x45165e59, 0x4d8ee751, 0x8c52f662}},
    {{0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344},
     {0xa4093822, 0x299f31d0},
     {0x4dfccaba, 0x190a87f0, 0xc47362ba, 0xb6b5242a}},
};

class Rng : public ::testing::TestWithParam<int> {};
INSTANTIATE_TEST_SUITE_P(Lanes, Rng, ::testing::Values(1, 4, 8, 16));

TEST_P(Rng, GivesPublishedVectors) {
    SelfTest test(cornell(), GetParam());
    for (const KnownAnswer& known : kKnownAnswers) {
        EXPECT_EQ(philox_host(known.counter, known.key[0], known.key[1]), known.answer);
        for (const Block& block :
             test.philox(std::vector<Block>(16, known.counter), known.key[0], known.key[1]))
            EXPECT_EQ(block, known.answer);
    }
}

TEST_P(Rng, IsTheSameOnHostAndDevice) {
    std::mt19937 rng(7);
    std::vector<Block> counters(4096);
    for (Block& counter : counters)
        for (uint32_t& word : counter) word = static_cast<uint32_t>(rng());
    const auto k0 = static_cast<uint32_t>(rng()), k1 = static_cast<uint32_t>(rng());
    const std::vector<Block> blocks = SelfTest(cornell(), GetParam()).philox(counters, k0, k1);
    for (size_t i = 0; i < counters.size(); ++i)
        ASSERT_EQ(blocks[i], philox_host(counters[i], k0, k1)) << "counter " << i;
}

TEST_P(Rng, StructsHaveOneSize) {
    const std::vector<uint32_t> sizes = SelfTest(cornell(), GetParam()).struct_sizes();
    EXPECT_EQ(sizes[0], sizeof(kernel::FlatShape));
    EXPECT_EQ(sizes[1], sizeof(kernel::CubeShape));
    EXPECT_EQ(sizes[2], sizeof(kernel::SphereShape));
    EXPECT_EQ(sizes[3], sizeof(kernel::PathParams));
    const auto lanes = static_cast<uint32_t>(GetParam());
    const std::vector<uint32_t> repeated = SelfTest(cornell(), GetParam(), {}).struct_sizes();
    EXPECT_EQ(repeated[0], lanes * sizeof(kernel::FlatShape));
    EXPECT_EQ(repeated[1], lanes * sizeof(kernel::CubeShape));
}

TEST(RngUnits, AreUniformAndIndependent) {
    constexpr size_t kCount = 1 << 18, kCells = 16;
    const Planes u = SelfTest(cornell()).philox_units(3, kCount);
    const double least_p = sidak(15);
    for (size_t a = 0; a < 5; ++a) {
        for (float x : u[a]) ASSERT_TRUE(x >= 0.0f && x < 1.0f);
        for (size_t b = a; b < 5; ++b) {
            // For one number also against its successor, the neighbouring sample's.
            std::vector<double> seen(kCells * kCells, 0.0);
            for (size_t i = 0; i + 1 < kCount; ++i) {
                const float y = a == b ? u[b][i + 1] : u[b][i];
                seen[static_cast<size_t>(u[a][i] * kCells) * kCells +
                     static_cast<size_t>(y * kCells)] += 1;
            }
            const double expected = static_cast<double>(kCount - 1) / (kCells * kCells);
            double statistic = 0;
            for (double n : seen) statistic += (n - expected) * (n - expected) / expected;
            EXPECT_GT(chi2_tail(statistic, kCells * kCells - 1), least_p)
                << "numbers " << a << " and " << b;
        }
    }
}

TEST(Chi2, KnowsPublishedQuantiles) {
    // Abramowitz and Stegun, table 26.8.
    EXPECT_NEAR(chi2_tail(3.84146, 1), 0.05, 1e-6);
    EXPECT_NEAR(chi2_tail(18.3070, 10), 0.05, 1e-6);
    EXPECT_NEAR(chi2_tail(135.807, 100), 0.01, 1e-6);
}

}  // namespace
}  // namespace pave::test
