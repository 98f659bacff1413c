// The frame: the channels of one view plus its metadata, in one slot of a pinned ring. The one
// seam between host/ and staging/.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "pave/error.h"

namespace pave {

inline constexpr size_t kChannelAlignment = 4096;  // bytes; every channel of a slot starts on it

/// A pinhole camera, as Mitsuba 3 has it: right-handed, +X left, +Y up, +Z along the view.
struct View {
    std::array<float, 16> world_from_camera{1, 0, 0, 0, 0, 1, 0, 0,
                                            0, 0, 1, 0, 0, 0, 0, 1};  // row-major 4x4
    float fov_x_degrees = 40.0f;  // horizontal field of view, in (0, 180)

    bool operator==(const View&) const = default;
};

/// View from `eye` to `target`; `up` must not be parallel to the view axis. Throws UsageError if it
/// is, or eye == target.
View look_at(std::array<float, 3> eye, std::array<float, 3> target, std::array<float, 3> up,
             float fov_x_degrees);

/// A named image plane group. Planes are float32, (planes, height, width), linear.
struct Channel {
    std::string name;
    int planes = 0;

    bool operator==(const Channel&) const = default;
};

/// Planes of a channel that PAVE itself knows (color 3, albedo 3, direct 3, normal 3, depth 1,
/// distance 1, variance 3, position 3, object 1, drawn 3); 0 if the name is not one of them.
int known_channel_planes(std::string_view name);

/// True for a name that is safe as file, variable and layer name: [A-Za-z0-9._-]{1,128}, no leading
/// dot.
bool is_valid_name(std::string_view name);

/// Size and layout of every frame of a stage. Immutable.
class FrameSchema {
   public:
    FrameSchema() = default;
    /// Throws UsageError for a size outside 1..16384, no or more than 64 channels, a bad or doubled
    /// name, planes outside 1..64.
    FrameSchema(int width, int height, std::vector<Channel> channels);
    /// Channels by known name only; throws UsageError with the list of known names otherwise.
    static FrameSchema of_known(int width, int height, const std::vector<std::string>& names);

    int width() const { return width_; }
    int height() const { return height_; }
    const std::vector<Channel>& channels() const { return channels_; }
    /// Index of `name`, or -1.
    int find(std::string_view name) const;
    size_t channel_byte_offset(int index) const {
        return byte_offsets_[static_cast<size_t>(index)];
    }
    size_t channel_byte_size(int index) const;  // planes * height * width * 4, without padding
    size_t slot_byte_size() const { return slot_byte_size_; }  // multiple of kChannelAlignment

    bool operator==(const FrameSchema&) const = default;

   private:
    int width_ = 0, height_ = 0;
    std::vector<Channel> channels_;
    std::vector<size_t> byte_offsets_;
    size_t slot_byte_size_ = 0;
};

/// What is known of a frame beside its pixels. Written by the producer, kept by every sink.
struct FrameMetadata {
    int64_t index = 0;  // frame number in its data set, 0-based
    View view;
    int spp = 0;        // samples per pixel
    int max_depth = 0;  // longest path in edges, as Mitsuba counts it
    int rr_depth = 0;   // Russian roulette from this depth on
    uint64_t seed = 0;
    std::string scene, scene_hash;  // name; XXH3-128 hex over the scene file and its meshes
    std::string device, driver, kernel_hash;
    std::string program_version, program_commit;
    std::string weights_version;  // empty unless a network drew it
    double seconds_spent = 0.0;   // wall time of making it; not part of a frame's identity
};

/// Memory that a ring is cut from: `slots` times `slot_byte_size` contiguous bytes,
/// kChannelAlignment-aligned. Devices derive from it to know the same bytes under a handle of their
/// own.
class Arena {
   public:
    virtual ~Arena() = default;
    virtual std::byte* data() = 0;
};

/// Makes arenas. pave::Device is one; host_memory() is the one of programs that have no device.
class ArenaAllocator {
   public:
    virtual ~ArenaAllocator() = default;
    /// Throws DeviceError or RunError when the memory cannot be had.
    virtual std::unique_ptr<Arena> allocate_arena(size_t slot_byte_size, int slots) = 0;
};
ArenaAllocator& host_memory();

/// One slot of a ring. Lives as long as any Frame refers to it; then its ring may hand it out
/// again.
struct Slot {
    FrameSchema schema;
    FrameMetadata metadata;
    std::shared_ptr<Arena> arena;  // keeps the memory alive even past its stage
    int index = 0;                 // position in the ring
    std::byte* data = nullptr;     // arena->data() + index * schema.slot_byte_size()
};

/// A counted handle on a slot: copies share it, and the slot is not reused while one lives. One
/// producer writes it between Stage::acquire and Stage::publish; afterwards everybody reads.
/// Distinct frames are independent (any thread).
class Frame {
   public:
    Frame() = default;
    explicit Frame(std::shared_ptr<Slot> slot) : slot_(std::move(slot)) {}
    explicit operator bool() const { return slot_ != nullptr; }

    const FrameSchema& schema() const { return slot_->schema; }
    FrameMetadata& metadata() { return slot_->metadata; }
    const FrameMetadata& metadata() const { return slot_->metadata; }
    bool has(std::string_view channel) const { return slot_->schema.find(channel) >= 0; }
    /// Planes of `channel`, (planes, height, width) row-major; borrowed while this frame or a copy
    /// lives. Throws UsageError naming the channels there are.
    std::span<float> channel(std::string_view name);
    std::span<const float> channel(std::string_view name) const;
    const std::shared_ptr<Slot>& slot() const { return slot_; }

   private:
    std::shared_ptr<Slot> slot_;
};

/// A frame of its own memory, outside any ring (tests, one-off renders, readers of files).
Frame make_frame(const FrameSchema& schema, ArenaAllocator& allocator = host_memory());

}  // namespace pave
