// A C++ host program with the renderer, a stage and, if there is one, a trained network inside.
// SPDX-License-Identifier: BSD-3-Clause
//
//   embedded_renderer URI [VIEWS] [RUN]      e.g. bp:views.bp 8 run/
#include <pave/pave.h>

#include <cstdlib>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

namespace {

constexpr int kSize = 64;
constexpr int kSamples = 16;

pave::StageOptions options_of(bool drawn) {
    pave::StageOptions options{
        .width = kSize,
        .height = kSize,
        .channels = {"color", "albedo", "direct", "normal", "depth"},
        .slots = 4,
        .trace = std::make_shared<pave::Trace>(),
    };
    if (drawn) options.channels.push_back("drawn");
    return options;
}

}  // namespace

int main(int argc, char** argv) try {
    if (argc < 2 || argc > 4) {
        std::cerr << "usage: embedded_renderer URI [VIEWS] [RUN]\n";
        return static_cast<int>(pave::ExitCode::kUsage);
    }
    const int count = argc >= 3 ? std::atoi(argv[2]) : 8;

    pave::Device device = pave::Device::select();
    const pave::Scene scene = pave::load_scene("cornell");
    pave::Renderer renderer(device, scene);
    std::unique_ptr<pave::Generator> generator;
    if (argc == 4) generator = std::make_unique<pave::Generator>(device, argv[3]);

    pave::Stage stage(device, argv[1], options_of(generator != nullptr));
    const std::vector<pave::View> views = pave::hemisphere_views(scene, count, 7);
    for (const pave::View& view : views) {
        pave::Frame frame = stage.acquire();
        renderer.render(view,
                        {.spp = kSamples,
                         .max_depth = scene.max_depth,
                         .seed = 7,
                         .frame_index = frame.metadata().index},
                        frame);
        if (generator) generator->draw(frame);
        stage.publish(std::move(frame));  // written while the next view renders
    }
    stage.close();
    std::cout << "rendered " << stage.published() << " views on " << device.profile().name << ", "
              << stage.acknowledged() << " acknowledged\n";
    return 0;
} catch (const pave::Error& error) {
    std::cerr << "embedded_renderer: error: " << error.what() << "\n";
    return static_cast<int>(error.exit_code());
}
