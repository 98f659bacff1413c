// Slots: host and device work on the same bytes, whichever way the device has.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <numeric>

#include "tests/host/device/environment.h"
#include "tests/host/device/saxpy.h"

namespace pave {
namespace {

constexpr const char* kAddSource =
    "kernel void add(global float* slot, uint first, float a) { slot[first + get_global_id(0)] += "
    "a; }\n";

/// Frames of one arena, as a ring cuts them.
std::vector<Frame> make_ring(Device& device, const FrameSchema& schema, int slots) {
    const std::shared_ptr<Arena> arena = device.allocate_arena(schema.slot_byte_size(), slots);
    std::vector<Frame> frames;
    for (int i = 0; i < slots; ++i) {
        auto slot = std::make_shared<Slot>();
        slot->schema = schema;
        slot->arena = arena;
        slot->index = i;
        slot->data = arena->data() + static_cast<size_t>(i) * schema.slot_byte_size();
        frames.emplace_back(std::move(slot));
    }
    return frames;
}

/// Adds `a` to every pixel of `channel` by a kernel.
void add(const Device& device, Frame& frame, const std::string& channel, float a) {
    const cl::Program program = build_program_from_source(device, "add.cl", kAddSource);
    cl::Kernel kernel = make_kernel(program, "add");
    const int index = frame.schema().find(channel);
    const auto first =
        static_cast<cl_uint>(frame.schema().channel_byte_offset(index) / sizeof(float));
    slot_to_device(device, frame);
    launch(device, kernel, cl::NDRange(frame.channel(channel).size()), cl::NullRange,
           slot_buffer_of(device, frame), first, a);
    wait(slot_to_host(device, frame), "add");
}

class Slots : public testing::TestWithParam<const char*> {
   protected:
    ScopedVariable access_{"PAVE_SLOT_ACCESS", GetParam()};
    Device device_ = Device::select();
};

TEST_P(Slots, AreZeroAlignedAndContiguous) {
    const FrameSchema schema = FrameSchema::of_known(7, 3, {"color", "depth"});
    std::vector<Frame> frames = make_ring(device_, schema, 3);
    for (Frame& frame : frames) {
        EXPECT_EQ(reinterpret_cast<uintptr_t>(frame.slot()->data) % kChannelAlignment, 0u);
        for (float pixel : frame.channel("color")) EXPECT_EQ(pixel, 0.0f);
        EXPECT_EQ(frame.slot()->data - frames[0].slot()->data,
                  static_cast<std::ptrdiff_t>(static_cast<size_t>(frame.slot()->index) *
                                              schema.slot_byte_size()));
    }
}

TEST_P(Slots, HostAndKernelTakeTurns) {
    std::vector<Frame> frames =
        make_ring(device_, FrameSchema::of_known(7, 3, {"color", "depth"}), 2);
    for (int turn = 0; turn < 3; ++turn) {
        for (Frame& frame : frames) {
            std::span<float> depth = frame.channel("depth");
            const float base = static_cast<float>(10 * turn + frame.slot()->index);
            std::iota(depth.begin(), depth.end(), base);
            add(device_, frame, "depth", 0.5f);
            for (size_t i = 0; i < depth.size(); ++i)
                ASSERT_EQ(depth[i], base + static_cast<float>(i) + 0.5f)
                    << "turn " << turn << ", slot " << frame.slot()->index << ", pixel " << i;
            for (float pixel : frame.channel("color"))
                ASSERT_EQ(pixel, 0.0f) << "another channel changed";
        }
    }
}

TEST_P(Slots, KeepTheirBufferAndTheirOwner) {
    std::vector<Frame> frames = make_ring(device_, FrameSchema::of_known(2, 2, {"depth"}), 2);
    void* const first = device_.slot_buffer(frames[0]);
    EXPECT_EQ(device_.slot_buffer(frames[0]), first);
    EXPECT_NE(device_.slot_buffer(frames[1]), first);
    EXPECT_EQ(Device::select().slot_buffer(frames[0]), nullptr) << "another context";
    EXPECT_EQ(device_.slot_buffer(make_frame(frames[0].schema())), nullptr) << "plain host memory";
    EXPECT_EQ(device_.slot_buffer(Frame()), nullptr);
    EXPECT_THROW(slot_to_host(device_, make_frame(frames[0].schema())), InternalError);
}

TEST_P(Slots, OutliveTheirDevice) {
    Frame frame;
    {
        Device device = Device::select();
        frame = make_frame(FrameSchema::of_known(2, 2, {"depth"}), device);
        add(device, frame, "depth", 4.0f);
    }
    for (float pixel : frame.channel("depth")) EXPECT_EQ(pixel, 4.0f);
}

// As pyopencl holds one: memory goes with its last holder, not with the frame.
TEST_P(Slots, BuffersMayOutliveTheirFrame) {
    cl::Buffer buffer;
    {
        Frame frame = make_frame(FrameSchema::of_known(64, 64, {"depth"}), device_);
        buffer = slot_buffer_of(device_, frame);
        add(device_, frame, "depth", 4.0f);
        slot_to_device(device_, frame);
        queue_of(device_).enqueueFillBuffer(buffer, 2.0f, 0, 4096);
        slot_to_host(device_, frame);  // and nobody waits for it
    }
    std::vector<float> got(64 * 64);
    read_buffer(device_, buffer, got, "buffer");
    EXPECT_EQ(got.front(), 2.0f);
    EXPECT_EQ(got.back(), 4.0f);
}

INSTANTIATE_TEST_SUITE_P(EveryAccess, Slots, testing::Values("shared", "mapped", "twin"),
                         [](const auto& info) { return std::string(info.param); });

TEST(Arenas, CpuSlotIsTheBuffersOwnMemory) {
    Device device = Device::select();
    Frame frame = make_frame(FrameSchema::of_known(2, 2, {"depth"}), device);
    const cl::Buffer buffer = slot_buffer_of(device, frame);
    if (device.profile().is_cpu && device.profile().host_unified_memory) {
        EXPECT_EQ(buffer.getInfo<CL_MEM_HOST_PTR>(), frame.slot()->data);
        EXPECT_EQ(queue_of(device).enqueueMapBuffer(buffer, CL_TRUE, CL_MAP_READ, 0, 16),
                  frame.slot()->data);
    }
    EXPECT_EQ(buffer.getInfo<CL_MEM_SIZE>(), frame.schema().slot_byte_size());
}

TEST(Arenas, MayBeLargerThanTheLargestAllocation) {
    Device device = Device::select();
    const size_t largest = device.profile().max_alloc_byte_size;
    const size_t height = std::min<size_t>(largest / 4 / (8192 * sizeof(float)), 16384);
    const FrameSchema schema = FrameSchema::of_known(8192, static_cast<int>(height), {"depth"});
    const int slots = static_cast<int>(largest / schema.slot_byte_size()) + 1;
    std::vector<Frame> frames =
        make_ring(device, schema, slots);  // system memory comes when touched
    Frame& last = frames.back();
    slot_to_device(device, last);
    queue_of(device).enqueueFillBuffer(slot_buffer_of(device, last), 1.5f, 0, 4096);
    wait(slot_to_host(device, last), "fill");
    EXPECT_EQ(last.channel("depth")[1023], 1.5f);
    EXPECT_EQ(last.channel("depth")[1024], 0.0f);
}

TEST(Arenas, RefuseWhatCannotBe) {
    Device device = Device::select();
    EXPECT_THROW(device.allocate_arena(4096, 0), InternalError);
    EXPECT_THROW(device.allocate_arena(0, 1), InternalError);
    EXPECT_THROW(device.allocate_arena(4097, 1), InternalError);
    EXPECT_THROW(device.allocate_arena((device.profile().max_alloc_byte_size / 4096 + 1) * 4096, 1),
                 DeviceError);
    EXPECT_THROW(device.allocate_arena(size_t{1} << 30, 2147483647), DeviceError);
}

TEST(Arenas, UnknownAccessIsAUsageError) {
    ScopedVariable access("PAVE_SLOT_ACCESS", "telepathy");
    Device device = Device::select();
    EXPECT_THROW(device.allocate_arena(4096, 1), UsageError);
}

TEST(ArenasDeathTest, NothingRunsOverTheirEnds) {
    GTEST_FLAG_SET(death_test_style, "threadsafe");
    const auto touch = [](std::ptrdiff_t offset) {
        ScopedVariable access("PAVE_SLOT_ACCESS", "shared");
        Device device = Device::select();
        const std::unique_ptr<Arena> arena = device.allocate_arena(4096, 2);
        *static_cast<volatile char*>(static_cast<void*>(arena->data() + offset)) = 1;
    };
    EXPECT_EXIT(touch(-1), testing::KilledBySignal(SIGSEGV), "");
    EXPECT_EXIT(touch(8192), testing::KilledBySignal(SIGSEGV), "");
}

}  // namespace
}  // namespace pave
