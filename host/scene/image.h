// Image files as texels: PNG, JPEG and OpenEXR.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <stdexcept>
#include <string_view>

#include "pave/scene.h"

namespace pave {

/// What can be wrong inside an image file; the caller adds the file's name.
struct ImageError : std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// The image in `bytes`, whose kind its first bytes tell. PNG and JPEG give sRGB bytes (grey is
/// repeated, alpha dropped, 16 bits rounded to 8), EXR linear floats of the channels R, G, B or Y.
/// Throws ImageError for what is cut, damaged, of another kind or beyond 16384 pixels a side.
Image decode_image(std::string_view bytes);

}  // namespace pave
