// BP5 files through ADIOS2.
// SPDX-License-Identifier: BSD-3-Clause
#include "staging/bp.h"

#include <adios2.h>
#include <pthread.h>
#include <unistd.h>

#include <chrono>
#include <condition_variable>
#include <mutex>
#include <vector>

namespace pave {
namespace {

/// A mutex that can be waited for with a deadline.
class Gate {
   public:
    bool take(std::chrono::seconds patience) {
        std::unique_lock lock(mutex_);
        if (!freed_.wait_for(lock, patience, [this] { return !is_taken_; })) return false;
        is_taken_ = true;
        return true;
    }
    void give_back() {
        const std::lock_guard lock(mutex_);
        is_taken_ = false;
        freed_.notify_one();
    }

   private:
    std::mutex mutex_;
    std::condition_variable freed_;
    bool is_taken_ = false;
};

/// The gate of this process, never destroyed: data sets may outlive main. A forked child has none
/// of the threads that could give the parent's back, so it begins with a fresh one; a fork waits a
/// second for ADIOS2 to be left alone, so that the child finds its tables whole.
Gate*& process_gate() {
    static thread_local bool is_taken_to_fork = false;
    static Gate* gate = [] {
        pthread_atfork([] { is_taken_to_fork = process_gate()->take(std::chrono::seconds(1)); },
                       [] {
                           if (is_taken_to_fork) process_gate()->give_back();
                       },
                       [] { process_gate() = new Gate; });
        return new Gate;
    }();
    return gate;
}

/// ADIOS2 keeps process-wide tables (FFS formats) that are not promised to be safe between threads:
/// one call at a time. Waits 30 s at most, so that a writer stuck in a dead disk does not hang a
/// reader for ever.
class AdiosLock {
   public:
    AdiosLock() {
        if (!gate_->take(std::chrono::seconds(30)))
            throw RunError("ADIOS2 is busy for 30 s: another data set of this process is stuck");
    }
    ~AdiosLock() { gate_->give_back(); }
    AdiosLock(const AdiosLock&) = delete;
    AdiosLock& operator=(const AdiosLock&) = delete;

   private:
    Gate* const gate_ = process_gate();
};

/// What ADIOS2 threw, as one plain line: it comes with a time, colours, its own stack and a second
/// line.
std::string plain_reason(std::string text) {
    for (size_t escape = 0; (escape = text.find('\033')) != std::string::npos;)
        text.erase(escape, text.find('m', escape) - escape + 1);
    text = text.substr(0, text.find('\n'));
    const size_t stack_end = text.rfind("> : ");
    return "ADIOS2 " + (stack_end == std::string::npos ? text : text.substr(stack_end + 4));
}

/// Runs one piece of work with ADIOS2, alone, and makes RunErrors of what it throws.
template <typename Work>
void with_adios(Work work) {
    const AdiosLock lock;
    try {
        work();
    } catch (const Error&) {
        throw;
    } catch (const std::exception& error) {
        throw RunError(plain_reason(error.what()));
    }
}

adios2::Dims shape_of(const FrameSchema& schema, const Channel& channel) {
    return {static_cast<size_t>(channel.planes), static_cast<size_t>(schema.height()),
            static_cast<size_t>(schema.width())};
}

}  // namespace

class BpWriter::Impl {
   public:
    Impl(const fs::path& path, const FrameSchema& schema) : path_(path) {
        io_ = adios_.DeclareIO("write");
        io_.SetEngine("BP5");
        // Synchronous, one data file, no statistics, no profile: the bytes depend on the frames
        // alone.
        io_.SetParameters({{"AsyncOpen", "Off"},
                           {"AsyncWrite", "Off"},
                           {"NumAggregators", "1"},
                           {"StatsLevel", "0"}});
        define(schema);
        engine_ = io_.Open(path.string(), adios2::Mode::Write);
    }

    void put(const Frame& frame) {
        const FrameMetadata& m = frame.metadata();
        engine_.BeginStep();
        for (const auto& variable : channels_)
            engine_.Put(variable, frame.channel(variable.Name()).data());
        put_value("frame/index", m.index);
        put_value("frame/spp", static_cast<int32_t>(m.spp));
        put_value("frame/max_depth", static_cast<int32_t>(m.max_depth));
        put_value("frame/rr_depth", static_cast<int32_t>(m.rr_depth));
        put_value("frame/seed", m.seed);
        put_value("frame/scene", m.scene);
        put_value("frame/scene_hash", m.scene_hash);
        put_value("frame/device", m.device);
        put_value("frame/driver", m.driver);
        put_value("frame/kernel_hash", m.kernel_hash);
        put_value("frame/program_version", m.program_version);
        put_value("frame/program_commit", m.program_commit);
        put_value("frame/weights_version", m.weights_version);
        put_value("frame/fov_x_degrees", m.view.fov_x_degrees);
        // Last, because it needs no padding: ADIOS2 pads a text at a step's end with whatever the
        // heap holds.
        engine_.Put(camera_, m.view.world_from_camera.data());
        engine_.EndStep();  // writes, and lets go of every pointer above
    }

    void close() {
        // BP5 knows no way to leave out this file, which holds times of the run and may meet a full
        // disk.
        std::error_code ignored;
        fs::create_symlink("/dev/null", path_ / "profiling.json", ignored);
        engine_.Close();
        is_closed_ = true;
        fs::remove(path_ / "profiling.json");
    }

    bool is_closed() const { return is_closed_; }
    /// Frees the disk space of an unfinished folder whose files are still open.
    void empty_files() const noexcept {
        std::error_code error;
        for (fs::directory_iterator file(path_, error), end; !error && file != end;
             file.increment(error))
            if (truncate(file->path().c_str(), 0) != 0) continue;
    }

   private:
    void define(const FrameSchema& schema) {
        for (const Channel& channel : schema.channels()) {
            const adios2::Dims shape = shape_of(schema, channel);
            channels_.push_back(io_.DefineVariable<float>(
                channel.name, shape, adios2::Dims(shape.size(), 0), shape, true));
            const ChannelMeaning meaning = channel_meaning(channel);
            if (meaning.unit.empty()) continue;
            io_.DefineAttribute<std::string>(channel.name + "/unit", meaning.unit);
            io_.DefineAttribute<std::string>(channel.name + "/meaning", meaning.meaning);
        }
        io_.DefineVariable<int64_t>("frame/index");
        io_.DefineVariable<int32_t>("frame/spp");
        io_.DefineVariable<int32_t>("frame/max_depth");
        io_.DefineVariable<int32_t>("frame/rr_depth");
        io_.DefineVariable<uint64_t>("frame/seed");
        io_.DefineVariable<float>("frame/fov_x_degrees");
        for (const char* name : {"scene", "scene_hash", "device", "driver", "kernel_hash",
                                 "program_version", "program_commit", "weights_version"})
            io_.DefineVariable<std::string>(std::string("frame/") + name);
        camera_ =
            io_.DefineVariable<float>("frame/world_from_camera", {4, 4}, {0, 0}, {4, 4}, true);
        io_.DefineAttribute<std::string>("frame/world_from_camera/meaning",
                                         "camera to world, row-major, +Z along the view, +X left");
        io_.DefineAttribute<std::string>("planes/meaning",
                                         "channel shapes are {planes, height, width}");
    }
    template <typename T>
    void put_value(const char* name, const T& value) {
        engine_.Put(io_.InquireVariable<T>(name), value, adios2::Mode::Sync);
    }

    const fs::path path_;
    adios2::ADIOS adios_;
    adios2::IO io_;
    adios2::Engine engine_;
    std::vector<adios2::Variable<float>> channels_;
    adios2::Variable<float> camera_;
    bool is_closed_ = false;
};

BpWriter::BpWriter(const fs::path& path, const FrameSchema& schema) {
    with_adios([&] { impl_ = std::make_unique<Impl>(path, schema); });
}
BpWriter::~BpWriter() {
    if (!impl_->is_closed()) {
        // The destructor of an ADIOS2 writer that failed writes again, and what it then throws ends
        // the process (seen with 2.12.1 on a full disk). Such a writer is never destroyed: this
        // list lives as long as the process.
        static auto& failed = *new std::vector<std::unique_ptr<Impl>>;
        static std::mutex mutex;
        const std::lock_guard lock(mutex);
        impl_->empty_files();
        failed.push_back(std::move(impl_));
        return;
    }
    try {
        const AdiosLock lock;
        impl_.reset();
    } catch (const RunError&) {
        (void)impl_.release();  // ADIOS2 is stuck: better a leak than to wait for ever
    }
}
void BpWriter::put(const Frame& frame) {
    with_adios([&] { impl_->put(frame); });
}
void BpWriter::close() {
    with_adios([&] { impl_->close(); });
}

class BpReader::Impl {
   public:
    Impl(const fs::path& path, const FrameSchema& schema, size_t frames) : path_(path) {
        io_ = adios_.DeclareIO("read");
        io_.SetEngine("BP5");
        io_.SetParameters({{"Threads", "1"}});
        engine_ = io_.Open(path.string(), adios2::Mode::ReadRandomAccess);
        for (const Channel& channel : schema.channels()) {
            auto variable = io_.InquireVariable<float>(channel.name);
            if (!variable || variable.Shape() != shape_of(schema, channel) ||
                variable.Steps() != frames)
                throw InputError(path.string() + ": channel '" + channel.name +
                                 "' is missing or not as the manifest says");
            channels_.push_back(variable);
        }
    }
    void get(size_t step, Frame& frame) {
        for (auto& variable : channels_) {
            variable.SetStepSelection({step, 1});
            engine_.Get(variable, frame.channel(variable.Name()).data(), adios2::Mode::Sync);
        }
    }

   private:
    const fs::path path_;
    adios2::ADIOS adios_;
    adios2::IO io_;
    adios2::Engine engine_;
    std::vector<adios2::Variable<float>> channels_;
};

BpReader::BpReader(const fs::path& root, const Block& block, const FrameSchema& schema) {
    verify_block(root, block);
    with_adios(
        [&] { impl_ = std::make_unique<Impl>(root / block.name, schema, block.frames.size()); });
}
BpReader::~BpReader() {
    try {
        const AdiosLock lock;
        impl_.reset();
    } catch (const RunError&) {
        (void)impl_.release();  // as above
    }
}
void BpReader::get(size_t step, Frame& frame) {
    with_adios([&] { impl_->get(step, frame); });
}

}  // namespace pave
