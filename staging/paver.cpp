// The papers' facade over a stage that is made when the first frame tells its schema.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/paver.h"

#include <algorithm>
#include <cstdio>
#include <exception>
#include <optional>
#include <utility>

#include "pave/version.h"
#include "staging/uri.h"

namespace pave {
namespace {

std::string to_uri(const std::string& name) {
    if (is_valid_name(name)) return "bp:" + name + ".bp";
    if (name.find(':') == std::string::npos)
        throw UsageError("'" + name +
                         "' is not a data set name: use [A-Za-z0-9._-], 1 to 128 characters, no "
                         "leading dot, no path; a path goes as bp:PATH or exr:DIR");
    return parse_uri(name).text();
}

/// Pixel after pixel to plane after plane.
void to_planes(const std::vector<float>& values, int planes, std::span<float> out) {
    const auto count = static_cast<size_t>(planes);
    const size_t pixels = values.size() / count;
    for (size_t plane = 0; plane < count; ++plane)
        for (size_t i = 0; i < pixels; ++i) out[plane * pixels + i] = values[i * count + plane];
}

}  // namespace

class Paver::Impl {
   public:
    Impl(const std::string& name, StageOptions options)
        : uri_(to_uri(name)), options_(std::move(options)) {}

    void save(const std::string& name, int width, int height, const std::vector<float>& values) {
        const int planes = check_size(name, width, height, values.size());
        check_fits(name, width, height, planes);
        if (has(name)) end_frame();
        if (!stage_) {
            options_.width = width;
            options_.height = height;
            channels_.push_back({name, planes});
            first_.push_back(values);
        } else {
            if (!frame_) frame_ = stage_->acquire();
            to_planes(values, planes, frame_.channel(name));
        }
        saved_.push_back(name);
    }
    void flush() {
        end_frame();
        if (stage_) stage_->flush();
    }
    void close() {
        end_frame();
        if (stage_) stage_->close();
    }

    const int exceptions_at_start = std::uncaught_exceptions();

   private:
    bool has(const std::string& name) const {
        return std::find(saved_.begin(), saved_.end(), name) != saved_.end();
    }

    int check_size(const std::string& name, int width, int height, size_t count) const {
        const FrameSchema size(width, height, {{name, 1}});  // refuses names and sizes out of range
        const size_t pixels = size.channel_byte_size(0) / sizeof(float);
        if (count == 0 || count % pixels != 0 || count / pixels > 64)
            throw UsageError("'" + name + "' has " + std::to_string(count) +
                             " values, not 1 to 64 times " + std::to_string(width) + "x" +
                             std::to_string(height));
        return static_cast<int>(count / pixels);
    }

    /// Every frame has the names and sizes of the first.
    void check_fits(const std::string& name, int width, int height, int planes) const {
        if (channels_.empty()) return;
        if (width != options_.width || height != options_.height)
            throw UsageError("'" + name + "' is " + std::to_string(width) + "x" +
                             std::to_string(height) + ", the data set is " +
                             std::to_string(options_.width) + "x" +
                             std::to_string(options_.height));
        const auto known = std::find_if(channels_.begin(), channels_.end(),
                                        [&](const Channel& c) { return c.name == name; });
        if (known == channels_.end()) {
            if (!stage_) return;
            throw UsageError("'" + name + "' was not in the first frame, which had " +
                             list_names());
        }
        if (planes != known->planes)
            throw UsageError("'" + name + "' has " + std::to_string(planes) +
                             " planes, before it had " + std::to_string(known->planes));
    }
    std::string list_names() const {
        std::string names;
        for (const Channel& channel : channels_)
            names += (names.empty() ? "" : ", ") + channel.name;
        return names;
    }

    void end_frame() {
        if (saved_.empty()) return;
        for (const Channel& channel : channels_)
            if (!has(channel.name))
                throw UsageError("the frame is not complete: '" + channel.name + "' was not saved");
        if (!stage_) {
            options_.custom_channels = channels_;
            stage_.emplace(uri_, options_);
        }
        if (!frame_) frame_ = stage_->acquire();
        for (size_t i = 0; i < first_.size(); ++i)
            to_planes(first_[i], channels_[i].planes, frame_.channel(channels_[i].name));
        frame_.metadata().program_version = program_version();
        frame_.metadata().program_commit = program_commit();
        stage_->publish(std::exchange(frame_, {}));
        first_.clear();
        saved_.clear();
    }

    const std::string uri_;
    StageOptions options_;
    std::vector<Channel> channels_;          // of every frame, in the order of the first
    std::vector<std::vector<float>> first_;  // the first frame's values, until there is a stage
    std::vector<std::string> saved_;         // names of the current frame
    Frame frame_;
    std::optional<Stage> stage_;
};

Paver::Paver(const std::string& name, StageOptions options)
    : impl_(std::make_unique<Impl>(name, std::move(options))) {}

Paver::~Paver() {
    // While an exception unwinds the stack the data set stays open: its stage sees to that.
    if (!impl_ || std::uncaught_exceptions() > impl_->exceptions_at_start) return;
    try {
        impl_->close();
    } catch (const std::exception& error) {
        std::fprintf(stderr, "pave: %s\n", error.what());
    }
}
Paver::Paver(Paver&&) noexcept = default;
Paver& Paver::operator=(Paver&& other) noexcept {
    if (this != &other) {
        const Paver closing(std::move(*this));  // its destructor closes and logs
        impl_ = std::move(other.impl_);
    }
    return *this;
}

void Paver::save_floats(const std::string& variable, int width, int height,
                        const std::vector<float>& values) {
    impl_->save(variable, width, height, values);
}
void Paver::flush() { impl_->flush(); }
void Paver::close() { impl_->close(); }

}  // namespace pave
