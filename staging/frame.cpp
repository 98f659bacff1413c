// Layout of frames, their names, and frames outside a ring.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/frame.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <utility>

namespace pave {
namespace {

constexpr std::pair<std::string_view, int> kKnownChannels[] = {
    {"color", 3},    {"albedo", 3},   {"direct", 3},   {"normal", 3}, {"depth", 1},
    {"distance", 1}, {"variance", 3}, {"position", 3}, {"object", 1}, {"drawn", 3},
};
constexpr int kMaxExtent = 16384;
constexpr int kMaxChannels = 64;

size_t align_up(size_t bytes) {
    return (bytes + kChannelAlignment - 1) / kChannelAlignment * kChannelAlignment;
}

class HostArena final : public Arena {
   public:
    explicit HostArena(size_t byte_size)
        : data_(static_cast<std::byte*>(std::aligned_alloc(kChannelAlignment, byte_size))) {
        if (data_ == nullptr)
            throw RunError("cannot allocate " + std::to_string(byte_size) +
                           " bytes of frame memory: use fewer slots or smaller frames");
        std::fill_n(data_, byte_size, std::byte{0});
    }
    ~HostArena() override { std::free(data_); }
    HostArena(const HostArena&) = delete;
    HostArena& operator=(const HostArena&) = delete;
    std::byte* data() override { return data_; }

   private:
    std::byte* data_;
};

class HostAllocator final : public ArenaAllocator {
   public:
    std::unique_ptr<Arena> allocate_arena(size_t slot_byte_size, int slots) override {
        return std::make_unique<HostArena>(slot_byte_size * static_cast<size_t>(slots));
    }
};

std::string list_names(const std::vector<Channel>& channels) {
    std::string names;
    for (const Channel& channel : channels) names += (names.empty() ? "" : ", ") + channel.name;
    return names;
}

using Vec3 = std::array<float, 3>;
Vec3 cross(Vec3 a, Vec3 b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
float normalize(Vec3& v) {
    const float length = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (float& x : v) x /= length;
    return length;
}

}  // namespace

int known_channel_planes(std::string_view name) {
    for (const auto& [known, planes] : kKnownChannels)
        if (known == name) return planes;
    return 0;
}

bool is_valid_name(std::string_view name) {
    if (name.empty() || name.size() > 128 || name.front() == '.') return false;
    return std::all_of(name.begin(), name.end(), [](unsigned char c) {
        return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
               c == '.' || c == '_' || c == '-';
    });
}

FrameSchema::FrameSchema(int width, int height, std::vector<Channel> channels)
    : width_(width), height_(height), channels_(std::move(channels)) {
    if (width < 1 || height < 1 || width > kMaxExtent || height > kMaxExtent)
        throw UsageError("frame size " + std::to_string(width) + "x" + std::to_string(height) +
                         " is outside 1..16384");
    if (channels_.empty() || channels_.size() > kMaxChannels)
        throw UsageError("a frame has 1 to 64 channels, not " + std::to_string(channels_.size()));
    for (size_t i = 0; i < channels_.size(); ++i) {
        const Channel& channel = channels_[i];
        if (!is_valid_name(channel.name))
            throw UsageError("channel name '" + channel.name +
                             "' is not of [A-Za-z0-9._-], 1 to 128 characters, no leading dot");
        if (find(channel.name) != static_cast<int>(i))
            throw UsageError("channel '" + channel.name + "' is named twice");
        if (channel.planes < 1 || channel.planes > 64)
            throw UsageError("channel '" + channel.name + "' has " +
                             std::to_string(channel.planes) + " planes, not 1 to 64");
        byte_offsets_.push_back(slot_byte_size_);
        slot_byte_size_ += align_up(channel_byte_size(static_cast<int>(i)));
    }
}

FrameSchema FrameSchema::of_known(int width, int height, const std::vector<std::string>& names) {
    std::vector<Channel> channels;
    for (const std::string& name : names) {
        const int planes = known_channel_planes(name);
        if (planes == 0) {
            std::string known;
            for (const auto& [k, n] : kKnownChannels)
                known += (known.empty() ? "" : ", ") + std::string(k);
            throw UsageError("unknown channel '" + name + "'; known are " + known);
        }
        channels.push_back({name, planes});
    }
    return FrameSchema(width, height, std::move(channels));
}

int FrameSchema::find(std::string_view name) const {
    for (size_t i = 0; i < channels_.size(); ++i)
        if (channels_[i].name == name) return static_cast<int>(i);
    return -1;
}

size_t FrameSchema::channel_byte_size(int index) const {
    return sizeof(float) * static_cast<size_t>(channels_[static_cast<size_t>(index)].planes) *
           static_cast<size_t>(width_) * static_cast<size_t>(height_);
}

View look_at(Vec3 eye, Vec3 target, Vec3 up, float fov_x_degrees) {
    Vec3 forward{target[0] - eye[0], target[1] - eye[1], target[2] - eye[2]};
    if (!(normalize(forward) > 0)) throw UsageError("look_at: eye and target are the same point");
    Vec3 left = cross(up, forward);
    if (!(normalize(left) > 1e-6f)) throw UsageError("look_at: up is parallel to the view axis");
    const Vec3 camera_up = cross(forward, left);
    View view;
    for (size_t row = 0; row < 3; ++row) {
        view.world_from_camera[4 * row + 0] = left[row];
        view.world_from_camera[4 * row + 1] = camera_up[row];
        view.world_from_camera[4 * row + 2] = forward[row];
        view.world_from_camera[4 * row + 3] = eye[row];
    }
    view.fov_x_degrees = fov_x_degrees;
    return view;
}

ArenaAllocator& host_memory() {
    static HostAllocator allocator;
    return allocator;
}

std::span<float> Frame::channel(std::string_view name) {
    const int index = slot_->schema.find(name);
    if (index < 0)
        throw UsageError("frame has no channel '" + std::string(name) + "'; it has " +
                         list_names(slot_->schema.channels()));
    return {reinterpret_cast<float*>(slot_->data + slot_->schema.channel_byte_offset(index)),
            slot_->schema.channel_byte_size(index) / sizeof(float)};
}

std::span<const float> Frame::channel(std::string_view name) const {
    return const_cast<Frame*>(this)->channel(name);
}

Frame make_frame(const FrameSchema& schema, ArenaAllocator& allocator) {
    auto slot = std::make_shared<Slot>();
    slot->schema = schema;
    slot->arena = allocator.allocate_arena(schema.slot_byte_size(), 1);
    slot->data = slot->arena->data();
    return Frame(std::move(slot));
}

}  // namespace pave
