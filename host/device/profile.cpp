// What a device says of itself, and the lane width that follows from it.
// SPDX-License-Identifier: BSD-3-Clause
#include <cstdlib>

#include "host/device/impl.h"

namespace pave {
namespace {

/// PAVE_LANES, or 0 if it is not set.
int forced_lane_width() {
    const char* text = std::getenv("PAVE_LANES");
    if (text == nullptr || *text == '\0') return 0;
    for (int width : {1, 4, 8, 16})
        if (std::to_string(width) == text) return width;
    throw UsageError("PAVE_LANES=" + std::string(text) + ": lanes are 1, 4, 8 or 16");
}

/// Explicit vectors are for devices whose work-items are CPU threads; a GPU vectorises over
/// work-items itself.
int lane_width_of(const DeviceProfile& profile) {
    if (const int forced = forced_lane_width()) return forced;
    if (profile.is_gpu) return 1;
    for (int width : {16, 8, 4})
        if (profile.native_float_width >= width) return width;
    return 1;
}

}  // namespace

DeviceProfile query_profile(const cl::Device& device, std::string id) {
    DeviceProfile profile;
    profile.id = std::move(id);
    const cl::Platform platform(device.getInfo<CL_DEVICE_PLATFORM>());
    profile.platform = platform.getInfo<CL_PLATFORM_NAME>();
    profile.name = device.getInfo<CL_DEVICE_NAME>();
    profile.vendor = device.getInfo<CL_DEVICE_VENDOR>();
    profile.driver = device.getInfo<CL_DRIVER_VERSION>();
    profile.opencl_version = device.getInfo<CL_DEVICE_VERSION>();
    const cl_device_type type = device.getInfo<CL_DEVICE_TYPE>();
    profile.is_gpu = (type & CL_DEVICE_TYPE_GPU) != 0;
    profile.is_cpu = (type & CL_DEVICE_TYPE_CPU) != 0;
    profile.host_unified_memory = device.getInfo<CL_DEVICE_HOST_UNIFIED_MEMORY>() == CL_TRUE;
    profile.compute_units = static_cast<int>(device.getInfo<CL_DEVICE_MAX_COMPUTE_UNITS>());
    profile.native_float_width =
        static_cast<int>(device.getInfo<CL_DEVICE_NATIVE_VECTOR_WIDTH_FLOAT>());
    profile.lane_width = lane_width_of(profile);
    profile.max_work_group_size = device.getInfo<CL_DEVICE_MAX_WORK_GROUP_SIZE>();
    profile.global_byte_size = device.getInfo<CL_DEVICE_GLOBAL_MEM_SIZE>();
    profile.max_alloc_byte_size = device.getInfo<CL_DEVICE_MAX_MEM_ALLOC_SIZE>();
    profile.cache_byte_size = device.getInfo<CL_DEVICE_GLOBAL_MEM_CACHE_SIZE>();
    return profile;
}

}  // namespace pave
