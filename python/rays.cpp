// Ray queries for Python, over numpy arrays in place and over OpenCL buffers by their handles.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/rays.h"

#include <cstdint>
#include <span>

#include "bindings.h"

namespace pave::python {
namespace {

using Released = nb::call_guard<nb::gil_scoped_release>;

/// Records as rows of plain numbers: the package gives them their names.
using RayArray = nb::ndarray<const float, nb::shape<-1, 8>, nb::c_contig, nb::device::cpu>;
using HitArray = nb::ndarray<float, nb::shape<-1, 6>, nb::c_contig, nb::device::cpu>;
using FlagArray = nb::ndarray<uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

std::span<const Ray> rays_of(const RayArray& rays) {
    return {reinterpret_cast<const Ray*>(rays.data()), rays.shape(0)};
}

void trace_closest(RayTracer& tracer, const RayArray& rays, const HitArray& hits) {
    const std::span<Hit> to(reinterpret_cast<Hit*>(hits.data()), hits.shape(0));
    const nb::gil_scoped_release released;
    tracer.trace_closest(rays_of(rays), to);
}

void trace_any(RayTracer& tracer, const RayArray& rays, const FlagArray& occluded) {
    const std::span<uint8_t> to(occluded.data(), occluded.shape(0));
    const nb::gil_scoped_release released;
    tracer.trace_any(rays_of(rays), to);
}

void* handle_at(uintptr_t address) { return reinterpret_cast<void*>(address); }

}  // namespace

void bind_rays(nb::module_& module) {
    nb::class_<RayTracer>(module, "RayTracer")
        .def(
            "__init__",
            [](RayTracer* self, const Device& device, const Scene& scene, int lane_width) {
                RayTracerOptions options;
                options.lane_width = lane_width;
                new (self) RayTracer(device, scene, options);
            },
            nb::arg("device"), nb::arg("scene"), nb::arg("lane_width"), Released())
        .def_prop_ro("dropped_triangles", &RayTracer::dropped_triangles)
        .def("trace_closest", &trace_closest, nb::arg("rays"), nb::arg("hits"))
        .def("trace_any", &trace_any, nb::arg("rays"), nb::arg("occluded"))
        .def(
            "enqueue_closest",
            [](RayTracer& tracer, uintptr_t rays, uintptr_t hits, size_t count) {
                tracer.enqueue_closest(handle_at(rays), handle_at(hits), count);
            },
            nb::arg("rays"), nb::arg("hits"), nb::arg("count"), Released())
        .def(
            "enqueue_any",
            [](RayTracer& tracer, uintptr_t rays, uintptr_t occluded, size_t count) {
                tracer.enqueue_any(handle_at(rays), handle_at(occluded), count);
            },
            nb::arg("rays"), nb::arg("occluded"), nb::arg("count"), Released());
}

}  // namespace pave::python
