// How long from a mesh in memory to the first ray traced through it, beside Embree?
// SPDX-License-Identifier: BSD-3-Clause
#include <sys/resource.h>

#include <cmath>
#include <cstdio>
#include <string>

#include "bench/meshes.h"
#include "bench/peers.h"
#include "bench/report.h"

namespace pave::bench {
namespace {

const Ray kFirstRay{
    {0.9f, 0.8f, 0.7f}, std::numeric_limits<float>::infinity(), {-1, -0.9f, -0.8f}, 0};

Hit first_hit_of_pave(const Device& device, const Scene& scene) {
    RayTracer tracer(device, scene);
    Hit hit;
    tracer.trace_closest({&kFirstRay, 1}, {&hit, 1});
    return hit;
}
Hit first_hit_of_embree(const Scene& scene, int threads) {
    const EmbreeScene embree(scene.shapes[0].mesh, threads);
    Hit hit;
    embree.trace_closest({&kFirstRay, 1}, {&hit, 1});
    return hit;
}

void run(const Options& options) {
    const Device device = Device::select(options.device);
    const int threads = device.profile().compute_units;
    // Compiles the kernels of such a scene, which is no part of the question.
    first_hit_of_pave(device, scene_of(bumpy_sphere_in_box(1000)));
    const std::vector<std::pair<const char*, size_t>> sizes =
        options.quick
            ? std::vector<std::pair<const char*, size_t>>{{"20k", 20000}}
            : std::vector<std::pair<const char*, size_t>>{{"262k", 262144}, {"2M", 2000000}};
    for (const auto& [name, triangles] : sizes) {
        if (std::string(name).find(options.only) == std::string::npos) continue;
        const Scene scene = scene_of(bumpy_sphere_in_box(triangles));
        Hit hit, expected;
        std::vector<std::function<void()>> subjects{
            [&] { hit = first_hit_of_pave(device, scene); }};
        if (options.peers)
            subjects.push_back([&] { expected = first_hit_of_embree(scene, threads); });
        const std::vector<Series> series = interleaved(options.rounds, subjects);
        if (hit.shape != 0 || (options.peers && std::abs(hit.t - expected.t) > 1e-4f))
            fail(std::string(name) + ": the first ray hits at " + std::to_string(hit.t) + ", not " +
                 std::to_string(expected.t));
        Line line{"build", name, "time_to_first_ray", "s", "embree 3 medium quality", 0};
        print(line, device, series[0].wall_s, options.peers ? &series[1].wall_s : nullptr);
        line.metric = "cpu_time_to_first_ray";
        line.unit = "cpu-s";
        print(line, device, series[0].cpu_s, options.peers ? &series[1].cpu_s : nullptr);
        rusage usage{};
        getrusage(RUSAGE_SELF, &usage);
        std::fprintf(stderr, "%s: peak resident set of the process so far %ld MB\n", name,
                     usage.ru_maxrss / 1024);
    }
}

}  // namespace
}  // namespace pave::bench

int main(int argc, char** argv) {
    return pave::bench::main_of(
        argc, argv, pave::bench::run,
        "Seconds from a mesh in memory to the first hit: checks, build of the tree, packing, "
        "upload "
        "and one ray.\nKernels are compiled before, by a small scene. Embree 3: new scene over "
        "the mesh, rtcCommitScene at\nmedium quality on one thread a compute unit, rtcIntersect1. "
        "Both free what they made.");
}
