// Stages, sources and traces for Python. Every wait lets go of the interpreter lock.
// SPDX-License-Identifier: BSD-3-Clause
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/unique_ptr.h>
#include <nanobind/stl/vector.h>

#include <chrono>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "bindings.h"
#include "pave/device.h"
#include "pave/exr.h"
#include "pave/source.h"
#include "pave/stage.h"
#include "pave/trace.h"

namespace pave::python {
namespace {

using Released = nb::call_guard<nb::gil_scoped_release>;

/// A trace whose owners are all C++: a stage's thread must not need the interpreter lock to let go
/// of one.
struct SharedTrace {
    std::shared_ptr<Trace> trace = std::make_shared<Trace>();
};

ArenaAllocator& allocator_of(Device* device) { return device ? *device : host_memory(); }

FrameSchema make_schema(int width, int height,
                        const std::vector<std::pair<std::string, int>>& channels) {
    std::vector<Channel> list;
    for (const auto& [name, planes] : channels) list.push_back({name, planes});
    return FrameSchema(width, height, std::move(list));
}

void make_stage(Stage* self, Device* device, const std::string& uri, int width, int height,
                const std::vector<std::pair<std::string, int>>& channels, int slots,
                QueuePolicy policy, int64_t timeout_ms, bool resume, int frames_per_shard,
                const std::string& exr_names, const SharedTrace* trace) {
    StageOptions options;
    options.width = width;
    options.height = height;
    for (const auto& [name, planes] : channels) options.custom_channels.push_back({name, planes});
    options.channels.clear();
    options.slots = slots;
    options.policy = policy;
    options.timeout = std::chrono::milliseconds(timeout_ms);
    options.resume = resume;
    options.frames_per_shard = frames_per_shard;
    options.exr_names = exr_names;
    if (trace) options.trace = trace->trace;
    new (self) Stage(allocator_of(device), uri, std::move(options));
}

void bind_stage(nb::module_& module) {
    nb::enum_<QueuePolicy>(module, "QueuePolicy")
        .value("block", QueuePolicy::kBlock)
        .value("drop_oldest", QueuePolicy::kDropOldest)
        .value("drop_newest", QueuePolicy::kDropNewest);
    nb::class_<Stage>(module, "Stage")
        .def("__init__", &make_stage, nb::arg("device").none(), nb::arg("uri"), nb::arg("width"),
             nb::arg("height"), nb::arg("channels"), nb::arg("slots"), nb::arg("policy"),
             nb::arg("timeout_ms"), nb::arg("resume"), nb::arg("frames_per_shard"),
             nb::arg("exr_names"), nb::arg("trace").none(), Released())
        .def_prop_ro("schema", &Stage::schema, nb::rv_policy::copy)
        .def("acquire", &Stage::acquire, Released())
        .def("publish", &Stage::publish, nb::arg("frame"), Released())
        .def("flush", &Stage::flush, Released())
        .def("close", &Stage::close, Released())
        .def("abandon", &Stage::abandon, Released())
        .def_prop_ro("first_index", &Stage::first_index)
        .def_prop_ro("published", &Stage::published)
        .def_prop_ro("acknowledged", &Stage::acknowledged)
        .def_prop_ro("dropped", &Stage::dropped);
}

void bind_source(nb::module_& module) {
    nb::class_<Source>(module, "Source")
        .def_static("open", &Source::open, nb::arg("uri"), nb::arg("allow_unfinished"), Released())
        .def_prop_ro("schema", &Source::schema, nb::rv_policy::copy)
        .def_prop_ro("frame_count", &Source::frame_count)
        .def_prop_ro("finished", &Source::finished)
        .def("metadata", &Source::metadata, nb::arg("position"), Released())
        .def(
            "read",
            [](Source& source, int64_t position, Device* device) {
                return source.read(position, allocator_of(device));
            },
            nb::arg("position"), nb::arg("device").none(), Released())
        .def(
            "read_all",
            [](Source& source, Device* device) { return source.read_all(allocator_of(device)); },
            nb::arg("device").none(), Released())
        .def(
            "next",
            [](Source& source, int64_t timeout_ms, Device* device) -> std::optional<Frame> {
                Frame frame =
                    source.next(std::chrono::milliseconds(timeout_ms), allocator_of(device));
                if (!frame) return std::nullopt;
                return frame;
            },
            nb::arg("timeout_ms"), nb::arg("device").none(), Released())
        .def("content_hash", &Source::content_hash, Released());
}

void bind_trace(nb::module_& module) {
    using std::chrono::nanoseconds;
    nb::class_<SharedTrace>(module, "Trace")
        .def(nb::init<>())
        .def(
            "span",
            // Python's time.monotonic_ns() and this clock are both CLOCK_MONOTONIC.
            [](SharedTrace& shared, const std::string& name, int64_t begin_ns, int64_t end_ns,
               const std::string& detail) {
                shared.trace->span(name, Trace::Clock::time_point(nanoseconds(begin_ns)),
                                   Trace::Clock::time_point(nanoseconds(end_ns)), detail);
            },
            nb::arg("name"), nb::arg("begin_ns"), nb::arg("end_ns"), nb::arg("detail"))
        .def(
            "name_thread",
            [](SharedTrace& shared, const std::string& name) { shared.trace->name_thread(name); },
            nb::arg("name"))
        .def(
            "write",
            [](const SharedTrace& shared, const std::string& path) { shared.trace->write(path); },
            nb::arg("path"), Released());
}

}  // namespace

void bind_staging(nb::module_& module) {
    bind_trace(module);
    bind_stage(module);
    bind_source(module);
    module.def("make_schema", &make_schema, nb::arg("width"), nb::arg("height"),
               nb::arg("channels"));
    module.def("write_exr", &write_exr, nb::arg("frame"), nb::arg("path"), nb::arg("names"),
               Released());
    module.def(
        "read_exr",
        [](const std::string& path, Device* device) {
            return read_exr(path, allocator_of(device));
        },
        nb::arg("path"), nb::arg("device").none(), Released());
    module.def(
        "make_frame", [](const FrameSchema& schema) { return make_frame(schema); },
        nb::arg("schema"));
}

}  // namespace pave::python
