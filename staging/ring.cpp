// Slots that come back by themselves when their last frame goes.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/ring.h"

namespace pave {

Ring::Ring(ArenaAllocator& allocator, const FrameSchema& schema, int slots) {
    std::shared_ptr<Arena> arena = allocator.allocate_arena(schema.slot_byte_size(), slots);
    if (reinterpret_cast<uintptr_t>(arena->data()) % kChannelAlignment != 0)
        throw InternalError("an arena of frames is not aligned");
    slots_.resize(static_cast<size_t>(slots));
    states_.resize(slots_.size(), SlotState::kFree);
    for (int i = slots - 1; i >= 0; --i) {
        Slot& slot = slots_[static_cast<size_t>(i)];
        slot.schema = schema;
        slot.arena = arena;
        slot.index = i;
        slot.data = arena->data() + static_cast<size_t>(i) * schema.slot_byte_size();
        free_.push_back(i);
    }
}

Frame Ring::try_acquire() {
    int index = 0;
    {
        const std::lock_guard lock(mutex_);
        if (free_.empty()) return {};
        index = free_.back();
        free_.pop_back();
        states_[static_cast<size_t>(index)] = SlotState::kProducer;
    }
    Slot& slot = slots_[static_cast<size_t>(index)];
    slot.metadata = {};
    // The deleter keeps the ring, so that a frame may outlive its stage.
    return Frame(std::shared_ptr<Slot>(
        &slot, [ring = shared_from_this()](Slot* freed) { ring->give_back(freed->index); }));
}

void Ring::wait_for_free(Clock::time_point deadline) {
    std::unique_lock lock(mutex_);
    changed_.wait_until(lock, deadline, [&] { return !free_.empty() || woken_; });
    woken_ = false;
}

void Ring::wake() {
    const std::lock_guard lock(mutex_);
    woken_ = true;
    changed_.notify_all();
}

void Ring::give_back(int index) {
    const std::lock_guard lock(mutex_);
    states_[static_cast<size_t>(index)] = SlotState::kFree;
    free_.push_back(index);
    changed_.notify_all();
}

bool Ring::is_in(const Frame& frame, SlotState state) const {
    if (!frame) return false;
    const Slot* slot = frame.slot().get();
    if (slot < slots_.data() || slot >= slots_.data() + slots_.size()) return false;
    const std::lock_guard lock(mutex_);
    return states_[static_cast<size_t>(slot->index)] == state;
}

void Ring::set_state(const Frame& frame, SlotState state) {
    const std::lock_guard lock(mutex_);
    states_[static_cast<size_t>(frame.slot()->index)] = state;
}

int Ring::free_slots() const {
    const std::lock_guard lock(mutex_);
    return static_cast<int>(free_.size());
}

std::string Ring::describe(const std::string& sink) const {
    const std::lock_guard lock(mutex_);
    std::string text = "of " + std::to_string(slots_.size()) + " slots " +
                       std::to_string(free_.size()) + " are free";
    const auto append = [&](SlotState state, const std::string& who) {
        int count = 0;
        std::string frames;
        for (size_t i = 0; i < slots_.size(); ++i) {
            if (states_[i] != state) continue;
            // The producer may be writing its frame's metadata right now: they are not looked at.
            if (++count <= 8 && state != SlotState::kProducer)
                frames += (count > 1 ? ", " : "") + std::to_string(slots_[i].metadata.index);
        }
        if (count == 0) return;
        text += ", " + std::to_string(count) + " " + who;
        if (!frames.empty())
            text += (count > 1 ? " (frames " : " (frame ") + frames + (count > 8 ? ", ...)" : ")");
    };
    append(SlotState::kProducer, "with the producer");
    append(SlotState::kQueued, "waiting for " + sink);
    append(SlotState::kSink, "being taken by " + sink);
    append(SlotState::kShared, "held by readers");
    return text;
}

}  // namespace pave
