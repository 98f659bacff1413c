// From a frame's channels to the network's input and from its result to a channel.
// SPDX-License-Identifier: BSD-3-Clause
#include "nn.h"

/* The transfer "srgb_log": sRGB's opto-electronic curve (IEC 61966-2-1) up to 1, above it 1 + s
   ln(x), which goes on with the same slope s = 1.055 / 2.4. python/pave/transfer.py is the same
   pair. */
#define NN_LINEAR_END 0.0031308f
#define NN_LINEAR_SLOPE 12.92f
#define NN_LOG_SLOPE (1.055f / 2.4f)

static inline nn_vec nn_transfer(nn_vec x) {
    const nn_vec low = x * NN_LINEAR_SLOPE;
    const nn_vec middle = 1.055f * pow(x, (nn_vec)(1.0f / 2.4f)) - 0.055f;
    const nn_vec high = 1.0f + NN_LOG_SLOPE * log(x);
    const nn_vec bright = x > 1.0f ? high : middle;
    return x > NN_LINEAR_END ? bright : (x > 0.0f ? low : (nn_vec)(0.0f));
}

static inline nn_vec nn_inverse_transfer(nn_vec y) {
    const nn_vec low = y / NN_LINEAR_SLOPE;
    const nn_vec middle = pow((y + 0.055f) / 1.055f, (nn_vec)(2.4f));
    const nn_vec high = exp((y - 1.0f) / NN_LOG_SLOPE);
    const nn_vec bright = y > 1.0f ? high : middle;
    return y > NN_LINEAR_SLOPE * NN_LINEAR_END ? bright : (y > 0.0f ? low : (nn_vec)(0.0f));
}

static inline nn_vec nn_encode_value(const NnEncode s, nn_vec x, int plane) {
    if (s.encode == NN_ENCODE_RADIANCE) return nn_transfer(x) * s.scale;
    if (s.encode == NN_ENCODE_DEPTH)
        return s.scale /
               (s.scale + (x > 0.0f ? x : (nn_vec)(0.0f)));  // a miss is +inf and becomes 0
    if (s.encode == NN_ENCODE_POSITION) return (x - s.center[plane]) * s.scale;
    return x;
}

/* Global size: (groups of NN_LANES pixels of a row, rows of the padded image, planes). */
NN_KERNEL void nn_encode(const NnEncode s, __global const float* restrict slot,
                         __global float* restrict arena) {
    const int x = (int)get_global_id(0) * NN_LANES, y = (int)get_global_id(1);
    const int plane = (int)get_global_id(2);
    __global const float* row =
        slot + s.src_first + ((size_t)plane * s.height + min(y, s.height - 1)) * s.width;
    float values[NN_LANES];
    for (int i = 0; i < NN_LANES; ++i) values[i] = row[min(x + i, s.width - 1)];
    nn_store(nn_encode_value(s, nn_load(values), plane), values);
    __global float* dst = arena + s.dst_first + (y * s.padded_width + x) * s.dst_step + plane;
    const int end = min(NN_LANES, s.padded_width - x);
    for (int i = 0; i < end; ++i)
        for (int r = 0; r < s.repeat; ++r) dst[i * s.dst_step + r * s.planes] = values[i];
}

/* Global size: (groups of NN_LANES pixels of a row, rows of the image, planes). */
NN_KERNEL void nn_decode(const NnDecode s, __global const float* restrict arena,
                         __global float* restrict slot) {
    const int x = (int)get_global_id(0) * NN_LANES, y = (int)get_global_id(1);
    const int plane = (int)get_global_id(2), count = s.width - x;
    __global const float* src = arena + s.src_first + (y * s.padded_width + x) * s.src_step + plane;
    float values[NN_LANES];
    for (int i = 0; i < NN_LANES; ++i) values[i] = i < count ? src[i * s.src_step] : 0.0f;
    nn_vec v = nn_load(values);
    if (s.encoded_peak > 0.0f) v = nn_inverse_transfer(v * s.encoded_peak);
    nn_store_part(v, slot + s.dst_first + ((size_t)plane * s.height + y) * s.width + x, count);
}
