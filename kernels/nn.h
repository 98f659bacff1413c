// What the network's kernels share: lanes along the channels and the activations.
// SPDX-License-Identifier: BSD-3-Clause
#ifndef PAVE_NN_H
#define PAVE_NN_H

#include "nn_types.h"

#ifndef NN_LANES /* floats that a work-item handles at once: 1 (GPUs), 4, 8 or 16 */
#define NN_LANES 1
#endif

#define NN_PASTE2(a, b) a##b
#define NN_PASTE(a, b) NN_PASTE2(a, b)
#if NN_LANES == 1
typedef float nn_vec;
typedef int nn_ivec;
#define nn_load(p) (*(p))
#define nn_store(v, p) (*(p) = (v))
#else
typedef NN_PASTE(float, NN_LANES) nn_vec;
typedef NN_PASTE(int, NN_LANES) nn_ivec;
#define nn_load(p) NN_PASTE(vload, NN_LANES)(0, p)
#define nn_store(v, p) NN_PASTE(vstore, NN_LANES)(v, 0, p)
#endif

#ifndef NN_SERIAL /* 1: one work-item a work-group, so that PoCL compiles straight code without \
                     work-item loops */
#define NN_SERIAL 0
#endif
#if NN_SERIAL
#define NN_KERNEL __kernel __attribute__((reqd_work_group_size(1, 1, 1)))
#else
#define NN_KERNEL __kernel
#endif

/* The first `count` lanes from p, zero in the others; `count` may be NN_LANES. */
static inline nn_vec nn_load_part(__global const float* p, int count) {
    if (count >= NN_LANES) return nn_load(p);
    float lanes[NN_LANES];
    for (int i = 0; i < NN_LANES; ++i) lanes[i] = i < count ? p[i] : 0.0f;
    return nn_load(lanes);
}

static inline void nn_store_part(nn_vec v, __global float* p, int count) {
    if (count >= NN_LANES) {
        nn_store(v, p);
        return;
    }
    float lanes[NN_LANES];
    nn_store(v, lanes);
    for (int i = 0; i < count; ++i) p[i] = lanes[i];
}

static inline nn_vec nn_activate(nn_vec x, int activation, float slope) {
    if (activation == NN_ACT_LEAKY) return x > 0.0f ? x : x * slope;
    if (activation == NN_ACT_SIGMOID) return 1.0f / (1.0f + exp(-x));
    if (activation == NN_ACT_TANH) return tanh(x);
    return x;
}

#endif
