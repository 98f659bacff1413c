// Finding a device, opening it, and taking over somebody else's.
// SPDX-License-Identifier: BSD-3-Clause
#include "pave/device.h"

#include <algorithm>
#include <cctype>
#include <cstdlib>

#include "host/device/cache.h"
#include "host/device/impl.h"

namespace pave {
namespace {

struct Found {
    cl::Device device;
    DeviceProfile profile;
    std::string searched;  // lower case: all names that a part of may select it
};

std::string lower(std::string_view text) {
    std::string result(text);
    std::transform(result.begin(), result.end(), result.begin(),
                   [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
    return result;
}

std::vector<cl::Platform> find_platforms() {
    constexpr const char* kHint =
        "no OpenCL platform found; install a driver: apt install pocl-opencl-icd (and see "
        "OCL_ICD_VENDORS)";
    KernelCache::of_process();  // before the first OpenCL call
    std::vector<cl::Platform> platforms;
    try {
        cl::Platform::get(&platforms);
    } catch (const cl::Error&) {
        throw DeviceError(kHint);
    }
    if (platforms.empty()) throw DeviceError(kHint);
    return platforms;
}

/// Platforms keep the loader's numbers, so that "P:D" means here what it means in clinfo; one that
/// fails is left out.
std::vector<Found> find_devices() {
    std::vector<Found> found;
    const std::vector<cl::Platform> platforms = find_platforms();
    for (size_t p = 0; p < platforms.size(); ++p) {
        try {
            std::vector<cl::Device> devices;
            platforms[p].getDevices(CL_DEVICE_TYPE_ALL, &devices);
            for (size_t d = 0; d < devices.size(); ++d) {
                Found entry{devices[d],
                            query_profile(devices[d], std::to_string(p) + ":" + std::to_string(d)),
                            {}};
                const DeviceProfile& profile = entry.profile;
                entry.searched = lower(
                    profile.platform + "\n" + platforms[p].getInfo<CL_PLATFORM_VERSION>() + "\n" +
                    profile.name + "\n" + profile.vendor + "\n" + profile.opencl_version);
                found.push_back(std::move(entry));
            }
        } catch (const cl::Error&) {
            continue;  // no devices, or a driver without its hardware: the other platforms still
                       // count
        }
    }
    return found;
}

std::string list_found(const std::vector<Found>& found) {
    if (found.empty()) return "no platform has a device; apt install pocl-opencl-icd";
    std::string text = "there is";
    for (const Found& entry : found)
        text += (&entry == &found.front() ? " " : ", ") + entry.profile.id + " '" +
                entry.profile.name + "' (" + entry.profile.platform + ")";
    return text;
}

template <class Predicate>
const Found* first(const std::vector<Found>& found, Predicate predicate) {
    const auto it = std::find_if(found.begin(), found.end(), predicate);
    return it == found.end() ? nullptr : &*it;
}

const Found* match(const std::vector<Found>& found, const std::string& spec) {
    const Found* gpu = first(found, [](const Found& f) { return f.profile.is_gpu; });
    const Found* cpu = first(found, [](const Found& f) { return f.profile.is_cpu; });
    if (spec.empty()) return gpu ? gpu : cpu ? cpu : found.empty() ? nullptr : &found.front();
    if (spec == "gpu") return gpu;
    if (spec == "cpu") return cpu;
    if (const Found* exact = first(found, [&](const Found& f) { return f.profile.id == spec; }))
        return exact;
    return first(found, [&](const Found& f) { return f.searched.find(spec) != std::string::npos; });
}

cl::CommandQueue make_queue(const cl::Context& context, const cl::Device& device) {
    const char* profile = std::getenv("PAVE_PROFILE");
    const bool timed = profile != nullptr && std::string_view(profile) == "1";
    return cl::CommandQueue(context, device, timed ? CL_QUEUE_PROFILING_ENABLE : 0);
}

/// "P:D" of a device that came in by handle; "external" if its platform does not list it (a
/// sub-device).
std::string id_of(const cl::Device& device) {
    std::vector<cl::Platform> platforms;
    cl::Platform::get(&platforms);
    for (size_t p = 0; p < platforms.size(); ++p) {
        std::vector<cl::Device> devices;
        try {
            platforms[p].getDevices(CL_DEVICE_TYPE_ALL, &devices);
        } catch (const cl::Error&) {
            continue;
        }
        for (size_t d = 0; d < devices.size(); ++d)
            if (devices[d]() == device()) return std::to_string(p) + ":" + std::to_string(d);
    }
    return "external";
}

}  // namespace

Device::Device(std::shared_ptr<Impl> impl) : impl_(std::move(impl)) {}

std::vector<DeviceProfile> Device::list() {
    std::vector<DeviceProfile> profiles;
    for (Found& entry : find_devices()) profiles.push_back(std::move(entry.profile));
    return profiles;
}

Device Device::select(std::string_view spec) {
    std::string origin = "device '" + std::string(spec) + "'";
    std::string wanted = lower(spec);
    if (wanted.empty()) {
        if (const char* variable = std::getenv("PAVE_DEVICE")) wanted = lower(variable);
        origin = wanted.empty() ? "a device" : "PAVE_DEVICE '" + wanted + "'";
    }
    const std::vector<Found> found = find_devices();
    const Found* chosen = match(found, wanted);
    if (chosen == nullptr) throw DeviceError(origin + " not found; " + list_found(found));
    return cl_guard(chosen->profile.name, [&] {
        cl::Context context(chosen->device);
        cl::CommandQueue queue = make_queue(context, chosen->device);
        return Device(std::make_shared<Impl>(std::move(context), chosen->device, std::move(queue),
                                             chosen->profile));
    });
}

Device Device::from_handles(void* context, void* device_id, void* queue) {
    if (context == nullptr || device_id == nullptr)
        throw DeviceError(
            "from_handles: context or device is null; pass both, only the queue may be null");
    KernelCache::of_process();
    return cl_guard("from_handles", [&] {
        cl::Context own_context(static_cast<::cl_context>(context), true);
        cl::Device own_device(static_cast<cl_device_id>(device_id), true);
        const auto devices = own_context.getInfo<CL_CONTEXT_DEVICES>();
        if (std::none_of(devices.begin(), devices.end(),
                         [&](const cl::Device& d) { return d() == own_device(); }))
            throw DeviceError("from_handles: the device is not one of the context's");
        cl::CommandQueue own_queue;
        if (queue == nullptr) {
            own_queue = make_queue(own_context, own_device);
        } else {
            own_queue = cl::CommandQueue(static_cast<cl_command_queue>(queue), true);
            if (own_queue.getInfo<CL_QUEUE_CONTEXT>()() != own_context() ||
                own_queue.getInfo<CL_QUEUE_DEVICE>()() != own_device())
                throw DeviceError("from_handles: the queue is of another context or device");
            if (own_queue.getInfo<CL_QUEUE_PROPERTIES>() & CL_QUEUE_OUT_OF_ORDER_EXEC_MODE_ENABLE)
                throw DeviceError(
                    "from_handles: the queue is out of order; PAVE needs one in order");
        }
        DeviceProfile profile = query_profile(own_device, id_of(own_device));
        return Device(std::make_shared<Impl>(std::move(own_context), std::move(own_device),
                                             std::move(own_queue), std::move(profile)));
    });
}

KernelCacheInfo Device::kernel_cache() {
    const CacheFolder& folder = KernelCache::of_process().folder();
    return {folder.path.string(), folder.note};
}

const DeviceProfile& Device::profile() const { return impl_->profile_; }
void* Device::context_handle() const { return impl_->context_(); }
void* Device::device_handle() const { return impl_->device_(); }
void* Device::queue_handle() const { return impl_->queue_(); }

const cl::Context& context_of(const Device& device) { return device.impl().context_; }
const cl::Device& device_of(const Device& device) { return device.impl().device_; }
const cl::CommandQueue& queue_of(const Device& device) { return device.impl().queue_; }

}  // namespace pave
