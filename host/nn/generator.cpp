// The trained generator inside the renderer: loads a run, draws frames.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/generator.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "host/nn/network.h"
#include "host/nn/run_folder.h"

namespace pave {
namespace {

/// f(peak) of the transfer "srgb_log", which radiance is divided by; see kernels/nn_frame.cl.
float encoded_peak(float peak) { return 1.0f + 1.055f / 2.4f * std::log(std::max(peak, 1.0f)); }

int rounded_up(int size, int multiple) { return (size + multiple - 1) / multiple * multiple; }

size_t groups_of(int width, int lanes) { return static_cast<size_t>((width + lanes - 1) / lanes); }

/// (C, H, W) with each plane grown to the padded size by replication at the right and the bottom.
std::vector<float> pad(std::span<const float> planes, int width, int height, int padded_width,
                       int padded_height) {
    const size_t plane_size = static_cast<size_t>(width) * static_cast<size_t>(height);
    std::vector<float> padded;
    padded.reserve(planes.size() / plane_size * static_cast<size_t>(padded_width) *
                   static_cast<size_t>(padded_height));
    for (size_t plane = 0; plane < planes.size(); plane += plane_size)
        for (int y = 0; y < padded_height; ++y)
            for (int x = 0; x < padded_width; ++x)
                padded.push_back(planes[plane +
                                        static_cast<size_t>(std::min(y, height - 1)) *
                                            static_cast<size_t>(width) +
                                        static_cast<size_t>(std::min(x, width - 1))]);
    return padded;
}

std::vector<float> crop(const std::vector<float>& planes, int padded_width, int padded_height,
                        int width, int height) {
    const size_t plane_size =
        static_cast<size_t>(padded_width) * static_cast<size_t>(padded_height);
    std::vector<float> cropped;
    for (size_t plane = 0; plane < planes.size(); plane += plane_size)
        for (int y = 0; y < height; ++y) {
            const auto row = planes.begin() + static_cast<std::ptrdiff_t>(
                                                  plane + static_cast<size_t>(y) *
                                                              static_cast<size_t>(padded_width));
            cropped.insert(cropped.end(), row, row + width);
        }
    return cropped;
}

}  // namespace

class Generator::Impl {
   public:
    Impl(const Device& device, nn::Run run)
        : device_(device),
          schema_(std::move(run.schema)),
          weights_version_(std::move(run.weights_version)),
          network_(device, std::move(schema_.graph), {nn::conv_policy(), 0}) {
        for (const nn::InputChannel& input : schema_.inputs) inputs_.push_back(input.channel);
    }

    void draw(Frame& frame);
    std::vector<float> run(std::span<const float> input, int width, int height,
                           std::map<std::string, std::vector<float>>* layers);

    Device device_;
    nn::Schema schema_;
    std::string weights_version_;
    std::vector<std::string> inputs_;
    nn::Network network_;

    int padded(int size) const { return rounded_up(size, schema_.multiple); }

   private:
    std::string output_channel(const Frame& frame) const;
    void check_inputs(const Frame& frame) const;
    cl::Buffer upload(const Frame& frame) const;
    void encode(const FrameSchema& frame, const cl::Buffer& slot);
    void decode(const FrameSchema& frame, const cl::Buffer& slot, int channel);
};

/// Kernels count a slot's floats in int.
void check_slot_size(const FrameSchema& schema) {
    if (schema.slot_byte_size() / sizeof(float) <=
        static_cast<size_t>(std::numeric_limits<int>::max()))
        return;
    throw UsageError("a frame of " + std::to_string(schema.width()) + " x " +
                     std::to_string(schema.height()) + " with these channels has " +
                     std::to_string(schema.slot_byte_size() >> 20) +
                     " MiB, at most 8191 can be drawn into; use fewer channels or smaller frames");
}

void Generator::Impl::check_inputs(const Frame& frame) const {
    check_slot_size(frame.schema());
    for (const nn::InputChannel& input : schema_.inputs) {
        const int index = frame.schema().find(input.channel);
        if (index < 0) throw UsageError("missing input: " + input.channel);
        const int planes = frame.schema().channels()[static_cast<size_t>(index)].planes;
        if (planes != input.planes)
            throw UsageError("input " + input.channel + " has " + std::to_string(planes) +
                             " planes in the frame, the network was trained on " +
                             std::to_string(input.planes));
    }
}

std::string Generator::Impl::output_channel(const Frame& frame) const {
    const std::string name = frame.has("drawn") ? "drawn" : "color";
    const int index = frame.schema().find(name);
    if (index < 0)
        throw UsageError("the frame has neither a channel 'drawn' nor 'color' to draw into");
    const int planes = frame.schema().channels()[static_cast<size_t>(index)].planes;
    const int drawn = network_.graph().output_channels;
    if (planes != drawn)
        throw UsageError("channel " + name + " has " + std::to_string(planes) +
                         " planes, the network draws " + std::to_string(drawn));
    return name;
}

/// A buffer laid out like the slot, with the network's inputs in it: for frames of other memory.
cl::Buffer Generator::Impl::upload(const Frame& frame) const {
    const cl::Buffer slot =
        make_buffer(device_, frame.schema().slot_byte_size(), "a copy of the frame");
    std::vector<cl::Event> events;
    for (const nn::InputChannel& input : schema_.inputs) {
        const std::span<const float> planes = frame.channel(input.channel);
        const size_t offset =
            frame.schema().channel_byte_offset(frame.schema().find(input.channel));
        cl::Event event;
        cl_guard(input.channel, [&] {
            queue_of(device_).enqueueWriteBuffer(slot, CL_FALSE, offset, planes.size_bytes(),
                                                 planes.data(), nullptr, &event);
        });
        events.push_back(event);
    }
    for (const cl::Event& event : events) wait(event, "copying the frame to the device");
    return slot;
}

void Generator::Impl::encode(const FrameSchema& frame, const cl::Buffer& slot) {
    const nn::View& input = network_.input();
    const int lanes = network_.runtime().lanes();
    int channel = 0;
    for (const nn::InputChannel& source : schema_.inputs) {
        NnEncode s{};
        s.src_first =
            static_cast<int>(frame.channel_byte_offset(frame.find(source.channel)) / sizeof(float));
        s.width = frame.width();
        s.height = frame.height();
        s.planes = source.planes;
        s.repeat = source.repeat;
        s.dst_first = input.first + channel;
        s.dst_step = input.step;
        s.padded_width = input.width;
        s.padded_height = input.height;
        std::copy(source.center.begin(), source.center.end(), s.center);
        switch (source.encode) {
            case nn::Encode::kUnit:
            case nn::Encode::kSigned:
                s.encode = NN_ENCODE_COPY;
                break;
            case nn::Encode::kRadiance:
                s.encode = NN_ENCODE_RADIANCE;
                s.scale = 1.0f / encoded_peak(schema_.peak);
                break;
            case nn::Encode::kDepth:
                s.encode = NN_ENCODE_DEPTH;
                s.scale = source.scale;
                break;
            case nn::Encode::kPosition:
                s.encode = NN_ENCODE_POSITION;
                s.scale = 1.0f / source.radius;
                break;
        }
        launch(device_, network_.runtime().encode(),
               cl::NDRange(groups_of(input.width, lanes), static_cast<size_t>(input.height),
                           static_cast<size_t>(source.planes)),
               network_.runtime().local(), s, slot, network_.arena());
        channel += source.planes * source.repeat;
    }
}

void Generator::Impl::decode(const FrameSchema& frame, const cl::Buffer& slot, int channel) {
    const nn::View& result = network_.result();
    NnDecode s{};
    s.src_first = result.first;
    s.src_step = result.step;
    s.padded_width = result.width;
    s.dst_first = static_cast<int>(frame.channel_byte_offset(channel) / sizeof(float));
    s.width = frame.width();
    s.height = frame.height();
    s.planes = result.channels;
    s.encoded_peak = encoded_peak(schema_.peak);
    launch(device_, network_.runtime().decode(),
           cl::NDRange(groups_of(s.width, network_.runtime().lanes()),
                       static_cast<size_t>(s.height), static_cast<size_t>(s.planes)),
           network_.runtime().local(), s, network_.arena(), slot);
}

void Generator::Impl::draw(Frame& frame) {
    check_inputs(frame);
    const std::string output = output_channel(frame);
    const FrameSchema& schema = frame.schema();
    network_.prepare(padded(schema.width()), padded(schema.height()), false);
    cl::Buffer slot = slot_buffer_of(device_, frame);
    const bool foreign = slot() == nullptr;
    if (foreign)
        slot = upload(frame);
    else
        slot_to_device(device_, frame);
    encode(schema, slot);
    network_.enqueue();
    decode(schema, slot, schema.find(output));
    if (foreign) {
        const std::span<float> planes = frame.channel(output);
        cl::Event event;
        cl_guard(output, [&] {
            queue_of(device_).enqueueReadBuffer(
                slot, CL_FALSE, schema.channel_byte_offset(schema.find(output)),
                planes.size_bytes(), planes.data(), nullptr, &event);
        });
        wait(event, "drawing a frame");
    } else {
        slot_to_host(device_, frame);
        finish(device_, "drawing a frame");
    }
    frame.metadata().weights_version = weights_version_;
}

std::vector<float> Generator::Impl::run(std::span<const float> input, int width, int height,
                                        std::map<std::string, std::vector<float>>* layers) {
    constexpr int kMaxSize = 16384;
    if (width < 1 || height < 1 || width > kMaxSize || height > kMaxSize)
        throw UsageError("an image of " + std::to_string(width) + " x " + std::to_string(height) +
                         ": sizes are 1 to 16384");
    const size_t expected = static_cast<size_t>(network_.graph().input_channels) *
                            static_cast<size_t>(width) * static_cast<size_t>(height);
    if (input.size() != expected)
        throw UsageError("the input has " + std::to_string(input.size()) +
                         " values, the network takes " +
                         std::to_string(network_.graph().input_channels) + " planes of " +
                         std::to_string(width) + " x " + std::to_string(height));
    const int padded_width = padded(width), padded_height = padded(height);
    network_.prepare(padded_width, padded_height, layers != nullptr);
    network_.write_input(pad(input, width, height, padded_width, padded_height));
    if (layers == nullptr) {
        network_.enqueue();
    } else {
        layers->clear();
        network_.enqueue([&](int value) {
            (*layers)[network_.graph().nodes[static_cast<size_t>(value)].name] =
                network_.read(value);
        });
    }
    return crop(network_.read(network_.graph().result), padded_width, padded_height, width, height);
}

Generator::Generator(const Device& device, const std::string& run_folder)
    : impl_(std::make_unique<Impl>(device, nn::load_run(run_folder))) {}
Generator::~Generator() = default;
Generator::Generator(Generator&&) noexcept = default;
Generator& Generator::operator=(Generator&&) noexcept = default;

const std::vector<std::string>& Generator::inputs() const { return impl_->inputs_; }
const std::string& Generator::weights_version() const { return impl_->weights_version_; }
void Generator::draw(Frame& frame) { impl_->draw(frame); }

std::vector<float> Generator::run(std::span<const float> input, int width, int height,
                                  std::map<std::string, std::vector<float>>* layers) {
    return impl_->run(input, width, height, layers);
}

size_t Generator::planned_byte_size(int width, int height, size_t* unplanned) const {
    return impl_->network_.planned_byte_size(impl_->padded(width), impl_->padded(height),
                                             unplanned);
}

}  // namespace pave
