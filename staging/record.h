// What is stored of a frame beside its pixels: metadata and the checksums made at production, as
// canonical JSON.
// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "pave/frame.h"

namespace pave {

using Json = nlohmann::ordered_json;  // keys keep their order: equal data are equal bytes

/// The value, or a discarded one if `text` is not JSON or nests deeper than anything PAVE writes.
Json parse_json(std::string_view text);

/// A frame's identity: everything but its place in memory and the time it took.
struct FrameRecord {
    FrameMetadata metadata;
    std::vector<std::string> channel_hashes;  // XXH3-128 of each channel's bytes, in schema order
};

/// Unit and meaning of a channel that PAVE knows; empty strings for others.
struct ChannelMeaning {
    std::string unit, meaning;
};
ChannelMeaning channel_meaning(const Channel& channel);

/// XXH3-128 of every channel, without the padding between them.
FrameRecord make_record(const Frame& frame);

/// Throws UsageError if the metadata cannot be stored: text that is not UTF-8, a view that is not
/// finite, index < 0.
void check_metadata(const FrameMetadata& metadata);

Json to_json(const FrameSchema& schema);
Json to_json(const FrameSchema& schema, const FrameRecord& record);  // without seconds_spent
/// Both throw InputError "WHERE: ..." for anything missing, of another type or out of range.
FrameSchema schema_from_json(const Json& json, const std::string& where);
FrameRecord record_from_json(const Json& json, const FrameSchema& schema, const std::string& where);

/// Hash over the schema and the records in order: equal for equal data sets in any sink.
std::string content_hash(const FrameSchema& schema, const std::vector<FrameRecord>& records);

}  // namespace pave
