// How many rays a second does PAVE trace through a mesh, beside Embree's single rays?
// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <cstdio>
#include <memory>
#include <string>

#include "bench/meshes.h"
#include "bench/peers.h"
#include "bench/report.h"

namespace pave::bench {
namespace {

// Embree without its robust flag lets a few rays through edges, and the two round t differently.
constexpr double kMaxWrong = 2e-5;
constexpr float kTolerance = 1e-4f;

struct MeshSize {
    const char* name;
    size_t triangles;
};

bool same_t(float a, float b) {
    return a == b || std::abs(a - b) <= kTolerance * (1 + std::abs(b));
}

/// One mesh on both sides; `embree` is null without peers.
struct Subjects {
    const Options& options;
    const Device& device;
    RayTracer& tracer;
    const EmbreeScene* embree;
};

void report(const Subjects& s, const std::string& name, size_t rays,
            const std::vector<Series>& series) {
    const bool peers = s.embree != nullptr;
    Line line{"rays",
              name,
              "rays_per_second",
              "Mrays/s",
              "embree 3 single rays",
              static_cast<double>(rays) * 1e-6};
    print(line, s.device, series[0].wall_s, peers ? &series[1].wall_s : nullptr);
    line.metric = "rays_per_cpu_second";
    line.unit = "Mrays/cpu-s";
    print(line, s.device, series[0].cpu_s, peers ? &series[1].cpu_s : nullptr);
}

void check_share(const std::string& name, size_t wrong, size_t count) {
    std::fprintf(stderr, "%s: %zu of %zu rays differ from Embree's\n", name.c_str(), wrong, count);
    if (static_cast<double>(wrong) > kMaxWrong * static_cast<double>(count))
        fail(name + ": " + std::to_string(wrong) + " of " + std::to_string(count) +
             " rays have another answer than Embree's");
}

/// Checks PAVE's answers against Embree's, then times both. `trace(tracer, answers)` serves either
/// tracer.
template <class Answer, class Trace, class Same>
void ray_case(const Subjects& s, const std::string& name, size_t count, Trace trace, Same same) {
    if (name.find(s.options.only) == std::string::npos) return;
    std::vector<Answer> answers(count), expected(count);
    trace(s.tracer, answers);
    std::vector<std::function<void()>> subjects{[&] { trace(s.tracer, answers); }};
    if (s.embree != nullptr) {
        trace(*s.embree, expected);
        size_t wrong = 0;
        for (size_t i = 0; i < count; ++i) wrong += !same(answers[i], expected[i]);
        check_share(name, wrong, count);
        subjects.push_back([&] { trace(*s.embree, expected); });
    }
    report(s, name, count, interleaved(s.options.rounds, subjects));
}

void closest_case(const Subjects& s, const std::string& name, const std::vector<Ray>& rays) {
    ray_case<Hit>(
        s, name, rays.size(), [&](auto& tracer, auto& hits) { tracer.trace_closest(rays, hits); },
        [](const Hit& a, const Hit& b) { return same_t(a.t, b.t); });
}

void any_case(const Subjects& s, const std::string& name, const std::vector<Ray>& rays) {
    ray_case<uint8_t>(
        s, name, rays.size(), [&](auto& tracer, auto& hits) { tracer.trace_any(rays, hits); },
        [](uint8_t a, uint8_t b) { return a == b; });
}

void run(const Options& options) {
    const Device device = Device::select(options.device);
    const std::vector<MeshSize> sizes =
        options.quick ? std::vector<MeshSize>{{"4k", 4000}}
                      : std::vector<MeshSize>{{"4k", 4000}, {"262k", 262144}, {"2M", 2000000}};
    const size_t side = options.quick ? 256 : 1024;
    for (const MeshSize& size : sizes) {
        const Mesh mesh = bumpy_sphere_in_box(size.triangles);
        RayTracer tracer(device, scene_of(mesh));
        std::unique_ptr<EmbreeScene> embree;
        if (options.peers)
            embree = std::make_unique<EmbreeScene>(mesh, device.profile().compute_units);
        const Subjects s{options, device, tracer, embree.get()};
        const std::string name = size.name;
        closest_case(s, "closest-diffuse-" + name, diffuse_rays(mesh, side * side, 1));
        closest_case(s, "closest-primary-" + name, primary_rays(side));
        any_case(s, "any-shadow-" + name, shadow_rays(mesh, side * side, 2));
    }
}

}  // namespace
}  // namespace pave::bench

int main(int argc, char** argv) {
    return pave::bench::main_of(
        argc, argv, pave::bench::run,
        "Rays a second through a bumpy sphere in a box of 4k, 262k and 2M triangles: closest hits "
        "of "
        "diffuse\nbounces and of primary rays, and occlusion. Embree 3: rtcIntersect1 and "
        "rtcOccluded1, medium build quality,\nno robust flag, one thread a compute unit.");
}
