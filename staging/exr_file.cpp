// Frames to and from EXR files through OpenEXR.
// SPDX-License-Identifier: BSD-3-Clause
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFloatAttribute.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfIO.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfIntAttribute.h>
#include <OpenEXR/ImfMatrixAttribute.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <fcntl.h>
#include <unistd.h>

#include <cstring>
#include <limits>
#include <optional>

#include "pave/exr.h"
#include "pave/hash.h"
#include "staging/exr.h"

namespace pave {
namespace {

// Bytes behind the EXR data, which readers do not look at: the mark and XXH3-128 of everything
// before it.
constexpr std::string_view kMark = "PAVEXXH3";
constexpr size_t kTrailerSize = kMark.size() + 32;

// All channels that PAVE knows at 16384 x 16384, uncompressed, are less.
constexpr uint64_t kFileByteLimit = uint64_t{32} << 30;

/// OpenEXR writes through this; small pieces are gathered. OpenEXR's destructors swallow errors, so
/// the first is kept.
class FileStream final : public Imf::OStream {
   public:
    explicit FileStream(File& file) : OStream(file.path().c_str()), file_(file) {}
    void write(const char bytes[], int count) override {
        buffer_.append(bytes, static_cast<size_t>(count));
        if (buffer_.size() >= kBufferSize) flush();
    }
    uint64_t tellp() override { return position_ + buffer_.size(); }
    void seekp(uint64_t position) override {
        flush();
        if (::lseek(file_.descriptor(), static_cast<off_t>(position), SEEK_SET) < 0)
            throw_errno("seek in", file_.path());
        position_ = position;
    }
    void flush() {
        const std::string bytes = std::exchange(buffer_, {});
        try {
            file_.write_all(bytes);
        } catch (const RunError& error) {
            if (!failure_) failure_ = error;
            throw;
        }
        position_ += bytes.size();
    }
    void check() const {
        if (failure_) throw *failure_;
    }

   private:
    static constexpr size_t kBufferSize = 1 << 16;
    File& file_;
    std::string buffer_;
    uint64_t position_ = 0;
    std::optional<RunError> failure_;
};

/// Verified bytes for OpenEXR to parse.
class MemoryStream final : public Imf::IStream {
   public:
    MemoryStream(const std::string& name, std::string_view bytes)
        : IStream(name.c_str()), bytes_(bytes) {}
    bool read(char out[], int count) override {
        const auto wanted = static_cast<size_t>(count);
        if (count < 0 || wanted > bytes_.size() - position_)
            throw InputError(std::string(fileName()) + ": unexpected end of file");
        std::memcpy(out, bytes_.data() + position_, wanted);
        position_ += wanted;
        return position_ < bytes_.size();
    }
    uint64_t tellg() override { return position_; }
    void seekg(uint64_t position) override {
        if (position > bytes_.size())
            throw InputError(std::string(fileName()) + ": unexpected end of file");
        position_ = static_cast<size_t>(position);
    }

   private:
    std::string_view bytes_;
    size_t position_ = 0;
};

void insert_metadata(Imf::Header& header, const FrameSchema& schema, const FrameRecord& record,
                     const std::string& names) {
    const FrameMetadata& m = record.metadata;
    const auto text = [&](const std::string& name, const std::string& value) {
        header.insert("pave." + name, Imf::StringAttribute(value));
    };
    text("schema", to_json(schema).dump());
    text("frame", to_json(schema, record).dump());
    text("names", names);
    Imath::M44f camera;
    std::memcpy(&camera[0][0], m.view.world_from_camera.data(), sizeof(float) * 16);
    header.insert("pave.world_from_camera", Imf::M44fAttribute(camera));
    header.insert("pave.fov_x_degrees", Imf::FloatAttribute(m.view.fov_x_degrees));
    header.insert("pave.spp", Imf::IntAttribute(m.spp));
    header.insert("pave.max_depth", Imf::IntAttribute(m.max_depth));
    header.insert("pave.rr_depth", Imf::IntAttribute(m.rr_depth));
    text("index", std::to_string(m.index));  // 64 bits: too wide for EXR's int
    text("seed", std::to_string(m.seed));
    text("scene", m.scene);
    text("scene_hash", m.scene_hash);
    text("device", m.device);
    text("driver", m.driver);
    text("kernel_hash", m.kernel_hash);
    text("program_version", m.program_version);
    text("program_commit", m.program_commit);
    text("weights_version", m.weights_version);
    for (const Channel& channel : schema.channels()) {
        const ChannelMeaning meaning = channel_meaning(channel);
        if (meaning.unit.empty()) continue;
        text(channel.name + ".unit", meaning.unit);
        text(channel.name + ".meaning", meaning.meaning);
    }
}

/// Calls visit(EXR name, first pixel of the plane) for every plane of `frame`.
template <typename Visit>
void for_each_plane(Frame& frame, const std::string& names, Visit visit) {
    const FrameSchema& schema = frame.schema();
    const size_t pixels =
        static_cast<size_t>(schema.width()) * static_cast<size_t>(schema.height());
    for (const Channel& channel : schema.channels()) {
        const std::vector<std::string> planes = exr_plane_names(channel, names);
        for (size_t i = 0; i < planes.size(); ++i)
            visit(planes[i], frame.channel(channel.name).data() + i * pixels);
    }
}

Imf::Slice plane_slice(const FrameSchema& schema, float* pixels) {
    return Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(pixels), sizeof(float),
                      sizeof(float) * static_cast<size_t>(schema.width()));
}

void write_pixels(const Frame& frame, const FrameRecord& record, const std::string& names,
                  FileStream& stream) {
    const FrameSchema& schema = frame.schema();
    Imf::Header header(schema.width(), schema.height());
    // Damage to a line does not go unseen, and lines are read alone.
    header.compression() = Imf::ZIPS_COMPRESSION;
    Imf::addChromaticities(header, Imf::Chromaticities());
    insert_metadata(header, schema, record, names);
    Imf::FrameBuffer buffer;
    Frame pixels = frame;  // OpenEXR wants pointers to non-const; it only reads
    for_each_plane(pixels, names, [&](const std::string& name, float* plane) {
        header.channels().insert(name, Imf::Channel(Imf::FLOAT));
        buffer.insert(name, plane_slice(schema, plane));
    });
    // Blender takes a Combined pass with alpha only.
    const std::vector<float> opaque(names == "cycles" ? static_cast<size_t>(schema.width()) : 0,
                                    1.0f);
    if (names == "cycles" && schema.find("color") >= 0) {
        header.channels().insert("ViewLayer.Combined.A", Imf::Channel(Imf::FLOAT));
        buffer.insert(
            "ViewLayer.Combined.A",
            Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(const_cast<float*>(opaque.data())),
                       sizeof(float), 0));
    }
    {
        Imf::OutputFile file(stream, header);
        file.setFrameBuffer(buffer);
        file.writePixels(schema.height());
    }
    stream.flush();
    stream.check();
}

std::string whole_hash(const fs::path& path) {
    return file_facts(path.parent_path(), path.filename().string()).hash;
}

/// The bytes of the EXR itself, without the trailer.
std::string_view checked_bytes(const std::string& bytes, const fs::path& path) {
    if (bytes.size() < kTrailerSize ||
        std::string_view(bytes).substr(bytes.size() - kTrailerSize, kMark.size()) != kMark)
        throw InputError(path.string() +
                         " is damaged or was not written by PAVE: its checksum is missing");
    const std::string_view exr(bytes.data(), bytes.size() - kTrailerSize);
    if (hash_hex(exr) != std::string_view(bytes).substr(bytes.size() - 32))
        throw InputError(path.string() + ": checksum mismatch, the file is damaged");
    return exr;
}

std::string text_attribute(const Imf::Header& header, const char* name, const fs::path& path) {
    const auto* attribute = header.findTypedAttribute<Imf::StringAttribute>(name);
    if (attribute == nullptr)
        throw InputError(path.string() + ": attribute '" + name + "' is missing");
    return attribute->value();
}

// Deflate cannot make more than about 1030 bytes of one: a larger image than that is a lie, told
// before memory is taken.
constexpr size_t kMostInflation = 1100;

Frame read_pixels(MemoryStream& stream, size_t byte_size, const FrameSchema* expected,
                  ArenaAllocator& allocator, const fs::path& path) {
    Imf::InputFile file(stream);
    const Imf::Header& header = file.header();
    const FrameSchema schema =
        schema_from_json(parse_json(text_attribute(header, "pave.schema", path)), path.string());
    if (expected != nullptr && schema != *expected)
        throw InputError(path.string() + " is of another schema than its data set");
    if (schema.slot_byte_size() / kMostInflation > byte_size + kChannelAlignment)
        throw InputError(path.string() + ": the file is too small for its schema");
    const FrameRecord record = record_from_json(
        parse_json(text_attribute(header, "pave.frame", path)), schema, path.string());
    const Imath::Box2i window = header.dataWindow();
    if (window.min != Imath::V2i(0, 0) ||
        window.max != Imath::V2i(schema.width() - 1, schema.height() - 1))
        throw InputError(path.string() + ": the image is not as large as its schema says");
    Frame frame = make_frame(schema, allocator);
    Imf::FrameBuffer buffer;
    for_each_plane(frame, text_attribute(header, "pave.names", path),
                   [&](const std::string& name, float* plane) {
                       const Imf::Channel* channel = header.channels().findChannel(name);
                       if (channel == nullptr || channel->type != Imf::FLOAT)
                           throw InputError(path.string() + ": '" + name + "' is missing");
                       buffer.insert(name, plane_slice(schema, plane));
                   });
    file.setFrameBuffer(buffer);
    file.readPixels(0, schema.height() - 1);
    frame.metadata() = record.metadata;
    if (make_record(frame).channel_hashes != record.channel_hashes)
        throw InputError(path.string() + ": the pixels are not those that were produced");
    return frame;
}

}  // namespace

void write_exr_file(const Frame& frame, const FrameRecord& record, const std::string& names,
                    const fs::path& path) {
    File file(path, O_WRONLY | O_CREAT | O_TRUNC);
    FileStream stream(file);
    try {
        write_pixels(frame, record, names, stream);
    } catch (const Error&) {
        throw;
    } catch (const std::exception& error) {
        stream.check();  // the disk's own words, where it was the disk
        throw RunError("cannot write " + path.string() + ": " + error.what());
    }
    if (::lseek(file.descriptor(), 0, SEEK_END) < 0) throw_errno("seek in", path);
    file.write_all(std::string(kMark) + whole_hash(path));
    file.close();
}

Frame read_exr_file(const fs::path& path, const FrameSchema* expected, ArenaAllocator& allocator) {
    const std::string bytes = read_file_within(path, kFileByteLimit);
    MemoryStream stream(path.string(), checked_bytes(bytes, path));
    try {
        return read_pixels(stream, bytes.size(), expected, allocator, path);
    } catch (const Error&) {
        throw;
    } catch (const std::exception& error) {
        throw InputError(path.string() + " cannot be read: " + error.what());
    }
}

void write_exr(const Frame& frame, const std::string& path, const std::string& names) {
    check_metadata(frame.metadata());
    const fs::path target = fs::absolute(path);
    const fs::path temporary = target.parent_path() / (kTemporaryPrefix + std::to_string(getpid()) +
                                                       "-" + target.filename().string());
    try {
        write_exr_file(frame, make_record(frame), names, temporary);
        sync_path(temporary);
        rename_durable(temporary, target);
    } catch (...) {
        remove_quietly(temporary);
        throw;
    }
}

Frame read_exr(const std::string& path, ArenaAllocator& allocator) {
    return read_exr_file(path, nullptr, allocator);
}

}  // namespace pave
