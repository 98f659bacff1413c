// Boxes around what a scene file puts into the world.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/bounds.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace pave {

Bounds::Bounds() {
    low.fill(std::numeric_limits<double>::infinity());
    high.fill(-std::numeric_limits<double>::infinity());
}

void Bounds::include(const Double3& point) {
    for (size_t i = 0; i < 3; ++i) {
        low[i] = std::min(low[i], point[i]);
        high[i] = std::max(high[i], point[i]);
    }
}

void Bounds::include(const Mesh& mesh) {
    for (const std::array<uint32_t, 3>& triangle : mesh.triangles)
        for (const uint32_t vertex : triangle) {
            const std::array<float, 3>& p = mesh.positions[vertex];
            include(Double3{p[0], p[1], p[2]});
        }
}

void Bounds::include_image(const Affine& map, const Double3& center, const Double3& half,
                           bool is_round) {
    // Half-extent along each axis: the sum of the columns' parts, or their root of squares.
    const Double3 middle = map.point(center);
    Double3 reach{};
    for (size_t axis = 0; axis < 3; ++axis) {
        const Double3& row = map.linear[axis];
        const Double3 part{row[0] * half[0], row[1] * half[1], row[2] * half[2]};
        reach[axis] =
            is_round ? length(part) : std::abs(part[0]) + std::abs(part[1]) + std::abs(part[2]);
    }
    include(middle - reach);
    include(middle + reach);
}

void Bounds::include_image(const Affine& map, const Bounds& box) {
    include_image(map, 0.5 * (box.low + box.high), 0.5 * (box.high - box.low));
}

bool Bounds::in_range() const {
    const auto fits = [](double x) { return std::abs(x) <= kMaxCoordinate; };
    return std::all_of(low.begin(), low.end(), fits) && std::all_of(high.begin(), high.end(), fits);
}

void set_bounds(Scene& scene, const Bounds& bounds) {
    for (size_t i = 0; i < 3; ++i) {
        scene.bounds_min[i] = static_cast<float>(bounds.low[i]);
        scene.bounds_max[i] = static_cast<float>(bounds.high[i]);
    }
}

}  // namespace pave
