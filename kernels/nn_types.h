// Parameter blocks of the network's kernels, read by both compilers: 32-bit fields only.
// SPDX-License-Identifier: BSD-3-Clause
#ifndef PAVE_NN_TYPES_H
#define PAVE_NN_TYPES_H

/* Activations of NnRows, NnConv and NnScatter. relu is leaky with slope 0. */
#define NN_ACT_NONE 0
#define NN_ACT_LEAKY 1
#define NN_ACT_SIGMOID 2
#define NN_ACT_TANH 3

/* Operations of NnRows: src; (src - parameters[0]) * parameters[1] + parameters[2] a channel; src
 * with other. */
#define NN_ROWS_COPY 0
#define NN_ROWS_AFFINE 1
#define NN_ROWS_ADD 2
#define NN_ROWS_MUL 3
#define NN_ROWS_UPSAMPLE 4

/* Encodings of NnEncode. */
#define NN_ENCODE_COPY 0
#define NN_ENCODE_RADIANCE 1
#define NN_ENCODE_DEPTH 2
#define NN_ENCODE_POSITION 3

/* A tensor is (height, width, channels) with the channels of a pixel side by side; "first" is the
   float in the arena at which it starts and "step" the floats from a pixel to the next (more than
   its channels when it is part of a wider one). */

/* Element by element over `pixels` x `channels` of the output. */
typedef struct {
    int op;
    int src_first, src_step;
    int other_first, other_step;
    int dst_first, dst_step;
    int pixels, channels;
    int pixels_per_item, channels_per_item;
    int activation;
    float slope;
    int scale, width; /* upsample: factor, and width of the output */
} NnRows;

/* Convolution over a grid of output pixels; see NnPhase. */
typedef struct {
    int src_first, src_step, src_width, src_height;
    int dst_first, dst_step, dst_width;
    int in_step, out_step; /* grid pixel (x, y) reads around (x, y) * in_step and writes (x, y) *
                              out_step + phase's out */
    int in_channels, out_channels;
    int tiles_per_item;
    int zeros_first; /* floats into the weights: in_channels zeros, read outside of the image */
    int activation;
    float slope;
} NnConv;

/* The outputs of a convolution that share their taps: one phase for a convolution, stride^2 for a
 * transposed one. */
typedef struct {
    int grid_width, grid_height;
    int out_x, out_y;
    int tap_first, taps; /* into the list of (dx, dy) */
    int weight_first;    /* floats */
    int unused;
} NnPhase;

/* im2col of grid pixels [pixel_first, pixel_first + pixels) of a phase: rows of taps * in_channels
 * floats. */
typedef struct {
    int src_first, src_step, src_width, src_height;
    int grid_width, in_step;
    int pixel_first, pixels;
    int tap_first, taps;
    int in_channels, channels_per_item;
} NnColumns;

/* Dense rows of out_channels floats, for the same pixels, to where they belong, plus bias and
 * activation. */
typedef struct {
    int dst_first, dst_step, dst_width;
    int grid_width, out_step, out_x, out_y;
    int pixel_first, pixels;
    int out_channels, channels_per_item;
    int activation;
    float slope;
} NnScatter;

/* Mean and squared deviations of each channel over chunks of pixels. */
typedef struct {
    int src_first, src_step;
    int pixels, channels;
    int pixels_per_chunk, chunks;
    float eps;
} NnMoments;

/* One channel of a frame to planes of the network's input. Planes are padded by replication at the
 * right and the bottom. */
typedef struct {
    int src_first; /* floats into the slot */
    int width, height;
    int planes, repeat;
    int dst_first, dst_step, padded_width, padded_height;
    int encode;
    float scale; /* depth: scale / (scale + d); radiance: 1 / f(peak); position: 1 / radius */
    float center[3];
} NnEncode;

/* The network's result to a channel of a frame; encoded_peak = f(peak), 0 leaves the values
 * alone. */
typedef struct {
    int src_first, src_step, padded_width;
    int dst_first, width, height, planes;
    float encoded_peak;
} NnDecode;

#endif
