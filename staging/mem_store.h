// Frames shared inside one process: the mem: sink and its source.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string>

#include "pave/source.h"
#include "staging/sink.h"

namespace pave {

/// `name` empty: a store nobody can open, which retains nothing. Throws UsageError if a stage has
/// this name open.
std::unique_ptr<Sink> make_mem_sink(const std::string& name, const FrameSchema& schema);
/// Throws UsageError if there is no such store.
std::unique_ptr<Source> open_mem_source(const std::string& name);

}  // namespace pave
