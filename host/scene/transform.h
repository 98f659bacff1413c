// Affine maps in double precision and the <transform> element, in Mitsuba's order: the first child
// acts first.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>

#include "host/scene/xml.h"

namespace pave {

using Double3 = std::array<double, 3>;

inline constexpr double kMaxCoordinate = 1e12;  // squares and cubes stay finite in float32

Double3 operator-(const Double3& a, const Double3& b);
Double3 operator+(const Double3& a, const Double3& b);
Double3 operator*(double s, const Double3& a);
double dot(const Double3& a, const Double3& b);
Double3 cross(const Double3& a, const Double3& b);
double length(const Double3& a);
/// Unit vector along `a`; `a` itself if its length is 0.
Double3 normalized(const Double3& a);

/// p -> linear p + offset; linear in rows.
struct Affine {
    std::array<Double3, 3> linear{{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
    Double3 offset{0, 0, 0};

    Double3 point(const Double3& p) const;
    Double3 vector(const Double3& v) const;
    Double3 column(size_t i) const { return {linear[0][i], linear[1][i], linear[2][i]}; }
    double determinant() const;
    /// |determinant| over the product of the columns' lengths: 1 for orthogonal columns, 0 for a
    /// singular map.
    double independence() const;
    /// Directions of normals: the inverse transpose times the determinant (cofactors), not
    /// normalised.
    Double3 normal(const Double3& n) const;
    Matrix4 matrix() const;  // rounded to float
};
/// First `inner`, then `outer`.
Affine compose(const Affine& outer, const Affine& inner);
Affine translation(const Double3& offset);
Affine scaling(const Double3& factors);
/// Whether an instance can lie so: the map and its inverse are in range, and it flattens nothing.
bool can_place(const Affine& map);

/// The object's <transform> called `name`, identity if it has none. Fails on singular, projective
/// and non-finite maps.
Affine read_affine(Properties& properties, const std::string& name);
inline Affine read_to_world(Properties& properties) { return read_affine(properties, "to_world"); }

}  // namespace pave
