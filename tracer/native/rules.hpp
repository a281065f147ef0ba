// The rules for single values and their wording, which the parser and the check of Scenes made in code share.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "format.hpp"
#include "scene.hpp"

namespace whitted {

constexpr std::string_view limit_hint = "--no-limits lifts this limit (limits=False in Python)";

// What is wrong with a value: what was expected instead, and a hint.
struct Fault {
    std::string expected;
    std::string hint;
};

std::optional<Fault> fault_of_number(Kind kind, double value);
std::optional<Fault> fault_of_text(Kind kind, std::string_view value);
std::optional<Fault> fault_of_size(std::int64_t value, bool limits);

// `object` says which of several in a Scene made in code, for example " of spheres[2]".
std::string found_message(std::string_view field, const Parameter &parameter, std::string_view value,
                          std::string_view object, std::string_view expected);

std::string order_message(FieldIndex low, double low_value, FieldIndex high, double high_value);
std::string order_hint(double low_value, double high_value);

bool too_many_pixels(std::int64_t columns, std::int64_t rows);
std::string pixels_message(std::int64_t columns, std::int64_t rows);
std::string count_message(std::size_t count, std::string_view objects);

// Collects diagnostics: the first of them in order of place, and how many there are.
class Report {
  public:
    void add(Diagnostic diagnostic);

    // For what is known only at the end but has a place further up; there are few of these.
    void add_late(Diagnostic diagnostic);

    std::vector<Diagnostic> finish();

  private:
    std::vector<Diagnostic> reported_, late_;
    std::int64_t count_ = 0;
};

struct Place {
    std::int64_t line = 0;
    std::int64_t column = 0;
};

// For every sphere the index of the first one with the same centre and the same |scaling|: itself, where it exists.
std::vector<std::size_t> first_equals(const std::vector<Sphere> &spheres);

// places: of the spheres in the file, or empty.
std::vector<Diagnostic> duplicate_warnings(const Scene &scene, std::span<const Place> places);

}  // namespace whitted
