// The network's operations beside convolution: element by element, normalisation, upsampling.
// SPDX-License-Identifier: BSD-3-Clause
#include "nn.h"

static inline nn_vec nn_row_value(const NnRows s, __global const float* parameters,
                                  __global const float* arena, int n, int c, int count) {
    int from = n;
    if (s.op == NN_ROWS_UPSAMPLE)  // each input pixel becomes scale x scale output pixels
        from = n / s.width / s.scale * (s.width / s.scale) + n % s.width / s.scale;
    const nn_vec x = nn_load_part(arena + s.src_first + from * s.src_step + c, count);
    if (s.op == NN_ROWS_AFFINE)
        return fma(x - nn_load_part(parameters + c, count),
                   nn_load_part(parameters + s.channels + c, count),
                   nn_load_part(parameters + 2 * s.channels + c, count));
    if (s.op == NN_ROWS_ADD)
        return x + nn_load_part(arena + s.other_first + n * s.other_step + c, count);
    if (s.op == NN_ROWS_MUL)
        return x * nn_load_part(arena + s.other_first + n * s.other_step + c, count);
    return x;
}

/* dst = activation(op(src, other)); in place where op reads each value once, that is all but
   upsampling. Global size: (groups of channels_per_item channels, groups of pixels_per_item
   pixels). */
NN_KERNEL void nn_rows(const NnRows s, __global const float* parameters, __global float* arena) {
    const int channel_first = (int)get_global_id(0) * s.channels_per_item;
    const int channel_end = min(channel_first + s.channels_per_item, s.channels);
    const int pixel_first = (int)get_global_id(1) * s.pixels_per_item;
    const int pixel_end = min(pixel_first + s.pixels_per_item, s.pixels);
    for (int n = pixel_first; n < pixel_end; ++n)
        for (int c = channel_first; c < channel_end; c += NN_LANES) {
            const int count = channel_end - c;
            const nn_vec value = nn_row_value(s, parameters, arena, n, c, count);
            nn_store_part(nn_activate(value, s.activation, s.slope),
                          arena + s.dst_first + n * s.dst_step + c, count);
        }
}

/* partial[chunk][2][channels] = mean and sum of squared deviations of the chunk: two passes, so
   that nothing cancels. Global size: (groups of NN_LANES channels, chunks). */
NN_KERNEL void nn_moments(const NnMoments s, __global const float* restrict arena,
                          __global float* restrict partial) {
    const int c = (int)get_global_id(0) * NN_LANES, count = s.channels - c;
    const int chunk = (int)get_global_id(1);
    const int first = chunk * s.pixels_per_chunk, end = min(first + s.pixels_per_chunk, s.pixels);
    __global const float* src = arena + s.src_first + c;
    nn_vec sum = (nn_vec)(0.0f), squares = (nn_vec)(0.0f);
    for (int n = first; n < end; ++n) sum += nn_load_part(src + n * s.src_step, count);
    const nn_vec mean = sum / (float)(end - first);
    for (int n = first; n < end; ++n) {
        const nn_vec deviation = nn_load_part(src + n * s.src_step, count) - mean;
        squares = fma(deviation, deviation, squares);
    }
    __global float* to = partial + 2 * chunk * s.channels + c;
    nn_store_part(mean, to, count);
    nn_store_part(squares, to + s.channels, count);
}

/* Joins the chunks (Chan, Golub, LeVeque 1983, eq. 2.1) and writes nn_affine's parameters: mean,
   weight / sqrt(var + eps), bias. `gains` is [2][channels], weight and bias. Global size: (groups
   of NN_LANES channels). */
NN_KERNEL void nn_normalise(const NnMoments s, __global const float* restrict partial,
                            __global const float* restrict gains,
                            __global float* restrict parameters) {
    const int c = (int)get_global_id(0) * NN_LANES, count = s.channels - c;
    nn_vec mean = (nn_vec)(0.0f), squares = (nn_vec)(0.0f);
    float n = 0.0f;
    for (int chunk = 0; chunk < s.chunks; ++chunk) {
        __global const float* from = partial + 2 * chunk * s.channels + c;
        const float m = (float)min(s.pixels_per_chunk, s.pixels - chunk * s.pixels_per_chunk);
        const nn_vec difference = nn_load_part(from, count) - mean;
        mean = fma(difference, (nn_vec)(m / (n + m)), mean);
        squares +=
            nn_load_part(from + s.channels, count) + difference * difference * (n * m / (n + m));
        n += m;
    }
    nn_store_part(mean, parameters + c, count);
    nn_store_part(nn_load_part(gains + c, count) / sqrt(squares / n + s.eps),
                  parameters + s.channels + c, count);
    nn_store_part(nn_load_part(gains + s.channels + c, count), parameters + 2 * s.channels + c,
                  count);
}

/* Sizes of the parameter blocks as this compiler sees them; the tests compare them with the host's.
 */
NN_KERNEL void nn_struct_sizes(__global int* sizes) {
    sizes[0] = sizeof(NnRows);
    sizes[1] = sizeof(NnConv);
    sizes[2] = sizeof(NnPhase);
    sizes[3] = sizeof(NnColumns);
    sizes[4] = sizeof(NnScatter);
    sizes[5] = sizeof(NnMoments);
    sizes[6] = sizeof(NnEncode);
    sizes[7] = sizeof(NnDecode);
}
