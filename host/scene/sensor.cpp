// Camera, film, sampler and integrator of the scene file.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/scene/sensor.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "host/scene/text.h"
#include "host/scene/transform.h"

namespace pave {
namespace {

constexpr int64_t kMaxExtent = 16384;  // FrameSchema's
constexpr int64_t kMaxSpp = int64_t{1} << 24;
constexpr double kRadiansPerDegree = std::numbers::pi / 180.0;
constexpr double kFullFrameDiagonalMm =
    43.266615305567875;  // 36 mm x 24 mm, what focal lengths refer to

int64_t read_bounded(Properties& properties, const std::string& name, int64_t fallback,
                     int64_t most) {
    const pugi::xml_node node = properties.peek(name);
    const int64_t value = properties.integer(name, fallback);
    if (value < 1 || value > most)
        properties.file().fail(node, quote(name) + " must be in 1.." + std::to_string(most));
    return value;
}

// PAVE draws each sample inside its pixel with weight 1: the box filter. Mitsuba's default is
// gaussian.
void read_filter(Properties& film) {
    SceneFile& file = film.file();
    const std::vector<pugi::xml_node> filters = film.take_objects("rfilter");
    if (filters.empty())
        return file.unsupported(film.node(),
                                "no <rfilter type=\"box\"/>: Mitsuba's default filter is gaussian, "
                                "PAVE has box only");
    if (filters.size() > 1) file.fail(filters[1], "a film has one rfilter");
    Properties filter(file, filters[0]);
    if (filter.type() != "box")
        return file.unsupported(
            filters[0], "filter " + quote(filter.type()) + " is not supported: use \"box\"");
    filter.finish();
}

void read_film(SceneFile& file, pugi::xml_node node, Scene& scene) {
    Properties film(file, node);
    if (film.type() != "hdrfilm")
        file.unsupported(node, "this film is not supported: use \"hdrfilm\"");
    scene.width = static_cast<int>(read_bounded(film, "width", 768, kMaxExtent));
    scene.height = static_cast<int>(read_bounded(film, "height", 576, kMaxExtent));
    // How a file would be stored, and sums that only matter to wider filters.
    film.accept({"component_format", "pixel_format", "file_format", "sample_border", "compensate"});
    read_filter(film);
    film.finish();
}

// Samples are always independent: the other samplers have the same mean, and only their count is
// taken.
void read_sampler(SceneFile& file, pugi::xml_node node, Scene& scene) {
    const std::vector<std::string> types{"independent", "stratified", "multijitter", "orthogonal",
                                         "ldsampler"};
    Properties sampler(file, node);
    if (std::find(types.begin(), types.end(), sampler.type()) == types.end())
        file.fail(node, "unknown sampler" + did_you_mean(sampler.type(), types) + "; there are " +
                            join(types));
    scene.spp = static_cast<int>(read_bounded(sampler, "sample_count", 4, kMaxSpp));
    sampler.accept({"seed", "jitter", "strength"});
    sampler.finish();
}

// "50mm" or "50"; degrees across the film's diagonal.
double diagonal_of_focal_length(Properties& sensor) {
    const pugi::xml_node node = sensor.peek("focal_length");
    std::string text = sensor.string("focal_length", "50mm");
    if (text.ends_with("mm")) text.resize(text.size() - 2);
    const std::optional<double> length_mm = parse_number(text);
    if (!length_mm || !(*length_mm > 0)) sensor.file().fail(node, "must be a length like 50mm");
    return 2 * std::atan(kFullFrameDiagonalMm / (2 * *length_mm)) / kRadiansPerDegree;
}

// Mitsuba's rules: the angle given is across the axis named, the picture plane is flat and pixels
// are square.
double read_fov_x(Properties& sensor, const Scene& scene) {
    SceneFile& file = sensor.file();
    const std::vector<std::string> axes{"x", "y", "smaller", "larger", "diagonal"};
    const pugi::xml_node node = sensor.peek("fov") ? sensor.peek("fov") : sensor.node();
    const pugi::xml_node axis_node = sensor.peek("fov_axis");
    std::string axis = sensor.string("fov_axis", "x");
    if (std::find(axes.begin(), axes.end(), axis) == axes.end())
        file.fail(axis_node, "fov_axis " + quote(axis) + " is not one of " + join(axes));
    const double aspect = static_cast<double>(scene.width) / scene.height;
    if (axis == "smaller") axis = aspect > 1 ? "y" : "x";
    if (axis == "larger") axis = aspect > 1 ? "x" : "y";
    double degrees = 0;
    if (sensor.has("fov")) {
        if (sensor.has("focal_length")) file.fail(node, "give either fov or focal_length");
        degrees = sensor.number("fov", 0);
    } else {
        degrees = diagonal_of_focal_length(sensor);
        axis = "diagonal";
    }
    if (!(degrees > 0) || !(degrees < 180))
        file.fail(node, "the field of view must be in (0, 180) degrees");
    const double half = std::tan(0.5 * degrees * kRadiansPerDegree);
    double half_x = half;
    if (axis == "y") half_x = half * aspect;
    if (axis == "diagonal") half_x = half * aspect / std::sqrt(aspect * aspect + 1);
    const double fov_x = 2 * std::atan(half_x) / kRadiansPerDegree;
    if (!(fov_x < 179.99)) file.fail(node, "the horizontal field of view reaches 180 degrees");
    return fov_x;
}

bool is_rigid(const Affine& map) {
    for (size_t i = 0; i < 3; ++i)
        if (std::abs(length(map.column(i)) - 1) > 1e-3) return false;
    return map.independence() > 1 - 1e-3;
}

}  // namespace

void read_sensor(SceneFile& file, pugi::xml_node node, Scene& scene) {
    Properties sensor(file, node);
    if (sensor.type() != "perspective")
        file.unsupported(node, "this sensor is not supported: use \"perspective\"");
    const std::vector<pugi::xml_node> films = sensor.take_objects("film"),
                                      samplers = sensor.take_objects("sampler");
    if (films.size() > 1) file.fail(films[1], "a sensor has one film");
    if (samplers.size() > 1) file.fail(samplers[1], "a sensor has one sampler");
    if (films.empty()) file.fail(node, "needs a <film type=\"hdrfilm\">");
    read_film(file, films[0], scene);
    scene.spp = 4;  // Mitsuba's default
    if (!samplers.empty()) read_sampler(file, samplers[0], scene);

    scene.view.fov_x_degrees = static_cast<float>(read_fov_x(sensor, scene));
    const pugi::xml_node place = sensor.peek("to_world");
    const Affine to_world = read_to_world(sensor);
    if (!is_rigid(to_world)) file.fail(place, "a camera cannot be scaled or sheared");
    scene.view.world_from_camera = to_world.matrix();
    // PAVE's rays begin at the pinhole and end nowhere: clipping planes only bound what a
    // rasteriser's depth can hold. Without motion there is no shutter, without a lens no focus.
    sensor.accept({"near_clip", "far_clip", "shutter_open", "shutter_close", "focus_distance"});
    for (const char* name : {"principal_point_offset_x", "principal_point_offset_y"}) {
        const pugi::xml_node offset = sensor.peek(name);
        if (sensor.number(name, 0) != 0)
            file.unsupported(offset, "a shifted principal point is not supported");
    }
    sensor.finish();
}

void read_integrator(SceneFile& file, pugi::xml_node node, Scene& scene) {
    Properties integrator(file, node);
    if (integrator.type() == "aov") {
        file.unsupported(
            node,
            "aov is not needed: PAVE writes its channels anyway; put the \"path\" integrator here");
        for (const pugi::xml_node nested : integrator.take_objects("integrator"))
            read_integrator(file, nested, scene);
        return;
    }
    if (integrator.type() != "path")
        return file.unsupported(node, "this integrator is not supported" +
                                          did_you_mean(integrator.type(), {"path"}) +
                                          ": use \"path\"");
    const pugi::xml_node depth_node = integrator.peek("max_depth"),
                         roulette_node = integrator.peek("rr_depth");
    const pugi::xml_node hide_node = integrator.peek("hide_emitters");
    const int64_t max_depth = integrator.integer("max_depth", -1);
    if (max_depth != -1 && (max_depth < 1 || max_depth > kEndlessDepth))
        file.fail(depth_node, "max_depth must be -1 (endless) or at least 1");
    scene.max_depth = static_cast<int>(max_depth == -1 ? kEndlessDepth : max_depth);
    const int64_t rr_depth = integrator.integer("rr_depth", 5);
    if (rr_depth < 1 || rr_depth > kEndlessDepth)
        file.fail(roulette_node, "rr_depth must be at least 1");
    scene.rr_depth = static_cast<int>(rr_depth);
    if (integrator.boolean("hide_emitters", false))
        file.unsupported(hide_node, "hidden emitters are not supported");
    integrator.accept({"block_size", "samples_per_pass", "timeout"});  // Mitsuba's schedule
    integrator.finish();
}

}  // namespace pave
