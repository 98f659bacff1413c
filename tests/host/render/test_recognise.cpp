// Small meshes made of boxes, rectangles and triangles: what is recognised, and that nothing else
// changes.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/scene_data.h"
#include "support.h"

namespace pave::test {
namespace {

/// Two triangles a quad; `jitter` moves the first corner of the first quad.
Mesh quads_mesh(const std::vector<std::array<std::array<float, 3>, 4>>& quads, float jitter = 0) {
    Mesh mesh;
    for (const auto& quad : quads) {
        const auto first = static_cast<uint32_t>(mesh.positions.size());
        mesh.positions.insert(mesh.positions.end(), quad.begin(), quad.end());
        mesh.triangles.push_back({first, first + 1, first + 2});
        mesh.triangles.push_back({first, first + 2, first + 3});
    }
    mesh.positions[0][0] += jitter;
    return mesh;
}

std::array<float, 3> apply(const Matrix4& m, float x, float y, float z) {
    return {m[0] * x + m[1] * y + m[2] * z + m[3], m[4] * x + m[5] * y + m[6] * z + m[7],
            m[8] * x + m[9] * y + m[10] * z + m[11]};
}

/// The shape as a mesh of quads with outward normals.
Mesh mesh_of(const Shape& shape, float jitter = 0) {
    std::vector<std::array<std::array<float, 3>, 4>> quads;
    const Matrix4& m = shape.world_from_object;
    if (shape.type == Shape::Type::kRectangle) {
        quads.push_back(
            {apply(m, -1, -1, 0), apply(m, 1, -1, 0), apply(m, 1, 1, 0), apply(m, -1, 1, 0)});
        return quads_mesh(quads, jitter);
    }
    for (size_t axis = 0; axis < 3; ++axis)
        for (float side : {-1.0f, 1.0f}) {
            auto& quad = quads.emplace_back();
            for (size_t k = 0; k < 4; ++k) {
                std::array<float, 3> p{};
                p[axis] = side;
                p[(axis + 1) % 3] = k == 0 || k == 3 ? -1.0f : 1.0f;
                p[(axis + 2) % 3] = k < 2 ? -side : side;
                quad[k] = apply(m, p[0], p[1], p[2]);
            }
        }
    return quads_mesh(quads, jitter);
}

/// The box with every shape as a mesh.
Scene meshes(float jitter = 0) {
    Scene scene = cornell();
    scene.name = "meshes";
    for (Shape& shape : scene.shapes) {
        Shape mesh = shape;
        mesh.type = Shape::Type::kMesh;
        mesh.mesh = mesh_of(shape, jitter);
        mesh.world_from_object = Shape{}.world_from_object;
        shape = mesh;
    }
    return scene;
}

size_t count_of(const SceneData& data, Shape::Type type) {
    size_t count = 0;
    for (const auto& parts : data.parts)
        for (const Shape& part : parts)
            count += part.type == type ? std::max(part.mesh.triangles.size(), size_t{1}) : 0;
    return count;
}

TEST(Recognise, FindsBoxesRectanglesAndTriangles) {
    const SceneData whole = build_scene_data(meshes(), {});
    EXPECT_EQ(count_of(whole, Shape::Type::kCube), 3u);
    EXPECT_EQ(count_of(whole, Shape::Type::kRectangle), 6u);
    EXPECT_TRUE(whole.corners.empty());
    EXPECT_EQ(whole.lights.size(), size_t{LIGHT_ROWS}) << "the light is one rectangle again";
    // One corner off: that quad stays two triangles, and its box is none.
    const SceneData broken = build_scene_data(meshes(0.01f), {});
    EXPECT_EQ(count_of(broken, Shape::Type::kCube), 0u);
    EXPECT_EQ(count_of(broken, Shape::Type::kMesh), 2u * 9);
    EXPECT_EQ(count_of(broken, Shape::Type::kRectangle), 3u * 5);
    EXPECT_EQ(broken.flat_count[FLAT_TRIANGLE], 18);
    EXPECT_TRUE(broken.corners.empty());
}

TEST(Recognise, LeavesOtherMeshesAlone) {
    Scene smooth = meshes();
    for (Shape& shape : smooth.shapes)
        shape.mesh.normals.resize(shape.mesh.positions.size(), {0, 0, 1});
    EXPECT_EQ(build_scene_data(smooth, {}).corners.size(), 48u);
    EXPECT_EQ(build_scene_data(meshes(), {.recognise_shapes = false}).corners.size(), 48u);
    EXPECT_EQ(build_scene_data(meshes(), {.broadcast_shapes = 8}).corners.size(), 48u)
        << "nine shapes would not fit";
    Scene large;
    add_mesh(large, sphere_mesh(12, {0, 0, 0}, 1, false), add_diffuse(large, {0.5f, 0.5f, 0.5f}));
    const SceneData data = build_scene_data(large, {});
    EXPECT_FALSE(data.corners.empty());
    // A box that is open, and one that is turned inside out.
    Scene odd;
    add_diffuse(odd, {0.5f, 0.5f, 0.5f});
    odd.shapes.assign(2, meshes().shapes.back());
    Shape &open = odd.shapes[0], &inverted = odd.shapes[1];
    open.bsdf = inverted.bsdf = 0;
    open.mesh.triangles.resize(10);
    for (auto& triangle : inverted.mesh.triangles) std::swap(triangle[1], triangle[2]);
    const SceneData odd_data = build_scene_data(odd, {});
    EXPECT_EQ(odd_data.parts[0].size(), 5u);
    ASSERT_EQ(odd_data.parts[1].size(), 1u);
    EXPECT_TRUE(odd_data.parts[1][0].flip_normals);
}

TEST(Recognise, ImageIsTheMeshs) {
    const std::vector<std::string> channels{"color",  "variance", "albedo",
                                            "normal", "depth",    "object"};
    for (float jitter : {0.0f, 0.01f}) {
        const Scene scene = meshes(jitter);
        RenderOptions options{.spp = 256, .sampler = Sampler::kIndependent};
        const Frame mesh = render(scene, 48, 48, channels, options, {.recognise_shapes = false});
        for (int lanes : {1, 8, 16}) {
            options.lane_width = lanes;
            const Frame shapes = render(scene, 48, 48, channels, options);
            EXPECT_TRUE(same_image(mesh, shapes)) << lanes << " lanes, jitter " << jitter;
            size_t others = 0;
            for (size_t i = 0; i < 48 * 48; ++i)
                others += mesh.channel("object")[i] != shapes.channel("object")[i];
            EXPECT_LE(others, 3u) << "pixels whose first sample falls on an edge";
        }
    }
}

}  // namespace
}  // namespace pave::test
