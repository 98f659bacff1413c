// A simulation that saves a variable of its loop with the papers' three verbs.
// SPDX-License-Identifier: BSD-3-Clause
//
//   simulation NAME [FRAMES]      writes NAME.bp, or to NAME if it is a URI such as exr:FOLDER
#include <pave/pave.h>

#include <algorithm>
#include <cstdlib>
#include <iostream>
#include <string>
#include <vector>

namespace {

constexpr int kWidth = 256, kHeight = 256;
constexpr int kStepsPerFrame = 20;
constexpr float kDiffusivity = 0.2f;  // in cells^2 a step; explicit steps are stable up to 0.25

// Temperature of a plate: cold edges, and one hot spot that moves along the diagonal.
class Plate {
   public:
    void advance(int frame) {
        for (int step = 0; step < kStepsPerFrame; ++step) {
            heat(frame);
            diffuse();
        }
    }
    const std::vector<float>& temperature() const { return now_; }

   private:
    void heat(int frame) {
        const int centre = 32 + frame * 8 % 192;
        for (int y = centre - 4; y <= centre + 4; ++y)
            for (int x = centre - 4; x <= centre + 4; ++x) now_[index(x, y)] = 1.0f;
    }
    void diffuse() {
        for (int y = 1; y < kHeight - 1; ++y)
            for (int x = 1; x < kWidth - 1; ++x) {
                const float here = now_[index(x, y)];
                const float around = now_[index(x - 1, y)] + now_[index(x + 1, y)] +
                                     now_[index(x, y - 1)] + now_[index(x, y + 1)];
                next_[index(x, y)] = here + kDiffusivity * (around - 4.0f * here);
            }
        std::swap(now_, next_);
    }
    static size_t index(int x, int y) { return static_cast<size_t>(y) * kWidth + x; }

    std::vector<float> now_ = std::vector<float>(kWidth * kHeight, 0.0f);
    std::vector<float> next_ = std::vector<float>(kWidth * kHeight, 0.0f);
};

}  // namespace

int main(int argc, char** argv) try {
    if (argc < 2 || argc > 3) {
        std::cerr << "usage: simulation NAME [FRAMES]\n";
        return static_cast<int>(pave::ExitCode::kUsage);
    }
    const int frames = argc == 3 ? std::atoi(argv[2]) : 10;

    pave::Paver paver(argv[1]);
    Plate plate;
    for (int frame = 0; frame < frames; ++frame) {
        plate.advance(frame);
        paver.save("temperature", kWidth, kHeight, plate.temperature());
    }
    paver.flush();
    paver.close();

    const float hottest = *std::max_element(plate.temperature().begin(), plate.temperature().end());
    std::cout << "saved " << frames << " frames of temperature, hottest " << hottest << "\n";
    return 0;
} catch (const pave::Error& error) {
    std::cerr << "simulation: error: " << error.what() << "\n";
    return static_cast<int>(error.exit_code());
}
