// The kernels of kernels/selftest.cl for one scene, and the statistics that judge what they return.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <functional>
#include <span>

#include "host/render/options.h"
#include "support.h"

namespace pave::test {

using Planes = std::vector<std::vector<float>>;  // [plane][item]

/// Runs single parts of the path tracer on the device. Item counts are multiples of 16.
class SelfTest {
   public:
    explicit SelfTest(const Scene& scene, int lanes = 8,
                      const RendererPaths& paths = {.specialise = false});

    const SceneData& data() const { return data_; }
    std::vector<uint32_t> struct_sizes();
    std::vector<std::array<uint32_t, 4>> philox(
        const std::vector<std::array<uint32_t, 4>>& counters, uint32_t key_low, uint32_t key_high);
    Planes philox_units(uint32_t seed, size_t count);
    /// w (3), pdf, inverse (2) for u1, u2.
    Planes sample_shape(int shape, float parameter, const Planes& u);
    /// wo (3), weight (3), pdf, eta of `count` samples.
    Planes sample_bsdf(int surface, std::array<double, 3> wi, uint32_t seed, size_t count);
    /// Power of `count` samples, a multiple of 2^14, over that of wi: radiance without the square
    /// of the index ratio.
    std::array<double, 3> bsdf_power(int surface, std::array<double, 3> wi, uint32_t seed,
                                     size_t count);
    /// f * cos (3), pdf for wi (3), wo (3).
    Planes eval_bsdf(int surface, const Planes& pairs);
    /// Colour (3) at u, v.
    Planes texture(int texture, const Planes& uv);
    /// wi (3), pdf, radiance (3), end (3).
    Planes sample_light(std::array<float, 3> at, uint32_t seed, size_t count);
    std::vector<float> light_pdf(std::array<float, 3> at, const Planes& directions);
    /// t, id, b1, b2, position (3), n_geom (3), n_shade (3), offset, any, instance. Rays: origin
    /// (3), direction (3), t_max, skip and its instance as bits.
    Planes trace(const Planes& rays);

   private:
    template <class... Args>
    Planes run(const char* kernel, size_t planes, size_t count, const Args&... args);
    cl::Buffer upload(const Planes& planes);

    SceneData data_;
    int lanes_;
    cl::Program program_;
    cl::Buffer params_, shapes_, tree_, tables_, light_cdf_;
};

/// Planes of `count` items, zero-filled.
inline Planes make_planes(size_t planes, size_t count) {
    return Planes(planes, std::vector<float>(count, 0.0f));
}

/// Probability that a chi-square variable with `freedom` degrees exceeds `statistic`.
double chi2_tail(double statistic, double freedom);

/// Judges samples of directions against a density by solid angle: histogram over cos(theta) and
/// phi, cells below 5 pooled.
struct DirectionTest {
    size_t rows = 16, columns = 32;  // cells
    size_t fine = 32;                // points a cell side where the density is integrated; four
                                     // times as many where it has an edge

    /// p-value; `valid(i)` says whether sample i is a direction at all, the rest must be what the
    /// density lacks to 1.
    double p_value(const Planes& directions, const std::function<bool(size_t)>& valid,
                   const std::function<std::vector<float>(const Planes&)>& density) const;

   private:
    std::vector<double> sums_over(const std::vector<size_t>& some, size_t fine,
                                  const std::function<std::vector<float>(const Planes&)>& density,
                                  std::vector<bool>* uneven) const;
};

/// Least p-value of `tests` tests that together raise a false alarm once in a hundred runs (Sidak).
inline double sidak(int tests) { return 1.0 - std::pow(0.99, 1.0 / tests); }

}  // namespace pave::test
