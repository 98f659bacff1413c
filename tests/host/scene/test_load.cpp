// What load_scene makes of right files: defaults, parameters, materials, emitters, names, hash.
// Numbers said to be Mitsuba's were read back from scenes that Mitsuba 3.9.1 (scalar_rgb) had
// loaded.
// SPDX-License-Identifier: BSD-3-Clause
#include <cstdlib>

#include "tests/host/scene/scene_files.h"

namespace pave::test {
namespace {

class LoadScene : public SceneFiles {};

TEST_F(LoadScene, UsesMitsubasDefaults) {
    const Scene scene = load("<shape type='sphere'/>");
    EXPECT_EQ(scene.name, "scene");
    EXPECT_EQ(scene.width, 16);
    EXPECT_EQ(scene.height, 8);
    EXPECT_EQ(scene.spp, 4);
    EXPECT_EQ(scene.max_depth, std::numeric_limits<int>::max());  // no integrator: endless
    EXPECT_EQ(scene.rr_depth, 5);
    ASSERT_EQ(scene.shapes.size(), 1u);
    EXPECT_FALSE(scene.shapes[0].is_emitter);
    EXPECT_EQ(scene.bsdfs[0].type, Bsdf::Type::kDiffuse);
    EXPECT_EQ(scene.bsdfs[0].reflectance, (Rgb{0.5f, 0.5f, 0.5f}));
    EXPECT_NEAR(scene.view.fov_x_degrees, 42.31171417236328, 1e-4);  // of 50 mm at 16x8: Mitsuba's
    EXPECT_FALSE(scene.has_environment);
    EXPECT_TRUE(scene.warnings.empty());
}

TEST_F(LoadScene, EmittersWithoutMaterialAreBlack) {
    const Scene scene =
        load("<shape type='rectangle'><emitter type='area'/></shape><shape type='cube'/>");
    EXPECT_TRUE(scene.shapes[0].is_emitter);
    EXPECT_EQ(scene.shapes[0].radiance, (Rgb{1, 1, 1}));
    EXPECT_EQ(scene.bsdfs[static_cast<size_t>(scene.shapes[0].bsdf)].reflectance, (Rgb{0, 0, 0}));
    EXPECT_EQ(scene.bsdfs[static_cast<size_t>(scene.shapes[1].bsdf)].reflectance,
              (Rgb{0.5f, 0.5f, 0.5f}));
}

TEST_F(LoadScene, ReadsIntegrator) {
    const Scene endless = load("<integrator type='path'/><shape type='cube'/>");
    EXPECT_EQ(endless.max_depth, 2147483647);
    EXPECT_EQ(endless.rr_depth, 5);
    const Scene scene = load(
        "<integrator type='path'><integer name='max_depth' value='7'/>"
        "<integer name='rr_depth' value=' +3 '/></integrator><shape type='cube'/>");
    EXPECT_EQ(scene.max_depth, 7);
    EXPECT_EQ(scene.rr_depth, 3);
}

TEST_F(LoadScene, PutsParametersIn) {
    const std::string body =
        "<default name='grey' value='0.25'/><default name='greyer' value='0.75'/>"
        "<shape type='cube'><bsdf type='diffuse'><rgb name='reflectance' value='$grey $greyer "
        "$grey'/></bsdf></shape>";
    EXPECT_EQ(load(body).bsdfs[0].reflectance, (Rgb{0.25f, 0.75f, 0.25f}));
    EXPECT_EQ(load(body, {.defines = {{"grey", "0.5"}}}).bsdfs[0].reflectance,
              (Rgb{0.5f, 0.75f, 0.5f}));
    EXPECT_NE(load(body).hash, load(body, {.defines = {{"grey", "0.5"}}}).hash);
    EXPECT_THROW(load(body, {.defines = {{"gray", "0.5"}}}), UsageError);
}

TEST_F(LoadScene, ReadsColoursAsMitsubaDoes) {
    const Scene scene = load(
        "<shape type='cube'><bsdf type='diffuse'><spectrum name='reflectance' value='0.4'/></bsdf>"
        "<emitter type='area'><spectrum name='radiance' value='2'/></emitter></shape>"
        "<emitter type='constant'><float name='radiance' value='1.5'/></emitter>"
        "<emitter type='point'><rgb name='intensity' value='1,2, 3'/><point name='position' x='1' "
        "y='2' z='3'/>"
        "</emitter>");
    EXPECT_EQ(scene.bsdfs[0].reflectance, (Rgb{0.4f, 0.4f, 0.4f}));
    EXPECT_NEAR(scene.shapes[0].radiance[0], 2.40959, 1e-5);  // equal-energy white: Mitsuba's
    EXPECT_NEAR(scene.shapes[0].radiance[1], 1.89658, 1e-5);
    EXPECT_NEAR(scene.shapes[0].radiance[2], 1.81783, 1e-5);
    EXPECT_TRUE(scene.has_environment);
    EXPECT_EQ(scene.environment, (Rgb{1.5f, 1.5f, 1.5f}));
    ASSERT_EQ(scene.point_lights.size(), 1u);
    EXPECT_EQ(scene.point_lights[0].intensity, (Rgb{1, 2, 3}));
    EXPECT_EQ(scene.point_lights[0].position, (std::array<float, 3>{1, 2, 3}));
}

TEST_F(LoadScene, DarkEmittersAreNone) {
    const Scene scene = load(
        "<shape type='cube'><emitter type='area'><rgb name='radiance' value='0'/></emitter></shape>"
        "<emitter type='constant'><rgb name='radiance' value='0'/></emitter>"
        "<emitter type='point'><rgb name='intensity' value='0'/></emitter>");
    EXPECT_FALSE(scene.shapes[0].is_emitter);
    EXPECT_FALSE(scene.has_environment);
    EXPECT_TRUE(scene.point_lights.empty());
}

TEST_F(LoadScene, ReadsMaterials) {
    const Scene scene = load(
        "<shape type='cube'><ref id='later'/></shape>"
        "<shape type='cube'><bsdf type='conductor'/></shape>"
        "<shape type='cube'><bsdf type='roughconductor'><string name='distribution' value='GGX'/>"
        "<rgb name='eta' value='0.2 0.9 1.1'/><spectrum name='k' value='3'/><float name='alpha_u' "
        "value='0.1'/>"
        "<float name='alpha_v' value='0'/><boolean name='sample_visible' "
        "value='true'/></bsdf></shape>"
        "<shape type='cube'><bsdf type='dielectric'><string name='int_ior' value='Water'/>"
        "<float name='ext_ior' value='1.1'/><rgb name='specular_transmittance' "
        "value='0.9'/></bsdf></shape>"
        "<bsdf type='twosided' id='later'><ref id='inner'/></bsdf>"
        "<bsdf type='diffuse' id='inner'><rgb name='reflectance' value='0.1 0.2 0.3'/></bsdf>");
    const auto material = [&](size_t shape) {
        return scene.bsdfs[static_cast<size_t>(scene.shapes[shape].bsdf)];
    };
    EXPECT_TRUE(material(0).two_sided);
    EXPECT_EQ(material(0).id, "later");
    EXPECT_EQ(material(0).reflectance, (Rgb{0.1f, 0.2f, 0.3f}));
    EXPECT_EQ(material(1).type, Bsdf::Type::kConductor);
    EXPECT_EQ(material(1).eta, (Rgb{0, 0, 0}));
    EXPECT_EQ(material(1).k, (Rgb{1, 1, 1}));
    EXPECT_EQ(material(2).type, Bsdf::Type::kRoughConductor);
    EXPECT_EQ(material(2).eta, (Rgb{0.2f, 0.9f, 1.1f}));
    EXPECT_EQ(material(2).k, (Rgb{3, 3, 3}));
    EXPECT_FLOAT_EQ(material(2).alpha_u, 0.1f);
    EXPECT_FLOAT_EQ(material(2).alpha_v, 1e-4f);  // Mitsuba's least
    EXPECT_FLOAT_EQ(material(3).int_ior, 1.333f);
    EXPECT_FLOAT_EQ(material(3).ext_ior, 1.1f);
    EXPECT_EQ(material(3).specular_transmittance, (Rgb{0.9f, 0.9f, 0.9f}));
}

TEST_F(LoadScene, SharesOneMaterialAmongShapes) {
    const Scene scene = load(
        "<bsdf type='diffuse' id='a'/><shape type='cube'><ref id='a'/></shape><shape "
        "type='disk'><ref id='a'/></shape>"
        "<shape type='cube'/><shape type='cube'/>");
    EXPECT_EQ(scene.bsdfs.size(), 2u);
    EXPECT_EQ(scene.shapes[0].bsdf, scene.shapes[1].bsdf);
    EXPECT_EQ(scene.shapes[2].bsdf, scene.shapes[3].bsdf);
}

TEST_F(LoadScene, InstancesPlaceGroups) {
    const Scene scene = load(
        "<shape type='instance' id='first'><ref name='shapegroup' id='pair'/><transform "
        "name='to_world'><scale x='-2' y='1' z='1'/><translate x='10'/></transform></shape>"
        "<shape type='shapegroup' id='unused'><shape type='disk'/></shape>"
        "<shape type='rectangle'/>"
        "<shape type='shapegroup' id='pair'><shape type='cube' id='block'><transform "
        "name='to_world'><translate y='3'/></transform></shape><shape type='rectangle'><ref "
        "id='red'/></shape></shape>"
        "<bsdf type='diffuse' id='red'><rgb name='reflectance' value='1 0 0'/></bsdf>"
        "<shape type='instance'><ref id='pair'/></shape>");
    ASSERT_EQ(scene.groups.size(), 2u);
    EXPECT_EQ(scene.groups[1].id, "pair");
    ASSERT_EQ(scene.groups[1].shapes.size(), 2u);
    EXPECT_EQ(scene.groups[1].shapes[0].id, "block");
    EXPECT_EQ(scene.groups[1].shapes[0].world_from_object[7], 3);
    EXPECT_EQ(scene.bsdfs[static_cast<size_t>(scene.groups[1].shapes[1].bsdf)].reflectance,
              (Rgb{1, 0, 0}));
    ASSERT_EQ(scene.shapes.size(), 3u);
    EXPECT_EQ(scene.shapes[0].type, Shape::Type::kInstance);
    EXPECT_EQ(scene.shapes[0].id, "first");
    EXPECT_EQ(scene.shapes[0].group, 1);
    EXPECT_EQ(scene.shapes[0].world_from_object[0], -2);
    EXPECT_EQ(scene.shapes[0].world_from_object[3], 10);
    EXPECT_EQ(scene.shapes[1].type, Shape::Type::kRectangle);
    EXPECT_EQ(scene.shapes[2].group, 1);
    EXPECT_EQ(scene.bounds_min, (std::array<float, 3>{-1, -1, -1}));
    EXPECT_EQ(scene.bounds_max, (std::array<float, 3>{12, 4, 1}));
}

TEST_F(LoadScene, BoundsHoldEveryShapeTightly) {
    const Scene scene = load(
        "<shape type='sphere'><point name='center' x='1' y='2' z='3'/><float name='radius' "
        "value='2'/></shape>"
        "<shape type='disk'><transform name='to_world'><rotate x='1' angle='90'/><scale "
        "x='5'/></transform></shape>");
    const std::array<float, 3> low{-5, 0, -1}, high{5, 4, 5};
    for (size_t i = 0; i < 3; ++i) {
        EXPECT_NEAR(scene.bounds_min[i], low[i], 1e-5);
        EXPECT_NEAR(scene.bounds_max[i], high[i], 1e-5);
    }
}

TEST_F(LoadScene, PlasticAndRoughGlass) {
    const Scene scene = load(
        "<shape type='cube'><bsdf type='plastic'/></shape>"
        "<shape type='cube'><bsdf type='twosided'><bsdf type='plastic'>"
        "<rgb name='diffuse_reflectance' value='0.1 0.2 0.3'/><float name='int_ior' value='1.9'/>"
        "<rgb name='specular_reflectance' value='0.5'/><boolean name='nonlinear' value='true'/>"
        "</bsdf></bsdf></shape>"
        "<shape type='cube'><bsdf type='roughdielectric'><string name='distribution' value='ggx'/>"
        "<float name='alpha' value='0.3'/><string name='int_ior' value='diamond'/></bsdf></shape>");
    const Bsdf &plain = scene.bsdfs[0], &red = scene.bsdfs[1], &frosted = scene.bsdfs[2];
    EXPECT_EQ(plain.type, Bsdf::Type::kPlastic);
    EXPECT_EQ(plain.int_ior, 1.49f);
    EXPECT_EQ(plain.ext_ior, 1.000277f);
    EXPECT_EQ(plain.reflectance, (Rgb{0.5f, 0.5f, 0.5f}));
    EXPECT_FALSE(plain.nonlinear);
    EXPECT_TRUE(red.two_sided);
    EXPECT_TRUE(red.nonlinear);
    EXPECT_EQ(red.reflectance, (Rgb{0.1f, 0.2f, 0.3f}));
    EXPECT_EQ(red.specular_reflectance, (Rgb{0.5f, 0.5f, 0.5f}));
    EXPECT_EQ(frosted.type, Bsdf::Type::kRoughDielectric);
    EXPECT_EQ(frosted.alpha_u, 0.3f);
    EXPECT_EQ(frosted.int_ior, 2.419f);
}

TEST_F(LoadScene, IgnoresWhatIsUnsupportedIfAsked) {
    const std::string body =
        "<shape type='cube'><bsdf type='blendbsdf'><float name='weight' "
        "value='0.4'/></bsdf></shape>\n"
        "<shape type='cylinder'/>\n"
        "<emitter type='sky'/>\n"
        "<integrator type='aov'><string name='aovs' value='a:albedo'/><integrator type='path'>"
        "<integer name='max_depth' value='3'/></integrator></integrator>";
    EXPECT_THROW(load(body), InputError);
    const Scene scene = load(body, {.ignore_unsupported = true});
    EXPECT_EQ(scene.shapes.size(), 1u);
    EXPECT_EQ(scene.max_depth, 3);
    ASSERT_EQ(scene.warnings.size(), 4u);
    EXPECT_NE(scene.warnings[1].find("scene.xml:3: shape \"cylinder\""), std::string::npos)
        << scene.warnings[1];
}

TEST_F(LoadScene, HashIsOfEveryByteThatMatters) {
    const std::string scene =
        with_sensor("<shape type='obj'><string name='filename' value='m.obj'/></shape>");
    write("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    const std::string path = write("scene.xml", scene);
    const std::string hash = load_scene(path).hash;
    EXPECT_EQ(hash.size(), 32u);
    EXPECT_EQ(load_scene(path).hash, hash);
    write("m.obj", "v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n");
    EXPECT_NE(load_scene(path).hash, hash);
    write("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    EXPECT_EQ(load_scene(path).hash, hash);
    write("scene.xml", scene + "<!-- -->");
    EXPECT_NE(load_scene(path).hash, hash);
}

TEST_F(LoadScene, FindsNamesInTheSceneFolder) {
    write("lamp.xml", with_sensor("<shape type='cube'/>"));
    ASSERT_EQ(::setenv("PAVE_SCENE_DIR", folder_.c_str(), 1), 0);
    EXPECT_EQ(load_scene("lamp").name, "lamp");
    std::string message;
    try {
        load_scene("lampp");
    } catch (const InputError& error) {
        message = error.what();
    }
    ::unsetenv("PAVE_SCENE_DIR");
    EXPECT_NE(message.find("did you mean \"lamp\""), std::string::npos) << message;
    EXPECT_EQ(load_scene("cornell").name, "cornell");  // the source tree's
    EXPECT_THROW(load_scene("../cornell"), InputError);
    EXPECT_THROW(load_scene(".."), InputError);
    EXPECT_THROW(load_scene(""), InputError);
}

struct FovCase {
    const char* axis;
    double fov_x_wide;  // film 16x8: Mitsuba's
};
class FovAxis : public SceneFiles, public ::testing::WithParamInterface<FovCase> {};

TEST_P(FovAxis, IsMitsubas) {
    const Scene scene =
        load_sensor(std::string("<float name='fov' value='40'/><string name='fov_axis' value='") +
                    GetParam().axis + "'/>");
    EXPECT_NEAR(scene.view.fov_x_degrees, GetParam().fov_x_wide, 1e-4);
}
INSTANTIATE_TEST_SUITE_P(All, FovAxis,
                         ::testing::Values(FovCase{"x", 40}, FovCase{"y", 72.10477447509766},
                                           FovCase{"smaller", 72.10477447509766},
                                           FovCase{"larger", 40},
                                           FovCase{"diagonal", 36.064788818359375}),
                         [](const auto& info) { return info.param.axis; });

}  // namespace
}  // namespace pave::test
