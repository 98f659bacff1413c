// Frame records to and from canonical JSON.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/record.h"

#include <cmath>

#include "pave/hash.h"
#include "staging/json.h"

namespace pave {
namespace {

constexpr const char* kRadianceUnit = "W m^-2 sr^-1";

bool is_utf8(const std::string& text) {
    // nlohmann's serializer is the judge: what it refuses cannot be stored.
    try {
        (void)Json(text).dump();
        return true;
    } catch (const nlohmann::json::exception&) {
        return false;
    }
}

template <typename Metadata, typename Visit>
void for_each_text(Metadata& m, Visit visit) {
    visit("scene", m.scene);
    visit("scene_hash", m.scene_hash);
    visit("device", m.device);
    visit("driver", m.driver);
    visit("kernel_hash", m.kernel_hash);
    visit("program_version", m.program_version);
    visit("program_commit", m.program_commit);
    visit("weights_version", m.weights_version);
}

template <typename T>
T get(const Json& json, const char* key, const std::string& where) {
    const auto found = json.find(key);
    if (found == json.end()) throw InputError(where + ": '" + key + "' is missing");
    if constexpr (std::is_same_v<T, std::string>) {
        if (!found->is_string()) throw InputError(where + ": '" + key + "' is not a text");
    } else if constexpr (std::is_same_v<T, uint64_t>) {
        if (!found->is_number_unsigned())
            throw InputError(where + ": '" + key + "' is not a whole number from 0 up");
    } else {
        if (!found->is_number()) throw InputError(where + ": '" + key + "' is not a number");
    }
    return found->get<T>();
}

/// A whole number in low..high.
int64_t get_whole(const Json& json, const char* key, int64_t low, int64_t high,
                  const std::string& where) {
    const auto found = json.find(key);
    if (found == json.end() || !found->is_number_integer() ||
        (found->is_number_unsigned() && found->get<uint64_t>() > INT64_MAX))
        throw InputError(where + ": '" + key + "' is missing or no whole number");
    const auto value = found->get<int64_t>();
    if (value < low || value > high) throw InputError(where + ": '" + key + "' is out of range");
    return value;
}

}  // namespace

Json parse_json(std::string_view text) {
    try {
        return parse_shallow_json<Json>(text);
    } catch (const InputError&) {
    } catch (const Json::exception&) {
    }
    return Json(Json::value_t::discarded);
}

ChannelMeaning channel_meaning(const Channel& channel) {
    if (known_channel_planes(channel.name) != channel.planes) return {};
    if (channel.name == "color") return {kRadianceUnit, "radiance, linear BT.709 R G B"};
    if (channel.name == "drawn")
        return {kRadianceUnit, "radiance as a network drew it, linear BT.709 R G B"};
    if (channel.name == "direct")
        return {kRadianceUnit,
                "radiance emitted or scattered once towards the camera, linear BT.709 R G B"};
    if (channel.name == "albedo")
        return {"1", "reflectance at the first non-specular hit, linear BT.709 R G B, 0 at a miss"};
    if (channel.name == "normal")
        return {"1", "unit shading normal in world space X Y Z, signed, 0 at a miss"};
    if (channel.name == "depth")
        return {"scene unit", "planar distance along the view axis, +inf at a miss"};
    if (channel.name == "distance")
        return {"scene unit", "length of the camera ray, +inf at a miss"};
    if (channel.name == "position") return {"scene unit", "hit point in world space X Y Z"};
    if (channel.name == "variance")
        return {"(W m^-2 sr^-1)^2", "estimated variance of the pixel mean of color, R G B"};
    if (channel.name == "object") return {"1", "number of the shape that was hit"};
    return {};
}

FrameRecord make_record(const Frame& frame) {
    FrameRecord record{frame.metadata(), {}};
    for (const Channel& channel : frame.schema().channels())
        record.channel_hashes.push_back(hash_hex(std::as_bytes(frame.channel(channel.name))));
    return record;
}

void check_metadata(const FrameMetadata& metadata) {
    if (metadata.index < 0)
        throw UsageError("frame number " + std::to_string(metadata.index) + " is negative");
    bool finite = std::isfinite(metadata.view.fov_x_degrees);
    for (const float x : metadata.view.world_from_camera) finite = finite && std::isfinite(x);
    if (!finite)
        throw UsageError("frame " + std::to_string(metadata.index) + ": the view is not finite");
    for_each_text(metadata, [&](const char* key, const std::string& text) {
        if (!is_utf8(text))
            throw UsageError("frame " + std::to_string(metadata.index) + ": '" + key +
                             "' is not UTF-8 text");
    });
}

Json to_json(const FrameSchema& schema) {
    Json channels = Json::array();
    for (const Channel& channel : schema.channels()) {
        const ChannelMeaning meaning = channel_meaning(channel);
        channels.push_back({{"name", channel.name},
                            {"planes", channel.planes},
                            {"unit", meaning.unit},
                            {"meaning", meaning.meaning}});
    }
    return {{"width", schema.width()}, {"height", schema.height()}, {"channels", channels}};
}

Json to_json(const FrameSchema& schema, const FrameRecord& record) {
    const FrameMetadata& m = record.metadata;
    Json json{{"index", m.index},
              {"world_from_camera", m.view.world_from_camera},
              {"fov_x_degrees", m.view.fov_x_degrees},
              {"spp", m.spp},
              {"max_depth", m.max_depth}};
    // Left out at 0: data sets made before there was this key keep their content hash.
    if (m.rr_depth != 0) json["rr_depth"] = m.rr_depth;
    json["seed"] = m.seed;
    for_each_text(m, [&](const char* key, const std::string& text) { json[key] = text; });
    Json hashes = Json::object();
    for (size_t i = 0; i < record.channel_hashes.size(); ++i)
        hashes[schema.channels()[i].name] = record.channel_hashes[i];
    json["hashes"] = std::move(hashes);
    return json;
}

FrameSchema schema_from_json(const Json& json, const std::string& where) {
    if (!json.is_object() || !json.contains("channels") || !json["channels"].is_array())
        throw InputError(where + ": 'channels' is missing");
    std::vector<Channel> channels;
    for (const Json& channel : json["channels"]) {
        if (!channel.is_object()) throw InputError(where + ": a channel is not an object");
        channels.push_back({get<std::string>(channel, "name", where),
                            static_cast<int>(get_whole(channel, "planes", 1, 64, where))});
    }
    try {
        return FrameSchema(static_cast<int>(get_whole(json, "width", 1, 16384, where)),
                           static_cast<int>(get_whole(json, "height", 1, 16384, where)), channels);
    } catch (const UsageError& error) {
        throw InputError(where + ": " + error.what());
    }
}

FrameRecord record_from_json(const Json& json, const FrameSchema& schema,
                             const std::string& where) {
    if (!json.is_object()) throw InputError(where + ": a frame is not an object");
    FrameRecord record;
    FrameMetadata& m = record.metadata;
    m.index = get_whole(json, "index", 0, INT64_MAX - 1, where);
    const auto matrix = json.find("world_from_camera");
    if (matrix == json.end() || !matrix->is_array() || matrix->size() != 16)
        throw InputError(where + ": 'world_from_camera' is not 16 numbers");
    for (size_t i = 0; i < 16; ++i) {
        if (!(*matrix)[i].is_number())
            throw InputError(where + ": 'world_from_camera' is not 16 numbers");
        m.view.world_from_camera[i] = (*matrix)[i].get<float>();
    }
    m.view.fov_x_degrees = get<float>(json, "fov_x_degrees", where);
    m.spp = static_cast<int>(get_whole(json, "spp", INT32_MIN, INT32_MAX, where));
    m.max_depth = static_cast<int>(get_whole(json, "max_depth", INT32_MIN, INT32_MAX, where));
    if (json.contains("rr_depth"))
        m.rr_depth = static_cast<int>(get_whole(json, "rr_depth", INT32_MIN, INT32_MAX, where));
    m.seed = get<uint64_t>(json, "seed", where);
    for_each_text(
        m, [&](const char* key, std::string& text) { text = get<std::string>(json, key, where); });
    const auto hashes = json.find("hashes");
    if (hashes == json.end() || !hashes->is_object() || hashes->size() != schema.channels().size())
        throw InputError(where + ": 'hashes' do not match the channels");
    for (const Channel& channel : schema.channels())
        record.channel_hashes.push_back(get<std::string>(*hashes, channel.name.c_str(), where));
    return record;
}

std::string content_hash(const FrameSchema& schema, const std::vector<FrameRecord>& records) {
    Hasher hasher;
    hasher.update(to_json(schema).dump() + "\n");
    for (const FrameRecord& record : records) hasher.update(to_json(schema, record).dump() + "\n");
    return hasher.hex();
}

}  // namespace pave
