// Three doubles: what the scene is prepared with, so that only the last step rounds to float.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

namespace pave {

struct Double3 {
    double x = 0, y = 0, z = 0;

    Double3 operator+(Double3 b) const { return {x + b.x, y + b.y, z + b.z}; }
    Double3 operator-(Double3 b) const { return {x - b.x, y - b.y, z - b.z}; }
    Double3 operator-() const { return {-x, -y, -z}; }
    Double3 operator*(double s) const { return {x * s, y * s, z * s}; }
    Double3 operator/(double s) const { return {x / s, y / s, z / s}; }
};

inline double dot(Double3 a, Double3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Double3 cross(Double3 a, Double3 b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline double length(Double3 a) { return std::sqrt(dot(a, a)); }
inline Double3 normalized(Double3 a) { return a / length(a); }
inline double max_abs(Double3 a) { return std::max({std::abs(a.x), std::abs(a.y), std::abs(a.z)}); }
inline bool is_finite(Double3 a) {
    return std::isfinite(a.x) && std::isfinite(a.y) && std::isfinite(a.z);
}
inline Double3 to_double3(const std::array<float, 3>& a) { return {a[0], a[1], a[2]}; }
inline std::array<float, 3> to_floats(Double3 a) {
    return {static_cast<float>(a.x), static_cast<float>(a.y), static_cast<float>(a.z)};
}

/// The affine part of a row-major 4x4 matrix by columns: where the axes and the origin go.
struct Axes {
    Double3 x, y, z, origin;

    explicit Axes(const std::array<float, 16>& m)
        : x{m[0], m[4], m[8]},
          y{m[1], m[5], m[9]},
          z{m[2], m[6], m[10]},
          origin{m[3], m[7], m[11]} {}
};

}  // namespace pave
