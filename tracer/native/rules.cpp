// What a value of a scene may be, what is said when it is not, and which spheres are duplicates.
#include "rules.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <iterator>
#include <numeric>
#include <utility>

#include "hints.hpp"
#include "number.hpp"
#include "text.hpp"

namespace whitted {
namespace {

constexpr double smallest_magnitude = 1e-100;
constexpr double largest_magnitude = 1e100;
constexpr std::int64_t most_reported = 100;

std::string shown_name(Kind kind, std::string_view name) {
    const bool counted = kind == Kind::name && name.size() > longest_name && name.size() <= 60;
    return counted ? join(quoted(name), " (", std::to_string(name.size()), " bytes)") : quoted(name);
}

}  // namespace

std::optional<Fault> fault_of_number(Kind kind, double value) {
    const double magnitude = std::abs(value);
    const bool in_range = magnitude >= smallest_magnitude && magnitude <= largest_magnitude;
    switch (kind) {
        case Kind::distance:
            if (!(value > 0)) {
                return Fault{"a number above 0",
                             value < 0 && in_range
                                 ? join("the image plane lies at z = -NEAR: did you mean '", decimal(magnitude), "'?")
                                 : ""};
            }
            return in_range ? std::nullopt : std::optional(Fault{"a magnitude from 1e-100 to 1e100", ""});
        case Kind::coordinate:
            return in_range || value == 0 ? std::nullopt
                                          : std::optional(Fault{"0 or a magnitude from 1e-100 to 1e100", ""});
        case Kind::scaling:
            if (value == 0) {
                return Fault{"a number other than 0", "a disc is a sphere with one small scaling, such as 0.001"};
            }
            return in_range ? std::nullopt : std::optional(Fault{"a magnitude from 1e-100 to 1e100", ""});
        case Kind::color:
        case Kind::fraction:
            if (value >= 0 && value <= 1) {
                return std::nullopt;
            }
            return Fault{"a number from 0 to 1", kind == Kind::color && value >= 2 && value <= 255
                                                     ? "colours run from 0 to 1: divide 8-bit values by 255"
                                                     : ""};
        case Kind::exponent:
            return value >= 0 && std::isfinite(value) ? std::nullopt
                                                      : std::optional(Fault{"a finite number of at least 0", ""});
        case Kind::finite:
            return std::isfinite(value) ? std::nullopt : std::optional(Fault{"a finite number", ""});
        case Kind::name:
        case Kind::file:
        case Kind::size:
            break;
    }
    return std::nullopt;
}

std::optional<Fault> fault_of_text(Kind kind, std::string_view value) {
    bool shows = !value.empty();
    for (std::size_t index = 0; index < value.size();) {
        const Character character = character_at(value, index);
        if (!character.valid) {
            return Fault{"UTF-8 text", "save the file as UTF-8"};
        }
        shows = shows && printable(character.code);
        index += character.length;
    }
    if (!shows) {
        return Fault{"printable characters without blanks", strange_hint(value)};
    }
    if (kind == Kind::name && value.size() > longest_name) {
        return Fault{join("at most ", std::to_string(longest_name), " bytes"), ""};
    }
    return std::nullopt;
}

std::optional<Fault> fault_of_size(std::int64_t value, bool limits) {
    if (value < 1) {
        return Fault{"an integer of at least 1", ""};
    }
    if (limits && value > longest_side) {
        return Fault{join("at most ", std::to_string(longest_side)), std::string(limit_hint)};
    }
    if (value == largest_integer) {
        return Fault{"an integer below 2^63 - 1", ""};
    }
    return std::nullopt;
}

std::string found_message(std::string_view field, const Parameter &parameter, std::string_view value,
                          std::string_view object, std::string_view expected) {
    return join(field, ": found ", shown_name(parameter.kind, value), " for '", parameter.name, "'", object,
                ", expected ", expected);
}

std::string order_message(FieldIndex low, double low_value, FieldIndex high, double high_value) {
    return join(fields[low].name, " is ", decimal(low_value), " and ", fields[high].name, " is ", decimal(high_value),
                ", expected ", fields[low].name, " < ", fields[high].name);
}

std::string order_hint(double low_value, double high_value) {
    return low_value > high_value ? "swap the two numbers" : "an image has a width and a height";
}

bool too_many_pixels(std::int64_t columns, std::int64_t rows) { return columns > largest_integer / rows; }

std::string pixels_message(std::int64_t columns, std::int64_t rows) {
    return join("RES: found ", std::to_string(columns), " x ", std::to_string(rows),
                " pixels, expected a number of pixels that 64 bits can count");
}

std::string count_message(std::size_t count, std::string_view objects) {
    return join("found ", std::to_string(count), " ", objects, ", expected at most ", std::to_string(most_objects));
}

void Report::add(Diagnostic diagnostic) {
    ++count_;
    if (count_ <= most_reported) {
        reported_.push_back(std::move(diagnostic));
    }
}

void Report::add_late(Diagnostic diagnostic) {
    ++count_;
    late_.push_back(std::move(diagnostic));
}

std::vector<Diagnostic> Report::finish() {
    std::move(late_.begin(), late_.end(), std::back_inserter(reported_));
    std::stable_sort(reported_.begin(), reported_.end(), [](const Diagnostic &a, const Diagnostic &b) {
        return a.line != b.line ? a.line < b.line : a.column < b.column;
    });
    if (count_ > most_reported) {
        reported_.resize(most_reported);
        const std::int64_t rest = count_ - most_reported;
        reported_.push_back({0, 0, "", join("and ", std::to_string(rest), " more"), ""});
    }
    return std::move(reported_);
}

std::vector<std::size_t> first_equals(const std::vector<Sphere> &spheres) {
    // Bit patterns, because they have a total order whatever the values; + 0.0 makes both zeros the same.
    const auto key = [&](std::size_t index) {
        const Sphere &sphere = spheres[index];
        std::array<std::uint64_t, 6> bits{};
        for (std::size_t axis = 0; axis < 3; ++axis) {
            bits[axis] = std::bit_cast<std::uint64_t>(sphere.position[axis] + 0.0);
            bits[axis + 3] = std::bit_cast<std::uint64_t>(std::abs(sphere.scaling[axis]));
        }
        return bits;
    };
    std::vector<std::size_t> order(spheres.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return key(a) < key(b); });
    std::vector<std::size_t> firsts(spheres.size());
    for (std::size_t rank = 0; rank < order.size(); ++rank) {
        const bool repeated = rank > 0 && key(order[rank - 1]) == key(order[rank]);
        firsts[order[rank]] = repeated ? firsts[order[rank - 1]] : order[rank];
    }
    return firsts;
}

std::vector<Diagnostic> duplicate_warnings(const Scene &scene, std::span<const Place> places) {
    const std::vector<std::size_t> firsts = first_equals(scene.spheres);
    Report report;
    for (std::size_t index = 0; index < firsts.size(); ++index) {
        const std::size_t first = firsts[index];
        if (first != index) {
            const Place place = places.empty() ? Place{} : places[index];
            const std::string where = places.empty() ? join("spheres[", std::to_string(first), "]")
                                                     : join(quoted(scene.spheres[first].name), " on line ",
                                                            std::to_string(places[first].line));
            report.add({place.line, place.column, std::string(fields[SPHERE].name),
                        join(quoted(scene.spheres[index].name), " has the centre and the scaling of ", where,
                             " and is ignored"),
                        ""});
        }
    }
    return report.finish();
}

}  // namespace whitted
