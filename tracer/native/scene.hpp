// The scene of the specification: values, the one parser, the canonical writer, and what is wrong with a file.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace whitted {

using Vec3 = std::array<double, 3>;

// The image plane z = -near and the resolution.
struct View {
    double near_plane = 1;
    double left = -1;
    double right = 1;
    double bottom = -1;
    double top = 1;
    std::int64_t columns = 1;
    std::int64_t rows = 1;
    bool operator==(const View &) const = default;
};

// An ellipsoid |(x - position) / scaling| = 1 with its Phong coefficients.
struct Sphere {
    std::string name;
    Vec3 position{};
    Vec3 scaling{1, 1, 1};
    Vec3 color{};
    double ka = 0;
    double kd = 0;
    double ks = 0;
    double kr = 0;
    double exponent = 0;
    bool operator==(const Sphere &) const = default;
};

// A point without falloff. Intensities may be negative.
struct Light {
    std::string name;
    Vec3 position{};
    Vec3 intensity{};
    bool operator==(const Light &) const = default;
};

struct Scene {
    View view;
    std::vector<Sphere> spheres;
    std::vector<Light> lights;
    Vec3 background{};
    Vec3 ambient{};
    std::string output = "image.ppm";
    bool operator==(const Scene &) const = default;

    // Indices of the spheres that exist: of spheres with equal centre and equal |scaling| the first in the file.
    std::vector<std::size_t> distinct() const;
};

// One thing that is wrong. line and column count from 1, columns in bytes; both are 0 where there is no place in a file
// (a Scene made in code). All texts are printable UTF-8, whatever was in the file.
struct Diagnostic {
    std::int64_t line = 0;
    std::int64_t column = 0;
    std::string field;    // the field's name, for example "SPHERE", "" where there is none
    std::string message;  // one sentence: what was found and what was expected
    std::string hint;     // what to do, "" where there is nothing to say
    bool operator==(const Diagnostic &) const = default;
};

struct ParseResult {
    Scene scene;                       // meaningful only when errors is empty
    std::vector<Diagnostic> errors;    // in file order; the first 100, then one that counts the rest
    std::vector<Diagnostic> warnings;  // duplicate spheres, where there are no errors; counted like errors
};

// Reads a scene. limits: five spheres, five lights, 100 000 columns and rows; the ranges of numbers hold always.
ParseResult parse(std::string_view text, bool limits = true);

// The violations of a Scene made in code, in the words of the parser, with line = column = 0.
std::vector<Diagnostic> check(const Scene &scene, bool limits = true);

// The duplicate spheres of a Scene made in code.
std::vector<Diagnostic> warnings(const Scene &scene);

// Why a valid scene cannot be rendered in float32 (magnitudes outside 1e-15 .. 1e15); empty when it can.
std::vector<Diagnostic> check_float32(const Scene &scene);

// The canonical text: shortest decimals that read back to the same float64, LF line ends. A zero has no sign.
std::string text(const Scene &scene);

// "source:line:column: error: message", and on a line of its own "  hint: ..." where there is one.
std::string describe(const Diagnostic &diagnostic, std::string_view source, std::string_view severity = "error");

}  // namespace whitted
