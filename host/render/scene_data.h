// A scene as the kernels read it: shapes, tables, tree and lights, ready to be uploaded.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "host/device/cl.h"
#include "host/render/bvh_build.h"
#include "host/render/double3.h"
#include "kernels/render_types.h"
#include "pave/render.h"

namespace pave {

/// A row of the tables and of the tree; integers lie in it bit by bit (see kernels/render_types.h).
using Row = std::array<float, 8>;
float as_float_bits(uint32_t bits);

/// What the tree and the shadow tests know of a primitive.
struct Primitive {
    enum class Kind { kTriangle, kFlat, kCube, kSphere };
    Kind kind = Kind::kTriangle;
    uint32_t index = 0;  // of its own kind
    Aabb bounds;
};

struct SceneData {
    std::vector<kernel::FlatShape> flats;  // rectangles, then disks
    std::vector<kernel::CubeShape> cubes;
    std::vector<kernel::SphereShape> spheres;
    int rect_count = 0, rect_shadow = 0, disk_shadow = 0;
    bool broadcast = true;  // shapes are tested in loops, not in the tree
    bool repeat_shapes =
        true;  // and stored once a lane; programs for any scene read them as plain floats

    std::vector<Row> surfaces, triangles, normals, bsdfs, lights;
    std::vector<Row> uvs, textures;                            // empty in a scene without textures
    std::vector<Row> environment;                              // its image; three rows without one
    std::vector<std::array<std::array<float, 3>, 3>> corners;  // of the triangles, for the tree
    int surface_count = 0, light_count = 0;  // tables have one empty entry where the scene has none
    std::vector<uint32_t> light_cdf;
    float environment_pmf = 0;

    std::vector<Row> nodes, leaves;
    int stack = 0;  // entries that walking the tree needs at most
    std::array<float, 3> tree_bound{};

    Aabb bounds;
    float offset_floor = 0;
    int dropped_triangles = 0;
    Defines features;
};

/// Throws InputError, naming the shape, for what can not be rendered: a singular transform, a
/// sphere scaled unevenly, an index out of range. Triangles without an area or with NaN are dropped
/// and counted.
SceneData build_scene_data(const Scene& scene, const RendererPaths& paths);

// ---- Steps of build_scene_data, each in its own file ----

/// Shapes, surfaces, triangles and materials; fills `emitters` with the lights that area emitters
/// become.
struct LightSource {
    int kind = 0;
    Double3 p{}, e1{}, e2{}, normal{};
    double radius = 0, area = 0;
    Rgb radiance{};
    double power = 0;
    int normals = -1;
};
void add_materials(const Scene& scene, SceneData& data);
/// Textures and their texels.
void add_textures(const Scene& scene, SceneData& data);
/// Mean colour of a texture.
Rgb mean_colour(const Texture& texture);
void add_shapes(const Scene& scene, SceneData& data, std::vector<LightSource>& lights);
void add_triangles(const Scene& scene, SceneData& data, std::vector<LightSource>& lights);
void add_lights(const Scene& scene, SceneData& data, std::vector<LightSource> lights);
/// The image around the scene, if there is one; after the lights.
void add_environment(const Scene& scene, SceneData& data);
/// Puts the flat shapes that can stand between a surface and a light first.
void sort_occluders(const Scene& scene, SceneData& data, const RendererPaths& paths);
void add_tree(SceneData& data);
void add_features(const Scene& scene, SceneData& data, const RendererPaths& paths);

Aabb bounds_of(const kernel::FlatShape& flat);
Aabb bounds_of(const kernel::CubeShape& cube);
Aabb bounds_of(const kernel::SphereShape& sphere);
double luminance(const Rgb& rgb);
/// BITS of a surface or triangle of `shape`.
uint32_t surface_bits(const Scene& scene, const Shape& shape, int kind, bool inverted);
bool emits(const Shape& shape);
/// "shape 3 'lamp'", for errors.
std::string name_of(const Scene& scene, const Shape& shape);

}  // namespace pave
