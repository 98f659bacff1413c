// Which PAVE this is.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

namespace pave {

std::string program_version();  // "0.1.0"
std::string program_commit();   // git commit of the build, "+" behind it if the tree was changed;
                                // "unknown" outside git

}  // namespace pave
