// Transforms against matrices read back from Mitsuba 3.9.1 (scalar_rgb), and what each shape makes
// of its transform.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/transform.h"
#include "tests/host/scene/scene_files.h"

namespace pave::test {
namespace {

class Transform : public SceneFiles {
   protected:
    Matrix4 matrix_of(const std::string& steps) const {
        return load("<shape type='rectangle'><transform name='to_world'>" + steps +
                    "</transform></shape>")
            .shapes[0]
            .world_from_object;
    }
    static void expect_near(const Matrix4& actual, const Matrix4& expected) {
        for (size_t i = 0; i < 16; ++i)
            EXPECT_NEAR(actual[i], expected[i], 1e-6) << "element " << i;
    }
};

TEST_F(Transform, FirstChildActsFirst) {
    expect_near(matrix_of("<translate x='1'/><scale x='2'/><rotate z='1' angle='90'/>"),
                {0, -1, 0, 0, 2, 0, 0, 2, 0, 0, 1, 0, 0, 0, 0, 1});
}

TEST_F(Transform, StepsAreMitsubas) {
    expect_near(
        matrix_of("<rotate x='0.48' y='0.6' z='-0.64' angle='40'/><scale x='2' y='0.5' z='3'/>"
                  "<translate x='1' y='-2' z='0.25'/><matrix value='1 0.1 0 0 0 1 0.2 0 "
                  "0.3 0 1 0 0 0 0 1'/>"),
        {1.6226953268051147f, 1.0000399351119995f, 0.6076840162277222f, 0.800000011920929f,
         -0.44652867317199707f, 0.5563536882400513f, 0.3179350793361664f, -1.9500000476837158f,
         -0.8806624412536621f, 0.9433553218841553f, 2.7738988399505615f, 0.550000011920929f, 0, 0,
         0, 1});
    expect_near(matrix_of("<lookat origin='1,2,3' target='4,-2,3.5' up='0 0 1'/>"),
                {0.800000011920929f, -0.05970223248004913f, 0.597022294998169f, 1,
                 0.6000000238418579f, 0.07960297167301178f, -0.7960297465324402f, 2, 0,
                 0.9950371980667114f, 0.09950371831655502f, 3, 0, 0, 0, 1});
    expect_near(matrix_of("<matrix value='1 2 3 0 1 4 0 0 1'/>"),
                {1, 2, 3, 0, 0, 1, 4, 0, 0, 0, 1, 0, 0, 0, 0, 1});
    expect_near(matrix_of("<scale value='2 3 4'/>"), matrix_of("<scale x='2' y='3' z='4'/>"));
}

TEST_F(Transform, LookatWithoutUpIsMitsubas) {
    expect_near(matrix_of("<lookat origin='1,2,3' target='0,0,0'/>"),
                {-0.07928650826215744f, 0.9603567719459534f, -0.26726123690605164f, 1,
                 0.8414269685745239f, -0.07928650826215744f, -0.5345224738121033f, 2,
                 -0.5345224738121033f, -0.26726123690605164f, -0.8017837405204773f, 3, 0, 0, 0, 1});
}

TEST_F(Transform, MirroredSpheresTurnTheirNormals) {
    const auto sphere = [&](const std::string& inside) {
        return load("<shape type='sphere'>" + inside + "</shape>").shapes[0];
    };
    const std::string mirror = "<transform name='to_world'><scale x='-1'/></transform>";
    EXPECT_FALSE(sphere("").flip_normals);
    EXPECT_TRUE(sphere("<boolean name='flip_normals' value='true'/>").flip_normals);
    EXPECT_TRUE(sphere(mirror).flip_normals);
    EXPECT_FALSE(sphere(mirror + "<boolean name='flip_normals' value='true'/>").flip_normals);
    EXPECT_TRUE(sphere("<float name='radius' value='-2'/>").flip_normals);
    const Matrix4 matrix =
        sphere("<float name='radius' value='-2'/><point name='center' value='1 2 3'/>")
            .world_from_object;
    expect_near(matrix, {2, 0, 0, 1, 0, 2, 0, 2, 0, 0, 2, 3, 0, 0, 0, 1});
}

TEST_F(Transform, SphereTakesCenterBeforeToWorld) {
    const Shape shape =
        load(
            "<shape type='sphere'><point name='center' x='1' y='0' z='0'/><float name='radius' "
            "value='0.5'/>"
            "<transform name='to_world'><scale value='2'/><translate y='1'/></transform></shape>")
            .shapes[0];
    expect_near(shape.world_from_object, {1, 0, 0, 2, 0, 1, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1});
}

TEST(Affine, NormalsStayOrthogonalToTangents) {
    Affine map;
    map.linear = {{{2, 1, 0}, {0, 3, 0.5}, {1, 0, -1}}};
    const Double3 normal = map.normal({0, 0, 1});
    EXPECT_NEAR(dot(normal, map.vector({1, 0, 0})), 0, 1e-12);
    EXPECT_NEAR(dot(normal, map.vector({0, 1, 0})), 0, 1e-12);
    EXPECT_NEAR(dot(normal, map.vector({0, 0, 1})), map.determinant(), 1e-12);
}

}  // namespace
}  // namespace pave::test
