// Packets of 128 bits: the limits of sse2.
#include "limits_loops.hpp"

namespace whitted {

const Limits limits_sse2{"sse2", Limit<double, 2>::loops, Limit<float, 4>::loops};

}  // namespace whitted
