// The kernels of kernels/selftest.cl for one scene, and the statistics that judge what they return.
// SPDX-License-Identifier: BSD-3-Clause
#include "selftest.h"

#include <algorithm>
#include <bit>
#include <numeric>

namespace pave::test {

SelfTest::SelfTest(const Scene& scene, int lanes, const RendererPaths& paths)
    : data_(build_scene_data(scene, paths)), lanes_(lanes) {
    const FrameSchema schema = FrameSchema::of_known(1, 1, {"color"});
    const kernel::PathParams p = make_params(data_, scene, scene.view, {}, schema, lanes);
    params_ = make_buffer_of(device(), std::array{p}, "parameters");
    shapes_ = make_buffer_of(device(), pack_shapes(data_, lanes), "shapes");
    tree_ = make_buffer_of(device(), data_.tree, "tree");
    tables_ = make_buffer_of(device(), pack_tables(data_), "tables");
    light_cdf_ = make_buffer_of(device(), data_.light_cdf, "lights");
    Defines defines = data_.features;
    defines.insert_or_assign("PAVE_LANES", lanes);
    if (!paths.specialise)
        defines.insert_or_assign("PAVE_STACK",
                                 std::max(data_.stack, 128));  // one program for most tests
    program_ = build_program(device(), "selftest.cl", defines);
}

cl::Buffer SelfTest::upload(const Planes& planes) {
    std::vector<float> all;
    for (const auto& plane : planes) all.insert(all.end(), plane.begin(), plane.end());
    return make_buffer_of(device(), all, "test input");
}

template <class... Args>
Planes SelfTest::run(const char* name, size_t planes, size_t count, const Args&... args) {
    if (count % 16 != 0) throw InternalError("item counts of self tests are multiples of 16");
    cl::Kernel kernel = make_kernel(program_, name);
    const cl::Buffer out = make_buffer(device(), planes * count * sizeof(float), "test output");
    launch(device(), kernel, cl::NDRange(count / static_cast<size_t>(lanes_)), cl::NDRange(1),
           args..., out, static_cast<cl_int>(count));
    std::vector<float> all(planes * count);
    read_buffer(device(), out, all, name);
    Planes result;
    for (size_t i = 0; i < planes; ++i)
        result.emplace_back(all.begin() + static_cast<std::ptrdiff_t>(i * count),
                            all.begin() + static_cast<std::ptrdiff_t>((i + 1) * count));
    return result;
}

std::vector<uint32_t> SelfTest::struct_sizes() {
    cl::Kernel kernel = make_kernel(program_, "struct_sizes");
    std::vector<uint32_t> sizes(4);
    const cl::Buffer out = make_buffer(device(), sizes.size() * sizeof(uint32_t), "struct sizes");
    launch(device(), kernel, cl::NDRange(1), cl::NDRange(1), out);
    read_buffer(device(), out, sizes, "struct sizes");
    return sizes;
}

std::vector<std::array<uint32_t, 4>> SelfTest::philox(
    const std::vector<std::array<uint32_t, 4>>& counters, uint32_t key_low, uint32_t key_high) {
    Planes in = make_planes(4, counters.size());
    for (size_t i = 0; i < counters.size(); ++i)
        for (size_t k = 0; k < 4; ++k) in[k][i] = std::bit_cast<float>(counters[i][k]);
    const Planes out = run("philox_bits", 4, counters.size(), upload(in), key_low, key_high);
    std::vector<std::array<uint32_t, 4>> bits(counters.size());
    for (size_t i = 0; i < counters.size(); ++i)
        for (size_t k = 0; k < 4; ++k) bits[i][k] = std::bit_cast<uint32_t>(out[k][i]);
    return bits;
}

Planes SelfTest::philox_units(uint32_t seed, size_t count) {
    return run("philox_units", 5, count, seed);
}
Planes SelfTest::sample_shape(int shape, float parameter, const Planes& u) {
    return run("sample_shape", 6, u[0].size(), shape, parameter, upload(u));
}

static cl_float4 float4_of(double x, double y, double z) {
    return {{static_cast<float>(x), static_cast<float>(y), static_cast<float>(z), 0.0f}};
}
Planes SelfTest::sample_bsdf(int surface, std::array<double, 3> wi, uint32_t seed, size_t count) {
    return run("sample_bsdf_many", 8, count, params_, tables_, surface,
               float4_of(wi[0], wi[1], wi[2]), seed);
}
std::array<double, 3> SelfTest::bsdf_power(int surface, std::array<double, 3> wi, uint32_t seed,
                                           size_t count) {
    constexpr size_t kItems = 1 << 14;
    const Planes sums =
        run("bsdf_power_many", 3, kItems, params_, tables_, surface, float4_of(wi[0], wi[1], wi[2]),
            seed, static_cast<cl_int>(count / kItems));
    std::array<double, 3> power{};
    for (size_t c = 0; c < 3; ++c)
        power[c] = std::accumulate(sums[c].begin(), sums[c].end(), 0.0) /
                   static_cast<double>(count / kItems * kItems);
    return power;
}
Planes SelfTest::eval_bsdf(int surface, const Planes& pairs) {
    return run("eval_bsdf_many", 4, pairs[0].size(), params_, tables_, surface, upload(pairs));
}
Planes SelfTest::texture(int texture, const Planes& uv) {
    return run("texture_many", 3, uv[0].size(), params_, tables_, texture, upload(uv));
}
Planes SelfTest::sample_light(std::array<float, 3> at, uint32_t seed, size_t count) {
    return run("sample_light_many", 10, count, params_, tables_, light_cdf_,
               float4_of(at[0], at[1], at[2]), seed);
}
std::vector<float> SelfTest::light_pdf(std::array<float, 3> at, const Planes& directions) {
    return run("light_pdf_many", 1, directions[0].size(), params_, shapes_, tree_, tables_,
               light_cdf_, float4_of(at[0], at[1], at[2]), upload(directions))[0];
}
Planes SelfTest::trace(const Planes& rays) {
    return run("trace_many", 16, rays[0].size(), params_, shapes_, tree_, tables_, upload(rays));
}

/// Upper regularised incomplete gamma function: series below a + 1, Lentz's continued fraction
/// above.
static double gamma_tail(double a, double x) {
    if (x <= 0) return 1.0;
    const double front = std::exp(a * std::log(x) - x - std::lgamma(a));
    if (x < a + 1) {
        double term = 1 / a, sum = term;
        for (int n = 1; n < 100000 && term > sum * 1e-16; ++n) sum += term *= x / (a + n);
        return 1 - front * sum;
    }
    double b = x + 1 - a, c = 1e300, d = 1 / b, h = d;
    for (int n = 1; n < 100000; ++n) {
        const double an = -n * (n - a);
        b += 2;
        d = 1 / (an * d + b);
        c = b + an / c;
        h *= d * c;
        if (std::abs(d * c - 1) < 1e-15) break;
    }
    return front * h;
}
double chi2_tail(double statistic, double freedom) {
    return gamma_tail(freedom / 2, statistic / 2);
}

/// Sums of the density over `fine` x `fine` points of each of `some` cells, and which of these
/// cells are uneven: an edge or a steep flank of the density lies in them.
std::vector<double> DirectionTest::sums_over(
    const std::vector<size_t>& some, size_t fine,
    const std::function<std::vector<float>(const Planes&)>& density,
    std::vector<bool>* uneven) const {
    const size_t points_a_cell = fine * fine;
    Planes points = make_planes(3, some.size() * points_a_cell);
    const auto steps = static_cast<double>(fine);
    size_t i = 0;
    for (size_t cell : some)
        for (size_t a = 0; a < fine; ++a)
            for (size_t b = 0; b < fine; ++b, ++i) {
                const double row =
                    static_cast<double>(cell / columns) + (static_cast<double>(a) + 0.5) / steps;
                const double column =
                    static_cast<double>(cell % columns) + (static_cast<double>(b) + 0.5) / steps;
                const double z = 2 * row / static_cast<double>(rows) - 1;
                const double phi = 2 * M_PI * column / static_cast<double>(columns);
                const double r = std::sqrt(1 - z * z);
                points[0][i] = static_cast<float>(r * std::cos(phi));
                points[1][i] = static_cast<float>(r * std::sin(phi));
                points[2][i] = static_cast<float>(z);
            }
    const std::vector<float> pdf = density(points);
    std::vector<double> sums;
    for (size_t k = 0; k < some.size(); ++k) {
        const auto first = pdf.begin() + static_cast<std::ptrdiff_t>(k * points_a_cell);
        const auto last = first + static_cast<std::ptrdiff_t>(points_a_cell);
        sums.push_back(std::accumulate(first, last, 0.0));
        if (uneven != nullptr) {
            const auto [least, most] = std::minmax_element(first, last);
            (*uneven)[some[k]] = *least < 0.7f * *most;
        }
    }
    return sums;
}

double DirectionTest::p_value(
    const Planes& directions, const std::function<bool(size_t)>& valid,
    const std::function<std::vector<float>(const Planes&)>& density) const {
    const size_t cells = rows * columns, count = directions[0].size();
    std::vector<double> seen(cells + 1, 0.0), expected(cells + 1, 0.0);
    for (size_t i = 0; i < count; ++i) {
        if (!valid(i)) {
            seen[cells] += 1;
            continue;
        }
        const double turn = std::atan2(directions[1][i], directions[0][i]) / (2 * M_PI);
        const double row = (directions[2][i] + 1.0) / 2 * static_cast<double>(rows);
        const double column = (turn < 0 ? turn + 1 : turn) * static_cast<double>(columns);
        seen[std::min(static_cast<size_t>(std::max(row, 0.0)), rows - 1) * columns +
             std::min(static_cast<size_t>(column), columns - 1)] += 1;
    }
    const double all = static_cast<double>(count) * 4 * M_PI / static_cast<double>(cells);
    std::vector<size_t> every(cells), edges;
    std::iota(every.begin(), every.end(), size_t{0});
    std::vector<bool> uneven(cells);
    const std::vector<double> coarse = sums_over(every, fine, density, &uneven);
    for (size_t cell : every) {
        expected[cell] = all * coarse[cell] / static_cast<double>(fine * fine);
        // A cell may hold less of a light than its points are apart.
        if (uneven[cell] || (expected[cell] == 0 && seen[cell] > 0)) edges.push_back(cell);
    }
    const size_t finer = 4 * fine;
    const std::vector<double> exact = sums_over(edges, finer, density, nullptr);
    for (size_t k = 0; k < edges.size(); ++k)
        expected[edges[k]] = all * exact[k] / static_cast<double>(finer * finer);
    expected[cells] = std::max(
        0.0, static_cast<double>(count) - std::accumulate(expected.begin(), expected.end(), 0.0));

    std::vector<size_t> order(cells + 1);
    std::iota(order.begin(), order.end(), size_t{0});
    std::sort(order.begin(), order.end(),
              [&](size_t a, size_t b) { return expected[a] < expected[b]; });
    double statistic = 0, pooled_seen = 0, pooled_expected = 0;
    int used = 0;
    for (size_t cell : order) {
        pooled_seen += seen[cell];
        pooled_expected += expected[cell];
        if (pooled_expected < 5) continue;
        statistic +=
            (pooled_seen - pooled_expected) * (pooled_seen - pooled_expected) / pooled_expected;
        ++used;
        pooled_seen = pooled_expected = 0;
    }
    return used > 1 ? chi2_tail(statistic, used - 1) : 1.0;
}

}  // namespace pave::test
