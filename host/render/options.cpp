// Checks of options and views, and the parameter block of one render.
// SPDX-License-Identifier: BSD-3-Clause
#include "host/render/options.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>
#include <string>

#include "host/device/impl.h"
#include "host/render/sobol.h"
#include "pave/error.h"

namespace pave {
namespace {

constexpr int kMaxSpp = 1 << 24;
// Without roulette a path in a lossless scene ends here only.
constexpr int kMaxDepthWithoutRoulette = 1 << 16;
constexpr const char* kNames[CHANNEL_COUNT] = {
    "color", "albedo", "direct", "normal", "depth", "distance", "variance", "position", "object"};
constexpr int kPathsPerSegment = 4096;  // a work-item's worth: 0.1 to 0.8 ms on a CPU core
constexpr int kLeastSegment = 8;
constexpr int kLargestSegment = 256;  // PAVE_SEGMENT

[[noreturn]] void refuse(const std::string& what, auto value, const std::string& range) {
    throw UsageError(what + " " + std::to_string(value) + " is outside " + range);
}

void copy3(float* to, Double3 v) {
    const std::array<float, 3> f = to_floats(v);
    std::memcpy(to, f.data(), sizeof f);
}

bool has(uint32_t channels, int channel) { return (channels >> channel & 1) != 0; }

/// Edges that the channels need; albedo goes further along specular chains by itself.
int shade_depth(uint32_t channels, int max_depth) {
    if (has(channels, CHANNEL_COLOR) || has(channels, CHANNEL_VARIANCE)) return max_depth;
    return std::min(max_depth, has(channels, CHANNEL_DIRECT) ? 2 : 1);
}

/// Film point (x, y) in pixels, y down: a point of the plane z = 1 of the camera, whose x axis
/// points left.
void set_camera(kernel::PathParams& p, const View& view, int width, int height) {
    const Axes camera(view.world_from_camera);
    const double half =
        std::tan(static_cast<double>(view.fov_x_degrees) * std::numbers::pi / 360.0);
    const double pixel = 2 * half / width;
    copy3(p.eye, camera.origin);
    copy3(p.right, camera.x * -pixel);
    copy3(p.down, camera.y * -pixel);
    copy3(p.corner, camera.z + camera.x * half + camera.y * (pixel * height / 2));
    copy3(p.forward, normalized(camera.z));
}

template <class T>
void append(std::vector<Row>& rows, const std::vector<T>& items) {
    static_assert(sizeof(T) % sizeof(Row) == 0);
    const size_t begin = rows.size();
    rows.resize(begin + items.size() * (sizeof(T) / sizeof(Row)));
    if (!items.empty()) std::memcpy(&rows[begin], items.data(), items.size() * sizeof(T));
}

template <class T>
uint32_t rows_of(const std::vector<T>& items) {
    return static_cast<uint32_t>(items.size() * (sizeof(T) / sizeof(Row)));
}

}  // namespace

void check_options(const View& view, const RenderOptions& options, size_t max_work_group_size) {
    if (options.spp < 1 || options.spp > kMaxSpp) refuse("spp", options.spp, "1..16777216");
    if (options.max_depth < 1) refuse("max_depth", options.max_depth, "1..2147483647");
    if (options.rr_depth < 0) refuse("rr_depth", options.rr_depth, "0..2147483647");
    if (std::min(options.max_depth, options.rr_depth) > kMaxDepthWithoutRoulette)
        throw UsageError("max_depth " + std::to_string(options.max_depth) + " with rr_depth " +
                         std::to_string(options.rr_depth) +
                         ": paths beyond 65536 edges need roulette; lower one of them");
    if (options.frame_index < 0 || options.frame_index > 0xffffffffLL)
        refuse("frame_index", options.frame_index, "0..4294967295");
    if (options.tile_rows < 0) refuse("tile_rows", options.tile_rows, "0..height");
    if (options.work_group_size < 0 ||
        static_cast<size_t>(options.work_group_size) > max_work_group_size)
        refuse("work_group_size", options.work_group_size,
               "0.." + std::to_string(max_work_group_size));
    if (options.sampler != Sampler::kSobol && options.sampler != Sampler::kIndependent)
        refuse("sampler", static_cast<int>(options.sampler), "sobol, independent");
    const int lanes = options.lane_width;
    if (lanes != 0 && lanes != 1 && lanes != 4 && lanes != 8 && lanes != 16)
        refuse("lane_width", lanes, "0, 1, 4, 8, 16");
    if (!(view.fov_x_degrees > 0.0f && view.fov_x_degrees < 180.0f))
        refuse("field of view", view.fov_x_degrees, "(0, 180) degrees");
    for (float x : view.world_from_camera)
        if (!std::isfinite(x))
            throw UsageError("the view's matrix has an entry that is not finite");
    const Axes axes(view.world_from_camera);
    const double volume = std::abs(dot(cross(axes.x, axes.y), axes.z));
    if (!(volume > 1e-6 * length(axes.x) * length(axes.y) * length(axes.z)))
        throw UsageError(
            "the view's matrix is singular; its first three columns must be independent axes");
}

uint32_t channels_of(const FrameSchema& schema) {
    uint32_t channels = 0;
    for (int i = 0; i < CHANNEL_COUNT; ++i) {
        const int at = schema.find(kNames[i]);
        if (at < 0) continue;
        const int planes = schema.channels()[static_cast<size_t>(at)].planes;
        if (planes != known_channel_planes(kNames[i]))
            throw UsageError("channel '" + std::string(kNames[i]) + "' has " +
                             std::to_string(planes) + " planes, not " +
                             std::to_string(known_channel_planes(kNames[i])));
        channels |= 1u << i;
    }
    if (channels == 0)
        throw UsageError(
            "the frame has no channel that the path tracer writes; add color, albedo, direct, "
            "normal or depth");
    return channels;
}

bool is_rendered(std::string_view channel) {
    return std::find(std::begin(kNames), std::end(kNames), channel) != std::end(kNames);
}

int segment_of(int spp, int lanes) {
    return lanes == 1 ? 1 : std::clamp(kPathsPerSegment / spp, kLeastSegment, kLargestSegment);
}

void set_scene_params(kernel::PathParams& p, const SceneData& data, int lanes) {
    for (size_t a = 0; a < 3; ++a) p.tree_bound[a] = data.tree_bound[a];
    for (size_t kind = 0; kind < FLAT_KINDS; ++kind) {
        p.flat_count[kind] = data.broadcast ? data.flat_count[kind] : 0;
        p.flat_shadow[kind] = data.broadcast ? data.flat_shadow[kind] : 0;
    }
    for (size_t k = 0; k < 3; ++k) {
        p.axis_rects[k] = data.axis_rect_count[k];
        p.axis_cubes[k] = data.axis_cube_count[k];
        p.axis_shadow[k] = data.axis_shadow[k];
    }
    p.cube_count = data.broadcast ? static_cast<int>(data.cubes.size()) : 0;
    p.sphere_count = data.broadcast ? static_cast<int>(data.spheres.size()) : 0;
    p.surface_count = data.surface_count;
    p.light_count = data.light_count;
    const auto copies = static_cast<uint32_t>(data.repeat_shapes ? lanes : 1);
    p.flat_row = 0;
    p.axis_rect_row = rows_of(data.flats) * copies;
    p.axis_cube_row = p.axis_rect_row + rows_of(data.axis_rects) * copies;
    p.cube_row = p.axis_cube_row + rows_of(data.axis_cubes) * copies;
    p.sphere_row = p.cube_row + rows_of(data.cubes) * copies;
    p.surface_row = 0;
    p.triangle_row = rows_of(data.surfaces);
    p.bsdf_row = p.triangle_row + rows_of(data.triangles);
    p.light_row = p.bsdf_row + rows_of(data.bsdfs);
    p.uv_row = p.light_row + rows_of(data.lights);
    p.texture_row = p.uv_row + rows_of(data.uvs);
    p.environment_row = p.texture_row + rows_of(data.textures);
    p.sobol_row = p.environment_row + rows_of(data.environment);
    p.leaf_row = static_cast<uint32_t>(data.leaf_row);
    p.instance_row = static_cast<uint32_t>(data.instance_row);
}

kernel::PathParams make_params(const SceneData& data, const Scene& scene, const View& view,
                               const RenderOptions& options, const FrameSchema& schema, int lanes) {
    kernel::PathParams p{};
    for (int i = 0; i < CHANNEL_COUNT; ++i)
        if (const int at = schema.find(kNames[i]); at >= 0)
            p.channel_offset[i] = schema.channel_byte_offset(at) / sizeof(float);
    p.plane = static_cast<uint64_t>(schema.width()) * static_cast<uint64_t>(schema.height());
    set_camera(p, view, schema.width(), schema.height());
    for (int c = 0; c < 3; ++c)
        p.environment[c] = scene.has_environment ? scene.environment[static_cast<size_t>(c)] : 0.0f;
    p.environment_pmf = data.environment_pmf;
    p.offset_floor = data.offset_floor;
    p.width = schema.width();
    p.height = schema.height();
    p.segment = segment_of(options.spp, lanes);
    p.spp = options.spp;
    p.max_depth = options.max_depth;
    p.shade_depth = shade_depth(channels_of(schema), options.max_depth);
    p.rr_depth = options.rr_depth;
    p.seed_low = static_cast<uint32_t>(options.seed);
    p.seed_high = static_cast<uint32_t>(options.seed >> 32);
    p.frame = static_cast<uint32_t>(options.frame_index);

    set_scene_params(p, data, lanes);
    return p;
}

std::vector<Row> pack_shapes(const SceneData& data, int lanes) {
    std::vector<Row> rows;
    append(rows, data.flats);
    append(rows, data.axis_rects);
    append(rows, data.axis_cubes);
    append(rows, data.cubes);
    append(rows, data.spheres);
    rows.resize(rows.size() + 2);
    if (!data.repeat_shapes || lanes == 1) return rows;
    std::vector<Row> repeated(rows.size() * static_cast<size_t>(lanes));
    float* to = repeated[0].data();
    for (const Row& row : rows)
        for (float number : row) to = std::fill_n(to, lanes, number);
    return repeated;
}
std::vector<Row> pack_tables(const SceneData& data) {
    std::vector<Row> rows;
    append(rows, data.surfaces);
    append(rows, data.triangles);
    append(rows, data.bsdfs);
    append(rows, data.lights);
    append(rows, data.uvs);
    append(rows, data.textures);
    append(rows, data.environment);
    append(rows, sobol_rows());
    return rows;
}

Defines scene_defines(const SceneData& data, const DeviceProfile& profile, size_t tree_byte_size,
                      TreeTurns turns, int lanes) {
    Defines defines = data.features;
    defines.insert_or_assign("PAVE_LANES", lanes);
    const bool large = lanes > 1 && tree_byte_size > profile.cache_byte_size;
    defines.insert_or_assign("PAVE_TREE_TURNS",
                             turns == TreeTurns::kAuto ? large : turns == TreeTurns::kAlways);
    return defines;
}

cl::Buffer make_tree_buffer(const Device& device, Block<Row>& rows) {
    const size_t byte_size = rows.size() * sizeof(Row);
    if (byte_size == 0 || device.impl().slot_access() != SlotAccess::kShared) {
        cl::Buffer buffer = make_buffer_of(device, rows, "tree");
        rows = {};
        return buffer;
    }
    if (byte_size > device.profile().max_alloc_byte_size)  // throws, with both sizes
        return make_buffer(device, byte_size, "tree");
    return cl_guard("tree", [&] {
        return cl::Buffer(context_of(device), CL_MEM_READ_ONLY | CL_MEM_USE_HOST_PTR, byte_size,
                          rows.data());
    });
}

}  // namespace pave
