// Checks and writes Scenes, and describes what is wrong with them.
#include "scene.hpp"

#include <cmath>
#include <span>
#include <utility>

#include "format.hpp"
#include "number.hpp"
#include "rules.hpp"
#include "text.hpp"

namespace whitted {
namespace {

constexpr double smallest_float32 = 1e-15;
constexpr double largest_float32 = 1e15;

class Checker {
  public:
    explicit Checker(bool limits) : limits_(limits) {}

    std::vector<Diagnostic> run(const Scene &scene) {
        const View &view = scene.view;
        numbers(NEAR, 0, {&view.near_plane, 1}, "");
        edges(LEFT, view.left, RIGHT, view.right);
        edges(BOTTOM, view.bottom, TOP, view.top);
        sizes(view.columns, view.rows);
        count(SPHERE, scene.spheres.size(), "spheres");
        for (std::size_t index = 0; index < scene.spheres.size(); ++index) {
            const Sphere &sphere = scene.spheres[index];
            const std::string object = join(" of spheres[", std::to_string(index), "]");
            const double coefficients[] = {sphere.ka, sphere.kd, sphere.ks, sphere.kr, sphere.exponent};
            word(SPHERE, sphere.name, object);
            numbers(SPHERE, 1, sphere.position, object);
            numbers(SPHERE, 4, sphere.scaling, object);
            numbers(SPHERE, 7, sphere.color, object);
            numbers(SPHERE, 10, coefficients, object);
        }
        count(LIGHT, scene.lights.size(), "lights");
        for (std::size_t index = 0; index < scene.lights.size(); ++index) {
            const Light &light = scene.lights[index];
            const std::string object = join(" of lights[", std::to_string(index), "]");
            word(LIGHT, light.name, object);
            numbers(LIGHT, 1, light.position, object);
            numbers(LIGHT, 4, light.intensity, object);
        }
        numbers(BACK, 0, scene.background, "");
        numbers(AMBIENT, 0, scene.ambient, "");
        word(OUTPUT, scene.output, "");
        return report_.finish();
    }

  private:
    void error(FieldIndex field, std::string message, std::string hint) {
        report_.add({0, 0, std::string(fields[field].name), std::move(message), std::move(hint)});
    }

    // The values of a field's parameters from `first` on: whether they are in order.
    bool numbers(FieldIndex field, std::size_t first, std::span<const double> values, std::string_view object) {
        bool valid = true;
        for (std::size_t index = 0; index < values.size(); ++index) {
            const Parameter &parameter = fields[field].parameters[first + index];
            if (const auto fault = fault_of_number(parameter.kind, values[index])) {
                error(field,
                      found_message(fields[field].name, parameter, decimal(values[index]), object, fault->expected),
                      fault->hint);
                valid = false;
            }
        }
        return valid;
    }

    void word(FieldIndex field, std::string_view value, std::string_view object) {
        const Parameter &parameter = fields[field].parameters[0];
        if (const auto fault = fault_of_text(parameter.kind, value)) {
            error(field, found_message(fields[field].name, parameter, value, object, fault->expected), fault->hint);
        }
    }

    void sizes(std::int64_t columns, std::int64_t rows) {
        bool valid = true;
        for (const auto &[value, parameter] :
             {std::pair(columns, &fields[RES].parameters[0]), std::pair(rows, &fields[RES].parameters[1])}) {
            if (const auto fault = fault_of_size(value, limits_)) {
                error(RES, found_message(fields[RES].name, *parameter, std::to_string(value), "", fault->expected),
                      fault->hint);
                valid = false;
            }
        }
        if (valid && too_many_pixels(columns, rows)) {
            error(RES, pixels_message(columns, rows), "");
        }
    }

    void edges(FieldIndex low, double low_value, FieldIndex high, double high_value) {
        const bool low_valid = numbers(low, 0, {&low_value, 1}, "");
        const bool high_valid = numbers(high, 0, {&high_value, 1}, "");
        if (low_valid && high_valid && low_value >= high_value) {
            error(high, order_message(low, low_value, high, high_value), order_hint(low_value, high_value));
        }
    }

    void count(FieldIndex field, std::size_t number, std::string_view objects) {
        if (limits_ && number > static_cast<std::size_t>(most_objects)) {
            error(field, count_message(number, objects), std::string(limit_hint));
        }
    }

    bool limits_;
    Report report_;
};

void append(std::string &text, std::span<const double> values) {
    for (const double value : values) {
        text.append(" ").append(decimal(value));
    }
}

void append_line(std::string &text, FieldIndex field, std::span<const double> values) {
    text.append(fields[field].name);
    append(text, values);
    text.append("\n");
}

}  // namespace

std::vector<std::size_t> Scene::distinct() const {
    const std::vector<std::size_t> firsts = first_equals(spheres);
    std::vector<std::size_t> indices;
    for (std::size_t index = 0; index < firsts.size(); ++index) {
        if (firsts[index] == index) {
            indices.push_back(index);
        }
    }
    return indices;
}

std::vector<Diagnostic> check(const Scene &scene, bool limits) { return Checker(limits).run(scene); }

std::vector<Diagnostic> warnings(const Scene &scene) { return duplicate_warnings(scene, {}); }

std::vector<Diagnostic> check_float32(const Scene &scene) {
    Report report;
    const auto numbers = [&](FieldIndex field, std::size_t first, std::span<const double> values,
                             std::string_view object, double smallest = smallest_float32) {
        for (std::size_t index = 0; index < values.size(); ++index) {
            const double magnitude = std::abs(values[index]);
            if (magnitude != 0 && !(magnitude >= smallest && magnitude <= largest_float32)) {
                const std::string_view expected = smallest > 0 ? "a magnitude from 1e-15 to 1e15 in float32"
                                                               : "a magnitude of at most 1e15 in float32";
                report.add({0, 0, std::string(fields[field].name),
                            found_message(fields[field].name, fields[field].parameters[first + index],
                                          decimal(values[index]), object, expected),
                            "render it in float64"});
            }
        }
    };
    const View &view = scene.view;
    numbers(NEAR, 0, {&view.near_plane, 1}, "");
    numbers(LEFT, 0, {&view.left, 1}, "");
    numbers(RIGHT, 0, {&view.right, 1}, "");
    numbers(BOTTOM, 0, {&view.bottom, 1}, "");
    numbers(TOP, 0, {&view.top, 1}, "");
    for (std::size_t index = 0; index < scene.spheres.size(); ++index) {
        const Sphere &sphere = scene.spheres[index];
        const std::string object = join(" of spheres[", std::to_string(index), "]");
        numbers(SPHERE, 1, sphere.position, object);
        numbers(SPHERE, 4, sphere.scaling, object);
        // Colours and K's are at most 1, and too small ones only become 0.
        numbers(SPHERE, 14, {&sphere.exponent, 1}, object, 0);
    }
    for (std::size_t index = 0; index < scene.lights.size(); ++index) {
        const Light &light = scene.lights[index];
        const std::string object = join(" of lights[", std::to_string(index), "]");
        numbers(LIGHT, 1, light.position, object);
        numbers(LIGHT, 4, light.intensity, object);
    }
    numbers(BACK, 0, scene.background, "", 0);
    numbers(AMBIENT, 0, scene.ambient, "");
    return report.finish();
}

std::string text(const Scene &scene) {
    std::string text;
    const View &view = scene.view;
    append_line(text, NEAR, {&view.near_plane, 1});
    append_line(text, LEFT, {&view.left, 1});
    append_line(text, RIGHT, {&view.right, 1});
    append_line(text, BOTTOM, {&view.bottom, 1});
    append_line(text, TOP, {&view.top, 1});
    text.append("RES ").append(std::to_string(view.columns)).append(" ").append(std::to_string(view.rows)).append("\n");
    for (const Sphere &sphere : scene.spheres) {
        const double coefficients[] = {sphere.ka, sphere.kd, sphere.ks, sphere.kr, sphere.exponent};
        text.append("SPHERE ").append(sphere.name);
        append(text, sphere.position);
        append(text, sphere.scaling);
        append(text, sphere.color);
        append(text, coefficients);
        text.append("\n");
    }
    for (const Light &light : scene.lights) {
        text.append("LIGHT ").append(light.name);
        append(text, light.position);
        append(text, light.intensity);
        text.append("\n");
    }
    append_line(text, BACK, scene.background);
    append_line(text, AMBIENT, scene.ambient);
    return text.append("OUTPUT ").append(scene.output).append("\n");
}

std::string describe(const Diagnostic &diagnostic, std::string_view source, std::string_view severity) {
    std::string line = escaped(source);
    if (diagnostic.line > 0) {
        line.append(":").append(std::to_string(diagnostic.line)).append(":").append(std::to_string(diagnostic.column));
    }
    line.append(": ").append(severity).append(": ").append(diagnostic.message);
    if (!diagnostic.hint.empty()) {
        line.append("\n  hint: ").append(diagnostic.hint);
    }
    return line;
}

}  // namespace whitted
