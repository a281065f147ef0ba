// One number at a time: the limits of scalar.
#include "limits_loops.hpp"

namespace whitted {

const Limits limits_scalar{"scalar", Limit<double, 1>::loops, Limit<float, 1>::loops};

}  // namespace whitted
