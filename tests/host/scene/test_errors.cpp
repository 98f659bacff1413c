// Every kind of wrong file ends in one line that names the file, the line, the node and the reason.
// SPDX-License-Identifier: BSD-3-Clause
#include "tests/host/scene/scene_files.h"

namespace pave::test {
namespace {

struct BadScene {
    const char* name;
    const char* body;      // begins on line 2 of the file
    const char* expected;  // part of the message after the file's name
};

void PrintTo(const BadScene& bad, std::ostream* out) { *out << bad.name; }

class BadBody : public SceneFiles, public ::testing::WithParamInterface<BadScene> {};

TEST_P(BadBody, IsNamed) {
    const std::string message = error_of(with_sensor(GetParam().body));
    const std::string where = (folder_ / "scene.xml:").string();
    EXPECT_EQ(message.rfind(where, 0), 0u) << message;
    EXPECT_TRUE(std::isdigit(static_cast<unsigned char>(message[where.size()]))) << message;
    EXPECT_NE(message.find(GetParam().expected, where.size() - 1), std::string::npos)
        << "message:  " << message << "\nexpected: " << GetParam().expected;
}

const BadScene kBadScenes[] = {
    {"unknown_element", "\n<shap type='cube'/>",
     ":3: shap \"cube\": <shap> is not supported in a scene (did you mean \"shape\"?)"},
    {"include", "<include filename='x.xml'/>", ":2: include: <include> is not supported"},
    {"unknown_shape", "<shape type='rectangl'/>",
     ":2: shape \"rectangl\": this shape is not supported (did you mean \"rectangle\"?)"},
    {"unknown_bsdf", "<shape type='cube'>\n<bsdf type='diffus'/></shape>",
     ":3: bsdf \"diffus\": this material is not supported (did you mean \"diffuse\"?)"},
    {"unknown_emitter", "<emitter type='spot'/>",
     ":2: emitter \"spot\": this emitter is not supported"},
    {"unknown_property",
     "<shape type='cube'><bsdf type='diffuse'>\n<rgb name='reflectanc' value='1'/></bsdf></shape>",
     ":3: rgb \"reflectanc\": not a property of bsdf \"diffuse\" in PAVE (did you mean "
     "\"reflectance\"?)"},
    {"unknown_attribute", "<shape type='cube' colour='1'/>",
     ":2: shape \"cube\": unexpected attribute \"colour\""},
    {"misspelt_attribute", "<shape tpye='cube'/>",
     ":2: shape: unexpected attribute \"tpye\" (did you mean \"type\"?)"},
    {"no_type", "<shape/>", ":2: shape: attribute \"type\" is missing"},
    {"no_value", "<shape type='sphere'><float name='radius'/></shape>",
     ":2: float \"radius\": attribute \"value\" is missing"},
    {"no_name", "<shape type='sphere'><float value='1'/></shape>",
     ":2: float: attribute \"name\" is missing"},
    {"twice",
     "<shape type='sphere'><float name='radius' value='1'/><float name='radius' "
     "value='2'/></shape>",
     "\"radius\" is given twice"},
    {"stray_text", "<shape type='cube'>hello</shape>", ":2: text: stray text \"hello\""},
    {"stray_text_in_scene", "<shape type='cube'/>hello", ":2: text: stray text \"hello\""},
    {"element_in_value",
     "<shape type='sphere'><float name='radius' value='1'><float/></float></shape>",
     "nothing may stand inside <float>"},
    {"not_a_number", "<shape type='sphere'><float name='radius' value='2x'/></shape>",
     ":2: float \"radius\": \"2x\" is not a finite number"},
    {"nan", "<shape type='sphere'><float name='radius' value='nan'/></shape>",
     "\"nan\" is not a finite number"},
    {"inf", "<shape type='sphere'><float name='radius' value='-inf'/></shape>",
     "\"-inf\" is not a finite number"},
    {"overflow", "<shape type='sphere'><float name='radius' value='1e39'/></shape>",
     "\"1e39\" is not a finite number"},
    {"nan_in_colour", "<emitter type='constant'><rgb name='radiance' value='1 nan 1'/></emitter>",
     ":2: rgb \"radiance\": \"1 nan 1\" has a part that is not a finite number"},
    {"nan_in_matrix",
     "<shape type='cube'><transform name='to_world'><matrix value='1 0 0 0 1 0 0 0 "
     "nan'/></transform></shape>",
     "matrix: \"nan\" is not a finite number"},
    {"not_an_integer",
     "<integrator type='path'><integer name='max_depth' value='2.5'/></integrator>",
     "\"2.5\" is not an integer"},
    {"wrong_tag", "<integrator type='path'><float name='max_depth' value='2'/></integrator>",
     "float \"max_depth\": must be a <integer>"},
    {"not_a_boolean", "<shape type='cube'><boolean name='flip_normals' value='yes'/></shape>",
     "\"yes\" is neither true nor false"},
    {"depth_zero", "<integrator type='path'><integer name='max_depth' value='0'/></integrator>",
     "max_depth must be -1 (endless) or at least 1"},
    {"roulette_zero", "<integrator type='path'><integer name='rr_depth' value='0'/></integrator>",
     "rr_depth must be at least 1"},
    {"hidden_emitters",
     "<integrator type='path'><boolean name='hide_emitters' value='true'/></integrator>",
     "hidden emitters are not supported"},
    {"aov", "<integrator type='aov'><string name='aovs' value='d:depth'/></integrator>",
     ":2: integrator \"aov\": aov is not needed"},
    {"volpath", "<integrator type='volpath'/>", "this integrator is not supported"},
    {"two_integrators", "<integrator type='path'/>\n<integrator type='path'/>",
     ":3: integrator \"path\": a second integrator"},
    {"two_sensors", "<sensor type='perspective'><film type='hdrfilm'/></sensor>",
     "a second sensor is not supported"},
    {"reflectance_above_one",
     "<bsdf type='diffuse' id='unused'>\n<rgb name='reflectance' value='0.5 1.2 0'/></bsdf>",
     ":3: rgb \"reflectance\": a reflectance must be in [0, 1]"},
    {"reflectance_negative", "<bsdf type='diffuse'><rgb name='reflectance' value='-0.1'/></bsdf>",
     "must not be negative"},
    {"radiance_negative",
     "<shape type='cube'><emitter type='area'><rgb name='radiance' value='1 1 "
     "-1'/></emitter></shape>",
     "rgb \"radiance\": must not be negative"},
    {"hex_colour", "<emitter type='constant'><rgb name='radiance' value='#ff8000'/></emitter>",
     "hex colours are sRGB"},
    {"two_numbers", "<emitter type='constant'><rgb name='radiance' value='1 2'/></emitter>",
     "\"1 2\" is not one or three numbers"},
    {"wavelengths",
     "<bsdf type='diffuse'><spectrum name='reflectance' value='400:0.1, 700:0.9'/></bsdf>",
     "spectra over wavelengths are not supported"},
    {"texture",
     "<bsdf type='diffuse'><texture type='bitmap' name='reflectance'><string name='filename' "
     "value='a.png'/></texture></bsdf>",
     "a.png: no such file"},
    {"texture_of_a_light",
     "<shape type='cube'><emitter type='area'><texture type='bitmap' name='radiance'><string "
     "name='filename' value='a.png'/></texture></emitter></shape>",
     "a texture is not supported here: \"radiance\" must be one colour"},
    {"texture_type", "<bsdf type='diffuse'><texture type='bitmp' name='reflectance'/></bsdf>",
     "this texture is not supported (did you mean \"bitmap\"?); there are bitmap, checkerboard"},
    {"texture_and_colour",
     "<bsdf type='diffuse'><texture type='checkerboard' name='reflectance'/><rgb "
     "name='reflectance' value='.5'/></bsdf>",
     "\"reflectance\" is given twice"},
    {"texture_reference",
     "<texture type='checkerboard' id='tiles'/><bsdf type='diffuse'><ref name='reflectance' "
     "id='tile'/></bsdf>",
     "no texture of the scene has the id \"tile\" (did you mean \"tiles\"?)"},
    {"texture_wrap",
     "<bsdf type='diffuse'><texture type='bitmap' name='reflectance'><string name='wrap_mode' "
     "value='repeated'/></texture></bsdf>",
     "\"repeated\" is not known (did you mean \"repeat\"?); there are repeat, mirror, clamp"},
    {"texture_alpha",
     "<bsdf type='roughconductor'><string name='distribution' value='ggx'/><texture "
     "type='checkerboard' name='alpha'/></bsdf>",
     "texture"},
    {"metal_by_name", "<bsdf type='conductor'>\n<string name='material' value='Au'/></bsdf>",
     ":3: string \"material\": material \"Au\" needs tables over wavelengths: give eta and k as "
     "<rgb>"},
    {"beckmann", "<bsdf type='roughconductor'/>", "distribution \"beckmann\" is not supported"},
    {"one_alpha_of_two",
     "<bsdf type='roughconductor'><string name='distribution' value='ggx'/><float name='alpha_u' "
     "value='.1'/></bsdf>",
     "both alpha_u and alpha_v"},
    {"unknown_ior", "<bsdf type='dielectric'><string name='int_ior' value='watr'/></bsdf>",
     "int_ior \"watr\" is not a known material (did you mean \"water\"?)"},
    {"ior_zero", "<bsdf type='dielectric'><float name='int_ior' value='0'/></bsdf>",
     "int_ior must be in (0.01, 100]"},
    {"two_sided_glass", "<bsdf type='twosided'><bsdf type='dielectric'/></bsdf>",
     "a material that lets light through cannot be inside"},
    {"two_sided_rough_glass",
     "<bsdf type='twosided'><bsdf type='roughdielectric'><string name='distribution' "
     "value='ggx'/></bsdf></bsdf>",
     "a material that lets light through cannot be inside"},
    {"plastic_of_air",
     "<bsdf type='plastic'><float name='int_ior' value='1.2'/><float name='ext_ior' "
     "value='1.2'/></bsdf>",
     "int_ior and ext_ior must differ"},
    {"rough_glass_beckmann", "<bsdf type='roughdielectric'/>",
     "distribution \"beckmann\" is not supported"},
    {"two_sided_nothing", "<bsdf type='twosided'/>", "needs a material inside"},
    {"two_sided_itself", "<bsdf type='twosided' id='a'><ref id='a'/></bsdf>", "refers to itself"},
    {"two_sided_loop",
     "<bsdf type='twosided' id='a'><ref id='b'/></bsdf><bsdf type='twosided' id='b'><ref "
     "id='a'/></bsdf>",
     "refers to itself"},
    {"two_bsdfs", "<shape type='cube'><bsdf type='diffuse'/><bsdf type='diffuse'/></shape>",
     "a shape has one bsdf"},
    {"no_such_ref", "<bsdf type='diffuse' id='white'/><shape type='cube'><ref id='whit'/></shape>",
     ":2: ref \"whit\": no bsdf of the scene has the id \"whit\" (did you mean \"white\"?)"},
    {"same_id", "<bsdf type='diffuse' id='a'/><bsdf type='diffuse' id='a'/>",
     "id \"a\" is given twice"},
    {"two_emitters", "<shape type='cube'><emitter type='area'/><emitter type='area'/></shape>",
     "a shape has one emitter"},
    {"area_outside", "<emitter type='area'/>", "an area emitter must stand inside a shape"},
    {"point_inside", "<shape type='cube'><emitter type='point'/></shape>",
     "only an \"area\" emitter can be inside a shape"},
    {"two_skies", "<emitter type='constant'/><emitter type='constant'/>",
     "a scene has one constant or envmap emitter"},
    {"zero_area_emitter",
     "<shape type='sphere'><float name='radius' value='1e-25'/><emitter type='area'/></shape>",
     ":2: shape \"sphere\": the emitter has no area"},
    {"zero_radius", "<shape type='sphere'><float name='radius' value='0'/></shape>",
     "the radius is 0"},
    {"group_without_id", "<shape type='shapegroup'><shape type='cube'/></shape>",
     ":2: shape \"shapegroup\": needs an id, by which instances refer to it"},
    {"group_twice",
     "<shape type='shapegroup' id='a'><shape type='cube'/></shape>\n<shape type='shapegroup' "
     "id='a'><shape type='cube'/></shape>",
     ":3: shape \"shapegroup\": id \"a\" is given twice"},
    {"group_of_nothing", "<shape type='shapegroup' id='a'/>",
     ":2: shape \"shapegroup\": a shapegroup needs shapes inside"},
    {"group_in_a_group",
     "<shape type='shapegroup' id='a'>\n<shape type='shapegroup' id='b'/></shape>",
     ":3: shape \"shapegroup\": a shapegroup cannot hold another one, nor instances"},
    {"group_of_itself",
     "<shape type='shapegroup' id='a'>\n<shape type='instance'><ref id='a'/></shape></shape>",
     ":3: shape \"instance\": a shapegroup cannot hold another one, nor instances"},
    {"group_with_a_light",
     "<shape type='shapegroup' id='a'><shape type='cube'>\n<emitter type='area'/></shape></shape>",
     ":3: emitter \"area\": a shape of a shapegroup cannot be an emitter"},
    {"group_with_a_material",
     "<shape type='shapegroup' id='a'><shape type='cube'/>\n<bsdf type='diffuse'/></shape>",
     ":3: bsdf \"diffuse\": has no place in shape \"shapegroup\""},
    {"group_unknown_shape", "<shape type='shapegroup' id='a'>\n<shape type='cub'/></shape>",
     ":3: shape \"cub\": this shape is not supported (did you mean \"cube\"?)"},
    {"instance_of_nothing", "<shape type='instance'/>",
     ":2: shape \"instance\": an instance needs one <ref id=\"...\"> to a shapegroup"},
    {"instance_of_two",
     "<shape type='shapegroup' id='a'><shape type='cube'/></shape>\n<shape type='instance'><ref "
     "id='a'/>\n<ref id='a'/></shape>",
     ":4: ref \"a\": an instance needs one <ref id=\"...\"> to a shapegroup"},
    {"instance_of_unknown",
     "<shape type='shapegroup' id='tree'><shape type='cube'/></shape><shape "
     "type='instance'>\n<ref id='tre'/></shape>",
     ":3: ref \"tre\": no shapegroup of the scene has the id \"tre\" (did you mean \"tree\"?)"},
    {"instance_of_a_material",
     "<bsdf type='diffuse' id='white'/><shape type='instance'>\n<ref id='white'/></shape>",
     ":3: ref \"white\": no shapegroup of the scene has the id \"white\""},
    {"instance_around_a_group",
     "<shape type='instance'>\n<shape type='shapegroup'><shape type='cube'/></shape></shape>",
     ":3: shape \"shapegroup\": stands in an instance: give the shapegroup an id"},
    {"instance_with_a_material",
     "<shape type='shapegroup' id='a'><shape type='cube'/></shape><shape type='instance'><ref "
     "id='a'/>\n<bsdf type='diffuse'/></shape>",
     ":3: bsdf \"diffuse\": has no place in shape \"instance\""},
    {"instance_flat",
     "<shape type='shapegroup' id='a'><shape type='cube'/></shape><shape type='instance'><ref "
     "id='a'/>\n<transform name='to_world'><scale x='0'/></transform></shape>",
     ":3: transform \"to_world\": is singular"},
    {"instance_tiny",
     "<shape type='shapegroup' id='a'><shape type='cube'/></shape>\n<shape type='instance'><ref "
     "id='a'/><transform name='to_world'><scale value='1e-11'/></transform></shape>",
     ":3: shape \"instance\": its transform scales by less than 1e-10 or leads beyond 1e12"},
    {"instance_far",
     "<shape type='shapegroup' id='a'><shape type='cube'><transform name='to_world'><translate "
     "x='1e9'/></transform></shape></shape>\n<shape type='instance'><ref id='a'/><transform "
     "name='to_world'><scale value='1e4'/></transform></shape>",
     ":3: shape \"instance\": its transform scales by less than 1e-10 or leads beyond 1e12"},
    {"instance_of_an_egg",
     "<shape type='shapegroup' id='a'><shape type='sphere'/></shape>\n<shape type='instance'><ref "
     "id='a'/><transform name='to_world'><scale x='2'/></transform></shape>",
     ":3: shape \"instance\": its shapegroup has a sphere, which can only be scaled by the same"},
    {"flat_scale",
     "<shape type='rectangle'>\n<transform name='to_world'><scale x='0'/></transform></shape>",
     ":3: transform \"to_world\": is singular"},
    {"singular_matrix",
     "<shape type='cube'><transform name='to_world'><matrix value='1 2 3 2 4 6 0 0 "
     "1'/></transform></shape>",
     "is singular"},
    {"projective_matrix",
     "<shape type='cube'><transform name='to_world'><matrix value='1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 "
     "1'/></transform></shape>",
     "the last row must be 0 0 0 1"},
    {"huge_transform",
     "<shape type='cube'><transform name='to_world'><translate x='1e13'/></transform></shape>",
     "has values beyond 1e12"},
    {"stretched_sphere",
     "<shape type='sphere'><transform name='to_world'><scale x='2'/></transform></shape>",
     "a sphere can only be scaled by the same factor"},
    {"sheared_disk",
     "<shape type='disk'><transform name='to_world'><matrix value='1 1 0 0 1 0 0 0 "
     "1'/></transform></shape>",
     "a disk cannot be sheared"},
    {"unknown_step",
     "<shape type='cube'><transform name='to_world'><tranlate x='1'/></transform></shape>",
     "<tranlate> cannot stand in a <transform> (did you mean \"translate\"?)"},
    {"axis_zero",
     "<shape type='cube'><transform name='to_world'><rotate angle='30'/></transform></shape>",
     "the axis of rotation is zero"},
    {"axis_long",
     "<shape type='cube'><transform name='to_world'><rotate x='1' y='1' "
     "angle='30'/></transform></shape>",
     "the axis of rotation must have length 1"},
    {"lookat_same",
     "<shape type='cube'><transform name='to_world'><lookat origin='1 1 1' target='1 1 "
     "1'/></transform></shape>",
     "origin and target are the same point"},
    {"lookat_up",
     "<shape type='cube'><transform name='to_world'><lookat origin='0 2 0' target='0 0 0' up='0 1 "
     "0'/></transform></shape>",
     "up is parallel"},
    {"undefined_parameter",
     "<default name='albedo' value='1'/><bsdf type='diffuse'><rgb name='reflectance' "
     "value='$albdo'/></bsdf>",
     "undefined parameter \"$albdo\" (did you mean \"albedo\"?)"},
    {"not_closed", "<shape type='cube'>", ":3: xml: "},
    {"missing_mesh", "\n<shape type='ply'><string name='filename' value='none.ply'/></shape>",
     ":3: string \"filename\": "},
    {"no_filename", "<shape type='ply'/>", "needs a <string name=\"filename\">"},
    {"missing_obj", "<shape type='obj'><string name='filename' value='x.obj'/></shape>",
     ":2: string \"filename\": "},
    {"no_shape", "", ":1: scene: has no shape"},
};
INSTANTIATE_TEST_SUITE_P(All, BadBody, ::testing::ValuesIn(kBadScenes),
                         [](const auto& info) { return info.param.name; });

class BadSensor : public SceneFiles {};

TEST_F(BadSensor, FilmAndSamplerAreBounded) {
    const auto film = [&](const std::string& width,
                          const std::string& filter = "<rfilter type='box'/>") {
        return "<scene version='3.0.0'><sensor type='perspective'><film type='hdrfilm'><integer "
               "name='width' value='" +
               width + "'/>" + filter + "</film></sensor><shape type='cube'/></scene>";
    };
    EXPECT_NE(error_of(film("0")).find("\"width\" must be in 1..16384"), std::string::npos);
    EXPECT_NE(error_of(film("-3")).find("\"width\" must be in 1..16384"), std::string::npos);
    EXPECT_NE(error_of(film("16385")).find("\"width\" must be in 1..16384"), std::string::npos);
    EXPECT_NE(error_of(film("99999999999999999999")).find("is not an integer"), std::string::npos);
    EXPECT_NE(error_of(film("8", "")).find("Mitsuba's default filter is gaussian"),
              std::string::npos);
    EXPECT_NE(
        error_of(film("8", "<rfilter type='tent'/>")).find("filter \"tent\" is not supported"),
        std::string::npos);
    EXPECT_NE(error_of(film("8", "<rfilter type='box'/><integer name='crop_width' value='4'/>"))
                  .find("crop_width"),
              std::string::npos);
    for (const char* spp : {"0", "-1", "16777217"})
        EXPECT_NE(
            error_of(with_sensor(
                         "<shape type='cube'/>",
                         std::string(
                             "<sampler type='independent'><integer name='sample_count' value='") +
                             spp + "'/></sampler>"))
                .find("\"sample_count\" must be in 1..16777216"),
            std::string::npos);
}

TEST_F(BadSensor, CameraIsChecked) {
    const std::pair<const char*, const char*> cases[] = {
        {"<float name='fov' value='180'/>", "must be in (0, 180) degrees"},
        {"<float name='fov' value='0'/>", "must be in (0, 180) degrees"},
        {"<float name='fov' value='40'/><string name='fov_axis' value='z'/>",
         "fov_axis \"z\" is not one of x, y"},
        {"<float name='fov' value='40'/><string name='focal_length' value='50mm'/>",
         "either fov or focal_length"},
        {"<string name='focal_length' value='long'/>", "must be a length like 50mm"},
        {"<float name='principal_point_offset_x' value='0.1'/>", "shifted principal point"},
        {"<transform name='to_world'><scale value='2'/></transform>", "a camera cannot be scaled"},
        {"<float name='aperture_radius' value='1'/>", "not a property of sensor"},
        {"<sampler type='halton'/>", "unknown sampler"},
    };
    for (const auto& [sensor, expected] : cases) {
        const std::string message = error_of(with_sensor("<shape type='cube'/>", sensor));
        EXPECT_NE(message.find(expected), std::string::npos)
            << message << "\nexpected: " << expected;
    }
    EXPECT_NE(
        error_of("<scene version='3.0.0'><shape type='cube'/></scene>").find("has no <sensor"),
        std::string::npos);
    EXPECT_NE(error_of("<scene version='3.0.0'><sensor type='thinlens'><film "
                       "type='hdrfilm'><rfilter type='box'/></film>"
                       "</sensor></scene>")
                  .find("this sensor is not supported"),
              std::string::npos);
}

TEST_F(BadSensor, AcceptsWhatChangesNothing) {
    const Scene scene = load_sensor(
        "<float name='near_clip' value='0.1'/><float name='far_clip' value='100'/>"
        "<float name='principal_point_offset_x' value='0'/><float name='fov' value='40'/>"
        "<sampler type='ldsampler'><integer name='sample_count' value='16'/><integer name='seed' "
        "value='3'/></sampler>",
        "<string name='pixel_format' value='rgb'/><string name='component_format' value='float32'/>"
        "<rfilter type='box'/>");
    EXPECT_EQ(scene.spp, 16);
}

class BadFile : public SceneFiles {};

TEST_F(BadFile, OutermostElementIsChecked) {
    EXPECT_NE(error_of("").find("xml: "), std::string::npos);
    EXPECT_NE(error_of("<a/>").find("the outermost element must be <scene"), std::string::npos);
    EXPECT_NE(error_of("<scene/>").find("attribute \"version\" is missing"), std::string::npos);
    EXPECT_NE(error_of("<scene version='0.6.0'/>").find("version \"0.6.0\" is not one of"),
              std::string::npos);
    EXPECT_NE(error_of("\x7f"
                       "ELF\x02\x01")
                  .find("xml: "),
              std::string::npos);
    EXPECT_NE(error_of(std::string("<scene\0 version='3.0.0'/>", 25)).find("scene.xml:1: "),
              std::string::npos);
}

TEST_F(BadFile, EntitiesAndDoctypesAreRefused) {
    write("secret.txt", "0.5");
    const std::string bomb =
        "<?xml version='1.0'?>\n<!DOCTYPE scene [<!ENTITY a 'aaaaaaaa'><!ENTITY b "
        "'&a;&a;&a;&a;&a;&a;&a;&a;'>]>\n" +
        with_sensor("<shape type='cube' id='&b;'/>");
    EXPECT_NE(error_of(bomb).find("a DOCTYPE is not allowed"), std::string::npos);
    const std::string file =
        "<!DOCTYPE scene SYSTEM 'secret.txt'>" + with_sensor("<shape type='cube'/>");
    EXPECT_NE(error_of(file).find("a DOCTYPE is not allowed"), std::string::npos);
    // An undeclared entity stays the text that it is.
    const std::string message =
        error_of(with_sensor("<shape type='sphere'><float name='radius' value='&b;'/></shape>"));
    EXPECT_NE(message.find("\"&b;\" is not a finite number"), std::string::npos) << message;
}

TEST_F(BadFile, LargeAndSpecialFilesAreRefused) {
    const std::string path = write("large.xml", "<scene/>");
    std::filesystem::resize_file(path, (size_t{64} << 20) + 1);
    EXPECT_THROW(load_scene(path), InputError);
    EXPECT_THROW(load_scene("/dev/zero/x.xml"), InputError);
    EXPECT_THROW(load_scene(folder_.string() + "/"), InputError);
    EXPECT_THROW(load_scene((folder_ / "none.xml").string()), InputError);
    const std::string scene =
        with_sensor("<shape type='ply'><string name='filename' value='/dev/zero'/></shape>");
    EXPECT_NE(error_of(scene).find("/dev/zero: not a regular file"), std::string::npos);
}

TEST_F(BadFile, DeepNestingIsNoTrap) {
    std::string deep;
    for (int i = 0; i < 200000; ++i) deep += "<bsdf type='twosided'>";
    error_of(with_sensor(deep));
    std::string closed = "<bsdf type='diffuse'/>";
    for (int i = 0; i < 2000; ++i) closed = "<bsdf type='twosided'>" + closed + "</bsdf>";
    EXPECT_NE(error_of(with_sensor(closed)).find("nested too deeply"), std::string::npos);
}

// Whatever bytes come in: an InputError or a scene, never a crash. Each mutation is seeded and
// printed on failure.
TEST_F(BadFile, MutatedScenesNeverCrash) {
    std::ifstream stream(std::string(PAVE_SOURCE_DIR) + "/scenes/materials.xml");
    const std::string original((std::istreambuf_iterator<char>(stream)), {});
    ASSERT_FALSE(original.empty());
    std::filesystem::create_directory(folder_ / "meshes");
    for (const char* mesh : {"torus.ply", "rock.obj"})
        std::filesystem::copy_file(std::string(PAVE_SOURCE_DIR) + "/scenes/meshes/" + mesh,
                                   folder_ / "meshes" / mesh);
    uint64_t state = 88172645463325252ull;
    const auto random = [&state](size_t bound) {
        state ^= state << 13, state ^= state >> 7, state ^= state << 17;
        return static_cast<size_t>(state % bound);
    };
    int loaded = 0;
    for (int round = 0; round < 300; ++round) {
        SCOPED_TRACE("round " + std::to_string(round));
        std::string text = original;
        for (size_t edits = 1 + random(4); edits > 0; --edits) {
            const size_t at = random(text.size());
            if (const size_t kind = random(4); kind == 0)
                text[at] = static_cast<char>(random(256));
            else if (kind == 1)
                text.erase(at, random(40));
            else if (kind == 2)
                text.insert(at, text.substr(random(text.size()), random(40)));
            else
                text.resize(text.size() - random(text.size() / 8));
        }
        try {
            load_scene(write("mutated.xml", text));
            ++loaded;
        } catch (const InputError&) {
        }
    }
    EXPECT_GT(loaded, 5);  // else the mutations are too coarse to reach the readers
}

}  // namespace
}  // namespace pave::test
