// Devices for Python, and their OpenCL objects as the raw handles that another OpenCL binding
// takes.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/device.h"

#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/string_view.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <string>

#include "bindings.h"
#include "host/device/cl.h"
#include "host/device/impl.h"

namespace pave::python {
namespace {

uintptr_t address_of(const void* handle) { return reinterpret_cast<uintptr_t>(handle); }
void* handle_at(uintptr_t address) { return reinterpret_cast<void*>(address); }

const char* slot_access_name(const Device& device) {
    switch (device.impl().slot_access()) {
        case SlotAccess::kShared:
            return "shared";
        case SlotAccess::kMapped:
            return "mapped";
        case SlotAccess::kTwin:
            return "twin";
        case SlotAccess::kUnknown:
            break;
    }
    throw InternalError("the probe for slot access left it open");
}

void bind_profile(nb::module_& module) {
    nb::class_<DeviceProfile>(module, "DeviceProfile")
        .def_ro("id", &DeviceProfile::id)
        .def_ro("platform", &DeviceProfile::platform)
        .def_ro("name", &DeviceProfile::name)
        .def_ro("vendor", &DeviceProfile::vendor)
        .def_ro("driver", &DeviceProfile::driver)
        .def_ro("opencl_version", &DeviceProfile::opencl_version)
        .def_ro("is_cpu", &DeviceProfile::is_cpu)
        .def_ro("is_gpu", &DeviceProfile::is_gpu)
        .def_ro("host_unified_memory", &DeviceProfile::host_unified_memory)
        .def_ro("compute_units", &DeviceProfile::compute_units)
        .def_ro("native_float_width", &DeviceProfile::native_float_width)
        .def_ro("lane_width", &DeviceProfile::lane_width)
        .def_ro("max_work_group_size", &DeviceProfile::max_work_group_size)
        .def_ro("global_byte_size", &DeviceProfile::global_byte_size)
        .def_ro("cache_byte_size", &DeviceProfile::cache_byte_size)
        .def_ro("max_alloc_byte_size", &DeviceProfile::max_alloc_byte_size);
}

}  // namespace

void bind_device(nb::module_& module) {
    using Released = nb::call_guard<nb::gil_scoped_release>;
    bind_profile(module);
    nb::class_<Device>(module, "Device")
        .def_static("select", &Device::select, nb::arg("spec"), Released())
        .def_static("list_all", &Device::list, Released())
        .def_static(
            "from_handles",
            [](uintptr_t context, uintptr_t device, uintptr_t queue) {
                return Device::from_handles(handle_at(context), handle_at(device),
                                            handle_at(queue));
            },
            nb::arg("context"), nb::arg("device"), nb::arg("queue"), Released())
        .def_static("kernel_hash", &Device::kernel_hash)
        .def_static("kernel_cache",
                    [] {
                        const KernelCacheInfo info = Device::kernel_cache();
                        return std::pair(info.folder, info.note);
                    })
        .def_prop_ro("profile", &Device::profile, nb::rv_policy::copy)
        .def_prop_ro("slot_access", &slot_access_name, Released())
        .def_prop_ro("context_handle",
                     [](const Device& device) { return address_of(device.context_handle()); })
        .def_prop_ro("device_handle",
                     [](const Device& device) { return address_of(device.device_handle()); })
        .def_prop_ro("queue_handle",
                     [](const Device& device) { return address_of(device.queue_handle()); })
        .def(
            "slot_buffer",
            [](const Device& device, const Frame& frame) {
                return address_of(device.slot_buffer(frame));
            },
            nb::arg("frame"),
            "cl_mem over the frame's slot, borrowed; 0 if it is not this context's.")
        .def(
            "make_frame",
            [](Device& device, const FrameSchema& schema) { return make_frame(schema, device); },
            nb::arg("schema"), Released())
        .def(
            "to_device",
            [](const Device& device, const Frame& frame) { slot_to_device(device, frame); },
            nb::arg("frame"), Released())
        .def(
            "to_host",
            [](const Device& device, const Frame& frame) {
                wait(slot_to_host(device, frame), "reading a slot back");
            },
            nb::arg("frame"), Released());
}

}  // namespace pave::python
