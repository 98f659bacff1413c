// Both sides of a convolution by matrix product: columns before it, placing after it.
// SPDX-License-Identifier: BSD-3-Clause
#include "nn.h"

/* columns[pixel][tap][channel] = the input under that tap, 0 outside of the image.
   Global size: (groups of channels_per_item channels, taps, pixels). */
NN_KERNEL void nn_columns(const NnColumns s, __global const float* restrict arena,
                          __global const int2* restrict taps, __global float* restrict columns) {
    const int channel_first = (int)get_global_id(0) * s.channels_per_item;
    const int channel_end = min(channel_first + s.channels_per_item, s.in_channels);
    const int t = (int)get_global_id(1), n = (int)get_global_id(2) + s.pixel_first;
    const int2 tap = taps[s.tap_first + t];
    const int grid_y = n / s.grid_width;
    const int x = (n - grid_y * s.grid_width) * s.in_step + tap.x, y = grid_y * s.in_step + tap.y;
    const bool inside = (uint)x < (uint)s.src_width && (uint)y < (uint)s.src_height;
    __global const float* src =
        arena + s.src_first + (inside ? (y * s.src_width + x) * s.src_step : 0);
    __global float* dst = columns + ((size_t)get_global_id(2) * s.taps + t) * s.in_channels;
    for (int c = channel_first; c < channel_end; c += NN_LANES) {
        const int count = channel_end - c;
        nn_store_part(inside ? nn_load_part(src + c, count) : (nn_vec)(0.0f), dst + c, count);
    }
}

/* arena pixel = activation(rows[pixel] + bias). Global size: (groups of channels_per_item channels,
 * pixels). */
NN_KERNEL void nn_scatter(const NnScatter s, __global const float* restrict rows,
                          __global const float* restrict bias, __global float* restrict arena) {
    const int channel_first = (int)get_global_id(0) * s.channels_per_item;
    const int channel_end = min(channel_first + s.channels_per_item, s.out_channels);
    const int n = (int)get_global_id(1) + s.pixel_first;
    const int y = n / s.grid_width, x = n - y * s.grid_width;
    const int to = (y * s.out_step + s.out_y) * s.dst_width + x * s.out_step + s.out_x;
    __global const float* src = rows + (size_t)get_global_id(1) * s.out_channels;
    __global float* dst = arena + s.dst_first + to * s.dst_step;
    for (int c = channel_first; c < channel_end; c += NN_LANES) {
        const int count = channel_end - c;
        const nn_vec sum = nn_load_part(src + c, count) + nn_load_part(bias + c, count);
        nn_store_part(nn_activate(sum, s.activation, s.slope), dst + c, count);
    }
}
