// Reads numbers exactly, however long they are, and writes the shortest decimals.
#include "number.hpp"

#include <charconv>
#include <cmath>
#include <iterator>
#include <system_error>

#include "text.hpp"

namespace whitted {
namespace {

// The parts of [+-]?(digits[.digits*] | .digits)([eE][+-]?digits)?, as far as a text follows it.
struct Syntax {
    std::string_view whole, fraction, exponent;
    bool negative = false;
    bool negative_exponent = false;
    std::size_t length = 0;  // of the longest beginning that is a number; 0: there is none
};

Syntax scan(std::string_view text) {
    Syntax syntax;
    std::size_t index = 0;
    const auto digits = [&] {
        const std::size_t start = index;
        while (index < text.size() && is_digit(text[index])) {
            ++index;
        }
        return text.substr(start, index - start);
    };
    const auto sign = [&] {
        const bool found = index < text.size() && (text[index] == '+' || text[index] == '-');
        return found && text[index++] == '-';
    };
    syntax.negative = sign();
    syntax.whole = digits();
    if (index < text.size() && text[index] == '.' &&
        (!syntax.whole.empty() || (index + 1 < text.size() && is_digit(text[index + 1])))) {
        ++index;
        syntax.fraction = digits();
    }
    if (syntax.whole.empty() && syntax.fraction.empty()) {
        return syntax;
    }
    syntax.length = index;
    if (index < text.size() && (text[index] == 'e' || text[index] == 'E')) {
        ++index;
        syntax.negative_exponent = sign();
        syntax.exponent = digits();
        if (!syntax.exponent.empty()) {
            syntax.length = index;
        }
    }
    return syntax;
}

// The magnitude of a number of any length. from_chars alone will not do: it says "out of range" to overflow and
// underflow alike, and implementations give up on exponents that hundreds of thousands of digits before or behind the
// point undo.
Number exact_magnitude(const Syntax &syntax) {
    // More than 767 significant digits only matter by whether they are all 0: halfway points have no more.
    constexpr std::size_t most_digits = 800;
    std::string digits;
    std::int64_t scale = 0;  // the value is digits * 10^scale
    bool rest = false;
    const auto take = [&](std::string_view part, bool behind_point) {
        for (const char digit : part) {
            if (digits.size() < most_digits && (digit != '0' || !digits.empty())) {
                digits.push_back(digit);
                scale -= behind_point ? 1 : 0;
            } else if (digits.empty()) {
                scale -= behind_point ? 1 : 0;
            } else {
                rest = rest || digit != '0';
                scale += behind_point ? 0 : 1;
            }
        }
    };
    take(syntax.whole, false);
    take(syntax.fraction, true);
    if (digits.empty()) {
        return {0, true, false};
    }
    if (rest) {
        digits.push_back('1');
        scale -= 1;
    }
    std::int64_t exponent = 0;
    for (const char digit : syntax.exponent) {
        // No text is long enough for its digits to undo an exponent of 10^17.
        if (exponent < 100'000'000'000'000'000) {
            exponent = exponent * 10 + (digit - '0');
        }
    }
    scale += syntax.negative_exponent ? -exponent : exponent;
    const std::int64_t leading = scale + static_cast<std::int64_t>(digits.size());
    const Number overflow{std::numeric_limits<double>::infinity(), true, false};
    const Number underflow{0, true, true};
    if (leading > 400) {
        return overflow;
    }
    if (leading < -400) {
        return underflow;
    }
    digits.append("e").append(std::to_string(scale));
    Number number{0, true, false};
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), number.value);
    if (error == std::errc::result_out_of_range) {
        return leading > 0 ? overflow : underflow;
    }
    number.underflow = number.value == 0;
    return number;
}

}  // namespace

Number parse_number(std::string_view token) {
    const Syntax syntax = scan(token);
    if (syntax.length == 0 || syntax.length != token.size()) {
        return {};
    }
    Number number{0, true, false};
    const std::string_view unsigned_text = token.substr(token[0] == '+' || token[0] == '-' ? 1 : 0);
    const char *end = unsigned_text.data() + unsigned_text.size();
    const auto [stop, error] = std::from_chars(unsigned_text.data(), end, number.value);
    if (token.size() > 60 || error != std::errc() || stop != end || number.value == 0) {
        number = exact_magnitude(syntax);
    }
    if (syntax.negative && number.value != 0) {
        number.value = -number.value;
    }
    return number;
}

std::optional<std::int64_t> parse_size(std::string_view token) {
    const std::size_t start = !token.empty() && token[0] == '+' ? 1 : 0;
    if (start == token.size()) {
        return std::nullopt;
    }
    std::int64_t value = 0;
    for (const char digit : token.substr(start)) {
        if (!is_digit(digit)) {
            return std::nullopt;
        }
        value = value > (largest_integer - (digit - '0')) / 10 ? largest_integer : value * 10 + (digit - '0');
    }
    return value;
}

std::size_t number_length(std::string_view text) { return scan(text).length; }

bool is_number(std::string_view text) { return !text.empty() && number_length(text) == text.size(); }

std::string decimal(double value) {
    char buffer[32];
    const auto [end, error] = std::to_chars(std::begin(buffer), std::end(buffer), value == 0 ? 0.0 : value);
    return error == std::errc() ? std::string(buffer, end) : std::string();
}

}  // namespace whitted
