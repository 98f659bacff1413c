// Pinned arenas and their slots as OpenCL buffers, on devices that share the host's memory and on
// those that do not. SPDX-License-Identifier: BSD-3-Clause
#include <cstdlib>
#include <cstring>
#include <memory>
#include <vector>

#include "host/device/impl.h"
#include "host/device/pages.h"

namespace pave {
namespace {

/// One OpenCL buffer a slot, made when it is first asked for: the arena may be larger than the
/// largest allocation.
class DeviceArena final : public Arena {
   public:
    DeviceArena(const cl::Context& context, const cl::CommandQueue& queue, SlotAccess access,
                size_t max_alloc_byte_size, size_t slot_byte_size, int slots)
        : context_(context), queue_(queue), access_(access), slot_byte_size_(slot_byte_size) {
        const size_t byte_size = slot_byte_size * static_cast<size_t>(slots);
        if (access == SlotAccess::kTwin && byte_size <= max_alloc_byte_size) {
            map_pinned(byte_size);
        } else {
            pages_ = std::make_unique<HostPages>(byte_size);
            data_ = pages_->data();
        }
        slots_.resize(static_cast<size_t>(slots));
    }
    ~DeviceArena() override {
        try {
            for (Slot& slot : slots_)
                if (slot.mapped != nullptr) queue_.enqueueUnmapMemObject(slot.buffer, slot.mapped);
            if (pinned_() != nullptr) queue_.enqueueUnmapMemObject(pinned_, data_);
            queue_.finish();  // host memory may not go while a command still uses it
        } catch (const cl::Error&) {
            // The driver is already gone; its memory is too.
        }
    }
    DeviceArena(const DeviceArena&) = delete;
    DeviceArena& operator=(const DeviceArena&) = delete;

    std::byte* data() override { return data_; }
    bool is_of(const cl::Context& context) const { return context_() == context(); }

    cl::Buffer buffer(const Frame& frame) {
        std::lock_guard lock(mutex_);
        return find(frame).buffer;
    }
    void to_device(const cl::CommandQueue& queue, const Frame& frame) {
        if (access_ == SlotAccess::kShared) return;
        std::lock_guard lock(mutex_);
        Slot& slot = find(frame);
        if (access_ == SlotAccess::kTwin) {
            queue.enqueueWriteBuffer(slot.buffer, CL_FALSE, 0, slot_byte_size_, frame.slot()->data);
        } else if (slot.mapped != nullptr) {
            queue.enqueueUnmapMemObject(slot.buffer, slot.mapped);
            slot.mapped = nullptr;
        }
    }
    cl::Event to_host(const cl::CommandQueue& queue, const Frame& frame) {
        cl::Event event;
        std::lock_guard lock(mutex_);
        Slot& slot = find(frame);
        if (access_ == SlotAccess::kTwin)
            queue.enqueueReadBuffer(slot.buffer, CL_FALSE, 0, slot_byte_size_, frame.slot()->data,
                                    nullptr, &event);
        else if (access_ == SlotAccess::kMapped && slot.mapped == nullptr)
            slot.mapped = queue.enqueueMapBuffer(slot.buffer, CL_FALSE, CL_MAP_READ | CL_MAP_WRITE,
                                                 0, slot_byte_size_, nullptr, &event);
        else
            queue.enqueueMarkerWithWaitList(nullptr, &event);
        return event;
    }

   private:
    struct Slot {
        cl::Buffer buffer;
        void* mapped = nullptr;  // kMapped: the host may look at the slot
    };

    void map_pinned(size_t byte_size) {
        pinned_ = cl::Buffer(context_, CL_MEM_ALLOC_HOST_PTR, byte_size);
        data_ = static_cast<std::byte*>(
            queue_.enqueueMapBuffer(pinned_, CL_TRUE, CL_MAP_READ | CL_MAP_WRITE, 0, byte_size));
        if (reinterpret_cast<uintptr_t>(data_) % kChannelAlignment != 0) {
            queue_.enqueueUnmapMemObject(pinned_, data_);
            pinned_ = cl::Buffer();
            pages_ = std::make_unique<HostPages>(byte_size);
            data_ = pages_->data();
            return;
        }
        std::memset(data_, 0, byte_size);
    }
    /// The slot of `frame`, with its buffer. Call with mutex_ held.
    Slot& find(const Frame& frame) {
        const size_t byte_offset = static_cast<size_t>(frame.slot()->data - data_);
        Slot& slot = slots_.at(byte_offset / slot_byte_size_);
        if (slot.buffer() == nullptr) {
            const bool over_host = access_ != SlotAccess::kTwin;
            slot.buffer = cl::Buffer(
                context_, CL_MEM_READ_WRITE | (over_host ? CL_MEM_USE_HOST_PTR : cl_mem_flags{0}),
                slot_byte_size_, over_host ? frame.slot()->data : nullptr);
        }
        return slot;
    }

    cl::Context context_;
    cl::CommandQueue queue_;
    SlotAccess access_;
    size_t slot_byte_size_;
    std::unique_ptr<HostPages> pages_;
    cl::Buffer pinned_;
    std::byte* data_ = nullptr;
    std::mutex mutex_;
    std::vector<Slot> slots_;
};

DeviceArena* arena_of(const Device& device, const Frame& frame) {
    if (!frame) return nullptr;
    auto* arena = dynamic_cast<DeviceArena*>(frame.slot()->arena.get());
    return arena != nullptr && arena->is_of(context_of(device)) ? arena : nullptr;
}

DeviceArena& own_arena(const Device& device, const Frame& frame) {
    DeviceArena* arena = arena_of(device, frame);
    if (arena == nullptr) throw InternalError("the frame's memory is not of this device's context");
    return *arena;
}

/// PAVE_SLOT_ACCESS=shared|mapped|twin, so that tests reach every way on any device.
SlotAccess forced_access() {
    const char* text = std::getenv("PAVE_SLOT_ACCESS");
    if (text == nullptr || *text == '\0') return SlotAccess::kUnknown;
    const std::string_view name = text;
    if (name == "shared") return SlotAccess::kShared;
    if (name == "mapped") return SlotAccess::kMapped;
    if (name == "twin") return SlotAccess::kTwin;
    throw UsageError("PAVE_SLOT_ACCESS=" + std::string(name) + ": it is shared, mapped or twin");
}

/// Does the device work on the host's own bytes, both ways, with no map in between?
bool shares_bytes(const cl::Context& context, const cl::CommandQueue& queue) {
    constexpr size_t kByteSize = kChannelAlignment;
    HostPages from_host(kByteSize), from_device(kByteSize);
    cl::Buffer source(context, CL_MEM_READ_WRITE | CL_MEM_USE_HOST_PTR, kByteSize,
                      from_host.data());
    cl::Buffer target(context, CL_MEM_READ_WRITE | CL_MEM_USE_HOST_PTR, kByteSize,
                      from_device.data());
    std::memset(from_host.data(), 0x5a, kByteSize);
    queue.enqueueCopyBuffer(source, target, 0, 0, kByteSize);
    queue.finish();
    return std::memcmp(from_host.data(), from_device.data(), kByteSize) == 0;
}

}  // namespace

SlotAccess Device::Impl::slot_access() {
    std::call_once(probed_, [this] {
        slot_access_ = forced_access();
        if (slot_access_ != SlotAccess::kUnknown) return;
        if (!profile_.host_unified_memory)
            slot_access_ = SlotAccess::kTwin;
        else if (profile_.is_cpu && shares_bytes(context_, queue_))
            slot_access_ = SlotAccess::kShared;
        else
            slot_access_ = SlotAccess::kMapped;
    });
    return slot_access_;
}

std::unique_ptr<Arena> Device::allocate_arena(size_t slot_byte_size, int slots) {
    if (slots < 1 || slot_byte_size == 0 || slot_byte_size % kChannelAlignment != 0)
        throw InternalError("an arena of " + std::to_string(slots) + " slots of " +
                            std::to_string(slot_byte_size) + " bytes");
    const size_t max_byte_size = profile().max_alloc_byte_size;
    if (slot_byte_size > max_byte_size)
        throw DeviceError("a frame of " + std::to_string(slot_byte_size) + " bytes is above the " +
                          std::to_string(max_byte_size) + " that " + profile().name +
                          " can allocate at once; use a smaller size or fewer channels");
    if (slot_byte_size > SIZE_MAX / 2 / static_cast<size_t>(slots))
        throw DeviceError("a ring of " + std::to_string(slots) + " slots of " +
                          std::to_string(slot_byte_size) + " bytes is above all memory");
    return cl_guard("ring", [&]() -> std::unique_ptr<Arena> {
        return std::make_unique<DeviceArena>(impl_->context_, impl_->queue_, impl_->slot_access(),
                                             max_byte_size, slot_byte_size, slots);
    });
}

void* Device::slot_buffer(const Frame& frame) const { return slot_buffer_of(*this, frame)(); }

cl::Buffer slot_buffer_of(const Device& device, const Frame& frame) {
    DeviceArena* arena = arena_of(device, frame);
    if (arena == nullptr) return {};
    return cl_guard("slot", [&] { return arena->buffer(frame); });
}

void slot_to_device(const Device& device, const Frame& frame) {
    cl_guard("slot", [&] { own_arena(device, frame).to_device(queue_of(device), frame); });
}

cl::Event slot_to_host(const Device& device, const Frame& frame) {
    return cl_guard("slot",
                    [&] { return own_arena(device, frame).to_host(queue_of(device), frame); });
}

}  // namespace pave
