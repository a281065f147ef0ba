// The Python face of the C++ library (nanobind).
#include "bindings.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/operators.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "scene.hpp"

namespace nb = nanobind;
using namespace nb::literals;

namespace whitted {
namespace {

using Triple = nb::typed<nb::tuple, double, double, double>;

Triple triple(const Vec3 &vector) { return Triple(nb::make_tuple(vector[0], vector[1], vector[2])); }

// A zero of a scene has no sign.
double unsigned_zero(double value) { return value + 0.0; }

Vec3 unsigned_zero(const Vec3 &vector) {
    return {unsigned_zero(vector[0]), unsigned_zero(vector[1]), unsigned_zero(vector[2])};
}

std::int64_t integer(const nb::object &value) {
    const nb::object index = nb::steal(PyNumber_Index(value.ptr()));
    const std::int64_t result = index.is_valid() ? PyLong_AsLongLong(index.ptr()) : -1;
    if (PyErr_Occurred() != nullptr) {
        throw nb::python_error();
    }
    return result;
}

template <class T>
nb::tuple tuple_of(const std::vector<T> &items) {
    nb::list list;
    for (const T &item : items) {
        list.append(nb::cast(item, nb::rv_policy::copy));
    }
    return nb::tuple(list);
}

// ---------------------------------------------------------------------------------------------------------------------
// What all values have in common: they are made of named attributes and never change.

using Names = std::span<const char *const>;

nb::tuple attributes(nb::handle self, Names names) {
    nb::list values;
    for (const char *name : names) {
        values.append(self.attr(name));
    }
    return nb::tuple(values);
}

std::string represent(nb::handle self, Names names, std::string_view end = ")") {
    std::string text = nb::cast<std::string>(self.type().attr("__name__"));
    for (std::size_t index = 0; index < names.size(); ++index) {
        text.append(index == 0 ? "(" : ", ").append(names[index]).append("=");
        text.append(nb::repr(self.attr(names[index])).c_str());
    }
    return text.append(end);
}

void check_size(const nb::tuple &state, Names names) {
    if (state.size() != names.size()) {
        throw nb::value_error("a pickled state of another version");
    }
}

void check_names(const std::string &type, Names names, const nb::kwargs &changes) {
    for (const auto &[key, value] : changes) {
        const auto name = nb::cast<std::string>(key);
        if (std::find(names.begin(), names.end(), name) == names.end()) {
            throw nb::type_error((type + " has no attribute '" + name + "'").c_str());
        }
    }
}

// The keyword arguments that make a copy with changes.
nb::dict changed(nb::handle self, Names names, const nb::kwargs &changes) {
    check_names(nb::cast<std::string>(self.type().attr("__name__")), names, changes);
    nb::dict arguments;
    for (const char *name : names) {
        arguments[name] = self.attr(name);
    }
    for (const auto &[name, value] : changes) {
        arguments[name] = value;
    }
    return arguments;
}

constexpr const char *hash_signature = "def __hash__(self) -> int";
constexpr const char *equal_signature = "def __eq__(self, other: object, /) -> bool";
constexpr const char *get_state_signature = "def __getstate__(self) -> tuple[object, ...]";
constexpr const char *set_state_signature = "def __setstate__(self, state: tuple[object, ...], /) -> None";

template <class T>
void bind_value(nb::class_<T> &type, Names names) {
    type.def(
            "__eq__", [](const T &a, const T &b) { return a == b; }, nb::is_operator(), nb::sig(equal_signature))
        .def(
            "__hash__", [names](nb::handle_t<T> self) { return nb::hash(attributes(self, names)); },
            nb::sig(hash_signature))
        .def("__copy__", [](nb::handle_t<T> self) { return nb::borrow(self); })
        .def("__deepcopy__", [](nb::handle_t<T> self, nb::handle) { return nb::borrow(self); }, "memo"_a);
}

template <class T>
void bind_repr(nb::class_<T> &type, Names names) {
    type.def("__repr__", [names](nb::handle_t<T> self) { return represent(self, names); });
}

template <class T>
nb::object replace(nb::handle self, Names names, const nb::kwargs &changes) {
    return nb::type<T>()(**changed(self, names, changes));
}

// ---------------------------------------------------------------------------------------------------------------------
// Errors and warnings

std::string described(const std::vector<Diagnostic> &diagnostics, std::string_view source, std::string_view severity) {
    std::string text;
    for (const Diagnostic &diagnostic : diagnostics) {
        text.append(text.empty() ? "" : "\n").append(describe(diagnostic, source, severity));
    }
    return text;
}

}  // namespace

void raise_errors(const std::vector<Diagnostic> &errors, std::string_view source) {
    if (errors.empty()) {
        return;
    }
    const nb::object type = nb::module_::import_("tracer.errors").attr("SceneError");
    const nb::object error = type(described(errors, source, "error"), tuple_of(errors));
    PyErr_SetObject(type.ptr(), error.ptr());
    throw nb::python_error();
}

namespace {

void warn(const std::vector<Diagnostic> &warnings, std::string_view source) {
    if (warnings.empty()) {
        return;
    }
    const nb::object category = nb::module_::import_("tracer.errors").attr("SceneWarning");
    if (PyErr_WarnEx(category.ptr(), described(warnings, source, "warning").c_str(), 1) != 0) {
        throw nb::python_error();
    }
}

Scene parsed(std::string_view text, bool limits, std::string_view source) {
    ParseResult result = parse(text, limits);
    raise_errors(result.errors, source);
    warn(result.warnings, source);
    return std::move(result.scene);
}

// The bytes of a Python string, its lone surrogates too: the parser refuses them with a place.
nb::bytes encoded(const nb::object &text) { return nb::cast<nb::bytes>(text.attr("encode")("utf-8", "surrogatepass")); }

Scene loads(const nb::object &text, bool limits, const std::string &source) {
    nb::bytes bytes;
    if (nb::isinstance<nb::bytes>(text)) {
        bytes = nb::cast<nb::bytes>(text);
    } else if (nb::isinstance<nb::str>(text)) {
        bytes = encoded(text);
    } else {
        throw nb::type_error("the text of a scene is str or bytes");
    }
    return parsed({bytes.c_str(), bytes.size()}, limits, source);
}

Scene load(const nb::object &path, bool limits) {
    const auto bytes = nb::cast<nb::bytes>(nb::module_::import_("pathlib").attr("Path")(path).attr("read_bytes")());
    const auto source = nb::cast<nb::bytes>(nb::module_::import_("os").attr("fsencode")(path));
    return parsed({bytes.c_str(), bytes.size()}, limits, {source.c_str(), source.size()});
}

constexpr const char *diagnostic_names[] = {"line", "column", "field", "message", "hint"};

void bind_errors(nb::module_ &module) {
    nb::class_<Diagnostic> type(module, "SceneDiagnostic", nb::is_final(),
                                "One thing that is wrong with a scene, or worth a warning.");
    type.def(
            "__init__",
            [](Diagnostic *self, std::int64_t line, std::int64_t column, std::string field, std::string message,
               std::string hint) {
                new (self) Diagnostic{line, column, std::move(field), std::move(message), std::move(hint)};
            },
            nb::kw_only(), "line"_a = 0, "column"_a = 0, "field"_a = "", "message"_a, "hint"_a = "")
        .def_ro("line", &Diagnostic::line, "The line, from 1; 0 for a Scene made in code.")
        .def_ro("column", &Diagnostic::column, "The column, from 1, in bytes; 0 for a Scene made in code.")
        .def_ro("field", &Diagnostic::field, "The field's name, for example 'SPHERE'; '' where there is none.")
        .def_ro("message", &Diagnostic::message, "One sentence: what was found and what was expected.")
        .def_ro("hint", &Diagnostic::hint, "What to do; '' where there is nothing to say.")
        .def(
            "describe",
            [](const Diagnostic &self, const std::string &source, const std::string &severity) {
                return describe(self, source, severity);
            },
            "source"_a, "severity"_a = "error",
            "`source:line:column: error: message` and, where there is one, a line `  hint: ...`.")
        .def("__str__", [](const Diagnostic &self) { return describe(self, in_code); })
        .def(
            "__getstate__", [](nb::handle_t<Diagnostic> self) { return attributes(self, diagnostic_names); },
            nb::sig(get_state_signature))
        .def(
            "__setstate__",
            [](Diagnostic &self, const nb::tuple &state) {
                check_size(state, diagnostic_names);
                new (&self) Diagnostic{nb::cast<std::int64_t>(state[0]), nb::cast<std::int64_t>(state[1]),
                                       nb::cast<std::string>(state[2]), nb::cast<std::string>(state[3]),
                                       nb::cast<std::string>(state[4])};
            },
            nb::sig(set_state_signature));
    bind_value(type, diagnostic_names);
    bind_repr(type, diagnostic_names);
}

// ---------------------------------------------------------------------------------------------------------------------
// Values

constexpr const char *view_names[] = {"near", "left", "right", "bottom", "top", "columns", "rows"};
constexpr const char *sphere_names[] = {"name", "position", "scaling", "color", "ka", "kd", "ks", "kr", "exponent"};
constexpr const char *light_names[] = {"name", "position", "intensity"};
constexpr const char *scene_names[] = {"view", "spheres", "lights", "background", "ambient", "output"};

void construct(View *self, double near_plane, double left, double right, double bottom, double top,
               const nb::object &columns, const nb::object &rows) {
    const std::int64_t column_count = integer(columns);
    const std::int64_t row_count = integer(rows);
    new (self) View{unsigned_zero(near_plane),
                    unsigned_zero(left),
                    unsigned_zero(right),
                    unsigned_zero(bottom),
                    unsigned_zero(top),
                    column_count,
                    row_count};
}

void construct(Sphere *self, std::string name, const Vec3 &position, const Vec3 &scaling, const Vec3 &color, double ka,
               double kd, double ks, double kr, double exponent) {
    new (self) Sphere{std::move(name),      unsigned_zero(position), unsigned_zero(scaling),
                      unsigned_zero(color), unsigned_zero(ka),       unsigned_zero(kd),
                      unsigned_zero(ks),    unsigned_zero(kr),       unsigned_zero(exponent)};
}

void construct(Light *self, std::string name, const Vec3 &position, const Vec3 &intensity) {
    new (self) Light{std::move(name), unsigned_zero(position), unsigned_zero(intensity)};
}

void construct(Scene *self, const View &view, std::vector<Sphere> spheres, std::vector<Light> lights,
               const Vec3 &background, const Vec3 &ambient, std::string output, bool limits) {
    Scene scene{view,
                std::move(spheres),
                std::move(lights),
                unsigned_zero(background),
                unsigned_zero(ambient),
                std::move(output)};
    raise_errors(check(scene, limits), in_code);
    warn(warnings(scene), in_code);
    new (self) Scene(std::move(scene));
}

void bind_view(nb::module_ &module) {
    nb::class_<View> type(module, "View", nb::is_final(),
                          "The image plane z = -near, the rectangle of it that the image shows, and the resolution.\n\n"
                          "Checked when it becomes part of a Scene.");
    type.def(
            "__init__",
            [](View *self, double near_plane, double left, double right, double bottom, double top,
               const nb::object &columns,
               const nb::object &rows) { construct(self, near_plane, left, right, bottom, top, columns, rows); },
            nb::kw_only(), "near"_a, "left"_a, "right"_a, "bottom"_a, "top"_a, "columns"_a, "rows"_a,
            nb::sig("def __init__(self, *, near: float, left: float, right: float, bottom: float, top: float, "
                    "columns: int, rows: int) -> None"))
        .def_ro("near", &View::near_plane, "The distance of the image plane along -z, above 0.")
        .def_ro("left", &View::left, "x of the image's left edge, below `right`.")
        .def_ro("right", &View::right, "x of the image's right edge.")
        .def_ro("bottom", &View::bottom, "y of the image's bottom edge, below `top`.")
        .def_ro("top", &View::top, "y of the image's top edge.")
        .def_ro("columns", &View::columns, "The image's width in pixels, at least 1.")
        .def_ro("rows", &View::rows, "The image's height in pixels, at least 1.")
        .def(
            "replace",
            [](nb::handle_t<View> self, const nb::kwargs &changes) { return replace<View>(self, view_names, changes); },
            nb::sig("def replace(self, *, near: float = ..., left: float = ..., right: float = ..., "
                    "bottom: float = ..., top: float = ..., columns: int = ..., rows: int = ...) -> View"),
            "A copy with some attributes changed.")
        .def(
            "__getstate__", [](nb::handle_t<View> self) { return attributes(self, view_names); },
            nb::sig(get_state_signature))
        .def(
            "__setstate__",
            [](View &self, const nb::tuple &state) {
                check_size(state, view_names);
                construct(&self, nb::cast<double>(state[0]), nb::cast<double>(state[1]), nb::cast<double>(state[2]),
                          nb::cast<double>(state[3]), nb::cast<double>(state[4]), state[5], state[6]);
            },
            nb::sig(set_state_signature));
    bind_value(type, view_names);
    bind_repr(type, view_names);
}

void bind_sphere(nb::module_ &module) {
    nb::class_<Sphere> type(module, "Sphere", nb::is_final(),
                            "An ellipsoid |(x - position) / scaling| = 1 with its Phong coefficients.\n\n"
                            "Checked when it becomes part of a Scene.");
    type.def(
            "__init__",
            [](Sphere *self, std::string name, const Vec3 &position, const Vec3 &scaling, const Vec3 &color, double ka,
               double kd, double ks, double kr, double exponent) {
                construct(self, std::move(name), position, scaling, color, ka, kd, ks, kr, exponent);
            },
            nb::kw_only(), "name"_a, "position"_a, "scaling"_a, "color"_a, "ka"_a, "kd"_a, "ks"_a, "kr"_a, "exponent"_a)
        .def_ro("name", &Sphere::name, "At most 20 bytes of UTF-8, printable, without blanks.")
        .def_prop_ro(
            "position", [](const Sphere &self) { return triple(self.position); }, "The centre.")
        .def_prop_ro(
            "scaling", [](const Sphere &self) { return triple(self.scaling); },
            "The half axes, none of them 0; their sign has no effect.")
        .def_prop_ro(
            "color", [](const Sphere &self) { return triple(self.color); }, "O: RGB in [0, 1].")
        .def_ro("ka", &Sphere::ka, "The ambient coefficient, in [0, 1].")
        .def_ro("kd", &Sphere::kd, "The diffuse coefficient, in [0, 1].")
        .def_ro("ks", &Sphere::ks, "The specular coefficient, in [0, 1].")
        .def_ro("kr", &Sphere::kr, "The coefficient of reflection, in [0, 1].")
        .def_ro("exponent", &Sphere::exponent, "n: the specular exponent, at least 0.")
        .def(
            "replace",
            [](nb::handle_t<Sphere> self, const nb::kwargs &changes) {
                return replace<Sphere>(self, sphere_names, changes);
            },
            nb::sig("def replace(self, *, name: str = ..., position: Sequence[float] = ..., "
                    "scaling: Sequence[float] = ..., color: Sequence[float] = ..., ka: float = ..., kd: float = ..., "
                    "ks: float = ..., kr: float = ..., exponent: float = ...) -> Sphere"),
            "A copy with some attributes changed.")
        .def(
            "__getstate__", [](nb::handle_t<Sphere> self) { return attributes(self, sphere_names); },
            nb::sig(get_state_signature))
        .def(
            "__setstate__",
            [](Sphere &self, const nb::tuple &state) {
                check_size(state, sphere_names);
                construct(&self, nb::cast<std::string>(state[0]), nb::cast<Vec3>(state[1]), nb::cast<Vec3>(state[2]),
                          nb::cast<Vec3>(state[3]), nb::cast<double>(state[4]), nb::cast<double>(state[5]),
                          nb::cast<double>(state[6]), nb::cast<double>(state[7]), nb::cast<double>(state[8]));
            },
            nb::sig(set_state_signature));
    bind_value(type, sphere_names);
    bind_repr(type, sphere_names);
}

void bind_light(nb::module_ &module) {
    nb::class_<Light> type(module, "Light", nb::is_final(),
                           "A point light without falloff.\n\nChecked when it becomes part of a Scene.");
    type.def(
            "__init__",
            [](Light *self, std::string name, const Vec3 &position, const Vec3 &intensity) {
                construct(self, std::move(name), position, intensity);
            },
            nb::kw_only(), "name"_a, "position"_a, "intensity"_a)
        .def_ro("name", &Light::name, "At most 20 bytes of UTF-8, printable, without blanks.")
        .def_prop_ro(
            "position", [](const Light &self) { return triple(self.position); }, "Where it is.")
        .def_prop_ro(
            "intensity", [](const Light &self) { return triple(self.intensity); },
            "I: linear RGB, also above 1 and below 0.")
        .def(
            "replace",
            [](nb::handle_t<Light> self, const nb::kwargs &changes) {
                return replace<Light>(self, light_names, changes);
            },
            nb::sig("def replace(self, *, name: str = ..., position: Sequence[float] = ..., "
                    "intensity: Sequence[float] = ...) -> Light"),
            "A copy with some attributes changed.")
        .def(
            "__getstate__", [](nb::handle_t<Light> self) { return attributes(self, light_names); },
            nb::sig(get_state_signature))
        .def(
            "__setstate__",
            [](Light &self, const nb::tuple &state) {
                check_size(state, light_names);
                construct(&self, nb::cast<std::string>(state[0]), nb::cast<Vec3>(state[1]), nb::cast<Vec3>(state[2]));
            },
            nb::sig(set_state_signature));
    bind_value(type, light_names);
    bind_repr(type, light_names);
}

bool keeps_limits(const Scene &scene) { return check(scene, true).empty(); }

template <class T>
void take(const nb::kwargs &changes, const char *name, T &value) {
    if (changes.contains(name) && !nb::try_cast(changes[name], value)) {
        const std::string message = "Scene has no such " + std::string(name) + ": " + nb::repr(changes[name]).c_str();
        throw nb::type_error(message.c_str());
    }
}

Scene replace_in(Scene scene, bool limits, const nb::kwargs &changes) {
    check_names("Scene", scene_names, changes);
    take(changes, "view", scene.view);
    take(changes, "spheres", scene.spheres);
    take(changes, "lights", scene.lights);
    take(changes, "background", scene.background);
    take(changes, "ambient", scene.ambient);
    take(changes, "output", scene.output);
    scene.background = unsigned_zero(scene.background);
    scene.ambient = unsigned_zero(scene.ambient);
    raise_errors(check(scene, limits), in_code);
    // Spheres that are not new have been warned about.
    if (changes.contains("spheres")) {
        warn(warnings(scene), in_code);
    }
    return scene;
}

void bind_scene_type(nb::module_ &module) {
    nb::class_<Scene> type(
        module, "Scene", nb::is_final(),
        "A view, spheres, lights, and the name of the image: what a scene file says, as float64.\n\n"
        "It is checked by the rules of scene files. `limits=False` lifts the limits of five spheres, five lights, and\n"
        "100 000 columns and rows.\n\n"
        "Raises:\n"
        "    SceneError: with everything that is wrong.\n\n"
        "Warns:\n"
        "    SceneWarning: two spheres have the same centre and the same |scaling|.");
    type.def(
            "__init__",
            [](Scene *self, const View &view, std::vector<Sphere> spheres, std::vector<Light> lights,
               const Vec3 &background, const Vec3 &ambient, std::string output, bool limits) {
                construct(self, view, std::move(spheres), std::move(lights), background, ambient, std::move(output),
                          limits);
            },
            nb::kw_only(), "view"_a, "spheres"_a = nb::tuple(), "lights"_a = nb::tuple(),
            "background"_a = nb::make_tuple(0.0, 0.0, 0.0), "ambient"_a = nb::make_tuple(0.0, 0.0, 0.0),
            "output"_a = "image.ppm", "limits"_a = true)
        .def_prop_ro(
            "view", [](const Scene &self) { return self.view; }, "The image plane and the resolution.")
        .def_prop_ro(
            "spheres",
            [](const Scene &self) { return nb::typed<nb::tuple, Sphere, nb::ellipsis>(tuple_of(self.spheres)); },
            "All spheres in the order of the file; an index into them is what the pass `id` shows.")
        .def_prop_ro(
            "lights",
            [](const Scene &self) { return nb::typed<nb::tuple, Light, nb::ellipsis>(tuple_of(self.lights)); },
            "All lights in the order of the file.")
        .def_prop_ro(
            "background", [](const Scene &self) { return triple(self.background); },
            "Linear RGB where a primary ray hits nothing.")
        .def_prop_ro(
            "ambient", [](const Scene &self) { return triple(self.ambient); }, "Ia: linear RGB.")
        .def_ro("output", &Scene::output, "The name of the image file, one word.")
        .def_prop_ro(
            "distinct",
            [](const Scene &self) { return nb::typed<nb::tuple, int, nb::ellipsis>(tuple_of(self.distinct())); },
            "The indices of the spheres that exist: all but those with the centre and |scaling| of an earlier one.")
        .def(
            "text", [](const Scene &self) { return text(self); },
            "The canonical text. `loads` makes an equal Scene of it, and equal Scenes have equal texts.")
        .def(
            "replace",
            [](const Scene &self, std::optional<bool> limits, const nb::kwargs &changes) {
                return replace_in(self, limits.value_or(keeps_limits(self)), changes);
            },
            "limits"_a.none() = nb::none(), "changes"_a,
            nb::sig("def replace(self, *, limits: bool | None = None, view: View = ..., "
                    "spheres: Sequence[Sphere] = ..., lights: Sequence[Light] = ..., "
                    "background: Sequence[float] = ..., ambient: Sequence[float] = ..., output: str = ...) -> Scene"),
            "A copy with some attributes changed, checked like any Scene.\n\n"
            "`limits` None asks of the copy what this Scene keeps itself. Only new spheres are warned about.")
        .def("__getstate__",
             [](const Scene &self) {
                 const std::string canonical = text(self);
                 return nb::bytes(canonical.data(), canonical.size());
             })
        .def("__setstate__", [](Scene &self, const nb::bytes &state) {
            ParseResult result = parse({state.c_str(), state.size()}, false);
            raise_errors(result.errors, in_code);
            new (&self) Scene(std::move(result.scene));
        });
    type.def("__repr__", [](nb::handle_t<Scene> self) {
        const bool limits = keeps_limits(nb::cast<const Scene &>(self));
        return represent(self, scene_names, limits ? ")" : ", limits=False)");
    });
    bind_value(type, scene_names);
}

void bind_scene(nb::module_ &module) {
    bind_errors(module);
    bind_view(module);
    bind_sphere(module);
    bind_light(module);
    bind_scene_type(module);
    module.def("loads", &loads, "text"_a, nb::kw_only(), "limits"_a = true, "source"_a = "<text>",
               nb::sig("def loads(text: str | bytes, *, limits: bool = True, source: str = '<text>') -> Scene"),
               "Read the text of a scene.\n\n"
               "`limits=False` lifts the limits of five spheres, five lights, and 100 000 columns and rows. `source` "
               "stands\nfor the file in messages.\n\n"
               "Raises:\n"
               "    SceneError: with everything that is wrong, in the order of the text.\n\n"
               "Warns:\n"
               "    SceneWarning: two spheres have the same centre and the same |scaling|; the later one is ignored.");
    module.def("load", &load, "path"_a, nb::kw_only(), "limits"_a = true,
               nb::sig("def load(path: str | os.PathLike[str], *, limits: bool = True) -> Scene"),
               "Read a scene file.\n\n"
               "`limits=False` lifts the limits of five spheres, five lights, and 100 000 columns and rows.\n\n"
               "Raises:\n"
               "    SceneError: with everything that is wrong, in the order of the file.\n"
               "    OSError: the file cannot be read.\n\n"
               "Warns:\n"
               "    SceneWarning: two spheres have the same centre and the same |scaling|; the later one is ignored.");
}

}  // namespace
}  // namespace whitted

NB_MODULE(_native, module) {
    // Whoever keeps a Scene until the interpreter ends, in a traceback or a module, leaks nothing that matters.
    nb::set_leak_warnings(false);
    module.doc() = "The tracer in C++: scenes and their rendering.";
    whitted::bind_scene(module);
    whitted::bind_render(module);
}
