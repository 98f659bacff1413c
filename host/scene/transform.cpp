// Affine maps in double precision and the <transform> element, in Mitsuba's order: the first child
// acts first.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/transform.h"

#include <cmath>
#include <numbers>

#include "host/scene/text.h"

namespace pave {
namespace {

// Columns nearer than this to a common plane make distances lose all digits of float32.
constexpr double kMinIndependence = 1e-6;
constexpr double kLeastScale = 1e-10;  // of instances

double read_number(SceneFile& file, pugi::xml_node node, std::string_view words) {
    const std::optional<double> number = parse_number(words);
    if (!number) file.fail(node, quote(words) + " is not a finite number");
    return *number;
}

std::vector<double> read_numbers(SceneFile& file, pugi::xml_node node, const char* attribute) {
    std::vector<double> numbers;
    const std::string words = file.attribute(node, attribute);
    for (const std::string_view word : split_words(words))
        numbers.push_back(read_number(file, node, word));
    return numbers;
}

Double3 read_vector(SceneFile& file, pugi::xml_node node, const char* attribute) {
    const std::vector<double> numbers = read_numbers(file, node, attribute);
    if (numbers.size() != 3) file.fail(node, quote(attribute) + " needs three numbers");
    return {numbers[0], numbers[1], numbers[2]};
}

// x, y, z attributes, each with a default, or one value="s" or value="x y z".
Double3 read_xyz(SceneFile& file, pugi::xml_node node, double fallback) {
    if (node.attribute("value")) {
        if (node.attribute("x") || node.attribute("y") || node.attribute("z"))
            file.fail(node, "give either \"value\" or \"x\", \"y\", \"z\"");
        const std::vector<double> numbers = read_numbers(file, node, "value");
        if (numbers.size() == 1) return {numbers[0], numbers[0], numbers[0]};
        if (numbers.size() != 3) file.fail(node, "\"value\" needs one or three numbers");
        return {numbers[0], numbers[1], numbers[2]};
    }
    Double3 result{fallback, fallback, fallback};
    constexpr const char* kAxes[] = {"x", "y", "z"};
    for (size_t i = 0; i < 3; ++i)
        if (node.attribute(kAxes[i]))
            result[i] = read_number(file, node, file.attribute(node, kAxes[i]));
    return result;
}

// Rodrigues' rotation by `degrees` about `axis`.
Affine rotation(const Double3& axis, double degrees) {
    const Double3 u = normalized(axis);
    const double angle = degrees * std::numbers::pi / 180.0;
    const double c = std::cos(angle), s = std::sin(angle);
    const std::array<Double3, 3> skew{{{0, -u[2], u[1]}, {u[2], 0, -u[0]}, {-u[1], u[0], 0}}};
    Affine result;
    for (size_t row = 0; row < 3; ++row)
        for (size_t column = 0; column < 3; ++column)
            result.linear[row][column] =
                (row == column ? c : 0.0) + (1 - c) * u[row] * u[column] + s * skew[row][column];
    return result;
}

// Some vector orthogonal to unit `n`: the first tangent of Duff et al. 2017, which Mitsuba takes
// when `up` is missing.
Double3 any_orthogonal(const Double3& n) {
    const double sign = std::copysign(1.0, n[2]);
    const double a = -1.0 / (sign + n[2]);
    return {1.0 + sign * n[0] * n[0] * a, sign * n[0] * n[1] * a, -sign * n[0]};
}

Affine read_lookat(SceneFile& file, pugi::xml_node node) {
    file.check_attributes(node, {"origin", "target"}, {"up"});
    const Double3 origin = read_vector(file, node, "origin");
    const Double3 target = read_vector(file, node, "target");
    Double3 up{0, 0, 0};
    if (node.attribute("up")) up = read_vector(file, node, "up");
    const Double3 forward = normalized(target - origin);
    if (length(forward) == 0) file.fail(node, "origin and target are the same point");
    if (length(up) == 0) up = any_orthogonal(forward);
    const Double3 left = cross(normalized(up), forward);
    if (length(left) < 1e-6) file.fail(node, "up is parallel to the line from origin to target");
    const Double3 unit_left = normalized(left), camera_up = cross(forward, unit_left);
    Affine result;
    for (size_t row = 0; row < 3; ++row)
        result.linear[row] = {unit_left[row], camera_up[row], forward[row]};
    result.offset = origin;
    return result;
}

Affine read_matrix(SceneFile& file, pugi::xml_node node) {
    file.check_attributes(node, {"value"});
    const std::vector<double> numbers = read_numbers(file, node, "value");
    if (numbers.size() != 9 && numbers.size() != 16)
        file.fail(node, "needs 9 or 16 numbers, has " + std::to_string(numbers.size()));
    const size_t stride = numbers.size() == 9 ? 3 : 4;
    Affine result;
    for (size_t row = 0; row < 3; ++row) {
        for (size_t column = 0; column < 3; ++column)
            result.linear[row][column] = numbers[row * stride + column];
        if (stride == 4) result.offset[row] = numbers[row * stride + 3];
    }
    if (stride == 4 &&
        (numbers[12] != 0 || numbers[13] != 0 || numbers[14] != 0 || numbers[15] != 1))
        file.fail(node,
                  "the last row must be 0 0 0 1: projections cannot be shapes' or cameras' places");
    return result;
}

Affine read_step(SceneFile& file, pugi::xml_node node) {
    const std::string tag = node.name();
    file.check_no_children(node);
    if (tag == "lookat") return read_lookat(file, node);
    if (tag == "matrix") return read_matrix(file, node);
    if (tag == "translate" || tag == "scale") {
        file.check_attributes(node, {}, {"x", "y", "z", "value"});
        return tag == "scale" ? scaling(read_xyz(file, node, 1))
                              : translation(read_xyz(file, node, 0));
    }
    if (tag != "rotate")
        file.fail(node,
                  "<" + tag + "> cannot stand in a <transform>" +
                      did_you_mean(tag, {"lookat", "matrix", "translate", "rotate", "scale"}));
    file.check_attributes(node, {"angle"}, {"x", "y", "z", "value"});
    const Double3 axis = read_xyz(file, node, 0);
    if (length(axis) == 0) file.fail(node, "the axis of rotation is zero");
    // Mitsuba 3.9 puts the axis into Rodrigues' formula as it stands, so that a longer one also
    // stretches.
    if (std::abs(length(axis) - 1) > 1e-5)
        file.fail(node, "the axis of rotation must have length 1: Mitsuba distorts with others");
    return rotation(axis, read_number(file, node, file.attribute(node, "angle")));
}

}  // namespace

Double3 operator-(const Double3& a, const Double3& b) {
    return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
Double3 operator+(const Double3& a, const Double3& b) {
    return {a[0] + b[0], a[1] + b[1], a[2] + b[2]};
}
Double3 operator*(double s, const Double3& a) { return {s * a[0], s * a[1], s * a[2]}; }
double dot(const Double3& a, const Double3& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
Double3 cross(const Double3& a, const Double3& b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
double length(const Double3& a) { return std::sqrt(dot(a, a)); }
Double3 normalized(const Double3& a) {
    const double norm = length(a);
    return norm > 0 ? (1 / norm) * a : a;
}

Double3 Affine::vector(const Double3& v) const {
    return {dot(linear[0], v), dot(linear[1], v), dot(linear[2], v)};
}
Double3 Affine::point(const Double3& p) const { return vector(p) + offset; }
double Affine::determinant() const { return dot(column(0), cross(column(1), column(2))); }

double Affine::independence() const {
    const double lengths = length(column(0)) * length(column(1)) * length(column(2));
    return lengths > 0 ? std::abs(determinant()) / lengths : 0;
}

Double3 Affine::normal(const Double3& n) const {
    return n[0] * cross(column(1), column(2)) + n[1] * cross(column(2), column(0)) +
           n[2] * cross(column(0), column(1));
}

Matrix4 Affine::matrix() const {
    Matrix4 result{};
    for (size_t row = 0; row < 3; ++row) {
        for (size_t column = 0; column < 3; ++column)
            result[4 * row + column] = static_cast<float>(linear[row][column]);
        result[4 * row + 3] = static_cast<float>(offset[row]);
    }
    result[15] = 1;
    return result;
}

Affine compose(const Affine& outer, const Affine& inner) {
    Affine result;
    for (size_t column = 0; column < 3; ++column) {
        const Double3 image = outer.vector(inner.column(column));
        for (size_t row = 0; row < 3; ++row) result.linear[row][column] = image[row];
    }
    result.offset = outer.point(inner.offset);
    return result;
}

Affine translation(const Double3& offset) {
    Affine result;
    result.offset = offset;
    return result;
}

Affine scaling(const Double3& factors) {
    Affine result;
    for (size_t i = 0; i < 3; ++i) result.linear[i][i] = factors[i];
    return result;
}

bool can_place(const Affine& map) {
    for (size_t i = 0; i < 3; ++i) {
        const double scale = length(map.column(i));
        if (!(scale > kLeastScale && scale <= kMaxCoordinate) ||
            !(std::abs(map.offset[i]) <= kMaxCoordinate))
            return false;
    }
    return map.independence() > kMinIndependence;
}

Affine read_affine(Properties& properties, const std::string& name) {
    const pugi::xml_node node = properties.value(name);
    if (!node) return {};
    SceneFile& file = properties.file();
    if (std::string_view(node.name()) != "transform") file.fail(node, "must be a <transform>");
    file.check_attributes(node, {"name"});
    Affine result;
    for (const pugi::xml_node step : node.children())
        if (step.type() == pugi::node_element) result = compose(read_step(file, step), result);
    for (size_t row = 0; row < 3; ++row)
        for (const double value : {result.linear[row][0], result.linear[row][1],
                                   result.linear[row][2], result.offset[row]})
            if (!(std::abs(value) <= kMaxCoordinate)) file.fail(node, "has values beyond 1e12");
    if (!(result.independence() > kMinIndependence))
        file.fail(node, "is singular: it flattens the object (a scale of 0?)");
    return result;
}

}  // namespace pave
