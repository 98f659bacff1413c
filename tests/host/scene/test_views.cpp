// hemisphere_views: even over the cap, deterministic, every view through the open front.
// SPDX-License-Identifier: BSD-3-Clause
#include <cmath>
#include <numbers>

#include "host/scene/transform.h"
#include "tests/host/scene/scene_files.h"

namespace pave::test {
namespace {

constexpr double kCapDegrees = 45;

Double3 column(const View& view, size_t i) {
    const auto& m = view.world_from_camera;
    return {m[i], m[4 + i], m[8 + i]};
}

class HemisphereViews : public ::testing::Test {
   protected:
    Scene scene_ = load_scene(std::string(PAVE_SOURCE_DIR) + "/scenes/cornell.xml");
};

TEST_F(HemisphereViews, LookAtTheCentreFromTheCamerasDistance) {
    for (const View& view : hemisphere_views(scene_, 500, 7)) {
        const Double3 eye = column(view, 3), forward = column(view, 2), up = column(view, 1);
        EXPECT_NEAR(length(eye), 3.9, 1e-5);
        EXPECT_NEAR(dot(forward, normalized(eye)), -1, 1e-6);  // the box's centre is the origin
        EXPECT_GE(normalized(eye)[2], std::cos(kCapDegrees * std::numbers::pi / 180) - 1e-6);
        EXPECT_GT(up[1], 0.5);
        EXPECT_NEAR(dot(cross(column(view, 0), up), forward), 1, 1e-5);  // right-handed, no scale
        EXPECT_EQ(view.fov_x_degrees, scene_.view.fov_x_degrees);
    }
}

TEST_F(HemisphereViews, DependOnSeedAndIndexOnly) {
    const std::vector<View> few = hemisphere_views(scene_, 10, 3),
                            many = hemisphere_views(scene_, 1000, 3);
    for (size_t i = 0; i < few.size(); ++i) EXPECT_EQ(few[i], many[i]) << i;
    EXPECT_NE(hemisphere_views(scene_, 1, 4)[0], few[0]);
    EXPECT_TRUE(hemisphere_views(scene_, 0, 3).empty());
    EXPECT_THROW(hemisphere_views(scene_, -1, 3), UsageError);
}

// Equal-area cells of the cap. A low-discrepancy set of n points misses a cell's share by far less
// than the sqrt(n) of chance: at most 3 of 25 here, where independent points would be 5 off in one
// cell of three.
TEST_F(HemisphereViews, CoverTheCapEvenly) {
    constexpr int kRings = 5, kSectors = 8, kCount = 1000;
    for (const uint64_t seed : {0ull, 1ull, 2ull, 12345678901ull}) {
        std::array<int, kRings * kSectors> counts{};
        for (const View& view : hemisphere_views(scene_, kCount, seed)) {
            const Double3 direction = normalized(column(view, 3));
            const double u =
                (1 - direction[2]) / (1 - std::cos(kCapDegrees * std::numbers::pi / 180));
            const double v = std::atan2(direction[1], direction[0]) / (2 * std::numbers::pi) + 0.5;
            const int ring = std::clamp(static_cast<int>(u * kRings), 0, kRings - 1);
            const int sector = std::clamp(static_cast<int>(v * kSectors), 0, kSectors - 1);
            ++counts[static_cast<size_t>(ring * kSectors + sector)];
        }
        for (const int count : counts)
            EXPECT_NEAR(count, kCount / (kRings * kSectors), 4) << "seed " << seed;
    }
}

// Share of the picture's rays that go in through the open front, which is the square z = 1 of the
// box.
double share_through_front(const View& view) {
    constexpr int kGrid = 32;
    const double half = std::tan(0.5 * view.fov_x_degrees * std::numbers::pi / 180);
    const Double3 eye = column(view, 3);
    int inside = 0;
    for (int y = 0; y < kGrid; ++y)
        for (int x = 0; x < kGrid; ++x) {
            const double u = half * (1 - 2 * (x + 0.5) / kGrid),
                         v = half * (1 - 2 * (y + 0.5) / kGrid);
            const Double3 ray = u * column(view, 0) + v * column(view, 1) + column(view, 2);
            const Double3 hit = eye + ((1 - eye[2]) / ray[2]) * ray;
            inside += ray[2] < 0 && std::abs(hit[0]) <= 1 && std::abs(hit[1]) <= 1;
        }
    return static_cast<double>(inside) / (kGrid * kGrid);
}

TEST_F(HemisphereViews, SeeTheBoxThroughItsFront) {
    double sum = 0, least = 1;
    const std::vector<View> views = hemisphere_views(scene_, 480, 0);
    for (const View& view : views) {
        // The centre, where every view looks, is in sight: the way to it passes the opening.
        const Double3 eye = column(view, 3);
        EXPECT_LE(std::max(std::abs(eye[0]), std::abs(eye[1])) / eye[2], 1 + 1e-5);
        // All of the box is before the camera, and its picture is around the middle: corners on
        // either side of both axes.
        const double half = std::tan(0.5 * view.fov_x_degrees * std::numbers::pi / 180);
        double left = 0, right = 0, down = 0, up = 0;
        for (int corner = 0; corner < 8; ++corner) {
            const Double3 point{corner & 1 ? 1.0 : -1.0, corner & 2 ? 1.0 : -1.0,
                                corner & 4 ? 1.0 : -1.0};
            const Double3 to_corner = point - eye;
            const double depth = dot(to_corner, column(view, 2));
            EXPECT_GT(depth, 1);
            const double x =
                -dot(to_corner, column(view, 0)) / (half * depth);  // [-1, 1] is the picture
            const double y = dot(to_corner, column(view, 1)) / (half * depth);
            left = std::min(left, x), right = std::max(right, x), down = std::min(down, y),
            up = std::max(up, y);
        }
        for (const double extent : {-left, right, -down, up}) {
            EXPECT_GT(extent, 0.6);
            EXPECT_LT(extent, 1.6);
        }
        const double share = share_through_front(view);
        least = std::min(least, share);
        sum += share;
    }
    EXPECT_GT(least, 0.35);
    EXPECT_GT(sum / static_cast<double>(views.size()), 0.6);
    RecordProperty("least_share_through_front", std::to_string(least));
    RecordProperty("mean_share_through_front",
                   std::to_string(sum / static_cast<double>(views.size())));
}

class OtherCameras : public SceneFiles {};

TEST_F(OtherCameras, SideFollowsTheCamera) {
    const Scene scene = load_scene(write(
        "side.xml",
        with_sensor(
            "<shape type='cube'><transform name='to_world'><translate y='5'/></transform></shape>",
            "<transform name='to_world'><lookat origin='-6 5 0' target='0 5 1' up='0 0 "
            "1'/></transform>")));
    for (const View& view : hemisphere_views(scene, 100, 1)) {
        const Double3 from_center = column(view, 3) - Double3{0, 5, 0};
        EXPECT_NEAR(length(from_center), 6, 1e-5);
        EXPECT_LT(from_center[0], -6 * 0.7);
        EXPECT_GT(column(view, 1)[2], 0.5);
    }
}

TEST_F(OtherCameras, CameraThatLooksAcrossHasAnUpToo) {
    const Scene scene =
        load_scene(write("up.xml", with_sensor("<shape type='cube'/>",
                                               "<transform name='to_world'><lookat origin='0 9 0' "
                                               "target='1 9 0' up='0 1 0'/></transform>")));
    for (const View& view : hemisphere_views(scene, 20, 1))
        for (const float value : view.world_from_camera) EXPECT_TRUE(std::isfinite(value));
}

TEST_F(OtherCameras, CameraInTheCentreIsRefused) {
    const Scene scene = load_scene(write("in.xml", with_sensor("<shape type='cube'/>")));
    EXPECT_THROW(hemisphere_views(scene, 1, 0), UsageError);
}

}  // namespace
}  // namespace pave::test
