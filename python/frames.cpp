// Frames, views and metadata for Python; the arrays that see a slot's own bytes.
// SPDX-License-Identifier: BSD-3-Clause
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/string_view.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <string>
#include <tuple>
#include <vector>

#include "bindings.h"
#include "pave/frame.h"

namespace pave::python {
namespace {

/// Name, planes and byte offset in the slot of each channel.
std::vector<std::tuple<std::string, int, size_t>> layout_of(const FrameSchema& schema) {
    std::vector<std::tuple<std::string, int, size_t>> layout;
    for (size_t i = 0; i < schema.channels().size(); ++i) {
        const Channel& channel = schema.channels()[i];
        layout.emplace_back(channel.name, channel.planes,
                            schema.channel_byte_offset(static_cast<int>(i)));
    }
    return layout;
}

void bind_view(nb::module_& module) {
    nb::class_<View>(module, "View")
        .def(
            "__init__",
            [](View* self, const std::array<float, 16>& world_from_camera, float fov_x_degrees) {
                new (self) View{world_from_camera, fov_x_degrees};
            },
            nb::arg("world_from_camera"), nb::arg("fov_x_degrees"))
        .def_ro("world_from_camera", &View::world_from_camera)
        .def_ro("fov_x_degrees", &View::fov_x_degrees);
    module.def("look_at", &look_at, nb::arg("eye"), nb::arg("target"), nb::arg("up"),
               nb::arg("fov_x_degrees"));
}

void bind_metadata(nb::module_& module) {
    nb::class_<FrameMetadata>(module, "FrameMetadata")
        .def_rw("index", &FrameMetadata::index)
        // A copy: a reference would change with the next frame in the slot, and hold the slot.
        .def_prop_rw(
            "view", [](const FrameMetadata& m) { return m.view; },
            [](FrameMetadata& m, const View& view) { m.view = view; })
        .def_rw("spp", &FrameMetadata::spp)
        .def_rw("max_depth", &FrameMetadata::max_depth)
        .def_rw("rr_depth", &FrameMetadata::rr_depth)
        .def_rw("seed", &FrameMetadata::seed)
        .def_rw("scene", &FrameMetadata::scene)
        .def_rw("scene_hash", &FrameMetadata::scene_hash)
        .def_rw("device", &FrameMetadata::device)
        .def_rw("driver", &FrameMetadata::driver)
        .def_rw("kernel_hash", &FrameMetadata::kernel_hash)
        .def_rw("program_version", &FrameMetadata::program_version)
        .def_rw("program_commit", &FrameMetadata::program_commit)
        .def_rw("weights_version", &FrameMetadata::weights_version)
        .def_rw("seconds_spent", &FrameMetadata::seconds_spent);
}

}  // namespace

FloatArray view_of_planes(const Frame& frame, size_t byte_offset, size_t planes) {
    const FrameSchema& schema = frame.schema();
    const size_t shape[] = {planes, static_cast<size_t>(schema.height()),
                            static_cast<size_t>(schema.width())};
    if (byte_offset + planes * shape[1] * shape[2] * sizeof(float) > schema.slot_byte_size())
        throw InternalError("a view beyond its slot");
    const nb::capsule owner(new Frame(frame),
                            [](void* held) noexcept { delete static_cast<Frame*>(held); });
    return FloatArray(reinterpret_cast<float*>(frame.slot()->data + byte_offset), 3, shape, owner);
}

void bind_frames(nb::module_& module) {
    bind_view(module);
    bind_metadata(module);
    nb::class_<FrameSchema>(module, "FrameSchema")
        .def_prop_ro("width", &FrameSchema::width)
        .def_prop_ro("height", &FrameSchema::height)
        .def_prop_ro("slot_byte_size", &FrameSchema::slot_byte_size)
        .def("layout", &layout_of);
    nb::class_<Frame>(module, "Frame")
        .def_prop_ro("schema", [](const Frame& frame) { return frame.schema(); })
        .def_prop_ro(
            "metadata", [](Frame& frame) -> FrameMetadata& { return frame.metadata(); },
            nb::rv_policy::reference_internal)
        .def_prop_ro("slot_index", [](const Frame& frame) { return frame.slot()->index; })
        .def_prop_ro(
            "address",
            [](const Frame& frame) { return reinterpret_cast<uintptr_t>(frame.slot()->data); })
        .def("planes", &view_of_planes, nb::arg("byte_offset"), nb::arg("planes"),
             "A (planes, height, width) array over the slot's own bytes; it keeps the slot.");
    module.def("known_channel_planes", &known_channel_planes, nb::arg("name"));
}

}  // namespace pave::python
