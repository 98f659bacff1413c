// Image files and what is made of them; broken ones are one error, whatever their library does.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>
#include <csignal>
#include <sstream>

#include "host/scene/image.h"
#include "host/scene/isolate.h"
#include "scene_files.h"

namespace pave::test {
namespace {

std::string bytes_of(const std::string& name) {
    std::ifstream stream(std::string(PAVE_SOURCE_DIR) + "/scenes/textures/" + name,
                         std::ios::binary);
    std::ostringstream bytes;
    bytes << stream.rdbuf();
    EXPECT_FALSE(bytes.str().empty()) << name;
    return bytes.str();
}

TEST(Image, SoundFilesAreRead) {
    const Image png = decode_image(bytes_of("map.png"));
    EXPECT_EQ(png.width, 96);
    EXPECT_EQ(png.height, 64);
    ASSERT_EQ(png.bytes.size(), 4u * 96 * 64);
    // Its upper left corner is a grid line: a quarter of (0.15, 0.2, 0.9).
    EXPECT_NEAR(png.bytes[0], 0.25 * 0.155 * 255, 2);
    EXPECT_NEAR(png.bytes[2], 0.25 * 0.9 * 255, 2);
    const Image jpeg = decode_image(bytes_of("stone.jpg"));
    EXPECT_EQ(jpeg.width, 64);
    EXPECT_EQ(jpeg.bytes.size(), 4u * 64 * 64);
    const Image exr = decode_image(bytes_of("sky.exr"));
    EXPECT_EQ(exr.width, 64);
    EXPECT_EQ(exr.height, 32);
    ASSERT_EQ(exr.floats.size(), 3u * 64 * 32);
    EXPECT_GT(*std::max_element(exr.floats.begin(), exr.floats.end()), 20.0f) << "the sun";
}

TEST(Image, BrokenFilesAreAnErrorOrAnImage) {
    for (const char* name : {"map.png", "stone.jpg", "sky.exr"}) {
        const std::string whole = bytes_of(name);
        size_t refused = 0, tried = 0;
        const auto attempt = [&](const std::string& bytes) {
            ++tried;
            try {
                const Image image = decode_image(bytes);
                EXPECT_GT(image.width, 0);
            } catch (const ImageError& error) {
                ++refused;
                EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << name;
            }
        };
        for (size_t i = 0; i < 24; ++i) attempt(whole.substr(0, whole.size() * i / 24));
        EXPECT_EQ(refused, tried) << name << ": a cut file was taken";
        uint32_t state = 7;
        for (size_t i = 0; i < 48; ++i) {
            std::string bytes = whole;
            for (size_t k = 0; k < 1 + i % 4; ++k) {
                state = state * 1664525u + 1013904223u;
                // Headers are where harm is done; leave the first bytes, which tell the kind.
                const size_t range =
                    i % 2 == 0 ? std::min<size_t>(400, bytes.size()) : bytes.size();
                bytes[4 + state % (range - 4)] = static_cast<char>(state >> 24);
            }
            attempt(bytes);
        }
    }
    EXPECT_THROW(decode_image(""), ImageError);
    EXPECT_THROW(decode_image("GIF89a"), ImageError);
}

TEST(Isolate, SurvivesWhatItRuns) {
    EXPECT_EQ(run_isolated([] { return std::string(3 << 20, 'x'); }), std::string(3 << 20, 'x'));
    EXPECT_EQ(run_isolated([] { return std::string(); }), "");
    const auto reason = [](const std::function<std::string()>& work, IsolationLimits limits = {}) {
        try {
            run_isolated(work, limits);
        } catch (const IsolationError& error) {
            return std::string(error.what());
        }
        return std::string("no error");
    };
    EXPECT_EQ(reason([]() -> std::string { throw std::runtime_error("no good"); }), "no good");
    EXPECT_EQ(reason([]() -> std::string {
                  (void)std::raise(SIGSEGV);
                  return "";
              }),
              "makes its reader crash");
    EXPECT_EQ(reason(
                  []() -> std::string {
                      for (;;) ::usleep(1000);
                  },
                  {.seconds = 1}),
              "takes too long or gives too much");
    EXPECT_EQ(reason([] { return std::string(1 << 20, 'x'); }, {.result_byte_size = 1000}),
              "takes too long or gives too much");
}

class Textures : public SceneFiles {};

TEST_F(Textures, AreReadOnceWithTheirSettings) {
    const std::string map = std::string(PAVE_SOURCE_DIR) + "/scenes/textures/map.png";
    const Scene scene = load(
        "<texture type='bitmap' id='map'><string name='filename' value='" + map +
        "'/><string name='wrap_mode' value='mirror'/><string name='filter_type' value='nearest'/>"
        "<boolean name='raw' value='true'/><transform name='to_uv'><scale x='2' y='3'/>"
        "<translate x='0.5'/></transform></texture>"
        "<shape type='cube'><bsdf type='diffuse'><ref name='reflectance' id='map'/></bsdf></shape>"
        "<shape type='cube'><bsdf type='plastic'><ref name='diffuse_reflectance' id='map'/>"
        "<texture type='checkerboard' name='specular_reflectance'/></bsdf></shape>");
    ASSERT_EQ(scene.textures.size(), 2u);
    const Texture& bitmap = scene.textures[0];
    EXPECT_EQ(bitmap.id, "map");
    EXPECT_EQ(bitmap.wrap, Texture::Wrap::kMirror);
    EXPECT_TRUE(bitmap.is_nearest);
    EXPECT_TRUE(bitmap.is_raw);
    EXPECT_EQ(bitmap.uv_map, (std::array<float, 6>{2, 0, 0.5f, 0, 3, 0}));
    EXPECT_EQ(scene.textures[1].color0, (Rgb{0.4f, 0.4f, 0.4f}));
    const Bsdf &diffuse = scene.bsdfs[0], &plastic = scene.bsdfs[1];
    EXPECT_EQ(diffuse.reflectance_texture, 0);
    EXPECT_EQ(diffuse.reflectance, (Rgb{1, 1, 1}));
    EXPECT_EQ(plastic.reflectance_texture, 0);
    EXPECT_EQ(plastic.specular_reflectance_texture, 1);
}

TEST_F(Textures, NeedCoordinatesOfTheMesh) {
    write("plain.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    write("mapped.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0.25\nvt 0 1\nf 1/1 2/2 3/3\n");
    const auto body = [](const std::string& file) {
        return "<shape type='obj'><string name='filename' value='" + file +
               "'/><bsdf type='diffuse'><texture type='checkerboard' "
               "name='reflectance'/></bsdf></shape>";
    };
    EXPECT_NE(error_of(with_sensor(body("plain.obj"))).find("has no texture coordinates"),
              std::string::npos);
    const Scene scene = load(body("mapped.obj"));
    // Turned over, as rows of images are counted from the top.
    EXPECT_EQ(scene.shapes[0].mesh.texcoords[1], (std::array<float, 2>{1, 0.75f}));
}

TEST_F(Textures, BeyondOneAreRefused) {
    const std::string sky = std::string(PAVE_SOURCE_DIR) + "/scenes/textures/sky.exr";
    EXPECT_NE(error_of(with_sensor("<bsdf type='diffuse'><texture type='bitmap' "
                                   "name='reflectance'><string name='filename' value='" +
                                   sky + "'/></texture></bsdf>"))
                  .find("a reflectance must be in [0, 1]"),
              std::string::npos);
}

class EnvironmentMap : public SceneFiles {
   protected:
    static std::string body(const std::string& file, const std::string& extra = "") {
        return "<shape type='cube'/><emitter type='envmap'><string name='filename' value='" +
               std::string(PAVE_SOURCE_DIR) + "/scenes/textures/" + file + "'/>" + extra +
               "</emitter>";
    }
};

TEST_F(EnvironmentMap, IsReadScaledAndTurned) {
    const Scene scene = load(body("sky.exr",
                                  "<float name='scale' value='2'/><transform name='to_world'>"
                                  "<rotate y='1' angle='90'/></transform>"));
    const Image plain = decode_image(bytes_of("sky.exr"));
    EXPECT_TRUE(scene.has_environment);
    ASSERT_EQ(scene.environment_map.floats.size(), plain.floats.size());
    EXPECT_EQ(scene.environment_map.floats[100], 2 * plain.floats[100]);
    // The image's own axes in rows: its x is the world's -z, its z the world's x.
    EXPECT_NEAR(scene.map_from_world[2], -1, 1e-6);
    EXPECT_NEAR(scene.map_from_world[6], 1, 1e-6);
    EXPECT_GT(scene.environment[2], 0.1f);
    // Bytes are sRGB.
    const Scene map = load(body("map.png"));
    EXPECT_EQ(map.environment_map.floats.size(), 3u * 96 * 64);
    EXPECT_TRUE(map.environment_map.bytes.empty());
}

TEST_F(EnvironmentMap, ThatCannotBeIsRefused) {
    const auto expect = [&](const std::string& text, const std::string& reason) {
        EXPECT_NE(error_of(with_sensor(text)).find(reason), std::string::npos) << reason;
    };
    expect(body("none.exr"), "no such file");
    expect(body("sky.exr", "<float name='scale' value='-1'/>"), "must be in [0, 1e30]");
    expect(body("sky.exr", "<transform name='to_world'><scale value='2'/></transform>"),
           "an environment can only be turned");
    expect(body("sky.exr") + "<emitter type='constant'/>", "one constant or envmap emitter");
    expect("<shape type='cube'/><emitter type='envmap'/>", "needs a <string name=\"filename\">");
}

}  // namespace
}  // namespace pave::test
