// x^n for 0 < x <= 1, the same bits at every vector width. Included by kernel.hpp, and by a test.
#pragma once

#include <type_traits>

#include "simd.hpp"

namespace whitted {
namespace {

template <class Real>
struct PowerConstants;

template <>
struct PowerConstants<double> {
    static constexpr int mantissa_bits = 52;
    static constexpr std::int64_t bias = 1023;
    static constexpr double round_shift = 0x1.8p52;  // adding it leaves the nearest integer in the low bits
    static constexpr double integer_shift = 0x1p52;
    static constexpr double smallest = 0x1p-1022;
    static constexpr double lowest_exponent = -708;
    static constexpr double ln2_high = 0x1.62e42feep-1;  // 20 trailing zeros: k ln2_high is exact
    static constexpr double ln2_low = 0x1.a39ef35793c76p-33;
    static constexpr int log_terms = 11;
    static constexpr int exp_terms = 13;
};

template <>
struct PowerConstants<float> {
    static constexpr int mantissa_bits = 23;
    static constexpr std::int32_t bias = 127;
    static constexpr float round_shift = 0x1.8p23f;
    static constexpr float integer_shift = 0x1p23f;
    static constexpr float smallest = 0x1p-126f;
    static constexpr float lowest_exponent = -87;
    static constexpr float ln2_high = 0x1.62ep-1f;
    static constexpr float ln2_low = 0x1.0bfbe8p-15f;
    static constexpr int log_terms = 6;
    static constexpr int exp_terms = 7;
};

// ln x for a normal x > 0: x = 2^e m with m in [sqrt 1/2, sqrt 2), ln m = 2 atanh f with f = (m - 1)/(m + 1).
template <class Real, int Width>
WHITTED_LARGE Packet<Real, Width> natural_log(Packet<Real, Width> x) {
    using P = Packet<Real, Width>;
    using C = PowerConstants<Real>;
    using Bits = typename BitsOf<Real>::type;
    using Unsigned = typename Vector<std::make_unsigned_t<Bits>, Width>::type;
    constexpr Bits one = C::bias << C::mantissa_bits;
    constexpr Bits mantissa = (Bits(1) << C::mantissa_bits) - 1;

    const auto bits = to_bits(x);
    const auto integer_shift = to_bits(P(C::integer_shift));
    const auto biased = (BitsPacket<Real, Width>)((Unsigned)bits >> C::mantissa_bits);
    P exponent = from_bits<Real, Width>(biased | integer_shift) - P(C::integer_shift + Real(C::bias));
    P m = from_bits<Real, Width>((bits & mantissa) | one);
    const auto upper = m > P(Real(1.4142135623730951));
    m = select(upper, m * P(Real(0.5)), m);
    exponent = select(upper, exponent + P(Real(1)), exponent);

    const P f = (m - P(Real(1))) / (m + P(Real(1)));
    const P s = f * f;
    P series = P(Real(1) / Real(2 * C::log_terms - 1));
    for (int k = C::log_terms - 2; k >= 1; --k) series = series * s + P(Real(1) / Real(2 * k + 1));
    const P ln_m = P(Real(2)) * (f + f * (s * series));
    return exponent * P(C::ln2_high) + (ln_m + exponent * P(C::ln2_low));
}

// e^y for y <= 0; 0 where it would be below the normal numbers.
template <class Real, int Width>
WHITTED_LARGE Packet<Real, Width> exponential(Packet<Real, Width> y) {
    using P = Packet<Real, Width>;
    using C = PowerConstants<Real>;
    const auto vanishes = y < P(C::lowest_exponent);
    y = maximum(y, P(C::lowest_exponent));
    const P shifted = y * P(Real(1.4426950408889634)) + P(C::round_shift);
    const P k = shifted - P(C::round_shift);
    const P r = (y - k * P(C::ln2_high)) - k * P(C::ln2_low);
    Real factorial = 1;
    for (int i = 2; i <= C::exp_terms; ++i) factorial *= Real(i);
    P series = P(Real(1) / factorial);
    for (int i = C::exp_terms; i >= 1; --i) {
        factorial /= Real(i);
        series = series * r + P(Real(1) / factorial);
    }
    const P two_to_k = from_bits<Real, Width>((to_bits(shifted) + C::bias) << C::mantissa_bits);
    return select(vanishes, P(Real(0)), series * two_to_k);
}

// x^n for 0 < x <= 1, n >= 0. integer: n where it is an integer to be multiplied out, else -1.
// Multiplied out it is off by n - 1 roundings. Else by less than 8 u: |y| e^y <= 1/e for y = n ln x, so that the
// relative error of y, 7 u at most, stays absolute. docs/tolerances.md, section 3.
template <class Real, int Width>
WHITTED_LARGE Packet<Real, Width> power(Packet<Real, Width> x, Real n, int integer) {
    using P = Packet<Real, Width>;
    if (integer >= 0) {
        if (integer == 0) return P(Real(1));
        P square = x;
        for (; !(integer & 1); integer >>= 1) square = square * square;
        P result = square;
        while (integer >>= 1) {
            square = square * square;
            if (integer & 1) result = result * square;
        }
        return result;
    }
    if constexpr (Pair<Real, Width>)
        return P(power(x.low, n, integer), power(x.high, n, integer));
    else
        return exponential(P(n) * natural_log(maximum(x, P(PowerConstants<Real>::smallest))));
}

}  // namespace
}  // namespace whitted
