// From URIs to sinks and sources: the one place where a new scheme is added.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/source.h"

#include "staging/bp.h"
#include "staging/exr.h"
#include "staging/mem_store.h"
#include "staging/sink.h"
#include "staging/uri.h"

namespace pave {

std::unique_ptr<Sink> make_sink(const std::string& uri, const FrameSchema& schema,
                                const StageOptions& options) {
    const Uri place = parse_uri(uri);
    if (place.scheme == "mem") return make_mem_sink(place.rest, schema);
    if (place.scheme == "exr") return make_exr_sink(place.rest, schema, options);
    return make_bp_sink(place.rest, schema, options);
}

std::unique_ptr<Source> Source::open(const std::string& uri, bool allow_unfinished) {
    const Uri place = parse_uri(uri);
    if (place.scheme == "mem") return open_mem_source(place.rest);
    if (place.scheme == "exr") return open_exr_source(place.rest, allow_unfinished);
    return open_bp_source(place.rest, allow_unfinished);
}

std::vector<Frame> Source::read_all(ArenaAllocator& allocator) {
    std::vector<Frame> frames;
    for (int64_t position = 0; position < frame_count(); ++position)
        frames.push_back(read(position, allocator));
    return frames;
}

}  // namespace pave
