// Finds the rectangles and cubes that the cheaper tests of kernels/axis_shapes.h serve.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <bit>
#include <cmath>

#include "host/render/scene_data.h"

namespace pave {
namespace {

/// Bit a: component a is more than what rounding leaves of a turn by 90 degrees.
unsigned components(const float* v) {
    const float largest = std::max({std::abs(v[0]), std::abs(v[1]), std::abs(v[2])});
    unsigned bits = 0;
    for (unsigned a = 0; a < 3; ++a)
        if (std::abs(v[a]) > largest * 0x1p-22f) bits |= 1u << a;
    return bits;
}
/// The axis that v runs along; -1: none.
int axis_along(const float* v) {
    const unsigned bits = components(v);
    return std::has_single_bit(bits) ? std::countr_zero(bits) : -1;
}

/// Where the rectangle lies along `axis`, which is that of its row `along`.
void set_extent(kernel::AxisRect& rect, size_t place, const float* along, int axis, float limit) {
    const double scale = along[axis];
    rect.center[place] = static_cast<float>(-along[3] / scale);
    rect.reach[place] = static_cast<float>(limit / std::abs(scale));
}

bool to_axis_rect(const kernel::FlatShape& flat, kernel::AxisRect& rect, size_t& axis) {
    const int n = axis_along(flat.n), u = axis_along(flat.u), v = axis_along(flat.v);
    if (flat.kind != FLAT_RECT || n < 0 || u < 0 || v < 0) return false;
    rect.plane = flat.n[3] / flat.n[n];
    rect.surface = flat.surface;
    set_extent(rect, u == (n + 1) % 3 ? 0 : 1, flat.u, u, flat.limit);
    set_extent(rect, v == (n + 1) % 3 ? 0 : 1, flat.v, v, flat.limit);
    axis = static_cast<size_t>(n);
    return true;
}

bool to_axis_cube(const kernel::CubeShape& cube, kernel::AxisCube& to, size_t& axis) {
    for (size_t row = 0; row < 3; ++row) {
        const int k = axis_along(cube.row[row]);
        const size_t u = (row + 1) % 3, v = (row + 2) % 3;
        if (k < 0 || ((components(cube.row[u]) | components(cube.row[v])) >> k & 1) != 0) continue;
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        for (const auto& [out, in] : {std::pair(to.u, cube.row[u]), std::pair(to.v, cube.row[v])}) {
            out[0] = in[i];
            out[1] = in[j];
            out[2] = in[3];
        }
        to.along[0] = cube.row[row][k];
        to.along[1] = cube.row[row][3];
        to.half_length = 1.0f / cube.row[row][k];
        to.face_along = cube.surface + 2 * static_cast<uint32_t>(row);
        to.face_u = cube.surface + 2 * static_cast<uint32_t>(u);
        to.face_v = cube.surface + 2 * static_cast<uint32_t>(v);
        axis = static_cast<size_t>(k);
        return true;
    }
    return false;
}

template <class Shape>
void append(std::array<std::vector<Shape>, 3>& lists, std::vector<Shape>& to,
            std::array<int, 3>& counts) {
    for (size_t k = 0; k < 3; ++k) {
        counts[k] = static_cast<int>(lists[k].size());
        to.insert(to.end(), lists[k].begin(), lists[k].end());
    }
}

}  // namespace

void split_axis_shapes(SceneData& data) {
    std::array<std::vector<kernel::AxisRect>, 3> rects;
    std::array<std::vector<kernel::AxisCube>, 3> cubes;
    std::vector<kernel::FlatShape> other_flats;
    std::vector<kernel::CubeShape> other_cubes;
    int blocking = 0;
    for (int i = 0; i < static_cast<int>(data.flats.size()); ++i) {
        const kernel::FlatShape& flat = data.flats[static_cast<size_t>(i)];
        const bool blocks = i < data.flat_shadow[FLAT_RECT];
        kernel::AxisRect rect{};
        size_t axis = 0;
        if (to_axis_rect(flat, rect, axis)) {
            data.axis_shadow[axis] += blocks;
            rects[axis].push_back(rect);
        } else {
            blocking += blocks;
            other_flats.push_back(flat);
        }
    }
    for (const kernel::CubeShape& cube : data.cubes) {
        kernel::AxisCube axis_cube{};
        size_t axis = 0;
        if (to_axis_cube(cube, axis_cube, axis))
            cubes[axis].push_back(axis_cube);
        else
            other_cubes.push_back(cube);
    }
    append(rects, data.axis_rects, data.axis_rect_count);
    append(cubes, data.axis_cubes, data.axis_cube_count);
    data.flat_count[FLAT_RECT] -= static_cast<int>(data.axis_rects.size());
    data.flat_shadow[FLAT_RECT] = blocking;
    data.flats = std::move(other_flats);
    data.cubes = std::move(other_cubes);
}

}  // namespace pave
