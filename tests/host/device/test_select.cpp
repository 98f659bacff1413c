// Finding devices: every way to name one, what is said when there is none, and other people's
// handles.
// SPDX-License-Identifier: BSD-3-Clause
#include <dlfcn.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "tests/host/device/environment.h"
#include "tests/host/device/saxpy.h"

namespace pave {
namespace {

std::string message_of_select(const char* spec) {
    try {
        Device::select(spec);
    } catch (const Error& error) {
        return std::to_string(static_cast<int>(error.exit_code())) + " " + error.what();
    }
    return "found";
}

TEST(Select, ListHoldsFactsOfEveryDevice) {
    const std::vector<DeviceProfile> profiles = Device::list();
    ASSERT_FALSE(profiles.empty());
    for (const DeviceProfile& profile : profiles) {
        EXPECT_FALSE(profile.platform.empty());
        EXPECT_FALSE(profile.name.empty());
        EXPECT_FALSE(profile.driver.empty());
        EXPECT_NE(profile.id.find(':'), std::string::npos);
        EXPECT_GE(profile.compute_units, 1);
        EXPECT_GE(profile.native_float_width, 1);
        EXPECT_GE(profile.max_work_group_size, 1u);
        EXPECT_GE(profile.max_alloc_byte_size, size_t{32} << 20);  // OpenCL's own minimum
        EXPECT_GE(profile.global_byte_size, profile.max_alloc_byte_size);
    }
}

TEST(Select, EverySpecFindsTheSameOneDevice) {
    const DeviceProfile profile = Device::list().front();
    const std::string part = profile.name.substr(0, 5);
    std::string upper = part;
    std::transform(upper.begin(), upper.end(), upper.begin(),
                   [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
    EXPECT_EQ(Device::select(profile.id).profile().name, profile.name);
    EXPECT_EQ(Device::select(part).profile().id, profile.id);
    EXPECT_EQ(Device::select(upper).profile().id, profile.id);
    EXPECT_EQ(Device::select(profile.platform).profile().platform, profile.platform);
    EXPECT_EQ(Device::select(profile.is_gpu ? "gpu" : "cpu").profile().is_gpu, profile.is_gpu);
}

TEST(Select, EmptySpecTakesTheVariable) {
    const std::string id = Device::list().back().id;
    ScopedVariable device("PAVE_DEVICE", id.c_str());
    EXPECT_EQ(Device::select().profile().id, id);
    ScopedVariable unknown("PAVE_DEVICE", "abacus");
    EXPECT_NE(message_of_select("").find("PAVE_DEVICE 'abacus' not found; there is"),
              std::string::npos);
}

TEST(Select, UnknownDeviceListsWhatThereIs) {
    const DeviceProfile profile = Device::list().front();
    for (const char* spec : {"abacus", "97:0", "0:97", "0:", "-1:0"}) {
        const std::string message = message_of_select(spec);
        EXPECT_EQ(message.substr(0, 2), "4 ") << message;
        EXPECT_NE(message.find(std::string("'") + spec + "'"), std::string::npos) << message;
        EXPECT_NE(message.find(profile.id + " '" + profile.name + "'"), std::string::npos)
            << message;
        EXPECT_EQ(message.find('\n'), std::string::npos) << message;
    }
}

TEST(Select, LanesFollowTheProfileOrTheVariable) {
    ScopedVariable unset("PAVE_LANES", nullptr);
    for (const DeviceProfile& profile : Device::list()) {
        if (profile.is_gpu)
            EXPECT_EQ(profile.lane_width, 1);
        else
            EXPECT_LE(profile.lane_width, std::max(1, profile.native_float_width));
    }
    for (const char* lanes : {"1", "4", "8", "16"}) {
        ScopedVariable forced("PAVE_LANES", lanes);
        EXPECT_EQ(std::to_string(Device::select().profile().lane_width), lanes);
    }
    for (const char* lanes : {"0", "2", "32", "-8", "8x", "eight", " 8"}) {
        ScopedVariable forced("PAVE_LANES", lanes);
        EXPECT_EQ(message_of_select(""),
                  "2 PAVE_LANES=" + std::string(lanes) + ": lanes are 1, 4, 8 or 16");
    }
}

TEST(SelectDeathTest, NoPlatformNamesThePackage) {
    GTEST_FLAG_SET(death_test_style,
                   "threadsafe");  // a fresh process: loaders read the variable once
    EXPECT_EXIT(
        {
            setenv("OCL_ICD_VENDORS", "/nonexistent", 1);
            std::string listed;
            try {
                Device::list();
            } catch (const DeviceError& error) {
                listed = error.what();
            }
            const std::string selected = message_of_select("");
            std::fprintf(stderr, "%s", selected.c_str());
            std::_Exit(selected == "4 " + listed ? 0 : 1);
        },
        testing::ExitedWithCode(0), "4 no OpenCL platform found; .*apt install pocl-opencl-icd");
}

TEST(Select, CopiesShareOneQueue) {
    const Device device = Device::select();
    const Device copy = device;
    EXPECT_EQ(copy.queue_handle(), device.queue_handle());
    EXPECT_EQ(copy.context_handle(), device.context_handle());
    EXPECT_NE(Device::select().context_handle(), device.context_handle());
}

TEST(FromHandles, RetainsAndUsesThem) {
    auto owner = std::make_unique<Device>(Device::select());
    Device guest = Device::from_handles(owner->context_handle(), owner->device_handle(),
                                        owner->queue_handle());
    EXPECT_EQ(guest.queue_handle(), owner->queue_handle());
    EXPECT_EQ(guest.profile().id, owner->profile().id);
    Frame frame = make_frame(FrameSchema::of_known(3, 5, {"depth"}), *owner);
    EXPECT_NE(guest.slot_buffer(frame), nullptr) << "one context: one and the same memory";
    owner.reset();
    EXPECT_EQ(run_saxpy(guest), "");
}

TEST(FromHandles, MakesAQueueIfThereIsNone) {
    const Device owner = Device::select();
    const Device guest =
        Device::from_handles(owner.context_handle(), owner.device_handle(), nullptr);
    EXPECT_NE(guest.queue_handle(), owner.queue_handle());
    EXPECT_EQ(run_saxpy(guest), "");
}

TEST(FromHandles, RefusesWhatDoesNotBelongTogether) {
    const Device a = Device::select(), b = Device::select();
    EXPECT_THROW(Device::from_handles(nullptr, a.device_handle(), nullptr), DeviceError);
    EXPECT_THROW(Device::from_handles(a.context_handle(), nullptr, nullptr), DeviceError);
    EXPECT_THROW(Device::from_handles(a.context_handle(), a.device_handle(), b.queue_handle()),
                 DeviceError);
    const cl::CommandQueue unordered(context_of(a), device_of(a),
                                     CL_QUEUE_OUT_OF_ORDER_EXEC_MODE_ENABLE);
    EXPECT_THROW(Device::from_handles(a.context_handle(), a.device_handle(), unordered()),
                 DeviceError);
}

/// pyopencl brings an ICD loader of its own. Here a copy of the system's loader plays that part.
class OtherLoader {
   public:
    OtherLoader() {
        Dl_info info{};
        if (dladdr(reinterpret_cast<void*>(&clGetPlatformIDs), &info) == 0) return;
        const std::filesystem::path copy = folder_.path() / "other_loader.so";
        std::filesystem::copy_file(std::filesystem::canonical(info.dli_fname), copy);
        library_ = dlopen(copy.c_str(), RTLD_NOW | RTLD_LOCAL);
    }
    template <class Function>
    Function* find(Function&, const char* name) const {
        return library_ == nullptr ? nullptr : reinterpret_cast<Function*>(dlsym(library_, name));
    }

   private:
    TemporaryFolder folder_;
    void* library_ = nullptr;
};

TEST(FromHandles, TakesHandlesOfAnotherLoader) {
    Device::kernel_cache();  // the other loader makes the first OpenCL call
    const OtherLoader other;
    auto* get_platforms = other.find(clGetPlatformIDs, "clGetPlatformIDs");
    auto* get_devices = other.find(clGetDeviceIDs, "clGetDeviceIDs");
    auto* create_context = other.find(clCreateContext, "clCreateContext");
    auto* create_queue = other.find(clCreateCommandQueue, "clCreateCommandQueue");
    ASSERT_TRUE(get_platforms && get_devices && create_context && create_queue);
    ASSERT_NE(get_platforms, &clGetPlatformIDs) << "the copy resolved to the same loader";
    cl_platform_id platform = nullptr;
    cl_device_id id = nullptr;
    cl_int code = CL_SUCCESS;
    ASSERT_EQ(get_platforms(1, &platform, nullptr), CL_SUCCESS);
    ASSERT_EQ(get_devices(platform, CL_DEVICE_TYPE_ALL, 1, &id, nullptr), CL_SUCCESS);
    ::cl_context context = create_context(nullptr, 1, &id, nullptr, nullptr, &code);
    ASSERT_EQ(code, CL_SUCCESS);
    ::cl_command_queue queue = create_queue(context, id, 0, &code);
    ASSERT_EQ(code, CL_SUCCESS);
    {
        Device device = Device::from_handles(context, id, queue);
        EXPECT_EQ(device.context_handle(), context);
        EXPECT_EQ(run_saxpy(device), "");
        Frame frame = make_frame(FrameSchema::of_known(3, 5, {"depth"}), device);
        // And back: a buffer that PAVE made, filled through the other loader.
        auto* fill = other.find(clEnqueueFillBuffer, "clEnqueueFillBuffer");
        auto* finish_queue = other.find(clFinish, "clFinish");
        const float value = 2.5f;
        ASSERT_EQ(fill(queue, static_cast<cl_mem>(device.slot_buffer(frame)), &value, sizeof value,
                       0, 15 * sizeof value, 0, nullptr, nullptr),
                  CL_SUCCESS);
        ASSERT_EQ(finish_queue(queue), CL_SUCCESS);
        wait(slot_to_host(device, frame), "slot");
        for (float pixel : frame.channel("depth")) EXPECT_EQ(pixel, 2.5f);
    }
    EXPECT_EQ(other.find(clReleaseCommandQueue, "clReleaseCommandQueue")(queue), CL_SUCCESS);
    EXPECT_EQ(other.find(clReleaseContext, "clReleaseContext")(context), CL_SUCCESS);
}

}  // namespace
}  // namespace pave
