// The papers' three verbs: initialize with a name, save variables, flush.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "pave/stage.h"

namespace pave {

/// Saves named images of a simulation loop to a data set. A frame is complete when a name comes
/// again or at flush(); the first frame says which names, sizes and planes all have. Every save
/// copies, so the caller's memory is free on return; writing happens in the background. One thread
/// at a time.
class Paver {
   public:
    /// `name` is a data set name ("cornell" means "bp:cornell.bp") or a URI. Throws UsageError if
    /// it is neither, or has a path without a scheme. Nothing is made before the first frame is
    /// complete. Of `options` the size and channels are not used.
    explicit Paver(const std::string& name, StageOptions options = {});
    /// close(); an incomplete frame is dropped and errors are logged to stderr.
    ~Paver();
    Paver(Paver&&) noexcept;
    Paver& operator=(Paver&&) noexcept;

    /// `values` are width * height * planes numbers, pixel after pixel, the planes of a pixel side
    /// by side; stored as float32 planes. Throws UsageError for a bad name or size, or what the
    /// first frame did not have, and then changes nothing; else as Stage::acquire.
    template <typename T, size_t kExtent>
    void save(const std::string& variable, int width, int height, std::span<T, kExtent> values) {
        static_assert(std::is_arithmetic_v<T>, "values are numbers");
        std::vector<float> converted(values.begin(), values.end());
        save_floats(variable, width, height, converted);
    }
    template <typename T>
    void save(const std::string& variable, int width, int height, const std::vector<T>& values) {
        save(variable, width, height, std::span<const T>(values));
    }
    /// Ends the current frame and returns when every frame is durable; throws UsageError if the
    /// frame lacks a name, and what went wrong in the background.
    void flush();
    /// flush() and the data set's closing record.
    void close();

   private:
    void save_floats(const std::string& variable, int width, int height,
                     const std::vector<float>& values);
    class Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace pave
