// The scenes that PAVE ships: all load, and have what their comments promise.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <cmath>
#include <set>

#include "tests/host/scene/scene_files.h"

namespace pave::test {
namespace {

const std::filesystem::path kScenes = std::filesystem::path(PAVE_SOURCE_DIR) / "scenes";

Scene shipped(const std::string& name, const LoadOptions& options = {}) {
    return load_scene((kScenes / (name + ".xml")).string(), options);
}

const Shape& shape_of(const Scene& scene, const std::string& id) {
    for (const Shape& shape : scene.shapes)
        if (shape.id == id) return shape;
    throw std::runtime_error("no shape " + id);
}

TEST(Scenes, AllLoadWithDistinctHashes) {
    std::set<std::string> hashes;
    size_t count = 0;
    for (const auto& entry : std::filesystem::directory_iterator(kScenes)) {
        if (entry.path().extension() != ".xml") continue;
        const Scene scene = load_scene(entry.path().string());
        EXPECT_TRUE(scene.warnings.empty()) << entry.path();
        EXPECT_GE(scene.max_depth, 2) << entry.path();
        for (const Shape& shape : scene.shapes)
            EXPECT_LT(static_cast<size_t>(shape.bsdf), scene.bsdfs.size());
        hashes.insert(scene.hash);
        ++count;
    }
    EXPECT_GE(count, 6u);
    EXPECT_EQ(hashes.size(), count);
}

TEST(Scenes, CornellIsThePapersBox) {
    const Scene scene = shipped("cornell");
    EXPECT_EQ(scene.width, 256);
    EXPECT_EQ(scene.height, 256);
    EXPECT_EQ(scene.spp, 1000);
    EXPECT_EQ(scene.max_depth, 50);
    EXPECT_NEAR(scene.view.fov_x_degrees, 39.3, 1e-5);
    EXPECT_EQ(std::count_if(scene.shapes.begin(), scene.shapes.end(),
                            [](const Shape& s) { return s.is_emitter; }),
              1);
    EXPECT_EQ(std::count_if(scene.shapes.begin(), scene.shapes.end(),
                            [](const Shape& s) { return s.type == Shape::Type::kCube; }),
              3);
    for (size_t i = 0; i < 3; ++i) {
        EXPECT_NEAR(scene.bounds_min[i], -1, 1e-6);
        EXPECT_NEAR(scene.bounds_max[i], 1, 1e-6);
    }
    const auto normal =
        [&](const std::string& id) {  // of a rectangle that is only turned: its z column
            const Matrix4& m = shape_of(scene, id).world_from_object;
            return std::array<int, 3>{static_cast<int>(std::lround(m[2])),
                                      static_cast<int>(std::lround(m[6])),
                                      static_cast<int>(std::lround(m[10]))};
        };
    EXPECT_EQ(normal("light"), (std::array<int, 3>{0, -1, 0}));
    EXPECT_EQ(normal("floor"), (std::array<int, 3>{0, 1, 0}));
    EXPECT_EQ(normal("ceiling"), (std::array<int, 3>{0, -1, 0}));
    EXPECT_EQ(normal("back"), (std::array<int, 3>{0, 0, 1}));
    EXPECT_EQ(normal("left"), (std::array<int, 3>{1, 0, 0}));
    EXPECT_EQ(normal("right"), (std::array<int, 3>{-1, 0, 0}));
    const auto colour = [&](const std::string& id) {
        return scene.bsdfs[static_cast<size_t>(shape_of(scene, id).bsdf)].reflectance;
    };
    EXPECT_GT(colour("left")[0], 5 * colour("left")[1]);
    EXPECT_GT(colour("right")[1], 2 * colour("right")[0]);
    EXPECT_EQ(colour("floor"), colour("ceiling"));
}

TEST(Scenes, CuboidsNeitherTouchTheFloorNorEachOther) {
    for (const char* name : {"cornell", "novel"}) {
        const Scene scene = shipped(name);
        for (const Shape& shape : scene.shapes) {
            if (shape.type != Shape::Type::kCube) continue;
            const Matrix4& m = shape.world_from_object;
            for (size_t axis = 0; axis < 3; ++axis) {
                const float half =
                    std::abs(m[4 * axis]) + std::abs(m[4 * axis + 1]) + std::abs(m[4 * axis + 2]);
                EXPECT_LT(m[4 * axis + 3] + half, 1) << name << " " << shape.id;
                EXPECT_GT(m[4 * axis + 3] - half, -1) << name << " " << shape.id;
            }
        }
    }
}

TEST(Scenes, NovelIsLikeCornellButNotIt) {
    const Scene cornell = shipped("cornell"), novel = shipped("novel");
    EXPECT_EQ(cornell.view, novel.view);
    EXPECT_EQ(cornell.max_depth, novel.max_depth);
    EXPECT_EQ(shape_of(cornell, "floor").world_from_object,
              shape_of(novel, "floor").world_from_object);
    EXPECT_NE(shape_of(cornell, "light").world_from_object,
              shape_of(novel, "light").world_from_object);
    EXPECT_THROW(shape_of(novel, "tall"), std::runtime_error);
}

TEST(Scenes, FurnacesTakeTheirParameters) {
    for (const char* name : {"furnace-sphere", "furnace-cube"}) {
        const Scene scene = shipped(
            name, {.defines = {{"albedo", "0.8"}, {"radiance", "0.2"}, {"max_depth", "12"}}});
        ASSERT_EQ(scene.shapes.size(), 1u);
        EXPECT_TRUE(scene.shapes[0].flip_normals);
        EXPECT_EQ(scene.shapes[0].radiance, (Rgb{0.2f, 0.2f, 0.2f}));
        EXPECT_EQ(scene.bsdfs[static_cast<size_t>(scene.shapes[0].bsdf)].reflectance,
                  (Rgb{0.8f, 0.8f, 0.8f}));
        EXPECT_EQ(scene.max_depth, 12);
    }
}

class SceneDocs : public SceneFiles {};

TEST_F(SceneDocs, ExamplesLoad) {
    std::ifstream stream(std::string(PAVE_SOURCE_DIR) + "/docs/scenes.md");
    const std::string text((std::istreambuf_iterator<char>(stream)), {});
    const std::string open = "```xml\n", close = "```\n";
    int count = 0;
    for (size_t at = text.find(open); at != std::string::npos;
         at = text.find(open, at + 1), ++count) {
        const size_t begin = at + open.size();
        const std::string example = text.substr(begin, text.find(close, begin) - begin);
        if (example.rfind("<scene", 0) != 0) {  // a part of one
            EXPECT_FALSE(load(example).shapes.empty()) << example;
            continue;
        }
        const Scene scene = load_scene(write("example.xml", example), {.defines = {{"spp", "16"}}});
        EXPECT_EQ(scene.spp, 16);
        EXPECT_EQ(scene.shapes.size(), 2u);
    }
    EXPECT_EQ(count, 2);
}

TEST(Scenes, MaterialsHaveEverything) {
    const Scene scene = shipped("materials");
    std::set<Bsdf::Type> types;
    std::set<Shape::Type> shapes;
    for (const Bsdf& bsdf : scene.bsdfs) types.insert(bsdf.type);
    for (const Shape& shape : scene.shapes) shapes.insert(shape.type);
    EXPECT_EQ(types.size(), 4u);
    EXPECT_EQ(shapes.size(), 5u);
    EXPECT_TRUE(scene.has_environment);
    EXPECT_EQ(scene.point_lights.size(), 1u);
    EXPECT_NEAR(scene.view.fov_x_degrees, 41.84642791748047,
                1e-4);  // Mitsuba's, of fov_axis "smaller"
}

}  // namespace
}  // namespace pave::test
