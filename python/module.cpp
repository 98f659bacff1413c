// The Python module _pave: nothing but the library's types and verbs; the package around it gives
// them their shape.
// SPDX-License-Identifier: BSD-3-Clause
#include <nanobind/stl/string.h>

#include <atomic>
#include <span>
#include <string>

#include "bindings.h"
#include "host/device/cl.h"
#include "pave/error.h"
#include "pave/hash.h"
#include "pave/version.h"

namespace pave::python {
namespace {

/// How often PAVE copied a channel between a slot and Python; of the process, any thread.
std::atomic<int64_t> copy_count{0};

/// Raises the class of pave/errors.py that has the C++ type's name.
void raise(const char* name, const Error& error) {
    const nb::object type = nb::module_::import_("pave.errors").attr(name);
    PyErr_SetString(type.ptr(), error.what());
}

void raise_cl_error(const ClError& error) {
    const nb::object type = nb::module_::import_("pave.errors").attr("ClError");
    const nb::object exception = type(error.what());
    exception.attr("routine") = nb::str(error.routine.c_str());
    exception.attr("code") = nb::int_(error.code);
    exception.attr("build_log") = nb::steal(PyUnicode_DecodeUTF8(
        error.build_log.data(), static_cast<Py_ssize_t>(error.build_log.size()), "replace"));
    PyErr_SetObject(type.ptr(), exception.ptr());
}

/// The one place where C++ errors become Python's; everything else stays with nanobind.
void translate(const std::exception_ptr& thrown, void*) {
    try {
        std::rethrow_exception(thrown);
    } catch (const ClError& error) {
        raise_cl_error(error);
    } catch (const RunError& error) {
        raise("RunError", error);
    } catch (const UsageError& error) {
        raise("UsageError", error);
    } catch (const InputError& error) {
        raise("InputError", error);
    } catch (const DeviceError& error) {
        raise("DeviceError", error);
    } catch (const PeerError& error) {
        raise("PeerError", error);
    } catch (const InternalError& error) {
        raise("InternalError", error);
    } catch (const Error& error) {
        raise("Error", error);
    }
}

/// Bytes of any object with a contiguous buffer, borrowed while this lives. Call with the GIL held.
class BufferView {
   public:
    explicit BufferView(nb::handle object) {
        if (PyObject_GetBuffer(object.ptr(), &view_, PyBUF_SIMPLE) != 0) throw nb::python_error();
    }
    ~BufferView() { PyBuffer_Release(&view_); }
    BufferView(const BufferView&) = delete;
    BufferView& operator=(const BufferView&) = delete;
    std::span<const std::byte> bytes() const {
        return {static_cast<const std::byte*>(view_.buf), static_cast<size_t>(view_.len)};
    }

   private:
    Py_buffer view_{};
};

std::string hash_buffer(nb::handle data) {
    const BufferView view(data);
    const nb::gil_scoped_release released;
    return hash_hex(view.bytes());
}

}  // namespace

FloatArray array_of(std::vector<float> values, std::vector<size_t> shape) {
    auto* owned = new std::vector<float>(std::move(values));
    const nb::capsule owner(
        owned, [](void* held) noexcept { delete static_cast<std::vector<float>*>(held); });
    return FloatArray(owned->data(), shape.size(), shape.data(), owner);
}

}  // namespace pave::python

NB_MODULE(_pave, module) {
    using namespace pave::python;
    module.doc() =
        "The C++ library behind the package pave. Use the package: this module has no promises.";
    nb::set_leak_warnings(false);  // arrays over slots may live until the process ends
    nb::register_exception_translator(translate);
    module.def("program_version", &pave::program_version);
    module.def("program_commit", &pave::program_commit);
    module.def("hash_bytes", &hash_buffer, nb::arg("data"));
    module.def("copies", [] { return copy_count.load(); });
    module.def(
        "count_copy", [](int64_t channels) { copy_count += channels; }, nb::arg("channels"));
    module.def(
        "keep_forever", [](nb::handle object) { object.inc_ref(); }, nb::arg("object"),
        "Never lets the object be destroyed: for what a forked child must not tear down.");
    bind_frames(module);
    bind_device(module);
    bind_staging(module);
    bind_rendering(module);
    bind_rays(module);
}
