// A scene as the kernels read it: shapes, tables, tree and lights, ready to be uploaded.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "host/device/cl.h"
#include "host/render/block.h"
#include "host/render/bvh_build.h"
#include "host/render/double3.h"
#include "host/render/workers.h"
#include "kernels/render_types.h"
#include "pave/render.h"

namespace pave {

/// A row of the tables and of the tree; integers lie in it bit by bit (see kernels/render_types.h).
using Row = std::array<float, 8>;
float as_float_bits(uint32_t bits);

using Corners = std::array<std::array<float, 3>, 3>;

/// Triangles from `first` on, up to the next run's, are those of `shape`, or of `part` of a group,
/// from its `primitive` on: dropped ones end a run.
struct TriangleRun {
    uint32_t first = 0;
    int shape = -1, part = -1;
    uint32_t primitive = 0;
};

/// A group whose triangles are there once, with a tree of their own.
struct GroupData {
    const ShapeGroup* group = nullptr;
    size_t first = 0, count = 0;  // of `corners`
    Aabb bounds;
    Bvh8 tree;
};

/// Where it lies.
struct InstanceData {
    size_t group = 0;  // into SceneData::groups
    uint32_t object = 0;
    Axes world_from_group;
    Aabb bounds;  // in the world
};

struct SceneData {
    // What is traced as it stands, until the tables are made: the scene's own shapes but instances,
    // and shapes of groups that were copied to their instances' places.
    std::vector<const Shape*> shapes;
    std::vector<Shape> copies;
    // By those shapes: the rectangles and boxes that are traced in a mesh's place; or none.
    std::vector<std::vector<Shape>> parts;
    std::vector<GroupData> groups;  // those that are not copied
    std::vector<InstanceData> instances;

    std::vector<kernel::FlatShape> flats;  // rectangles, then disks, then triangles
    // By kind; the first flat_shadow of a kind can stand between a surface and a light.
    std::array<int, FLAT_KINDS> flat_count{}, flat_shadow{};
    // Across and along x, y, z: what has left `flats` and `cubes`; see host/render/axis_shapes.cpp.
    std::vector<kernel::AxisRect> axis_rects;
    std::vector<kernel::AxisCube> axis_cubes;
    std::array<int, 3> axis_rect_count{}, axis_shadow{}, axis_cube_count{};
    std::vector<kernel::CubeShape> cubes;
    std::vector<kernel::SphereShape> spheres;
    bool broadcast = true;  // shapes are tested in loops, not in the tree
    bool smooth = false;    // some mesh has vertex normals
    bool repeat_shapes =
        true;  // and stored once a lane; programs for any scene read them as plain floats

    std::vector<Row> surfaces, triangles, bsdfs, lights;
    std::vector<Row> uvs, textures;  // empty in a scene without textures
    std::vector<Row> environment;    // its image; three rows without one
    Block<Corners> corners;          // of the triangles, for the tree; those of groups come last
    size_t own_triangles = 0;        // that are in no group
    std::vector<TriangleRun> triangle_runs;
    int surface_count = 0, light_count = 0;  // tables have one empty entry where the scene has none
    std::vector<uint32_t> light_cdf;
    float environment_pmf = 0;

    Block<Row> tree;  // nodes, then leaves, then instances
    size_t leaf_row = 0, instance_row = 0;
    int stack = 0;  // entries that walking the tree needs at most
    std::array<float, 3> tree_bound{};

    Aabb bounds;
    float offset_floor = 0;
    int dropped_triangles = 0;
    Defines features;
};

/// Throws InputError, naming the shape, for what can not be rendered: a singular transform, a
/// sphere scaled unevenly, an index out of range. Triangles without an area or with NaN are dropped
/// and counted. Without `tables` the triangles have no shading rows and no lights: enough for ray
/// queries. Works on all cores; the result does not depend on their number.
SceneData build_scene_data(const Scene& scene, const RendererPaths& paths, bool tables = true);

// ---- Steps of build_scene_data, each in its own file ----

/// Shapes, surfaces, triangles and materials; fills `emitters` with the lights that area emitters
/// become.
struct LightSource {
    int kind = 0;
    Double3 p{}, e1{}, e2{}, normal{};
    double radius = 0, area = 0;
    Rgb radiance{};
    double power = 0;
    int normals = -1;  // triangle that has vertex normals
};
/// Fills `shapes`, `copies`, `groups` and `instances`. With `turn` the winding of mirrored copies
/// is turned, so that their front is the group's; without, triangles keep their vertices' order.
void place_instances(const Scene& scene, SceneData& data, const RendererPaths& paths, bool turn);
/// Trees of the groups, and with them the bounds of the instances; after the triangles.
void build_groups(SceneData& data, Workers& workers);
/// INSTANCE_ROWS rows; `root` is that of the group's tree.
void write_instance(const InstanceData& instance, const GroupData& group, uint32_t root, Row* rows);
/// Fills `parts`, unless the scene then has more than `most_shapes` analytic shapes. Corners move
/// by rounding alone.
void recognise_shapes(const Scene& scene, SceneData& data, size_t most_shapes);
void add_materials(const Scene& scene, SceneData& data);
/// Textures and their texels.
void add_textures(const Scene& scene, SceneData& data);
/// Mean colour of a texture.
Rgb mean_colour(const Texture& texture);
void add_shapes(const Scene& scene, SceneData& data, std::vector<LightSource>& lights);
void add_triangles(const Scene& scene, SceneData& data, std::vector<LightSource>& lights,
                   bool tables, Workers& workers);
LightSource light_of_triangle(const Corners& corners, const Rgb& radiance, int normals);
/// A unit vector as kernels/vertex.h unpacks it, within 7e-5; 0 for one without a direction.
uint32_t pack_normal(const std::array<float, 3>& n);
/// Whether float32 kernels can normalise the triangle's normal.
bool has_area(const Corners& corners);
void add_lights(const Scene& scene, SceneData& data, std::vector<LightSource> lights);
/// The image around the scene, if there is one; after the lights.
void add_environment(const Scene& scene, SceneData& data);
/// Puts the flat shapes that can stand between a surface and a light first.
void sort_occluders(const Scene& scene, SceneData& data, const RendererPaths& paths);
/// Moves the rectangles and cubes with edges along the coordinate axes to lists of their own.
void split_axis_shapes(SceneData& data);
void add_tree(SceneData& data, Workers& workers);
/// Boxes of the triangles [first, first + count), as the builder takes them, with `spare` behind
/// them.
Block<Box> triangle_boxes(const SceneData& data, size_t first, size_t count, size_t spare,
                          Workers& workers);
void add_features(const Scene& scene, SceneData& data, const RendererPaths& paths);

Aabb bounds_of(const kernel::FlatShape& flat);
Aabb bounds_of(const kernel::CubeShape& cube);
Aabb bounds_of(const kernel::SphereShape& sphere);
double luminance(const Rgb& rgb);
/// BITS of a surface or triangle of `shape`.
uint32_t surface_bits(const Scene& scene, const Shape& shape, int kind, bool inverted);
bool emits(const Shape& shape);
/// The number that channel `object` shows.
uint32_t object_of(const Scene& scene, const Shape& shape);
/// "shape 3 'lamp'", for errors.
std::string name_of(const Scene& scene, const Shape& shape);

}  // namespace pave
