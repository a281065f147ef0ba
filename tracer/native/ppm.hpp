// 8-bit values of colours and the binary PPM file.
#pragma once

#include <cstdint>
#include <string>

namespace whitted {

// v > 0 ? (v < 1 ? v : 1) : 0, times 255, truncated; NaN becomes 0.
template <class Real>
inline std::uint8_t quantise(Real v) {
    const Real clamped = v > Real(0) ? (v < Real(1) ? v : Real(1)) : Real(0);
    return static_cast<std::uint8_t>(static_cast<int>(clamped * Real(255)));
}

// "P6", size and maxval, up to the first pixel.
std::string ppm_header(std::int64_t columns, std::int64_t rows);

}  // namespace whitted
