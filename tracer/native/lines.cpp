// Splits a scene file into lines, and lines into tokens.
#include "lines.hpp"

#include <algorithm>

namespace whitted {
namespace {

constexpr bool is_blank(char character) { return character == ' ' || character == '\t'; }

void split(std::string_view text, std::int64_t first_column, Line &line) {
    line.tokens.clear();
    line.count = 0;
    line.end = first_column;
    for (std::size_t index = 0; index < text.size();) {
        if (is_blank(text[index])) {
            ++index;
            continue;
        }
        const std::size_t start = index;
        while (index < text.size() && !is_blank(text[index])) {
            ++index;
        }
        ++line.count;
        line.end = static_cast<std::int64_t>(index) + first_column;
        if (line.tokens.size() < Line::most_tokens) {
            line.tokens.push_back({text.substr(start, index - start), static_cast<std::int64_t>(start) + first_column});
        }
    }
}

}  // namespace

bool LineReader::next(Line &line) {
    if (position_ >= text_.size()) {
        return false;
    }
    const std::size_t end = std::min(text_.find_first_of("\n\r", position_), text_.size());
    const std::size_t skipped = line.number == 0 ? position_ : 0;
    ++line.number;
    split(text_.substr(position_, end - position_), static_cast<std::int64_t>(skipped) + 1, line);
    position_ = end + (text_.substr(end, 2) == "\r\n" ? 2 : 1);
    return true;
}

}  // namespace whitted
