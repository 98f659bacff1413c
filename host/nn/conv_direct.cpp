// Convolution by register tiles: chooses the tile and each work-item's share.
// SPDX-License-Identifier: BSD-3-Clause
#include <algorithm>

#include "host/nn/conv.h"

namespace pave::nn {
namespace {

// Multiply-adds an item should have: some 20 us, much above its launch.
constexpr int64_t kItemWork = 1 << 20;
constexpr int kItemsPerUnit = 16;  // but so many items for each compute unit, to balance

int ceil_div(int a, int b) { return (a + b - 1) / b; }

/// Vectors of a tile: the most that do not pad the output channels further than one vector would.
int block_of(int out_channels, int lanes, int largest) {
    const int vectors = ceil_div(out_channels, lanes);
    for (int block = largest; block > 1; block /= 2)
        if (vectors % block == 0) return block;
    return 1;
}

class DirectConv : public Conv {
   public:
    DirectConv(Runtime& runtime, WeightStore& store, const ConvSite& site)
        : runtime_(runtime),
          block_(block_of(site.node->out_channels, runtime.conv_lanes(), runtime.largest_block())),
          tile_channels_(block_ * runtime.conv_lanes()) {
        const Node& node = *site.node;
        const Geometry geometry = geometry_of(node, site.dst.width, site.dst.height);
        const PackedWeights& packed = store.tiled(node, geometry, tile_channels_);
        weights_ = packed.weights;
        bias_ = packed.bias;
        s_ = NnConv{};
        s_.src_first = site.src.first;
        s_.src_step = site.src.step;
        s_.src_width = site.src.width;
        s_.src_height = site.src.height;
        s_.dst_first = site.dst.first;
        s_.dst_step = site.dst.step;
        s_.dst_width = site.dst.width;
        s_.in_step = geometry.in_step;
        s_.out_step = geometry.out_step;
        s_.in_channels = node.weight_in_channels;
        s_.out_channels = node.out_channels;
        s_.zeros_first = packed.zeros_first;
        s_.activation = site.activation.kind;
        s_.slope = site.activation.slope;
        upload_phases(geometry, packed);
    }

    void enqueue(const cl::Buffer& arena) override { enqueue_items(arena, items_); }

    double enqueue_sample(const cl::Buffer& arena, int64_t multiply_adds) override {
        const int64_t wanted = multiply_adds / std::max<int64_t>(1, row_work_);
        const int items = static_cast<int>(std::clamp<int64_t>(wanted, 1, items_));
        enqueue_items(arena, items);
        return static_cast<double>(items) / items_;
    }

   private:
    /// The first `items` work-items of each block of output channels and each phase.
    void enqueue_items(const cl::Buffer& arena, int items) {
        const cl::NDRange global(static_cast<size_t>(items), blocks_, phase_count_);
        launch(runtime_.device(), runtime_.direct_convolution(block_), global, runtime_.local(), s_,
               arena, weights_, bias_, phases_, taps_, arena);
    }

    void upload_phases(const Geometry& geometry, const PackedWeights& packed) {
        std::vector<NnPhase> phases;
        std::vector<cl_int2> taps;
        int most_pixels = 1;
        size_t most_taps = 1;
        for (size_t i = 0; i < geometry.phases.size(); ++i) {
            const Phase& phase = geometry.phases[i];
            NnPhase p{};
            p.grid_width = phase.grid_w;
            p.grid_height = phase.grid_h;
            p.out_x = phase.out_x;
            p.out_y = phase.out_y;
            p.tap_first = static_cast<int>(taps.size());
            p.taps = static_cast<int>(phase.taps.size());
            p.weight_first = packed.phase_first[i];
            phases.push_back(p);
            for (const Tap& tap : phase.taps) taps.push_back({{tap.dx, tap.dy}});
            most_pixels = std::max(most_pixels, phase.grid_w * phase.grid_h);
            most_taps = std::max(most_taps, phase.taps.size());
        }
        phases_ = make_buffer_of(runtime_.device(), phases, "phases of a convolution");
        taps_ = make_buffer_of(runtime_.device(), taps, "taps of a convolution");
        choose_items(most_pixels, static_cast<int64_t>(most_taps), geometry.phases.size());
    }

    void choose_items(int pixels, int64_t taps, size_t phases) {
        const int tiles = ceil_div(pixels, Runtime::kTilePixels);
        const int blocks = ceil_div(s_.out_channels, tile_channels_);
        const int64_t tile_work = Runtime::kTilePixels * tile_channels_ * taps * s_.in_channels;
        int64_t tiles_per_item = std::max<int64_t>(1, kItemWork / tile_work);
        const int64_t all = static_cast<int64_t>(tiles) * blocks * static_cast<int64_t>(phases);
        const int64_t fair = all / (kItemsPerUnit * runtime_.compute_units());
        tiles_per_item = std::clamp<int64_t>(fair, 1, tiles_per_item);
        if (!runtime_.serial()) tiles_per_item = 1;
        s_.tiles_per_item = static_cast<int>(tiles_per_item);
        items_ = ceil_div(tiles, s_.tiles_per_item);
        blocks_ = static_cast<size_t>(blocks);
        phase_count_ = phases;
        row_work_ = tiles_per_item * tile_work * blocks * static_cast<int64_t>(phases);
    }

    Runtime& runtime_;
    int block_, tile_channels_;
    NnConv s_;
    cl::Buffer weights_, bias_, phases_, taps_;
    int items_ = 1;  // along the pixels
    size_t blocks_ = 1, phase_count_ = 1;
    int64_t row_work_ = 1;  // multiply-adds of the items at one place along the pixels
};

}  // namespace

std::unique_ptr<Conv> make_direct_conv(Runtime& runtime, WeightStore& store, const ConvSite& site) {
    return std::make_unique<DirectConv>(runtime, store, site);
}

}  // namespace pave::nn
