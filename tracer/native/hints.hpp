// What was likely meant by something wrong in a scene file. Every hint is "" where nothing comes to mind.
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "format.hpp"
#include "lines.hpp"

namespace whitted {

std::string did_you_mean(std::string_view text);

// What likely happened to a word with characters that do not belong into a text of ASCII blanks.
std::string strange_hint(std::string_view word);

// What was likely meant by a token that is not a number.
std::string number_hint(std::string_view token);

// What was likely meant by a token that is not a size.
std::string size_hint(std::string_view token);

// What is likely wrong with a field of too few or too many parameters.
std::string missing_hint(const Field &field, std::span<const Token> given);
std::string surplus_hint(const Field &field, std::span<const Token> given);

// Comments of other languages; scene files have none.
bool is_comment(std::string_view token);

}  // namespace whitted
