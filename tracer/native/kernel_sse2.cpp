// Packets of 128 bits: the kernels for SSE2.
#include "kernel.hpp"

namespace whitted {

const Kernels kernels_sse2{"sse2", Kernel<double, 2>::trace_span, Kernel<float, 4>::trace_span};

}  // namespace whitted
