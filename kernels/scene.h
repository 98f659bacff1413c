// Everything a scene is on the device, and how its parts are found.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "features.h"
#include "vec3.h"

#if PAVE_BUILTINS && PAVE_SOBOL
#define SOBOL_PARTS 3
/// What bits 0 to 3, 4 to 7 and 8 to 9 of a sample's number contribute to the Sobol table; row
/// 2 * bits + vertex.
typedef struct {
    FewRows part[SOBOL_PARTS];
} SobolParts;
#endif

typedef struct {
    __constant const PathParams* p;
    __global const float8* shapes;
    __global const float8* tree;
    __global const float8* tables;
    __global const uint* light_cdf;
#if SURFACES_IN_REGISTERS
    const FewRows* surfaces;
#endif
#if PAVE_BUILTINS && PAVE_SOBOL
    const SobolParts* sobol;
#endif
} Scene;

static inline __global const FlatShape* flat_shapes(const Scene* s, int kind) {
    __global const FlatShape* first = (__global const FlatShape*)(s->shapes + s->p->flat_row);
    for (int before = 0; before < kind; ++before) first += s->p->flat_count[before];
    return first;
}
static inline __global const AxisRect* axis_rects(const Scene* s) {
    return (__global const AxisRect*)(s->shapes + s->p->axis_rect_row);
}
static inline __global const AxisCube* axis_cubes(const Scene* s) {
    return (__global const AxisCube*)(s->shapes + s->p->axis_cube_row);
}
static inline __global const CubeShape* cube_shapes(const Scene* s) {
    return (__global const CubeShape*)(s->shapes + s->p->cube_row);
}
static inline __global const SphereShape* sphere_shapes(const Scene* s) {
    return (__global const SphereShape*)(s->shapes + s->p->sphere_row);
}

/// First row of surface `index` for every lane.
static inline Row surface_row(const Scene* s, vint index) {
#if SURFACES_IN_REGISTERS
    return pick_row(s->surfaces, index);
#else
    return gather_row(s->tables + s->p->surface_row, index * SURFACE_ROWS);
#endif
}
