// What a program is specialised for. Everything is on by default: such a program renders any
// scene, only slower.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once
#include "lanes.h"

#ifndef PAVE_HAS_RECTS /* 0 or 1 each: kinds of shapes in the broadcast loops */
#define PAVE_HAS_RECTS 1
#endif
#ifndef PAVE_HAS_AXIS_RECTS /* rectangles across a coordinate axis, in loops of their own */
#define PAVE_HAS_AXIS_RECTS 0
#endif
#ifndef PAVE_HAS_DISKS
#define PAVE_HAS_DISKS 1
#endif
#ifndef PAVE_HAS_FLAT_TRIANGLES /* in the loops too; others are in the tree */
#define PAVE_HAS_FLAT_TRIANGLES 1
#endif
#ifndef PAVE_HAS_CUBES
#define PAVE_HAS_CUBES 1
#endif
#ifndef PAVE_HAS_AXIS_CUBES /* cubes with edges along a coordinate axis, in loops of their own */
#define PAVE_HAS_AXIS_CUBES 0
#endif
#ifndef PAVE_HAS_SPHERES
#define PAVE_HAS_SPHERES 1
#endif
#ifndef PAVE_HAS_TRIANGLES /* triangles, which are always in the tree */
#define PAVE_HAS_TRIANGLES 1
#endif
#ifndef PAVE_HAS_INSTANCES /* groups of triangles that transforms place; only beside triangles */
#define PAVE_HAS_INSTANCES 1
#endif
#ifndef PAVE_HAS_SMOOTH /* triangles with vertex normals */
#define PAVE_HAS_SMOOTH 1
#endif
#ifndef PAVE_TREE_SHAPES /* rectangles, disks, cubes and spheres are leaves of the tree, not \
                            broadcast */
#define PAVE_TREE_SHAPES 1
#endif
#ifndef PAVE_HAS_CONDUCTOR /* materials beside diffuse */
#define PAVE_HAS_CONDUCTOR 1
#endif
#ifndef PAVE_HAS_ROUGH
#define PAVE_HAS_ROUGH 1
#endif
#ifndef PAVE_HAS_ANISOTROPIC
#define PAVE_HAS_ANISOTROPIC 1
#endif
#ifndef PAVE_HAS_DIELECTRIC
#define PAVE_HAS_DIELECTRIC 1
#endif
#ifndef PAVE_HAS_PLASTIC
#define PAVE_HAS_PLASTIC 1
#endif
#ifndef PAVE_HAS_ROUGH_DIELECTRIC
#define PAVE_HAS_ROUGH_DIELECTRIC 1
#endif
#ifndef PAVE_HAS_TEXTURES /* colours that vary over a surface */
#define PAVE_HAS_TEXTURES 1
#endif
#ifndef PAVE_HAS_TWO_SIDED
#define PAVE_HAS_TWO_SIDED 1
#endif
#ifndef PAVE_HAS_QUAD_LIGHT /* kinds of lights */
#define PAVE_HAS_QUAD_LIGHT 1
#endif
#ifndef PAVE_HAS_TRIANGLE_LIGHT
#define PAVE_HAS_TRIANGLE_LIGHT 1
#endif
#ifndef PAVE_HAS_DISK_LIGHT
#define PAVE_HAS_DISK_LIGHT 1
#endif
#ifndef PAVE_HAS_SPHERE_LIGHT
#define PAVE_HAS_SPHERE_LIGHT 1
#endif
#ifndef PAVE_HAS_ENVIRONMENT
#define PAVE_HAS_ENVIRONMENT 1
#endif
#ifndef PAVE_HAS_ENVMAP /* the environment is an image */
#define PAVE_HAS_ENVMAP 1
#endif
#ifndef PAVE_HAS_POINT_LIGHT
#define PAVE_HAS_POINT_LIGHT 1
#endif
#ifndef PAVE_ONE_LIGHT /* the light table has one row, which is broadcast instead of gathered */
#define PAVE_ONE_LIGHT 0
#endif
#ifndef PAVE_FEW_SURFACES /* at most 32 */
#define PAVE_FEW_SURFACES 0
#endif
#ifndef PAVE_SOBOL /* 0 or 1: stratified numbers for the first dimensions, or all independent */
#define PAVE_SOBOL 1
#endif
#ifndef PAVE_STACK /* traversal stack, 8..1024; the host computes what a tree needs */
#define PAVE_STACK 128
#endif
#ifndef PAVE_TREE_TURNS /* 0 or 1: rays take turns in the tree, which is larger than the caches */
#define PAVE_TREE_TURNS 0
#endif
#ifndef PAVE_SEGMENT /* most pixels a work-item renders, 1..256; 1 keeps their sums in registers \
                      */
#define PAVE_SEGMENT 64
#endif
#if PAVE_TREE_SHAPES
typedef float ShapeFloat;
typedef uint ShapeWord;
#else
typedef vfloat ShapeFloat;
typedef vuint ShapeWord;
#endif
#include "render_types.h"

#ifndef PAVE_CHANNELS /* bit set of channels to write */
#define PAVE_CHANNELS ((1 << CHANNEL_COUNT) - 1)
#endif

#define PAVE_HAS_SHAPES                                                                    \
    (PAVE_HAS_AXIS_RECTS || PAVE_HAS_RECTS || PAVE_HAS_FLAT_TRIANGLES || PAVE_HAS_DISKS || \
     PAVE_HAS_AXIS_CUBES || PAVE_HAS_CUBES || PAVE_HAS_SPHERES)
#define SURFACES_IN_REGISTERS (PAVE_FEW_SURFACES && PAVE_BUILTINS)
#define PAVE_HAS_TREE (PAVE_HAS_TRIANGLES || PAVE_TREE_SHAPES)
#define PAVE_HAS_REFRACTION (PAVE_HAS_DIELECTRIC || PAVE_HAS_ROUGH_DIELECTRIC)
#define PAVE_HAS_SPECULAR (PAVE_HAS_CONDUCTOR || PAVE_HAS_DIELECTRIC)
#define PAVE_HAS_MATERIALS /* beside diffuse */ \
    (PAVE_HAS_SPECULAR || PAVE_HAS_ROUGH || PAVE_HAS_PLASTIC || PAVE_HAS_ROUGH_DIELECTRIC)
#define PAVE_HAS_AREA_LIGHT \
    (PAVE_HAS_QUAD_LIGHT || PAVE_HAS_TRIANGLE_LIGHT || PAVE_HAS_DISK_LIGHT || PAVE_HAS_SPHERE_LIGHT)
#define PAVE_HAS_LIGHTS (PAVE_HAS_AREA_LIGHT || PAVE_HAS_ENVIRONMENT || PAVE_HAS_POINT_LIGHT)

#define HAS_COLOR ((PAVE_CHANNELS >> CHANNEL_COLOR) & 1)
#define HAS_ALBEDO ((PAVE_CHANNELS >> CHANNEL_ALBEDO) & 1)
#define HAS_DIRECT ((PAVE_CHANNELS >> CHANNEL_DIRECT) & 1)
#define HAS_NORMAL ((PAVE_CHANNELS >> CHANNEL_NORMAL) & 1)
#define HAS_DEPTH ((PAVE_CHANNELS >> CHANNEL_DEPTH) & 1)
#define HAS_DISTANCE ((PAVE_CHANNELS >> CHANNEL_DISTANCE) & 1)
#define HAS_VARIANCE ((PAVE_CHANNELS >> CHANNEL_VARIANCE) & 1)
#define HAS_POSITION ((PAVE_CHANNELS >> CHANNEL_POSITION) & 1)
#define HAS_OBJECT ((PAVE_CHANNELS >> CHANNEL_OBJECT) & 1)
#define HAS_RADIANCE (HAS_COLOR || HAS_VARIANCE)
