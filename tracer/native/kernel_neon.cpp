// Packets of 128 bits: the kernels for NEON.
#include "kernel.hpp"

namespace whitted {

const Kernels kernels_neon{"neon", Kernel<double, 2>::trace_span, Kernel<float, 4>::trace_span};

}  // namespace whitted
