// Packets of two registers of 128 bits: the kernels for SSE2.
#include "kernel.hpp"

namespace whitted {

const Kernels kernels_sse2{"sse2", Kernel<double, 4>::trace_span, Kernel<float, 8>::trace_span};

}  // namespace whitted
