// Loops of one operation on packets. Included by limits_*.cpp only, which are compiled with the options of the kernels.
#pragma once

#include "limits.hpp"
#include "simd.hpp"

namespace whitted {
namespace {

// So many packets are on their way at once: more than an operation takes cycles, times what starts in a cycle.
inline constexpr int packets = 12;

template <class Real, int Width>
struct Limit {
    using P = Packet<Real, Width>;

    template <class Operation>
    static WHITTED_INLINE Real repeat(std::int64_t rounds, Operation operation) {
        P x[packets];
        for (int i = 0; i < packets; ++i) x[i] = P(Real(i + 1));
        for (std::int64_t round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
            for (int i = 0; i < packets; ++i) x[i] = operation(x[i]);
        }
        Real total = 0;
        for (const P &packet : x) {
            Real lanes[Width];
            packet.store(lanes);
            for (const Real lane : lanes) total += lane;
        }
        return total;
    }

    // Not fused, like those of the kernels.
    static Real multiply_adds(std::int64_t rounds, Real seed) {
        const P factor(Real(1) - seed), more(seed);
        return repeat(rounds, [=](P x) __attribute__((always_inline)) { return x * factor + more; });
    }

    static Real divisions(std::int64_t rounds, Real seed) {
        const P by(Real(1) + seed);
        return repeat(rounds, [=](P x) __attribute__((always_inline)) { return by / x; });
    }

    static Real square_roots(std::int64_t rounds, Real seed) {
        const P more(seed);
        return repeat(rounds, [=](P x) __attribute__((always_inline)) { return sqrt(x + more); });
    }

    static constexpr Loops<Real> loops{packets * Width, multiply_adds, square_roots, divisions};
};

}  // namespace
}  // namespace whitted
