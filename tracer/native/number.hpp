// The syntax of numbers in scene files and on the command line.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <string_view>

namespace whitted {

constexpr std::int64_t largest_integer = std::numeric_limits<std::int64_t>::max();

// A number in the syntax of scene files, read as the nearest float64. A zero has no sign.
struct Number {
    double value = 0;        // infinite on overflow
    bool valid = false;      // false: not in that syntax, for example "1.5x", "0x1", "nan"
    bool underflow = false;  // it is not 0, but the nearest float64 is
};
Number parse_number(std::string_view token);

// An integer without a minus sign, or nothing; largest_integer when it is larger.
std::optional<std::int64_t> parse_size(std::string_view token);

// The length of the longest beginning of a text that is a number; 0: there is none.
std::size_t number_length(std::string_view text);

bool is_number(std::string_view text);

// The shortest decimal that reads back to the same float64; also "inf" and "nan".
std::string decimal(double value);

}  // namespace whitted
