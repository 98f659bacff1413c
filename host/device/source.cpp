// Kernel sources: where they come from, their includes, their hash.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/device/source.h"

#include <xxhash.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include "host/device/cl.h"

namespace pave {

namespace {

/// Where kernels are read from instead of the library, or "".
std::string kernel_folder() {
    const char* folder = std::getenv("PAVE_KERNEL_DIR");
    return folder == nullptr ? "" : folder;
}

std::string read_kernel_file(const std::string& name) {
    if (const std::string folder = kernel_folder(); !folder.empty()) {
        const std::filesystem::path path = std::filesystem::path(folder) / name;
        std::ifstream file(path, std::ios::binary);
        std::ostringstream text;
        text << file.rdbuf();
        if (!file)
            throw DeviceError("kernel source " + path.string() +
                              " cannot be read; unset PAVE_KERNEL_DIR or point it at kernels/");
        return text.str();
    }
    const auto it = embedded_kernels().find(name);
    if (it == embedded_kernels().end())
        throw InternalError("kernel source '" + name + "' is not in the library");
    return std::string(it->second);
}

std::string trimmed(const std::string& line) {
    const size_t begin = line.find_first_not_of(" \t\r");
    return begin == std::string::npos ? "" : line.substr(begin);
}

/// The name in `#include "name"`, or "" if `line` is something else.
std::string included_name(const std::string& line) {
    std::string text = trimmed(line);
    if (text.empty() || text[0] != '#') return "";
    text = trimmed(text.substr(1));
    if (text.rfind("include", 0) != 0) return "";
    const size_t open = text.find('"');
    const size_t close = open == std::string::npos ? open : text.find('"', open + 1);
    return close == std::string::npos ? "" : text.substr(open + 1, close - open - 1);
}

bool is_pragma_once(const std::string& line) {
    std::istringstream words(line);
    std::string hash, once;
    words >> hash >> once;
    return hash == "#pragma" && once == "once";
}

void line_mark(std::string& out, int line, const std::string& name) {
    out += "#line " + std::to_string(line) + " \"" + name + "\"\n";
}

void append(std::string& out, const std::string& name, const std::string& text,
            std::set<std::string>& seen) {
    line_mark(out, 1, name);
    std::istringstream lines(text);
    std::string line;
    for (int number = 1; std::getline(lines, line); ++number) {
        const std::string included = included_name(line);
        if (!included.empty()) {
            if (seen.insert(included).second)
                append(out, included, read_kernel_file(included), seen);
            line_mark(out, number + 1, name);
        } else {
            out += (is_pragma_once(line) ? "" : line) + "\n";
        }
    }
}

}  // namespace

std::string assemble_text(const std::string& name, const std::string& text) {
    // Contracted a*b+c would differ between devices and lane widths; see build_program.
    std::string out = "#pragma OPENCL FP_CONTRACT OFF\n";
    std::set<std::string> seen{name};
    append(out, name, text, seen);
    return out;
}

std::string assemble_source(const std::string& file) {
    return assemble_text(file, read_kernel_file(file));
}

SourcePlace place_of_line(const std::string& assembled, int line) {
    std::istringstream lines(assembled);
    std::string text;
    SourcePlace place;
    for (int number = 1; number <= line && std::getline(lines, text); ++number) {
        int marked = 0;
        if (std::sscanf(text.c_str(), "#line %d", &marked) == 1) {
            const size_t quote = text.find('"');
            place = {text.substr(quote + 1, text.rfind('"') - quote - 1), marked - 1};
        } else {
            ++place.line;
        }
    }
    return place;
}

bool has_file(const std::string& assembled, const std::string& file) {
    const std::string name = " \"" + file + "\"\n";
    for (size_t at = assembled.find(name); at != std::string::npos;
         at = assembled.find(name, at + 1)) {
        const size_t begin = assembled.rfind('\n', at) + 1;  // npos + 1 is 0
        if (assembled.compare(begin, 6, "#line ") == 0) return true;
    }
    return false;
}

std::string xxh3_hex(std::string_view bytes) {
    const XXH128_hash_t hash = XXH3_128bits(bytes.data(), bytes.size());
    char text[33];
    std::snprintf(text, sizeof text, "%016llx%016llx", static_cast<unsigned long long>(hash.high64),
                  static_cast<unsigned long long>(hash.low64));
    return text;
}

std::string Device::kernel_hash() {
    std::map<std::string, std::string> files;
    if (const std::string folder = kernel_folder(); !folder.empty()) {
        std::error_code error;
        for (std::filesystem::directory_iterator it(folder, error), end; !error && it != end;
             it.increment(error)) {
            const std::string name = it->path().filename().string();
            if (name.ends_with(".cl") || name.ends_with(".h")) files[name] = read_kernel_file(name);
        }
    } else {
        for (const auto& [name, text] : embedded_kernels()) files[name] = text;
    }
    std::string all;
    for (const auto& [name, text] : files)
        all += name + '\0' + std::to_string(text.size()) + '\0' + text;
    return xxh3_hex(all);
}

}  // namespace pave
