// Kernel programs: sources, defines, arithmetic, and errors that name file and line.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>

#include "host/device/source.h"
#include "tests/host/device/environment.h"
#include "tests/host/device/saxpy.h"

namespace pave {
namespace {

ClError build_error(const Device& device, const std::string& file) {
    try {
        build_program(device, file);
    } catch (const ClError& error) {
        return error;
    }
    throw std::runtime_error(file + " built");
}

/// Runs `kernel void f(global float* out)` of `source` once and returns the first `count` values.
std::vector<float> run_once(const Device& device, const std::string& source, size_t count,
                            const Defines& defines = {}) {
    const cl::Program program = build_program_from_source(device, "once.cl", source, defines);
    cl::Kernel kernel = make_kernel(program, "f");
    const cl::Buffer buffer = make_buffer(device, count * sizeof(float), "out");
    wait(launch(device, kernel, cl::NDRange(1), cl::NullRange, buffer), "f");
    std::vector<float> out(count);
    read_buffer(device, buffer, out, "out");
    return out;
}

class Program : public testing::Test {
   protected:
    Device device_ = Device::select();
    TemporaryFolder folder_;
    ScopedVariable kernels_{"PAVE_KERNEL_DIR", folder_.path().c_str()};
    void write(const std::string& name, const std::string& text) {
        write_text(folder_.path() / name, text);
    }
};

TEST_F(Program, RunsWithEveryLocalSize) {
    for (int local_size : {0, 1, 8, 64}) EXPECT_EQ(run_saxpy(device_, 64 * 15, local_size), "");
}

TEST_F(Program, NamesFileAndLineOfTheFirstError) {
    write("outer.cl",
          "#pragma once\n#include \"inner.h\"\n\nkernel void f(global int* p) {\n    p[0] = "
          "missing;\n}\n");
    write("inner.h", "#define FINE 1\n");
    const ClError error = build_error(device_, "outer.cl");
    EXPECT_EQ(error.routine, "clBuildProgram");
    EXPECT_NE(std::string(error.what()).find("outer.cl:5: "), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("missing"), std::string::npos) << error.what();
    EXPECT_NE(std::string(error.what()).find("CL_BUILD_PROGRAM_FAILURE(-11)"), std::string::npos);
    EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
    EXPECT_NE(error.build_log.find("missing"), std::string::npos);
    EXPECT_EQ(error.exit_code(), ExitCode::kDevice);
}

TEST_F(Program, NamesTheIncludedFile) {
    write("outer.cl", "#include \"a.h\"\nkernel void f(global int* p) { p[0] = 0; }\n");
    write("a.h", "// one\n#include \"b.h\"\n");
    write("b.h", "\n\nint broken(void) { return nothing; }\n");
    EXPECT_NE(std::string(build_error(device_, "outer.cl").what()).find("b.h:3: "),
              std::string::npos);
}

TEST_F(Program, IncludesEachFileOnce) {
    write(
        "outer.cl",
        "#include \"a.h\"\n  #  include \"b.h\"\nkernel void f(global float* p) { p[0] = A + B; }");
    write("a.h", "#include \"b.h\"\nconstant float A = 2.0f;");
    write("b.h", "#include \"a.h\"\nconstant float B = 3.0f;\r\n");
    const cl::Program program = build_program(device_, "outer.cl");
    EXPECT_EQ(program.getInfo<CL_PROGRAM_KERNEL_NAMES>(), "f");
}

TEST_F(Program, MissingSourcesAreNamed) {
    write("outer.cl", "#include \"gone.h\"\n");
    for (const char* file : {"outer.cl", "absent.cl"}) {
        try {
            build_program(device_, file);
            ADD_FAILURE() << file << " built";
        } catch (const DeviceError& error) {
            EXPECT_NE(std::string(error.what()).find("cannot be read"), std::string::npos);
        }
    }
    ScopedVariable embedded("PAVE_KERNEL_DIR", nullptr);
    EXPECT_THROW(build_program(device_, "absent.cl"), InternalError);
}

TEST_F(Program, HashFollowsTheSources) {
    std::string embedded;
    {
        ScopedVariable unset("PAVE_KERNEL_DIR", nullptr);
        embedded = Device::kernel_hash();
        EXPECT_EQ(Device::kernel_hash(), embedded);
    }
    write("a.cl", "kernel void f() {}");
    const std::string one = Device::kernel_hash();
    write("a.cl", "kernel void g() {}");
    const std::string two = Device::kernel_hash();
    EXPECT_EQ(one.size(), 32u);
    EXPECT_NE(one, two);
    EXPECT_NE(one, embedded);
}

TEST_F(Program, DefinesAreNumbersAndExact) {
    const std::vector<float> values{0.1f, -1.0f / 3.0f, 1e-38f, 3.4e38f, 0.0f};
    Defines defines{{"INTEGER", -7}, {"BOOLEAN", true}};
    std::string source = "kernel void f(global float* out) { out[5] = INTEGER; out[6] = BOOLEAN;";
    for (size_t i = 0; i < values.size(); ++i) {
        const std::string name = "VALUE_" + std::to_string(i);
        defines.emplace(name, values[i]);
        source += " out[" + std::to_string(i) + "] = " + name + ";";
    }
    std::vector<float> expected = values;
    expected.insert(expected.end(), {-7.0f, 1.0f});
    EXPECT_EQ(run_once(device_, source + " }", 7, defines), expected);
}

TEST_F(Program, DefinesOfOtherNamesAreRefused) {
    for (const char* name : {"", "lower", "A B", "A=1 -D B", "_A", "1A", "A-B", "A\n"})
        EXPECT_THROW(build_program_from_source(device_, "x.cl", kSaxpySource, {{name, 1}}),
                     InternalError)
            << name;
    for (float value : {INFINITY, NAN})
        EXPECT_THROW(build_program_from_source(device_, "x.cl", kSaxpySource, {{"A", value}}),
                     InternalError);
}

// a*b+c rounds twice, fma(a,b,c) once: with a*b = 1 - 2^-46 the difference is the whole result.
TEST_F(Program, ArithmeticIsNotContracted) {
    const char* source =
        "kernel void f(global float* out) {\n"
        "    volatile float a = 1.0f + 0x1p-23f, b = 1.0f - 0x1p-23f, c = -1.0f;\n"
        "    const float x = a, y = b, z = c;\n"
        "    out[0] = x * y + z;\n"
        "    out[1] = fma(x, y, z);\n"
        "}";
    EXPECT_EQ(run_once(device_, source, 2), (std::vector<float>{0.0f, -0x1p-46f}));
}

TEST_F(Program, UnknownKernelListsThoseThereAre) {
    const cl::Program program = build_program_from_source(device_, "saxpy.cl", kSaxpySource);
    try {
        make_kernel(program, "daxpy");
        ADD_FAILURE() << "there is no daxpy";
    } catch (const ClError& error) {
        EXPECT_STREQ(
            error.what(),
            "clCreateKernel: CL_INVALID_KERNEL_NAME(-46): daxpy: kernels of the program: saxpy");
    }
}

TEST(Source, LinesAreFoundWithoutTheirMarks) {
    TemporaryFolder folder;
    ScopedVariable kernels("PAVE_KERNEL_DIR", folder.path().c_str());
    write_text(folder.path() / "a.cl", "// a 1\n#include \"b.h\"\n// a 3\n// a 4\n");
    write_text(folder.path() / "b.h", "// b 1\n// b 2");
    const std::string text = assemble_source("a.cl");
    std::istringstream lines(text);
    std::string line;
    int found = 0;
    for (int number = 1; std::getline(lines, line); ++number) {
        if (line.rfind("// ", 0) != 0) continue;
        const SourcePlace place = place_of_line(text, number);
        EXPECT_EQ(line, "// " + place.file.substr(0, 1) + " " + std::to_string(place.line));
        ++found;
    }
    EXPECT_EQ(found, 5);
    EXPECT_TRUE(has_file(text, "a.cl") && has_file(text, "b.h"));
    EXPECT_FALSE(has_file(text, "input.cl") || has_file(text, ""));
}

TEST(EmbeddedKernels, AllOfThemAssemble) {
    ScopedVariable unset("PAVE_KERNEL_DIR", nullptr);
    int count = 0;
    for (const auto& [name, bytes] : embedded_kernels()) {
        if (!name.ends_with(".cl")) continue;
        const std::string text = assemble_source(name);
        EXPECT_TRUE(has_file(text, name));
        EXPECT_EQ(text.find("#include \""), std::string::npos) << name;
        EXPECT_GE(text.size(), bytes.size());
        ++count;
    }
    EXPECT_GT(count, 0);
}

}  // namespace
}  // namespace pave
