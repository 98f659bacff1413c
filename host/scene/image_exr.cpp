// OpenEXR images, decoded in a process of its own: the library has open faults, and images come
// from anywhere.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/image_exr.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputFile.h>

#include <cstring>

#include "host/scene/isolate.h"

namespace pave {
namespace {

class Memory : public Imf::IStream {
   public:
    explicit Memory(std::string_view bytes) : Imf::IStream("image"), bytes_(bytes) {}

    bool isMemoryMapped() const override { return false; }
    bool read(char* to, int count) override {
        if (count < 0 || static_cast<size_t>(count) > bytes_.size() - at_)
            throw ImageError("the file ends early");
        std::memcpy(to, bytes_.data() + at_, static_cast<size_t>(count));
        at_ += static_cast<size_t>(count);
        return at_ < bytes_.size();
    }
    uint64_t tellg() override { return at_; }
    void seekg(uint64_t position) override {
        if (position > bytes_.size()) throw ImageError("the file ends early");
        at_ = static_cast<size_t>(position);
    }

   private:
    std::string_view bytes_;
    size_t at_ = 0;
};

/// Width and height as two int32, then three floats a pixel.
std::string read_pixels(std::string_view bytes, int max_side) {
    Memory memory(bytes);
    Imf::InputFile file(memory, 0);
    const Imath::Box2i box = file.header().dataWindow();
    const int64_t width = int64_t{box.max.x} - box.min.x + 1,
                  height = int64_t{box.max.y} - box.min.y + 1;
    if (width < 1 || height < 1 || width > max_side || height > max_side)
        throw ImageError("the image is " + std::to_string(width) + " x " + std::to_string(height) +
                         " pixels, each side must be in 1.." + std::to_string(max_side));
    const Imf::ChannelList& channels = file.header().channels();
    const bool is_grey =
        channels.findChannel("Y") != nullptr && channels.findChannel("R") == nullptr;
    std::string result(8 + static_cast<size_t>(width * height) * 12, '\0');
    const int32_t size[2] = {static_cast<int32_t>(width), static_cast<int32_t>(height)};
    std::memcpy(result.data(), size, 8);
    const auto row_stride = static_cast<size_t>(width) * 12;
    const char* names[] = {"R", "G", "B"};
    Imf::FrameBuffer target;
    for (int c = 0; c < 3; ++c) {
        const char* name = is_grey ? "Y" : names[c];
        const Imf::Channel* channel = channels.findChannel(name);
        if (channel == nullptr) throw ImageError(std::string("has no channel ") + name);
        if (channel->xSampling != 1 || channel->ySampling != 1)
            throw ImageError("has subsampled channels");
        char* base = result.data() + 8 + 4 * c - static_cast<int64_t>(box.min.x) * 12 -
                     static_cast<int64_t>(box.min.y) * static_cast<int64_t>(row_stride);
        if (!is_grey || c == 0) target.insert(name, Imf::Slice(Imf::FLOAT, base, 12, row_stride));
    }
    file.setFrameBuffer(target);
    file.readPixels(box.min.y, box.max.y);
    if (is_grey)
        for (size_t at = 8; at < result.size(); at += 12) {
            std::memcpy(&result[at + 4], &result[at], 4);
            std::memcpy(&result[at + 8], &result[at], 4);
        }
    return result;
}

}  // namespace

Image decode_exr(std::string_view bytes, int max_side) {
    std::string result;
    try {
        result = run_isolated([&] { return read_pixels(bytes, max_side); });
    } catch (const IsolationError& error) {
        throw ImageError(std::string("not a sound OpenEXR image: ") + error.what());
    }
    int32_t size[2];
    if (result.size() < 8) throw ImageError("not a sound OpenEXR image");
    std::memcpy(size, result.data(), 8);
    Image image{.width = size[0], .height = size[1]};
    image.floats.resize((result.size() - 8) / sizeof(float));
    std::memcpy(image.floats.data(), result.data() + 8, image.floats.size() * sizeof(float));
    if (image.floats.size() !=
        size_t{3} * static_cast<size_t>(size[0]) * static_cast<size_t>(size[1]))
        throw ImageError("not a sound OpenEXR image");
    return image;
}

}  // namespace pave
