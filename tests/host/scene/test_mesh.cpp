// OBJ and PLY readers: what they read, what Mitsuba 3.9.1 makes of the same files, and what they
// refuse.
// SPDX-License-Identifier: BSD-3-Clause
#include <cstring>

#include "host/scene/mesh.h"
#include "tests/host/scene/scene_files.h"

namespace pave::test {
namespace {

const std::string kSquare = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

std::string error_of_mesh(const std::string& text, Mesh (*parse)(std::string_view)) {
    try {
        Mesh mesh = parse(text);
        place_mesh(mesh, {});
    } catch (const MeshError& error) {
        return error.what();
    }
    return "";
}

TEST(Obj, FansPolygonsAndSharesVertices) {
    Mesh mesh =
        parse_obj("# c\r\nmtllib a.mtl\r\no x\n" + kSquare + "s 1\nf 1 2 3 4 # quad\nf -4 -2 -1\n");
    EXPECT_EQ(mesh.positions.size(), 4u);
    ASSERT_EQ(mesh.triangles.size(), 3u);
    EXPECT_EQ(mesh.triangles[0], (std::array<uint32_t, 3>{0, 1, 2}));
    EXPECT_EQ(mesh.triangles[1], (std::array<uint32_t, 3>{0, 2, 3}));
    EXPECT_EQ(mesh.triangles[2], (std::array<uint32_t, 3>{0, 2, 3}));
    EXPECT_TRUE(mesh.normals.empty());
}

TEST(Obj, KeepsVerticesApartByNormalAndTexture) {
    const Mesh mesh = parse_obj(
        kSquare + "vn 0 0 1\nvn 0 1 0\nvt 0 0\nvt 1 1\nf 1//1 2//1 3//1\nf 1//2 3//1 4//1\n");
    EXPECT_EQ(mesh.positions.size(), 5u);
    EXPECT_EQ(mesh.normals.size(), 5u);
    EXPECT_EQ(
        parse_obj(kSquare + "vt 0 0\nvt 1 1\nf 1/1 2/1 3/1\nf 1/2 3/1 4/1\n").positions.size(), 5u);
}

TEST(Obj, RefusesWhatIsBroken) {
    const std::pair<std::string, const char*> cases[] = {
        {"", "the mesh is empty"},
        {kSquare, "the mesh is empty"},
        {kSquare + "f 1 2 9\n", "5: face: vertex 9 is out of range, there are 4 before this line"},
        {kSquare + "f 0 1 2\n", "5: face: vertex 0 is out of range"},
        {kSquare + "f -5 1 2\n", "5: face: vertex -5 is out of range"},
        {kSquare + "f 1 2 4000000000000\n", "is out of range"},
        {kSquare + "f 1 2 99999999999999999999\n", "is not an index"},
        {kSquare + "f 1//1 2//1 3//1\n", "normal 1 is out of range"},
        {kSquare + "f 1/1 2/1 3/1\n", "texture vertex 1 is out of range"},
        {kSquare + "f 1 2\n", "a face needs three vertices"},
        {kSquare + "f 1 2 x\n", "\"x\" is not an index"},
        {kSquare + "f 1 2 \\\n3\n", "lines continued by \\"},
        {"v 0 0\n", "1: needs three numbers"},
        {"v 0 zero 0\n", "\"zero\" is not a finite number"},
        {"v nan 0 0\n", "\"nan\" is not a finite number"},
        {"v 0 inf 0\n", "\"inf\" is not a finite number"},
        {kSquare + "vn 0 0 0\nf 1//1 2//1 3//1\n", "the normal of vertex 1 is zero"},
        {kSquare + "vn 0 0 1\nf 1//1 2//1 3//1\nf 1 3 4\n", "1 of 2 faces have no normals"},
        {kSquare + "f 1 1 2\n", "no triangle has an area"},
    };
    for (const auto& [text, expected] : cases) {
        const std::string message = error_of_mesh(text, parse_obj);
        EXPECT_NE(message.find(expected), std::string::npos)
            << "got \"" << message << "\", expected: " << expected;
    }
}

const std::string kHeader =
    "ply\nformat ascii 1.0\ncomment c\nelement vertex 4\nproperty float x\nproperty double "
    "y\nproperty float z\n"
    "element extra 1\nproperty list uchar int things\nelement face 1\nproperty uchar kind\n"
    "property list uchar int vertex_indices\nend_header\n";
const std::string kVertices = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 7 8\n";

TEST(Ply, ReadsAsciiWithOtherElements) {
    const Mesh mesh = parse_ply(kHeader + kVertices + "9 4 0 1 2 3");
    EXPECT_EQ(mesh.positions[2], (std::array<float, 3>{1, 1, 0}));
    ASSERT_EQ(mesh.triangles.size(), 2u);
    EXPECT_EQ(mesh.triangles[1], (std::array<uint32_t, 3>{0, 2, 3}));
}

TEST(Ply, ReadsBothByteOrders) {
    for (const bool big : {false, true}) {
        std::string text =
            "ply\nformat binary_" + std::string(big ? "big" : "little") +
            "_endian 1.0\nelement vertex 3\nproperty double x\nproperty float y\nproperty short z\n"
            "element face 1\nproperty list ushort uint vertex_index\nend_header\n";
        const auto put = [&](auto value) {
            char bytes[sizeof(value)];
            std::memcpy(bytes, &value, sizeof(value));
            if (big) std::reverse(bytes, bytes + sizeof(value));
            text.append(bytes, sizeof(value));
        };
        const int corners[3][3] = {{0, 0, 0}, {2, 0, -3}, {0, 5, 0}};
        for (const auto& corner : corners) {
            put(static_cast<double>(corner[0]));
            put(static_cast<float>(corner[1]));
            put(static_cast<int16_t>(corner[2]));
        }
        put(uint16_t{3});
        for (const uint32_t index : {2u, 1u, 0u}) put(index);
        const Mesh mesh = parse_ply(text);
        EXPECT_EQ(mesh.positions[1], (std::array<float, 3>{2, 0, -3}));
        EXPECT_EQ(mesh.triangles[0], (std::array<uint32_t, 3>{2, 1, 0}));
        for (size_t cut = 0; cut < text.size(); ++cut)
            EXPECT_THROW(parse_ply(std::string_view(text).substr(0, cut)), MeshError)
                << "cut to " << cut << " bytes";
        EXPECT_THROW(parse_ply(text + "x"), MeshError);
    }
}

TEST(Ply, RefusesWhatIsBroken) {
    std::string no_z = kHeader, nan_y = kVertices, no_list = kHeader, huge = kHeader;
    no_z.replace(no_z.find("property float z"), 16, "property float w");
    nan_y.replace(nan_y.find("1 1"), 3, "1 nan");
    no_list.replace(no_list.find("vertex_indices"), 14, "vertex_indexes");
    huge.replace(huge.find("vertex 4"), 8, "vertex 4000000000");
    const std::pair<std::string, const char*> cases[] = {
        {"", "the header has no end_header"},
        {"plx\nend_header\n", "does not begin with \"ply\""},
        {"ply\nformat ascii 1.0\nelement vertex x\nend_header\n",
         "3: element count \"x\" is no count"},
        {"ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n",
         "4: type \"quad\" is not known"},
        {"ply\nformat klingon 1.0\nend_header\n", "2: format \"klingon\" is not known"},
        {"ply\nend_header\n", "no format line"},
        {"ply\nhello\nend_header\n", "2: header line begins with \"hello\""},
        {kHeader + kVertices + "9 3 0 1 9\n",
         "19: face 1: a vertex index is out of range, there are 4 vertices"},
        {kHeader + kVertices + "9 3 0 1 -1\n", "a vertex index is out of range"},
        {kHeader + kVertices + "9 3 0 1 1.5\n", "a vertex index is out of range"},
        {kHeader + kVertices + "9 2 0 1\n", "face 1 has fewer than three vertices"},
        {kHeader + kVertices + "9 -3 0 1\n", "no sound length"},
        {kHeader + kVertices + "9 200 0 1\n", "no sound length"},
        {kHeader + kVertices + "9 3 0 1\n", "the file ends early"},
        {kHeader + kVertices, "the file ends early"},
        {kHeader + kVertices + "9 3 0 1 2 5\n", "data after the last element"},
        {kHeader + nan_y + "9 3 0 1 2\n", "16: \"nan\" is not a finite number"},
        {no_z + kVertices + "9 3 0 1 2\n", "vertices have no \"z\""},
        {no_list + kVertices + "9 3 0 1 2\n", "faces have no list"},
        {huge + kVertices + "9 3 0 1 2\n", "too short for 4000000000"},
    };
    for (const auto& [text, expected] : cases) {
        const std::string message = error_of_mesh(text, parse_ply);
        EXPECT_NE(message.find(expected), std::string::npos)
            << "got \"" << message << "\", expected: " << expected;
    }
}

class MeshInScene : public SceneFiles {};

TEST_F(MeshInScene, ErrorNamesBothFiles) {
    write("m.obj", kSquare + "f 1 2 9\n");
    const std::string message = error_of(
        with_sensor("<shape type='obj'>\n<string name='filename' value='m.obj'/></shape>"));
    EXPECT_NE(message.find("scene.xml:3: string \"filename\": "), std::string::npos) << message;
    EXPECT_NE(message.find("m.obj:5: face: vertex 9 is out of range"), std::string::npos)
        << message;
}

TEST_F(MeshInScene, OverflowByPlaceIsRefused) {
    write("m.obj", "v 0 0 0\nv 1e11 0 0\nv 0 1 0\nf 1 2 3\n");
    const std::string shape = "<shape type='obj'><string name='filename' value='m.obj'/>";
    EXPECT_NO_THROW(load(shape + "</shape>"));
    EXPECT_NE(error_of(with_sensor(
                           shape +
                           "<transform name='to_world'><scale value='1000'/></transform></shape>"))
                  .find("vertex 2 is not finite or beyond 1e12"),
              std::string::npos);
}

TEST_F(MeshInScene, AnisotropicRoughnessIsRefused) {
    write("m.obj", kSquare + "f 1 2 3\n");
    const std::string body =
        "<shape type='obj'><string name='filename' value='m.obj'/><bsdf type='roughconductor'>"
        "<string name='distribution' value='ggx'/><float name='alpha_u' value='.1'/><float "
        "name='alpha_v' value='.2'/>"
        "</bsdf></shape>";
    EXPECT_NE(error_of(with_sensor(body)).find("need a direction"), std::string::npos);
}

TEST_F(MeshInScene, SidesAreMitsubas) {
    // One square with a slanted normal; Mitsuba's shading and geometric normals at its centre, case
    // by case.
    write("m.obj", kSquare + "vn 0.6 0 0.8\nf 1//1 2//1 3//1 4//1\n");
    struct Case {
        const char* inside;
        std::array<float, 3> shading;  // zeros: none
        float geometric_z;
    };
    const std::string mirror = "<transform name='to_world'><scale x='-1'/></transform>";
    const std::string flip = "<boolean name='flip_normals' value='true'/>",
                      flat = "<boolean name='face_normals' value='true'/>";
    const std::pair<std::string, std::pair<std::array<float, 3>, float>> cases[] = {
        {"", {{0.6f, 0, 0.8f}, 1}},
        {flip, {{-0.6f, 0, -0.8f}, -1}},
        {flat, {{0, 0, 0}, 1}},
        {mirror, {{-0.6f, 0, 0.8f}, -1}},
        {mirror + flip, {{0.6f, 0, -0.8f}, 1}},
        {mirror + flat, {{0, 0, 0}, -1}},
    };
    for (const auto& [inside, expected] : cases) {
        const Shape shape =
            load("<shape type='obj'><string name='filename' value='m.obj'/>" + inside + "</shape>")
                .shapes[0];
        EXPECT_FALSE(shape.flip_normals) << inside;
        if (expected.first == std::array<float, 3>{0, 0, 0}) {
            EXPECT_TRUE(shape.mesh.normals.empty()) << inside;
        } else {
            ASSERT_FALSE(shape.mesh.normals.empty()) << inside;
            for (size_t i = 0; i < 3; ++i)
                EXPECT_NEAR(shape.mesh.normals[0][i], expected.first[i], 1e-6) << inside;
        }
        const auto& t = shape.mesh.triangles[0];
        const auto& p = shape.mesh.positions;
        const float z = (p[t[1]][0] - p[t[0]][0]) * (p[t[2]][1] - p[t[0]][1]) -
                        (p[t[1]][1] - p[t[0]][1]) * (p[t[2]][0] - p[t[0]][0]);
        EXPECT_EQ(z > 0, expected.second > 0) << inside;
    }
}

// Vertices of scenes/materials.xml as Mitsuba 3.9.1 has them after loading: order, place and
// computed normals.
TEST_F(MeshInScene, VerticesAreMitsubas) {
    const Scene scene = load_scene(std::string(PAVE_SOURCE_DIR) + "/scenes/materials.xml");
    struct Vertex {
        const char* shape;
        size_t index;
        std::array<float, 3> position, normal;
    };
    const Vertex vertices[] = {
        {"rock",
         0,
         {-1.2373623847961426f, 0.7581543922424316f, 1.5f},
         {-0.2813948392868042f, 0.9499049782752991f, -0.13600574433803558f}},
        {"rock",
         1,
         {-1.3529244661331177f, 0.7165271639823914f, 1.57632315158844f},
         {-0.6466471552848816f, 0.7624379396438599f, -0.023148290812969208f}},
        {"rock",
         7,
         {-1.3639535903930664f, 0.6060636043548584f, 1.7892752885818481f},
         {-0.695140540599823f, 0.23811744153499603f, 0.6782916784286499f}},
        {"rock",
         100,
         {-0.534483790397644f, 0.41999998688697815f, 1.2898882627487183f},
         {0.7693750858306885f, 0, -0.6387973427772522f}},
        {"ring",
         0,
         {1.3437628746032715f, 1.049290657043457f, -0.5f},
         {0.9659258723258972f, 0.258819043636322f, 0}},
        {"ring",
         100,
         {0.9934985637664795f, 1.4851226806640625f, -0.6862204670906067f},
         {0.5110370516777039f, 0.8248346447944641f, -0.2418447583913803f}},
        {"gem", 7, {1.6613106727600098f, 0.7093215584754944f, 1.1892752647399902f}, {0, 0, 0}},
    };
    for (const Vertex& vertex : vertices) {
        const Shape* shape = nullptr;
        for (const Shape& candidate : scene.shapes)
            if (candidate.id == vertex.shape) shape = &candidate;
        ASSERT_NE(shape, nullptr) << vertex.shape;
        for (size_t i = 0; i < 3; ++i) {
            EXPECT_NEAR(shape->mesh.positions[vertex.index][i], vertex.position[i], 1e-6)
                << vertex.shape << vertex.index;
            if (vertex.normal != std::array<float, 3>{0, 0, 0})
                EXPECT_NEAR(shape->mesh.normals[vertex.index][i], vertex.normal[i], 2e-6)
                    << vertex.shape << vertex.index;
            else
                EXPECT_TRUE(shape->mesh.normals.empty());
        }
    }
    const std::map<std::string, double> areas{
        {"rock", 2.721327543258667}, {"ring", 4.745056629180908}, {"gem", 2.539196252822876}};
    for (const Shape& shape : scene.shapes)
        if (const auto area = areas.find(shape.id); area != areas.end()) {
            EXPECT_NEAR(mesh_area(shape.mesh), area->second, 1e-5) << shape.id;
        }
}

// Cut and bent meshes end in MeshError or are sound; every index stays in range whatever the bytes.
TEST_F(MeshInScene, MutatedMeshesStaySound) {
    const auto read = [](const char* name) {
        std::ifstream stream(std::string(PAVE_SOURCE_DIR) + "/scenes/meshes/" + name,
                             std::ios::binary);
        return std::string((std::istreambuf_iterator<char>(stream)), {});
    };
    uint64_t state = 0x9E3779B97F4A7C15ull;
    const auto random = [&state](size_t bound) {
        state ^= state << 13, state ^= state >> 7, state ^= state << 17;
        return static_cast<size_t>(state % bound);
    };
    int sound = 0, refused = 0;
    for (const char* name : {"torus.ply", "rock.obj"}) {
        const std::string original = read(name);
        ASSERT_FALSE(original.empty());
        for (int round = 0; round < 400; ++round) {
            std::string bytes = original;
            for (size_t edits = 1 + random(3); edits > 0; --edits)
                bytes[round % 2 ? random(std::min<size_t>(bytes.size(), 300))
                                : random(bytes.size())] = static_cast<char>(random(256));
            if (round % 5 == 0) bytes.resize(random(bytes.size()));
            try {
                Mesh mesh = name[0] == 't' ? parse_ply(bytes) : parse_obj(bytes);
                place_mesh(mesh, {});
                ++sound;
                for (const auto& triangle : mesh.triangles)
                    for (const uint32_t vertex : triangle) ASSERT_LT(vertex, mesh.positions.size());
                for (const auto& position : mesh.positions)
                    for (const float x : position)
                        ASSERT_TRUE(std::abs(x) <= 1e12f) << name << " round " << round;
            } catch (const MeshError&) {
                ++refused;
            }
        }
    }
    EXPECT_GT(sound, 50);
    EXPECT_GT(refused, 50);
}

}  // namespace
}  // namespace pave::test
