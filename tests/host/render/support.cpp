// Scenes built by hand, renders and statistics for the tests of the path tracer.
// SPDX-License-Identifier: BSD-3-Clause
#include "support.h"

#include <cstring>
#include <random>

namespace pave::test {

Scene cornell() {
    Scene scene;
    scene.name = "cornell-by-hand";
    const int white = add_diffuse(scene, {0.73f, 0.73f, 0.73f}),
              red = add_diffuse(scene, {0.63f, 0.065f, 0.05f}),
              green = add_diffuse(scene, {0.14f, 0.45f, 0.091f});
    using Type = Shape::Type;
    add_shape(scene, Type::kRectangle, translate(0, -1, 0) * rotate(0, -90), white);  // floor
    add_shape(scene, Type::kRectangle, translate(0, 1, 0) * rotate(0, 90), white);    // ceiling
    add_shape(scene, Type::kRectangle, translate(0, 0, -1), white);                   // back
    add_shape(scene, Type::kRectangle, translate(-1, 0, 0) * rotate(1, 90),
              red);  // seen on the left
    add_shape(scene, Type::kRectangle, translate(1, 0, 0) * rotate(1, -90), green);
    Shape& light =
        add_shape(scene, Type::kRectangle,
                  translate(0, 0.999f, 0) * rotate(0, 90) * scale(0.25f, 0.2f, 1), white);
    make_emitter(light, {17, 12, 4});
    add_shape(scene, Type::kCube,
              translate(-0.35f, -0.4f, -0.3f) * rotate(1, 17) * scale(0.3f, 0.6f, 0.3f), white);
    add_shape(scene, Type::kCube,
              translate(0.35f, -0.7f, 0.3f) * rotate(1, -18) * scale(0.3f, 0.3f, 0.3f), white);
    add_shape(scene, Type::kCube,
              translate(-0.5f, -0.85f, 0.5f) * rotate(1, 35) * scale(0.15f, 0.15f, 0.15f), white);
    scene.view = look_at({0, 0, 3.9f}, {0, 0, 0}, {0, 1, 0}, 39.3f);
    return scene;
}

Mesh sphere_mesh(int rows, std::array<float, 3> center, float radius, bool smooth) {
    Mesh mesh;
    const int columns = 2 * rows;
    const auto point = [&](int row, int column) {
        const double theta = M_PI * row / rows, phi = 2 * M_PI * (column % columns) / columns;
        return std::array<float, 3>{static_cast<float>(std::sin(theta) * std::cos(phi)),
                                    static_cast<float>(std::sin(theta) * std::sin(phi)),
                                    static_cast<float>(std::cos(theta))};
    };
    // Poles and the seam are shared, so that the mesh is closed.
    const auto index = [&](int row, int column) -> uint32_t {
        if (row == 0) return 0;
        if (row == rows) return 1;
        return static_cast<uint32_t>(2 + (row - 1) * columns + column % columns);
    };
    const auto add = [&](std::array<float, 3> n) {
        if (smooth) mesh.normals.push_back(n);
        mesh.positions.push_back(
            {center[0] + radius * n[0], center[1] + radius * n[1], center[2] + radius * n[2]});
    };
    add({0, 0, 1});
    add({0, 0, -1});
    for (int row = 1; row < rows; ++row)
        for (int column = 0; column < columns; ++column) add(point(row, column));
    for (int row = 0; row < rows; ++row)
        for (int column = 0; column < columns; ++column) {
            const uint32_t a = index(row, column), b = index(row + 1, column),
                           c = index(row + 1, column + 1), d = index(row, column + 1);
            if (row + 1 < rows) mesh.triangles.push_back({a, b, c});
            if (row > 0) mesh.triangles.push_back({a, c, d});
        }
    return mesh;
}

Mesh random_triangles(int count, float size, uint32_t seed) {
    std::mt19937 rng(seed);
    std::uniform_real_distribution<float> unit(-1.0f, 1.0f);
    Mesh mesh;
    for (int i = 0; i < count; ++i) {
        const std::array<float, 3> center{unit(rng), unit(rng), unit(rng)};
        const auto first = static_cast<uint32_t>(mesh.positions.size());
        for (int corner = 0; corner < 3; ++corner)
            mesh.positions.push_back({center[0] + size * unit(rng), center[1] + size * unit(rng),
                                      center[2] + size * unit(rng)});
        mesh.triangles.push_back({first, first + 1, first + 2});
    }
    return mesh;
}

Scene menagerie() {
    Scene scene = cornell();
    scene.name = "menagerie";
    scene.shapes.resize(6);  // the box and its light
    const int blue = add_diffuse(scene, {0.1f, 0.2f, 0.6f}, true);
    const int glass = add_material(scene, Bsdf::Type::kDielectric);
    const int mirror = add_material(scene, Bsdf::Type::kConductor);
    const int gold = add_material(scene, Bsdf::Type::kRoughConductor);
    Bsdf& brushed = scene.bsdfs.back();
    brushed.two_sided = true;
    brushed.eta = {0.14f, 0.37f, 1.44f};
    brushed.k = {3.98f, 2.39f, 1.6f};
    brushed.alpha_u = 0.1f;
    brushed.alpha_v = 0.4f;
    const int frosted = add_material(scene, Bsdf::Type::kRoughDielectric);
    scene.bsdfs.back().alpha_u = scene.bsdfs.back().alpha_v = 0.3f;
    const int plastic = add_material(scene, Bsdf::Type::kPlastic);
    scene.bsdfs.back().reflectance = {0.6f, 0.2f, 0.4f};
    scene.bsdfs.back().nonlinear = true;
    scene.textures.resize(2);
    scene.textures[0].image = {.width = 2, .height = 1, .bytes = {200, 40, 10, 0, 30, 90, 220, 0}};
    scene.textures[1].type = Texture::Type::kCheckerboard;
    scene.textures[1].uv_map = {5, 0, 0, 0, 3, 0};
    const int painted = add_diffuse(scene, {1, 1, 1});
    scene.bsdfs.back().reflectance_texture = 0;
    scene.bsdfs[static_cast<size_t>(plastic)].specular_reflectance_texture = 1;
    using Type = Shape::Type;
    add_shape(scene, Type::kDisk, translate(0.3f, -0.95f, 0.8f) * rotate(0, -80) * scale(0.15f),
              painted);
    Shape& ball = add_mesh(scene, sphere_mesh(4, {-0.7f, -0.1f, 0.5f}, 0.15f, true), painted);
    for (const auto& p : ball.mesh.positions) ball.mesh.texcoords.push_back({p[0] * 4, p[1] * 4});
    add_shape(scene, Type::kSphere, translate(-0.2f, -0.8f, 0.6f) * scale(0.2f), frosted);
    add_shape(scene, Type::kCube, translate(-0.65f, 0.75f, 0.2f) * rotate(1, 40) * scale(0.15f),
              plastic);
    add_shape(scene, Type::kSphere, translate(-0.55f, -0.7f, 0.3f) * scale(0.3f), glass);
    add_shape(scene, Type::kSphere, translate(0.55f, -0.7f, -0.4f) * scale(0.3f), mirror);
    add_shape(scene, Type::kCube, translate(0.5f, -0.75f, 0.45f) * rotate(1, 30) * scale(0.25f),
              gold);
    add_shape(scene, Type::kDisk, translate(0, -0.2f, -0.5f) * rotate(0, 30) * scale(0.3f, 0.2f, 1),
              blue);
    Shape& bulb =
        add_shape(scene, Type::kSphere, translate(-0.6f, 0.4f, -0.5f) * scale(0.1f), blue);
    make_emitter(bulb, {2, 4, 8});
    add_mesh(scene, sphere_mesh(12, {0.1f, 0.3f, 0}, 0.25f, true), gold);
    add_mesh(scene, sphere_mesh(6, {0.65f, 0.5f, 0.1f}, 0.2f, false), blue);
    Shape& tetra = add_mesh(scene, sphere_mesh(3, {0, -0.85f, 0.7f}, 0.12f, false), blue);
    make_emitter(tetra, {4, 1, 1});
    return scene;
}

Scene outdoors() {
    Scene scene;
    scene.name = "outdoors";
    scene.has_environment = true;
    scene.environment_map = {.width = 4, .height = 3};
    for (int i = 0; i < 36; ++i)
        scene.environment_map.floats.push_back(i == 7 ? 20.0f : 0.1f * static_cast<float>(i % 5));
    scene.environment = {0.7f, 0.7f, 0.7f};
    scene.map_from_world = {0.6f, 0.8f, 0, -0.8f, 0.6f, 0, 0, 0, 1};
    const int grey = add_diffuse(scene, {0.6f, 0.6f, 0.6f}),
              frosted = add_material(scene, Bsdf::Type::kRoughDielectric);
    using Type = Shape::Type;
    add_shape(scene, Type::kRectangle, translate(0, -0.5f, 0) * rotate(0, -90) * scale(2), grey);
    add_shape(scene, Type::kSphere, translate(-0.3f, 0, 0) * scale(0.5f), frosted);
    add_mesh(scene, sphere_mesh(4, {0.6f, 0, 0.2f}, 0.4f, true), grey);
    scene.view = look_at({0, 0.7f, 3}, {0, 0, 0}, {0, 1, 0}, 45);
    return scene;
}

Scene grove() {
    Scene scene = menagerie();
    scene.name = "grove";
    scene.shapes.resize(6);  // the box and its light
    const int painted = add_diffuse(scene, {1, 1, 1});
    scene.bsdfs.back().reflectance_texture = 0;
    const int red = add_diffuse(scene, {0.7f, 0.2f, 0.1f});  // black from behind
    const int glass = 5;
    Shape apple = mesh_shape(sphere_mesh(8, {0, 0.8f, 0}, 0.5f, true), painted);
    for (const auto& p : apple.mesh.positions) apple.mesh.texcoords.push_back({p[0] * 4, p[1] * 4});
    Shape ball;
    ball.type = Shape::Type::kSphere;
    ball.bsdf = glass;
    ball.world_from_object = translate(0.9f, 0.3f, 0) * scale(0.3f);
    const int tree =
                  add_group(scene, {apple, mesh_shape(random_triangles(60, 0.4f, 3), red)}, "tree"),
              pair =
                  add_group(scene, {ball, mesh_shape(sphere_mesh(6, {0, 0, 0}, 0.5f, false), red)});
    const Matrix4 shear{1, 0.6f, 0, 0, 0, 1, 0, 0, 0, 0.3f, 1, 0, 0, 0, 0, 1};
    add_instance(scene, tree, translate(-0.6f, -0.7f, 0) * scale(0.25f));
    add_instance(scene, tree,
                 translate(0, -0.6f, -0.4f) * rotate(1, 130) * scale(0.2f, 0.4f, 0.1f));
    add_instance(scene, tree, translate(0.6f, -0.6f, 0.1f) * scale(-0.25f, 0.25f, 0.25f));
    add_instance(scene, tree, translate(0.1f, 0.3f, 0) * shear * rotate(2, 170) * scale(0.2f));
    add_instance(scene, pair, translate(-0.5f, 0.3f, 0.2f) * rotate(0, 40) * scale(0.3f));
    add_instance(scene, pair, translate(0.6f, 0.4f, 0.2f) * rotate(2, 40) * scale(-0.3f));
    return scene;
}

Frame render(Renderer& renderer, int width, int height, const std::vector<std::string>& channels,
             const RenderOptions& options) {
    Frame frame =
        make_frame(FrameSchema::of_known(width, height, channels), const_cast<Device&>(device()));
    renderer.render(renderer.scene().view, options, frame);
    return frame;
}

Frame render(const Scene& scene, int width, int height, const std::vector<std::string>& channels,
             const RenderOptions& options, const RendererPaths& paths) {
    Renderer renderer(device(), scene, paths);
    return render(renderer, width, height, channels, options);
}

static size_t pixels_of(const Frame& frame) {
    return static_cast<size_t>(frame.schema().width()) *
           static_cast<size_t>(frame.schema().height());
}

double mean(const Frame& frame, const std::string& channel, size_t plane) {
    const size_t n = pixels_of(frame);
    double sum = 0;
    for (float x : frame.channel(channel).subspan(plane * n, n)) sum += x;
    return sum / static_cast<double>(n);
}

double standard_error(const Frame& frame, size_t plane) {
    return std::sqrt(mean(frame, "variance", plane) / static_cast<double>(pixels_of(frame)));
}

::testing::AssertionResult same_bits(const Frame& a, const Frame& b, const std::string& channel) {
    const auto x = a.channel(channel), y = b.channel(channel);
    if (x.size() != y.size()) return ::testing::AssertionFailure() << channel << ": sizes differ";
    size_t different = 0, first = x.size();
    for (size_t i = x.size(); i-- > 0;)
        if (std::memcmp(&x[i], &y[i], sizeof(float)) != 0) {
            ++different;
            first = i;
        }
    if (different == 0) return ::testing::AssertionSuccess();
    return ::testing::AssertionFailure()
           << channel << ": " << different << " of " << x.size() << " values differ, the first at "
           << first << ": " << x[first] << " and " << y[first];
}

::testing::AssertionResult same_image(const Frame& a, const Frame& b) {
    const size_t n = pixels_of(a);
    size_t far = 0;
    for (size_t i = 0; i < 3 * n; ++i) {
        const double gap = a.channel("color")[i] - b.channel("color")[i];
        const double spread =
            std::sqrt(static_cast<double>(a.channel("variance")[i]) + b.channel("variance")[i]);
        if (std::abs(gap) > 4.5 * spread + 1e-5) ++far;
    }
    // Beyond 4.5 sigma of a heavy-tailed pixel mean: measured at most 0.1 % between two seeds.
    if (static_cast<double>(far) > 0.003 * static_cast<double>(3 * n) + 1)
        return ::testing::AssertionFailure()
               << far << " of " << 3 * n << " values are more than 4.5 sigma apart";
    for (size_t c = 0; c < 3; ++c) {
        const double gap = mean(a, "color", c) - mean(b, "color", c);
        const double spread = std::hypot(standard_error(a, c), standard_error(b, c));
        if (std::abs(gap) > 4.5 * spread)
            return ::testing::AssertionFailure()
                   << "mean of colour " << c << ": " << mean(a, "color", c) << " and "
                   << mean(b, "color", c) << ", " << gap / spread << " sigma";
    }
    return ::testing::AssertionSuccess();
}

}  // namespace pave::test
