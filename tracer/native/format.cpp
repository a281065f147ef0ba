// Finds fields in the table of the scene format by name, also by a misspelt one.
#include "format.hpp"

#include <algorithm>

#include "text.hpp"

namespace whitted {

const Field *find_field(std::string_view name) {
    const auto found =
        std::find_if(fields.begin(), fields.end(), [&](const Field &field) { return field.name == name; });
    return found == fields.end() ? nullptr : &*found;
}

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

std::string usage(const Field &field) {
    std::string line(field.name);
    for (const Parameter &parameter : field.parameters) {
        line.append(" <").append(parameter.name).append(">");
    }
    return line;
}

}  // namespace whitted
