// Words of messages: UTF-8, quotes, lists, and how far two words are apart.
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>

namespace whitted {

template <class... Parts>
std::string join(const Parts &...parts) {
    std::string joined;
    (joined.append(parts), ...);
    return joined;
}

struct Character {
    char32_t code = 0;
    std::size_t length = 1;
    bool valid = false;  // false: a byte that is not UTF-8
};

// The UTF-8 character that starts at an index, which must be inside the text.
Character character_at(std::string_view text, std::size_t index);

// Neither control characters nor blanks nor what changes the direction of a terminal's text.
bool printable(char32_t code);

// Text with everything that cannot be shown written as \xff, byte by byte.
std::string escaped(std::string_view text);

// A piece of a file in quotes; a long one is cut.
std::string quoted(std::string_view text);

// "'a'", "'a' and 'b'", "'a', 'b' and 'c'".
std::string listed(std::span<const std::string> items);

std::string replaced(std::string_view text, std::string_view from, std::string_view to);

// ASCII only.
std::string upper(std::string_view text);

constexpr bool is_digit(char character) { return character >= '0' && character <= '9'; }

// The number of insertions, deletions, replacements and swaps of neighbours between two short words.
std::size_t edit_distance(std::string_view a, std::string_view b);

}  // namespace whitted
