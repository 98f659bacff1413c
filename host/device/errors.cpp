// OpenCL's error codes by name, and the one-line error that carries them.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/device/cl.h"

namespace pave {
namespace {

struct NamedCode {
    cl_int code;
    const char* name;
    const char* hint;
};
#define PAVE_CODE(name, hint) \
    { name, #name, hint }
constexpr NamedCode kCodes[] = {
    PAVE_CODE(CL_DEVICE_NOT_FOUND, "see `pave devices`"),
    PAVE_CODE(CL_DEVICE_NOT_AVAILABLE, "another program may hold the device"),
    PAVE_CODE(CL_COMPILER_NOT_AVAILABLE, "install the driver's compiler package"),
    PAVE_CODE(CL_MEM_OBJECT_ALLOCATION_FAILURE,
              "use a smaller frame, fewer slots or a smaller scene"),
    PAVE_CODE(CL_OUT_OF_RESOURCES, "use a smaller frame, tile or work-group"),
    PAVE_CODE(CL_OUT_OF_HOST_MEMORY, "free memory, use fewer slots"),
    PAVE_CODE(CL_PROFILING_INFO_NOT_AVAILABLE, "set PAVE_PROFILE=1"),
    PAVE_CODE(CL_MEM_COPY_OVERLAP, ""),
    PAVE_CODE(CL_IMAGE_FORMAT_MISMATCH, ""),
    PAVE_CODE(CL_IMAGE_FORMAT_NOT_SUPPORTED, ""),
    PAVE_CODE(CL_BUILD_PROGRAM_FAILURE, "try another device, or report the log"),
    PAVE_CODE(CL_MAP_FAILURE, ""),
    PAVE_CODE(CL_MISALIGNED_SUB_BUFFER_OFFSET, ""),
    PAVE_CODE(CL_EXEC_STATUS_ERROR_FOR_EVENTS_IN_WAIT_LIST,
              "an earlier command of the queue failed"),
    PAVE_CODE(CL_COMPILE_PROGRAM_FAILURE, ""),
    PAVE_CODE(CL_LINKER_NOT_AVAILABLE, ""),
    PAVE_CODE(CL_LINK_PROGRAM_FAILURE, ""),
    PAVE_CODE(CL_DEVICE_PARTITION_FAILED, ""),
    PAVE_CODE(CL_KERNEL_ARG_INFO_NOT_AVAILABLE, ""),
    PAVE_CODE(CL_INVALID_VALUE, ""),
    PAVE_CODE(CL_INVALID_DEVICE_TYPE, ""),
    PAVE_CODE(CL_INVALID_PLATFORM, ""),
    PAVE_CODE(CL_INVALID_DEVICE, "device and context must belong together"),
    PAVE_CODE(CL_INVALID_CONTEXT, "device and context must belong together"),
    PAVE_CODE(CL_INVALID_QUEUE_PROPERTIES, ""),
    PAVE_CODE(CL_INVALID_COMMAND_QUEUE, "queue and context must belong together"),
    PAVE_CODE(CL_INVALID_HOST_PTR, ""),
    PAVE_CODE(CL_INVALID_MEM_OBJECT, ""),
    PAVE_CODE(CL_INVALID_IMAGE_FORMAT_DESCRIPTOR, ""),
    PAVE_CODE(CL_INVALID_IMAGE_SIZE, ""),
    PAVE_CODE(CL_INVALID_SAMPLER, ""),
    PAVE_CODE(CL_INVALID_BINARY, ""),
    PAVE_CODE(CL_INVALID_BUILD_OPTIONS, ""),
    PAVE_CODE(CL_INVALID_PROGRAM, ""),
    PAVE_CODE(CL_INVALID_PROGRAM_EXECUTABLE, ""),
    PAVE_CODE(CL_INVALID_KERNEL_NAME, ""),
    PAVE_CODE(CL_INVALID_KERNEL_DEFINITION, ""),
    PAVE_CODE(CL_INVALID_KERNEL, ""),
    PAVE_CODE(CL_INVALID_ARG_INDEX, ""),
    PAVE_CODE(CL_INVALID_ARG_VALUE, ""),
    PAVE_CODE(CL_INVALID_ARG_SIZE, "host and kernel types differ"),
    PAVE_CODE(CL_INVALID_KERNEL_ARGS, "an argument is not set"),
    PAVE_CODE(CL_INVALID_WORK_DIMENSION, ""),
    PAVE_CODE(CL_INVALID_WORK_GROUP_SIZE, "use a smaller work-group that divides the global size"),
    PAVE_CODE(CL_INVALID_WORK_ITEM_SIZE, "use a smaller work-group"),
    PAVE_CODE(CL_INVALID_GLOBAL_OFFSET, ""),
    PAVE_CODE(CL_INVALID_EVENT_WAIT_LIST, ""),
    PAVE_CODE(CL_INVALID_EVENT, ""),
    PAVE_CODE(CL_INVALID_OPERATION, ""),
    PAVE_CODE(CL_INVALID_GL_OBJECT, ""),
    PAVE_CODE(CL_INVALID_BUFFER_SIZE, "split it: it is above the device's largest allocation"),
    PAVE_CODE(CL_INVALID_MIP_LEVEL, ""),
    PAVE_CODE(CL_INVALID_GLOBAL_WORK_SIZE, ""),
    PAVE_CODE(CL_INVALID_PROPERTY, ""),
    PAVE_CODE(CL_INVALID_IMAGE_DESCRIPTOR, ""),
    PAVE_CODE(CL_INVALID_COMPILER_OPTIONS, ""),
    PAVE_CODE(CL_INVALID_LINKER_OPTIONS, ""),
    PAVE_CODE(CL_INVALID_DEVICE_PARTITION_COUNT, ""),
    {-1001, "CL_PLATFORM_NOT_FOUND_KHR", "install an OpenCL driver: apt install pocl-opencl-icd"},
};
#undef PAVE_CODE

const NamedCode* find_code(cl_int code) {
    for (const NamedCode& known : kCodes)
        if (known.code == code) return &known;
    return nullptr;
}

std::string one_line(std::string_view routine, cl_int code, std::string_view where,
                     std::string_view reason, std::string_view hint) {
    std::string line = std::string(routine) + ": " + cl_code_name(code);
    if (!where.empty()) line += ": " + std::string(where);
    if (!reason.empty()) line += ": " + std::string(reason);
    if (hint.empty())
        if (const NamedCode* known = find_code(code)) hint = known->hint;
    if (!hint.empty()) line += "; " + std::string(hint);
    for (char& c : line)
        if (c == '\n' || c == '\r') c = ' ';
    return line;
}

}  // namespace

std::string cl_code_name(cl_int code) {
    const NamedCode* known = find_code(code);
    return std::string(known ? known->name : "CL_ERROR") + "(" + std::to_string(code) + ")";
}

ClError::ClError(std::string_view routine, cl_int code, std::string_view where,
                 std::string_view reason, std::string_view hint, std::string build_log)
    : DeviceError(one_line(routine, code, where, reason, hint)),
      routine(routine),
      code(code),
      build_log(std::move(build_log)) {}

}  // namespace pave
