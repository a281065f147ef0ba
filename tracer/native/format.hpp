// The table of the scene format: fields, their parameters, and the limits.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace whitted {

constexpr std::size_t longest_name = 20;
constexpr std::int64_t most_objects = 5;
constexpr std::int64_t longest_side = 100'000;

enum class Kind {
    name,        // printable, at most 20 bytes
    file,        // printable
    size,        // integer >= 1
    distance,    // > 0, in the range of magnitudes
    coordinate,  // 0 or in the range of magnitudes; intensities too
    scaling,     // not 0, in the range of magnitudes
    color,       // in [0, 1]
    fraction,    // in [0, 1]
    exponent,    // >= 0
    finite,
};

constexpr bool is_text(Kind kind) { return kind == Kind::name || kind == Kind::file; }

struct Parameter {
    std::string_view name;
    Kind kind;
};

inline constexpr Parameter near_parameters[] = {{"n", Kind::distance}};
inline constexpr Parameter left_parameters[] = {{"l", Kind::coordinate}};
inline constexpr Parameter right_parameters[] = {{"r", Kind::coordinate}};
inline constexpr Parameter bottom_parameters[] = {{"b", Kind::coordinate}};
inline constexpr Parameter top_parameters[] = {{"t", Kind::coordinate}};
inline constexpr Parameter resolution_parameters[] = {{"columns", Kind::size}, {"rows", Kind::size}};
inline constexpr Parameter sphere_parameters[] = {
    {"name", Kind::name},     {"pos x", Kind::coordinate}, {"pos y", Kind::coordinate}, {"pos z", Kind::coordinate},
    {"scl x", Kind::scaling}, {"scl y", Kind::scaling},    {"scl z", Kind::scaling},    {"r", Kind::color},
    {"g", Kind::color},       {"b", Kind::color},          {"Ka", Kind::fraction},      {"Kd", Kind::fraction},
    {"Ks", Kind::fraction},   {"Kr", Kind::fraction},      {"n", Kind::exponent}};
inline constexpr Parameter light_parameters[] = {
    {"name", Kind::name},     {"pos x", Kind::coordinate}, {"pos y", Kind::coordinate}, {"pos z", Kind::coordinate},
    {"Ir", Kind::coordinate}, {"Ig", Kind::coordinate},    {"Ib", Kind::coordinate}};
inline constexpr Parameter background_parameters[] = {{"r", Kind::finite}, {"g", Kind::finite}, {"b", Kind::finite}};
inline constexpr Parameter ambient_parameters[] = {
    {"Ir", Kind::coordinate}, {"Ig", Kind::coordinate}, {"Ib", Kind::coordinate}};
inline constexpr Parameter output_parameters[] = {{"file name", Kind::file}};

struct Field {
    std::string_view name;
    std::span<const Parameter> parameters;
    bool repeated = false;
};

enum FieldIndex : std::size_t { NEAR, LEFT, RIGHT, BOTTOM, TOP, RES, SPHERE, LIGHT, BACK, AMBIENT, OUTPUT };

// In the order of FieldIndex, which is the order of the canonical text.
inline constexpr std::array<Field, 11> fields = {{
    {"NEAR", near_parameters},
    {"LEFT", left_parameters},
    {"RIGHT", right_parameters},
    {"BOTTOM", bottom_parameters},
    {"TOP", top_parameters},
    {"RES", resolution_parameters},
    {"SPHERE", sphere_parameters, true},
    {"LIGHT", light_parameters, true},
    {"BACK", background_parameters},
    {"AMBIENT", ambient_parameters},
    {"OUTPUT", output_parameters},
}};

// The field of this very name, or null.
const Field *find_field(std::string_view name);

// The field that an unknown word may stand for, or null.
const Field *nearest_field(std::string_view word);

// A line of this field, with placeholders: "NEAR <n>".
std::string usage(const Field &field);

}  // namespace whitted
