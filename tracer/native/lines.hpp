// Splits a scene file into lines, and lines into tokens.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

namespace whitted {

constexpr std::string_view byte_order_mark = "\xef\xbb\xbf";

struct Token {
    std::string_view text;
    std::int64_t column = 0;
};

struct Line {
    std::int64_t number = 0;
    std::vector<Token> tokens;  // the first of them; no field has this many
    std::size_t count = 0;      // of all tokens
    std::int64_t end = 1;       // the column behind the last token
    static constexpr std::size_t most_tokens = 32;
};

class LineReader {
  public:
    // Skips a byte-order mark.
    explicit LineReader(std::string_view text)
        : text_(text), position_(text.starts_with(byte_order_mark) ? byte_order_mark.size() : 0) {}

    // Reads the next line into `line`, which holds the one before; false, and nothing changes, at the end of the file.
    bool next(Line &line);

  private:
    std::string_view text_;
    std::size_t position_;
};

}  // namespace whitted
