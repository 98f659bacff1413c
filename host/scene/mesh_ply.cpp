// Stanford PLY: ascii and both binary orders, any scalar types, elements other than vertex and
// face skipped.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>

#include "host/scene/mesh.h"
#include "host/scene/text.h"

namespace pave {
namespace {

enum class Scalar { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat32, kFloat64 };

struct ScalarName {
    const char* name;
    Scalar scalar;
};
constexpr ScalarName kScalarNames[] = {
    {"char", Scalar::kInt8},      {"int8", Scalar::kInt8},       {"uchar", Scalar::kUint8},
    {"uint8", Scalar::kUint8},    {"short", Scalar::kInt16},     {"int16", Scalar::kInt16},
    {"ushort", Scalar::kUint16},  {"uint16", Scalar::kUint16},   {"int", Scalar::kInt32},
    {"int32", Scalar::kInt32},    {"uint", Scalar::kUint32},     {"uint32", Scalar::kUint32},
    {"float", Scalar::kFloat32},  {"float32", Scalar::kFloat32}, {"double", Scalar::kFloat64},
    {"float64", Scalar::kFloat64}};

size_t byte_size(Scalar scalar) {
    switch (scalar) {
        case Scalar::kInt8:
        case Scalar::kUint8:
            return 1;
        case Scalar::kInt16:
        case Scalar::kUint16:
            return 2;
        case Scalar::kFloat64:
            return 8;
        default:
            return 4;
    }
}

struct Property {
    std::string name;
    Scalar scalar = Scalar::kFloat32;
    bool is_list = false;
    Scalar count_scalar = Scalar::kUint8;
};

struct Element {
    std::string name;
    uint64_t count = 0;
    std::vector<Property> properties;

    // Index of a property, or -1.
    int find(std::string_view property) const {
        for (size_t i = 0; i < properties.size(); ++i)
            if (properties[i].name == property) return static_cast<int>(i);
        return -1;
    }
};

// The next value of the body, whatever its encoding.
class Body {
   public:
    enum class Encoding { kAscii, kLittle, kBig };
    Body(std::string_view bytes, Encoding encoding, size_t line)
        : rest_(bytes), encoding_(encoding), line_(line) {}

    double next(Scalar scalar) {
        return encoding_ == Encoding::kAscii ? next_word() : next_binary(scalar);
    }
    uint64_t least_bytes(const Property& property) const {
        if (encoding_ == Encoding::kAscii) return 2;  // a digit and a space
        return byte_size(property.is_list ? property.count_scalar : property.scalar);
    }
    size_t bytes_left() const {
        return rest_.size() + 1;
    }  // the last word of an ascii file has no space after it
    bool is_at_end() const {
        return encoding_ == Encoding::kAscii ? trim(rest_).empty() : rest_.empty();
    }
    /// "LINE: " of an ascii file.
    std::string where() const {
        return encoding_ == Encoding::kAscii ? std::to_string(line_) + ": " : "";
    }

   private:
    double next_word() {
        size_t begin = 0;
        while (begin < rest_.size() && std::isspace(static_cast<unsigned char>(rest_[begin])))
            line_ += rest_[begin++] == '\n';
        size_t end = begin;
        while (end < rest_.size() && !std::isspace(static_cast<unsigned char>(rest_[end]))) ++end;
        const std::string_view word = rest_.substr(begin, end - begin);
        rest_.remove_prefix(end);
        if (word.empty()) throw MeshError("the file ends early");
        const std::optional<double> number = parse_number(word);
        if (!number) throw MeshError(where() + quote(word) + " is not a finite number");
        return *number;
    }

    template <typename T>
    double load() {
        if (rest_.size() < sizeof(T)) throw MeshError("the file ends early");
        std::array<char, sizeof(T)> bytes;
        std::memcpy(bytes.data(), rest_.data(), sizeof(T));
        const bool is_native =
            (encoding_ == Encoding::kLittle) == (std::endian::native == std::endian::little);
        if (!is_native) std::reverse(bytes.begin(), bytes.end());
        rest_.remove_prefix(sizeof(T));
        return static_cast<double>(std::bit_cast<T>(bytes));
    }

    double next_binary(Scalar scalar) {
        switch (scalar) {
            case Scalar::kInt8:
                return load<int8_t>();
            case Scalar::kUint8:
                return load<uint8_t>();
            case Scalar::kInt16:
                return load<int16_t>();
            case Scalar::kUint16:
                return load<uint16_t>();
            case Scalar::kInt32:
                return load<int32_t>();
            case Scalar::kUint32:
                return load<uint32_t>();
            case Scalar::kFloat32:
                return load<float>();
            default:
                return load<double>();
        }
    }

    std::string_view rest_;
    Encoding encoding_;
    size_t line_;
};

class PlyReader {
   public:
    explicit PlyReader(std::string_view bytes) : rest_(bytes) {}

    Mesh read() {
        read_header();
        Body body(rest_, encoding_, line_ + 1);
        for (const Element& element : elements_) read_element(element, body);
        if (!body.is_at_end()) throw MeshError(body.where() + "data after the last element");
        return std::move(mesh_);
    }

   private:
    [[noreturn]] void fail(const std::string& reason) const {
        throw MeshError(std::to_string(line_) + ": " + reason);
    }

    std::vector<std::string_view> next_header_line() {
        const size_t end = rest_.find('\n');
        if (end == std::string_view::npos) throw MeshError("the header has no end_header");
        const std::string_view line = rest_.substr(0, end);
        rest_.remove_prefix(end + 1);
        ++line_;
        return split_words(line);
    }

    void read_header() {
        if (next_header_line() != std::vector<std::string_view>{"ply"})
            fail("does not begin with \"ply\"");
        bool has_format = false;
        for (;;) {
            const std::vector<std::string_view> words = next_header_line();
            if (words.empty() || words[0] == "comment" || words[0] == "obj_info") continue;
            if (words[0] == "end_header") break;
            if (words[0] == "format" && words.size() == 3) {
                encoding_ = read_encoding(words[1]);
                has_format = true;
            } else if (words[0] == "element" && words.size() == 3) {
                const std::optional<int64_t> count = parse_integer(words[2]);
                if (!count || *count < 0) fail("element count " + quote(words[2]) + " is no count");
                elements_.push_back({std::string(words[1]), static_cast<uint64_t>(*count), {}});
            } else if (words[0] == "property" && !elements_.empty()) {
                elements_.back().properties.push_back(read_property(words));
            } else {
                fail("header line begins with " + quote(words[0]));
            }
        }
        if (!has_format) throw MeshError("the header has no format line");
    }

    Body::Encoding read_encoding(std::string_view word) const {
        if (word == "ascii") return Body::Encoding::kAscii;
        if (word == "binary_little_endian") return Body::Encoding::kLittle;
        if (word == "binary_big_endian") return Body::Encoding::kBig;
        fail("format " + quote(word) + " is not known");
    }

    Scalar read_scalar(std::string_view word) const {
        for (const ScalarName& known : kScalarNames)
            if (word == known.name) return known.scalar;
        fail("type " + quote(word) + " is not known");
    }

    Property read_property(const std::vector<std::string_view>& words) const {
        if (words.size() == 3)
            return {std::string(words[2]), read_scalar(words[1]), false, Scalar::kUint8};
        if (words.size() == 5 && words[1] == "list")
            return {std::string(words[4]), read_scalar(words[3]), true, read_scalar(words[2])};
        fail("a property is \"property TYPE NAME\" or \"property list TYPE TYPE NAME\"");
    }

    // Counts are checked against the bytes there are before anything is allocated.
    void check_count(const Element& element, const Body& body) const {
        uint64_t least = 0;
        for (const Property& property : element.properties) least += body.least_bytes(property);
        if (element.count > std::numeric_limits<uint32_t>::max() ||
            element.count * std::max<uint64_t>(least, 1) > body.bytes_left())
            throw MeshError("the file ends early: it is too short for " +
                            std::to_string(element.count) + " of " + quote(element.name));
    }

    uint64_t read_list_length(const Property& property, Body& body) const {
        const double length = body.next(property.count_scalar);
        if (!(length >= 0) || length != std::floor(length) ||
            length > static_cast<double>(body.bytes_left()))
            throw MeshError(body.where() + "a list of " + quote(property.name) +
                            " has no sound length");
        return static_cast<uint64_t>(length);
    }

    void skip(const Property& property, Body& body) const {
        const uint64_t count = property.is_list ? read_list_length(property, body) : 1;
        for (uint64_t i = 0; i < count; ++i) body.next(property.scalar);
    }

    void read_element(const Element& element, Body& body) {
        check_count(element, body);
        if (element.name == "vertex") return read_vertices(element, body);
        if (element.name == "face") return read_faces(element, body);
        for (uint64_t i = 0; i < element.count; ++i)
            for (const Property& property : element.properties) skip(property, body);
    }

    void read_vertices(const Element& element, Body& body) {
        constexpr const char* kNames[] = {"x", "y", "z", "nx", "ny", "nz"};
        std::array<int, 6> places{};
        for (size_t i = 0; i < 6; ++i) {
            places[i] = element.find(kNames[i]);
            if (i < 3 && places[i] < 0) throw MeshError("vertices have no " + quote(kNames[i]));
        }
        const bool has_normals = places[3] >= 0 && places[4] >= 0 && places[5] >= 0;
        const std::array<int, 2> uv = find_texcoords(element);
        std::vector<double> row(element.properties.size());
        for (uint64_t vertex = 0; vertex < element.count; ++vertex) {
            for (size_t i = 0; i < row.size(); ++i) {
                if (element.properties[i].is_list)
                    skip(element.properties[i], body);
                else
                    row[i] = body.next(element.properties[i].scalar);
            }
            const auto at = [&](size_t i) {
                return static_cast<float>(row[static_cast<size_t>(places[i])]);
            };
            for (size_t i = 0; i < (has_normals ? 6u : 3u); ++i)
                if (!std::isfinite(at(i)))
                    throw MeshError(body.where() + "vertex " + std::to_string(vertex + 1) +
                                    " is not finite");
            mesh_.positions.push_back({at(0), at(1), at(2)});
            if (has_normals) mesh_.normals.push_back({at(3), at(4), at(5)});
            if (uv[0] < 0) continue;
            const auto u = static_cast<float>(row[static_cast<size_t>(uv[0])]),
                       v = static_cast<float>(row[static_cast<size_t>(uv[1])]);
            if (!std::isfinite(u) || !std::isfinite(v))
                throw MeshError(body.where() + "texture coordinates of vertex " +
                                std::to_string(vertex + 1) + " are not finite");
            mesh_.texcoords.push_back({u, v});
        }
    }

    // Places of a vertex's texture coordinates, or -1, -1.
    static std::array<int, 2> find_texcoords(const Element& element) {
        for (const auto& [u, v] : {std::pair("u", "v"), std::pair("s", "t")})
            if (element.find(u) >= 0 && element.find(v) >= 0)
                return {element.find(u), element.find(v)};
        return {-1, -1};
    }

    void read_faces(const Element& element, Body& body) {
        const int place = std::max(element.find("vertex_index"), element.find("vertex_indices"));
        if (place < 0 || !element.properties[static_cast<size_t>(place)].is_list)
            throw MeshError("faces have no list \"vertex_indices\"");
        for (uint64_t face = 0; face < element.count; ++face)
            for (size_t i = 0; i < element.properties.size(); ++i) {
                if (static_cast<int>(i) == place)
                    read_polygon(element.properties[i], body, face);
                else
                    skip(element.properties[i], body);
            }
    }

    void read_polygon(const Property& property, Body& body, uint64_t face) {
        const std::string name = "face " + std::to_string(face + 1);
        const uint64_t corners = read_list_length(property, body);
        if (corners < 3) throw MeshError(body.where() + name + " has fewer than three vertices");
        std::array<uint32_t, 3> triangle{};
        for (uint64_t i = 0; i < corners; ++i) {
            const double index = body.next(property.scalar);
            if (!(index >= 0) || index != std::floor(index) ||
                index >= static_cast<double>(mesh_.positions.size()))
                throw MeshError(body.where() + name +
                                ": a vertex index is out of range, there are " +
                                std::to_string(mesh_.positions.size()) + " vertices");
            triangle[std::min<uint64_t>(i, 2)] = static_cast<uint32_t>(index);
            if (i < 2) continue;
            mesh_.triangles.push_back(triangle);
            triangle[1] = triangle[2];
        }
    }

    std::string_view rest_;
    size_t line_ = 0;
    Body::Encoding encoding_ = Body::Encoding::kAscii;
    std::vector<Element> elements_;
    Mesh mesh_;
};

}  // namespace

Mesh parse_ply(std::string_view bytes) { return PlyReader(bytes).read(); }

}  // namespace pave
