// What a render is asked for: checks, and the numbers that the kernel gets.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include "host/render/scene_data.h"
#include "pave/render.h"

namespace pave {

/// Throws UsageError, naming the option, its value and its range.
void check_options(const View& view, const RenderOptions& options, size_t max_work_group_size);

/// Channels of `schema` that the path tracer writes, as a CHANNEL_* bit set. Throws UsageError if
/// there are none or one has another number of planes than is known.
uint32_t channels_of(const FrameSchema& schema);

/// Whether the path tracer writes a channel of this name.
bool is_rendered(std::string_view channel);

/// Pixels of a row that a work-item renders: enough paths that lanes run dry rarely, few enough
/// pixels for many work-items. A function of samples and lanes only, since the order of additions
/// follows from it.
int segment_of(int spp, int lanes);

/// Fills in what follows from the scene alone: counts of shapes and where the parts of the buffers
/// begin.
void set_scene_params(kernel::PathParams& p, const SceneData& data, int lanes);

kernel::PathParams make_params(const SceneData& data, const Scene& scene, const View& view,
                               const RenderOptions& options, const FrameSchema& schema, int lanes);

/// Where the parts of the buffers `shapes` and `tables` begin is in the params; these are
/// their contents. Broadcast shapes have every number once a lane.
std::vector<Row> pack_shapes(const SceneData& data, int lanes);
std::vector<Row> pack_tables(const SceneData& data);

/// What a program needs to be told beside the scene's features: the lanes, and how they pass the
/// tree of `tree_byte_size`.
Defines scene_defines(const SceneData& data, const DeviceProfile& profile, size_t tree_byte_size,
                      TreeTurns turns, int lanes);

/// A buffer of the tree. On devices that share the host's memory it lies over `rows`, which must
/// live as long as it does; on others it is a copy, and `rows` is emptied.
cl::Buffer make_tree_buffer(const Device& device, Block<Row>& rows);

}  // namespace pave
