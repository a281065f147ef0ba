// Packets of 256 bits: the limits of avx2.
#include "limits_loops.hpp"

namespace whitted {

const Limits limits_avx2{"avx2", Limit<double, 4>::loops, Limit<float, 8>::loops};

}  // namespace whitted
