// The first points of the Sobol sequence, scrambled, as rows for the sampler.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/sobol.h"

#include <array>
#include <bit>
#include <cstddef>

namespace pave {
namespace {

constexpr int kBits = 32;
constexpr int kIndexBits = 10;
static_assert(1 << kIndexBits == SOBOL_SAMPLES);
constexpr size_t kDimensions = 2 + 6 * SOBOL_VERTICES;

/// A primitive polynomial (degree, inner coefficients as bits) and the first odd integers of its
/// recurrence.
struct Direction {
    int degree;
    uint32_t coefficients;
    std::array<uint32_t, 6> first;
};
// Joe and Kuo 2008, "Constructing Sobol sequences with better two-dimensional projections", the
// published table for dimensions 2 to 14; dimension 1 is the bits in reverse.
constexpr std::array<Direction, 13> kDirections = {{{1, 0, {1}},
                                                    {2, 1, {1, 3}},
                                                    {3, 1, {1, 3, 1}},
                                                    {3, 2, {1, 1, 1}},
                                                    {4, 1, {1, 1, 3, 3}},
                                                    {4, 4, {1, 3, 5, 13}},
                                                    {5, 2, {1, 1, 5, 5, 17}},
                                                    {5, 4, {1, 1, 5, 5, 5}},
                                                    {5, 7, {1, 1, 7, 11, 19}},
                                                    {5, 11, {1, 1, 5, 1, 1}},
                                                    {5, 13, {1, 1, 1, 3, 11}},
                                                    {5, 14, {1, 3, 5, 5, 31}},
                                                    {6, 1, {1, 3, 3, 9, 7, 49}}}};
static_assert(kDirections.size() + 1 == kDimensions);

/// Column k: what bit k of the index contributes.
std::array<uint32_t, kIndexBits> columns(size_t dimension) {
    std::array<uint32_t, kIndexBits> v{};
    for (size_t k = 0; k < v.size(); ++k) {
        if (dimension == 0) {
            v[k] = 1u << (kBits - 1 - k);
            continue;
        }
        const Direction& d = kDirections[dimension - 1];
        const auto degree = static_cast<size_t>(d.degree);
        if (k < degree) {
            v[k] = d.first[k] << (kBits - 1 - k);
            continue;
        }
        v[k] = v[k - degree] ^ (v[k - degree] >> degree);
        for (size_t j = 1; j < degree; ++j)
            if (d.coefficients >> (degree - 1 - j) & 1) v[k] ^= v[k - j];
    }
    return v;
}

/// Well mixed bits of a number; the finalizer of Steele et al. 2014, "Fast splittable pseudorandom
/// number generators".
uint64_t mix(uint64_t x) {
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

/// Linear scrambling of Matousek: each digit gets a fixed random combination of those before it.
/// With a digital shift, which the kernels give each pixel, its variance is that of Owen's nested
/// scrambling; Owen 2003, "Variance with alternative scramblings of digital nets". Being linear, it
/// leaves the table a sum of what the index's bits contribute.
uint32_t scramble(uint32_t x, size_t dimension) {
    uint32_t result = 0;
    for (int digit = 0; digit < kBits; ++digit) {
        const auto random = static_cast<uint32_t>(
            mix((static_cast<uint64_t>(dimension) << 8 | static_cast<uint64_t>(digit)) +
                0x9e3779b97f4a7c15u) >>
            32);
        const uint32_t before = digit == 0 ? 0 : ~0u << (kBits - digit);
        const uint32_t own = 1u << (kBits - 1 - digit);
        if (std::popcount(x & ((random & before) | own)) & 1) result |= own;
    }
    return result;
}

}  // namespace

std::vector<Row> sobol_rows() {
    std::array<std::array<uint32_t, SOBOL_SAMPLES>, kDimensions> points{};
    for (size_t d = 0; d < kDimensions; ++d) {
        auto column = columns(d);
        for (uint32_t& x : column) x = scramble(x, d);
        for (uint32_t i = 0; i < SOBOL_SAMPLES; ++i) {
            for (size_t k = 0; k < column.size(); ++k)
                if (i >> k & 1) points[d][i] ^= column[k];
        }
    }
    // Dimensions: 0, 1 camera; then light and BSDF of each vertex; last the lights' choices and the
    // lobes.
    std::vector<Row> rows(static_cast<size_t>(SOBOL_SAMPLES) * SOBOL_VERTICES);
    for (size_t i = 0; i < SOBOL_SAMPLES; ++i)
        for (size_t vertex = 0; vertex < SOBOL_VERTICES; ++vertex) {
            Row& row = rows[i * SOBOL_VERTICES + vertex];
            for (size_t k = 0; k < 4; ++k) row[k] = as_float_bits(points[2 + 4 * vertex + k][i]);
            row[4] = as_float_bits(points[0][i]);
            row[5] = as_float_bits(points[1][i]);
            row[6] = as_float_bits(points[2 + 4 * SOBOL_VERTICES + vertex][i]);
            row[7] = as_float_bits(points[2 + 5 * SOBOL_VERTICES + vertex][i]);
        }
    return rows;
}

}  // namespace pave
