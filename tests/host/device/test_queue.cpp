// Buffers, waits with a deadline, and errors by name.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <thread>

#include "tests/host/device/saxpy.h"

namespace pave {
namespace {

using std::chrono::milliseconds;

double seconds_of_thread() {
    rusage usage{};
    getrusage(RUSAGE_THREAD, &usage);
    return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
           1e-6 * static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

TEST(Errors, CodesHaveNames) {
    EXPECT_EQ(cl_code_name(CL_OUT_OF_RESOURCES), "CL_OUT_OF_RESOURCES(-5)");
    EXPECT_EQ(cl_code_name(-1001), "CL_PLATFORM_NOT_FOUND_KHR(-1001)");
    EXPECT_EQ(cl_code_name(-9999), "CL_ERROR(-9999)");
    const ClError error("clFinish", -5, "trace", "two\nlines", "do this");
    EXPECT_STREQ(error.what(), "clFinish: CL_OUT_OF_RESOURCES(-5): trace: two lines; do this");
    EXPECT_EQ(error.exit_code(), ExitCode::kDevice);
}

TEST(Wait, EndsAtItsDeadline) {
    const Device device = Device::select();
    cl::UserEvent never(context_of(device));
    const auto begin = std::chrono::steady_clock::now();
    const double used = seconds_of_thread();
    try {
        wait(never, "frame 7", milliseconds(300));
        ADD_FAILURE() << "nothing completed that event";
    } catch (const DeviceError& error) {
        EXPECT_NE(std::string(error.what()).find("frame 7 did not finish within 0.3"),
                  std::string::npos)
            << error.what();
    }
    const auto waited = std::chrono::steady_clock::now() - begin;
    EXPECT_GE(waited, milliseconds(300));
    EXPECT_LT(waited, milliseconds(5000));
    EXPECT_LT(seconds_of_thread() - used, 0.1) << "the wait spins";
    never.setStatus(CL_COMPLETE);
    wait(never, "frame 7");
}

TEST(Wait, SeesAnEventThatComesLater) {
    const Device device = Device::select();
    cl::UserEvent later(context_of(device));
    std::thread other([&] {
        std::this_thread::sleep_for(milliseconds(30));
        later.setStatus(CL_COMPLETE);
    });
    wait(later, "later", milliseconds(10000));
    other.join();
}

TEST(Wait, NamesTheCodeOfAFailedCommand) {
    const Device device = Device::select();
    cl::UserEvent failed(context_of(device));
    failed.setStatus(CL_OUT_OF_RESOURCES);
    try {
        wait(failed, "frame 7");
        ADD_FAILURE() << "the event failed";
    } catch (const ClError& error) {
        EXPECT_NE(std::string(error.what()).find("CL_OUT_OF_RESOURCES(-5): frame 7"),
                  std::string::npos);
    }
}

TEST(Wait, FinishCoversTheWholeQueue) {
    const Device device = Device::select();
    std::vector<int> zeros(1 << 20, 0), got(zeros.size(), -1);
    const cl::Buffer buffer = make_buffer_of(device, zeros, "zeros");
    queue_of(device).enqueueReadBuffer(buffer, CL_FALSE, 0, got.size() * sizeof(int), got.data());
    finish(device, "read");
    EXPECT_EQ(got, zeros);
}

TEST(Buffers, RoundTripOfAnySize) {
    const Device device = Device::select();
    for (size_t count : {0u, 1u, 3u, 4097u}) {
        std::vector<uint16_t> sent(count), got(count);
        for (size_t i = 0; i < count; ++i) sent[i] = static_cast<uint16_t>(i * 40503u);
        read_buffer(device, make_buffer_of(device, sent, "sent"), got, "got");
        EXPECT_EQ(got, sent);
    }
}

TEST(Buffers, TooLargeNamesBothSizes) {
    const Device device = Device::select();
    const size_t largest = device.profile().max_alloc_byte_size;
    try {
        make_buffer(device, largest + 1, "bvh");
        ADD_FAILURE() << "above the largest allocation";
    } catch (const ClError& error) {
        const std::string message = error.what();
        EXPECT_NE(message.find("bvh"), std::string::npos);
        EXPECT_NE(message.find(std::to_string(largest + 1)), std::string::npos);
        EXPECT_NE(message.find(std::to_string(largest) + " at most"), std::string::npos);
    }
}

TEST(Launch, NamesTheKernelAndTheArgument) {
    const Device device = Device::select();
    const cl::Program program = build_program_from_source(device, "saxpy.cl", kSaxpySource);
    cl::Kernel kernel = make_kernel(program, "saxpy");
    const cl::Buffer buffer = make_buffer(device, 64, "x");
    try {
        launch(device, kernel, cl::NDRange(1), cl::NullRange, buffer, buffer, 3.0);  // a double
        ADD_FAILURE() << "saxpy takes a float";
    } catch (const ClError& error) {
        EXPECT_NE(std::string(error.what()).find("CL_INVALID_ARG_SIZE(-51): saxpy, argument 2"),
                  std::string::npos)
            << error.what();
    }
    const size_t too_large = 2 * device.profile().max_work_group_size;
    EXPECT_THROW(launch(device, kernel, cl::NDRange(too_large), cl::NDRange(too_large), buffer,
                        buffer, 3.0f),
                 ClError);
}

TEST(Launch, ManyThreadsShareADevice) {
    const Device device = Device::select();
    std::vector<std::string> results(4);
    std::vector<std::thread> threads;
    for (std::string& result : results)
        threads.emplace_back([&device, &result] {
            for (int i = 0; i < 5 && result.empty(); ++i) result = run_saxpy(device);
        });
    for (std::thread& thread : threads) thread.join();
    for (const std::string& result : results) EXPECT_EQ(result, "");
}

}  // namespace
}  // namespace pave
