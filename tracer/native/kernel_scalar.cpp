// One ray at a time: the kernels for any processor.
#include "kernel.hpp"

namespace whitted {

const Kernels kernels_scalar{"scalar", Kernel<double, 1>::trace_span, Kernel<float, 1>::trace_span};

}  // namespace whitted
