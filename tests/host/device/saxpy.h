// A program of no lanes for the tests of host/device: y = a*x + y.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <vector>

#include "host/device/cl.h"

namespace pave {

inline constexpr const char* kSaxpySource =
    "kernel void saxpy(global float* y, global const float* x, float a) {\n"
    "    const size_t i = get_global_id(0);\n"
    "    y[i] = a * x[i] + y[i];\n"
    "}\n";

/// y[i] = 3 * i + 1 by the device, or a message that tells the first wrong element.
inline std::string run_saxpy(const Device& device, int count = 1000, int local_size = 0) {
    std::vector<float> x(static_cast<size_t>(count)), y(x.size(), 1.0f);
    for (size_t i = 0; i < x.size(); ++i) x[i] = static_cast<float>(i);
    const cl::Program program = build_program_from_source(device, "saxpy.cl", kSaxpySource);
    cl::Kernel kernel = make_kernel(program, "saxpy");
    const cl::Buffer x_buffer = make_buffer_of(device, x, "x");
    const cl::Buffer y_buffer = make_buffer(device, y.size() * sizeof(float), "y");
    write_buffer(device, y_buffer, y, "y");
    const cl::NDRange local =
        local_size == 0 ? cl::NullRange : cl::NDRange(static_cast<size_t>(local_size));
    wait(launch(device, kernel, cl::NDRange(x.size()), local, y_buffer, x_buffer, 3.0f), "saxpy");
    read_buffer(device, y_buffer, y, "y");
    for (size_t i = 0; i < y.size(); ++i)
        if (y[i] != 3.0f * static_cast<float>(i) + 1.0f)
            return "y[" + std::to_string(i) + "] is " + std::to_string(y[i]);
    return "";
}

}  // namespace pave
