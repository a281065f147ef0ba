// Packets of 128 bits: the limits of neon.
#include "limits_loops.hpp"

namespace whitted {

const Limits limits_neon{"neon", Limit<double, 2>::loops, Limit<float, 4>::loops};

}  // namespace whitted
