// On which side of a sphere's surface a light is: in float64 where that is certain, else in whole numbers.
#include "light_side.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace whitted {

namespace {

// A whole number >= 0: 32 bits a digit, the lowest first, without leading zeros.
class Natural {
  public:
    // |value| 2^shift, where that is whole.
    Natural(double value, int shift) {
        int exponent = 0;
        const auto mantissa = static_cast<std::uint64_t>(std::ldexp(std::frexp(std::abs(value), &exponent), 53));
        if (mantissa == 0) return;
        const auto up = static_cast<unsigned>(exponent - 53 + shift);
        digits.assign(up / 32, 0);
        const unsigned part = up % 32;
        digits.push_back(static_cast<std::uint32_t>(mantissa << part));
        digits.push_back(static_cast<std::uint32_t>(mantissa << part >> 32));
        if (part) digits.push_back(static_cast<std::uint32_t>(mantissa >> (64 - part)));
        trim();
    }

    friend int compare(const Natural &a, const Natural &b) {
        if (a.digits.size() != b.digits.size()) return a.digits.size() < b.digits.size() ? -1 : 1;
        for (std::size_t k = a.digits.size(); k-- > 0;)
            if (a.digits[k] != b.digits[k]) return a.digits[k] < b.digits[k] ? -1 : 1;
        return 0;
    }

    friend Natural operator+(const Natural &a, const Natural &b) {
        Natural sum;
        std::uint64_t carry = 0;
        for (std::size_t k = 0; k < std::max(a.digits.size(), b.digits.size()) || carry; ++k) {
            carry += a.at(k) + b.at(k);
            sum.digits.push_back(static_cast<std::uint32_t>(carry));
            carry >>= 32;
        }
        return sum;
    }

    // |a - b|
    friend Natural distance(const Natural &a, const Natural &b) {
        const bool less = compare(a, b) < 0;
        const Natural &large = less ? b : a;
        const Natural &small = less ? a : b;
        Natural found;
        std::uint64_t borrow = 0;
        for (std::size_t k = 0; k < large.digits.size(); ++k) {
            const std::uint64_t digit = large.at(k) - small.at(k) - borrow;
            found.digits.push_back(static_cast<std::uint32_t>(digit));
            borrow = digit >> 63;
        }
        found.trim();
        return found;
    }

    friend Natural operator*(const Natural &a, const Natural &b) {
        Natural product;
        product.digits.assign(a.digits.size() + b.digits.size(), 0);
        for (std::size_t i = 0; i < a.digits.size(); ++i) {
            std::uint64_t carry = 0;
            for (std::size_t j = 0; j < b.digits.size() || carry; ++j) {
                carry += a.at(i) * b.at(j) + product.digits[i + j];
                product.digits[i + j] = static_cast<std::uint32_t>(carry);
                carry >>= 32;
            }
        }
        product.trim();
        return product;
    }

  private:
    Natural() = default;
    std::uint64_t at(std::size_t k) const { return k < digits.size() ? digits[k] : 0; }
    void trim() {
        while (!digits.empty() && digits.back() == 0) digits.pop_back();
    }

    std::vector<std::uint32_t> digits;
};

// The sign of sum ((p - c) / s)^2 - 1, times the product of all s^2.
int exact_side(const Sphere &sphere, const Light &light) {
    int shift = 0;
    for (const Vec3 *vector : {&light.position, &sphere.position, &sphere.scaling})
        for (const double value : *vector)
            if (value != 0) shift = std::max(shift, 53 - std::ilogb(value));
    std::vector<Natural> away, size;
    for (std::size_t k = 0; k < 3; ++k) {
        const double p = light.position[k], c = sphere.position[k];
        const Natural to(p, shift), from(c, shift), s(sphere.scaling[k], shift);
        const Natural difference = std::signbit(p) == std::signbit(c) ? distance(to, from) : to + from;
        away.push_back(difference * difference);
        size.push_back(s * s);
    }
    const Natural form = away[0] * size[1] * size[2] + size[0] * away[1] * size[2] + size[0] * size[1] * away[2];
    return compare(form, size[0] * size[1] * size[2]);
}

}  // namespace

int light_side(const Sphere &sphere, const Light &light) {
    double form = -1;
    double size = 1;
    for (std::size_t k = 0; k < 3; ++k) {
        const double q = (light.position[k] - sphere.position[k]) / sphere.scaling[k];
        form += q * q;
        size += q * q;
    }
    // Each of the squares is off by 5 roundings at most, and each of the sums by one.
    if (std::abs(form) > 0x1p-50 * size) return form > 0 ? 1 : -1;
    return exact_side(sphere, light);
}

}  // namespace whitted
