// From kernel source to program: options, build, and build errors that name file and line.
// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <regex>
#include <sstream>

#include "host/device/cache.h"
#include "host/device/impl.h"
#include "host/device/source.h"
#include "pave/version.h"

namespace pave {
namespace {

constexpr size_t kMaxDefineLength = 64;
constexpr const char* kLogName = "last-build.log";

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
    if (!std::isfinite(std::get<float>(define.value)))
        throw InternalError("a kernel define that is no finite number");
    char text[48];
    std::snprintf(text, sizeof text, "%af", static_cast<double>(std::get<float>(define.value)));
    return text;
}

std::string options_of(const Defines& defines) {
    std::string options = "-cl-std=CL1.2";
    // Warnings are for those who edit kernels: some drivers print them on the user's terminal.
    const char* editing = std::getenv("PAVE_KERNEL_DIR");
    if (editing == nullptr || *editing == '\0') options += " -w";
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
/// without a leading "error: "; drivers that do not heed #line write a name of their own. A log
/// without such a line gives its first line.
BuildFault first_fault(const std::string& log, const std::string& name, const std::string& text) {
    static const std::regex kPlace(
        R"(([A-Za-z0-9_.+<>-]*):(\d{1,8})(?::\d+)?:\s*(?:fatal )?(?:error:)?\s*(.*))");
    std::istringstream lines(log);
    std::string line, first_line;
    while (std::getline(lines, line)) {
        if (first_line.empty()) first_line = line;
        std::smatch match;
        if (line.find("error") == std::string::npos || !std::regex_search(line, match, kPlace))
            continue;
        SourcePlace place{match[1].str(), std::stoi(match[2].str())};
        if (!has_file(text, place.file)) place = place_of_line(text, place.line);
        return {place.file + ":" + std::to_string(place.line), match[3].str()};
    }
    return {name, first_line.empty() ? "the driver gave no log" : first_line};
}

[[noreturn]] void throw_build_error(const cl::Program& program, const Device& device,
                                    const std::string& name, const std::string& text, cl_int code) {
    std::string log;
    try {
        log = program.getBuildInfo<CL_PROGRAM_BUILD_LOG>(device_of(device));
    } catch (const cl::Error&) {
        log.clear();  // a driver that fails even here still gets its code reported
    }
    const BuildFault fault = first_fault(log, name, text);
    std::string hint;
    const std::filesystem::path cache = KernelCache::of_process().folder().path;
    if (!cache.empty() && try_write_file(cache / kLogName, log))
        hint = "the whole log is in " + (cache / kLogName).string();
    throw ClError("clBuildProgram", code, fault.where, fault.reason, hint, log);
}

/// Everything that the compiled program depends on.
std::string key_of(const Device& device, const std::string& text, const std::string& options) {
    const DeviceProfile& profile = device.profile();
    std::string all;
    for (const std::string& part : {text, options, profile.platform, profile.name, profile.vendor,
                                    profile.driver, profile.opencl_version, program_version()})
        all += std::to_string(part.size()) + ":" + part;
    return xxh3_hex(all);
}

std::optional<cl::Program> build_binary(const Device& device, const std::string& binary,
                                        const std::string& options) {
    try {
        const std::vector<unsigned char> bytes(binary.begin(), binary.end());
        cl::Program program(context_of(device), {device_of(device)}, {bytes});
        program.build({device_of(device)}, options.c_str());
        return program;
    } catch (const cl::Error&) {
        return std::nullopt;  // the driver wants none of it: compile
    }
}

/// The binary of the context's one device; empty if the driver gives none, as for contexts of
/// several devices.
std::string binary_of(const cl::Program& program) {
    try {
        const auto binaries = program.getInfo<CL_PROGRAM_BINARIES>();
        if (binaries.size() == 1) return {binaries[0].begin(), binaries[0].end()};
    } catch (const cl::Error&) {
        return {};
    }
    return {};
}

cl::Program compile(const Device& device, const std::string& key, const std::string& name,
                    const std::string& text, const std::string& options) {
    KernelCache::Compilation compilation(KernelCache::of_process(), key);
    if (compilation.binary())
        if (auto program = build_binary(device, *compilation.binary(), options)) return *program;
    cl::Program program =
        cl_guard(name, [&] { return cl::Program(context_of(device), text, false); });
    try {
        program.build({device_of(device)}, options.c_str());
    } catch (const cl::Error& error) {
        throw_build_error(program, device, name, text, error.err());
    }
    if (!compilation.end())
        if (std::string binary = binary_of(program); !binary.empty())
            compilation.keep_binary(std::move(binary));
    return program;
}

cl::Program build(const Device& device, const std::string& name, const std::string& text,
                  const std::string& options) {
    const std::string key = key_of(device, text, options);
    Device::Impl& impl = device.impl();
    {
        std::lock_guard lock(impl.programs_mutex_);
        if (const auto it = impl.programs_.find(key); it != impl.programs_.end()) return it->second;
    }
    cl::Program program = compile(device, key, name, text, options);
    std::lock_guard lock(impl.programs_mutex_);
    return impl.programs_.emplace(key, std::move(program)).first->second;
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
