// The table of stratified numbers that all pixels share.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/render/scene_data.h"

namespace pave {

/// SOBOL_SAMPLES * SOBOL_VERTICES rows as kernels/render_types.h lays them out: the first points of
/// the Sobol sequence in 14 dimensions, scrambled linearly: row i ^ j is row i ^ row j. Always the
/// same ones.
std::vector<Row> sobol_rows();

}  // namespace pave
