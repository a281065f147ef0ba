// Reads scene files: every error of a file, each with its place and a hint.
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "format.hpp"
#include "hints.hpp"
#include "lines.hpp"
#include "number.hpp"
#include "rules.hpp"
#include "scene.hpp"
#include "text.hpp"

namespace whitted {
namespace {

constexpr const char *scene_hint = "a scene is text in UTF-8 with lines such as RES 640 480";

// The kind of image that a file begins like; empty: none.
std::string_view image_format(std::string_view text) {
    if (text.size() > 2 && text[0] == 'P' && text[1] >= '1' && text[1] <= '6' &&
        std::string_view(" \t\r\n").find(text[2]) != text.npos) {
        return "PPM";
    }
    if (text.starts_with("\x89PNG")) {
        return "PNG";
    }
    return text.starts_with("\xff\xd8\xff") ? "JPEG" : text.starts_with("v/1\x01") ? "EXR" : "";
}

// Whether the file begins like a program or an archive. A few strange bytes are a slip of an editor: those are reported
// one by one, with their places.
bool is_binary(std::string_view text) {
    constexpr std::size_t looked_at = 1024;
    constexpr std::ptrdiff_t slips = 4;
    const std::string_view start = text.substr(0, looked_at);
    return std::count_if(start.begin(), start.end(), [](char character) {
               return (character >= 0 && character < ' ' && (character < '\t' || character > '\r')) ||
                      character == '\x7f';
           }) > slips;
}

class Parser {
  public:
    Parser(std::string_view text, bool limits) : text_(text), limits_(limits) {}

    ParseResult run() {
        if (text_.starts_with("\xff\xfe") || text_.starts_with("\xfe\xff")) {
            // Once, where every line would be an error.
            report_.add({1, 1, "", "the file is UTF-16, expected UTF-8", "save the file as UTF-8"});
        } else if (const std::string_view image = image_format(text_); !image.empty()) {
            report_.add({1, 1, "", join("this is an image (", image, "), not a scene"), scene_hint});
        } else if (is_binary(text_)) {
            report_.add({1, 1, "", "this is not a text file", scene_hint});
        } else {
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
    void read_lines() {
        if (text_.starts_with(byte_order_mark)) {
            report_.add({1, 1, "", "found a byte-order mark, expected a field", "save the file as UTF-8 without BOM"});
        }
        LineReader reader(text_);
        while (reader.next(line_)) {
            if (line_.count > 0) {
                read_line();
            }
        }
    }

    void error(const Token &token, std::string message, std::string hint = "") {
        report_.add({line_.number, token.column, std::string(field_), std::move(message), std::move(hint)});
    }

    void unexpected(const Parameter &parameter, const Token &token, std::string_view expected, std::string hint) {
        error(token, found_message(field_, parameter, token.text, "", expected), std::move(hint));
    }

    void not_a_number(const Parameter &parameter, const Token &token) {
        unexpected(parameter, token, "a number", number_hint(token.text));
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
            message = join(found, listed(names), " ", names.size() == 1 ? "is" : "are", " missing");
            hint = missing_hint(field, given);
        }
        if (hint.empty()) {
            hint = write_hint(field);
            // Nothing says that the tokens stand in the wrong places: the numbers can be looked at.
            for (std::size_t index = 0; index < std::min(count, expected); ++index) {
                const Parameter &parameter = field.parameters[index];
                if (!is_text(parameter.kind) && parameter.kind != Kind::size && !is_number(given[index].text)) {
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

    std::optional<double> number(const Parameter &parameter, const Token &token) {
        const Number parsed = parse_number(token.text);
        if (!parsed.valid) {
            not_a_number(parameter, token);
            return std::nullopt;
        }
        if (const auto fault = fault_of_number(parameter.kind, parsed.value)) {
            unexpected(parameter, token, fault->expected,
                       parsed.underflow ? "it is so small that it is 0 as a float64" : fault->hint);
            return std::nullopt;
        }
        return parsed.value;
    }

    std::optional<std::int64_t> size(const Parameter &parameter, const Token &token) {
        const auto value = parse_size(token.text);
        if (!value) {
            unexpected(parameter, token, "an integer of at least 1", size_hint(token.text));
        } else if (const auto fault = fault_of_size(*value, limits_)) {
            unexpected(parameter, token, fault->expected, fault->hint);
        } else {
            return value;
        }
        return std::nullopt;
    }

    // Whether a name or file name is in order.
    bool word(const Parameter &parameter, const Token &token) {
        const auto fault = fault_of_text(parameter.kind, token.text);
        if (fault) {
            unexpected(parameter, token, fault->expected, fault->hint);
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
            if (is_text(parameter.kind)) {
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
        const std::string_view subject = empty_ ? "the file is empty: the fields " : one ? "the field " : "the fields ";
        report_.add_late({std::max<std::int64_t>(line_.number, 1), line_.end, one ? missing[0] : "",
                          join(subject, listed(missing), one ? " is missing" : " are missing", ", expected once",
                               one ? "" : " each"),
                          one ? join("add a line ", usage(*last)) : ""});
    }

    std::string_view text_;
    bool limits_;
    Line line_;
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

}  // namespace

ParseResult parse(std::string_view text, bool limits) { return Parser(text, limits).run(); }

}  // namespace whitted
