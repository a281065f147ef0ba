// The Python face of the renderer: fills NumPy arrays with the interpreter unlocked.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <map>
#include <tuple>

#include "bindings.hpp"
#include "limits.hpp"
#include "render.hpp"
#include "scene.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace whitted {
namespace {

using Array = nb::ndarray<nb::numpy, nb::c_contig, nb::device::cpu>;
// The pass, its member (the light or the bounce), and the array that it fills.
using NamedArray = std::tuple<std::string, int, Array>;

const std::map<std::string, PassKind> kinds = {
    {"beauty", PassKind::beauty},         {"ambient", PassKind::ambient},
    {"diffuse", PassKind::diffuse},       {"specular", PassKind::specular},
    {"direct", PassKind::direct},         {"shadow.L*", PassKind::shadow},
    {"reflection", PassKind::reflection}, {"reflection.*", PassKind::reflection_order},
    {"depth", PassKind::depth},           {"position", PassKind::position},
    {"normal", PassKind::normal},         {"id", PassKind::id},
    {"beauty8", PassKind::beauty8},  // the bytes of a file, which is no pass of the table: for measuring
};

std::string checked_instruction_set() {
    std::string problem;
    std::string name = instruction_set(problem);
    if (name.empty()) throw nb::value_error(problem.c_str());
    return name;
}

Target target(const Scene &scene, const Settings &settings, const NamedArray &named) {
    const auto &[name, member, array] = named;
    const auto kind = kinds.find(name);
    if (kind == kinds.end()) throw nb::value_error(("unknown pass '" + name + "'").c_str());
    const std::size_t expected = static_cast<std::size_t>(scene.view.columns * scene.view.rows) *
                                 static_cast<std::size_t>(channels(kind->second)) *
                                 value_size(kind->second, settings.precision);
    if (array.nbytes() != expected)
        throw nb::value_error(("the array of pass '" + name + "' has a wrong size").c_str());
    int least = 0;
    int most = 0;
    if (kind->second == PassKind::shadow) most = static_cast<int>(scene.lights.size()) - 1;
    if (kind->second == PassKind::reflection_order) {
        least = 1;
        most = settings.max_reflections;
    }
    if (member < least || member > most)
        throw nb::value_error(("pass '" + name + "' has no member " + std::to_string(member)).c_str());
    return {kind->second, member, array.data()};
}

void render_into(const Scene &scene, const std::vector<NamedArray> &arrays, const std::string &precision, int threads,
                 const std::string &sample, double shadow_epsilon, int max_reflections) {
    checked_instruction_set();
    Settings settings;
    settings.precision = precision == "f64" ? Precision::f64 : Precision::f32;
    settings.threads = threads;
    settings.sample = parse_sample(sample).value_or(Sample::corner);
    settings.shadow_epsilon = shadow_epsilon;
    settings.max_reflections = max_reflections;
    if (settings.precision == Precision::f32) raise_errors(check_float32(scene), in_code);

    std::vector<Target> targets;
    for (const NamedArray &named : arrays) targets.push_back(target(scene, settings, named));
    bool whole = false;
    {
        const nb::gil_scoped_release unlocked;
        const Renderer renderer(scene, settings);
        whole = renderer.render(0, scene.view.columns * scene.view.rows, targets, [](std::int64_t) {
            const nb::gil_scoped_acquire locked;
            return PyErr_CheckSignals() == 0;
        });
    }
    if (!whole) throw nb::python_error();  // what the signal's handler raised: KeyboardInterrupt
}

nb::dict limits(double seconds) {
    const std::string name = checked_instruction_set();
    Rate rates[2]{};
    {
        const nb::gil_scoped_release unlocked;
        measure_limits(name, seconds, rates);
    }
    nb::dict found;
    const char *const precisions[] = {"f64", "f32"};
    for (int i = 0; i < 2; ++i) {
        nb::dict entry;
        entry["multiply_adds"] = rates[i].multiply_adds;
        entry["square_roots"] = rates[i].square_roots;
        entry["divisions"] = rates[i].divisions;
        found[precisions[i]] = entry;
    }
    return found;
}

}  // namespace

void bind_render(nb::module_ &module) {
    module.def("render_into", &render_into, "scene"_a, "arrays"_a, "precision"_a, "threads"_a, "sample"_a,
               "shadow_epsilon"_a, "max_reflections"_a,
               nb::sig("def render_into(scene: Scene, arrays: Sequence[tuple[str, int, "
                       "numpy.typing.NDArray[typing.Any]]], precision: str, "
                       "threads: int, sample: str, shadow_epsilon: float, max_reflections: int) -> None"),
               "Fill arrays with passes; `tracer.render` is the checked face of this.");
    module.def("instruction_set", &checked_instruction_set,
               "The instruction set of the kernels in use: scalar, sse2, avx2, avx512 or neon.\n\n"
               "Raises:\n    ValueError: the environment variable WHITTED_ISA names one that is not there.");
    module.def(
        "limits", &limits, "seconds"_a = 0.2,
        nb::sig("def limits(seconds: float = 0.2) -> dict[str, dict[str, float]]"),
        "What one thread of this machine can do in a second with the instruction set in use, by precision.\n\n"
        "multiply_adds, not fused, like those of the kernels; square_roots; divisions. Measured in about `seconds`.");
    module.def("compiler", &compiler, "The compiler that built the extension.");
    module.def("version", [] { return std::string(WHITTED_VERSION); }, "The version of whitted.");
    module.attr("MOST_REFLECTIONS") = most_reflections;
    module.attr("MOST_THREADS") = most_threads;
}

}  // namespace whitted
