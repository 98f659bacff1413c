// The renderer as its callers see it: checks, metadata, frames of other memory, progress,
// cancellation, odd scenes.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <limits>

#include "pave/version.h"
#include "support.h"

namespace pave::test {
namespace {

template <class Exception, class Call>
std::string message_of(Call&& call) {
    try {
        call();
    } catch (const Exception& error) {
        return error.what();
    } catch (const std::exception& error) {
        return std::string("another type: ") + error.what();
    }
    return "no exception";
}

TEST(RendererOptions, AreChecked) {
    Renderer renderer(device(), cornell());
    const auto message = [&](const RenderOptions& options) {
        return message_of<UsageError>([&] { render(renderer, 4, 4, {"color"}, options); });
    };
    EXPECT_EQ(message({.spp = 0}), "spp 0 is outside 1..16777216");
    EXPECT_EQ(message({.spp = (1 << 24) + 1}), "spp 16777217 is outside 1..16777216");
    EXPECT_EQ(message({.max_depth = 0}), "max_depth 0 is outside 1..2147483647");
    EXPECT_NE(message({.rr_depth = -1}).find("rr_depth -1"), std::string::npos);
    EXPECT_NE(message({.max_depth = 1 << 20, .rr_depth = 1 << 20}).find("need roulette"),
              std::string::npos);
    EXPECT_NE(message({.frame_index = -1}).find("frame_index -1"), std::string::npos);
    EXPECT_NE(message({.frame_index = int64_t{1} << 32}).find("frame_index"), std::string::npos);
    EXPECT_NE(message({.tile_rows = -2}).find("tile_rows -2"), std::string::npos);
    EXPECT_NE(message({.work_group_size = -1}).find("work_group_size -1"), std::string::npos);
    EXPECT_NE(message({.lane_width = 3}).find("lane_width 3"), std::string::npos);
    EXPECT_EQ(message({.max_depth = 2147483647}), "no exception");
}

TEST(RendererOptions, ViewsAreChecked) {
    Renderer renderer(device(), cornell());
    Frame frame = make_frame(FrameSchema::of_known(4, 4, {"color"}), const_cast<Device&>(device()));
    const auto message = [&](const View& view) {
        return message_of<UsageError>([&] { renderer.render(view, {.spp = 1}, frame); });
    };
    for (float fov : {0.0f, -3.0f, 180.0f, std::nanf("")}) {
        View view = cornell().view;
        view.fov_x_degrees = fov;
        EXPECT_NE(message(view).find("field of view"), std::string::npos) << fov;
    }
    for (size_t i = 0; i < 12; ++i) {
        View view = cornell().view;
        view.world_from_camera[i] = std::nanf("");
        EXPECT_NE(message(view).find("not finite"), std::string::npos);
    }
    View flat;
    flat.world_from_camera.fill(0);
    EXPECT_NE(message(flat).find("singular"), std::string::npos);
}

TEST(Renderer, RefusesFramesWithoutItsChannels) {
    Renderer renderer(device(), cornell());
    Frame none;
    EXPECT_NE(message_of<UsageError>([&] { renderer.render({}, {}, none); }).find("needs a frame"),
              std::string::npos);
    Frame drawn = make_frame(FrameSchema::of_known(4, 4, {"drawn"}));
    EXPECT_NE(message_of<UsageError>([&] { renderer.render({}, {}, drawn); }).find("no channel"),
              std::string::npos);
    Frame wrong = make_frame(FrameSchema(4, 4, {{"color", 1}}));
    EXPECT_NE(
        message_of<UsageError>([&] { renderer.render({}, {}, wrong); }).find("1 planes, not 3"),
        std::string::npos);
}

TEST(Renderer, FillsTheMetadata) {
    Scene scene = cornell();
    scene.hash = "0123";
    const Frame frame =
        render(scene, 4, 4, {"color"}, {.spp = 3, .max_depth = 7, .seed = 11, .frame_index = 5});
    const FrameMetadata& m = frame.metadata();
    EXPECT_EQ(m.index, 5);
    EXPECT_EQ(m.spp, 3);
    EXPECT_EQ(m.max_depth, 7);
    EXPECT_EQ(m.seed, 11u);
    EXPECT_EQ(m.view, scene.view);
    EXPECT_EQ(m.scene, "cornell-by-hand");
    EXPECT_EQ(m.scene_hash, "0123");
    EXPECT_EQ(m.device, device().profile().name);
    EXPECT_EQ(m.driver, device().profile().driver);
    EXPECT_EQ(m.kernel_hash, Device::kernel_hash());
    EXPECT_EQ(m.program_version, program_version());
    EXPECT_EQ(m.program_commit, program_commit());
    EXPECT_GT(m.seconds_spent, 0.0);
}

TEST(Renderer, FramesOfOtherMemoryGetACopy) {
    Renderer renderer(device(), cornell());
    const RenderOptions options{.spp = 4};
    const FrameSchema schema = FrameSchema::of_known(9, 5, {"drawn", "color", "depth"});
    Frame mine = make_frame(schema, const_cast<Device&>(device())), other = make_frame(schema);
    std::fill(other.channel("drawn").begin(), other.channel("drawn").end(), 3.0f);
    std::fill(mine.channel("drawn").begin(), mine.channel("drawn").end(), 3.0f);
    renderer.render(cornell().view, options, mine);
    renderer.render(cornell().view, options, other);
    EXPECT_TRUE(same_bits(mine, other, "color"));
    EXPECT_TRUE(same_bits(mine, other, "depth"));
    for (float x : other.channel("drawn"))
        EXPECT_EQ(x, 3.0f) << "channels of others are left alone";
    for (float x : mine.channel("drawn")) EXPECT_EQ(x, 3.0f);
    EXPECT_EQ(other.metadata().spp, 4);
}

TEST(Renderer, WritesOnlyItsChannels) {
    // Odd sizes: the padding behind each channel of the slot must stay what it was.
    const FrameSchema schema = FrameSchema::of_known(
        13, 7, {"color", "albedo", "direct", "normal", "depth", "variance", "object"});
    Frame frame = make_frame(schema, const_cast<Device&>(device()));
    std::byte* data = frame.slot()->data;
    std::fill(data, data + schema.slot_byte_size(), std::byte{0x5a});
    Renderer renderer(device(), cornell());
    renderer.render(cornell().view, {.spp = 2}, frame);
    std::vector<bool> inside(schema.slot_byte_size(), false);
    for (size_t i = 0; i < schema.channels().size(); ++i)
        for (size_t b = 0; b < schema.channel_byte_size(static_cast<int>(i)); ++b)
            inside[schema.channel_byte_offset(static_cast<int>(i)) + b] = true;
    for (size_t b = 0; b < inside.size(); ++b)
        if (!inside[b]) {
            ASSERT_EQ(data[b], std::byte{0x5a}) << "byte " << b;
        }
}

TEST(Renderer, ReportsProgressAndCanBeCancelled) {
    Renderer renderer(device(), cornell());
    std::vector<double> seen;
    RenderOptions options{.spp = 2, .tile_rows = 2};
    options.progress = [&](double done) {
        seen.push_back(done);
        return true;
    };
    render(renderer, 8, 8, {"color"}, options);
    ASSERT_EQ(seen.size(), 4u);
    EXPECT_TRUE(std::is_sorted(seen.begin(), seen.end()));
    EXPECT_DOUBLE_EQ(seen.back(), 1.0);
    options.progress = [](double) { return false; };
    EXPECT_EQ(message_of<RunError>([&] { render(renderer, 8, 8, {"color"}, options); }),
              "render cancelled");
    options.progress = {};
    EXPECT_NO_THROW(render(renderer, 8, 8, {"color"}, options))
        << "a cancelled render leaves the renderer usable";
}

TEST(Renderer, StandsOddScenes) {
    const std::vector<std::string> channels{"color", "albedo",   "direct", "normal",
                                            "depth", "variance", "object"};
    Scene empty;
    empty.view = look_at({0, 0, 1}, {0, 0, 0}, {0, 1, 0}, 40);
    EXPECT_EQ(mean(render(empty, 3, 5, channels, {.spp = 2}), "color"), 0.0);
    Scene sky = empty;
    sky.has_environment = true;
    sky.environment = {0.25f, 0.5f, 1};
    for (bool specialise : {true, false}) {
        const Frame frame = render(sky, 1, 1, channels, {.spp = 7}, {.specialise = specialise});
        EXPECT_FLOAT_EQ(frame.channel("color")[0], 0.25f);
        EXPECT_FLOAT_EQ(frame.channel("direct")[2], 1.0f);
    }
    Scene dark = cornell();
    for (Shape& shape : dark.shapes) shape.is_emitter = false;
    EXPECT_EQ(mean(render(dark, 5, 5, channels, {.spp = 4}), "color"), 0.0);
    Scene inside = cornell();  // a camera inside a cuboid
    inside.view = look_at({0.35f, -0.7f, 0.3f}, {0, 0, 0}, {0, 1, 0}, 90);
    Renderer renderer(device(), inside);
    render(renderer, 8, 8, channels, {.spp = 4});
    EXPECT_EQ(renderer.dropped_samples(), 0u);
}

TEST(Renderer, CountsSamplesThatAreNotFinite) {
    Scene scene = cornell();
    scene.bsdfs[0].reflectance = {std::nanf(""), 0.5f, 0.5f};
    Renderer renderer(device(), scene);
    const Frame frame = render(renderer, 16, 16, {"color", "direct", "variance"}, {.spp = 16});
    EXPECT_GT(renderer.dropped_samples(), 0u);
    for (const char* channel : {"color", "direct", "variance"})
        for (float x : frame.channel(channel)) ASSERT_TRUE(std::isfinite(x)) << channel;
    Renderer sane(device(), menagerie());
    render(sane, 32, 32, {"color"}, {.spp = 64});
    EXPECT_EQ(sane.dropped_samples(), 0u);
}

TEST(Renderer, StandsVerticesThatAreNoPoints) {
    Scene scene = cornell();
    Shape& ball = add_mesh(scene, sphere_mesh(12, {0.3f, 0.1f, 0.3f}, 0.3f, false), 1);
    Renderer sound(device(), scene);
    const auto first = static_cast<uint32_t>(ball.mesh.positions.size());
    constexpr float kInfinity = std::numeric_limits<float>::infinity();
    for (const float bad : {std::nanf(""), kInfinity, -kInfinity})
        ball.mesh.positions.push_back({0, bad, 0});
    for (uint32_t i = 0; i < 60; ++i) ball.mesh.triangles.push_back({i, i + 1, first + i % 3});
    Renderer renderer(device(), scene);
    EXPECT_EQ(renderer.dropped_triangles(), 60);
    const std::vector<std::string> channels{"color", "direct", "variance", "normal"};
    const Frame expected = render(sound, 24, 24, channels, {.spp = 16}),
                frame = render(renderer, 24, 24, channels, {.spp = 16});
    EXPECT_EQ(renderer.dropped_samples(), 0u);
    for (const std::string& channel : channels) EXPECT_TRUE(same_bits(expected, frame, channel));
}

TEST(Renderer, RefusesScenesThatItCannotRender) {
    const auto message = [](const Scene& scene) {
        return message_of<InputError>([&] { Renderer(device(), scene); });
    };
    Scene scene;
    const int grey = add_diffuse(scene, {0.5f, 0.5f, 0.5f});
    scene.name = "odd";
    add_shape(scene, Shape::Type::kSphere, scale(1, 2, 1), grey).id = "egg";
    EXPECT_EQ(message(scene),
              "scene 'odd': shape 0 'egg': a sphere can only be scaled evenly; use a mesh for an "
              "ellipsoid");
    scene.shapes[0].type = Shape::Type::kCube;
    scene.shapes[0].world_from_object = scale(1, 0, 1);
    EXPECT_NE(message(scene).find("no volume"), std::string::npos);
    scene.shapes[0].type = Shape::Type::kRectangle;
    EXPECT_NE(message(scene).find("no area"), std::string::npos);
    scene.shapes[0].world_from_object = scale(std::numeric_limits<float>::infinity());
    EXPECT_NE(message(scene).find("no area"), std::string::npos);
    scene.shapes[0].world_from_object = scale(1);
    scene.shapes[0].bsdf = 4;
    EXPECT_NE(message(scene).find("material 4 of 1"), std::string::npos);
    scene.shapes[0].bsdf = 0;
    Mesh mesh = random_triangles(2, 1, 1);
    mesh.triangles[1][2] = 77;
    add_mesh(scene, mesh, grey);
    EXPECT_NE(message(scene).find("vertex 77 of 6"), std::string::npos);
}

}  // namespace
}  // namespace pave::test
