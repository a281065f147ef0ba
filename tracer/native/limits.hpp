// How fast this machine is at the arithmetic of the kernels, and nothing else: for `whitted speed --kernels`.
//
// One translation unit an instruction set (limits_*.cpp), compiled with the options of its kernels. Everything here is
// in an unnamed namespace, so that no function of one can be linked into another's path.
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

namespace {

// So many packets are on their way at once: more than an operation takes cycles, times what starts in a cycle.
inline constexpr int packets = 12;

template <class Real, int Width>
struct Packet {
    typedef Real type __attribute__((vector_size(sizeof(Real) * Width)));
};
template <class Real>
struct Packet<Real, 1> {
    using type = Real;
};

inline double root(double x) { return __builtin_sqrt(x); }
inline float root(float x) { return __builtin_sqrtf(x); }

template <class Real, int Width>
struct Limit {
    using V = typename Packet<Real, Width>::type;

    static Real sum(const V *x) {
        Real total = 0;
        const Real *lane = reinterpret_cast<const Real *>(x);
        for (int i = 0; i < packets * Width; ++i) total += lane[i];
        return total;
    }

    // Not fused, like those of the kernels.
    static Real multiply_adds(std::int64_t rounds, Real seed) {
        V x[packets];
        const V factor = V{} + (Real(1) - seed), more = V{} + seed;
        for (int i = 0; i < packets; ++i) x[i] = V{} + Real(i + 1);
        for (std::int64_t round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
            for (int i = 0; i < packets; ++i) x[i] = x[i] * factor + more;
        }
        return sum(x);
    }

    static Real divisions(std::int64_t rounds, Real seed) {
        V x[packets];
        const V by = V{} + (Real(1) + seed);
        for (int i = 0; i < packets; ++i) x[i] = by + Real(i + 1);
        for (std::int64_t round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
            for (int i = 0; i < packets; ++i) x[i] = by / x[i];
        }
        return sum(x);
    }

    // Lanes of an array, which the compiler makes packets of.
    static Real square_roots(std::int64_t rounds, Real seed) {
        alignas(64) Real x[packets * Width];
        for (int i = 0; i < packets * Width; ++i) x[i] = Real(i + 1);
        for (std::int64_t round = 0; round < rounds; ++round)
            for (int i = 0; i < packets * Width; ++i) x[i] = root(x[i] + seed);
        Real total = 0;
        for (int i = 0; i < packets * Width; ++i) total += x[i];
        return total;
    }

    static constexpr Loops<Real> loops{packets * Width, multiply_adds, square_roots, divisions};
};

}  // namespace
}  // namespace whitted
