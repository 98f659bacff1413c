// What the ray queries of rays.cl take and give: one source for host and kernels.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "render_types.h"

#ifndef __OPENCL_VERSION__
namespace pave::kernel {
#endif

/// As pave::Ray.
PAVE_STRUCT(RayRecord) {
    float origin[3];
    float t_max;
    float direction[3];
    float spare;
};
PAVE_SIZEOF(RayRecord, 32);

/// As pave::Hit.
PAVE_STRUCT(HitRecord) {
    float t;
    int shape, part, primitive;
    float b1, b2;
};
PAVE_SIZEOF(HitRecord, 24);

/// Ids from `first_id` up to the next run's are primitives of `shape`, or of `part` of an instance,
/// counted from `first_primitive`. Runs are in order of their ids.
PAVE_STRUCT(IdRun) { int first_id, shape, part, first_primitive; };
PAVE_SIZEOF(IdRun, 16);

#ifndef __OPENCL_VERSION__
}  // namespace pave::kernel
#endif
