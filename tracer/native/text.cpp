// Words of messages: UTF-8, quotes, lists, and how far two words are apart.
#include "text.hpp"

#include <algorithm>
#include <iterator>
#include <numeric>
#include <vector>

namespace whitted {

Character character_at(std::string_view text, std::size_t index) {
    const auto byte = [&](std::size_t offset) { return static_cast<unsigned char>(text[index + offset]); };
    const unsigned char first = byte(0);
    if (first < 0x80) {
        return {first, 1, true};
    }
    const std::size_t length = first >= 0xf0 ? 4 : first >= 0xe0 ? 3 : 2;
    if (first < 0xc2 || first > 0xf4 || text.size() - index < length) {
        return {};
    }
    char32_t code = first & (0x7fU >> length);
    for (std::size_t offset = 1; offset < length; ++offset) {
        if ((byte(offset) & 0xc0) != 0x80) {
            return {};
        }
        code = (code << 6) | (byte(offset) & 0x3fU);
    }
    // Overlong forms, surrogates, and what lies beyond Unicode.
    constexpr char32_t least[] = {0, 0, 0x80, 0x800, 0x10000};
    if (code < least[length] || (code >= 0xd800 && code <= 0xdfff) || code > 0x10ffff) {
        return {};
    }
    return {code, length, true};
}

bool printable(char32_t code) {
    struct Range {
        char32_t first, last;
    };
    constexpr Range hidden[] = {{0x00, 0x20},     {0x7f, 0xa0},     {0xad, 0xad},     {0x1680, 0x1680},
                                {0x180e, 0x180e}, {0x2000, 0x200f}, {0x2028, 0x202f}, {0x205f, 0x206f},
                                {0x3000, 0x3000}, {0xfeff, 0xfeff}, {0xfff9, 0xfffb}, {0xe0000, 0xe007f}};
    return std::none_of(std::begin(hidden), std::end(hidden),
                        [&](const Range &range) { return range.first <= code && code <= range.last; });
}

std::string escaped(std::string_view text) {
    constexpr char digits[] = "0123456789abcdef";
    std::string shown;
    for (std::size_t index = 0; index < text.size();) {
        const Character character = character_at(text, index);
        const std::string_view bytes = text.substr(index, character.length);
        if (character.valid && (printable(character.code) || character.code == ' ')) {
            shown.append(bytes);
        } else {
            for (const char byte : bytes) {
                const auto value = static_cast<unsigned char>(byte);
                shown.append({'\\', 'x', digits[value >> 4], digits[value & 15]});
            }
        }
        index += character.length;
    }
    return shown;
}

std::string quoted(std::string_view text) {
    constexpr std::size_t longest = 60;
    constexpr std::size_t kept = 40;
    if (text.size() <= longest) {
        return join("'", escaped(text), "'");
    }
    std::size_t end = 0;
    while (end < kept) {
        end += character_at(text, end).length;
    }
    return join("'", escaped(text.substr(0, end)), "...' (", std::to_string(text.size()), " bytes)");
}

std::string listed(std::span<const std::string> items) {
    std::string list;
    for (std::size_t index = 0; index < items.size(); ++index) {
        list.append(index == 0 ? "" : index + 1 == items.size() ? " and " : ", ");
        list.append(quoted(items[index]));
    }
    return list;
}

std::string replaced(std::string_view text, std::string_view from, std::string_view to) {
    std::string result;
    for (std::size_t at = text.find(from); at != std::string_view::npos; at = text.find(from)) {
        result.append(text.substr(0, at)).append(to);
        text.remove_prefix(at + from.size());
    }
    return result.append(text);
}

std::string upper(std::string_view text) {
    std::string result(text);
    for (char &character : result) {
        if (character >= 'a' && character <= 'z') {
            character = static_cast<char>(character - 'a' + 'A');
        }
    }
    return result;
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
    std::vector<std::size_t> before(b.size() + 1), last(b.size() + 1), row(b.size() + 1);
    std::iota(last.begin(), last.end(), std::size_t{0});
    for (std::size_t i = 1; i <= a.size(); ++i) {
        row[0] = i;
        for (std::size_t j = 1; j <= b.size(); ++j) {
            const std::size_t change = a[i - 1] == b[j - 1] ? 0 : 1;
            row[j] = std::min({last[j] + 1, row[j - 1] + 1, last[j - 1] + change});
            if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1]) {
                row[j] = std::min(row[j], before[j - 2] + 1);
            }
        }
        before.swap(last);
        last.swap(row);
    }
    return last[b.size()];
}

}  // namespace whitted
