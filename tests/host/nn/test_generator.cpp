// Drawing of frames: encodings, padding, memory, against arithmetic in double precision.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "pave/error.h"
#include "pave/generator.h"
#include "tests/host/nn/fixtures.h"

namespace pave::nn {
namespace {

using nlohmann::json;

constexpr double kPeak = 6.5, kScale = 2.5, kRadius = 3.0;
constexpr std::array<double, 3> kCenter{0.5, -1.0, 2.0};
constexpr int kMultiple = 4, kInPlanes = 14;

// The transfer as the format states it (IEC 61966-2-1, then 1 + s ln x), in double precision.
double transfer(double x) {
    if (x <= 0.0) return 0.0;
    if (x <= 0.0031308) return 12.92 * x;
    return x <= 1.0 ? 1.055 * std::pow(x, 1.0 / 2.4) - 0.055 : 1.0 + 1.055 / 2.4 * std::log(x);
}

double inverse_transfer(double y) {
    if (y <= 0.0) return 0.0;
    if (y <= 12.92 * 0.0031308) return y / 12.92;
    return y <= 1.0 ? std::pow((y + 0.055) / 1.055, 2.4) : std::exp((y - 1.0) / (1.055 / 2.4));
}

json document() {
    return {{"format", "pave-generator"},
            {"version", 1},
            {"inputs",
             {{{"channel", "albedo"}, {"planes", 3}, {"encode", "unit"}},
              {{"channel", "direct"}, {"planes", 3}, {"encode", "radiance"}},
              {{"channel", "normal"}, {"planes", 3}, {"encode", "signed"}},
              {{"channel", "depth"},
               {"planes", 1},
               {"encode", "depth"},
               {"scale", kScale},
               {"repeat", 2}},
              {{"channel", "position"},
               {"planes", 3},
               {"encode", "position"},
               {"center", kCenter},
               {"radius", kRadius}}}},
            {"transfer", {{"name", "srgb_log"}, {"peak", kPeak}}},
            {"output", {{"channel", "color"}, {"planes", 3}, {"decode", "radiance"}}},
            {"multiple", kMultiple},
            {"nodes",
             {{{"name", "conv"},
               {"op", "conv2d"},
               {"inputs", {"input"}},
               {"weight", "w"},
               {"bias", "b"},
               {"stride", 1},
               {"padding", 1}}}},
            {"result", "conv"},
            {"training", {{"note", "by hand"}}}};
}

std::map<std::string, Tensor> tensors() {
    std::mt19937 random(7);
    Tensor weight{{3, kInPlanes, 3, 3}, {}}, bias{{3}, {0.3f, 0.1f, -0.05f}};
    for (int i = 0; i < 3 * kInPlanes * 9; ++i)
        weight.values.push_back(0.15f * (static_cast<float>(random() % 2001) / 1000.0f - 1.0f));
    return {{"w", weight}, {"b", bias}};
}

/// Channels with values that try every branch: misses, highlights above the peak, negative
/// radiance, black.
void fill(Frame& frame) {
    std::mt19937 random(11);
    const auto uniform = [&] { return static_cast<float>(random() % 100001) / 100000.0f; };
    for (const Channel& channel : frame.schema().channels())
        for (float& value : frame.channel(channel.name)) {
            const float u = uniform();
            value = channel.name == "normal" || channel.name == "position" ? 2.0f * u - 1.0f
                    : channel.name == "depth"
                        ? (u < 0.2f ? std::numeric_limits<float>::infinity() : 5.0f * u)
                    : channel.name == "direct" ? (u < 0.1f   ? -0.5f
                                                  : u < 0.3f ? 0.004f * u
                                                             : 12.0f * u * u)
                                               : u;
        }
}

/// The network's input (C, h, w), padded, in double precision.
std::vector<double> encoded(const Frame& frame, int width, int height) {
    std::vector<double> planes;
    const auto append = [&](const std::string& name, auto&& encode) {
        const std::span<const float> values = frame.channel(name);
        const int w = frame.schema().width(), h = frame.schema().height();
        for (int plane = 0; plane < static_cast<int>(values.size()) / (w * h); ++plane)
            for (int y = 0; y < height; ++y)
                for (int x = 0; x < width; ++x)
                    planes.push_back(
                        encode(static_cast<double>(values[static_cast<size_t>(
                                   (plane * h + std::min(y, h - 1)) * w + std::min(x, w - 1))]),
                               plane));
    };
    const auto same = [](double x, int) { return x; };
    const auto depth = [](double x, int) { return kScale / (kScale + x); };
    append("albedo", same);
    append("direct", [](double x, int) { return transfer(x) / transfer(kPeak); });
    append("normal", same);
    append("depth", depth);
    append("depth", depth);
    append("position",
           [](double x, int plane) { return (x - kCenter[static_cast<size_t>(plane)]) / kRadius; });
    return planes;
}

std::vector<double> expected_drawing(const Frame& frame) {
    const int w = frame.schema().width(), h = frame.schema().height();
    const int pw = (w + kMultiple - 1) / kMultiple * kMultiple,
              ph = (h + kMultiple - 1) / kMultiple * kMultiple;
    const std::vector<double> input = encoded(frame, pw, ph);
    const auto weights = tensors();
    std::vector<double> drawn;
    for (int out = 0; out < 3; ++out)
        for (int y = 0; y < h; ++y)
            for (int x = 0; x < w; ++x) {
                double sum = static_cast<double>(weights.at("b").values[static_cast<size_t>(out)]);
                for (int in = 0; in < kInPlanes; ++in)
                    for (int ky = 0; ky < 3; ++ky)
                        for (int kx = 0; kx < 3; ++kx) {
                            const int sy = y + ky - 1, sx = x + kx - 1;
                            if (sy < 0 || sx < 0 || sy >= ph || sx >= pw) continue;
                            sum += input[static_cast<size_t>((in * ph + sy) * pw + sx)] *
                                   static_cast<double>(weights.at("w").values[static_cast<size_t>(
                                       ((out * kInPlanes + in) * 3 + ky) * 3 + kx)]);
                        }
                drawn.push_back(inverse_transfer(sum * transfer(kPeak)));
            }
    return drawn;
}

class Drawing : public testing::Test {
   protected:
    void SetUp() override { write_run(folder_, document(), tensors()); }
    static FrameSchema schema(int width, int height, const std::string& output) {
        return FrameSchema::of_known(width, height,
                                     {"albedo", "direct", "normal", "depth", "position", output});
    }
    TemporaryFolder folder_;
};

TEST_F(Drawing, equals_the_arithmetic_in_place_and_on_copies_at_odd_sizes) {
    for (int lanes : {0, 1}) {
        Device device = device_with_lanes(lanes);
        Generator generator(device, folder_.path());
        EXPECT_EQ(generator.inputs(),
                  (std::vector<std::string>{"albedo", "direct", "normal", "depth", "position"}));
        for (const auto& [width, height] : {std::pair{1, 1}, {3, 5}, {16, 16}, {19, 6}})
            for (const char* output : {"drawn", "color"}) {
                if (lanes == 1 && width > 3) continue;
                Frame own = make_frame(schema(width, height, output), device);
                Frame foreign = make_frame(schema(width, height, output));
                for (Frame* frame : {&own, &foreign}) {
                    fill(*frame);
                    const std::vector<double> expected = expected_drawing(*frame);
                    generator.draw(*frame);
                    const std::span<const float> drawn = frame->channel(output);
                    ASSERT_EQ(drawn.size(), expected.size());
                    for (size_t i = 0; i < drawn.size(); ++i)
                        ASSERT_NEAR(static_cast<double>(drawn[i]), expected[i],
                                    1e-4 * (1.0 + expected[i]))
                            << width << " x " << height << ", lanes " << lanes << ", value " << i;
                    EXPECT_EQ(frame->metadata().weights_version, generator.weights_version());
                }
                const std::span<const float> a = own.channel(output), b = foreign.channel(output);
                EXPECT_TRUE(std::equal(a.begin(), a.end(), b.begin()));
            }
    }
}

TEST_F(Drawing, leaves_the_inputs_alone_and_repeats_itself) {
    Device device = device_with_lanes(0);
    Generator generator(device, folder_.path());
    Frame frame = make_frame(schema(13, 9, "drawn"), device),
          before = make_frame(schema(13, 9, "drawn"));
    fill(frame);
    fill(before);
    generator.draw(frame);
    for (const std::string& name : generator.inputs()) {
        const std::span<const float> a = frame.channel(name), b = before.channel(name);
        EXPECT_TRUE(std::equal(a.begin(), a.end(), b.begin())) << name;
    }
    const std::vector<float> first(frame.channel("drawn").begin(), frame.channel("drawn").end());
    for (int i = 0; i < 3; ++i) {
        Frame other = make_frame(schema(8, 8, "drawn"), device);  // another size in between
        generator.draw(other);
        generator.draw(frame);
        EXPECT_TRUE(std::equal(first.begin(), first.end(), frame.channel("drawn").begin()));
    }
}

template <class Call>
std::string usage_error(Call&& call) {
    try {
        call();
    } catch (const UsageError& error) {
        return error.what();
    }
    return "nothing thrown";
}

TEST_F(Drawing, says_which_channel_does_not_fit) {
    Device device = device_with_lanes(0);
    Generator generator(device, folder_.path());
    const auto draw = [&](std::vector<Channel> channels) {
        return usage_error([&] {
            Frame frame = make_frame(FrameSchema(4, 4, std::move(channels)), device);
            generator.draw(frame);
        });
    };
    EXPECT_EQ(draw({{"albedo", 3}, {"drawn", 3}}), "missing input: direct");
    const std::vector<Channel> inputs{{"albedo", 3}, {"direct", 3}, {"normal", 3}, {"position", 3}};
    std::vector<Channel> channels = inputs;
    channels.insert(channels.end(), {{"depth", 3}, {"drawn", 3}});
    EXPECT_NE(draw(channels).find("input depth has 3 planes"), std::string::npos);
    // Slots whose floats an int cannot count; their memory is never looked at.
    channels = inputs;
    channels.insert(channels.end(), {{"depth", 1}, {"drawn", 3}});
    for (int i = 0; i < 40; ++i) channels.push_back({"more" + std::to_string(i), 64});
    auto slot = std::make_shared<Slot>();
    slot->schema = FrameSchema(1024, 1024, channels);
    Frame large(slot);
    EXPECT_NE(usage_error([&] { generator.draw(large); }).find("at most 8191"), std::string::npos);
    channels = inputs;
    channels.push_back({"depth", 1});
    EXPECT_NE(draw(channels).find("neither a channel 'drawn' nor 'color'"), std::string::npos);
    channels.push_back({"drawn", 1});
    EXPECT_NE(draw(channels).find("channel drawn has 1 planes"), std::string::npos);
}

TEST_F(Drawing, run_pads_crops_and_checks_its_input) {
    const FixtureCase& item = fixture_case("unet_batch");
    TemporaryFolder folder;
    json changed = item.document;
    changed["multiple"] = 16;
    write_run(folder, changed, tensors_of(changed, fixture_tensors()));
    Generator generator(device_with_lanes(0), folder.path());
    std::map<std::string, std::vector<float>> layers;
    const std::vector<float> whole = generator.run(item.input(0), item.width, item.height, &layers);
    EXPECT_LE(largest_difference(whole, item.outputs(0).at(item.document.at("result"))), 1e-4);
    EXPECT_EQ(layers.at("input"), item.input(0));
    EXPECT_EQ(layers.at(item.document.at("result")), whole);
    // An image whose last columns repeat is the padding of a narrower one.
    const int narrow = item.width - 3;
    std::vector<float> repeated = item.input(0), cut;
    for (size_t row = 0; row < repeated.size(); row += static_cast<size_t>(item.width)) {
        std::fill_n(repeated.begin() + static_cast<std::ptrdiff_t>(row) + narrow, 3,
                    repeated[row + static_cast<size_t>(narrow) - 1]);
        cut.insert(cut.end(), repeated.begin() + static_cast<std::ptrdiff_t>(row),
                   repeated.begin() + static_cast<std::ptrdiff_t>(row) + narrow);
    }
    const std::vector<float> a = generator.run(repeated, item.width, item.height);
    const std::vector<float> b = generator.run(cut, narrow, item.height);
    ASSERT_EQ(b.size(), 3u * static_cast<size_t>(narrow * item.height));
    for (size_t i = 0; i < b.size(); ++i)
        ASSERT_EQ(b[i], a[i / static_cast<size_t>(narrow) * static_cast<size_t>(item.width) +
                          i % static_cast<size_t>(narrow)]);
    EXPECT_NE(usage_error([&] { generator.run(cut, 7, 7); }).find("values"), std::string::npos);
    EXPECT_NE(usage_error([&] { generator.run({}, 0, 7); }).find("sizes are"), std::string::npos);
    size_t unplanned = 0;
    const size_t planned = generator.planned_byte_size(100, 100, &unplanned);
    EXPECT_LT(planned, unplanned / 2);
    EXPECT_EQ(generator.planned_byte_size(100, 100), generator.planned_byte_size(112, 112));
}

}  // namespace
}  // namespace pave::nn
