// Triangles of all meshes: corners, shading data, emitting triangles; the degenerate ones are
// dropped.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <numbers>

#include "host/render/scene_data.h"
#include "pave/error.h"

namespace pave {
namespace {

using Point = std::array<float, 3>;

constexpr size_t kChunk = 1 << 14;  // triangles that a thread takes

// Squared length of a face normal that float32 kernels can still normalise.
constexpr double kLeastSquaredArea = 1e-36;

Row row_of(const Point& a, float a3, const Point& b, float b3) {
    return {a[0], a[1], a[2], a3, b[0], b[1], b[2], b3};
}

/// A mesh, and what its triangles are known by.
struct Place {
    const Shape* shape;
    int object, part;  // object -1: of a group, where the instance tells
    Aabb* bounds;      // that grow
};

/// One mesh's triangles, those that have an area, chunk by chunk over all cores.
class MeshReader {
   public:
    MeshReader(const Scene& scene, const Place& place, SceneData& data, size_t first,
               Workers& workers)
        : scene_(scene),
          place_(place),
          shape_(*place.shape),
          mesh_(shape_.mesh),
          data_(data),
          first_(first),
          workers_(workers),
          chunks_((mesh_.triangles.size() + kChunk - 1) / kChunk) {}

    /// Appends corners and runs; returns how many triangles were kept.
    size_t read() {
        run_chunks(workers_, mesh_.triangles.size(), kChunk,
                   [&](size_t piece, size_t begin, size_t end) { read_chunk(piece, begin, end); });
        size_t kept = 0;
        for (size_t i = 0; i < chunks_.size(); ++i) {
            const Chunk& chunk = chunks_[i];
            Corners* const from = data_.corners.data() + first_ + i * kChunk;
            if (kept != i * kChunk)
                std::copy(from, from + chunk.kept, data_.corners.data() + first_ + kept);
            append_runs(chunk, first_ + kept);
            place_.bounds->grow(chunk.bounds);
            kept += chunk.kept;
        }
        data_.dropped_triangles += static_cast<int>(mesh_.triangles.size() - kept);
        return kept;
    }

    std::array<uint32_t, 3> vertices_of(size_t primitive) const {
        std::array<uint32_t, 3> vertex = mesh_.triangles[primitive];
        if (shape_.flip_normals) std::swap(vertex[1], vertex[2]);
        return vertex;
    }

   private:
    struct Chunk {
        size_t kept = 0;
        Aabb bounds;
        std::vector<TriangleRun> runs;  // counted from the chunk's first kept triangle
    };

    void read_chunk(size_t piece, size_t begin, size_t end) {
        Chunk chunk;
        Corners* to = data_.corners.data() + first_ + begin;
        bool in_run = false;
        for (size_t primitive = begin; primitive < end; ++primitive) {
            const std::array<uint32_t, 3> vertex = vertices_of(primitive);
            for (uint32_t index : vertex)
                if (index >= mesh_.positions.size())
                    throw InputError(name_of(scene_, shape_) + ": vertex " + std::to_string(index) +
                                     " of " + std::to_string(mesh_.positions.size()));
            const Corners corners{mesh_.positions[vertex[0]], mesh_.positions[vertex[1]],
                                  mesh_.positions[vertex[2]]};
            const bool keep = has_area(corners);
            if (keep && !in_run)
                chunk.runs.push_back({.first = static_cast<uint32_t>(chunk.kept),
                                      .primitive = static_cast<uint32_t>(primitive)});
            in_run = keep;
            if (!keep) continue;
            for (const Point& corner : corners) chunk.bounds.grow_to(corner);
            to[chunk.kept++] = corners;
        }
        chunks_[piece] = std::move(chunk);
    }

    void append_runs(const Chunk& chunk, size_t first) {
        for (TriangleRun run : chunk.runs) {
            run.first += static_cast<uint32_t>(first);
            run.shape = place_.object;
            run.part = place_.part;
            if (first > first_) {
                const TriangleRun& last = data_.triangle_runs.back();
                // The chunk before ended in the middle of a run.
                if (run.first - last.first == run.primitive - last.primitive) continue;
            }
            data_.triangle_runs.push_back(run);
        }
    }

    const Scene& scene_;
    const Place& place_;
    const Shape& shape_;
    const Mesh& mesh_;
    SceneData& data_;
    size_t first_;
    Workers& workers_;
    std::vector<Chunk> chunks_;
};

/// Calls use(triangle, primitive) for the kept triangles [first, last) of runs that cover them.
template <class Use>
void for_primitives(const std::vector<TriangleRun>& runs, size_t first, size_t last, Use use) {
    auto run = std::upper_bound(runs.begin(), runs.end(), first,
                                [](size_t at, const auto& r) { return at < r.first; }) -
               1;
    for (size_t i = first; i < last; ++i) {
        if (run + 1 != runs.end() && (run + 1)->first <= i) ++run;
        use(i, run->primitive + (i - run->first));
    }
}

/// Shading rows of the triangles [first, last) of `shape`; `lights` is that of `first`.
void write_rows(const Scene& scene, const Place& place, const MeshReader& reader, SceneData& data,
                size_t first, size_t last, size_t lights, Workers& workers) {
    const Shape& shape = *place.shape;
    const auto object = static_cast<uint32_t>(place.object);
    const uint32_t bits = surface_bits(scene, shape, SURFACE_FLAT, false);
    const bool smooth = !shape.mesh.normals.empty();
    const bool textured = has_texture(scene.bsdfs[static_cast<size_t>(shape.bsdf)]);
    const size_t uvs = data.uvs.size();
    data.triangles.resize(last * TRIANGLE_ROWS);
    data.smooth |= smooth;
    if (textured) data.uvs.resize(uvs + last - first);
    const auto write = [&](size_t triangle, size_t primitive) {
        const size_t i = triangle - first;
        const Corners& corners = data.corners[triangle];
        const std::array<uint32_t, 3> vertex = reader.vertices_of(primitive);
        std::array<float, 3> n{};  // packed
        for (size_t k = 0; k < 3 && smooth; ++k) {
            Point normal = shape.mesh.normals[vertex[k]];
            if (shape.flip_normals)
                for (float& x : normal) x = -x;
            n[k] = as_float_bits(pack_normal(normal));
        }
        data.triangles[triangle * TRIANGLE_ROWS] =
            row_of(corners[0], as_float_bits(bits), corners[1],
                   as_float_bits(static_cast<uint32_t>(lights + (emits(shape) ? i : 0))));
        data.triangles[triangle * TRIANGLE_ROWS + 1] =
            row_of(corners[2], as_float_bits(object), n,
                   as_float_bits(static_cast<uint32_t>(textured ? uvs + i : size_t{0xffffffff})));
        if (!textured) return;
        const auto& at = shape.mesh.texcoords;
        const auto &a = at[vertex[0]], &b = at[vertex[1]], &c = at[vertex[2]];
        data.uvs[uvs + i] = {a[0], a[1], b[0], b[1], c[0], c[1], 0, 0};
    };
    run_chunks(workers, last - first, kChunk, [&](size_t, size_t begin, size_t end) {
        for_primitives(data.triangle_runs, first + begin, first + end, write);
    });
}

}  // namespace

bool has_area(const Corners& corners) {
    const Double3 normal = cross(to_double3(corners[1]) - to_double3(corners[0]),
                                 to_double3(corners[2]) - to_double3(corners[0]));
    return is_finite(normal) && dot(normal, normal) > kLeastSquaredArea &&
           dot(normal, normal) < 1e36;
}

uint32_t pack_normal(const std::array<float, 3>& n) {
    const double x = n[0], y = n[1], z = n[2];
    const double sum = std::abs(x) + std::abs(y) + std::abs(z);
    if (!(sum > 0) || !std::isfinite(sum)) return 0;
    double u = x / sum, v = y / sum;
    if (z < 0) {
        const double folded = std::copysign(1 - std::abs(v), u);
        v = std::copysign(1 - std::abs(u), v);
        u = folded;
    }
    // From 1 up, so that no normal is 0.
    const auto coordinate = [](double c) {
        return static_cast<uint32_t>(std::lround(c * 32767) + 32768);
    };
    return coordinate(u) | coordinate(v) << 16;
}

LightSource light_of_triangle(const Corners& corners, const Rgb& radiance, int normals) {
    const Double3 p = to_double3(corners[0]);
    LightSource light{.kind = LIGHT_TRIANGLE,
                      .p = p,
                      .e1 = to_double3(corners[1]) - p,
                      .e2 = to_double3(corners[2]) - p};
    const Double3 area = cross(light.e1, light.e2);
    light.normal = normalized(area);
    light.area = length(area) / 2;
    light.radiance = radiance;
    light.power = std::numbers::pi * light.area * luminance(radiance);
    light.normals = normals;
    return light;
}

/// Appends the mesh's triangles at `kept`; returns where the next ones go.
static size_t add_mesh(const Scene& scene, const Place& place, SceneData& data,
                       std::vector<LightSource>& lights, bool tables, size_t kept,
                       Workers& workers) {
    const Shape& shape = *place.shape;
    const Mesh& mesh = shape.mesh;
    if (!mesh.normals.empty() && mesh.normals.size() != mesh.positions.size())
        throw InputError(name_of(scene, shape) + ": " + std::to_string(mesh.normals.size()) +
                         " normals for " + std::to_string(mesh.positions.size()) + " vertices");
    if (has_texture(scene.bsdfs[static_cast<size_t>(shape.bsdf)]) &&
        mesh.texcoords.size() != mesh.positions.size())
        throw InputError(name_of(scene, shape) + ": its material has a texture, but there are " +
                         std::to_string(mesh.texcoords.size()) + " texture coordinates for " +
                         std::to_string(mesh.positions.size()) + " vertices");
    MeshReader reader(scene, place, data, kept, workers);
    const size_t first = kept;
    kept += reader.read();
    if (!tables) return kept;
    write_rows(scene, place, reader, data, first, kept, lights.size(), workers);
    for (size_t i = first; i < kept && emits(shape); ++i)
        lights.push_back(light_of_triangle(data.corners[i], shape.radiance,
                                           mesh.normals.empty() ? -1 : static_cast<int>(i)));
    return kept;
}

void add_triangles(const Scene& scene, SceneData& data, std::vector<LightSource>& lights,
                   bool tables, Workers& workers) {
    size_t most = 0;
    for (const Shape* shape : data.shapes) most += shape->mesh.triangles.size();
    for (const GroupData& group : data.groups)
        for (const Shape& part : group.group->shapes) most += part.mesh.triangles.size();
    if (most > kMaxPrimitives)
        throw InputError("scene '" + scene.name + "': " + std::to_string(most) +
                         " triangles, at most " + std::to_string(kMaxPrimitives));
    data.corners = Block<Corners>(most);
    size_t kept = 0;
    for (size_t i = 0; i < data.shapes.size(); ++i) {
        const Shape& shape = *data.shapes[i];
        if (shape.type != Shape::Type::kMesh || !data.parts[i].empty()) continue;
        const Place place{&shape, static_cast<int>(object_of(scene, shape)), shape.part,
                          &data.bounds};
        kept = add_mesh(scene, place, data, lights, tables, kept, workers);
    }
    data.own_triangles = kept;
    for (GroupData& group : data.groups) {
        group.first = kept;
        const std::vector<Shape>& parts = group.group->shapes;
        for (size_t i = 0; i < parts.size(); ++i) {
            if (parts[i].type != Shape::Type::kMesh) continue;
            const Place place{&parts[i], -1, static_cast<int>(i), &group.bounds};
            kept = add_mesh(scene, place, data, lights, tables, kept, workers);
        }
        group.count = kept - group.first;
    }
    data.corners.shorten(kept);
}

}  // namespace pave
