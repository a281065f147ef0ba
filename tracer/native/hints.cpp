// What was likely meant by something wrong in a scene file.
#include "hints.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "number.hpp"
#include "text.hpp"

namespace whitted {

std::string did_you_mean(std::string_view text) { return join("did you mean ", quoted(text), "?"); }

std::string strange_hint(std::string_view word) {
    if (word.find('\0') != std::string_view::npos) {
        return "the file is binary or UTF-16: save it as UTF-8";
    }
    for (std::size_t index = 0; index < word.size();) {
        const Character character = character_at(word, index);
        const char32_t code = character.code;
        if (character.valid && (code == 0x0b || code == 0x0c || code == 0x85 || code == 0xa0 || code == 0x1680 ||
                                (code >= 0x2000 && code <= 0x200a) || code == 0x2028 || code == 0x2029 ||
                                code == 0x202f || code == 0x205f || code == 0x3000)) {
            return "only spaces and tabs separate parameters";
        }
        index += character.length;
    }
    return "";
}

std::string number_hint(std::string_view token) {
    if (token.size() > 100) {
        return "";
    }
    if (std::string hint = strange_hint(token); !hint.empty()) {
        return hint;
    }
    const std::string plain = upper(token);
    const std::string_view word = std::string_view(plain).substr(plain[0] == '+' || plain[0] == '-' ? 1 : 0);
    if (word == "NAN" || word == "INF" || word == "INFINITY") {
        return "every number is finite";
    }
    if (word.starts_with("0X")) {
        return "numbers are decimal";
    }
    if (token.ends_with(',') && is_number(token.substr(0, token.size() - 1))) {
        return join("parameters are separated by blanks: ", did_you_mean(token.substr(0, token.size() - 1)));
    }
    if (std::count(token.begin(), token.end(), ',') == 1) {
        const std::string pointed = replaced(token, ",", ".");
        return is_number(pointed) ? did_you_mean(pointed) : "";
    }
    constexpr std::string_view corrections[][2] = {
        {"\xe2\x88\x92", "-"}, {"O", "0"}, {"o", "0"}, {"d", "e"}, {"D", "e"}, {"_", ""}, {"'", ""}, {"\"", ""}};
    for (const auto &[wrong, right] : corrections) {
        const std::string corrected = replaced(token, wrong, right);
        if (corrected != token && is_number(corrected)) {
            return did_you_mean(corrected);
        }
    }
    const std::size_t length = number_length(token);
    const std::string_view rest = token.substr(length);
    const bool garbage =
        std::none_of(rest.begin(), rest.end(), [](char character) { return is_digit(character) || character == '.'; });
    return length > 0 && garbage ? did_you_mean(token.substr(0, length)) : "";
}

std::string size_hint(std::string_view token) {
    const Number number = parse_number(token);
    if (number.valid && number.value >= 1 && number.value <= 1e15 && std::trunc(number.value) == number.value) {
        return did_you_mean(std::to_string(static_cast<std::int64_t>(number.value)));
    }
    if (number.valid) {
        return "";
    }
    if (token.find(',') != std::string_view::npos) {
        // Thousands, but not fractions.
        const std::string grouped = replaced(token, ",", "");
        return token.size() <= 30 && token.rfind(',') + 4 == token.size() && parse_size(grouped) ? did_you_mean(grouped)
                                                                                                 : "";
    }
    return number_hint(token);
}

std::string missing_hint(const Field &field, std::span<const Token> given) {
    for (const Token &token : given) {
        if (is_comment(token.text)) {
            return "scene files have no comments";
        }
        if (std::string hint = strange_hint(token.text); !hint.empty()) {
            return hint;
        }
    }
    for (const Token &token : given) {
        if (token.text.find(',') != std::string_view::npos) {
            return "parameters are separated by blanks, not commas";
        }
    }
    if (&field == &fields[RES] && given.size() == 1) {
        for (const std::string_view sign : {"x", "X", "*", "\xc3\x97"}) {
            const std::string separated = replaced(given[0].text, sign, " ");
            const std::size_t blank = separated.find(' ');
            if (blank != std::string::npos && parse_size(std::string_view(separated).substr(0, blank)) &&
                parse_size(std::string_view(separated).substr(blank + 1))) {
                return did_you_mean(join("RES ", separated));
            }
        }
    }
    return "";
}

std::string surplus_hint(const Field &field, std::span<const Token> given) {
    const std::size_t expected = field.parameters.size();
    for (const Token &token : given) {
        if (is_comment(token.text)) {
            return "scene files have no comments";
        }
        if (token.text == ",") {
            return "parameters are separated by blanks, not commas";
        }
    }
    if (find_field(given[expected].text) != nullptr) {
        return "every field has a line of its own";
    }
    if (is_text(field.parameters[0].kind)) {
        // Blanks in a name: as many words too many as there are before the numbers.
        const std::size_t words = given.size() - expected + 1;
        const bool numbers = std::all_of(given.begin() + static_cast<std::ptrdiff_t>(words), given.end(),
                                         [](const Token &token) { return is_number(token.text); });
        if (given.size() + 1 < Line::most_tokens && numbers &&
            (field.parameters[0].kind == Kind::file || !is_number(given[1].text))) {
            std::string name(given[0].text);
            for (const Token &token : given.subspan(1, words - 1)) {
                name.append("_").append(token.text);
            }
            return join("names have no blanks", name.size() <= 60 ? ": " + did_you_mean(name) : "");
        }
    }
    return "";
}

bool is_comment(std::string_view token) { return token.starts_with('#') || token.starts_with("//"); }

}  // namespace whitted
