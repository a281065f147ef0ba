// Times the loops of limits.hpp.
#include "limits.hpp"

#include <algorithm>
#include <chrono>

namespace whitted {
namespace {

const Limits *const compiled[] = {
    &limits_scalar,
#if defined(__x86_64__)
    &limits_sse2,
    &limits_avx2,
    &limits_avx512,
#elif defined(__aarch64__)
    &limits_neon,
#endif
};

// What is written here cannot be left out by the compiler.
volatile double sink;

template <class Real>
double rate(Real (*loop)(std::int64_t, Real), std::int64_t operations, double seconds) {
    using Clock = std::chrono::steady_clock;
    constexpr int runs = 5;
    // The compiler must not know it.
    volatile Real seed = Real(1e-3);
    double best = 0;
    std::int64_t rounds = 1000;
    for (int run = 0; run < runs;) {
        const auto start = Clock::now();
        sink = static_cast<double>(loop(rounds, seed));
        const double took = std::chrono::duration<double>(Clock::now() - start).count();
        if (took < seconds / runs / 2) {
            rounds *= 2;
            continue;
        }
        best = std::max(best, static_cast<double>(rounds) * static_cast<double>(operations) / took);
        ++run;
    }
    return best;
}

template <class Real>
Rate measure(const Loops<Real> &loops, double seconds) {
    const double each = seconds / 3;
    return {rate(loops.multiply_adds, loops.operations, each), rate(loops.square_roots, loops.operations, each),
            rate(loops.divisions, loops.operations, each)};
}

}  // namespace

bool measure_limits(std::string_view instruction_set, double seconds, Rate (&rates)[2]) {
    for (const Limits *limits : compiled) {
        if (limits->name != instruction_set) continue;
        rates[0] = measure(limits->f64, seconds / 2);
        rates[1] = measure(limits->f32, seconds / 2);
        return true;
    }
    return false;
}

}  // namespace whitted
