// The same tests once more on Oclgrind, a second OpenCL runtime, which watches every access of
// every work-item.
// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include "tests/host/device/environment.h"

namespace pave {
namespace {

// Left out: death tests and other runtimes' loaders (Oclgrind replaces the loader in this process
// only), and launches from several threads, which Oclgrind 21.10 does not know (it asserts that one
// kernel runs at a time).
constexpr const char* kFilter =
    "-*DeathTest*:*Oclgrind*:Launch.ManyThreadsShareADevice:FromHandles."
    "TakesHandlesOfAnotherLoader";

TEST(Oclgrind, FindsNothingToReport) {
    TemporaryFolder folder;
    const std::string log = (folder.path() / "log").string();
    const std::string output = (folder.path() / "output").string();
    const std::string self = std::filesystem::canonical("/proc/self/exe").string();
    const std::string command =
        "PAVE_NO_CACHE=1 timeout 300 oclgrind --data-races --uninitialized --log '" + log + "' '" +
        self + "' '--gtest_filter=" + kFilter + "' >'" + output + "' 2>&1";
    EXPECT_EQ(std::system(command.c_str()), 0) << command << "\n" << read_text(output);
    EXPECT_EQ(read_text(log), "") << command;
}

}  // namespace
}  // namespace pave
