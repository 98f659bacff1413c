// Pixels of an OpenEXR file that nobody vouches for.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/scene/image.h"

namespace pave {

/// Linear floats of the channels R, G, B or Y of the first part. Throws ImageError.
Image decode_exr(std::string_view bytes, int max_side);

}  // namespace pave
