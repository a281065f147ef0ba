// How fast this machine is at the arithmetic of the kernels, and nothing else: for `whitted speed --kernels`.
#pragma once

#include <cstdint>
#include <string_view>

namespace whitted {

// Does `rounds` rounds, each of `operations` operations of every kind; returns a number that depends on all of them.
template <class Real>
struct Loops {
    std::int64_t operations;
    Real (*multiply_adds)(std::int64_t rounds, Real seed);
    Real (*square_roots)(std::int64_t rounds, Real seed);
    Real (*divisions)(std::int64_t rounds, Real seed);
};

struct Limits {
    const char *name;  // the instruction set
    Loops<double> f64;
    Loops<float> f32;
};

extern const Limits limits_scalar, limits_sse2, limits_avx2, limits_avx512, limits_neon;

// Operations a second of one thread.
struct Rate {
    double multiply_adds, square_roots, divisions;
};

// The best of several runs of about `seconds` in all, with an instruction set that this processor has: of f64, then of
// f32. False where there is no such instruction set.
bool measure_limits(std::string_view instruction_set, double seconds, Rate (&rates)[2]);

}  // namespace whitted
