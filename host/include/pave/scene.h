// The scene as data: shapes, materials, emitters and the camera, read from a Mitsuba 3 XML subset.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "pave/frame.h"

namespace pave {

using Rgb = std::array<float, 3>;       // linear BT.709
using Matrix4 = std::array<float, 16>;  // row-major

/// Pixels of an image file, row 0 at the top: either sRGB bytes r, g, b, - or linear floats r, g,
/// b.
struct Image {
    int width = 0, height = 0;
    std::vector<uint8_t> bytes{};
    std::vector<float> floats{};
};

/// A colour that varies over a surface, by its texture coordinates (u, v); v = 0 is the top of an
/// image. Colours are linear and in [0, 1].
struct Texture {
    enum class Type : int { kBitmap, kCheckerboard };
    enum class Wrap : int { kRepeat, kMirror, kClamp };
    Type type = Type::kBitmap;
    std::string id{};
    std::array<float, 6> uv_map{1, 0, 0, 0, 1, 0};  // two rows: x = m0 u + m1 v + m2, y likewise
    Rgb color0{0.4f, 0.4f, 0.4f}, color1{0.2f, 0.2f, 0.2f};  // checkerboard
    Image image{};                                           // bitmap
    bool is_raw = false;                                     // bytes are linear, not sRGB
    bool is_nearest = false;                                 // no interpolation
    Wrap wrap = Wrap::kRepeat;
};

/// A material. Fields that its type does not use keep their defaults.
struct Bsdf {
    enum class Type : int {
        kDiffuse,
        kConductor,
        kRoughConductor,
        kDielectric,
        kPlastic,
        kRoughDielectric
    };
    Type type = Type::kDiffuse;
    std::string id{};
    bool two_sided =
        false;  // inside a `twosided`; otherwise the back of all but dielectrics is black
    Rgb reflectance{0.5f, 0.5f, 0.5f};  // diffuse; plastic: of its base
    Rgb eta{0, 0, 0},
        k{1, 1,
          1};  // conductors: complex index of refraction ("none": eta 0, k 1, a perfect mirror)
    Rgb specular_reflectance{1, 1, 1}, specular_transmittance{1, 1, 1};
    float alpha_u = 0.1f, alpha_v = 0.1f;  // roughconductor and roughdielectric, GGX (Mitsuba's
                                           // default distribution is beckmann: only ggx is taken)
    float int_ior = 1.5046f, ext_ior = 1.000277f;  // dielectrics, plastic
    // Into Scene::textures, -1: none. A texture is multiplied with its colour, which the scene
    // reader sets to 1.
    int reflectance_texture = -1, specular_reflectance_texture = -1,
        specular_transmittance_texture = -1;
    bool nonlinear = false;  // plastic: light that stays inside is coloured at each reflection
};

inline bool has_texture(const Bsdf& bsdf) {
    return bsdf.reflectance_texture >= 0 || bsdf.specular_reflectance_texture >= 0 ||
           bsdf.specular_transmittance_texture >= 0;
}

/// Triangles; the geometric normal is that of the winding, cross(p1 - p0, p2 - p0). Shading
/// normals: none (faceted) or one a vertex, of unit length; they decide what is the front for
/// materials and emission, as in Mitsuba. Texture coordinates: none or one pair a vertex.
struct Mesh {
    std::vector<std::array<float, 3>> positions, normals;
    std::vector<std::array<float, 2>> texcoords;
    std::vector<std::array<uint32_t, 3>> triangles;
};

/// One shape. rectangle: [-1,1]^2 at z=0, normal +z; cube: [-1,1]^3; sphere: unit at the origin;
/// disk: unit, normal +z. world_from_object is affine and regular. Rectangles and cubes may be
/// sheared (a parallelogram, a parallelepiped), disks stretched (an ellipse), spheres only turned
/// and scaled evenly, never mirrored. Normals go by the inverse transpose, so a mirrored cube's
/// point outwards still.
struct Shape {
    enum class Type : int { kRectangle, kCube, kSphere, kDisk, kMesh, kInstance };
    Type type = Type::kRectangle;
    std::string id{};
    Matrix4 world_from_object{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    int bsdf = 0;  // into Scene::bsdfs
    bool flip_normals =
        false;  // the normal points the other way; never set for meshes, whose data are turned
    int object = -1;  // what channel `object` shows; -1: its place in Scene::shapes
    int part = -1;    // what Hit::part names; the renderer sets it for shapes of groups
    int group = -1;   // kInstance only: into Scene::groups
    bool is_emitter = false;
    Rgb radiance{0, 0, 0};  // area emitter, from the side that the normal points to
    Mesh mesh;  // kMesh only, in world space, every triangle with an area; world_from_object is
                // identity
};

/// Shapes that are seen only where instances place them. Their transforms and meshes lead to the
/// group's own space; an instance's world_from_object, regular and otherwise any, leads from there
/// to the world. Normals go by the inverse transpose, so what is in front stays in front. No
/// emitters, no instances; spheres only where instances scale them evenly.
struct ShapeGroup {
    std::string id{};
    std::vector<Shape> shapes{};
};

struct Scene {
    std::string name;  // file name without folder and extension
    std::string hash;  // XXH3-128 hex over the XML file, LoadOptions::defines and every mesh and
                       // image file, in order
    std::vector<Bsdf> bsdfs;
    std::vector<Texture> textures;
    std::vector<ShapeGroup> groups;
    std::vector<Shape> shapes;
    bool has_environment = false;
    Rgb environment{0, 0, 0};  // constant emitter's radiance; of an image the mean over the sphere
    // The image, linear floats of radiance, in latitude and longitude as Mitsuba has it; width 0:
    // none.
    Image environment_map{};
    std::array<float, 9> map_from_world{1, 0, 0, 0, 1, 0, 0, 0, 1};  // orthogonal, row-major
    struct PointLight {
        std::array<float, 3> position{};
        Rgb intensity{};
    };
    std::vector<PointLight> point_lights;

    View view;                      // the file's sensor
    int width = 256, height = 256;  // film
    int spp = 16;                   // sampler's sample_count
    int max_depth = 50;  // path integrator: edges of the longest path; -1 in a file means 2^31-1
    int rr_depth = 5;    // roulette starts at this depth
    // What --ignore-unsupported left out, each with file and line.
    std::vector<std::string> warnings;

    std::array<float, 3> bounds_min{}, bounds_max{};  // of all shapes
};

struct LoadOptions {
    bool ignore_unsupported = false;  // unsupported nodes become warnings instead of errors
    std::map<std::string, std::string> defines{};  // values of <default> names, as Mitsuba's -D
};

/// Reads a scene. A bare name ("cornell") is looked up in PAVE's own scenes folder (PAVE_SCENE_DIR
/// overrides), anything with a slash or ".xml" is a path. Throws InputError as "file:line: node:
/// reason", UsageError for a define that the file lacks.
Scene load_scene(const std::string& path_or_name, const LoadOptions& options = {});

/// `count` views on the hemisphere around `scene`'s centre on the side of its camera, all looking
/// at the centre, as in the papers: evenly over the directions up to 45 degrees off the line from
/// centre to camera, at the camera's distance and with its field of view. Deterministic in `seed`;
/// view i is the same for every `count` > i. Throws UsageError for a camera in the centre.
std::vector<View> hemisphere_views(const Scene& scene, int count, uint64_t seed);

}  // namespace pave
