// A folder of scene files that lives as long as a test, and the lines every small scene needs.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

#include "pave/error.h"
#include "pave/scene.h"

namespace pave::test {

class SceneFiles : public ::testing::Test {
   protected:
    SceneFiles() {
        const auto* info = ::testing::UnitTest::GetInstance()->current_test_info();
        std::string name = std::string("pave-") + info->name() + "-" + std::to_string(::getpid());
        for (char& c : name)
            if (c == '/') c = '-';
        folder_ = std::filesystem::temp_directory_path() / name;
        std::filesystem::create_directories(folder_);
    }
    ~SceneFiles() override { std::filesystem::remove_all(folder_); }

    std::string write(const std::string& name, const std::string& text) const {
        std::ofstream(folder_ / name, std::ios::binary) << text;
        return (folder_ / name).string();
    }

    /// Line 1 is the sensor, `body` begins on line 2.
    static std::string with_sensor(const std::string& body, const std::string& sensor_extra = "",
                                   const std::string& film_extra = "<rfilter type='box'/>") {
        return "<scene version='3.0.0'><sensor type='perspective'>" + sensor_extra +
               "<film type='hdrfilm'><integer name='width' value='16'/>"
               "<integer name='height' value='8'/>" +
               film_extra + "</film></sensor>\n" + body + "\n</scene>\n";
    }
    Scene load(const std::string& body, const LoadOptions& options = {}) const {
        return load_scene(write("scene.xml", with_sensor(body)), options);
    }
    Scene load_sensor(const std::string& sensor,
                      const std::string& film = "<rfilter type='box'/>") const {
        return load_scene(write("scene.xml", with_sensor("<shape type='cube'/>", sensor, film)));
    }

    /// The message of the InputError that loading `text` ends in; "" and a failure if it loads.
    std::string error_of(const std::string& text, const LoadOptions& options = {}) const {
        try {
            load_scene(write("scene.xml", text), options);
        } catch (const InputError& error) {
            const std::string message = error.what();
            EXPECT_EQ(message.find('\n'), std::string::npos) << "more than one line: " << message;
            return message;
        }
        ADD_FAILURE() << "loaded without an error: " << text;
        return "";
    }

    std::filesystem::path folder_;
};

}  // namespace pave::test
