// The header of a binary PPM file.
#include "ppm.hpp"

namespace whitted {

std::string ppm_header(std::int64_t columns, std::int64_t rows) {
    return "P6\n" + std::to_string(columns) + " " + std::to_string(rows) + "\n255\n";
}

}  // namespace whitted
