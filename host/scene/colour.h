// Colours of the scene file as linear BT.709, the way Mitsuba's RGB variants read them.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/scene/xml.h"

namespace pave {

/// What a colour is for: Mitsuba reads a constant <spectrum> of an emitter as equal-energy white,
/// that of a surface as grey.
enum class ColourUse { kReflectance, kRadiance, kIndexOfRefraction };

/// The element `name`: <rgb>, a constant <spectrum>, or a <float>. Reflectances must be in [0,1],
/// the others >= 0. Texture and wavelength tables are unsupported (`fallback` if that is to be
/// ignored).
Rgb read_colour(Properties& properties, const std::string& name, ColourUse use,
                const Rgb& fallback);

}  // namespace pave
