// From kernel source to program: options, build, and build errors that name file and line.
// SPDX-License-Identifier: BSD-3-Clause
#include <cstdio>
#include <regex>
#include <sstream>

#include "host/device/impl.h"
#include "host/device/source.h"

namespace pave {
namespace {

constexpr size_t kMaxDefineLength = 64;

bool is_define_name(const std::string& name) {
    if (name.empty() || name.size() > kMaxDefineLength || name[0] < 'A' || name[0] > 'Z')
        return false;
    for (char c : name)
        if (!((c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_')) return false;
    return true;
}

std::string number_text(const DefineValue& define) {
    if (const int64_t* integer = std::get_if<int64_t>(&define.value))
        return std::to_string(*integer);
    char text[48];
    std::snprintf(text, sizeof text, "%af", static_cast<double>(std::get<float>(define.value)));
    return text;
}

std::string options_of(const Defines& defines) {
    std::string options = "-cl-std=CL1.2";
    for (const auto& [name, value] : defines) {
        if (!is_define_name(name))
            throw InternalError("'" + name + "' is no name of a kernel define");
        options += " -D " + name + "=" + number_text(value);
    }
    return options;
}

struct BuildFault {
    std::string where, reason;
};

/// The first error of a compiler's log. Clang-based drivers write "file:57:3: error: text", with or
/// without a leading "error: "; whatever has no such line is given back as its first line.
BuildFault first_fault(const std::string& log, const std::string& name) {
    static const std::regex kPlace(
        R"(([A-Za-z0-9_.+-]+):(\d+)(?::\d+)?:\s*(?:fatal )?(?:error:)?\s*(.*))");
    std::istringstream lines(log);
    std::string line, first_line;
    while (std::getline(lines, line)) {
        if (first_line.empty()) first_line = line;
        std::smatch match;
        if (line.find("error") != std::string::npos && std::regex_search(line, match, kPlace))
            return {match[1].str() + ":" + match[2].str(), match[3].str()};
    }
    return {name, first_line.empty() ? "the driver gave no log" : first_line};
}

cl::Program build(const Device& device, const std::string& name, const std::string& text,
                  const std::string& options) {
    cl::Program program =
        cl_guard(name, [&] { return cl::Program(context_of(device), text, false); });
    try {
        program.build({device_of(device)}, options.c_str());
    } catch (const cl::Error& error) {
        std::string log;
        try {
            log = program.getBuildInfo<CL_PROGRAM_BUILD_LOG>(device_of(device));
        } catch (const cl::Error&) {
            log.clear();  // a driver that fails even here still gets its code reported
        }
        const BuildFault fault = first_fault(log, name);
        throw ClError("clBuildProgram", error.err(), fault.where, fault.reason, {}, log);
    }
    return program;
}

}  // namespace

cl::Program build_program(const Device& device, const std::string& file, const Defines& defines) {
    return build(device, file, assemble_source(file), options_of(defines));
}

cl::Program build_program_from_source(const Device& device, const std::string& name,
                                      const std::string& source, const Defines& defines) {
    return build(device, name, assemble_text(name, source), options_of(defines));
}

cl::Kernel make_kernel(const cl::Program& program, const std::string& name) {
    try {
        return cl::Kernel(program, name.c_str());
    } catch (const cl::Error& error) {
        std::string names;
        try {
            names = program.getInfo<CL_PROGRAM_KERNEL_NAMES>();
        } catch (const cl::Error&) {
            names = "not known";
        }
        throw ClError(error.what(), error.err(), name, "kernels of the program: " + names);
    }
}

}  // namespace pave
