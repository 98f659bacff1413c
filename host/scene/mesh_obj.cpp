// Wavefront OBJ: v, vn and f lines; vertices are shared exactly as the file shares them, which
// computed normals need.
// SPDX-License-Identifier: BSD-3-Clause
#include <limits>
#include <unordered_map>

#include "host/scene/mesh.h"
#include "host/scene/text.h"

namespace pave {
namespace {

// A general importer would be shorter, but the one at hand (assimp 5.2) gives every face corner a
// vertex of its own, so that smooth normals are lost, and takes faces that are not whole.
class ObjReader {
   public:
    explicit ObjReader(std::string_view text) : text_(text) {}

    Mesh read() {
        for (size_t at = 0; at < text_.size();) {
            const size_t end = std::min(text_.find('\n', at), text_.size());
            ++line_;
            read_line(text_.substr(at, end - at));
            at = end + 1;
        }
        if (faces_with_normals_ != 0 && faces_without_normals_ != 0)
            throw MeshError(std::to_string(faces_without_normals_) + " of " +
                            std::to_string(faces_with_normals_ + faces_without_normals_) +
                            " faces have no normals; give all or none");
        if (faces_with_normals_ == 0) mesh_.normals.clear();
        if (!has_all_texcoords_) mesh_.texcoords.clear();
        return std::move(mesh_);
    }

   private:
    struct Corner {
        uint32_t position = 0, texture = 0, normal = 0;  // 1-based, 0: absent
        bool operator==(const Corner&) const = default;
    };
    struct CornerHash {
        size_t operator()(const Corner& corner) const {
            return (corner.position * size_t{0x9E3779B97F4A7C15}) ^
                   (corner.texture * size_t{0xC2B2AE3D27D4EB4F}) ^
                   (corner.normal * size_t{0x165667B19E3779F9});
        }
    };

    [[noreturn]] void fail(const std::string& reason) const {
        throw MeshError(std::to_string(line_) + ": " + reason);
    }

    void read_line(std::string_view line) {
        line = trim(line.substr(0, line.find('#')));
        if (line.ends_with('\\')) fail("lines continued by \\ are not supported");
        const std::vector<std::string_view> words = split_words(line);
        if (words.empty()) return;
        if (words[0] == "v") {
            positions_.push_back(read_three(words));
        } else if (words[0] == "vn") {
            normals_.push_back(read_three(words));
        } else if (words[0] == "vt") {
            texcoords_.push_back(read_texcoord(words));
        } else if (words[0] == "f") {
            read_face(words);
        }  // groups, materials, smoothing, lines: no part of the surface
    }

    std::array<float, 3> read_three(const std::vector<std::string_view>& words) const {
        if (words.size() < 4) fail("needs three numbers");
        std::array<float, 3> result{};
        for (size_t i = 0; i < 3; ++i) {
            const std::optional<double> number = parse_number(words[i + 1]);
            if (!number) fail(quote(words[i + 1]) + " is not a finite number");
            result[i] = static_cast<float>(*number);
        }
        return result;
    }

    // u and, if there, v.
    std::array<float, 2> read_texcoord(const std::vector<std::string_view>& words) const {
        if (words.size() < 2) fail("needs a number");
        std::array<float, 2> result{};
        for (size_t i = 0; i < std::min<size_t>(2, words.size() - 1); ++i) {
            const std::optional<double> number = parse_number(words[i + 1]);
            if (!number) fail(quote(words[i + 1]) + " is not a finite number");
            result[i] = static_cast<float>(*number);
        }
        return result;
    }

    // A 1-based index, or one counted back from the newest.
    uint32_t read_index(std::string_view word, size_t count, const char* what) const {
        const std::optional<int64_t> index = parse_integer(word);
        if (!index) fail("face: " + quote(word) + " is not an index");
        const int64_t absolute = *index < 0 ? static_cast<int64_t>(count) + 1 + *index : *index;
        if (absolute < 1 || absolute > static_cast<int64_t>(count))
            fail("face: " + std::string(what) + " " + std::to_string(*index) +
                 " is out of range, there are " + std::to_string(count) + " before this line");
        return static_cast<uint32_t>(absolute);
    }

    // position, position/texture, position//normal or position/texture/normal.
    Corner read_corner(std::string_view word) const {
        Corner corner;
        const size_t first = word.find('/');
        corner.position = read_index(word.substr(0, first), positions_.size(), "vertex");
        if (first == std::string_view::npos) return corner;
        const size_t second = word.find('/', first + 1);
        const std::string_view texture = word.substr(first + 1, second - first - 1);
        if (!texture.empty())
            corner.texture = read_index(texture, texcoords_.size(), "texture vertex");
        if (second != std::string_view::npos)
            corner.normal = read_index(word.substr(second + 1), normals_.size(), "normal");
        return corner;
    }

    uint32_t vertex_of(const Corner& corner) {
        const auto [entry, is_new] =
            vertices_.emplace(corner, static_cast<uint32_t>(mesh_.positions.size()));
        if (is_new) {
            if (mesh_.positions.size() >= std::numeric_limits<uint32_t>::max())
                fail("too many vertices");
            mesh_.positions.push_back(positions_[corner.position - 1]);
            mesh_.normals.push_back(corner.normal == 0 ? std::array<float, 3>{}
                                                       : normals_[corner.normal - 1]);
            mesh_.texcoords.push_back(corner.texture == 0 ? std::array<float, 2>{}
                                                          : texcoords_[corner.texture - 1]);
        }
        return entry->second;
    }

    void read_face(const std::vector<std::string_view>& words) {
        if (words.size() < 4) fail("a face needs three vertices");
        std::vector<uint32_t> polygon;
        bool has_all_normals = true;
        for (size_t i = 1; i < words.size(); ++i) {
            const Corner corner = read_corner(words[i]);
            has_all_normals = has_all_normals && corner.normal != 0;
            has_all_texcoords_ = has_all_texcoords_ && corner.texture != 0;
            polygon.push_back(vertex_of(corner));
        }
        ++(has_all_normals ? faces_with_normals_ : faces_without_normals_);
        for (size_t i = 2; i < polygon.size(); ++i)
            mesh_.triangles.push_back({polygon[0], polygon[i - 1], polygon[i]});
    }

    std::string_view text_;
    size_t line_ = 0;
    std::vector<std::array<float, 3>> positions_, normals_;
    std::vector<std::array<float, 2>> texcoords_;
    bool has_all_texcoords_ = true;
    size_t faces_with_normals_ = 0, faces_without_normals_ = 0;
    std::unordered_map<Corner, uint32_t, CornerHash> vertices_;
    Mesh mesh_;
};

}  // namespace

Mesh parse_obj(std::string_view text) { return ObjReader(text).read(); }

}  // namespace pave
