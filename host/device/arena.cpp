// Pinned arenas and their slots as OpenCL buffers, on devices that share the host's memory and on
// those that do not.
// SPDX-License-Identifier: BSD-3-Clause
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <vector>

#include "host/device/impl.h"
#include "host/device/pages.h"

namespace pave {
namespace {

/// The memory of an arena. Shared with whatever in the driver still works on it (commands on their
/// way, buffers that others retained), because the arena itself does not wait for those when it
/// goes.
class Storage {
   public:
    Storage(const cl::Context& context, const cl::CommandQueue& queue, bool pinned,
            size_t byte_size)
        : queue_(queue) {
        if (pinned && map_pinned(context, byte_size)) return;
        pages_ = std::make_unique<HostPages>(byte_size);
        data_ = pages_->data();
    }
    ~Storage() {
        if (pinned_() != nullptr) unmap();
    }
    Storage(const Storage&) = delete;
    Storage& operator=(const Storage&) = delete;
    std::byte* data() { return data_; }

   private:
    bool map_pinned(const cl::Context& context, size_t byte_size) {
        pinned_ = cl::Buffer(context, CL_MEM_ALLOC_HOST_PTR, byte_size);
        data_ = static_cast<std::byte*>(
            queue_.enqueueMapBuffer(pinned_, CL_TRUE, CL_MAP_READ | CL_MAP_WRITE, 0, byte_size));
        if (reinterpret_cast<uintptr_t>(data_) % kChannelAlignment == 0) {
            std::memset(data_, 0, byte_size);
            return true;
        }
        unmap();
        pinned_ = cl::Buffer();
        return false;
    }
    void unmap() noexcept {
        try {
            queue_.enqueueUnmapMemObject(pinned_, data_);
        } catch (const cl::Error& error) {
            std::fprintf(stderr, "pave: %s: %s\n", error.what(), cl_code_name(error.err()).c_str());
        }
    }

    cl::CommandQueue queue_;
    std::unique_ptr<HostPages> pages_;
    cl::Buffer pinned_;
    std::byte* data_ = nullptr;
};

using SharedStorage = std::shared_ptr<Storage>;
void CL_CALLBACK drop_with_buffer(cl_mem, void* storage) {
    delete static_cast<SharedStorage*>(storage);
}
void CL_CALLBACK drop_with_event(cl_event, cl_int, void* storage) {
    delete static_cast<SharedStorage*>(storage);
}

/// One OpenCL buffer a slot, made when it is first asked for: the arena may be larger than the
/// largest allocation.
class DeviceArena final : public Arena {
   public:
    DeviceArena(const cl::Context& context, const cl::CommandQueue& queue, SlotAccess access,
                size_t max_alloc_byte_size, size_t slot_byte_size, int slots)
        : context_(context), queue_(queue), access_(access), slot_byte_size_(slot_byte_size) {
        const size_t byte_size = slot_byte_size * static_cast<size_t>(slots);
        const bool pinned = access == SlotAccess::kTwin && byte_size <= max_alloc_byte_size;
        storage_ = std::make_shared<Storage>(context, queue, pinned, byte_size);
        data_ = storage_->data();
        slots_.resize(static_cast<size_t>(slots));
    }
    ~DeviceArena() override {
        for (Slot& slot : slots_) {
            if (slot.mapped == nullptr) continue;
            try {
                queue_.enqueueUnmapMemObject(slot.buffer, slot.mapped);
            } catch (const cl::Error& error) {
                std::fprintf(stderr, "pave: %s: %s\n", error.what(),
                             cl_code_name(error.err()).c_str());
            }
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
            cl::Event event;
            queue.enqueueWriteBuffer(slot.buffer, CL_FALSE, 0, slot_byte_size_, frame.slot()->data,
                                     nullptr, &event);
            event.setCallback(CL_COMPLETE, drop_with_event, new SharedStorage(storage_));
        } else if (slot.mapped != nullptr) {
            queue.enqueueUnmapMemObject(slot.buffer, slot.mapped);
            slot.mapped = nullptr;
        }
    }
    cl::Event to_host(const cl::CommandQueue& queue, const Frame& frame) {
        cl::Event event;
        std::lock_guard lock(mutex_);
        Slot& slot = find(frame);
        if (access_ == SlotAccess::kTwin) {
            queue.enqueueReadBuffer(slot.buffer, CL_FALSE, 0, slot_byte_size_, frame.slot()->data,
                                    nullptr, &event);
            event.setCallback(CL_COMPLETE, drop_with_event, new SharedStorage(storage_));
        } else if (access_ == SlotAccess::kMapped && slot.mapped == nullptr) {
            slot.mapped = queue.enqueueMapBuffer(slot.buffer, CL_FALSE, CL_MAP_READ | CL_MAP_WRITE,
                                                 0, slot_byte_size_, nullptr, &event);
        } else {
            queue.enqueueMarkerWithWaitList(nullptr, &event);
        }
        return event;
    }

   private:
    struct Slot {
        cl::Buffer buffer;
        void* mapped = nullptr;  // kMapped: the host may look at the slot
    };

    /// The slot of `frame`, with its buffer. Call with mutex_ held.
    Slot& find(const Frame& frame) {
        const size_t byte_offset = static_cast<size_t>(frame.slot()->data - data_);
        Slot& slot = slots_.at(byte_offset / slot_byte_size_);
        if (slot.buffer() == nullptr) {
            if (access_ == SlotAccess::kTwin) {
                slot.buffer = cl::Buffer(context_, CL_MEM_READ_WRITE, slot_byte_size_);
            } else {
                slot.buffer = cl::Buffer(context_, CL_MEM_READ_WRITE | CL_MEM_USE_HOST_PTR,
                                         slot_byte_size_, frame.slot()->data);
                slot.buffer.setDestructorCallback(drop_with_buffer, new SharedStorage(storage_));
            }
        }
        return slot;
    }

    cl::Context context_;
    cl::CommandQueue queue_;
    SlotAccess access_;
    size_t slot_byte_size_;
    SharedStorage storage_;
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
