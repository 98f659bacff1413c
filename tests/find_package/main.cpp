// Uses an installed PAVE from outside: saves two frames, reads them back, loads a scene.
// SPDX-License-Identifier: BSD-3-Clause
#include <pave/pave.h>

#include <iostream>
#include <vector>

int main(int, char** argv) try {
    const std::vector<float> pixels(12 * 8, 0.25f);
    const std::string uri = std::string("bp:") + argv[1];
    pave::Paver paver(uri);
    paver.save("depth", 12, 8, pixels);
    paver.save("depth", 12, 8, pixels);
    paver.close();
    const auto source = pave::Source::open(uri);
    const pave::Frame frame = source->read(1);
    const float value = frame.channel("depth")[95];
    const pave::Scene scene = pave::load_scene("cornell");
    std::cout << "pave " << pave::program_version() << ": " << source->frame_count()
              << " frames, last value " << value << ", scene " << scene.name << " with "
              << (scene.shapes.empty() ? "no" : "some") << " shapes\n";
    return 0;
} catch (const pave::Error& error) {
    std::cerr << error.what() << "\n";
    return static_cast<int>(error.exit_code());
}
