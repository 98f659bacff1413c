// Image files as texels. PNG and JPEG by libpng and libjpeg-turbo; EXR, whose library has open
// faults, in a process of its own.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/image.h"

#include <png.h>

#include <csetjmp>
#include <cstdio>
// libjpeg's header needs FILE and size_t from above.
#include <jpeglib.h>

#include "host/scene/image_exr.h"

namespace pave {
namespace {

constexpr int kMaxSide = 16384;

void check_size(int64_t width, int64_t height) {
    if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide)
        throw ImageError("the image is " + std::to_string(width) + " x " + std::to_string(height) +
                         " pixels, each side must be in 1..16384");
}

Image decode_png(std::string_view bytes) {
    png_image png{};
    png.version = PNG_IMAGE_VERSION;
    const auto fail = [&] {
        const std::string reason = png.message;
        png_image_free(&png);
        throw ImageError("not a sound PNG: " + reason);
    };
    if (png_image_begin_read_from_memory(&png, bytes.data(), bytes.size()) == 0) fail();
    if (png.width > kMaxSide || png.height > kMaxSide) {
        png_image_free(&png);
        check_size(png.width, png.height);
    }
    png.format = PNG_FORMAT_RGBA;
    png.flags |= PNG_IMAGE_FLAG_16BIT_sRGB;
    Image image{.width = static_cast<int>(png.width), .height = static_cast<int>(png.height)};
    image.bytes.resize(size_t{4} * png.width * png.height);
    if (png_image_finish_read(&png, nullptr, image.bytes.data(), 0, nullptr) == 0) fail();
    return image;
}

struct JpegError {
    jpeg_error_mgr base;
    std::jmp_buf jump;
    char message[JMSG_LENGTH_MAX];
};

[[noreturn]] void leave_jpeg(j_common_ptr info) {
    auto* error = reinterpret_cast<JpegError*>(info->err);
    info->err->format_message(info, error->message);
    std::longjmp(error->jump, 1);
}

/// A JPEG being read. Everything that a longjmp passes over lies in here or in C.
struct JpegReader {
    jpeg_decompress_struct info{};
    JpegError error{};

    explicit JpegReader(std::string_view bytes) {
        info.err = jpeg_std_error(&error.base);
        error.base.error_exit = leave_jpeg;
        // A damaged file is a warning to libjpeg, which fills in grey.
        error.base.emit_message = [](j_common_ptr common, int level) {
            if (level < 0) leave_jpeg(common);
        };
        jpeg_create_decompress(&info);
        jpeg_mem_src(&info, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
    }
    ~JpegReader() { jpeg_destroy_decompress(&info); }
    JpegReader(const JpegReader&) = delete;
    JpegReader& operator=(const JpegReader&) = delete;

    bool read_header() {
        if (setjmp(error.jump) != 0) return false;
        jpeg_read_header(&info, TRUE);
        info.out_color_space = JCS_EXT_RGBX;
        return true;
    }
    bool read_rows(uint8_t* pixels) {
        if (setjmp(error.jump) != 0) return false;
        jpeg_start_decompress(&info);
        while (info.output_scanline < info.output_height) {
            JSAMPROW row = pixels + size_t{4} * info.output_width * info.output_scanline;
            jpeg_read_scanlines(&info, &row, 1);
        }
        jpeg_finish_decompress(&info);
        return true;
    }
};

Image decode_jpeg(std::string_view bytes) {
    JpegReader reader(bytes);
    const auto fail = [&] {
        throw ImageError("not a sound JPEG: " + std::string(reader.error.message));
    };
    if (!reader.read_header()) fail();
    check_size(reader.info.image_width, reader.info.image_height);
    Image image{.width = static_cast<int>(reader.info.image_width),
                .height = static_cast<int>(reader.info.image_height)};
    image.bytes.resize(size_t{4} * reader.info.image_width * reader.info.image_height);
    if (!reader.read_rows(image.bytes.data())) fail();
    return image;
}

}  // namespace

Image decode_image(std::string_view bytes) {
    if (bytes.starts_with("\x89PNG")) return decode_png(bytes);
    if (bytes.starts_with("\xff\xd8\xff")) return decode_jpeg(bytes);
    if (bytes.starts_with("\x76\x2f\x31\x01")) {
        Image image = decode_exr(bytes, kMaxSide);
        check_size(image.width, image.height);
        return image;
    }
    throw ImageError("neither PNG, JPEG nor OpenEXR");
}

}  // namespace pave
