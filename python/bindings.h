// What the files of the Python module share: one function a room of the library, and the array
// that views a slot.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstddef>
#include <vector>

#include "pave/frame.h"

namespace pave::python {

namespace nb = nanobind;

/// A writable numpy array of float32 in row-major order. Every one names its owner.
using FloatArray = nb::ndarray<nb::numpy, float>;

/// `planes` planes of `frame` from `byte_offset` on, as (planes, height, width), with no copy. The
/// array's owner is a handle on the frame of its own: the slot is not reused while the array, a
/// view of it, or a tensor made from it lives.
FloatArray view_of_planes(const Frame& frame, size_t byte_offset, size_t planes);

/// `values` as an array that owns them.
FloatArray array_of(std::vector<float> values, std::vector<size_t> shape);

void bind_frames(nb::module_& module);
void bind_device(nb::module_& module);
void bind_staging(nb::module_& module);
void bind_rendering(nb::module_& module);
void bind_rays(nb::module_& module);

}  // namespace pave::python
