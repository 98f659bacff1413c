// Direct (transposed) convolution of any kernel, stride and padding by register tiles.
// SPDX-License-Identifier: BSD-3-Clause
#include "nn.h"

#ifndef NN_BLOCK /* vectors of output channels in a tile, 1..4; 2 fills the registers of AVX2, 4 \
                    those of AVX-512 */
#define NN_BLOCK 2
#endif
#ifndef NN_PIXELS /* pixels in a tile, 1..12; NN_BLOCK * NN_PIXELS accumulators must stay in \
                     registers */
#define NN_PIXELS 6
#endif
#define NN_UNROLL 4 /* input channels a loop step: more gains nothing and doubles the code */
#define NN_TILE_CHANNELS (NN_BLOCK * NN_LANES)

/* acc += weights of one input channel (NN_BLOCK vectors) x that channel of each pixel. */
#define NN_MULTIPLY_ADD(i, w)                                                \
    do {                                                                     \
        nn_vec weight[NN_BLOCK];                                             \
        _Pragma("unroll") for (int b = 0; b < NN_BLOCK; ++b) weight[b] =     \
            nn_load((w) + b * NN_LANES);                                     \
        _Pragma("unroll") for (int m = 0; m < NN_PIXELS; ++m) {              \
            const nn_vec value = (nn_vec)(pixel[m][i]);                      \
            _Pragma("unroll") for (int b = 0; b < NN_BLOCK; ++b) acc[m][b] = \
                fma(value, weight[b], acc[m][b]);                            \
        }                                                                    \
    } while (0)

/* Global size: (chunks of tiles, blocks of NN_TILE_CHANNELS output channels, phases). Weights of a
   phase: [block][tap][in channel][NN_TILE_CHANNELS], padded with zeros; bias padded likewise. */
NN_KERNEL void nn_conv_direct(const NnConv s, __global const float* restrict src_arena,
                              __global const float* restrict weights,
                              __global const float* restrict bias,
                              __global const NnPhase* restrict phases,
                              __global const int2* restrict taps,
                              __global float* restrict dst_arena) {
    const NnPhase phase = phases[get_global_id(2)];
    const int channel = (int)get_global_id(1) * NN_TILE_CHANNELS;
    const int pixels = phase.grid_width * phase.grid_height;
    __global const float* src = src_arena + s.src_first;
    __global const float* zeros = weights + s.zeros_first;

    for (int tile = 0; tile < s.tiles_per_item; ++tile) {
        const int first = ((int)get_global_id(0) * s.tiles_per_item + tile) * NN_PIXELS;
        if (first >= pixels) return;
        int x0[NN_PIXELS], y0[NN_PIXELS];
        nn_vec acc[NN_PIXELS][NN_BLOCK];
#pragma unroll
        for (int m = 0; m < NN_PIXELS; ++m) {
            const int n = min(first + m, pixels - 1);
            const int y = n / phase.grid_width;
            y0[m] = y * s.in_step;
            x0[m] = (n - y * phase.grid_width) * s.in_step;
#pragma unroll
            for (int b = 0; b < NN_BLOCK; ++b) acc[m][b] = nn_load(bias + channel + b * NN_LANES);
        }
        __global const float* w =
            weights + phase.weight_first + channel * (phase.taps * s.in_channels);
        for (int t = 0; t < phase.taps; ++t) {
            const int2 tap = taps[phase.tap_first + t];
            __global const float* pixel[NN_PIXELS];
#pragma unroll
            for (int m = 0; m < NN_PIXELS; ++m) {
                const int x = x0[m] + tap.x, y = y0[m] + tap.y;
                const bool inside = (uint)x < (uint)s.src_width && (uint)y < (uint)s.src_height;
                pixel[m] = inside ? src + (y * s.src_width + x) * s.src_step : zeros;
            }
            int i = 0;
            for (; i + NN_UNROLL <= s.in_channels; i += NN_UNROLL) {
#pragma unroll
                for (int u = 0; u < NN_UNROLL; ++u)
                    NN_MULTIPLY_ADD(i + u, w + u * NN_TILE_CHANNELS);
                w += NN_UNROLL * NN_TILE_CHANNELS;
            }
            for (; i < s.in_channels; ++i) {
                NN_MULTIPLY_ADD(i, w);
                w += NN_TILE_CHANNELS;
            }
        }
#pragma unroll
        for (int m = 0; m < NN_PIXELS; ++m) {
            const int n = first + m;
            if (n >= pixels) break;
            const int y = n / phase.grid_width, x = n - y * phase.grid_width;
            const int to =
                (y * s.out_step + phase.out_y) * s.dst_width + x * s.out_step + phase.out_x;
            __global float* dst = dst_arena + s.dst_first + to * s.dst_step + channel;
#pragma unroll
            for (int b = 0; b < NN_BLOCK; ++b) {
                const int count = s.out_channels - channel - b * NN_LANES;
                if (count > 0)
                    nn_store_part(nn_activate(acc[m][b], s.activation, s.slope), dst + b * NN_LANES,
                                  count);
            }
        }
    }
}
