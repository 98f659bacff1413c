// Loading of an exported run: checksums first, then both files.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <string>

#include "host/nn/graph.h"

namespace pave::nn {

struct Run {
    Schema schema;
    std::string weights_version;  // XXH3-128 hex of the weights file
};

/// Reads `folder`'s generator.json and the weights that it names. Neither is parsed before its
/// checksum was compared with run-manifest.json's, the weights' also with generator.json's. Throws
/// InputError.
Run load_run(const std::string& folder);

}  // namespace pave::nn
