// Scenes, the renderer and the generator for Python. Rendering lets go of the interpreter lock and
// takes it back between launches, for progress and signals.
// SPDX-License-Identifier: BSD-3-Clause
#include <nanobind/stl/array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <exception>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "bindings.h"
#include "pave/generator.h"
#include "pave/render.h"
#include "pave/scene.h"

namespace pave::python {
namespace {

using Released = nb::call_guard<nb::gil_scoped_release>;

/// RenderOptions::progress over a Python callable. What Python raises in it, Ctrl-C included, ends
/// the render and is raised by rethrow().
class Progress {
   public:
    explicit Progress(nb::object callable) : callable_(std::move(callable)) {}
    bool operator()(double done) {
        const nb::gil_scoped_acquire acquired;
        try {
            if (PyErr_CheckSignals() != 0) throw nb::python_error();
            return callable_.is_none() || !callable_(done).is(nb::handle(Py_False));
        } catch (...) {
            raised_ = std::current_exception();
            return false;
        }
    }
    void rethrow() const {
        if (raised_) std::rethrow_exception(raised_);
    }

   private:
    nb::object callable_;
    std::exception_ptr raised_;
};

Sampler sampler_of(const std::string& name) {
    if (name == "sobol") return Sampler::kSobol;
    if (name == "independent") return Sampler::kIndependent;
    throw UsageError("sampler '" + name + "' is none of sobol, independent");
}

void render(Renderer& renderer, const View& view, Frame& frame, int spp, int max_depth,
            int rr_depth, const std::string& sampler, uint64_t seed, int64_t frame_index,
            int tile_rows, int work_group_size, int lane_width, nb::object callable) {
    Progress progress(std::move(callable));
    RenderOptions options;
    options.spp = spp;
    options.max_depth = max_depth;
    options.rr_depth = rr_depth;
    options.sampler = sampler_of(sampler);
    options.seed = seed;
    options.frame_index = frame_index;
    options.tile_rows = tile_rows;
    options.work_group_size = work_group_size;
    options.lane_width = lane_width;
    options.progress = [&progress](double done) { return progress(done); };
    try {
        const nb::gil_scoped_release released;
        renderer.render(view, options, frame);
    } catch (const RunError&) {
        progress.rethrow();
        throw;
    }
}

Scene load(const std::string& path_or_name, bool ignore_unsupported,
           const std::map<std::string, std::string>& defines) {
    LoadOptions options;
    options.ignore_unsupported = ignore_unsupported;
    options.defines = defines;
    return load_scene(path_or_name, options);
}

bool has_specular(const Scene& scene) {
    return std::any_of(scene.bsdfs.begin(), scene.bsdfs.end(), [](const Bsdf& bsdf) {
        return bsdf.type == Bsdf::Type::kDielectric || bsdf.type == Bsdf::Type::kConductor;
    });
}

void bind_scene(nb::module_& module) {
    nb::class_<Scene>(module, "Scene")
        .def_ro("name", &Scene::name)
        .def_ro("hash", &Scene::hash)
        .def_ro("view", &Scene::view)
        .def_ro("width", &Scene::width)
        .def_ro("height", &Scene::height)
        .def_ro("spp", &Scene::spp)
        .def_ro("max_depth", &Scene::max_depth)
        .def_ro("rr_depth", &Scene::rr_depth)
        .def_ro("warnings", &Scene::warnings)
        .def_ro("bounds_min", &Scene::bounds_min)
        .def_ro("bounds_max", &Scene::bounds_max)
        .def_prop_ro("shape_count", [](const Scene& scene) { return scene.shapes.size(); })
        .def_prop_ro("has_specular", &has_specular);
    module.def("load_scene", &load, nb::arg("path_or_name"), nb::arg("ignore_unsupported"),
               nb::arg("defines"), Released());
    module.def("hemisphere_views", &hemisphere_views, nb::arg("scene"), nb::arg("count"),
               nb::arg("seed"), Released());
}

void bind_renderer(nb::module_& module) {
    nb::class_<Renderer>(module, "Renderer")
        .def(
            "__init__",
            [](Renderer* self, const Device& device, const Scene& scene, int copied_triangles) {
                RendererPaths paths;
                paths.copied_triangles = copied_triangles;
                new (self) Renderer(device, scene, paths);
            },
            nb::arg("device"), nb::arg("scene"), nb::arg("copied_triangles"), Released())
        .def("render", &render, nb::arg("view"), nb::arg("frame"), nb::arg("spp"),
             nb::arg("max_depth"), nb::arg("rr_depth"), nb::arg("sampler"), nb::arg("seed"),
             nb::arg("frame_index"), nb::arg("tile_rows"), nb::arg("work_group_size"),
             nb::arg("lane_width"), nb::arg("progress").none())
        .def_prop_ro("dropped_samples", &Renderer::dropped_samples)
        .def_prop_ro("dropped_triangles", &Renderer::dropped_triangles);
}

using InputPlanes = nb::ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

/// The output planes, and by node name every node's output when `layers`.
nb::object run_generator(Generator& generator, const InputPlanes& input, bool layers) {
    std::map<std::string, std::vector<float>> outputs;
    std::vector<float> values;
    {
        const nb::gil_scoped_release released;
        values = generator.run({input.data(), input.size()}, static_cast<int>(input.shape(2)),
                               static_cast<int>(input.shape(1)), layers ? &outputs : nullptr);
    }
    const size_t planes = values.size() / (input.shape(1) * input.shape(2));
    nb::object image =
        nb::cast(array_of(std::move(values), {planes, input.shape(1), input.shape(2)}));
    if (!layers) return image;
    nb::dict by_name;
    for (auto& [name, data] : outputs) {
        const size_t count = data.size();
        by_name[name.c_str()] = array_of(std::move(data), {count});
    }
    return nb::make_tuple(image, by_name);
}

void bind_generator(nb::module_& module) {
    nb::class_<Generator>(module, "Generator")
        .def(nb::init<const Device&, const std::string&>(), nb::arg("device"),
             nb::arg("run_folder"), Released())
        .def_prop_ro("inputs", &Generator::inputs)
        .def_prop_ro("weights_version", &Generator::weights_version)
        .def("draw", &Generator::draw, nb::arg("frame"), Released())
        .def("run", &run_generator, nb::arg("planes"), nb::arg("layers"))
        .def(
            "planned_byte_size",
            [](const Generator& generator, int width, int height) {
                size_t unplanned = 0;
                const size_t planned = generator.planned_byte_size(width, height, &unplanned);
                return std::make_pair(planned, unplanned);
            },
            nb::arg("width"), nb::arg("height"));
}

}  // namespace

void bind_rendering(nb::module_& module) {
    bind_scene(module);
    bind_renderer(module);
    bind_generator(module);
}

}  // namespace pave::python
