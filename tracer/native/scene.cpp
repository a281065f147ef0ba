// Reads, checks and writes scenes. One table describes the format; the parser and the check of Scenes made in code
// share it, and the wording of every error.
#include "scene.hpp"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <iterator>
#include <limits>
#include <numeric>
#include <optional>
#include <span>
#include <system_error>
#include <utility>

namespace whitted {
namespace {

constexpr double smallest_magnitude = 1e-100;
constexpr double largest_magnitude = 1e100;
constexpr double smallest_float32 = 1e-15;
constexpr double largest_float32 = 1e15;
constexpr std::size_t longest_name = 20;
constexpr std::int64_t most_objects = 5;
constexpr std::int64_t longest_side = 100'000;
constexpr std::int64_t most_reported = 100;
constexpr std::int64_t largest_integer = std::numeric_limits<std::int64_t>::max();

constexpr std::string_view limit_hint = "--no-limits lifts this limit (limits=False in Python)";

// ---------------------------------------------------------------------------------------------------------------------
// The format

enum class Kind {
    name,        // printable, at most 20 bytes
    file,        // printable
    size,        // integer >= 1
    distance,    // > 0, in the range of magnitudes
    coordinate,  // 0 or in the range of magnitudes; intensities too
    scaling,     // not 0, in the range of magnitudes
    color,       // in [0, 1]
    fraction,    // in [0, 1]
    exponent,    // >= 0
    finite,
};

struct Parameter {
    std::string_view name;
    Kind kind;
};

constexpr Parameter near_parameters[] = {{"n", Kind::distance}};
constexpr Parameter left_parameters[] = {{"l", Kind::coordinate}};
constexpr Parameter right_parameters[] = {{"r", Kind::coordinate}};
constexpr Parameter bottom_parameters[] = {{"b", Kind::coordinate}};
constexpr Parameter top_parameters[] = {{"t", Kind::coordinate}};
constexpr Parameter resolution_parameters[] = {{"columns", Kind::size}, {"rows", Kind::size}};
constexpr Parameter sphere_parameters[] = {
    {"name", Kind::name},     {"pos x", Kind::coordinate}, {"pos y", Kind::coordinate}, {"pos z", Kind::coordinate},
    {"scl x", Kind::scaling}, {"scl y", Kind::scaling},    {"scl z", Kind::scaling},    {"r", Kind::color},
    {"g", Kind::color},       {"b", Kind::color},          {"Ka", Kind::fraction},      {"Kd", Kind::fraction},
    {"Ks", Kind::fraction},   {"Kr", Kind::fraction},      {"n", Kind::exponent}};
constexpr Parameter light_parameters[] = {
    {"name", Kind::name},     {"pos x", Kind::coordinate}, {"pos y", Kind::coordinate}, {"pos z", Kind::coordinate},
    {"Ir", Kind::coordinate}, {"Ig", Kind::coordinate},    {"Ib", Kind::coordinate}};
constexpr Parameter background_parameters[] = {{"r", Kind::finite}, {"g", Kind::finite}, {"b", Kind::finite}};
constexpr Parameter ambient_parameters[] = {
    {"Ir", Kind::coordinate}, {"Ig", Kind::coordinate}, {"Ib", Kind::coordinate}};
constexpr Parameter output_parameters[] = {{"file name", Kind::file}};

struct Field {
    std::string_view name;
    std::span<const Parameter> parameters;
    bool repeated = false;
};

enum FieldIndex : std::size_t { NEAR, LEFT, RIGHT, BOTTOM, TOP, RES, SPHERE, LIGHT, BACK, AMBIENT, OUTPUT };

// In the order of FieldIndex, which is the order of the canonical text.
constexpr std::array<Field, 11> fields = {{
    {"NEAR", near_parameters},
    {"LEFT", left_parameters},
    {"RIGHT", right_parameters},
    {"BOTTOM", bottom_parameters},
    {"TOP", top_parameters},
    {"RES", resolution_parameters},
    {"SPHERE", sphere_parameters, true},
    {"LIGHT", light_parameters, true},
    {"BACK", background_parameters},
    {"AMBIENT", ambient_parameters},
    {"OUTPUT", output_parameters},
}};

// ---------------------------------------------------------------------------------------------------------------------
// Text

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

// Neither control characters nor blanks nor what changes the direction of a terminal's text.
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

// What likely happened to a word with characters that do not belong into a text of ASCII blanks.
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

// Text with everything that cannot be shown written as \xff, byte by byte.
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

// A piece of a file in quotes; a long one is cut.
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

// "'a'", "'a' and 'b'", "'a', 'b' and 'c'".
std::string listed(std::span<const std::string> items) {
    std::string list;
    for (std::size_t index = 0; index < items.size(); ++index) {
        list.append(index == 0 ? "" : index + 1 == items.size() ? " and " : ", ");
        list.append(quoted(items[index]));
    }
    return list;
}

std::string_view verb(std::size_t count) { return count == 1 ? "is" : "are"; }

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

bool is_digit(char character) { return character >= '0' && character <= '9'; }

}  // namespace

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

namespace {

// ---------------------------------------------------------------------------------------------------------------------
// Numbers

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

// An integer without a minus sign, or nothing; largest_integer when it is larger.
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

bool is_number(std::string_view text) { return !text.empty() && scan(text).length == text.size(); }

std::string did_you_mean(std::string_view text) { return join("did you mean ", quoted(text), "?"); }

// What was likely meant by a token that is not a number.
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
    const std::size_t length = scan(token).length;
    const std::string_view rest = token.substr(length);
    const bool garbage =
        std::none_of(rest.begin(), rest.end(), [](char character) { return is_digit(character) || character == '.'; });
    return length > 0 && garbage ? did_you_mean(token.substr(0, length)) : "";
}

// What was likely meant by a token that is not a size.
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

// ---------------------------------------------------------------------------------------------------------------------
// Rules that the parser and check() share

// What is wrong with a value: what was expected instead, and a hint.
struct Fault {
    std::string expected;
    std::string hint;
};

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

// `object` says which of several in a Scene made in code, for example " of spheres[2]".
std::string found_message(std::string_view field, std::string_view shown, std::string_view parameter,
                          std::string_view object, std::string_view expected) {
    return join(field, ": found ", shown, " for '", parameter, "'", object, ", expected ", expected);
}

std::string shown_name(Kind kind, std::string_view name) {
    const bool counted = kind == Kind::name && name.size() > longest_name && name.size() <= 60;
    return counted ? join(quoted(name), " (", std::to_string(name.size()), " bytes)") : quoted(name);
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

// Collects diagnostics: the first of them in order of place, and how many there are.
class Report {
  public:
    void add(Diagnostic diagnostic) {
        ++count_;
        if (count_ <= most_reported) {
            reported_.push_back(std::move(diagnostic));
        }
    }

    // For what is known only at the end but has a place further up; there are few of these.
    void add_late(Diagnostic diagnostic) {
        ++count_;
        late_.push_back(std::move(diagnostic));
    }

    std::vector<Diagnostic> finish() {
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

  private:
    std::vector<Diagnostic> reported_, late_;
    std::int64_t count_ = 0;
};

struct Place {
    std::int64_t line = 0;
    std::int64_t column = 0;
};

// For every sphere the index of the first one with the same centre and the same |scaling|: itself, where it exists.
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

// places: of the spheres in the file, or empty.
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

// ---------------------------------------------------------------------------------------------------------------------
// Parser

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

const Field *find_field(std::string_view name) {
    const auto found =
        std::find_if(fields.begin(), fields.end(), [&](const Field &field) { return field.name == name; });
    return found == fields.end() ? nullptr : &*found;
}

// The field that an unknown word may stand for, or null.
const Field *nearest_field(std::string_view word) {
    if (word.size() > 30) {
        return nullptr;
    }
    const std::string plain = upper(word);
    for (const Field &field : fields) {
        if (plain.starts_with(field.name) || (plain.size() >= 3 && field.name.starts_with(plain))) {
            return &field;
        }
    }
    const Field *nearest = nullptr;
    std::size_t least = 3;
    for (const Field &field : fields) {
        const std::size_t distance = edit_distance(plain, field.name);
        if (distance < least && distance <= std::max<std::size_t>(1, field.name.size() / 3)) {
            nearest = &field;
            least = distance;
        }
    }
    return nearest;
}

bool is_comment(std::string_view token) { return token.starts_with('#') || token.starts_with("//"); }

std::string usage(const Field &field) {
    std::string line(field.name);
    for (const Parameter &parameter : field.parameters) {
        line.append(" <").append(parameter.name).append(">");
    }
    return line;
}

class Parser {
  public:
    Parser(std::string_view text, bool limits) : text_(text), limits_(limits) {}

    ParseResult run() {
        if (!refuse_encoding()) {
            read_lines();
            check_order(LEFT, scene_.view.left, RIGHT, scene_.view.right);
            check_order(BOTTOM, scene_.view.bottom, TOP, scene_.view.top);
            check_count(SPHERE, "spheres");
            check_count(LIGHT, "lights");
            check_missing();
        }
        ParseResult result;
        result.errors = report_.finish();
        if (result.errors.empty()) {
            result.warnings = duplicate_warnings(scene_, sphere_places_);
            result.scene = std::move(scene_);
        }
        return result;
    }

  private:
    // Says so once where every line would be an error; a byte-order mark of UTF-8 is an error and then skipped.
    bool refuse_encoding() {
        if (text_.starts_with("\xff\xfe") || text_.starts_with("\xfe\xff")) {
            report_.add({1, 1, "", "the file is UTF-16, expected UTF-8", "save the file as UTF-8"});
            return true;
        }
        if (text_.starts_with("\xef\xbb\xbf")) {
            report_.add({1, 1, "", "found a byte-order mark, expected a field", "save the file as UTF-8 without BOM"});
            position_ = 3;
        }
        return false;
    }

    void read_lines() {
        std::int64_t first_column = static_cast<std::int64_t>(position_) + 1;
        while (position_ < text_.size()) {
            std::size_t end = position_;
            while (end < text_.size() && text_[end] != '\n' && text_[end] != '\r') {
                ++end;
            }
            ++line_.number;
            split(text_.substr(position_, end - position_), first_column, line_);
            first_column = 1;
            if (line_.count > 0) {
                read_line();
            }
            end_ = {line_.number, line_.end};
            position_ = end < text_.size() && text_[end] == '\r' && end + 1 < text_.size() && text_[end + 1] == '\n'
                            ? end + 2
                            : end + 1;
        }
    }

    void error(const Token &token, std::string message, std::string hint = "") {
        report_.add({line_.number, token.column, std::string(field_), std::move(message), std::move(hint)});
    }

    void read_line() {
        const Token &word = line_.tokens[0];
        empty_ = false;
        const Field *field = find_field(word.text);
        if (field == nullptr) {
            unknown_field(word);
            return;
        }
        field_ = field->name;
        const auto index = static_cast<std::size_t>(field - fields.data());
        const bool first = counts_[index]++ == 0;
        if (first) {
            first_lines_[index] = line_.number;
        } else if (!field->repeated) {
            error(word, join("found ", field->name, " again, expected it once"),
                  join("it is on line ", std::to_string(first_lines_[index]), " too: keep one of the two lines"));
        }
        if (counts_[index] == most_objects + 1) {
            surplus_[index] = {line_.number, word.column};
        }
        if (line_.count - 1 != field->parameters.size()) {
            wrong_count(*field);
            return;
        }
        read_parameters(*field, static_cast<FieldIndex>(index), first);
    }

    void unknown_field(const Token &word) {
        field_ = "";
        std::string message = join("found ", quoted(word.text), ", expected the name of a field");
        if (is_comment(word.text)) {
            error(word, message, "scene files have no comments: remove the line");
        } else if (const std::string strange = strange_hint(word.text); !strange.empty()) {
            error(word, message, strange);
        } else if (is_number(word.text)) {
            error(word, message, "the parameters of a field follow its name on one line");
        } else if (const Field *field = nearest_field(word.text)) {
            const bool same = upper(word.text) == field->name;
            error(word, message, join(same ? "field names are upper case: " : "", did_you_mean(field->name)));
            // It would only be confusing to call that field missing as well.
            ++meant_[static_cast<std::size_t>(field - fields.data())];
        } else {
            std::string hint = "the fields are ";
            for (const Field &known : fields) {
                hint.append(known.name).append(&known == &fields.back() ? "" : ", ");
            }
            error(word, message, hint);
        }
    }

    void wrong_count(const Field &field) {
        const std::size_t expected = field.parameters.size();
        const std::size_t count = line_.count - 1;
        const std::span<const Token> given = std::span(line_.tokens).subspan(1);
        const std::string found =
            join(field_, ": found ", count == 0 ? "no" : std::to_string(count),
                 count == 1 ? " parameter" : " parameters", ", expected ", std::to_string(expected), ": ");
        Token place{"", line_.end};
        std::string message, hint;
        if (count > expected) {
            place = given[expected];
            message =
                join(found, quoted(place.text), count == expected + 1 ? " is" : " and what follows is", " too much");
            hint = surplus_hint(field, given);
        } else if (name_missing(field, given)) {
            message = join(found, "'name' is missing");
            hint = write_hint(field);
        } else {
            std::vector<std::string> names;
            for (const Parameter &parameter : field.parameters.subspan(count)) {
                names.emplace_back(parameter.name);
            }
            message = join(found, listed(names), " ", verb(names.size()), " missing");
            hint = missing_hint(field, given);
        }
        if (hint.empty()) {
            hint = write_hint(field);
            // Nothing says that the tokens stand in the wrong places: the numbers can be looked at.
            for (std::size_t index = 0; index < std::min(count, expected); ++index) {
                const Parameter &parameter = field.parameters[index];
                if (parameter.kind != Kind::name && parameter.kind != Kind::file && parameter.kind != Kind::size &&
                    !is_number(given[index].text)) {
                    not_a_number(parameter, given[index]);
                }
            }
        }
        error(place, std::move(message), std::move(hint));
    }

    static std::string write_hint(const Field &field) { return join("write ", usage(field)); }

    // Whether all that is missing is a name in front of the numbers.
    static bool name_missing(const Field &field, std::span<const Token> given) {
        return field.parameters[0].kind == Kind::name && given.size() + 1 == field.parameters.size() &&
               std::all_of(given.begin(), given.end(), [](const Token &token) { return is_number(token.text); });
    }

    static std::string missing_hint(const Field &field, std::span<const Token> given) {
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

    static std::string surplus_hint(const Field &field, std::span<const Token> given) {
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
        if (field.parameters[0].kind == Kind::file || field.parameters[0].kind == Kind::name) {
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

    void not_a_number(const Parameter &parameter, const Token &token) {
        error(token, found_message(field_, quoted(token.text), parameter.name, "", "a number"),
              number_hint(token.text));
    }

    std::optional<double> number(const Parameter &parameter, const Token &token) {
        const Number parsed = parse_number(token.text);
        if (!parsed.valid) {
            not_a_number(parameter, token);
            return std::nullopt;
        }
        if (const auto fault = fault_of_number(parameter.kind, parsed.value)) {
            error(token, found_message(field_, quoted(token.text), parameter.name, "", fault->expected),
                  parsed.underflow ? "it is so small that it is 0 as a float64" : fault->hint);
            return std::nullopt;
        }
        return parsed.value;
    }

    std::optional<std::int64_t> size(const Parameter &parameter, const Token &token) {
        const auto value = parse_size(token.text);
        if (!value) {
            error(token, found_message(field_, quoted(token.text), parameter.name, "", "an integer of at least 1"),
                  size_hint(token.text));
        } else if (const auto fault = fault_of_size(*value, limits_)) {
            error(token, found_message(field_, quoted(token.text), parameter.name, "", fault->expected), fault->hint);
        } else {
            return value;
        }
        return std::nullopt;
    }

    // Whether a name or file name is in order.
    bool word(const Parameter &parameter, const Token &token) {
        const auto fault = fault_of_text(parameter.kind, token.text);
        if (fault) {
            error(token,
                  found_message(field_, shown_name(parameter.kind, token.text), parameter.name, "", fault->expected),
                  fault->hint);
        }
        return !fault;
    }

    void read_parameters(const Field &field, FieldIndex index, bool first) {
        std::array<double, 15> values{};
        std::array<std::int64_t, 2> sizes{};
        bool valid = true;
        for (std::size_t i = 0; i < field.parameters.size(); ++i) {
            const Parameter &parameter = field.parameters[i];
            const Token &token = line_.tokens[i + 1];
            if (parameter.kind == Kind::name || parameter.kind == Kind::file) {
                valid = word(parameter, token) && valid;
            } else if (parameter.kind == Kind::size) {
                const auto value = size(parameter, token);
                valid = value && valid;
                sizes[i] = value.value_or(1);
            } else {
                const auto value = number(parameter, token);
                valid = value && valid;
                values[i] = value.value_or(0);
            }
        }
        if (index == RES && valid && too_many_pixels(sizes[0], sizes[1])) {
            error(line_.tokens[1], pixels_message(sizes[0], sizes[1]));
            valid = false;
        }
        if (!valid || (!first && !field.repeated)) {
            return;
        }
        places_[index] = {line_.number, line_.tokens[1].column};
        store(index, values, sizes);
    }

    void store(FieldIndex index, const std::array<double, 15> &values, const std::array<std::int64_t, 2> &sizes) {
        const auto vector = [&](std::size_t start) {
            return Vec3{values[start], values[start + 1], values[start + 2]};
        };
        const Token &first = line_.tokens[1];
        switch (index) {
            case NEAR:
                scene_.view.near_plane = values[0];
                break;
            case LEFT:
                scene_.view.left = values[0];
                break;
            case RIGHT:
                scene_.view.right = values[0];
                break;
            case BOTTOM:
                scene_.view.bottom = values[0];
                break;
            case TOP:
                scene_.view.top = values[0];
                break;
            case RES:
                scene_.view.columns = sizes[0];
                scene_.view.rows = sizes[1];
                break;
            case SPHERE:
                if (!limits_ || counts_[SPHERE] <= most_objects) {
                    scene_.spheres.push_back({std::string(first.text), vector(1), vector(4), vector(7), values[10],
                                              values[11], values[12], values[13], values[14]});
                    sphere_places_.push_back({line_.number, line_.tokens[0].column});
                }
                break;
            case LIGHT:
                if (!limits_ || counts_[LIGHT] <= most_objects) {
                    scene_.lights.push_back({std::string(first.text), vector(1), vector(4)});
                }
                break;
            case BACK:
                scene_.background = vector(0);
                break;
            case AMBIENT:
                scene_.ambient = vector(0);
                break;
            case OUTPUT:
                scene_.output = first.text;
                break;
        }
    }

    void check_order(FieldIndex low, double low_value, FieldIndex high, double high_value) {
        const Place low_place = places_[low];
        const Place high_place = places_[high];
        if (low_place.line == 0 || high_place.line == 0 || low_value < high_value) {
            return;
        }
        const FieldIndex later = low_place.line > high_place.line ? low : high;
        report_.add_late({places_[later].line, places_[later].column, std::string(fields[later].name),
                          order_message(low, low_value, high, high_value), order_hint(low_value, high_value)});
    }

    void check_count(FieldIndex index, std::string_view objects) {
        if (limits_ && counts_[index] > most_objects) {
            report_.add_late({surplus_[index].line, surplus_[index].column, std::string(fields[index].name),
                              count_message(static_cast<std::size_t>(counts_[index]), objects),
                              std::string(limit_hint)});
        }
    }

    void check_missing() {
        std::vector<std::string> missing;
        const Field *last = nullptr;
        for (std::size_t index = 0; index < fields.size(); ++index) {
            if (!fields[index].repeated && counts_[index] == 0 && meant_[index] == 0) {
                missing.emplace_back(fields[index].name);
                last = &fields[index];
            }
        }
        if (missing.empty()) {
            return;
        }
        const bool one = missing.size() == 1;
        const Place end = end_.line == 0 ? Place{1, 1} : end_;
        const std::string_view subject = empty_ ? "the file is empty: the fields " : one ? "the field " : "the fields ";
        report_.add_late({end.line, end.column, one ? missing[0] : "",
                          join(subject, listed(missing), one ? " is missing" : " are missing", ", expected once",
                               one ? "" : " each"),
                          one ? join("add a line ", usage(*last)) : ""});
    }

    std::string_view text_;
    bool limits_;
    std::size_t position_ = 0;
    Line line_;
    Place end_;
    bool empty_ = true;
    std::string_view field_;
    std::array<std::int64_t, fields.size()> counts_{};
    std::array<std::int64_t, fields.size()> meant_{};
    std::array<std::int64_t, fields.size()> first_lines_{};
    std::array<Place, fields.size()> places_{};   // of the first parameter of a field that is in order
    std::array<Place, fields.size()> surplus_{};  // of the sixth object
    std::vector<Place> sphere_places_;
    Scene scene_;
    Report report_;
};

// ---------------------------------------------------------------------------------------------------------------------
// Scenes made in code

class Checker {
  public:
    explicit Checker(bool limits) : limits_(limits) {}

    std::vector<Diagnostic> run(const Scene &scene) {
        const View &view = scene.view;
        numbers(NEAR, 0, {&view.near_plane, 1}, "");
        edges(LEFT, view.left, RIGHT, view.right);
        edges(BOTTOM, view.bottom, TOP, view.top);
        sizes(view.columns, view.rows);
        count(SPHERE, scene.spheres.size(), "spheres");
        for (std::size_t index = 0; index < scene.spheres.size(); ++index) {
            const Sphere &sphere = scene.spheres[index];
            const std::string object = join(" of spheres[", std::to_string(index), "]");
            const double coefficients[] = {sphere.ka, sphere.kd, sphere.ks, sphere.kr, sphere.exponent};
            word(SPHERE, sphere.name, object);
            numbers(SPHERE, 1, sphere.position, object);
            numbers(SPHERE, 4, sphere.scaling, object);
            numbers(SPHERE, 7, sphere.color, object);
            numbers(SPHERE, 10, coefficients, object);
        }
        count(LIGHT, scene.lights.size(), "lights");
        for (std::size_t index = 0; index < scene.lights.size(); ++index) {
            const Light &light = scene.lights[index];
            const std::string object = join(" of lights[", std::to_string(index), "]");
            word(LIGHT, light.name, object);
            numbers(LIGHT, 1, light.position, object);
            numbers(LIGHT, 4, light.intensity, object);
        }
        numbers(BACK, 0, scene.background, "");
        numbers(AMBIENT, 0, scene.ambient, "");
        word(OUTPUT, scene.output, "");
        return report_.finish();
    }

  private:
    void error(FieldIndex field, std::string message, std::string hint) {
        report_.add({0, 0, std::string(fields[field].name), std::move(message), std::move(hint)});
    }

    // The values of a field's parameters from `first` on: whether they are in order.
    bool numbers(FieldIndex field, std::size_t first, std::span<const double> values, std::string_view object) {
        bool valid = true;
        for (std::size_t index = 0; index < values.size(); ++index) {
            const Parameter &parameter = fields[field].parameters[first + index];
            if (const auto fault = fault_of_number(parameter.kind, values[index])) {
                error(field,
                      found_message(fields[field].name, quoted(decimal(values[index])), parameter.name, object,
                                    fault->expected),
                      fault->hint);
                valid = false;
            }
        }
        return valid;
    }

    void word(FieldIndex field, std::string_view value, std::string_view object) {
        const Parameter &parameter = fields[field].parameters[0];
        if (const auto fault = fault_of_text(parameter.kind, value)) {
            error(field,
                  found_message(fields[field].name, shown_name(parameter.kind, value), parameter.name, object,
                                fault->expected),
                  fault->hint);
        }
    }

    void sizes(std::int64_t columns, std::int64_t rows) {
        bool valid = true;
        for (const auto &[value, parameter] :
             {std::pair(columns, &fields[RES].parameters[0]), std::pair(rows, &fields[RES].parameters[1])}) {
            if (const auto fault = fault_of_size(value, limits_)) {
                error(RES,
                      found_message(fields[RES].name, quoted(std::to_string(value)), parameter->name, "",
                                    fault->expected),
                      fault->hint);
                valid = false;
            }
        }
        if (valid && too_many_pixels(columns, rows)) {
            error(RES, pixels_message(columns, rows), "");
        }
    }

    void edges(FieldIndex low, double low_value, FieldIndex high, double high_value) {
        const bool low_valid = numbers(low, 0, {&low_value, 1}, "");
        const bool high_valid = numbers(high, 0, {&high_value, 1}, "");
        if (low_valid && high_valid && low_value >= high_value) {
            error(high, order_message(low, low_value, high, high_value), order_hint(low_value, high_value));
        }
    }

    void count(FieldIndex field, std::size_t number, std::string_view objects) {
        if (limits_ && number > static_cast<std::size_t>(most_objects)) {
            error(field, count_message(number, objects), std::string(limit_hint));
        }
    }

    bool limits_;
    Report report_;
};

// ---------------------------------------------------------------------------------------------------------------------
// Writer

void append(std::string &text, std::span<const double> values) {
    for (const double value : values) {
        text.append(" ").append(decimal(value));
    }
}

void append_line(std::string &text, FieldIndex field, std::span<const double> values) {
    text.append(fields[field].name);
    append(text, values);
    text.append("\n");
}

}  // namespace

std::vector<std::size_t> Scene::distinct() const {
    const std::vector<std::size_t> firsts = first_equals(spheres);
    std::vector<std::size_t> indices;
    for (std::size_t index = 0; index < firsts.size(); ++index) {
        if (firsts[index] == index) {
            indices.push_back(index);
        }
    }
    return indices;
}

ParseResult parse(std::string_view text, bool limits) { return Parser(text, limits).run(); }

std::vector<Diagnostic> check(const Scene &scene, bool limits) { return Checker(limits).run(scene); }

std::vector<Diagnostic> warnings(const Scene &scene) { return duplicate_warnings(scene, {}); }

std::vector<Diagnostic> check_float32(const Scene &scene) {
    Report report;
    const auto numbers = [&](FieldIndex field, std::size_t first, std::span<const double> values,
                             std::string_view object, double smallest = smallest_float32) {
        for (std::size_t index = 0; index < values.size(); ++index) {
            const double magnitude = std::abs(values[index]);
            if (magnitude != 0 && !(magnitude >= smallest && magnitude <= largest_float32)) {
                const std::string_view expected = smallest > 0 ? "a magnitude from 1e-15 to 1e15 in float32"
                                                               : "a magnitude of at most 1e15 in float32";
                report.add({0, 0, std::string(fields[field].name),
                            found_message(fields[field].name, quoted(decimal(values[index])),
                                          fields[field].parameters[first + index].name, object, expected),
                            "render it in float64"});
            }
        }
    };
    const View &view = scene.view;
    numbers(NEAR, 0, {&view.near_plane, 1}, "");
    numbers(LEFT, 0, {&view.left, 1}, "");
    numbers(RIGHT, 0, {&view.right, 1}, "");
    numbers(BOTTOM, 0, {&view.bottom, 1}, "");
    numbers(TOP, 0, {&view.top, 1}, "");
    for (std::size_t index = 0; index < scene.spheres.size(); ++index) {
        const Sphere &sphere = scene.spheres[index];
        const std::string object = join(" of spheres[", std::to_string(index), "]");
        numbers(SPHERE, 1, sphere.position, object);
        numbers(SPHERE, 4, sphere.scaling, object);
        // Colours and K's are at most 1, and too small ones only become 0.
        numbers(SPHERE, 14, {&sphere.exponent, 1}, object, 0);
    }
    for (std::size_t index = 0; index < scene.lights.size(); ++index) {
        const Light &light = scene.lights[index];
        const std::string object = join(" of lights[", std::to_string(index), "]");
        numbers(LIGHT, 1, light.position, object);
        numbers(LIGHT, 4, light.intensity, object);
    }
    numbers(BACK, 0, scene.background, "", 0);
    numbers(AMBIENT, 0, scene.ambient, "");
    return report.finish();
}

std::string text(const Scene &scene) {
    std::string text;
    const View &view = scene.view;
    append_line(text, NEAR, {&view.near_plane, 1});
    append_line(text, LEFT, {&view.left, 1});
    append_line(text, RIGHT, {&view.right, 1});
    append_line(text, BOTTOM, {&view.bottom, 1});
    append_line(text, TOP, {&view.top, 1});
    text.append("RES ").append(std::to_string(view.columns)).append(" ").append(std::to_string(view.rows)).append("\n");
    for (const Sphere &sphere : scene.spheres) {
        const double coefficients[] = {sphere.ka, sphere.kd, sphere.ks, sphere.kr, sphere.exponent};
        text.append("SPHERE ").append(sphere.name);
        append(text, sphere.position);
        append(text, sphere.scaling);
        append(text, sphere.color);
        append(text, coefficients);
        text.append("\n");
    }
    for (const Light &light : scene.lights) {
        text.append("LIGHT ").append(light.name);
        append(text, light.position);
        append(text, light.intensity);
        text.append("\n");
    }
    append_line(text, BACK, scene.background);
    append_line(text, AMBIENT, scene.ambient);
    return text.append("OUTPUT ").append(scene.output).append("\n");
}

std::string decimal(double value) {
    char buffer[32];
    const auto [end, error] = std::to_chars(std::begin(buffer), std::end(buffer), value == 0 ? 0.0 : value);
    return error == std::errc() ? std::string(buffer, end) : std::string();
}

std::string describe(const Diagnostic &diagnostic, std::string_view source, std::string_view severity) {
    std::string line = escaped(source);
    if (diagnostic.line > 0) {
        line.append(":").append(std::to_string(diagnostic.line)).append(":").append(std::to_string(diagnostic.column));
    }
    line.append(": ").append(severity).append(": ").append(diagnostic.message);
    if (!diagnostic.hint.empty()) {
        line.append("\n  hint: ").append(diagnostic.hint);
    }
    return line;
}

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

}  // namespace whitted
