// Packets of 512 bits: the limits of avx512.
#include "limits_loops.hpp"

namespace whitted {

const Limits limits_avx512{"avx512", Limit<double, 8>::loops, Limit<float, 16>::loops};

}  // namespace whitted
